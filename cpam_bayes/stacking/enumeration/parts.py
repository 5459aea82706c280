"""The posterior over many sequences from its parts: sampled, fitted and learned, as draws correct them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.conditional.evaluation import Evaluated, merged
from cpam_bayes.stacking.enumeration.best_first import BIN, BINS, Enumeration, PartialSums, values_of_prefix
from cpam_bayes.stacking.enumeration.listing import ListedClasses, refined
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.records import (
    CREDIBLE,
    StackingPosterior,
    StackingProblem,
    SurrogateCheck,
    random_members,
)
from cpam_bayes.stacking.surrogate.training import TrainedSurrogate
from cpam_bayes.stacking.symmetry.classes import canonical

Array = NDArray[Any]

# Draws at which the basis made for the posterior is compared with the totals one.
_BASIS_SETS = 200
# Fewest draws from a part that is not sampled.
_FEWEST = 64
# What a draw counts, in mean ones, from which on its error does: others were learned far too high.
_COUNTS = 1e-3


@dataclass(frozen=True, slots=True)
class DrawnPart:
    """Draws from one part of the sequences, computed with care.

    mass : weight of the part as it was known. miss : (d,) log evidence less what it was drawn by.
    """

    mass: float
    data: Evaluated
    miss: Array

    @property
    def correction(self) -> float:
        """Log of the factor on the part's mass."""
        return float(np.log(np.mean(np.exp(self.miss - self.miss.max()))) + self.miss.max())


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
    found: list[DrawnPart | None] = []
    for i, mass in enumerate(masses):
        if mass <= 0.0:
            found.append(None)
            continue
        n = max(round(problem.settings.draws * mass / sum(masses)), min(_FEWEST, problem.settings.draws))
        if i < len(rows):
            pick = rows[i][rng.choice(len(rows[i]), size=n, p=weight[rows[i]] / mass)]
            sequences, value = listed.sequences[pick], listed.log_evidence[pick]
        else:
            sequences, value = _unlisted(enumeration, totals, n, rng)
        distinct, place = np.unique(sequences, axis=0, return_inverse=True)
        features = sums.features(distinct)
        data = refined(problem, trained, listed.around, distinct, features, None)[place.ravel()]
        found.append(DrawnPart(mass, data, data.log_evidence - value))
    return tuple(found)


