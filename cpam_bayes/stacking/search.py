"""Computation of the posterior over stacking sequences: exhaustive, or by a surrogate in rounds.

Few sequences are all evaluated. Most are given up on a small basis as soon as they promise to stay far below
the best; the others are screened, and those near the best computed on a basis made for them, from their
optimum and from those of their neighbours, as the first optimisation may have found the lesser of two optima.

With many, the surrogate of the log evidence shows which can matter. These are listed and evaluated, the rest
is summed (`stacking.listing`). The evidence of draws from the result is refined: it measures the error of
each part's evidence and corrects the sums of the unsampled parts. Sequences with large errors join the
training set, and another round begins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parallel import counted, run
from cpam_bayes.running import TimeIsUpError, cut_short
from cpam_bayes.stacking.conditional import ConditionalPosterior
from cpam_bayes.stacking.evaluation import (
    NEAR,
    Evaluated,
    about,
    angle_functions,
    evaluate,
    in_sight,
    merged,
    neighbours,
    roughly,
    with_optima,
)
from cpam_bayes.stacking.listing import (
    BIN,
    BINS_BEGIN,
    INNER,
    DrawnPart,
    Enumeration,
    ListedClasses,
    PartialSums,
    basis_error_at,
    combined,
    combined_posterior,
    draw_parts,
    enumerate_prefixes,
    evaluate_listed,
    prefixes_to_visit,
    surrogate_values,
)
from cpam_bayes.stacking.records import CREDIBLE, OVERLOOKED, StackingPosterior, StackingProblem
from cpam_bayes.stacking.surrogate import Surrogate, piecewise_linear_surrogate
from cpam_bayes.stacking.symmetry import PlySums, Symmetry, all_sequences, canonical, classes, members
from cpam_bayes.stacking.training import TrainedSurrogate, TrainingProblem, retrain, train, train_further

Array = NDArray[Any]

# log2 of the points of importance sampling in the screening.
_SCREENING_POINTS = 5
# Pieces in which the prefixes are enumerated.
_PIECES = 64
# Depth of the lower bound below the best, nats: initially at least and at most, largest growth while too much
# is left out, and the depth from which it grows no more.
_LEAST_DEPTH, _DEPTH, _DEEPER, _MAX_DEPTH = 6, 17, 5.0, 35.0
# Evenly drawn sequences from which this depth is estimated.
_EVENLY_DRAWN = 8000
# Prefixes of the pilot enumeration, which predicts what a lower bound leaves out and how long a list gets.
_PILOT_PREFIXES = 512
# Number of sequences up to which the surrogate is evaluated for each, and up to which its piecewise-linear
# form is; of more, a sample stands for all.
_MAX_EVALUATED, _MAX_SUMMED = 3_000_000, 100_000_000
# Multiple of the most fitted sequences above which those of the first bins count as indistinguishable; from
# the pilot's few prefixes their number may seem tens of times too large.
_ALIKE = 50


def exhaustive(
    problem: StackingProblem, rng: np.random.Generator, notify: Callable[[str], None]
) -> StackingPosterior:
    """Posterior with the computed evidence of every sequence in sight of the best."""
    g, k = len(problem.grid_deg), problem.n_unknown
    distinct = classes(all_sequences(g, k), problem.symmetries)
    n = len(distinct.size)
    notify(f"{n} sequences are looked at")
    data, focused = _evaluated(problem, distinct.representative, rng)
    size = canonical(data.sequences, problem.symmetries).size
    best = float(data.log_evidence.max())
    total = float(np.log(np.sum(size * np.exp(data.log_evidence - best)))) + best
    single = np.exp(data.log_evidence - total)
    order = np.argsort(-data.log_evidence, kind="stable")
    cumulative = np.cumsum(np.repeat(single[order], size[order]))
    drawn = rng.choice(len(size), size=problem.settings.draws, p=single * size / np.sum(single * size))
    top = order[: problem.settings.listed]
    none = distinct.representative[:0]
    every = np.concatenate([members(sequence, problem.symmetries) for sequence in data.sequences])
    p = np.repeat(single, size)
    return StackingPosterior(
        specimen=problem.specimen,
        conditional=problem.conditional,
        symmetries=problem.symmetries,
        grid_deg=problem.grid_deg,
        enumerated=g**k,
        classes=n,
        log_evidence_total=total - float(np.log(g**k)),
        top=problem.grid_deg[data.sequences[top]],
        same_bending=(none,) * len(top),
        alike=(none,) * len(top),
        multiplicity=size[top],
        probability=single[top],
        log_evidence=data.log_evidence[top],
        log_evidence_error=data.conditionals.error[top],
        components=data[top],
        marginals=np.stack([np.bincount(every[:, j], p, minlength=g) for j in range(k)]),
        credible_count=int(np.searchsorted(cumulative, CREDIBLE) + 1),
        effective_count=float(np.exp(-np.sum(size * single * np.log(single)))),
        unaccounted=float((g**k - size.sum()) * np.exp(best - NEAR - total)),
        drawn=problem.random_members(data[drawn], rng),
        draw_weight=np.full(len(drawn), 1.0 / len(drawn)),
        check=None,
        basis_error=basis_error_at(focused, problem.grid_deg, data, drawn),
        seconds=0.0,
    )


def _evaluated(
    problem: StackingProblem, sequences: Array, rng: np.random.Generator
) -> tuple[Evaluated, ConditionalPosterior]:
    """Evidence of those of the sequences (m, k) that are in sight of the best, and the basis it is on."""
    settings, grid, executor = problem.settings, problem.grid_deg, problem.executor
    rows, optima = in_sight(
        problem.conditional, grid, sequences, problem.starts, problem.library, rng, executor
    )
    sequences = sequences[rows]
    rough = roughly(problem.conditional, rng)
    screened = evaluate(
        rough, grid, sequences, _starts_near(grid, sequences, optima), _SCREENING_POINTS, executor
    )
    screened = screened[screened.log_evidence > screened.log_evidence.max() - NEAR]
    starts = _starts_near(grid, screened.sequences, screened.fits.x)
    focused = about(problem.conditional, grid, screened, rng)
    refined = evaluate(focused, grid, screened.sequences, starts, settings.log2_points, executor)
    return refined, focused


def _starts_near(grid_deg: Array, sequences: Array, optima: Array) -> Array:
    """Two starts (m, 2, n) of sequences (m, k): their optima (m, n) and a different one of a neighbour."""
    features = angle_functions(grid_deg[sequences])
    n = features.shape[1]
    return neighbours(features, optima, np.ones(n), np.ones((1, n))).starts(features, optima)


def by_surrogate(
    problem: StackingProblem,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> StackingPosterior:
    """Posterior by a surrogate: all sequences enumerated, those that can matter computed."""
    posterior: StackingPosterior | None = None
    try:
        for posterior in _rounds(problem, sums, rng, notify, progress):  # noqa: B007
            pass
    except TimeIsUpError:
        if posterior is None:
            raise
        cut_short("cut_rounds")
    assert posterior is not None
    return posterior


def _rounds(
    problem: StackingProblem,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> Iterator[StackingPosterior]:
    """The posterior after every round of training, listing and checking, each better than the one before."""
    training = training_problem(problem, sums)
    trained = train(training, rng, notify, noisier_seeds(problem, sums, rng, notify))
    rules = problem.settings.rounds
    rounds, fine, margin = 0, False, rules.margin
    current = _trial(problem) if problem.n_sequences > rules.many else problem
    pilot: PilotEnumeration | None = None
    while True:
        if pilot is None:
            pilot = _pilot(problem, sums, trained, rng, notify, margin)
        if not fine and pilot.unlisted(problem) > rules.fine_from:
            notify("too many sequences count to be fitted one by one: training the surrogate further")
            fine, pilot, current = True, None, problem  # a trial takes as long as the answer
            trained = train_further(trained, training, problem.settings.training.fine_rms, rng, notify)
            continue
        enumeration = pilot.listing(current)
        cells = "" if enumeration.table is None else f", {len(enumeration.table.tangent)} cells"
        notify(f"{current.n_sequences} sequences{cells}")
        totals = _enumerated(enumeration, current.executor, progress)
        notify(f"{len(totals.log_evidence)} sequences are fitted one by one")
        listed = evaluate_listed(current, sums, trained, totals, training.images, notify)
        parts = draw_parts(current, sums, trained, enumeration, totals, listed, rng)
        posterior = combined_posterior(current, trained, enumeration, totals, listed, parts, rng)
        assert posterior.check is not None
        check, rounds = posterior.check, rounds + 1
        astray = check.rms > rules.astray_nats or check.overlooked > OVERLOOKED
        close = check.rms <= max(rules.settled_nats, rules.settled_errors * trained.surrogate.rms_error)
        settled = close and not astray
        excess = posterior.unaccounted / problem.settings.unaccounted
        last = rounds >= (rules.most_rounds if astray or excess > 1.0 else rules.least_rounds)
        yield posterior
        if current is problem and (last or (settled and excess <= 1.0)):
            return
        if excess > 1.0:
            margin, pilot = 0.5 * margin / excess, None
        if not settled:
            notify(f"off by {check.rms:.2f} nats on draws: these join the training set")
            fresh = _joining(parts, listed, rules.added_from_list, rng)
            trained, pilot = retrain(trained, training, fresh, rng), None
        if rounds >= rules.least_rounds or not astray:
            current = problem


def noisier_seeds(
    problem: StackingProblem, sums: PlySums, rng: np.random.Generator, notify: Callable[[str], None]
) -> Array | None:
    """The best sequences (m, k) for the same frequencies with more noise; ``None`` where noise is not small.

    No evenly drawn sequence is near the posterior of a list with very little noise: for lists of C1 with
    0.07 % the training found the true sequence with both random seeds tried, and without these with one.
    """
    noisier = _with_more_noise(problem)
    if noisier is None:
        return None
    trained = train(training_problem(noisier, sums), rng, notify, noisier_seeds(noisier, sums, rng, notify))
    seeds = problem.settings.training.seeds
    few = replace(noisier, settings=replace(noisier.settings, max_fitted=seeds))
    enumeration = _pilot(noisier, sums, trained, rng, notify, problem.settings.rounds.margin).listing(few)
    totals = _enumerated(enumeration, problem.executor)
    best = np.argsort(-totals.log_evidence, kind="stable")[:seeds]
    return np.asarray(canonical(totals.listed[best].astype(np.int64), problem.symmetries).representative)


def _with_more_noise(problem: StackingProblem) -> StackingProblem | None:
    """The problem with more noise, where the list states so little that evenly drawn sequences fail."""
    conditional = problem.conditional
    middle = 0.5 * (conditional.parameters.lower + conditional.parameters.upper)
    model = conditional.template.noise_model
    if not isinstance(model.amplitude, float):  # inferred
        return None
    given = problem.settings.training
    if conditional.least_noise(middle[None]) >= given.easy_noise:
        return None
    noise = replace(
        model,
        amplitude=given.noise_factor * model.amplitude,
        rounding=given.noise_factor**2 * model.rounding,
    )
    training = replace(given, rms=given.seeds_rms)
    return replace(
        problem,
        conditional=replace(conditional, template=replace(conditional.template, noise_model=noise)),
        settings=replace(problem.settings, training=training),
    )


def _trial(problem: StackingProblem) -> StackingProblem:
    """The problem with a short list and few draws."""
    settings = problem.settings
    few = replace(
        settings,
        max_fitted=min(settings.rounds.short, settings.max_fitted),
        listed=min(settings.rounds.trial_listed, settings.listed),
        draws=min(settings.rounds.trial_draws, settings.draws),
    )
    return replace(problem, settings=few)


@dataclass(frozen=True, slots=True)
class PilotEnumeration:
    """The surrogate's log evidence of all sequences, and sums over some, which predict a list's length.

    sums : over a ``fraction`` of the sequences.
    """

    enumeration: Enumeration
    sums: PartialSums
    fraction: float

    def listing(self, problem: StackingProblem) -> Enumeration:
        """The enumeration with the listing threshold for a problem's settings."""
        threshold = self.enumeration.reference + BINS_BEGIN - BIN * self._listed_bins(problem)
        return replace(self.enumeration, threshold=threshold)

    def unlisted(self, problem: StackingProblem) -> float:
        """Fraction of the mass, by the surrogate, that is unlisted with a problem's settings."""
        n = self._listed_bins(problem)
        return float(self.sums.weight[n:].sum() / self.sums.weight.sum())

    def _listed_bins(self, problem: StackingProblem) -> int:
        """Number of bins of the log evidence that are listed: nearly all the mass, not too many sequences.

        Where bins hold many sequences each, as the frequencies tell little, only enough for the first ones.
        Raises ``ValueError`` where these are too many as well.
        """
        settings, rules = problem.settings, problem.settings.rounds
        rest = 1.0 - np.cumsum(self.sums.weight) / self.sums.weight.sum()
        images = 1 if self.enumeration.negation is None else 2
        number = np.cumsum(self.sums.count) / self.fraction / images
        enough = int(np.argmax(rest <= rules.unlisted)) + 1
        most = int(np.searchsorted(number, settings.max_fitted, side="right"))
        if enough > most and (not most or rest[most - 1] > 1.0 - rules.worth_listing):
            most = int(np.searchsorted(number, max(rules.short, 2 * settings.listed), side="right"))
        least = min(enough, int(np.searchsorted(number, settings.listed)) + 1)
        if least > most and number[least - 1] > _ALIKE * settings.max_fitted:
            raise ValueError(
                f"{problem.specimen.source}: the frequencies do not tell stacking sequences apart: about "
                f"{number[least - 1]:.0f} of {problem.n_sequences} are as probable as the best; measure more "
                "frequencies, or leave fewer angles unknown"
            )
        return min(enough, max(most, least))


