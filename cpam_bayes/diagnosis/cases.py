"""Plate cases from plate files, every frequency paired with a mode, and the hypotheses about them."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace

import numpy as np

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis, prior_by_cause, single_hypotheses
from cpam_bayes.diagnosis.models import PlateModels, extended_model, needs_another_space, plate_models
from cpam_bayes.effects import CATALOGUE, Effect, extend
from cpam_bayes.forward_model.build import without_matrices
from cpam_bayes.forward_model.labels import by_shape, labelled_model, list_order, spare_modes
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.pairing import (
    PairingPrior,
    labelled_log_likelihood,
    most_probable_labelled_pairing,
)
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parallel import counted, run
from cpam_bayes.parameters import Parameter
from cpam_bayes.plate import Specimen
from cpam_bayes.running import TimeIsUpError

# Spare modes for a complete list, which may lack two modes, and for one that is declared incomplete.
_SPARE, _MORE_SPARE = 2, 6


def plate_case(
    specimen: Specimen, notify: Callable[[str], None] = lambda text: None, *, is_rough: bool = False
) -> PlateCase:
    """Plate case in which every measured frequency is paired with a mode.

    The list is paired in order, except where labels or measured shapes fix the mode; the search for pairings
    of an incomplete list starts there. Raises ``ValueError`` for a specimen without a list or without
    unknown constants.
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
    n_modes = measurement.size + max(spare, spare_modes(measurement))
    models = plate_models(specimen, n_modes, notify, is_rough=is_rough)
    model = labelled_model(models.bare, measurement, specimen)
    order = list_order(model, reference_vector(specimen, models.parameters))
    return PlateCase(models, measurement, order[: measurement.size], by_shape=by_shape(model))


