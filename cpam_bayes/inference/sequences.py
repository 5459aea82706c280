"""The posterior over every stacking sequence on the grid, the elastic constants marginalised.

A sequence is a component of a mixture with its own evidence. Where there are few, each one's evidence
is computed; where there are many, it is learned as a smooth function of the plies' sums, evaluated for
every sequence, and computed anew for those that are reported and for draws from the result, which tell
how good the learned function is and correct it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.cache import reduced_model
from cpam_bayes.inference.enumeration import (
    BINS,
    Enumerator,
    Piece,
    bin_of,
    enumerate_prefixes,
    prefixes_to_visit,
    values_of_prefix,
)
from cpam_bayes.inference.evidence_table import build_table
from cpam_bayes.inference.identify import required
from cpam_bayes.inference.ply_sums import PlySums, ply_sums
from cpam_bayes.inference.sequence_classes import canonical, members
from cpam_bayes.inference.sequence_evidence import SequencePosterior, sequence_posterior
from cpam_bayes.inference.sequence_surface import (
    Evaluated,
    LearningSettings,
    Surface,
    evaluate,
    learn,
    starts_near,
)
from cpam_bayes.inference.symmetries import Symmetry, plate_symmetries
from cpam_bayes.measurement import Specimen
from cpam_bayes.measurement.records import angle_grid
from cpam_bayes.model import angle_parameters, reference_vector
from cpam_bayes.parallel import run
from cpam_bayes.reduced import DEFAULT_SETTINGS as REDUCTION
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Share of the probability that a credible set holds.
CREDIBLE = 0.95
# Modes looked at beyond the list where it may lack some.
_SPARE_MODES = 4
# Pieces that the prefixes are shared out in.
_PIECES = 64
# A floor this far below the best to begin with, and deeper by this much while too much is left out.
_FLOOR, _DEEPER = 14.0, 5.0
# Prefixes that tell beforehand how much a floor leaves out.
_SCOUTS = 128


@dataclass(frozen=True, slots=True)
class SequenceSettings:
    """How the sequences are gone through.

    exhaustive : up to so many classes of sequences each evidence is computed. learning : of the surface.
    halvings : of the table's cells. unaccounted : probability that may be left out. listed : most
    probable sequences whose evidence is computed exactly. draws : sequences drawn to check and correct
    the surface. polished : 95 % sets up to so many classes are computed exactly as a whole. log2_points :
    of the importance sampling of these.
    """

    exhaustive: int = 1500
    learning: LearningSettings = field(default_factory=LearningSettings)
    halvings: int = 2
    unaccounted: float = 1e-3
    listed: int = 100
    draws: int = 200
    polished: int = 400
    log2_points: int = 9


DEFAULT_SETTINGS = SequenceSettings()


@dataclass(frozen=True, slots=True)
class SurfaceCheck:
    """How good the learned evidence is where the mass is.

    learned_from : sequences. rms, largest : error on draws from the posterior, nats. correction : log of the
    factor on the sum of all evidences that the draws found. effective : share of the draws that count.
    """

    learned_from: int
    rms: float
    largest: float
    correction: float
    effective: float


@dataclass(frozen=True, slots=True)
class SequenceAnswer:
    """The posterior over the sequences of one specimen.

    enumerated : sequences on the grid. classes : distinct ones, symmetric images merged, ``None`` where they
    were not counted. log_evidence_total : log of their mean evidence. top : the most
    probable classes, each by its first member, (t, k) degrees, in descending order; multiplicity : (t,)
    sequences in each; probability : (t,) of each single sequence; log_evidence, log_evidence_error : (t,).
    marginals : (k, n_grid) probability of every angle, ply by ply. credible_count : sequences in the smallest
    set that holds 95 %. effective_count : exp of the entropy. unaccounted : bound of what is left out.
    drawn : sequences drawn from the posterior with their conditional posteriors; draw_weight : (d,) what each
    counts. components : those of ``top``. check : ``None`` where every evidence was computed.
    """

    specimen: Specimen
    own: SequencePosterior
    symmetries: tuple[Symmetry, ...]
    grid_deg: Array
    enumerated: int
    classes: int | None
    log_evidence_total: float
    top: Array
    multiplicity: Array
    probability: Array
    log_evidence: Array
    log_evidence_error: Array
    components: Evaluated
    marginals: Array
    credible_count: int
    effective_count: float
    unaccounted: float
    drawn: Evaluated
    draw_weight: Array
    check: SurfaceCheck | None
    seconds: float


@single_blas_thread
def sequence_probabilities(
    specimen: Specimen,
    seed: int,
    *,
    settings: SequenceSettings = DEFAULT_SETTINGS,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> SequenceAnswer:
    """The probability of every sequence on the grid of a specimen's unknown angles, all equal beforehand.

    ``progress`` is told how many of how many pieces of the enumeration are done. The answer does not
    depend on the executor. Raises ``ValueError`` if the specimen has no unknown angle, no measured
    frequencies or no unknown constants, or an unsymmetric layup with too many unknown angles to try each.
    """
    start = time.perf_counter()
    measurement, unknowns = required(specimen)
    layup = specimen.plate.layup
    if not layup.n_unknown:
        raise ValueError(f'{specimen.source}: layup {layup.text} has no unknown angle; write "?" for one')
    grid = angle_grid(specimen.angle_grid_deg)
    few = len(grid) ** layup.n_unknown <= 2 * settings.exhaustive
    sums = None if few else ply_sums(layup, grid)
    n_modes = measurement.size + (0 if measurement.complete else _SPARE_MODES)
    parameters = angle_parameters(specimen).union(unknowns)
    model = reduced_model(specimen, parameters, n_modes, notify=notify)
    error = np.asarray(np.hypot(model.full.error, REDUCTION.tolerance))
    own = sequence_posterior(model, layup.n_unknown, measurement, error)
    task = _Task(specimen, own, plate_symmetries(specimen), grid, _starts(specimen, own), settings, executor)
    rng = np.random.default_rng([seed, 4])
    answer = _exhaustive(task, rng, notify) if sums is None else _learned(task, sums, rng, notify, progress)
    return replace(answer, seconds=time.perf_counter() - start)


@dataclass(frozen=True, slots=True)
class _Task:
    specimen: Specimen
    own: SequencePosterior
    symmetries: tuple[Symmetry, ...]
    grid_deg: Array
    starts: Array
    settings: SequenceSettings
    executor: Executor | None

    @property
    def n_unknown(self) -> int:
        return self.own.n_angles

    @property
    def n_sequences(self) -> int:
        return int(len(self.grid_deg) ** self.n_unknown)


def _starts(specimen: Specimen, own: SequencePosterior) -> Array:
    """Two starts of every climb: the reference constants with little noise, the middle with much."""
    p = own.parameters
    n = own.template.model.parameters.size
    starts = np.empty((2, p.size))
    starts[0, :n] = reference_vector(specimen, own.template.model.parameters)
    starts[1, :n] = 0.5 * (p.lower[:n] + p.upper[:n])
    if own.template.noise_is_inferred:
        prior = p.parameters[-1].prior
        starts[0, -1], starts[1, -1] = (
            np.clip(share * prior.upper, prior.lower, prior.upper) for share in (0.05, 0.3)
        )
    inside = np.isfinite(own.template.log_prior(starts))
    if not inside.any():
        raise ValueError(
            f"{specimen.source}: neither the reference constants nor the middle of [unknowns] meet the "
            "constraints (9); move the bounds"
        )
    return starts[inside][[0, -1]]


def _exhaustive(task: _Task, rng: np.random.Generator, notify: Callable[[str], None]) -> SequenceAnswer:
    """Every evidence computed."""
    g, k = len(task.grid_deg), task.n_unknown
    every = np.stack(np.unravel_index(np.arange(g**k), (g,) * k), axis=1)
    orbits = canonical(every, task.symmetries)
    code = orbits.representative @ (g ** np.arange(k - 1, -1, -1))
    _, first, label = np.unique(code, return_index=True, return_inverse=True)
    representative, size = orbits.representative[first], orbits.size[first]
    notify(f"evidence of {len(first)} sequences")
    data = _evaluate(task, representative, task.starts)
    total = float(np.log(np.sum(size * np.exp(data.log_evidence - data.log_evidence.max()))))
    total += float(data.log_evidence.max())
    single = np.exp(data.log_evidence - total)
    p = single[label.ravel()]
    marginals = np.stack([np.bincount(every[:, j], p, minlength=g) for j in range(k)])
    order = np.argsort(-single, kind="stable")
    held = np.cumsum(np.repeat(single[order], size[order]))
    drawn = rng.choice(len(first), size=task.settings.draws, p=single * size / np.sum(single * size))
    top = order[: task.settings.listed]
    positive = single > 0
    return SequenceAnswer(
        specimen=task.specimen,
        own=task.own,
        symmetries=task.symmetries,
        grid_deg=task.grid_deg,
        enumerated=g**k,
        classes=len(first),
        log_evidence_total=total - float(np.log(g**k)),
        top=task.grid_deg[representative[top]],
        multiplicity=size[top],
        probability=single[top],
        log_evidence=data.log_evidence[top],
        log_evidence_error=data.conditionals.error[top],
        components=data[top],
        marginals=marginals,
        credible_count=int(np.searchsorted(held, CREDIBLE) + 1),
        effective_count=float(np.exp(-np.sum(size * single * np.log(np.where(positive, single, 1.0))))),
        unaccounted=0.0,
        drawn=_moved(task, data[drawn], rng),
        draw_weight=np.full(len(drawn), 1.0 / len(drawn)),
        check=None,
        seconds=0.0,
    )


def _evaluate(task: _Task, sequences: Array, starts: Array) -> Evaluated:
    return evaluate(task.own, task.grid_deg, sequences, starts, task.settings.log2_points, task.executor)


def _moved(task: _Task, data: Evaluated, rng: np.random.Generator) -> Evaluated:
    """Sequences replaced by members of their classes at random: all are equally probable."""
    moved = data.sequences.copy()
    for i, sequence in enumerate(data.sequences):
        every = members(sequence, task.symmetries)
        moved[i] = every[rng.integers(len(every))]
    return replace(data, sequences=moved)


def _learned(
    task: _Task,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> SequenceAnswer:
    """The evidence learned, all sequences gone through, the reported ones computed exactly."""
    settings = task.settings
    surface, data = learn(
        task.own,
        sums,
        task.starts,
        rng,
        settings.learning,
        _negation(task) is not None,
        task.executor,
        notify,
    )
    enumerator = _enumerator(task, sums, surface, rng, notify)
    notify(f"{task.n_sequences} sequences, {len(enumerator.table.centre)} cells")
    whole = _gone_through(enumerator, task.executor, progress)
    listed = _listed(task, sums, surface, enumerator, whole, data)
    drawn, learned_value = _drawn(task, sums, enumerator, whole, data, rng)
    miss = drawn.log_evidence - learned_value
    weight = np.exp(miss - miss.max())
    correction = float(np.log(weight.mean()) + miss.max())
    g, k = len(task.grid_deg), task.n_unknown
    exact, learned_listed, size = listed
    reference = enumerator.reference
    sums_over_all = _with_exact(task, enumerator, whole, exact, learned_listed, size, correction)
    total_weight = float(sums_over_all.weight.sum())
    total = float(np.log(total_weight)) + reference
    left_out = whole.left_out * np.exp(enumerator.table.floor - reference)
    order = np.argsort(-exact.log_evidence, kind="stable")[: settings.listed]
    return SequenceAnswer(
        specimen=task.specimen,
        own=task.own,
        symmetries=task.symmetries,
        grid_deg=task.grid_deg,
        enumerated=task.n_sequences,
        classes=None,
        log_evidence_total=total - k * float(np.log(g)),
        top=task.grid_deg[exact.sequences[order]],
        multiplicity=size[order],
        probability=np.exp(exact.log_evidence[order] - total),
        log_evidence=exact.log_evidence[order],
        log_evidence_error=exact.conditionals.error[order],
        components=exact[order],
        marginals=sums_over_all.marginals,
        credible_count=_credible_count(sums_over_all),
        effective_count=float(np.exp(np.log(total_weight) - sums_over_all.entropy / total_weight)),
        unaccounted=float(left_out / (left_out + total_weight)),
        drawn=drawn,
        draw_weight=weight / weight.sum(),
        check=SurfaceCheck(
            learned_from=len(data.sequences),
            rms=float(np.sqrt(np.mean(miss**2))),
            largest=float(np.abs(miss).max()),
            correction=correction,
            effective=float(weight.sum() ** 2 / np.sum(weight**2) / len(weight)),
        ),
        seconds=0.0,
    )


@dataclass(frozen=True, slots=True)
class _Sums:
    """Sums over all sequences, the listed ones by their exact evidence, weights as in ``Piece``.

    count, weight : (BINS,). entropy : sum of weight * (log evidence - reference). marginals : (k, n_grid),
    normalised.
    """

    count: Array
    weight: Array
    entropy: float
    marginals: Array


def _with_exact(
    task: _Task,
    own: Enumerator,
    whole: Piece,
    exact: Evaluated,
    learned: Array,
    size: Array,
    correction: float,
) -> _Sums:
    """The learned sums, as the draws correct them, with the listed sequences' own evidences put in."""
    factor = np.exp(correction)
    before, after = learned - own.reference, exact.log_evidence - own.reference
    old, new = factor * np.exp(before), np.exp(after)
    count, weight = whole.count.astype(float), factor * whole.weight
    for values, sign, weights in ((before, -1.0, old), (after, 1.0, new)):
        bins = bin_of(values)
        count += sign * np.bincount(bins, size, minlength=BINS)
        weight += sign * np.bincount(bins, size * weights, minlength=BINS)
    count, weight = np.maximum(count, 0.0), np.maximum(weight, 0.0)
    entropy = factor * (whole.entropy + correction * whole.mass.sum())
    entropy += float(np.sum(size * (new * after - old * (before + correction))))
    marginals = factor * whole.mass.sum() * _marginals(own, whole)
    ply = np.arange(task.n_unknown)
    for sequence, change in zip(exact.sequences, new - old, strict=True):
        for image in members(sequence, task.symmetries):
            marginals[ply, image] += change
    marginals = np.maximum(marginals, 0.0)
    return _Sums(count, weight, entropy, marginals / marginals.sum(axis=1, keepdims=True))