def training_problem(problem: StackingProblem, sums: PlySums) -> TrainingProblem:
    """Training problem of the surrogate of a problem."""
    return TrainingProblem(
        conditional=problem.conditional,
        sums=sums,
        images=np.array(
            [np.ones(len(sums.function))]
            + [sums.signs(s.name) for s in problem.symmetries if _acts_on_angles(problem, s)]
        ),
        starts=problem.starts,
        library=problem.library,
        settings=problem.settings.training,
        executor=problem.executor,
    )


def _joining(
    parts: tuple[DrawnPart | None, ...], listed: ListedClasses, n_listed: int, rng: np.random.Generator
) -> Evaluated:
    """Additions to the training set where the surrogate is wrong: its draws, and some of the best."""
    some = rng.permutation(len(listed.evaluated.sequences))[:n_listed]
    data = listed.evaluated[np.sort(some)]
    for part in parts[1:]:
        if part is not None:
            data = merged(data, with_optima(part.data, data.fits.weight.shape[1]))
    _, first = np.unique(data.sequences, axis=0, return_index=True)
    return data[np.sort(first)]


def _acts_on_angles(problem: StackingProblem, symmetry: Symmetry) -> bool:
    """Whether a symmetry changes all angles in the same way and leaves the plies in their places."""
    return symmetry.everywhere and np.array_equal(symmetry.source, np.arange(problem.n_unknown))


