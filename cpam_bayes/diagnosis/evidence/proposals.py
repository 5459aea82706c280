"""Proposals of importance sampling about a Laplace picture: a mixture over the nodes of a quadrature."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, logsumexp, ndtri
from scipy.stats import qmc

from cpam_bayes.inference.truncated import log_student_t

Array = NDArray[Any]

# Log2 of the points, and the share of the mass below which a node proposes nothing.
_LOG2_POINTS, _LEAST_SHARE = 9, 1e-4
_HALF_LOG_2PI = 0.5 * np.log(2 * np.pi)


def proposed(
    z: Array, curvature: Array, weight: Array, quadrature: int | None, wider: float, freedom: float
) -> tuple[Array, Array]:
    """Scores (d, n) near a Laplace picture from a scrambled Sobol sequence, and their log density, (d,).

    The score gone through by the quadrature is Gaussian about a node, the others are Student-t about the
    optimum there, which is carried along between nodes. z : (k, n) optima at the nodes; curvature : (k, n -
    1, n - 1), or (1, n, n) without quadrature; weight : (k,). wider : factor on all widths. freedom : of the
    Student-t.
    """
    nodes, n = z, z.shape[1]
    used = np.flatnonzero(weight >= _LEAST_SHARE)
    share = weight[used] / weight[used].sum()
    uniform = qmc.Sobol(n + 2, rng=np.random.default_rng(0)).random_base2(_LOG2_POINTS)
    uniform = np.clip(uniform, 1e-12, 1 - 1e-12)
    which = np.searchsorted(np.cumsum(share)[:-1], uniform[:, n + 1])
    normal = ndtri(uniform[:, :n])
    stretch = np.ones(len(uniform))
    if np.isfinite(freedom):  # a Student-t is a Gaussian over the root of a chi-squared variable
        stretch = 1.0 / np.sqrt(chdtri(freedom, 1.0 - uniform[:, n]) / freedom)
    factor = np.linalg.cholesky(np.linalg.inv(curvature[used])) * wider
    if quadrature is None:
        centre = nodes[used]
        step = np.einsum("mij,mj->mi", factor[which], normal) * stretch[:, None]
        z = centre[which] + step
        log_q = log_student_t(z, centre[0], factor[0], freedom)
        return z, np.asarray(log_q)
    q = quadrature
    columns = np.delete(np.arange(n), q)
    score, rest = nodes[used, q], nodes[np.ix_(used, columns)]
    width = _spacing(nodes[:, q])[used] * wider
    along = _slopes(nodes[:, q], nodes[:, columns])[used]
    t = score[which] + width[which] * normal[:, n - 1]
    step = np.einsum("mij,mj->mi", factor[which], normal[:, : n - 1]) * stretch[:, None]
    u = rest[which] + along[which] * (t - score[which])[:, None] + step
    log_q = np.stack(
        [
            np.log(share[k])
            - 0.5 * ((t - score[k]) / width[k]) ** 2
            - np.log(width[k])
            - _HALF_LOG_2PI
            + log_student_t(u - along[k] * (t - score[k])[:, None], rest[k], factor[k], freedom)
            for k in range(len(used))
        ]
    )
    return np.insert(u, q, t, axis=1), np.asarray(logsumexp(log_q, axis=0))


def _spacing(score: Array) -> Array:
    """Half the distance between the neighbours of every node, (k,)."""
    padded = np.concatenate((score[:1] - np.diff(score[:2]), score, score[-1:] + np.diff(score[-2:])))
    return np.asarray(0.5 * (padded[2:] - padded[:-2]))


def _slopes(score: Array, rest: Array) -> Array:
    """How the optimum of the rest moves with the score, (k, n - 1); none where it jumps."""
    found = np.gradient(rest, score, axis=0)
    return np.where(np.abs(found) < 3.0, found, 0.0)
