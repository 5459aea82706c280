"""The Laplace approximation over the nodes of a quadrature as one mixture of Student-t densities."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.student_mixture import Mixture

Array = NDArray[Any]

# Fraction of the mass below which a node proposes nothing.
_LEAST_FRACTION = 1e-4


def about_nodes(
    z: Array, curvature: Array, weight: Array, quadrature: int | None, wider: float, freedom: float
) -> Mixture:
    """A stack of one mixture with a component at every node that carries mass.

    Along the score of the quadrature a component is as wide as its node is far from the next ones, and
    the optimum of the other scores is carried along.

    z : (k, n) optima at the nodes.
    curvature : (k, n - 1, n - 1), or (1, n, n) without quadrature.
    weight : (k,).
    wider : factor on all widths.
    freedom : degrees of freedom of the Student-t.
    """
    used = np.flatnonzero(weight >= _LEAST_FRACTION)
    share = weight[used] / weight[used].sum()
    factor = np.linalg.cholesky(np.linalg.inv(curvature[used]))
    if quadrature is not None:
        n, score = z.shape[1], z[:, quadrature]
        rest = np.delete(np.arange(n), quadrature)
        width = _spacing(score)[used]
        whole = np.zeros((len(used), n, n))
        whole[:, rest, : n - 1] = factor
        whole[:, rest, n - 1] = width[:, None] * _slopes(score, z[:, rest])[used]
        whole[:, quadrature, n - 1] = width
        factor = whole
    return Mixture(share[None], z[None, used], wider * factor[None], freedom)


def _spacing(score: Array) -> Array:
    """Half the distance between the neighbours of every node, (k,)."""
    padded = np.concatenate((score[:1] - np.diff(score[:2]), score, score[-1:] + np.diff(score[-2:])))
    return np.asarray(0.5 * (padded[2:] - padded[:-2]))


def _slopes(score: Array, rest: Array) -> Array:
    """How the optimum of the rest moves with the score, (k, n - 1); none where it jumps."""
    slope = np.gradient(rest, score, axis=0)
    return np.where(np.abs(slope) < 3.0, slope, 0.0)
