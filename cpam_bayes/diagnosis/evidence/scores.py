"""Coordinates in which every prior is standard normal: no bounds, flat directions integrated exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln, ndtr, ndtri, stdtr, stdtrit

from cpam_bayes.parameters import ParameterSet, ScaledStudentT, TruncatedNormal, Uniform

Array = NDArray[Any]

# Scores beyond are rounding.
FARTHEST = 7.0
_UNIFORM, _NORMAL, _STUDENT = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Scores:
    """z with Phi(z) = F(x), F the distribution function of a parameter's prior, for n parameters.

    shape : (n,) which family a prior is of. loc, scale : (n,), of a uniform prior its lower bound and
    width. low, mass : (n,) distribution function at the lower cut, and the share between the cuts, both
    of the variable mirrored by ``sign`` (n,) to the tail where they are accurate. freedom : (n,) of the
    Student-t ones.
    """

    shape: Array
    loc: Array
    scale: Array
    low: Array
    mass: Array
    sign: Array
    freedom: Array
    lower: Array
    upper: Array

    def to_x(self, z: Array) -> Array:
        """Parameters (..., n) of scores (..., n)."""
        share = self.low + self.mass * ndtr(self.sign * z)
        inner = np.where(self.shape == _UNIFORM, share, 0.0)
        normal, student = self.shape == _NORMAL, self.shape == _STUDENT
        inner[..., normal] = ndtri(share[..., normal])
        inner[..., student] = stdtrit(self.freedom[student], share[..., student])
        return np.asarray(np.clip(self.loc + self.sign * self.scale * inner, self.lower, self.upper))

    def to_z(self, x: Array) -> Array:
        """Scores (..., n) of parameters (..., n)."""
        inner = self.sign * (np.clip(x, self.lower, self.upper) - self.loc) / self.scale
        share = inner.copy()
        normal, student = self.shape == _NORMAL, self.shape == _STUDENT
        share[..., normal] = ndtr(inner[..., normal])
        share[..., student] = stdtr(self.freedom[student], inner[..., student])
        with np.errstate(divide="ignore"):
            z = self.sign * ndtri(np.clip((share - self.low) / self.mass, 0.0, 1.0))
        return np.asarray(np.clip(z, -FARTHEST, FARTHEST))

    def slope(self, x: Array, z: Array) -> Array:
        """d x / d z, (..., n): the density of the standard normal over that of the prior."""
        inner = (x - self.loc) / self.scale
        nu = self.freedom
        log_density = np.where(self.shape == _NORMAL, -0.5 * (inner**2 + np.log(2 * np.pi)), 0.0)
        student = -0.5 * (nu + 1) * np.log1p(inner**2 / nu) - 0.5 * np.log(nu) - betaln(0.5, 0.5 * nu)
        log_density = np.where(self.shape == _STUDENT, student, log_density)
        log_normal = -0.5 * (z**2 + np.log(2 * np.pi))
        return np.asarray(self.scale * self.mass * np.exp(log_normal - log_density))


def scores_of(parameters: ParameterSet) -> Scores:
    """The scores of a parameter set."""
    rows = []
    for parameter in parameters.parameters:
        p = parameter.prior
        if isinstance(p, Uniform):
            rows.append((_UNIFORM, p.lower, p.upper - p.lower, 0.0, 1.0, 1.0, 1.0))
            continue
        if isinstance(p, TruncatedNormal):
            kind, loc, nu, width = _NORMAL, p.loc, 1.0, p.scale
        else:
            assert isinstance(p, ScaledStudentT)
            kind, loc, nu, width = _STUDENT, 0.0, p.degrees_of_freedom, p.scale
        a, b = (p.lower - loc) / width, (p.upper - loc) / width
        mirror = 1.0
        if a > 0.0:
            a, b, mirror = -b, -a, -1.0
        below, above = (float(ndtr(v)) if kind == _NORMAL else float(stdtr(nu, v)) for v in (a, b))
        rows.append((kind, loc, width, below, above - below, mirror, nu))
    columns = np.array(rows, dtype=float).reshape(-1, 7).T
    shape, location, scale, low, mass, sign, freedom = columns
    return Scores(shape, location, scale, low, mass, sign, freedom, parameters.lower, parameters.upper)
