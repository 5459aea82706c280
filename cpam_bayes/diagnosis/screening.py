"""A first look at a hypothesis: its marginal likelihood with the model linear in all but the effect.

About the optimum of the plain model the log frequencies are linear in the scores of the constants, so that
at every node of the effect's grid the constants are integrated in closed form. Between nodes the effect is
linear too. It costs two stacks of solves, and says which hypotheses deserve to be climbed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.comparison import Comparison
from cpam_bayes.diagnosis.marginal import GRID, Marginal
from cpam_bayes.noise import NOISE_PRIOR

Array = NDArray[Any]

# Amplitudes of the noise, where it is inferred, and their prior weights.
_AMPLITUDES = np.geomspace(5e-4, 0.15, 12)
_AMPLITUDE_WEIGHTS = np.exp(NOISE_PRIOR.log_density(_AMPLITUDES)) * np.gradient(_AMPLITUDES)


def screened_marginal(comparison: Comparison, quadrature: int | None, z: Array) -> Marginal:
    """Approximate marginal likelihood from scores z (n,) at the optimum of the plain model.

    Nothing is climbed. The constants answer the effect's shift once, in a linear step; where that does not
    reach the value is too low, rarely by more than some nats. The draws are the nodes of the effect's grid,
    each with its most probable constants.
    """
    grid = np.zeros(1) if quadrature is None else GRID
    held = [c for c in (quadrature, comparison.noise, comparison.discrepancy) if c is not None]
    free = np.delete(np.arange(len(z)), held)
    at = np.tile(z, (len(grid), 1))
    if quadrature is not None:
        at[:, quadrature] = grid
    slope = _slope(comparison, z, free)
    listed = np.log(comparison.listed.frequencies)
    weight = 1.0 / comparison.listed.frequencies
    sigma = np.sqrt(comparison.variance(comparison.scores.to_x(z)[None])[0]) * weight
    a = slope / sigma[:, None]
    answer = np.linalg.solve(a.T @ a + np.eye(len(free)), a.T)
    r = listed - _log_f(comparison, at)
    at[:, free] = np.clip(((r / sigma) + at[:, free] @ a.T) @ answer.T, -4.0, 4.0)
    r = listed - _log_f(comparison, at)
    # what the plain model predicts where the constants are at their prior means
    r = r + at[:, free] @ slope.T
    columns = np.broadcast_to(slope, (len(grid), *slope.shape))
    log_width = np.zeros(len(grid))
    if quadrature is not None:
        step = np.gradient(grid)
        # within a cell the effect is linear, its score spread by half the step
        along = -np.gradient(r, grid, axis=0) * (0.5 * step)[:, None]
        columns = np.concatenate((columns, along[..., None]), axis=2)
        log_width = np.log(step) - 0.5 * grid**2 - 0.5 * np.log(2 * np.pi)
    if comparison.noise is None:
        nodes = _log_density(r, columns, sigma) + log_width
    else:
        base = comparison.listed.variance * weight**2
        scale = comparison.listed.scale * weight
        each = np.stack(
            [_log_density(r, columns, np.sqrt(base + (s * scale) ** 2)) + log_width for s in _AMPLITUDES]
        )
        nodes = np.asarray(logsumexp(each, b=_AMPLITUDE_WEIGHTS[:, None], axis=0))
    # densities over log frequencies, carried to frequencies
    total = float(logsumexp(nodes))
    n_rest = len(z) - (quadrature is not None)
    return Marginal(
        comparison=comparison,
        quadrature=quadrature,
        log_evidence=total + float(np.log(weight).sum()) + comparison.listed.log_constant,
        error=np.nan,
        z=at,
        curvature=np.tile(np.eye(n_rest), (len(at), 1, 1)),
        weight=np.exp(nodes - total),
        draws=comparison.scores.to_x(at),
        log_weight=nodes - total,
        is_climbed=False,
    )


def _log_density(r: Array, columns: Array, sigma: Array) -> Array:
    """Log density of residuals (k, n) under N(0, diag sigma^2 + C C^T), C (k, n, p), (k,)."""
    n = r.shape[1]
    c = columns / sigma[:, None]
    precision = np.eye(n) + c @ np.swapaxes(c, 1, 2)
    scaled = r / sigma
    solved = np.linalg.solve(precision, scaled[..., None])[..., 0]
    _, log_det = np.linalg.slogdet(precision)
    return np.asarray(
        -0.5 * np.sum(scaled * solved, axis=1)
        - 0.5 * log_det
        - np.log(sigma).sum()
        - 0.5 * n * np.log(2 * np.pi)
    )


def _log_f(comparison: Comparison, z: Array) -> Array:
    f, _ = comparison.predict(comparison.scores.to_x(z))
    return np.log(f)


def _slope(comparison: Comparison, z: Array, free: Array) -> Array:
    """d ln f / d z of the constants, (n_f, n_free)."""
    x = comparison.scores.to_x(z)[None]
    f, slope = comparison.predict(x, jacobian=True)
    assert slope is not None
    found = slope[0] * comparison.scores.slope(x, z[None])[0] / f[0][:, None]
    return np.asarray(found[:, free])
