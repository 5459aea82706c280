"""Optima of one model between which the lists do not decide, and the modes whose order they differ in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cpam_bayes.diagnosis.evidence.optima import maximised
from cpam_bayes.diagnosis.evidence.tested import Tested
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.inference.optimise import Array

# Fraction of the posterior from which an optimum is reported; nodes that optima are sought from, and the
# fraction that makes one worth it.
_LEAST_FRACTION, _MOST_STARTS, _START_FRACTION = 0.03, 12, 3e-3
# Steps of an optimisation at most, and the gain, nats, that ends it.
_MOST_STEPS, _PROMISED = 60, 1e-3
# Constants agree within so many standard deviations.
_SAME_SD = 2.0


@dataclass(frozen=True, slots=True)
class OpenOptimum:
    """One of several optima of the posterior.

    fraction : of the posterior about it
    constants : name -> value there, SI
    modes : labels of the modes in the lists' places, plate by plate
    """

    fraction: float
    constants: Mapping[str, float]
    modes: tuple[tuple[str, ...], ...]

    def differences(self, other: OpenOptimum) -> tuple[tuple[int, int, str, str], ...]:
        """Plate, number of the frequency from 0 and labels at both, where the mode is another one."""
        return tuple(
            (i, k, a, b)
            for i, (here, there) in enumerate(zip(self.modes, other.modes, strict=True))
            for k, (a, b) in enumerate(zip(here, there, strict=True))
            if a != b
        )


def open_optima(t: Tested, cases: Sequence[PlateCase]) -> tuple[OpenOptimum, ...]:
    """The optima of a hypothesis that carry probability, the most probable first; none where it is one.

    Every draw of the posterior counts for the optimum that is nearest in standard deviations.
    """
    marginal, comparison = t.marginal, t.marginal.comparison
    starts = marginal.z[:_MOST_STARTS][marginal.weight[:_MOST_STARTS] > _START_FRACTION]
    if len(starts) < 2:
        return ()
    optima, _ = maximised(comparison, starts, _MOST_STEPS, _PROMISED)
    z, curvature = optima.z, optima.curvature
    draws = comparison.scores.to_z(marginal.draws)
    away = draws[:, None] - z
    nearest = np.einsum("dki,kij,dkj->dk", away, curvature, away).argmin(axis=1)
    fraction = np.bincount(nearest, np.exp(marginal.log_weight), minlength=len(z))
    constants_at = [comparison.parameters.names.index(name) for name in _unknowns(t, cases)]
    carry, fraction = _apart(z[:, constants_at], curvature, constants_at, fraction)
    if len(carry) < 2:
        return ()
    sizes = {p.name for p in t.hypothesis.parameters}
    open_ones = []
    for best in carry:
        x = comparison.scores.to_x(z[best])
        names = comparison.model.parameters.names
        constants = {name: float(value) for name, value in zip(names, x, strict=False) if name not in sizes}
        modes = []
        for case, part in zip(t.cases or cases, comparison.model.parts, strict=True):
            every = case.models.bare.full.modes(part.plate_vector(x[None])[0])
            labels = [every[j].label if j < len(every) else "" for j in part.modes]
            for k in np.flatnonzero(case.modes < 0):  # false peaks of an incomplete list
                labels.insert(int(k), "")
            modes.append(tuple(labels))
        open_ones.append(OpenOptimum(float(fraction[best]), constants, tuple(modes)))
    return tuple(open_ones)


def _unknowns(t: Tested, cases: Sequence[PlateCase]) -> list[str]:
    """Names of the unknown constants that are parameters of the hypothesis."""
    names = dict.fromkeys(n for case in cases for n in case.models.specimen.unknowns.names)
    return [n for n in t.marginal.comparison.parameters.names if n in names]


def _apart(z: Array, curvature: Array, columns: list[int], fraction: Array) -> tuple[list[int], Array]:
    """Optima that carry probability and differ in a constant; others count for the one they agree with.

    A skew of either sign, or a mass at the mirrored place, leaves the constants where they are.
    """
    sd = np.sqrt(np.diagonal(np.linalg.inv(curvature), axis1=1, axis2=2)[:, columns])
    whole = np.zeros_like(fraction)
    carry: list[int] = []
    for k in np.argsort(-fraction, kind="stable"):
        same = [i for i in carry if np.all(np.abs(z[k] - z[i]) < _SAME_SD * np.maximum(sd[k], sd[i]))]
        at = same[0] if same else int(k)
        whole[at] += fraction[k]
        if not same:
            carry.append(int(k))
    return [k for k in carry if whole[k] > _LEAST_FRACTION], whole
