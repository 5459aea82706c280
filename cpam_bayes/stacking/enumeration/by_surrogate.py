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
from cpam_bayes.stacking.answer import OVERLOOKED, SequenceAnswer, Task
from cpam_bayes.stacking.conditional.evaluation import (
    Evaluated,
    merged,
    with_optima,
)
from cpam_bayes.stacking.enumeration.best_first import (
    BIN,
    INNER,
    Enumerator,
    Piece,
    enumerate_prefixes,
    prefixes_to_visit,
    together,
)
from cpam_bayes.stacking.enumeration.listing import Listed, compute_listed, learned_values
from cpam_bayes.stacking.enumeration.parts import Part, combined_answer, draw_parts
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.surrogate.piecewise_linear import build_table
from cpam_bayes.stacking.surrogate.training import Learned, Learning, learn, learn_more, learn_on
from cpam_bayes.stacking.symmetry.classes import canonical
from cpam_bayes.stacking.symmetry.symmetries import Symmetry

Array = NDArray[Any]

# Pieces that the prefixes are shared out in.
_PIECES = 64
# A floor this far below the best to begin with, and deeper by this much while too much is left out.
_FLOOR, _DEEPER, _DEEPEST = 17.0, 5.0, 35.0
# Prefixes that tell beforehand how much a floor leaves out, and how long a list gets.
_SCOUTS = 512
# Share of the mass that may be learned alone where the list can be long enough.
_UNLISTED = 3e-3
# Share of the mass that is learned alone from which on the surface is learned more finely.
_LEARNED_ALONE = 0.05
# Rounds of learning, listing and checking; root mean square error on the draws, nats, that ends them, or so
# many times the one that the learning ended with; listed sequences that a further round learns from.
_ROUNDS, _SETTLED, _AS_SAID, _LESSON = 2, 0.2, 1.5, 400
# Root mean square error on the draws, nats, from which on there are more rounds, and so many at most.
_ASTRAY, _MOST_ROUNDS = 0.5, 4
# Share of what may be left out that the floor is chosen for: what a few prefixes say of it is rough.
_SPARE = 0.5
# Noise, relative, from which on a posterior is found at once; below it its seeds are the best sequences at so
# many times the noise, so many of them, learned to a root mean square error, nats.
_EASY, _NOISIER, _SEEDS, _ROUGHLY = 1.5e-3, 3.0, 600, 1.0
# Of more sequences than this a short list is tried first: sequences fitted, most probable ones, and draws.
_MANY, _TRIAL, _TRIAL_LISTED, _TRIAL_DRAWS = 10_000_000, 500, 50, 150
# Up to so many sequences the surface is evaluated for each.
_EVERY = 3_000_000