def _unlisted(
    enumeration: Enumeration, totals: PartialSums, n: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Sequences (n, k) drawn from those that are not listed, by their learned log evidence (n,)."""
    prefix = rng.choice(len(totals.mass), size=n, p=totals.mass / totals.mass.sum())
    sequences = np.empty((n, enumeration.sums.n_unknown), dtype=np.int64)
    value = np.empty(n)
    for p in np.unique(prefix):
        rows = np.flatnonzero(prefix == p)
        some, log_evidence = values_of_prefix(enumeration, int(totals.prefixes[p]))
        weight = np.exp(log_evidence - log_evidence.max())
        pick = rng.choice(len(some), size=len(rows), p=weight / weight.sum())
        sequences[rows], value[rows] = some[pick], log_evidence[pick]
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
    """All parts together, those that were not sampled as the draws correct them."""
    fitted, rest = (0.0 if part is None else part.correction for part in parts[1:])
    value = listed.log_evidence + np.where(listed.sampled, 0.0, fitted)
    below = value - enumeration.reference
    weight = np.exp(below)
    rest_mass = float(np.exp(rest) * totals.mass.sum())
    listed_mass = float(listed.count @ weight)
    total = listed_mass + rest_mass
    log_total = float(np.log(total)) + enumeration.reference
    entropy = float((listed.count * weight) @ below) + np.exp(rest) * (
        totals.entropy + rest * totals.mass.sum()
    )
    left_out = totals.left_out * np.exp(enumeration.floor - enumeration.reference)
    some = [p for p in parts if p is not None]
    # sampled classes count as they were drawn: what a draw with care adds to them is noise of both
    share = [
        p.mass / total * (np.full(len(p.miss), 1.0 / len(p.miss)) if p is parts[0] else _shares(p))
        for p in some
    ]
    draw_weight = np.concatenate(share)
    draw_weight = draw_weight / draw_weight.sum()
    drawn = some[0].data
    for part in some[1:]:
        drawn = merged(drawn, part.data)
    miss = np.concatenate([p.miss for p in some])
    top = np.arange(min(problem.settings.listed, len(listed.careful.sequences)))
    careful = listed.careful[top]
    return StackingPosterior(
        specimen=problem.specimen,
        conditional=problem.conditional,
        symmetries=problem.symmetries,
        grid_deg=problem.grid_deg,
        enumerated=problem.n_sequences,
        classes=None,
        log_evidence_total=log_total - float(np.log(problem.n_sequences)),
        top=problem.grid_deg[careful.sequences],
        same_bending=(careful.sequences[:0],) * len(top),
        alike=(careful.sequences[:0],) * len(top),
        multiplicity=canonical(careful.sequences, problem.symmetries).size,
        probability=np.exp(careful.log_evidence - log_total),
        log_evidence=careful.log_evidence,
        log_evidence_error=careful.conditionals.error,
        components=careful,
        marginals=_marginals(enumeration, totals, listed, weight, float(np.exp(rest))),
        credible_count=_credible_count(totals, listed, weight, rest, total),
        effective_count=float(np.exp(np.log(total) - entropy / total)),
        unaccounted=float(left_out / (left_out + total)),
        drawn=random_members(problem, drawn, rng),
        draw_weight=draw_weight,
        check=SurrogateCheck(
            training_size=len(trained.data.sequences),
            rms=float(np.sqrt(np.sum(draw_weight * miss**2))),
            largest=float(np.abs(miss[draw_weight > _COUNTS * draw_weight.mean()]).max()),
            overlooked=max(0.0, float(drawn.log_evidence.max() - listed.careful.log_evidence[0])),
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
    some = rng.permutation(len(drawn.sequences))[:_BASIS_SETS]
    x = drawn.conditionals.draws[some, 0, : problem.conditional.template.model.parameters.size]
    sets = np.column_stack((problem.grid_deg[drawn.sequences[some]], x))
    ratio = (
        trained.focused.model.predict(sets).frequencies / problem.conditional.model.predict(sets).frequencies
    )
    return float(np.abs(ratio - 1.0).max())


def _shares(part: DrawnPart) -> Array:
    """What each draw of a part counts, (d,), as a share of the part's mass before it was corrected."""
    return np.asarray(np.exp(part.miss) / len(part.miss))


def _credible_count(
    totals: PartialSums, listed: ListedClasses, weight: Array, correction: float, total: float
) -> int:
    """Sequences in the smallest set with 95 %, the last group in proportion."""
    value = np.exp(5.0 - BIN * (np.arange(BINS) + 0.5) + correction)
    each = np.concatenate((weight, value))
    count = np.concatenate((listed.count, totals.count)).astype(float)
    mass = np.concatenate((listed.count * weight, np.exp(correction) * totals.weight))
    order = np.argsort(-each, kind="stable")
    held = np.cumsum(mass[order])
    at = int(np.searchsorted(held, CREDIBLE * total))
    before = float(count[order[:at]].sum())
    share = (CREDIBLE * total - (held[at - 1] if at else 0.0)) / max(float(mass[order[at]]), 1e-300)
    return int(np.ceil(before + share * count[order[at]] - 1e-9))


def _marginals(
    enumeration: Enumeration, totals: PartialSums, listed: ListedClasses, weight: Array, factor: float
) -> Array:
    """Probability of every angle, ply by ply, (k, n_grid)."""
    g, n_inner = len(enumeration.sums.grid_deg), enumeration.n_inner
    n_outer = enumeration.sums.n_unknown - n_inner
    place = g ** np.arange(n_outer - 1, -1, -1, dtype=np.int64)
    outer = [np.bincount(totals.prefixes // p % g, totals.mass, minlength=g) for p in place]
    found = factor * np.concatenate((np.reshape(outer, (n_outer, g)), totals.inner))
    row_weight = totals.times * weight[listed.class_of_row]
    found = found + np.stack([np.bincount(column, row_weight, minlength=g) for column in totals.listed.T])
    if enumeration.negation is not None:
        found = 0.5 * (found + found[:, enumeration.negation])
    return np.asarray(found / found.sum(axis=1, keepdims=True))
