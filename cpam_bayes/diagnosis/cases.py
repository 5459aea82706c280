"""From plate files to plates with their lists, ready to be weighed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis, prior_by_cause, single_hypotheses
from cpam_bayes.diagnosis.models import plate_models
from cpam_bayes.effects import CATALOGUE, Effect
from cpam_bayes.forward_model.labels import by_shape, labelled_model, list_order, spare_modes
from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.parameters import Parameter
from cpam_bayes.plate import Measurement, Specimen

# Modes computed beyond a complete list, which may lack two, and beyond one that says it is incomplete.
_SPARE, _MORE_SPARE = 2, 6


def plate_case(specimen: Specimen, notify: Callable[[str], None] = lambda text: None) -> PlateCase:
    """A plate with its list, every frequency given to a mode.

    A list is paired in order, and labels and measured shapes fix their modes, shapes that are like several
    modes the most probable ones. The pairings of an incomplete list, summed over
    in its diagnosis, begin from there. Raises ``ValueError`` for a specimen without a list or without unknown
    constants.
    """
    measurement = specimen.measurement
    if measurement is None or not measurement.size:
        raise ValueError(
            f"{specimen.source}: [measurement] is missing, nothing to be compared with the model"
        )
    if not specimen.unknowns.size:
        raise ValueError(
            f"{specimen.source}: [unknowns] is missing; name the constants that may differ from [material]"
        )
    spare = _SPARE if measurement.complete and not measurement.names_modes else _MORE_SPARE
    models = plate_models(specimen, measurement.size + max(spare, spare_modes(measurement)), notify)
    model = labelled_model(models.bare, measurement, specimen)
    order = list_order(model, reference_vector(specimen, models.parameters))
    return PlateCase(models, measurement, order[: measurement.size], by_shape=by_shape(model))


def with_list(case: PlateCase, measurement: Measurement) -> PlateCase:
    """The same plate with another complete list of as many frequencies; its models are shared."""
    return replace(case, measurement=measurement)


def hypotheses_of(
    cases: Sequence[PlateCase], catalogue: tuple[Effect, ...] = CATALOGUE
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """All single hypotheses with the plates that they are about, none first.

    With several specimens a cause may be that of one of them or common to all, with one size; both have
    the same probability, and so have the specimens.
    """
    singles = [
        single_hypotheses(
            case.models.facts,
            case.measurement.size,
            complete=case.models.specimen.measurement is not None
            and case.models.specimen.measurement.complete,
            catalogue=catalogue,
        )
        for case in cases
    ]
    every = tuple(range(len(cases)))
    if len(cases) == 1:
        return [(h, every) for h in singles[0]]
    groups: dict[str, list[int]] = {}
    for i, case in enumerate(cases):
        groups.setdefault(case.models.specimen.specimen, []).append(i)
    hypotheses = _causes_of_several(singles, [tuple(group) for group in groups.values()])
    # what only some plates can have leaves a part of its probability, which goes to all causes
    alone = sum(h.prior for h in singles[0] if h.cause not in (NONE, OTHER))
    factor = alone / sum(h.prior for h, _ in hypotheses)
    first = [(h, every) for h in singles[0] if h.cause in (NONE, OTHER)]
    return first + [(replace(h, prior=factor * h.prior), plates) for h, plates in hypotheses]


def _causes_of_several(
    singles: Sequence[tuple[Hypothesis, ...]], groups: Sequence[tuple[int, ...]]
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """Causes with the plates that they are about, half of the probability on those common to all.

    singles : hypotheses of every plate
    groups : plates by specimen
    """
    every = tuple(range(len(singles)))
    if len(groups) == 1:
        of_all = [(h, every) for h in _common(singles, every) if h.other_material]
        return of_all + _of_specimen(singles, every)
    causes = [(replace(h, prior=0.5 * h.prior), every) for h in _common(singles, every)]
    half = 0.5 / len(groups)
    for group in groups:
        causes += [(replace(h, prior=half * h.prior), at) for h, at in _of_specimen(singles, group)]
    return causes


def differing_priors(cases: Sequence[PlateCase]) -> tuple[str, ...]:
    """Constants whose prior is not the same in the files of plates of one material; the first one's holds."""
    first: dict[tuple[str | None, str], Parameter] = {}
    names = []
    for case in cases:
        specimen = case.models.specimen
        for parameter in case.models.parameters.parameters:
            if parameter.name in specimen.unknowns:
                known = first.setdefault((specimen.material.name, parameter.name), parameter)
                if known.prior != parameter.prior:
                    names.append(parameter.name)
    return tuple(dict.fromkeys(names))


def _common(singles: Sequence[tuple[Hypothesis, ...]], plates: tuple[int, ...]) -> list[Hypothesis]:
    """Causes that all of some plates may have in common; a material is that of all."""
    first = [h for h in singles[plates[0]] if h.records]
    others = [{(h.cause, h.variant) for h in singles[i]} for i in plates[1:]]
    return [h for h in first if not h.is_of_one_test and all((h.cause, h.variant) in o for o in others)]


def _of_specimen(
    singles: Sequence[tuple[Hypothesis, ...]], tests: tuple[int, ...]
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """Causes of one specimen with its tests that they are about.

    A flaw of the plate is about all tests in which it can act: threads do not hold a clamped plate. Clamps
    and errors of a frequency list are about one test each. A cause is as probable as it is with one test.
    """
    flaws: dict[tuple[str, str], tuple[Hypothesis, list[int]]] = {}
    causes: list[tuple[Hypothesis, tuple[int, ...]]] = []
    alone: dict[str, float] = {}
    for i in tests:
        here = [h for h in singles[i] if h.cause not in (NONE, OTHER) and not h.other_material]
        for h in here:
            if h.is_of_one_test:
                causes.append((h, (i,)))
            else:
                flaws.setdefault((h.cause, h.variant), (h, []))[1].append(i)
        for cause, prior in prior_by_cause(here).items():
            alone[cause] = max(prior, alone.get(cause, 0.0))
    causes = [(h, tuple(at)) for h, at in flaws.values()] + causes
    whole = prior_by_cause([h for h, _ in causes])
    return [(replace(h, prior=h.prior * alone[h.cause] / whole[h.cause]), at) for h, at in causes]