def _credible_count(sums: _Sums) -> int:
    """Sequences in the smallest set with 95 %, the last bin in proportion."""
    mass = np.cumsum(sums.weight)
    at = int(np.searchsorted(mass, CREDIBLE * mass[-1]))
    before = (float(sums.count[:at].sum()), float(mass[at - 1]) if at else 0.0)
    share = (CREDIBLE * mass[-1] - before[1]) / max(float(sums.weight[at]), 1e-300)
    return int(np.ceil(before[0] + share * sums.count[at] - 1e-9))


def _negation(task: _Task) -> Array | None:
    """Grid index of minus every angle if all sequences have an equally probable mirror image."""
    for s in task.symmetries:
        if s.name == "mirror image" and s.everywhere and np.array_equal(s.source, np.arange(task.n_unknown)):
            return np.asarray(s.permutation)
    return None


def _enumerator(
    task: _Task, sums: PlySums, surface: Surface, rng: np.random.Generator, notify: Callable[[str], None]
) -> Enumerator:
    """A table whose floor is so low that what it leaves out does not count."""
    settings = task.settings
    slack = float(np.clip(surface.largest_error, 0.2, 3.0))
    depth = _FLOOR
    while True:
        floor = surface.top - depth
        table = build_table(surface.expansion, sums.rest_reach, floor, settings.halvings, slack)
        found = Enumerator(
            table, sums, surface.top, _negation(task), 4 * max(settings.listed, settings.polished)
        )
        visited = prefixes_to_visit(found)
        scouts = np.sort(rng.choice(visited, size=min(_SCOUTS, len(visited)), replace=False))
        piece = enumerate_prefixes(found, scouts)
        total = piece.mass.sum() * len(visited) / len(scouts)
        left_out = piece.left_out * len(visited) / len(scouts) * np.exp(floor - surface.top)
        if left_out <= 0.5 * settings.unaccounted * total or depth > 35.0:
            return found
        short = np.log(max(left_out, 1e-300) / max(0.5 * settings.unaccounted * total, 1e-300))
        depth += min(max(float(short), 1.0), _DEEPER)
        notify(f"the table reaches {depth:.0f} nats below the best")


