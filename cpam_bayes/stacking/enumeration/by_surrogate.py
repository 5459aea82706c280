"""The posterior over many stacking sequences: a surrogate trained, evidences computed, the result checked.

The surrogate of the log evidence says which sequences can matter. These are listed and fitted one by one,
from optima nearby, and the evidence of those that carry the mass is sampled. The rest is summed by the
surrogate. The evidence of draws from the result is refined: it says how far the evidence of each part is off
and corrects the sums of the parts that were not sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.deadline import TimeIsUpError, cut_short
from cpam_bayes.parallel import counted, run
from cpam_bayes.stacking.conditional.evaluation import Evaluated, merged, with_optima
from cpam_bayes.stacking.enumeration.best_first import (
    BIN,
    BINS_BEGIN,
    INNER,
    Enumeration,
    PartialSums,
    combined,
    enumerate_prefixes,
    prefixes_to_visit,
)
from cpam_bayes.stacking.enumeration.listing import ListedClasses, evaluate_listed, surrogate_values
from cpam_bayes.stacking.enumeration.parts import DrawnPart, combined_posterior, draw_parts
from cpam_bayes.stacking.features import PlySums, all_sequences
from cpam_bayes.stacking.records import OVERLOOKED, StackingPosterior, StackingProblem
from cpam_bayes.stacking.surrogate.piecewise_linear import piecewise_linear_surrogate
from cpam_bayes.stacking.surrogate.training import (
    TrainedSurrogate,
    TrainingProblem,
    retrain,
    train,
    train_further,
)
from cpam_bayes.stacking.symmetry.classes import canonical, classes
from cpam_bayes.stacking.symmetry.symmetries import Symmetry

Array = NDArray[Any]

# Pieces that the prefixes are enumerated in.
_PIECES = 64
# Depth of the lower bound below the best to begin with, the most that it grows by while too much is left out,
# and the depth from which on it grows no more, nats.
_DEPTH, _DEEPER, _MAX_DEPTH = 17.0, 5.0, 35.0
# Prefixes of the pilot enumeration, which predicts what a lower bound leaves out and how long a list gets.
_PILOT_PREFIXES = 512
# Fraction of the mass that may be known from the surrogate alone where the list can be long enough.
_MAX_UNLISTED = 3e-3
# Fraction of the mass known from the surrogate alone from which on the surrogate is trained to a finer error.
_FINE_FROM = 0.05
# Rounds of training, listing and checking.
_ROUNDS = 2
# Root mean square error on the draws that ends them: nats, or so many times that at the end of the training.
_SETTLED_NATS, _SETTLED_ERRORS = 0.2, 1.5
# Root mean square error on the draws, nats, from which on there are more rounds, and so many at most.
_ASTRAY_NATS, _MAX_ROUNDS = 0.5, 4
# Listed sequences that join the training set in a further round.
_ADDED_FROM_LIST = 400
# Fraction of what may be left out that the lower bound is chosen for: a pilot enumeration is rough.
_MARGIN = 0.5
# Relative noise from which on sequences drawn evenly lead to the posterior.
_EASY_NOISE = 1.5e-3
# Where there is less, training begins with the best sequences at so many times the noise: their number, and
# the root mean square error of the surrogate that they are found by, nats.
_NOISE_FACTOR, _SEEDS, _SEEDS_RMS = 3.0, 600, 1.0
# Number of sequences above which a short list is tried first: sequences fitted, most probable, and drawn.
_MANY, _TRIAL_FITTED, _TRIAL_LISTED, _TRIAL_DRAWS = 10_000_000, 500, 50, 150
# Number of sequences up to which the surrogate is evaluated for each.
_MAX_EVALUATED = 3_000_000


def by_surrogate(
    problem: StackingProblem,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> StackingPosterior:
    """The posterior by a surrogate: all sequences enumerated, those that can matter computed."""
    posterior: StackingPosterior | None = None
    try:
        for posterior in _rounds(problem, sums, rng, notify, progress):  # noqa: B007
            pass
    except TimeIsUpError:
        if posterior is None:
            raise
        cut_short("the probabilities of sequences are those of a round before the last")
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
    rounds, fine, margin = 0, False, _MARGIN
    current = _trial(problem) if problem.n_sequences > _MANY else problem
    pilot: PilotEnumeration | None = None
    while True:
        if pilot is None:
            pilot = _pilot(problem, sums, trained, rng, notify, margin)
        if current is problem and not fine and pilot.unlisted(problem) > _FINE_FROM:
            notify("too many sequences count to be fitted one by one: training the surrogate further")
            fine, pilot = True, None
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
        astray = check.rms > _ASTRAY_NATS or check.overlooked > OVERLOOKED
        close = check.rms <= max(_SETTLED_NATS, _SETTLED_ERRORS * trained.surrogate.rms_error)
        settled = close and not astray
        excess = posterior.unaccounted / problem.settings.unaccounted
        last = rounds >= (_MAX_ROUNDS if astray or excess > 1.0 else _ROUNDS)
        yield posterior
        if current is problem and (last or (settled and excess <= 1.0)):
            return
        if excess > 1.0:
            margin, pilot = 0.5 * margin / excess, None
        if not settled:
            notify(f"off by {check.rms:.2f} nats on draws: these join the training set")
            trained, pilot = retrain(trained, training, _further_training_set(parts, listed, rng), rng), None
        if rounds >= _ROUNDS or not astray:
            current = problem


def noisier_seeds(
    problem: StackingProblem, sums: PlySums, rng: np.random.Generator, notify: Callable[[str], None]
) -> Array | None:
    """The best sequences (m, k) for the same frequencies with more noise; ``None`` where noise is not small.

    No sequence drawn evenly is next to the posterior of a list with very little noise.
    """
    noisier = _with_more_noise(problem)
    if noisier is None:
        return None
    trained = train(training_problem(noisier, sums), rng, notify, noisier_seeds(noisier, sums, rng, notify))
    few = replace(noisier, settings=replace(noisier.settings, max_fitted=_SEEDS))
    enumeration = _pilot(noisier, sums, trained, rng, notify).listing(few)
    totals = _enumerated(enumeration, problem.executor)
    best = np.argsort(-totals.log_evidence, kind="stable")[:_SEEDS]
    return np.asarray(canonical(totals.listed[best].astype(np.int64), problem.symmetries).representative)


def _with_more_noise(problem: StackingProblem) -> StackingProblem | None:
    """The problem with more noise, where the list states so little that evenly drawn sequences do not do."""
    conditional = problem.conditional
    middle = 0.5 * (conditional.parameters.lower + conditional.parameters.upper)
    model = conditional.template.noise_model
    if not isinstance(model.amplitude, float):  # inferred
        return None
    if conditional.least_noise(middle[None]) >= _EASY_NOISE:
        return None
    noise = replace(
        model, amplitude=_NOISE_FACTOR * model.amplitude, rounding=_NOISE_FACTOR**2 * model.rounding
    )
    training = replace(problem.settings.training, rms=_SEEDS_RMS)
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
        max_fitted=min(_TRIAL_FITTED, settings.max_fitted),
        listed=min(_TRIAL_LISTED, settings.listed),
        draws=min(_TRIAL_DRAWS, settings.draws),
    )
    return replace(problem, settings=few)


@dataclass(frozen=True, slots=True)
class PilotEnumeration:
    """All sequences with the surrogate's log evidence, and the sums over some, which predict a list's length.

    sums : over a ``fraction`` of the sequences.
    """

    enumeration: Enumeration
    sums: PartialSums
    fraction: float

    def listing(self, problem: StackingProblem) -> Enumeration:
        """The enumeration with the threshold of what a problem's settings list."""
        threshold = self.enumeration.reference + BINS_BEGIN - BIN * self._listed_bins(problem)
        return replace(self.enumeration, threshold=threshold)

    def unlisted(self, problem: StackingProblem) -> float:
        """Fraction of the mass, by the surrogate, of sequences that a problem's settings do not list."""
        n = self._listed_bins(problem)
        return float(self.sums.weight[n:].sum() / self.sums.weight.sum())

    def _listed_bins(self, problem: StackingProblem) -> int:
        """Number of bins of the log evidence that are listed: nearly all the mass, not too many sequences."""
        rest = 1.0 - np.cumsum(self.sums.weight) / self.sums.weight.sum()
        images = 1 if self.enumeration.negation is None else 2
        number = np.cumsum(self.sums.count) / self.fraction / images
        enough = int(np.argmax(rest <= _MAX_UNLISTED))
        return min(enough + 1, int(np.searchsorted(number, problem.settings.max_fitted, side="right")))


