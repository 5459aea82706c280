"""From plate files to plates with their lists, ready to be weighed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import Hypothesis, ListChange, single_hypotheses
from cpam_bayes.diagnosis.models import PlateModels, diagnosis_parameters, plate_models
from cpam_bayes.inference.laplace import find_optima
from cpam_bayes.labels import labelled_model, list_order
from cpam_bayes.measurement import Measurement, Specimen
from cpam_bayes.model import reference_vector
from cpam_bayes.posterior import plate_posterior

Array = NDArray[Any]

# Modes computed beyond a complete list, which may lack two, and beyond one that says it is incomplete.
_SPARE, _MORE_SPARE = 2, 6


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


def hypotheses_of(cases: Sequence[PlateCase]) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """All single hypotheses with the plates that they are about, none first.

    With several specimens a cause may be that of one of them or common to all, with one size; both have
    the same probability, and so have the specimens.
    """
    own = [
        single_hypotheses(
            case.models.facts,
            case.measurement.size,
            complete=case.models.specimen.measurement is not None
            and case.models.specimen.measurement.complete,
            air_is_known=case.models.specimen.air_density is not None,
            references_have_sd=_references_have_sd(case.models),
        )
        for case in cases
    ]
    every = tuple(range(len(cases)))
    if len(cases) == 1:
        return [(h, every) for h in own[0]]
    groups: dict[str, list[int]] = {}
    for i, case in enumerate(cases):
        groups.setdefault(case.models.specimen.specimen, []).append(i)
    found = [(h, every) for h in own[0] if h.cause in ("none", "other")]
    common = _shared(own, every)
    # one specimen under several tests: its flaws are in all of them, those of a test in one
    of_groups = [(_shared(own, tuple(g)), tuple(g)) for g in groups.values()]
    if len(groups) == 1:
        found += [(h, every) for h in common]
        of_tests = [(h, (i,)) for i in every for h in own[i] if _is_of_test(h)]
        found += [(replace(h, prior=h.prior / len(cases)), at) for h, at in of_tests]
        return found
    found += [(replace(h, prior=0.5 * h.prior), every) for h in common]
    for members, at in of_groups:
        found += [(replace(h, prior=0.5 * h.prior / len(groups)), at) for h in members]
        if len(at) > 1:
            of_tests = [(h, (i,)) for i in at for h in own[i] if _is_of_test(h)]
            found += [(replace(h, prior=0.5 * h.prior / len(groups) / len(at)), i) for h, i in of_tests]
    lists = [
        (h, (i,)) for i in every for h in own[i] if h.listed != ListChange() and len(groups) == len(cases)
    ]
    seen = {(h.cause, h.variant, at) for h, at in found}
    found += [
        (replace(h, prior=0.5 * h.prior / len(cases)), at)
        for h, at in lists
        if (h.cause, h.variant, at) not in seen
    ]
    return found


def _references_have_sd(models: PlateModels) -> bool:
    """Whether a reference narrows the prior of a constant beyond the search bounds."""
    wide = diagnosis_parameters(models.specimen, other_material=True)
    return [p.prior for p in wide.parameters] != [p.prior for p in models.parameters.parameters]


def _shared(own: Sequence[tuple[Hypothesis, ...]], plates: tuple[int, ...]) -> list[Hypothesis]:
    """Causes that all of some plates may have in common."""
    if len(plates) == 1:  # a material is that of all plates
        return [h for h in own[plates[0]] if h.cause not in ("none", "other") and not h.other_material]
    first = [h for h in own[plates[0]] if h.effects or h.other_material]
    others = [{(h.cause, h.variant) for h in own[i]} for i in plates[1:]]
    return [h for h in first if not _is_of_test(h) and all((h.cause, h.variant) in names for names in others)]


def _is_of_test(h: Hypothesis) -> bool:
    """Whether a cause belongs to one test of a specimen: its clamp or its list."""
    return h.family in ("clamp", "list")


def _modes(models: PlateModels, measurement: Measurement) -> Array:
    """Model mode of every frequency, -1 for a false peak."""
    n = measurement.size
    if any(measurement.labels):
        labelled = labelled_model(models.bare, measurement, models.specimen)
        order = list_order(labelled, reference_vector(models.specimen, models.parameters))
        return np.asarray(order[:n])
    if measurement.complete:
        return np.arange(n)
    posterior = plate_posterior(models.bare, measurement, models.error)
    best = find_optima(posterior, np.empty((0, posterior.parameters.size)), np.random.default_rng(0))[0]
    return posterior.most_probable_pairing(best.x).mode


def _only(measurement: Measurement, kept: Array) -> Measurement:
    if kept.all():
        return measurement
    sd = measurement.frequency_sd
    return Measurement(
        measurement.frequencies[kept],
        measurement.resolution,
        measurement.relative_std,
        None if sd is None else sd[kept],
        tuple(label for label, own in zip(measurement.labels, kept, strict=True) if own),
        measurement.complete,
    )