def _gone_through(own: Enumerator, executor: Executor | None, progress: Callable[[int, int], None]) -> Piece:
    """The sums over all sequences."""
    items = [p for p in np.array_split(prefixes_to_visit(own), _PIECES) if len(p)]
    done = [0]

    def count(index: int, piece: Piece) -> None:
        del index, piece
        done[0] += 1
        progress(done[0], len(items))

    pieces = run(enumerate_prefixes, own, items, executor, batch_size=1, on_result=count)
    best = [p.best for p in pieces if len(p.best)]
    return Piece(
        prefixes=np.concatenate([p.prefixes for p in pieces]),
        mass=np.concatenate([p.mass for p in pieces]),
        inner=np.sum([p.inner for p in pieces], axis=0),
        count=np.sum([p.count for p in pieces], axis=0),
        weight=np.sum([p.weight for p in pieces], axis=0),
        kept=sum(p.kept for p in pieces),
        left_out=sum(p.left_out for p in pieces),
        best=np.concatenate(best),
        log_evidence=np.concatenate([p.log_evidence for p in pieces if len(p.best)]),
        squares=sum(p.squares for p in pieces),
        entropy=sum(p.entropy for p in pieces),
    )


def _listed(
    task: _Task, sums: PlySums, surface: Surface, own: Enumerator, whole: Piece, data: Evaluated
) -> tuple[Evaluated, Array, Array]:
    """The most probable classes, computed exactly, their learned evidence and their sizes.

    All classes of the 95 % set if they are few, else the first of the list.
    """
    settings = task.settings
    order = np.argsort(-whole.log_evidence, kind="stable")
    orbits = canonical(whole.best[order], task.symmetries)
    _, first = np.unique(orbits.representative, axis=0, return_index=True)
    first = np.sort(first)  # in descending order of evidence
    value, size = whole.log_evidence[order][first], orbits.size[first]
    held = np.cumsum(size * np.exp(value - own.reference)) / whole.mass.sum()
    # a little more than the set: its exact order is not known yet
    needed = int(np.searchsorted(held, 0.5 * (1.0 + CREDIBLE))) + 1
    number = needed if needed <= settings.polished else settings.listed
    chosen = first[: max(number, settings.listed)]
    sequences = orbits.representative[chosen]
    exact = _evaluate(task, sequences, starts_near(sums, data, sequences, task.starts))
    return exact, whole.log_evidence[order][chosen], orbits.size[chosen]


