"""The posterior over few stacking sequences: the evidence of each one is computed.

All are screened on a small basis first. Those near the best are computed again, on a basis that is made for
them, from their optimum and from those of their neighbours: of two optima the first optimisation may have
met the lesser one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.conditional.bases import NEAR, about, roughly
from cpam_bayes.stacking.conditional.evaluation import Evaluated, evaluate, merged, neighbours, with_optima
from cpam_bayes.stacking.features import all_sequences
from cpam_bayes.stacking.records import CREDIBLE, StackingPosterior, StackingProblem
from cpam_bayes.stacking.symmetry.classes import classes

Array = NDArray[Any]

# log2 of the points of importance sampling in the screening.
_SCREENING_POINTS = 5


def exhaustive(
    problem: StackingProblem, rng: np.random.Generator, notify: Callable[[str], None]
) -> StackingPosterior:
    """The posterior with every evidence computed."""
    g, k = len(problem.grid_deg), problem.n_unknown
    every = all_sequences(g, k)
    distinct = classes(every, problem.symmetries)
    n, size = len(distinct.size), distinct.size
    notify(f"evidence of {n} sequences")
    data = _evaluated(problem, distinct.representative, rng)
    best = float(data.log_evidence.max())
    total = float(np.log(np.sum(size * np.exp(data.log_evidence - best)))) + best
    single = np.exp(data.log_evidence - total)
    p = single[distinct.label]
    order = np.argsort(-data.log_evidence, kind="stable")
    cumulative = np.cumsum(np.repeat(single[order], size[order]))
    drawn = rng.choice(n, size=problem.settings.draws, p=single * size / np.sum(single * size))
    top = order[: problem.settings.listed]
    none = distinct.representative[:0]
    log_single = np.log(np.where(single > 0, single, 1.0))
    return StackingPosterior(
        specimen=problem.specimen,
        conditional=problem.conditional,
        symmetries=problem.symmetries,
        grid_deg=problem.grid_deg,
        enumerated=g**k,
        classes=n,
        log_evidence_total=total - float(np.log(g**k)),
        top=problem.grid_deg[distinct.representative[top]],
        same_bending=(none,) * len(top),
        alike=(none,) * len(top),
        multiplicity=size[top],
        probability=single[top],
        log_evidence=data.log_evidence[top],
        log_evidence_error=data.conditionals.error[top],
        components=data[top],
        marginals=np.stack([np.bincount(every[:, j], p, minlength=g) for j in range(k)]),
        credible_count=int(np.searchsorted(cumulative, CREDIBLE) + 1),
        effective_count=float(np.exp(-np.sum(size * single * log_single))),
        unaccounted=0.0,
        drawn=problem.random_members(data[drawn], rng),
        draw_weight=np.full(len(drawn), 1.0 / len(drawn)),
        check=None,
        seconds=0.0,
    )


def _evaluated(problem: StackingProblem, sequences: Array, rng: np.random.Generator) -> Evaluated:
    """The evidence of sequences (m, k), in their order."""
    settings, grid, executor, library = problem.settings, problem.grid_deg, problem.executor, problem.library
    rough = roughly(problem.conditional, rng)
    screened = evaluate(rough, grid, sequences, problem.starts, _SCREENING_POINTS, executor, library)
    high = screened.log_evidence > screened.log_evidence.max() - NEAR
    features = _angle_functions(grid[sequences])[high]
    optima = screened.fits.x[high]
    n_features = features.shape[1]
    around = neighbours(features, optima, np.ones(n_features), np.ones((1, n_features)))
    starts = np.concatenate((optima[:, None, :], around.starts(features, optima)[:, 1:]), axis=1)
    focused = about(problem.conditional, grid, screened, rng)
    refined = evaluate(focused, grid, sequences[high], starts, settings.log2_points, executor, library)
    both = merged(refined, with_optima(screened[~high], refined.fits.weight.shape[1]))
    return both[np.argsort(np.concatenate((np.flatnonzero(high), np.flatnonzero(~high))), kind="stable")]


def _angle_functions(angles_deg: Array) -> Array:
    """cos and sin of twice and four times every angle (m, k), (m, 4 k): near ones are of near sequences."""
    t = np.deg2rad(angles_deg)
    return np.concatenate([f(n * t) / n for n in (2, 4) for f in (np.cos, np.sin)], axis=1)
