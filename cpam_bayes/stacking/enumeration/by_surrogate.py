"""The posterior over many stacking sequences: a surrogate trained, evidences computed, the result checked.

The surrogate of the log evidence says which sequences can matter. These are listed and fitted one by one,
from optima nearby, and the evidence of those that carry the mass is sampled. The rest is summed by the
surrogate. The evidence of draws from the result is refined: it says how far the evidence of each part is off
and corrects the sums of the parts that were not sampled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.deadline import TimeIsUpError, cut_short, time_limit
from cpam_bayes.stacking.conditional.evaluation import Evaluated, merged, with_optima
from cpam_bayes.stacking.enumeration.listing import ListedClasses, evaluate_listed
from cpam_bayes.stacking.enumeration.parts import DrawnPart, combined_posterior, draw_parts
from cpam_bayes.stacking.enumeration.pilot import (
    MARGIN,
    PilotEnumeration,
    acts_on_angles,
    enumerated,
    pilot_enumeration,
)
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.records import OVERLOOKED, StackingPosterior, StackingProblem
from cpam_bayes.stacking.surrogate.training import (
    TrainedSurrogate,
    TrainingProblem,
    retrain,
    train,
    train_further,
)
from cpam_bayes.stacking.symmetry.classes import canonical

Array = NDArray[Any]

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
# Relative noise from which on sequences drawn evenly lead to the posterior.
_EASY_NOISE = 1.5e-3
# Where there is less, training begins with the best sequences at so many times the noise: their number, and
# the root mean square error of the surrogate that they are found by, nats.
_NOISE_FACTOR, _SEEDS, _SEEDS_RMS = 3.0, 600, 1.0
# Number of sequences above which a short list is tried first: sequences fitted, most probable, and drawn.
_MANY, _TRIAL_FITTED, _TRIAL_LISTED, _TRIAL_DRAWS = 10_000_000, 500, 50, 150


def by_surrogate(
    problem: StackingProblem,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> StackingPosterior:
    """The posterior by a surrogate: all sequences enumerated, those that can matter computed."""
    found: Callable[[], StackingPosterior] | None = None
    try:
        for found in _rounds(problem, sums, rng, notify, progress):  # noqa: B007
            pass
    except TimeIsUpError:
        if found is None:
            raise
        cut_short("the probabilities of sequences are those of a round before the last")
    assert found is not None
    with time_limit(None):
        return found()


def _rounds(
    problem: StackingProblem,
    sums: PlySums,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> Iterator[Callable[[], StackingPosterior]]:
    """What gives the posterior after every round of training, listing and checking, each time a better one.

    A trial on the pilot's prefixes alone is no posterior: what it leads to enumerates all of them.
    """
    training = training_problem(problem, sums)
    trained = train(training, rng, notify, noisier_seeds(problem, sums, rng, notify))
    rounds, fine, margin = 0, False, MARGIN
    current = _trial(problem) if problem.n_sequences > _MANY else problem
    pilot: PilotEnumeration | None = None
    while True:
        if pilot is None:
            pilot = pilot_enumeration(problem, sums, trained, rng, notify, margin)
        if current is problem and not fine and pilot.unlisted(problem) > _FINE_FROM:
            notify("too many sequences count to be fitted one by one: training the surrogate further")
            fine, pilot = True, None
            trained = train_further(trained, training, problem.settings.training.fine_rms, rng, notify)
            continue
        on_some = current is not problem and pilot.is_representative
        done = _round(current, sums, trained, training.images, pilot, on_some, rng, notify, progress)
        posterior = done.posterior
        assert posterior.check is not None
        check, rounds = posterior.check, rounds + 1
        astray = check.rms > _ASTRAY_NATS or check.overlooked > OVERLOOKED
        close = check.rms <= max(_SETTLED_NATS, _SETTLED_ERRORS * trained.surrogate.rms_error)
        settled = close and not astray
        excess = posterior.unaccounted / problem.settings.unaccounted
        last = rounds >= (_MAX_ROUNDS if astray or excess > 1.0 else _ROUNDS)
        # without the pilot, whose table would stand in memory beside that of the next one
        whole = partial(_whole_round, current, sums, trained, training.images, rng, notify, progress)
        yield whole if on_some else partial(_posterior_of, done)
        if current is problem and (last or (settled and excess <= 1.0)):
            return
        if excess > 1.0:
            margin, pilot = 0.5 * margin / excess, None
        if not settled:
            notify(f"off by {check.rms:.2f} nats on draws: these join the training set")
            trained, pilot = retrain(trained, training, _further_training_set(done, rng), rng), None
        if rounds >= _ROUNDS or not astray:
            current = problem


@dataclass(frozen=True, slots=True)
class _Round:
    """One listing with the draws that check it, and the posterior by it."""

    listed: ListedClasses
    parts: tuple[DrawnPart | None, ...]
    posterior: StackingPosterior


def _round(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    images: Array,
    pilot: PilotEnumeration,
    on_some: bool,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> _Round:
    """All sequences, or those of the pilot's prefixes alone, listed, computed and checked."""
    part = replace(pilot, fraction=1.0) if on_some else pilot
    enumeration, prefixes = part.listing(problem), pilot.sums.prefixes if on_some else None
    cells = "" if enumeration.table is None else f", {len(enumeration.table.tangent)} cells"
    every = f"some of {problem.n_sequences}" if on_some else str(problem.n_sequences)
    notify(f"{every} sequences{cells}")
    if prefixes is None:
        totals = enumerated(enumeration, problem.executor, progress)
    else:
        totals = enumerated(enumeration, problem.executor, prefixes=prefixes)
    notify(f"{len(totals.log_evidence)} sequences are fitted one by one")
    listed = evaluate_listed(problem, sums, trained, totals, images, notify)
    parts = draw_parts(problem, sums, trained, enumeration, totals, listed, rng)
    return _Round(
        listed, parts, combined_posterior(problem, trained, enumeration, totals, listed, parts, rng)
    )