def training_problem(problem: StackingProblem, sums: PlySums) -> TrainingProblem:
    """The training of the surrogate of a problem."""
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


def _further_training_set(
    parts: tuple[DrawnPart | None, ...], listed: ListedClasses, rng: np.random.Generator
) -> Evaluated:
    """What joins the training set when the surrogate proves wrong: draws from it, and some of the best."""
    some = rng.permutation(len(listed.evaluated.sequences))[:_ADDED_FROM_LIST]
    data = listed.evaluated[np.sort(some)]
    for part in parts[1:]:
        if part is not None:
            data = merged(data, with_optima(part.data, data.fits.weight.shape[1]))
    _, first = np.unique(data.sequences, axis=0, return_index=True)
    return data[np.sort(first)]


def _acts_on_angles(problem: StackingProblem, symmetry: Symmetry) -> bool:
    """Whether a symmetry changes every angle in the same way and leaves the plies in their places."""
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
    margin: float = _MARGIN,
) -> PilotEnumeration:
    """The surrogate's log evidence of each sequence.

    Up to a few million sequences it is evaluated for all. For more it is piecewise linear, with a lower bound
    so low that what it leaves out does not count: at most the fraction ``margin`` of what may be left out.
    """
    settings, surrogate = problem.settings, trained.surrogate
    negation, executor = _negation(problem), problem.executor
    if problem.n_sequences <= _MAX_EVALUATED:
        every = _every_value(problem, sums, trained)
        enumeration = Enumeration(None, sums, surrogate.top, negation, np.inf, every)
        return PilotEnumeration(enumeration, _enumerated(enumeration, executor), 1.0)
    slack = float(np.clip(surrogate.largest_error, 0.2, 3.0))
    depth = _DEPTH
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
        enumeration = Enumeration(table, sums, surrogate.top, negation, np.inf)
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


def _every_value(problem: StackingProblem, sums: PlySums, trained: TrainedSurrogate) -> Array:
    """The surrogate's log evidence of every sequence, (choices of the first plies, choices of the others)."""
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
    """The sums over all sequences, or over those of some prefixes, and the list of the best."""
    visited = prefixes_to_visit(enumeration) if prefixes is None else prefixes
    items = [part for part in np.array_split(visited, _PIECES) if len(part)]
    count = counted(progress, len(items))
    return combined(
        run(enumerate_prefixes, enumeration, items, executor, batch_size=1, on_result=count, is_limited=True)
    )
