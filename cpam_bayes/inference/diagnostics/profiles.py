"""Profile likelihoods: how well the data fit when one constant is held and the others follow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.derivatives import Coordinates, Expansion, coordinates, expand_u
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.parameters import ParameterSet, Uniform

Array = NDArray[Any]

# Half the 95 % quantile of chi-square with one degree of freedom.
DROP_95 = 1.920729
_GRID = 21
# The grid goes so far beyond the draws, as a fraction of their range, and on to a bound that is near.
_BEYOND, _NEAR = 0.15, 0.05
# Draws that starts are chosen from.
_CANDIDATES = 4000
# Times that points start again from their neighbours' ends, and the gain in nats that makes it worth it.
_SWEEPS, _BETTER = 4, 1e-4
_STEPS = 40


@dataclass(frozen=True, slots=True)
class Profile:
    """Profile likelihood of one parameter, SI.

    values : (g,).
    drop : (g,) largest log likelihood of all less that with the parameter held there, infinite where none was
    found.
    best : the value with the largest likelihood.
    lower, upper : outer ends of the 95 % region, drop <= 1.92, or of the grid where the likelihood does not
    drop so far.
    lower_open, upper_open : whether that is so.
    parts : separate intervals of the region.
    """

    name: str
    values: Array
    drop: Array
    best: float
    lower: float
    upper: float
    lower_open: bool
    upper_open: bool
    parts: int


def profile_likelihoods(
    posterior: Posterior, names: tuple[str, ...], draws: Array, log_prob: Array, n_grid: int = _GRID
) -> tuple[Profile, ...]:
    """Profile log likelihood of each of ``names`` on a grid (Raue et al., 2009).

    pl(v) = max over the other parameters of log p(data | p) with p_k = v, within bounds and
    constraints. Priors of ``names`` do not enter; those of the noise and of plate sizes do, being what
    is known of them, the noise's over its logarithm. All grid points of all parameters are optimised together
    (``maximise``), from the best draws near them and then from the ends of their neighbours on the grid.
    What is found is a lower bound of the profile, as of any maximum.

    draws (m, n), log_prob (m,) : of the chains. The grid spans the draws, and the whole search
    interval where the prior is not uniform.
    """
    flat = _without_priors(posterior, names)
    axes = coordinates(flat)
    few = np.unique(np.append(np.linspace(0, len(draws) - 1, _CANDIDATES).astype(int), log_prob.argmax()))
    draws = draws[few]
    height = log_prob[few] + flat.parameters.log_prior(draws) - posterior.parameters.log_prior(draws)
    index = [posterior.parameters.names.index(name) for name in names]
    grids = [_grid(posterior, k, draws[:, k], n_grid) for k in index]
    starts = [_starts(draws, height, k, grid) for k, grid in zip(index, grids, strict=True)]
    # the last point is free: it finds the largest likelihood of all
    held = np.append(np.repeat(index, n_grid), -1)
    u = axes.to_u(np.vstack((*starts, draws[height.argmax()])))
    value = np.full(len(u), -np.inf)
    _maximise_again(flat, axes, held, np.arange(len(u)), u.copy(), u, value)
    changed = np.ones(len(u), dtype=bool)
    for _ in range(_SWEEPS):
        moved = np.zeros(len(u), dtype=bool)
        for side in (-1, 1):
            moved |= _from_neighbours(flat, axes, held, u, value, n_grid, side, changed | moved)
        changed = moved
        if not changed.any():
            break
    top = int(value.argmax())
    if top != len(u) - 1:
        _maximise_again(flat, axes, held, np.array([len(u) - 1]), u[top : top + 1].copy(), u, value)
    best = axes.to_x(u[-1])
    drops = value.max() - value[:-1].reshape(len(names), n_grid)
    return tuple(
        _profile(name, grid, drop, float(best[k]))
        for name, grid, drop, k in zip(names, grids, drops, index, strict=True)
    )


def _without_priors(posterior: Posterior, names: tuple[str, ...]) -> Posterior:
    """The posterior with even priors of some parameters between their bounds."""
    parameters = tuple(
        replace(p, prior=Uniform(p.prior.lower, p.prior.upper)) if p.name in names else p
        for p in posterior.parameters.parameters
    )
    return replace(posterior, parameters=ParameterSet(parameters, posterior.parameters.fixed))


def _grid(posterior: Posterior, k: int, draws: Array, n: int) -> Array:
    prior = posterior.parameters.parameters[k].prior
    if not isinstance(prior, Uniform):
        return np.linspace(prior.lower, prior.upper, n)
    low, high = np.quantile(draws, (0.0005, 0.9995))
    beyond, near = _BEYOND * (high - low), _NEAR * (prior.upper - prior.lower)
    low = prior.lower if low - beyond < prior.lower + near else low - beyond
    high = prior.upper if high + beyond > prior.upper - near else high + beyond
    return np.linspace(low, high, n)


def _starts(draws: Array, height: Array, k: int, grid: Array) -> Array:
    """For each grid point the best draw near it, moved onto it, (g, n)."""
    place = np.rint((draws[:, k] - grid[0]) / (grid[1] - grid[0]))
    place = np.clip(place, 0, len(grid) - 1).astype(int)
    order = np.argsort(height, kind="stable")
    best = np.full(len(grid), -1)
    best[place[order]] = order  # the last one written, the best, stays
    filled = np.flatnonzero(best >= 0)
    best = best[filled[np.abs(np.arange(len(grid))[:, None] - filled).argmin(axis=1)]]
    starts: Array = draws[best]
    starts[:, k] = grid
    return starts


def _maximise_again(
    flat: Posterior, axes: Coordinates, held: Array, which: Array, start: Array, u: Array, value: Array
) -> Array:
    """Optimise from ``start`` with a parameter of each held; keep in ``u`` and ``value`` what got higher.

    Returns which points did, as numbers.
    """

    def target(at: Array, rows: Array) -> Expansion:
        expansion = expand_u(flat, axes, at)
        fixed = np.arange(at.shape[1]) == held[which[rows], None]
        crossed = fixed[:, :, None] | fixed[:, None, :]
        curvature = np.where(crossed, np.eye(at.shape[1]), expansion.curvature)
        return Expansion(expansion.value, np.where(fixed, 0.0, expansion.gradient), curvature)

    optimum = maximise(target, start, axes.lower, axes.upper, most_steps=_STEPS)
    higher = optimum.expansion.value > value[which] + _BETTER
    u[which[higher]], value[which[higher]] = optimum.u[higher], optimum.expansion.value[higher]
    return which[higher]


def _from_neighbours(
    posterior: Posterior,
    axes: Coordinates,
    held: Array,
    u: Array,
    value: Array,
    n_grid: int,
    side: int,
    changed: Array,
) -> Array:
    """Let points start again where their neighbours on one side ended, if these changed.

    Returns which points got higher, (m,) bool.
    """
    i = np.arange(len(u) - 1)
    to = i[(i % n_grid + side >= 0) & (i % n_grid + side < n_grid)]
    to = to[changed[to + side]]
    moved = np.zeros(len(u), dtype=bool)
    if len(to):
        start = u[to + side].copy()
        start[np.arange(len(to)), held[to]] = u[to, held[to]]
        moved[_maximise_again(posterior, axes, held, to, start, u, value)] = True
    return moved


def _profile(name: str, values: Array, drop: Array, best: float) -> Profile:
    """The 95 % region, its ends interpolated in the square root of the drop, which is nearly linear."""
    level = np.sqrt(DROP_95)
    root = np.sqrt(np.maximum(drop, 0.0))
    ends = []
    for side in (-1, 1):
        outward = np.flatnonzero(side * (values - best) > 0.0)[::side]
        places, heights = np.append(best, values[outward]), np.append(0.0, root[outward])
        j = int(np.flatnonzero(heights < level)[-1])  # the last one inside
        if j == len(places) - 1:
            ends.append((float(places[-1]), True))
            continue
        fraction = (level - heights[j]) / (heights[j + 1] - heights[j])
        ends.append((float(places[j] + fraction * (places[j + 1] - places[j])), False))
    (lower, lower_open), (upper, upper_open) = ends
    at = int(np.searchsorted(values, best))
    inside = np.insert(root < level, at, True)
    parts = int(np.sum(inside[1:] & ~inside[:-1]) + inside[0])
    return Profile(name, values, drop, best, lower, upper, lower_open, upper_open, parts)