def _negation(problem: StackingProblem) -> Array | None:
    """Grid index of minus every angle if all sequences have an equally probable mirror image."""
    for symmetry in problem.symmetries:
        if symmetry.name == "mirror image" and _acts_on_angles(problem, symmetry):
            return np.asarray(symmetry.permutation)
    return None


def _pilot(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    margin: float,
) -> PilotEnumeration:
    """The surrogate's log evidence of each sequence.

    Up to a few million sequences it is evaluated for all. For more it is piecewise linear, with a lower bound
    so low that at most the fraction ``margin`` of the allowed mass is left out.
    """
    settings, surrogate = problem.settings, trained.surrogate
    negation, executor = _negation(problem), problem.executor
    if problem.n_sequences <= _MAX_EVALUATED:
        every = _every_value(problem, sums, trained)
        enumeration = Enumeration(None, sums, surrogate.top, negation, np.inf, every)
        return PilotEnumeration(enumeration, _enumerated(enumeration, executor), 1.0)
    slack = float(np.clip(surrogate.largest_error, 0.2, 3.0))
    share = max(1, round(problem.n_sequences / _MAX_SUMMED))
    mixed = rng.permutation(len(problem.grid_deg) ** INNER) if share > 1 else None
    depth = _first_depth(sums, surrogate, margin * settings.unaccounted, executor, rng)
    while True:
        table = piecewise_linear_surrogate(
            surrogate.tangent,
            sums.rest_bound,
            surrogate.top,
            depth,
            settings.halvings,
            slack,
            surrogate.freedom,
            executor,
        )
        enumeration = Enumeration(table, sums, surrogate.top, negation, np.inf, share=share, mixed=mixed)
        visited = prefixes_to_visit(enumeration)
        pilot = np.sort(rng.choice(visited, size=min(_PILOT_PREFIXES, len(visited)), replace=False))
        partial = _enumerated(enumeration, executor, prefixes=pilot)
        left_out = partial.left_out * np.exp(-depth)
        allowed = margin * settings.unaccounted * partial.mass.sum()
        if left_out <= allowed or depth > _MAX_DEPTH:
            return PilotEnumeration(enumeration, partial, len(pilot) / len(visited))
        del table, enumeration  # the next one takes as much memory
        depth += float(np.clip(np.log(left_out / max(allowed, 1e-300)), 1.0, _DEEPER))
        notify(f"the piecewise-linear surrogate reaches {depth:.0f} nats below the best")


