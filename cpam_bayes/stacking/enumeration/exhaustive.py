"""The posterior over few stacking sequences: the evidence of each one is computed.

All are looked at on a small basis first. Those near the best are computed again, on a basis that is made
for them, from their own optimum and from those of their neighbours: of two optima a climb may have
met the lesser one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.conditional.bases import NEAR, about, roughly
from cpam_bayes.stacking.conditional.evaluation import Evaluated, evaluate, merged, neighbours, with_optima
from cpam_bayes.stacking.records import CREDIBLE, StackingPosterior, StackingProblem, random_members
from cpam_bayes.stacking.symmetry.classes import canonical

Array = NDArray[Any]

# log2 of the points of the first look.
_FIRST_POINTS = 5


def exhaustive(
    problem: StackingProblem, rng: np.random.Generator, notify: Callable[[str], None]
) -> StackingPosterior:
    """Every evidence computed."""
    g, k = len(problem.grid_deg), problem.n_unknown
    every = np.stack(np.unravel_index(np.arange(g**k), (g,) * k), axis=1)
    orbits = canonical(every, problem.symmetries)
    code = orbits.representative @ (g ** np.arange(k - 1, -1, -1))
    _, first, label = np.unique(code, return_index=True, return_inverse=True)
    representative, size = orbits.representative[first], orbits.size[first]
    notify(f"evidence of {len(first)} sequences")
    data = _computed(problem, representative, rng)
    total = float(np.log(np.sum(size * np.exp(data.log_evidence - data.log_evidence.max()))))
    total += float(data.log_evidence.max())
    single = np.exp(data.log_evidence - total)
    p = single[label.ravel()]
    marginals = np.stack([np.bincount(every[:, j], p, minlength=g) for j in range(k)])
    order = np.argsort(-data.log_evidence, kind="stable")
    held = np.cumsum(np.repeat(single[order], size[order]))
    drawn = rng.choice(len(first), size=problem.settings.draws, p=single * size / np.sum(single * size))
    top = order[: problem.settings.listed]
    positive = single > 0
    return StackingPosterior(
        specimen=problem.specimen,
        conditional=problem.conditional,
        symmetries=problem.symmetries,
        grid_deg=problem.grid_deg,
        enumerated=g**k,
        classes=len(first),
        log_evidence_total=total - float(np.log(g**k)),
        top=problem.grid_deg[representative[top]],
        same_bending=(representative[:0],) * len(top),
        alike=(representative[:0],) * len(top),
        multiplicity=size[top],
        probability=single[top],
        log_evidence=data.log_evidence[top],
        log_evidence_error=data.conditionals.error[top],
        components=data[top],
        marginals=marginals,
        credible_count=int(np.searchsorted(held, CREDIBLE) + 1),
        effective_count=float(np.exp(-np.sum(size * single * np.log(np.where(positive, single, 1.0))))),
        unaccounted=0.0,
        drawn=random_members(problem, data[drawn], rng),
        draw_weight=np.full(len(drawn), 1.0 / len(drawn)),
        check=None,
        seconds=0.0,
    )


def _computed(problem: StackingProblem, sequences: Array, rng: np.random.Generator) -> Evaluated:
    """The evidence of sequences (m, k), in their order."""
    rough = roughly(problem.conditional, rng)
    first = evaluate(
        rough, problem.grid_deg, sequences, problem.starts, _FIRST_POINTS, problem.executor, problem.library
    )
    some = first.log_evidence > first.log_evidence.max() - NEAR
    features = _angle_functions(problem.grid_deg[sequences])
    own = first.fits.x[some]
    around = neighbours(features[some], own, np.ones(features.shape[1]), np.ones((1, features.shape[1])))
    starts = np.concatenate((own[:, None, :], around.starts(features[some], own)[:, 1:]), axis=1)
    exact = evaluate(
        about(problem.conditional, problem.grid_deg, first, rng),
        problem.grid_deg,
        sequences[some],
        starts,
        problem.settings.log2_points,
        problem.executor,
        problem.library,
    )
    both = merged(exact, with_optima(first[~some], exact.fits.weight.shape[1]))
    place = np.argsort(np.concatenate((np.flatnonzero(some), np.flatnonzero(~some))), kind="stable")
    return both[place]


def _angle_functions(angles_deg: Array) -> Array:
    """cos and sin of twice and four times every angle (m, k), (m, 4 k): near ones are of near sequences."""
    t = np.deg2rad(angles_deg)
    return np.concatenate([f(n * t) / n for n in (2, 4) for f in (np.cos, np.sin)], axis=1)
