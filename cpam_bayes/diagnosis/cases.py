"""From plate files to plates with their lists, ready to be weighed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.fitting import PlateCase, comparison_of
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis, prior_by_cause, single_hypotheses
from cpam_bayes.diagnosis.models import PlateModels, plate_models
from cpam_bayes.effects import CATALOGUE, Effect
from cpam_bayes.forward_model.labels import labelled_model, list_order
from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.inference.standard_normal import MAX_SCORE
from cpam_bayes.parameters import Parameter
from cpam_bayes.plate import Measurement, Specimen

Array = NDArray[Any]

# Modes computed beyond a complete list, which may lack two, and beyond one that says it is incomplete.
_SPARE, _MORE_SPARE = 2, 6
# Points of the prior at which the pairing of an incomplete list is sought, those of them optimised
# from, and turns of pairing and optimising at most.
_POINTS, _OPTIMISED, _MOST_TURNS = 512, 6, 8


def plate_case(specimen: Specimen, notify: Callable[[str], None] = lambda text: None) -> PlateCase:
    """A plate with its list, every frequency given to a mode.

    A complete list is paired in order, labels fix their modes, and an incomplete list has the pairing that
    is most probable under the plain model; its false peaks are left out. Raises ``ValueError`` for a
    specimen without a list or without unknown constants.
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
    spare = _SPARE if measurement.complete and not any(measurement.labels) else _MORE_SPARE
    models = plate_models(specimen, measurement.size + spare, notify)
    modes = _modes(models, measurement)
    kept = modes >= 0
    return PlateCase(models, _only(measurement, kept), modes[kept])


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


def _modes(models: PlateModels, measurement: Measurement) -> Array:
    """Model mode of every frequency, -1 for a false peak."""
    n = measurement.size
    if any(measurement.labels):
        labelled = labelled_model(models.bare, measurement, models.specimen)
        order = list_order(labelled, reference_vector(models.specimen, models.parameters))
        return np.asarray(order[:n])
    if measurement.complete:
        return np.arange(n)
    return _most_probable_pairing(models, measurement)


def _most_probable_pairing(models: PlateModels, measurement: Measurement) -> Array:
    """Model mode of every frequency of an incomplete list, -1 for a false peak, under the plain model.

    Pairing and constants are sought in turn from the best of many points of the prior: the most probable
    pairing at the constants, then the most probable constants of that pairing.
    """
    posterior = plate_posterior(models.bare, measurement, models.error)
    points = posterior.parameters.sample(np.random.default_rng(0), _POINTS)
    points = points[models.bare.admissible(points[:, : models.parameters.size])]
    best: dict[bytes, tuple[float, Array]] = {}
    for start in points[np.argsort(-posterior.log_prob(points), kind="stable")[:_OPTIMISED]]:
        x, seen = start, set[bytes]()
        for _ in range(_MOST_TURNS):
            mode = posterior.most_probable_pairing(x).mode
            if mode.tobytes() in seen:
                break
            seen.add(mode.tobytes())
            x = _best_constants(models, measurement, mode, x)
            value = float(posterior.log_prob(x[None])[0])
            best[mode.tobytes()] = max(best.get(mode.tobytes(), (-np.inf, mode)), (value, mode), key=_first)
    return max(best.values(), key=_first)[1]


def _first(entry: tuple[float, Array]) -> float:
    return entry[0]


def _best_constants(models: PlateModels, measurement: Measurement, mode: Array, x: Array) -> Array:
    """The most probable parameters of a pairing, by an optimisation from x (n,)."""
    kept = mode >= 0
    case = PlateCase(models, _only(measurement, kept), mode[kept])
    comparison = comparison_of([case], Hypothesis(NONE, NONE))
    bound = np.full(len(x), MAX_SCORE)
    maxima = maximise(
        lambda z, rows: comparison.expand(z), comparison.scores.to_z(x[None]), -bound, bound, promised=1e-2
    )
    return np.asarray(comparison.scores.to_x(maxima.u[0]))


def _only(measurement: Measurement, kept: Array) -> Measurement:
    if kept.all():
        return measurement
    sd = measurement.frequency_sd
    return replace(
        measurement,
        frequencies=measurement.frequencies[kept],
        frequency_sd=None if sd is None else sd[kept],
        labels=tuple(label for label, is_kept in zip(measurement.labels, kept, strict=True) if is_kept),
    )