def learned(
    task: Task,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> SequenceAnswer:
    """The evidence learned, all sequences gone through, those that can matter computed."""
    problem = learning_of(task, sums)
    images = problem.images
    known = learn(problem, rng, notify, noisier_seeds(task, sums, rng, notify))
    rounds, fine, spare = 0, False, _SPARE
    current = _trial(task) if task.n_sequences > _MANY else task
    scouted: Scouted | None = None
    while True:
        if scouted is None:
            scouted = _scouted(task, sums, known, rng, notify, spare)
        if current is task and not fine and scouted.unlisted(task) > _LEARNED_ALONE:
            notify("too many sequences count to be fitted one by one: learning on")
            fine, scouted = True, None
            known = learn_on(known, problem, task.settings.learning.fine, rng, notify)
            continue
        answer, listed, drawn = _answered(
            current, sums, known, scouted.listing(current), images, rng, notify, progress
        )
        assert answer.check is not None
        check, rounds = answer.check, rounds + 1
        astray = check.rms > _ASTRAY or check.overlooked > OVERLOOKED
        settled = not astray and check.rms <= max(_SETTLED, _AS_SAID * known.surface.rms_error)
        excess = answer.unaccounted / task.settings.unaccounted
        last = rounds >= (_MOST_ROUNDS if astray or excess > 1.0 else _ROUNDS)
        if current is task and (last or (settled and excess <= 1.0)):
            return answer
        if excess > 1.0:
            spare, scouted = 0.5 * spare / excess, None
        if not settled:
            notify(f"off by {check.rms:.2f} nats on draws: these are learned from as well")
            known, scouted = learn_more(known, problem, _lesson(drawn, listed, rng), rng), None
        if rounds >= _ROUNDS or not astray:
            current = task


def _answered(
    task: Task,
    sums: PlySums,
    known: Learned,
    enumerator: Enumerator,
    images: Array,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> tuple[SequenceAnswer, Listed, tuple[Part | None, ...]]:
    """All sequences gone through, those that can matter computed, and draws that check the result."""
    cells = "" if enumerator.table is None else f", {len(enumerator.table.centre)} cells"
    notify(f"{task.n_sequences} sequences{cells}")
    whole = _gone_through(enumerator, task.executor, progress)
    notify(f"{len(whole.log_evidence)} sequences are fitted one by one")
    listed = compute_listed(task, sums, known, whole, images, notify)
    drawn = draw_parts(task, sums, known, enumerator, whole, listed, rng)
    return combined_answer(task, known, enumerator, whole, listed, drawn, rng), listed, drawn


def noisier_seeds(
    task: Task, sums: PlySums, rng: np.random.Generator, notify: Callable[[str], None]
) -> Array | None:
    """The sequences (m, k) that would be good if the list were noisier; ``None`` where it is noisy enough.

    No sequence drawn evenly is next to the posterior of a list with very little noise.
    """
    wide = _noisier(task)
    if wide is None:
        return None
    known = learn(learning_of(wide, sums), rng, notify, noisier_seeds(wide, sums, rng, notify))
    few = replace(wide, settings=replace(wide.settings, fitted=_SEEDS))
    listing = _scouted(wide, sums, known, rng, notify).listing(few)
    whole = _gone_through(listing, task.executor, lambda done, total: None)
    best = np.argsort(-whole.log_evidence, kind="stable")[:_SEEDS]
    return np.asarray(canonical(whole.listed[best].astype(np.int64), task.symmetries).representative)


def _noisier(task: Task) -> Task | None:
    """The same with more noise, where the list states so little that its posterior is not found at once."""
    template = task.own.template
    middle = 0.5 * (task.own.parameters.lower + task.own.parameters.upper)
    if template.noise_is_inferred or task.own.relative_noise(middle[None]).min() >= _EASY:
        return None
    own = template.noise_model
    assert isinstance(own.amplitude, float)
    noise = replace(own, amplitude=_NOISIER * own.amplitude, rounding=_NOISIER**2 * own.rounding)
    settings = replace(task.settings, learning=replace(task.settings.learning, error=_ROUGHLY))
    return replace(
        task, own=replace(task.own, template=replace(template, noise_model=noise)), settings=settings
    )


def _trial(task: Task) -> Task:
    """The same with a short list and few draws."""
    own = task.settings
    few = replace(
        own,
        fitted=min(_TRIAL, own.fitted),
        listed=min(_TRIAL_LISTED, own.listed),
        draws=min(_TRIAL_DRAWS, own.draws),
    )
    return replace(task, settings=few)


@dataclass(frozen=True, slots=True)
class Scouted:
    """All sequences with their learned log evidence, and what some of them say of a list's length.

    piece : the sums over a ``share`` of the sequences.
    """

    enumerator: Enumerator
    piece: Piece
    share: float

    def listing(self, task: Task) -> Enumerator:
        """The same with what a task lists."""
        own = self.enumerator
        return replace(own, threshold=own.reference + 5.0 - BIN * self._listed_bins(task))

    def unlisted(self, task: Task) -> float:
        """Share of the mass, as it was learned, of sequences that a task does not list."""
        n = self._listed_bins(task)
        return float(self.piece.weight[n:].sum() / self.piece.weight.sum())

    def _listed_bins(self, task: Task) -> int:
        """How many bins of the log evidence are listed: nearly all the mass, but not too many sequences."""
        settings = task.settings
        rest = 1.0 - np.cumsum(self.piece.weight) / self.piece.weight.sum()
        number = np.cumsum(self.piece.count) / self.share / (1 if self.enumerator.negation is None else 2)
        enough = int(np.argmax(rest <= _UNLISTED))
        return min(enough + 1, int(np.searchsorted(number, settings.fitted, side="right")))


def learning_of(task: Task, sums: PlySums) -> Learning:
    """What is to be learned of a task."""
    images = _images(task, sums)
    return Learning(task.own, sums, images, task.starts, task.library, task.settings.learning, task.executor)


def _lesson(drawn: tuple[Part | None, ...], listed: Listed, rng: np.random.Generator) -> Evaluated:
    """What is learned from when the learned evidence proves wrong: where it is, and some of the best."""
    some = rng.permutation(len(listed.exact.sequences))[:_LESSON]
    found = listed.exact[np.sort(some)]
    for part in drawn[1:]:
        if part is not None:
            found = merged(found, with_optima(part.data, found.fits.weight.shape[1]))
    _, first = np.unique(found.sequences, axis=0, return_index=True)
    return found[np.sort(first)]


def _images(task: Task, sums: PlySums) -> Array:
    """Changes of sign of the features that change no frequency, the identity first, (n_images, d)."""
    found = [np.ones(len(sums.function))]
    found += [sums.signs(s.name) for s in task.symmetries if _of_angles(task, s)]
    return np.array(found)


def _of_angles(task: Task, s: Symmetry) -> bool:
    """Whether a symmetry changes every angle in the same way and leaves the plies in their places."""
    return s.everywhere and np.array_equal(s.source, np.arange(task.n_unknown))


def _negation(task: Task) -> Array | None:
    """Grid index of minus every angle if all sequences have an equally probable mirror image."""
    for s in task.symmetries:
        if s.name == "mirror image" and _of_angles(task, s):
            return np.asarray(s.permutation)
    return None


def _scouted(
    task: Task,
    sums: PlySums,
    known: Learned,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    spare: float = _SPARE,
) -> Scouted:
    """What gives each sequence its learned log evidence.

    Up to a few million sequences all are evaluated. More are looked up in a table, whose floor is so low
    that what it leaves out does not count: at most the share ``spare`` of what may be left out.
    """
    settings, surface = task.settings, known.surface
    if task.n_sequences <= _EVERY:
        found = Enumerator(None, sums, surface.top, _negation(task), np.inf, _every_value(task, sums, known))
        return Scouted(found, _gone_through(found, task.executor, lambda done, total: None), 1.0)
    slack = float(np.clip(surface.largest_error, 0.2, 3.0))
    depth = _FLOOR
    while True:
        table = build_table(
            surface.tangent,
            sums.rest_reach,
            surface.top,
            depth,
            settings.halvings,
            slack,
            surface.freedom,
            task.executor,
        )
        found = Enumerator(table, sums, surface.top, _negation(task), np.inf)
        visited = prefixes_to_visit(found)
        scouts = np.sort(rng.choice(visited, size=min(_SCOUTS, len(visited)), replace=False))
        items = [s for s in np.array_split(scouts, _PIECES) if len(s)]
        piece = together(run(enumerate_prefixes, found, items, task.executor, batch_size=1))
        share = len(scouts) / len(visited)
        left_out = piece.left_out * np.exp(-depth)
        allowed = spare * settings.unaccounted * piece.mass.sum()
        if left_out <= allowed or depth > _DEEPEST:
            return Scouted(found, piece, share)
        del table, found  # the next one takes as much memory
        depth += float(np.clip(np.log(left_out / max(allowed, 1e-300)), 1.0, _DEEPER))
        notify(f"the table reaches {depth:.0f} nats below the best")


def _every_value(task: Task, sums: PlySums, known: Learned) -> Array:
    """The learned log evidence of every sequence, (choices of the first plies, choices of the others)."""
    g, k = len(task.grid_deg), task.n_unknown
    every = np.stack(np.unravel_index(np.arange(g**k), (g,) * k), axis=1)
    representative = canonical(every, task.symmetries).representative
    code = representative @ (g ** np.arange(k - 1, -1, -1))
    _, first, label = np.unique(code, return_index=True, return_inverse=True)
    features = sums.features(representative[first])
    return learned_values(known.surface, task.executor, features)[label.ravel()].reshape(
        -1, g ** min(k, INNER)
    )


def _gone_through(own: Enumerator, executor: Executor | None, progress: Callable[[int, int], None]) -> Piece:
    """The sums over all sequences and the list of the best."""
    items = [p for p in np.array_split(prefixes_to_visit(own), _PIECES) if len(p)]
    done = [0]

    def count(index: int, piece: Piece) -> None:
        del index, piece
        done[0] += 1
        progress(done[0], len(items))

    return together(run(enumerate_prefixes, own, items, executor, batch_size=1, on_result=count))
