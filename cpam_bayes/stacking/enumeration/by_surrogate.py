"""The posterior over many stacking sequences: learned, then computed where the mass is, then checked.

The learned evidence says which sequences can matter. These are listed and fitted one by one, from optima
nearby, and the evidence of those that carry the mass is sampled. The rest is summed with its learned
evidence. Draws from the result are computed with care: they say how far the evidence of each part is off
and correct the sums of the parts that were not sampled.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parallel import run
from cpam_bayes.stacking.conditional.evaluation import (
    Evaluated,
    merged,
    with_optima,
)
from cpam_bayes.stacking.enumeration.best_first import (
    BIN,
    INNER,
    Enumeration,
    PartialSums,
    combined,
    enumerate_prefixes,
    prefixes_to_visit,
)
from cpam_bayes.stacking.enumeration.listing import ListedClasses, evaluate_listed, surrogate_values
from cpam_bayes.stacking.enumeration.parts import DrawnPart, combined_posterior, draw_parts
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.records import OVERLOOKED, StackingPosterior, StackingProblem
from cpam_bayes.stacking.surrogate.piecewise_linear import piecewise_linear_surrogate
from cpam_bayes.stacking.surrogate.training import (
    TrainedSurrogate,
    TrainingProblem,
    retrain,
    train,
    train_further,
)
from cpam_bayes.stacking.symmetry.classes import canonical
from cpam_bayes.stacking.symmetry.symmetries import Symmetry

Array = NDArray[Any]

# Pieces that the prefixes are shared out in.
_PIECES = 64
# A floor this far below the best to begin with, and deeper by this much while too much is left out.
_FLOOR, _DEEPER, _DEEPEST = 17.0, 5.0, 35.0
# Prefixes that tell beforehand how much a floor leaves out, and how long a list gets.
_PILOT_PREFIXES = 512
# Share of the mass that may be learned alone where the list can be long enough.
_UNLISTED = 3e-3
# Share of the mass that is learned alone from which on the surrogate is learned more finely.
_LEARNED_ALONE = 0.05
# Rounds of learning, listing and checking; root mean square error on the draws, nats, that ends them, or so
# many times the one that the learning ended with; listed sequences that a further round learns from.
_ROUNDS, _SETTLED, _AS_SAID, _ADDED_FROM_LIST = 2, 0.2, 1.5, 400
# Root mean square error on the draws, nats, from which on there are more rounds, and so many at most.
_ASTRAY, _MOST_ROUNDS = 0.5, 4
# Share of what may be left out that the floor is chosen for: what a few prefixes say of it is rough.
_SPARE = 0.5
# Noise, relative, from which on a posterior is found at once; below it its seeds are the best sequences at so
# many times the noise, so many of them, learned to a root mean square error, nats.
_EASY, _NOISIER, _SEEDS, _ROUGHLY = 1.5e-3, 3.0, 600, 1.0
# Of more sequences than this a short list is tried first: sequences fitted, most probable ones, and draws.
_MANY, _TRIAL, _TRIAL_LISTED, _TRIAL_DRAWS = 10_000_000, 500, 50, 150
# Up to so many sequences the surrogate is evaluated for each.
_EVERY = 3_000_000


def by_surrogate(
    problem: StackingProblem,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> StackingPosterior:
    """The evidence learned, all sequences gone through, those that can matter computed."""
    training = training_problem(problem, sums)
    images = training.images
    trained = train(training, rng, notify, noisier_seeds(problem, sums, rng, notify))
    rounds, fine, spare = 0, False, _SPARE
    current = _trial(problem) if problem.n_sequences > _MANY else problem
    pilot: PilotEnumeration | None = None
    while True:
        if pilot is None:
            pilot = _pilot(problem, sums, trained, rng, notify, spare)
        if current is problem and not fine and pilot.unlisted(problem) > _LEARNED_ALONE:
            notify("too many sequences count to be fitted one by one: learning on")
            fine, pilot = True, None
            trained = train_further(trained, training, problem.settings.learning.fine, rng, notify)
            continue
        answer, listed, drawn = _evaluated(
            current, sums, trained, pilot.listing(current), images, rng, notify, progress
        )
        assert answer.check is not None
        check, rounds = answer.check, rounds + 1
        astray = check.rms > _ASTRAY or check.overlooked > OVERLOOKED
        settled = not astray and check.rms <= max(_SETTLED, _AS_SAID * trained.surrogate.rms_error)
        excess = answer.unaccounted / problem.settings.unaccounted
        last = rounds >= (_MOST_ROUNDS if astray or excess > 1.0 else _ROUNDS)
        if current is problem and (last or (settled and excess <= 1.0)):
            return answer
        if excess > 1.0:
            spare, pilot = 0.5 * spare / excess, None
        if not settled:
            notify(f"off by {check.rms:.2f} nats on draws: these are learned from as well")
            trained, pilot = retrain(trained, training, _further_training_set(drawn, listed, rng), rng), None
        if rounds >= _ROUNDS or not astray:
            current = problem


def _evaluated(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    enumerator: Enumeration,
    images: Array,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> tuple[StackingPosterior, ListedClasses, tuple[DrawnPart | None, ...]]:
    """All sequences gone through, those that can matter computed, and draws that check the result."""
    cells = "" if enumerator.table is None else f", {len(enumerator.table.centre)} cells"
    notify(f"{problem.n_sequences} sequences{cells}")
    totals = _enumerated(enumerator, problem.executor, progress)
    notify(f"{len(totals.log_evidence)} sequences are fitted one by one")
    listed = evaluate_listed(problem, sums, trained, totals, images, notify)
    drawn = draw_parts(problem, sums, trained, enumerator, totals, listed, rng)
    return combined_posterior(problem, trained, enumerator, totals, listed, drawn, rng), listed, drawn


def noisier_seeds(
    problem: StackingProblem, sums: PlySums, rng: np.random.Generator, notify: Callable[[str], None]
) -> Array | None:
    """The sequences (m, k) that would be good if the list were noisier; ``None`` where it is noisy enough.

    No sequence drawn evenly is next to the posterior of a list with very little noise.
    """
    wide = _noisier(problem)
    if wide is None:
        return None
    trained = train(training_problem(wide, sums), rng, notify, noisier_seeds(wide, sums, rng, notify))
    few = replace(wide, settings=replace(wide.settings, fitted=_SEEDS))
    listing = _pilot(wide, sums, trained, rng, notify).listing(few)
    totals = _enumerated(listing, problem.executor, lambda done, total: None)
    best = np.argsort(-totals.log_evidence, kind="stable")[:_SEEDS]
    return np.asarray(canonical(totals.listed[best].astype(np.int64), problem.symmetries).representative)


def _noisier(problem: StackingProblem) -> StackingProblem | None:
    """The same with more noise, where the list states so little that its posterior is not found at once."""
    template = problem.conditional.template
    middle = 0.5 * (problem.conditional.parameters.lower + problem.conditional.parameters.upper)
    if template.noise_is_inferred or problem.conditional.relative_noise(middle[None]).min() >= _EASY:
        return None
    own = template.noise_model
    assert isinstance(own.amplitude, float)
    noise = replace(own, amplitude=_NOISIER * own.amplitude, rounding=_NOISIER**2 * own.rounding)
    settings = replace(problem.settings, learning=replace(problem.settings.learning, error=_ROUGHLY))
    return replace(
        problem,
        conditional=replace(problem.conditional, template=replace(template, noise_model=noise)),
        settings=settings,
    )


def _trial(problem: StackingProblem) -> StackingProblem:
    """The same with a short list and few draws."""
    own = problem.settings
    few = replace(
        own,
        fitted=min(_TRIAL, own.fitted),
        listed=min(_TRIAL_LISTED, own.listed),
        draws=min(_TRIAL_DRAWS, own.draws),
    )
    return replace(problem, settings=few)


@dataclass(frozen=True, slots=True)
class PilotEnumeration:
    """All sequences with their learned log evidence, and what some of them say of a list's length.

    piece : the sums over a ``share`` of the sequences.
    """

    enumerator: Enumeration
    piece: PartialSums
    share: float

    def listing(self, problem: StackingProblem) -> Enumeration:
        """The same with what a problem lists."""
        own = self.enumerator
        return replace(own, threshold=own.reference + 5.0 - BIN * self._listed_bins(problem))

    def unlisted(self, problem: StackingProblem) -> float:
        """Share of the mass, as it was learned, of sequences that a problem does not list."""
        n = self._listed_bins(problem)
        return float(self.piece.weight[n:].sum() / self.piece.weight.sum())

    def _listed_bins(self, problem: StackingProblem) -> int:
        """How many bins of the log evidence are listed: nearly all the mass, but not too many sequences."""
        settings = problem.settings
        rest = 1.0 - np.cumsum(self.piece.weight) / self.piece.weight.sum()
        number = np.cumsum(self.piece.count) / self.share / (1 if self.enumerator.negation is None else 2)
        enough = int(np.argmax(rest <= _UNLISTED))
        return min(enough + 1, int(np.searchsorted(number, settings.fitted, side="right")))


def training_problem(problem: StackingProblem, sums: PlySums) -> TrainingProblem:
    """What is to be learned of a problem."""
    images = _images(problem, sums)
    return TrainingProblem(
        problem.conditional,
        sums,
        images,
        problem.starts,
        problem.library,
        problem.settings.learning,
        problem.executor,
    )


def _further_training_set(
    drawn: tuple[DrawnPart | None, ...], listed: ListedClasses, rng: np.random.Generator
) -> Evaluated:
    """What is learned from when the learned evidence proves wrong: where it is, and some of the best."""
    some = rng.permutation(len(listed.exact.sequences))[:_ADDED_FROM_LIST]
    found = listed.exact[np.sort(some)]
    for part in drawn[1:]:
        if part is not None:
            found = merged(found, with_optima(part.data, found.fits.weight.shape[1]))
    _, first = np.unique(found.sequences, axis=0, return_index=True)
    return found[np.sort(first)]


def _images(problem: StackingProblem, sums: PlySums) -> Array:
    """Changes of sign of the features that change no frequency, the identity first, (n_images, d)."""
    found = [np.ones(len(sums.function))]
    found += [sums.signs(s.name) for s in problem.symmetries if _of_angles(problem, s)]
    return np.array(found)


def _of_angles(problem: StackingProblem, s: Symmetry) -> bool:
    """Whether a symmetry changes every angle in the same way and leaves the plies in their places."""
    return s.everywhere and np.array_equal(s.source, np.arange(problem.n_unknown))


def _negation(problem: StackingProblem) -> Array | None:
    """Grid index of minus every angle if all sequences have an equally probable mirror image."""
    for s in problem.symmetries:
        if s.name == "mirror image" and _of_angles(problem, s):
            return np.asarray(s.permutation)
    return None


def _pilot(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    spare: float = _SPARE,
) -> PilotEnumeration:
    """What gives each sequence its learned log evidence.

    Up to a few million sequences all are evaluated. More are looked up in a table, whose floor is so low
    that what it leaves out does not count: at most the share ``spare`` of what may be left out.
    """
    settings, surrogate = problem.settings, trained.surrogate
    if problem.n_sequences <= _EVERY:
        found = Enumeration(
            None, sums, surrogate.top, _negation(problem), np.inf, _every_value(problem, sums, trained)
        )
        return PilotEnumeration(found, _enumerated(found, problem.executor, lambda done, total: None), 1.0)
    slack = float(np.clip(surrogate.largest_error, 0.2, 3.0))
    depth = _FLOOR
    while True:
        table = piecewise_linear_surrogate(
            surrogate.tangent,
            sums.rest_reach,
            surrogate.top,
            depth,
            settings.halvings,
            slack,
            surrogate.freedom,
            problem.executor,
        )
        found = Enumeration(table, sums, surrogate.top, _negation(problem), np.inf)
        visited = prefixes_to_visit(found)
        pilot_prefixes = np.sort(rng.choice(visited, size=min(_PILOT_PREFIXES, len(visited)), replace=False))
        items = [s for s in np.array_split(pilot_prefixes, _PIECES) if len(s)]
        piece = combined(run(enumerate_prefixes, found, items, problem.executor, batch_size=1))
        share = len(pilot_prefixes) / len(visited)
        left_out = piece.left_out * np.exp(-depth)
        allowed = spare * settings.unaccounted * piece.mass.sum()
        if left_out <= allowed or depth > _DEEPEST:
            return PilotEnumeration(found, piece, share)
        del table, found  # the next one takes as much memory
        depth += float(np.clip(np.log(left_out / max(allowed, 1e-300)), 1.0, _DEEPER))
        notify(f"the table reaches {depth:.0f} nats below the best")


def _every_value(problem: StackingProblem, sums: PlySums, trained: TrainedSurrogate) -> Array:
    """The learned log evidence of every sequence, (choices of the first plies, choices of the others)."""
    g, k = len(problem.grid_deg), problem.n_unknown
    every = np.stack(np.unravel_index(np.arange(g**k), (g,) * k), axis=1)
    representative = canonical(every, problem.symmetries).representative
    code = representative @ (g ** np.arange(k - 1, -1, -1))
    _, first, label = np.unique(code, return_index=True, return_inverse=True)
    features = sums.features(representative[first])
    return surrogate_values(trained.surrogate, problem.executor, features)[label.ravel()].reshape(
        -1, g ** min(k, INNER)
    )


def _enumerated(
    own: Enumeration, executor: Executor | None, progress: Callable[[int, int], None]
) -> PartialSums:
    """The sums over all sequences and the list of the best."""
    items = [p for p in np.array_split(prefixes_to_visit(own), _PIECES) if len(p)]
    done = [0]

    def count(index: int, piece: PartialSums) -> None:
        del index, piece
        done[0] += 1
        progress(done[0], len(items))

    return combined(run(enumerate_prefixes, own, items, executor, batch_size=1, on_result=count))