def _first_depth(
    sums: PlySums, surrogate: Surrogate, allowed: float, executor: Executor | None, rng: np.random.Generator
) -> float:
    """Depth, nats, below which sequences hold no more than the allowed mass, from evenly drawn ones."""
    drawn = rng.integers(len(sums.grid_deg), size=(_EVENLY_DRAWN, sums.n_unknown))
    below = surrogate.top - surrogate_values(surrogate, executor, sums.features(drawn))
    depth = np.arange(_LEAST_DEPTH, _DEPTH)
    left = np.array([np.mean(below > d) for d in depth]) * np.exp(-depth)
    return float(_LEAST_DEPTH + np.count_nonzero(left > allowed * np.exp(-below).mean()))


def _every_value(problem: StackingProblem, sums: PlySums, trained: TrainedSurrogate) -> Array:
    """The surrogate's log evidence of every sequence, by choices of the first plies and of the others."""
    g, k = len(problem.grid_deg), problem.n_unknown
    distinct = classes(all_sequences(g, k), problem.symmetries)
    features = sums.features(distinct.representative)
    values = surrogate_values(trained.surrogate, problem.executor, features)
    return values[distinct.label].reshape(-1, g ** min(k, INNER))


def _enumerated(
    enumeration: Enumeration,
    executor: Executor | None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    prefixes: Array | None = None,
) -> PartialSums:
    """Sums over all sequences, or over those of some prefixes, and the list of the best."""
    visited = prefixes_to_visit(enumeration) if prefixes is None else prefixes
    items = [part for part in np.array_split(visited, _PIECES) if len(part)]
    count = counted(progress, len(items))
    return combined(
        run(enumerate_prefixes, enumeration, items, executor, batch_size=1, on_result=count, is_limited=True)
    )
