"""Signatures: the shifts of the frequencies by a cause, and the part that no constants can imitate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from cpam_bayes.diagnosis.evidence.marginal import Marginal, ShiftTable
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.effects import scale_of
from cpam_bayes.inference.log_density import CorrelatedDensity, kept_of
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array

# Two causes are distinguished below this cosine of their visible signatures.
ALIKE = 0.95
# A cause whose visible fraction is below this is absorbed by the constants.
ABSORBED = 0.1
# Best fits are compared for causes with at least this fraction of the leading one's probability. Fits are
# equal within so many nats of the log likelihood, and distinguished by so many where one cause has less than
# the last fraction of the other's probability.
_COMPARED, AS_WELL, _TOLD_APART, _HARDLY_PROBABLE = 5e-3, 2.0, 7.0, 1e-2
# A shift smaller than this fraction of the one that it is compared with has no direction.
HARDLY = 0.1
# Interpolated points of one size at which its shifts are compared with others.
_BETWEEN = 181


@dataclass(frozen=True, slots=True)
class Signature:
    """Relative shifts of the frequencies by one hypothesis at fixed constants.

    shift : (n_f,), in units of the noise, at the size that the data suggest
    visible : the part of it that the constants cannot imitate
    visible_fraction : norm of the visible shift over that of the whole
    bias : (n,) scores by which the constants move to imitate it
    largest : largest relative shift of a frequency at one standard deviation of the catalogue
    """

    shift: Array
    visible: Array
    visible_fraction: float
    bias: Array
    largest: float

    @property
    def is_absorbed(self) -> bool:
        """Whether the constants absorb it."""
        return self.visible_fraction < ABSORBED


@dataclass(frozen=True, slots=True)
class Projector:
    """Removal from a shift of the part that constants and tolerances can imitate within their priors.

    With A the derivatives of the frequencies by the scores and C the covariance by the tolerances, both in
    units of the noise, the precision of the data with these integrated out is (I + C + A A^T)^-1. root :
    (n_f, n_f) its square root, which maps a shift to its visible part. absorb : (n, n_f), maps a shift to the
    scores that imitate it.
    """

    root: Array
    absorb: Array


def projector_of(none: Marginal) -> Projector:
    """The projector about the optimum of the plain model."""
    comparison, z = none.comparison, none.z[:1]
    x = comparison.scores.to_x(z)
    _, slope = comparison.predict(x, jacobian=True)
    assert slope is not None
    sigma = np.sqrt(comparison.variance(x)[0])
    a = comparison.scores.by_score(slope, x, z)[0] / sigma[:, None]
    covariance = comparison.covariance(x)[0] / np.outer(sigma, sigma) + a @ a.T
    values, vectors = np.linalg.eigh(covariance)
    return Projector((vectors / np.sqrt(values)) @ vectors.T, a.T @ np.linalg.inv(covariance))


def signature_of(tested: Tested, none: Marginal, projector: Projector) -> Signature:
    """The signature of a hypothesis at the constants of the plain model.

    Its size is the root mean square of its posterior, with the sign of the mean where that is clear.
    """
    comparison = tested.as_plain or tested.marginal.comparison
    null = {p.name: 0.0 if p.null is None else p.null for p in tested.hypothesis.parameters}
    plain = comparison.carried(none.comparison, none.best)
    with_it, one_sd = plain.copy(), plain.copy()
    mean, sd = tested.marginal.moments()
    for parameter, column in zip(tested.hypothesis.parameters, tested.columns, strict=True):
        if parameter.name in tested.hypothesis.coordinates:
            plain[column] = with_it[column] = one_sd[column] = mean[column]
            continue
        plain[column] = null[parameter.name]
        size = np.hypot(mean[column] - null[parameter.name], sd[column])
        sign = -1.0 if mean[column] < null[parameter.name] else 1.0
        with_it[column] = null[parameter.name] + sign * size
        one_sd[column] = null[parameter.name] + scale_of(parameter)
    within = (comparison.parameters.lower, comparison.parameters.upper)
    points = np.clip(np.stack((plain, with_it, one_sd)), *within)
    try:
        f = _aligned(comparison, points, none)
    except RigidBodyError:  # a size at which the plate buckles: the opposite one
        buckled = np.delete(np.arange(len(points)), comparison.predict_inside(points)[0])
        points[buckled] = np.clip(2.0 * plain - points[buckled], *within)
        f = _aligned(comparison, points, none)
    if not all(e.parameters for e in tested.hypothesis.effects):  # no value of theirs gives back the plate
        bare = replace(comparison, model=comparison.model.without_changes())
        f = np.concatenate((_aligned(bare, points[:1], none), f[1:]))
    sigma = np.sqrt(none.comparison.variance(none.best[None])[0])
    listed = none.comparison.listed.frequencies
    shift = (f[1] - f[0]) / sigma
    visible = projector.root @ shift
    whole = float(np.linalg.norm(shift))
    fraction = float(np.linalg.norm(visible)) / whole if whole > 0.0 else 0.0
    return Signature(
        shift, visible, fraction, projector.absorb @ shift, float(np.abs((f[2] - f[0]) / listed).max())
    )


def cosine(a: Signature, b: Signature) -> float:
    """Cosine between the visible parts of two signatures, 0 where one of them is absorbed."""
    size = float(np.linalg.norm(a.visible) * np.linalg.norm(b.visible))
    if a.is_absorbed or b.is_absorbed or size == 0.0:
        return 0.0
    return float(a.visible @ b.visible) / size


def alike(
    signatures: Sequence[Signature], i: int, menus: Sequence[Sequence[Menu]] | None = None
) -> tuple[int, ...]:
    """Indices of the signatures that frequencies cannot distinguish from the i-th.

    menus : of every cause, the shifts of its variants at other sizes than their own optimum: a cause that can
    shift the frequencies as the i-th does is not distinguished from it.
    """
    indistinguishable = []
    for j, other in enumerate(signatures):
        best = abs(cosine(signatures[i], other))
        if menus is not None and not signatures[i].is_absorbed:
            best = max([best, *(menu.cosine(signatures[i].visible) for menu in menus[j])])
        if j != i and best > ALIKE:
            indistinguishable.append(j)
    return tuple(indistinguishable)


def compared_by_fits(
    best: Mapping[str, Tested], probability: Mapping[str, float], by_signature: Mapping[str, Sequence[str]]
) -> dict[str, Tested]:
    """Causes whose fits are compared.

    Improbable ones are left out, except those with the signature of the leading one, and another material.

    best : best variant of every cause
    by_signature : by cause, those with equal visible signatures
    """
    if not best:
        return {}
    leading = max(best, key=lambda name: probability[name])
    top = probability[leading]
    return {
        name: t
        for name, t in best.items()
        if probability[name] > _COMPARED * top
        or name in by_signature[leading]
        or (t.hypothesis.other_material and top > probability["none"])
    }


def with_equal_fits(
    by_signature: Mapping[str, Sequence[str]], peak: Mapping[str, float], probability: Mapping[str, float]
) -> dict[str, tuple[str, ...]]:
    """Causes indistinguishable from each one: those with its signature, and those that fit as well.

    A gross effect may be imitated by another that moves the constants far: the data prefer neither by more
    than e^2. It is distinguished from one with its signature that fits worse by more than e^7 at any size and
    is less probable by a factor of 0.01.

    by_signature : by cause, those with equal visible signatures
    peak : largest log likelihood of the causes whose fits are compared
    """
    indistinguishable = {}
    for name, others in by_signature.items():
        behind = {c: peak[name] - peak[c] for c in peak if c != name} if name in peak else {}
        as_well = [c for c, nats in behind.items() if nats < AS_WELL]
        hardly = {c for c in behind if probability[c] < _HARDLY_PROBABLE * probability[name]}
        kept = [c for c in others if c not in hardly or behind[c] < _TOLD_APART]
        indistinguishable[name] = tuple(dict.fromkeys([*kept, *as_well]))
    return indistinguishable


@dataclass(frozen=True, slots=True)
class Menu:
    """Possible shifts of the frequencies by one variant of a cause.

    visible : (k, n_f) visible part of its shifts at k sizes, in units of the noise
    visible_fraction : (k,) their norms over those of the whole shifts
    """

    visible: Array
    visible_fraction: Array

    def cosine(self, target: Array) -> float:
        """Absolute cosine of a visible shift (n_f,) with the nearest of these; 0 if that is absorbed."""
        i = nearest_of(self.visible, target)
        size = float(np.linalg.norm(self.visible[i]) * np.linalg.norm(target))
        if size == 0.0 or self.visible_fraction[i] < ABSORBED:
            return 0.0
        return abs(float(self.visible[i] @ target)) / size


def nearest_of(visible: Array, target: Array) -> int:
    """Index of the visible shift, among (k, n_f), that is nearest to one (n_f,).

    Negligible shifts are passed over: they have no direction.
    """
    norm = np.linalg.norm(visible, axis=1)
    there = norm >= HARDLY * np.linalg.norm(target)
    if not there.any():
        return int(np.argmax(norm))
    away = np.where(there, np.sum((visible - target) ** 2, axis=1), np.inf)
    return int(np.argmin(away))


def menu_of(tested: Tested, none: Marginal, projector: Projector) -> Menu | None:
    """Menu of a tested hypothesis at the constants of the plain model, ``None`` if its shifts are unknown."""
    if tested.shift is None:
        return None
    sigma = np.sqrt(none.comparison.variance(none.best[None])[0])
    shift = _fine(tested.shift) * (none.comparison.listed.frequencies / sigma)
    visible = shift @ projector.root
    whole = np.linalg.norm(shift, axis=1)
    fraction = np.linalg.norm(visible, axis=1) / np.where(whole > 0.0, whole, np.inf)
    return Menu(visible, fraction)


def _fine(table: ShiftTable) -> Array:
    """Shifts interpolated between the nodes of one size, or at the nodes of several sizes or of none."""
    if table.scores.shape[1] != 1:
        return table.shift
    score = table.scores[:, 0]
    fine = np.linspace(score[0], score[-1], _BETWEEN)
    return np.asarray(CubicSpline(score, table.shift, axis=0)(fine))


def _aligned(comparison: CorrelatedDensity, x: Array, none: Marginal) -> Array:
    """Predictions (m, n_f) for every frequency of the whole list at parameters (m, n).

    A hypothesis about the list changes the pairing: its null is the plain pairing. A false peak is predicted
    as measured.
    """
    f, _ = comparison.predict(x)
    plain, _ = none.comparison.predict(none.best[None])
    n = plain.shape[1]
    if f.shape[1] == n:
        parts = zip(comparison.model.parts, none.comparison.model.parts, strict=True)
        if all(np.array_equal(a.modes, b.modes) for a, b in parts):
            return f
        return np.concatenate((plain, f[1:]))
    listed = none.comparison.listed.frequencies
    kept = kept_of(listed, comparison.listed.frequencies)
    whole = np.tile(listed, (len(x), 1))
    whole[:, kept] = f
    return np.concatenate((plain, whole[1:]))
