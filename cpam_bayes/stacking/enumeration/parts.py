"""The posterior over many stacking sequences from its parts: sampled, fitted, and by surrogate alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.conditional.evaluation import Evaluated, merged
from cpam_bayes.stacking.enumeration.best_first import (
    BIN,
    BINS,
    BINS_BEGIN,
    Enumeration,
    PartialSums,
    place_values,
    values_of_prefix,
)
from cpam_bayes.stacking.enumeration.listing import ListedClasses, refined
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.records import CREDIBLE, StackingPosterior, StackingProblem, SurrogateCheck
from cpam_bayes.stacking.surrogate.training import TrainedSurrogate
from cpam_bayes.stacking.symmetry.classes import canonical

Array = NDArray[Any]

# Draws at which the basis made for the posterior is compared with the whole one.
_BASIS_SETS = 200
# Fewest draws from a part that is not sampled.
_MIN_DRAWS = 64
# Weight of a draw, in mean weights, from which on its error counts: of others the surrogate was far too high.
_MIN_WEIGHT = 1e-3


@dataclass(frozen=True, slots=True)
class DrawnPart:
    """Draws from one part of the sequences, their evidence refined.

    mass : weight of the part before it is corrected.
    data : the draws.
    error : (d,) refined log evidence less the one they were drawn by, nats.
    """

    mass: float
    data: Evaluated
    error: Array

    @property
    def correction(self) -> float:
        """Log of the factor on the part's mass."""
        return float(np.log(np.mean(np.exp(self.error - self.error.max()))) + self.error.max())


def draw_parts(
    problem: StackingProblem,
    sums: PlySums,
    trained: TrainedSurrogate,
    enumeration: Enumeration,
    totals: PartialSums,
    listed: ListedClasses,
    rng: np.random.Generator,
) -> tuple[DrawnPart | None, ...]:
    """Draws from the classes that were sampled, from those fitted only, and from all that is not listed."""
    weight = listed.count * np.exp(listed.log_evidence - enumeration.reference)
    rows = (np.flatnonzero(listed.sampled), np.flatnonzero(~listed.sampled))
    masses = (*(float(weight[r].sum()) for r in rows), float(totals.mass.sum()))
    draws = problem.settings.draws
    parts: list[DrawnPart | None] = []
    for i, mass in enumerate(masses):
        if mass <= 0.0:
            parts.append(None)
            continue
        n = max(round(draws * mass / sum(masses)), min(_MIN_DRAWS, draws))
        if i < len(rows):
            pick = rows[i][rng.choice(len(rows[i]), size=n, p=weight[rows[i]] / mass)]
            sequences, value = listed.sequences[pick], listed.log_evidence[pick]
        else:
            sequences, value = _unlisted(enumeration, totals, n, rng)
        distinct, index = np.unique(sequences, axis=0, return_inverse=True)
        features = sums.features(distinct)
        data = refined(problem, trained, listed.around, distinct, features, None)[index.ravel()]
        parts.append(DrawnPart(mass, data, data.log_evidence - value))
    return tuple(parts)


