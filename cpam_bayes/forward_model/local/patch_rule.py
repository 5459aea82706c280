"""Quadrature over a patch of a plate, one direction at a time, and how it moves with the patch."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

Array = NDArray[Any]
PatchForm = Literal["bell", "rectangle"]

# Widths of a bell within which it is integrated: beyond lie 5e-4 of it. Points that its measure has there.
_REACH, _FINE = 3.5, 48


@dataclass(frozen=True, slots=True)
class PatchRule:
    """Points of m patches in one direction, clipped by the plate, all (m, n).

    points : reference coordinate
    weight : of the integral with the profile g
    per_centre, per_width : derivatives of the integral over centre and width of the patch, as weights
    """

    points: Array
    weight: Array
    per_centre: Array
    per_width: Array


def patch_rules(
    form: PatchForm, centre: Array, width: Array, n: Array, with_ends: bool
) -> tuple[PatchRule, PatchRule]:
    """The rules in x and y of patches with centres and widths (m, 2), of n (m,) points each.

    Where others have more, further points without weight follow.

    with_ends : so that the rules tell how the integrals change, which those of a rectangle do at its ends
    """
    m = len(n)
    rule = _bell if form == "bell" else _rectangle
    # both directions at once
    both = rule(centre.T.ravel(), width.T.ravel(), np.concatenate((n, n)), with_ends)
    x, y = (
        PatchRule(*(getattr(both, f.name)[rows] for f in fields(PatchRule)))
        for rows in (slice(0, m), slice(m, None))
    )
    return x, y


def _bell(centre: Array, width: Array, n: Array, with_ends: bool) -> PatchRule:
    """Gauss's rule for the bell as a weight; beyond the plate there is none of it."""
    start, end = centre - _REACH * width, centre + _REACH * width
    low, high = np.maximum(start, 0.0), np.minimum(end, 1.0)
    nodes, weights = _nodes(_FINE)
    fine = low[:, None] + (high - low)[:, None] * nodes
    distance = (fine - centre[:, None]) / width[:, None]
    points, weight = _gauss(fine, (high - low)[:, None] * weights * np.exp(-0.5 * distance**2), n)
    distance = (points - centre[:, None]) / width[:, None]
    per_centre = weight * distance / width[:, None]
    return PatchRule(points, weight, per_centre, per_centre * distance)


def _rectangle(centre: Array, width: Array, n: Array, with_ends: bool) -> PatchRule:
    start, end = centre - width, centre + width
    low, high = np.maximum(start, 0.0), np.minimum(end, 1.0)
    first = 1 if with_ends else 0
    nodes, weights = np.full((len(n), n.max() + 2 * first), 0.5), np.zeros((len(n), n.max() + 2 * first))
    for count in np.unique(n).tolist():
        at = np.ix_(n == count, np.arange(first, first + count))
        nodes[at], weights[at] = _nodes(count)
    per_centre, per_width = np.zeros_like(nodes), np.zeros_like(nodes)
    if with_ends:
        for column, free, sign in ((0, start > 0.0, -1.0), (-1, end < 1.0, 1.0)):
            nodes[:, column] = max(sign, 0.0)
            per_centre[:, column] = sign * free
            per_width[:, column] = free
    points = low[:, None] + (high - low)[:, None] * nodes
    return PatchRule(points, (high - low)[:, None] * weights, per_centre, per_width)


def _gauss(points: Array, weights: Array, n: Array) -> tuple[Array, Array]:
    """Gauss's rules of n (m,) points for the discrete measures of weights (m, k) at points (m, k).

    By the recurrence of their orthogonal polynomials (Stieltjes) and its tridiagonal matrix (Golub and
    Welsch, Math. Comp. 23, 1969), which falls apart after n rows.
    """
    most = int(n.max())
    whole = weights.sum(axis=1)
    matrix = np.zeros((len(points), most, most))
    before, now = np.zeros_like(points), np.ones_like(points) / np.sqrt(whole)[:, None]
    beta = np.zeros(len(points))
    for k in range(most):
        matrix[:, k, k] = alpha = np.sum(points * weights * now**2, axis=1)
        if k + 1 == most:
            break
        after = (points - alpha[:, None]) * now - beta[:, None] * before
        beta = np.sqrt(np.sum(weights * after**2, axis=1))
        before, now = now, after / beta[:, None]
        matrix[:, k, k + 1] = matrix[:, k + 1, k] = np.where(k + 1 < n, beta, 0.0)
    at, vectors = np.linalg.eigh(matrix)
    return at, whole[:, None] * vectors[:, 0] ** 2


@lru_cache
def _nodes(n: int) -> tuple[Array, Array]:
    """Points and weights on [0, 1] of Gauss's rule."""
    t, weights = legendre.leggauss(n)
    return 0.5 * (t + 1.0), 0.5 * weights