def _whole_round(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    images: Array,
    rng: np.random.Generator,
    notify: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> StackingPosterior:
    """The posterior after a trial on some prefixes, from all of them."""
    pilot = pilot_enumeration(problem, sums, trained, rng, notify)
    return _round(problem, sums, trained, images, pilot, False, rng, notify, progress).posterior


def _posterior_of(done: _Round) -> StackingPosterior:
    return done.posterior


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
    enumeration = pilot_enumeration(noisier, sums, trained, rng, notify).listing(few)
    totals = enumerated(enumeration, problem.executor)
    best = np.argsort(-totals.log_evidence, kind="stable")[:_SEEDS]
    return np.asarray(canonical(totals.listed[best].astype(np.int64), problem.symmetries).representative)


def _with_more_noise(problem: StackingProblem) -> StackingProblem | None:
    """The problem with more noise, where the list states so little that evenly drawn sequences do not do."""
    conditional = problem.conditional
    middle = 0.5 * (conditional.parameters.lower + conditional.parameters.upper)
    model = conditional.template.noise_model
    if not isinstance(model.amplitude, float):  # inferred
        return None
    if conditional.relative_noise(middle[None]).min() >= _EASY_NOISE:
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


def training_problem(problem: StackingProblem, sums: PlySums) -> TrainingProblem:
    """The training of the surrogate of a problem."""
    return TrainingProblem(
        conditional=problem.conditional,
        sums=sums,
        images=np.array(
            [np.ones(len(sums.function))]
            + [sums.signs(s.name) for s in problem.symmetries if acts_on_angles(problem, s)]
        ),
        starts=problem.starts,
        library=problem.library,
        settings=problem.settings.training,
        executor=problem.executor,
    )


def _further_training_set(done: _Round, rng: np.random.Generator) -> Evaluated:
    """What joins the training set when the surrogate proves wrong: draws from it, and some of the best."""
    some = rng.permutation(len(done.listed.evaluated.sequences))[:_ADDED_FROM_LIST]
    data = done.listed.evaluated[np.sort(some)]
    for part in done.parts[1:]:
        if part is not None:
            data = merged(data, with_optima(part.data, data.fits.weight.shape[1]))
    _, first = np.unique(data.sequences, axis=0, return_index=True)
    return data[np.sort(first)]