def _drawn(
    task: _Task, sums: PlySums, own: Enumerator, whole: Piece, data: Evaluated, rng: np.random.Generator
) -> tuple[Evaluated, Array]:
    """Sequences drawn from the posterior as the table has it, computed exactly, and the table's values."""
    prefix = rng.choice(len(whole.mass), size=task.settings.draws, p=whole.mass / whole.mass.sum())
    sequences = np.empty((len(prefix), task.n_unknown), dtype=np.int64)
    value = np.empty(len(prefix))
    mirrored = rng.uniform(size=len(prefix)) < 0.5
    for p in np.unique(prefix):
        rows = np.flatnonzero(prefix == p)
        some, log_evidence = values_of_prefix(own, int(whole.prefixes[p]))
        weight = np.exp(log_evidence - log_evidence.max())
        pick = rng.choice(len(some), size=len(rows), p=weight / weight.sum())
        sequences[rows], value[rows] = some[pick], log_evidence[pick]
    if own.negation is not None:
        sequences[mirrored] = own.negation[sequences[mirrored]]
    return _evaluate(task, sequences, starts_near(sums, data, sequences, task.starts)), value


def _marginals(own: Enumerator, whole: Piece) -> Array:
    """Probability of every angle, ply by ply, (k, n_grid)."""
    g, n_inner = len(own.sums.grid_deg), own.n_inner
    n_outer = own.sums.n_unknown - n_inner
    place = g ** np.arange(n_outer - 1, -1, -1, dtype=np.int64)
    outer = [np.bincount(whole.prefixes // p % g, whole.mass, minlength=g) for p in place]
    found = np.concatenate((np.reshape(outer, (n_outer, g)), whole.inner)) / whole.mass.sum()
    if own.negation is not None:
        found = 0.5 * (found + found[:, own.negation])
    return np.asarray(found)