def _unlisted(
    enumeration: Enumeration, totals: PartialSums, n: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Sequences (n, k) drawn from those that are not listed, and the surrogate's log evidence (n,)."""
    prefix = rng.choice(len(totals.mass), size=n, p=totals.mass / totals.mass.sum())
    sequences = np.empty((n, enumeration.sums.n_unknown), dtype=np.int64)
    value = np.empty(n)
    for p in np.unique(prefix):
        rows = np.flatnonzero(prefix == p)
        candidates, log_evidence = values_of_prefix(enumeration, int(totals.prefixes[p]))
        weight = np.exp(log_evidence - log_evidence.max())
        pick = rng.choice(len(candidates), size=len(rows), p=weight / weight.sum())
        sequences[rows], value[rows] = candidates[pick], log_evidence[pick]
    return sequences, value


def combined_posterior(
    problem: StackingProblem,
    trained: TrainedSurrogate,
    enumeration: Enumeration,
    totals: PartialSums,
    listed: ListedClasses,
    parts: tuple[DrawnPart | None, ...],
    rng: np.random.Generator,
) -> StackingPosterior:
    """The posterior of all parts together, those that were not sampled corrected by their draws."""
    fitted, rest = (0.0 if part is None else part.correction for part in parts[1:])
    relative = listed.log_evidence + np.where(listed.sampled, 0.0, fitted) - enumeration.reference
    weight = np.exp(relative)
    rest_mass = float(np.exp(rest) * totals.mass.sum())
    total = float(listed.count @ weight) + rest_mass
    log_total = float(np.log(total)) + enumeration.reference
    entropy = float((listed.count * weight) @ relative) + np.exp(rest) * (
        totals.entropy + rest * totals.mass.sum()
    )
    left_out = totals.left_out * np.exp(enumeration.lower_bound - enumeration.reference)
    drawn_parts = [part for part in parts if part is not None]
    # sampled classes count as they were drawn: a refined evidence differs by the noise of both
    weights = [
        np.exp(part.error) if part is not parts[0] else np.ones(len(part.error)) for part in drawn_parts
    ]
    fractions = [part.mass / total * (w / len(w)) for part, w in zip(drawn_parts, weights, strict=True)]
    draw_weight = np.concatenate(fractions)
    draw_weight = draw_weight / draw_weight.sum()
    drawn = drawn_parts[0].data
    for part in drawn_parts[1:]:
        drawn = merged(drawn, part.data)
    error = np.concatenate([part.error for part in drawn_parts])
    top = listed.refined[np.arange(min(problem.settings.listed, len(listed.refined.sequences)))]
    none = top.sequences[:0]
    return StackingPosterior(
        specimen=problem.specimen,
        conditional=problem.conditional,
        symmetries=problem.symmetries,
        grid_deg=problem.grid_deg,
        enumerated=problem.n_sequences,
        classes=None,
        log_evidence_total=log_total - float(np.log(problem.n_sequences)),
        top=problem.grid_deg[top.sequences],
        same_bending=(none,) * len(top.sequences),
        alike=(none,) * len(top.sequences),
        multiplicity=canonical(top.sequences, problem.symmetries).size,
        probability=np.exp(top.log_evidence - log_total),
        log_evidence=top.log_evidence,
        log_evidence_error=top.conditionals.error,
        components=top,
        marginals=_marginals(enumeration, totals, listed, weight, float(np.exp(rest))),
        credible_count=_credible_count(totals, listed, weight, rest, total),
        effective_count=float(np.exp(np.log(total) - entropy / total)),
        unaccounted=float(left_out / (left_out + total)),
        drawn=problem.random_members(drawn, rng),
        draw_weight=draw_weight,
        check=SurrogateCheck(
            training_size=len(trained.data.sequences),
            rms=float(np.sqrt(np.sum(draw_weight * error**2))),
            largest=float(np.abs(error[draw_weight > _MIN_WEIGHT * draw_weight.mean()]).max()),
            overlooked=max(0.0, float(drawn.log_evidence.max() - listed.refined.log_evidence[0])),
            correction=rest,
            effective=float(1.0 / np.sum(draw_weight**2) / len(draw_weight)),
            fitted=len(listed.size),
            sampled=int(listed.sampled.sum()),
            surrogate_probability=rest_mass / total,
            basis_error=_basis_error(problem, trained, drawn, rng),
        ),
        seconds=0.0,
    )


def _basis_error(
    problem: StackingProblem, trained: TrainedSurrogate, drawn: Evaluated, rng: np.random.Generator
) -> float:
    """Largest relative difference of the frequencies of the two bases at some constants drawn."""
    rows = rng.permutation(len(drawn.sequences))[:_BASIS_SETS]
    whole = problem.conditional
    x = drawn.conditionals.draws[rows, 0, : whole.template.model.parameters.size]
    sets = np.column_stack((problem.grid_deg[drawn.sequences[rows]], x))
    ratio = trained.focused.model.predict(sets).frequencies / whole.model.predict(sets).frequencies
    return float(np.abs(ratio - 1.0).max())


def _credible_count(
    totals: PartialSums, listed: ListedClasses, weight: Array, correction: float, total: float
) -> int:
    """Number of sequences in the smallest set with 95 %, the last group in proportion."""
    value = np.exp(BINS_BEGIN - BIN * (np.arange(BINS) + 0.5) + correction)
    each = np.concatenate((weight, value))
    count = np.concatenate((listed.count, totals.count)).astype(float)
    mass = np.concatenate((listed.count * weight, np.exp(correction) * totals.weight))
    order = np.argsort(-each, kind="stable")
    cumulative = np.cumsum(mass[order])
    last = int(np.searchsorted(cumulative, CREDIBLE * total))
    before = float(count[order[:last]].sum())
    missing = CREDIBLE * total - (cumulative[last - 1] if last else 0.0)
    fraction = missing / max(float(mass[order[last]]), 1e-300)
    return int(np.ceil(before + fraction * count[order[last]] - 1e-9))


def _marginals(
    enumeration: Enumeration, totals: PartialSums, listed: ListedClasses, weight: Array, factor: float
) -> Array:
    """Probability of every angle, ply by ply, (k, n_grid)."""
    g, n_outer = len(enumeration.sums.grid_deg), enumeration.sums.n_unknown - enumeration.n_inner
    outer = [
        np.bincount(totals.prefixes // p % g, totals.mass, minlength=g) for p in place_values(g, n_outer)
    ]
    summed = factor * np.concatenate((np.reshape(outer, (n_outer, g)), totals.inner))
    row_weight = totals.times * weight[listed.class_of_row]
    mass = summed + np.stack([np.bincount(column, row_weight, minlength=g) for column in totals.listed.T])
    if enumeration.negation is not None:
        mass = 0.5 * (mass + mass[:, enumeration.negation])
    return np.asarray(mass / mass.sum(axis=1, keepdims=True))