def hypotheses_of(
    cases: Sequence[PlateCase], catalogue: tuple[Effect, ...] = CATALOGUE
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """All single hypotheses, each with the plates it concerns; none comes first.

    With several specimens a cause may act on one of them or, as probably, on all with a common size.
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
    # causes that only some plates can have leave a part of the prior, which is shared among all causes
    alone = sum(h.prior for h in singles[0] if h.cause not in (NONE, OTHER))
    factor = alone / sum(h.prior for h, _ in hypotheses)
    first = [(h, every) for h in singles[0] if h.cause in (NONE, OTHER)]
    return first + [(replace(h, prior=factor * h.prior), plates) for h, plates in hypotheses]


def _causes_of_several(
    singles: Sequence[tuple[Hypothesis, ...]], groups: Sequence[tuple[int, ...]]
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """Causes with the plates they concern; half of the prior goes to causes common to all plates.

    singles : hypotheses of each plate
    groups : plate numbers, by specimen
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
    """Names of constants whose prior differs between files of one material; the first file's one holds."""
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
    """Causes that the given plates may have in common; another material always concerns all plates.

    The prior of a common size is that of the plate with the narrowest range.
    """
    each = [{(h.cause, h.variant): h for h in singles[i] if h.records} for i in plates]
    shared = [key for key, h in each[0].items() if not h.is_of_one_test and all(key in o for o in each)]
    return [
        replace(min((of[key] for of in each), key=_widest_size), prior=each[0][key].prior) for key in shared
    ]


def _widest_size(hypothesis: Hypothesis) -> float:
    sizes = (p.prior for effect in hypothesis.effects for p in effect.sizes)
    return max((prior.upper - prior.lower for prior in sizes), default=0.0)


def _of_specimen(
    singles: Sequence[tuple[Hypothesis, ...]], tests: tuple[int, ...]
) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """Causes of one specimen with the tests they concern, as probable as with a single test.

    A flaw of the plate concerns all tests in which it can act; a clamp or an error of a list concerns one.
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


Model = ReducedModel | LocalModel | PlateModels


def build_models(
    cases: Sequence[PlateCase],
    hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]],
    executor: Executor | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Build the models that the hypotheses need, in parallel on an executor.

    They are bit-identical on any executor. An effect that cannot be pickled is built on first use.
    """
    wanted = _wanted(cases, hypotheses)
    if not wanted:
        return
    plates = [replace(case.models, bare=without_matrices(case.models.bare)) for case in cases]

    count = counted(progress, len(wanted))

    def store(index: int, built: Model | None) -> None:
        i, effect = wanted[index]
        case = cases[i]
        if isinstance(built, PlateModels):
            case.of_another_material.append(built)
        elif effect is not None and built is not None:
            case.extended[effect.name, effect.variant] = built
        count(index, None)

    progress(0, len(wanted))
    with suppress(TimeIsUpError):  # the hypotheses that need what is missing are not tested
        run(_built, plates, wanted, executor, batch_size=1, on_result=store, is_limited=True)


def _built(plates: Sequence[PlateModels], item: tuple[int, Effect | None]) -> Model | None:
    """The model of a plate with an effect, or of another material; ``None`` where it has no modes."""
    i, effect = item
    try:
        if effect is None:
            return plate_models(plates[i].specimen, plates[i].n_modes, other_material=True)
        return extended_model(plates[i], effect)
    except RigidBodyError:  # it is said where the hypothesis is tested
        return None


def _wanted(
    cases: Sequence[PlateCase], hypotheses: Sequence[tuple[Hypothesis, tuple[int, ...]]]
) -> list[tuple[int, Effect | None]]:
    """Models to build as (plate, effect), ``None`` for another material; the slowest first."""
    wanted: dict[tuple[int, str, str], tuple[int, int, Effect | None]] = {}
    for hypothesis, plates in hypotheses:
        for i in plates:
            case = cases[i]
            models = case.models
            if hypothesis.other_material and not case.of_another_material:
                wanted[i, "", ""] = (0, i, None)
            for effect in hypothesis.effects:
                key = (i, effect.name, effect.variant)
                known = key in wanted or key[1:] in case.extended or effect.change is None
                if not known and _can_be_sent(effect):
                    is_converged_anew = not effect.is_anywhere and needs_another_space(
                        extend(models.problem, effect, models.facts), effect, models
                    )
                    wanted[key] = (1 - int(is_converged_anew), i, effect)
    return [(i, effect) for _, i, effect in sorted(wanted.values(), key=lambda entry: entry[0])]


def _can_be_sent(effect: Effect) -> bool:
    try:
        pickle.dumps(effect)
    except (pickle.PicklingError, AttributeError, TypeError):
        return False
    return True


def is_incomplete(case: PlateCase) -> bool:
    """Whether the list is incomplete, so that its pairings are summed over."""
    return not case.measurement.complete


def is_open_ended(case: PlateCase) -> bool:
    """Whether the last frequency of an incomplete list is a false peak: modes below it may be missed."""
    return is_incomplete(case) and bool(case.modes[-1] < 0)


def labelled(case: PlateCase) -> Array:
    """Mask (n,) of the frequencies whose mode is fixed by a label or a measured shape."""
    if case.by_shape is not None:
        return np.asarray(case.by_shape.modes >= 0)
    return np.array([bool(label) for label in case.measurement.labels])


def with_pairing(case: PlateCase, modes: Array, missed_above: int = 0) -> PlateCase:
    """The plate case with another pairing of its list.

    The log prior is n_paired log(1 - p) + n_missed log p + n_false log(lambda / f_last), where the modes that
    the list lacks below its highest paired one count as missed (``PairingPrior``); a complete list has none.

    modes : (n,) model mode of every frequency, -1 for a false peak
    missed_above : number of modes between the highest paired one and the last frequency, a false peak
    """
    if case.measurement.complete:
        return replace(case, modes=modes)
    prior, paired = PairingPrior.of(case.measurement), modes[modes >= 0]
    n_missed = int(paired.max(initial=-1)) + 1 - len(paired) + missed_above
    log_prior = len(paired) * np.log1p(-prior.missed)
    if n_missed:
        log_prior += n_missed * np.log(prior.missed)
    log_prior += prior.log_false(len(modes), case.measurement.frequencies[-1])[modes < 0].sum()
    return replace(case, modes=modes, log_pairing=float(log_prior))


def with_missed_modes(case: PlateCase, predicted: Array) -> PlateCase:
    """The case with unpaired predicted modes (k,) below the last frequency counted as missed."""
    if not is_open_ended(case):
        return case
    first = int(case.modes.max(initial=-1)) + 1
    above = int(np.sum(predicted[first:] <= case.measurement.frequencies[-1]))
    return with_pairing(case, case.modes, above)


def most_probable(case: PlateCase, predicted: Array, sigma: Array) -> Array:
    """Most probable modes (n,) given predictions (k,) and noise (n,) Hz; labelled frequencies keep theirs."""
    f, known = case.measurement.frequencies, np.where(labelled(case), case.modes, -1)
    density = log_density(f, predicted[None], sigma)[0]
    prior = PairingPrior.of(case.measurement)
    return most_probable_labelled_pairing(density, predicted <= f[-1], f[-1], known, prior).mode


def log_sum(case: PlateCase, predicted: Array, relative: float) -> Array:
    """Log likelihood (m,) of predictions (m, k) at a relative noise, summed over all pairings."""
    f, known = case.measurement.frequencies, np.where(labelled(case), case.modes, -1)
    density, prior = log_density(f, predicted, relative * f), PairingPrior.of(case.measurement)
    return labelled_log_likelihood(density, predicted <= f[-1], f[-1], known, prior)


def log_density(f: Array, predicted: Array, sigma: Array) -> Array:
    """Log density of frequencies (n,) about predictions (m, k), (m, n, k)."""
    away = (f[:, None] - predicted[:, None, :]) / sigma[:, None]
    return np.asarray(-0.5 * away**2 - np.log(sigma)[:, None] - 0.5 * np.log(2 * np.pi))


def neighbours(case: PlateCase) -> list[Array]:
    """Modes (n,) of all pairings one move away.

    A move makes one frequency false or gives it another mode, or shifts it and all above it by a mode.
    """
    fixed = labelled(case)
    columns = np.setdiff1d(np.arange(case.models.n_modes), case.modes[fixed])
    place = {int(mode): at for at, mode in enumerate(columns)}
    rank = np.array([place.get(int(mode), -1) for mode in case.modes[~fixed]])
    n, k = len(rank), len(columns)
    moved: list[Array] = []
    for i in range(n):
        below, above = rank[:i].max(initial=-1), min((r for r in rank[i + 1 :] if r >= 0), default=k)
        moved += [_moved(rank, i, r) for r in (-1, *range(int(below) + 1, int(above))) if r != rank[i]]
        if rank[i] < 0:
            continue
        for step in (-1, 1):
            shifted = np.where((np.arange(n) >= i) & (rank >= 0), rank + step, rank)
            if shifted.max() < k and shifted[i] > below:
                moved.append(shifted)
            at = i + step
            if 0 <= at < n and rank[at] < 0:  # the next frequency is the mode, and this one false
                moved.append(_moved(_moved(rank, at, rank[i]), i, -1))
    modes = []
    for r in moved:
        changed = np.array(case.modes)
        changed[~fixed] = np.where(r >= 0, columns[r], -1)
        modes.append(changed)
    return modes


def _moved(rank: Array, i: int, to: int) -> Array:
    moved = rank.copy()
    moved[i] = to
    return moved
