"""Evidence of stacking sequences by importance sampling, many sequences at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp, ndtri
from scipy.stats import chi2, qmc

from cpam_bayes.forward_model.focused import focused
from cpam_bayes.stacking.conditional.posterior import (
    CURVATURE_FLOOR,
    ConditionalFits,
    ConditionalPosterior,
    joined,
)
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Degrees of freedom and widening of the proposals of importance sampling.
_NU, _WIDER = 6.0, 1.1
# Draws of the constants that are kept of each sequence.
_KEPT = 8
# Points of importance sampling that are solved for together.
_POINTS = 2048
# Fractions of the points that each proposal gets where it is refitted.
_STAGES = (0.25, 0.25, 0.5)
# Unsure evidences get 2^m times as many points, for each m in turn while they stay so.
_MORE = (2, 4)
# Basis for one sequence: sets of constants that it is made from, how much wider than the posterior they
# lie, its relative error, and the most of that in noises.
_OWN_SETS, _OWN_WIDER, _OWN_ERROR, _OWN_SHARE = 64, 1.5, 1e-3, 0.05
# Points a dimension that the first proposal counts as where it is refitted.
_PRIOR_POINTS = 3.0
# Shares of optima that count in a proposal, and the least that one then has.
_USED, _LEAST_SHARE = 1e-4, 0.1


@dataclass(frozen=True, slots=True)
class RefinementSettings:
    """When importance sampling of a stacking sequence takes more trouble.

    refitted_from : log2 of the points from which on the proposal is refitted.
    resampled_from : log2 of the points from which on an unsure evidence is sampled again.
    unsure : standard error of a log evidence that is.
    large : functions in a block from which on an unsure sequence gets a basis for itself.
    """

    refitted_from: int = 7
    resampled_from: int = 9
    unsure: float = 0.08
    large: int = 60


DEFAULT_REFINEMENT = RefinementSettings()


@dataclass(frozen=True, slots=True)
class Conditionals:
    """The conditional posteriors of m sequences by importance sampling.

    log_evidence : (m,); error : (m,) its standard error, that of independent draws, an upper bound.
    mean, sd : (m, n) of the parameters; draws : (m, 8, n), equally probable.
    """

    log_evidence: Array
    error: Array
    mean: Array
    sd: Array
    draws: Array

    def __getitem__(self, rows: Any) -> Conditionals:
        """Those of some of the sequences."""
        return Conditionals(*(getattr(self, name)[rows] for name in self.__slots__))


@single_blas_thread
def importance_evidence(
    own: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int = 9,
    *,
    settings: RefinementSettings = DEFAULT_REFINEMENT,
) -> Conditionals:
    """Conditional posteriors of sequences by importance sampling about their optima.

    The proposal is a mixture of Student-t densities about the optima. Of 128 points or more a quarter is
    spent on it; its components then take mean and covariance of the posterior that these found, and
    once more after the next quarter. All points are weighed against the blend of the proposals (Cornuet
    et al., 2012). They are those of a Sobol sequence, scrambled in the same way for every sequence, so
    that differences between sequences are known better than each alone. Evidences of 512 points and
    more that stay unsure are sampled again with four times as many, and with sixteen times, where solves
    are slow on bases that are made for each.
    """
    found = _in_parts(own, angles_deg, fits, log2_points, settings)
    for more in _MORE if log2_points >= settings.resampled_from else ():
        unsure = np.flatnonzero(found.error > settings.unsure)
        if not len(unsure):
            break
        again = joined(
            [
                _importance(basis, angles_deg[[i]], fits[[i]], log2_points + more, settings)
                for i in unsure
                for basis in [_on_own_basis(own, angles_deg[i], found[i], settings.large)]
            ]
        )
        place = np.arange(len(angles_deg))
        place[unsure] = len(angles_deg) + np.arange(len(unsure))
        found = joined([found, again])[place]
    return found


def _in_parts(
    own: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int,
    settings: RefinementSettings,
) -> Conditionals:
    each = max(_POINTS >> log2_points, 1)
    return joined(
        [
            _importance(own, angles_deg[i : i + each], fits[i : i + each], log2_points, settings)
            for i in range(0, len(angles_deg), each)
        ]
    )


def _on_own_basis(
    own: ConditionalPosterior, angles_deg: Array, known: Conditionals, large: int
) -> ConditionalPosterior:
    """The posterior on a basis for one sequence (k,) and what is known of its constants.

    These are spread independently, which covers the posterior whatever its correlations are.
    """
    if max(block.size for block in own.model.fast.operator.blocks) < large:
        return own
    p = own.parameters
    spread = ndtri(qmc.Sobol(p.size, rng=np.random.default_rng(0)).random(_OWN_SETS))
    some = np.clip(known.mean + _OWN_WIDER * known.sd * spread, p.lower, p.upper)
    some = np.concatenate((known.draws, some[np.isfinite(own.template.log_prior(some))]))
    noise = float(own.relative_noise(known.draws).min())
    constants = some[:, : own.template.model.parameters.size]
    x = np.column_stack((np.broadcast_to(angles_deg, (len(some), len(angles_deg))), constants))
    return replace(own, model=focused(own.model, x, min(_OWN_ERROR, _OWN_SHARE * noise)))


@dataclass(frozen=True, slots=True)
class _Proposals:
    """Mixtures of Student-t densities over normal scores, one for each of m sequences.

    share : (m, s). centre : (m, s, n). factor : (m, s, n, n) lower Cholesky factors.
    """

    share: Array
    centre: Array
    factor: Array

    def points(self, step: Array, uniform: Array) -> Array:
        """Points (m, p, n) from those of a standard Student-t (p, n) and uniform numbers (p, 1)."""
        component = np.sum(np.cumsum(self.share, axis=1)[:, None, :-1] < uniform[:, None], axis=2)
        row = np.arange(len(self.share))[:, None]
        moved = np.einsum("mpij,pj->mpi", self.factor[row, component], step)
        return np.asarray(self.centre[row, component] + moved)

    def log_components(self, z: Array) -> Array:
        """Log of share times density of every component at points (m, p, n), (m, s, p)."""
        m, s = self.share.shape
        found = np.full((m, s, z.shape[1]), -np.inf)
        for j in range(s):
            rows = np.flatnonzero(self.share[:, j] > 0.0)
            away = z[rows] - self.centre[rows, j][:, None, :]
            own = _log_student_t(away, self.factor[rows, j])
            found[rows, j] = np.log(self.share[rows, j])[:, None] + own
        return found


def _about_optima(fits: ConditionalFits) -> _Proposals:
    used = fits.weight > _USED
    share = np.where(used, np.maximum(fits.weight, _LEAST_SHARE), 0.0)
    n = fits.optima.shape[2]
    covariance = np.linalg.inv(fits.curvature + CURVATURE_FLOOR * np.eye(n))
    return _Proposals(
        share / share.sum(axis=1, keepdims=True), fits.optima, np.linalg.cholesky(covariance) * _WIDER
    )


def _log_blend(proposals: list[_Proposals], stages: tuple[float, ...], z: Array) -> Array:
    """Log density at points (m, p, n) of what they were drawn from, each proposal at its stage, (m, p)."""
    parts = [
        p.log_components(z) + np.log(stage)
        for p, stage in zip(proposals, stages[: len(proposals)], strict=True)
    ]
    every = logsumexp(np.concatenate(parts, axis=1), axis=1)
    return np.asarray(every - np.log(sum(stages[: len(proposals)])))


def _refitted(before: _Proposals, z: Array, log_weight: Array) -> _Proposals:
    """The mixtures with the moments that weighted points (m, p, n) give their components.

    A component that few points speak of stays near where it was.
    """
    n = z.shape[2]
    parts = before.log_components(z)
    log_q = logsumexp(parts, axis=1)
    weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    member = np.exp(parts - log_q[:, None, :]) * weight[:, None, :]
    held = member.sum(axis=2)
    share = np.where(before.share > 0.0, np.maximum(held, _LEAST_SHARE), 0.0)
    scale = np.maximum(held, 1e-300)[:, :, None]
    number = (held**2 / np.maximum(np.sum(member**2, axis=2), 1e-300))[:, :, None]
    trust = number / (number + _PRIOR_POINTS * n)
    mean = np.einsum("msp,mpi->msi", member / scale, z)
    centre = before.centre + trust * (mean - before.centre)
    away = z[:, None] - centre[:, :, None, :]
    covariance = np.einsum("msp,mspi,mspj->msij", member / scale, away, away)
    old = before.factor @ np.swapaxes(before.factor, 2, 3)
    trust = trust[..., None]
    factor = np.linalg.cholesky(trust * _WIDER**2 * covariance + (1.0 - trust) * old)
    return _Proposals(share / share.sum(axis=1, keepdims=True), centre, factor)


def _importance(
    own: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int,
    settings: RefinementSettings,
) -> Conditionals:
    axes, n = own.axes, fits.optima.shape[2]
    size = 1 << log2_points
    row = np.arange(len(angles_deg))[:, None]
    step, uniform = _proposal_points(n, log2_points)
    used = _STAGES if log2_points >= settings.refitted_from else (1.0,)
    stops = np.cumsum([0, *(round(stage * size) for stage in used)])
    proposals, z, log_target = [_about_optima(fits)], np.empty((len(row), 0, n)), np.empty((len(row), 0))
    for i in range(len(used)):
        if i:
            proposals.append(_refitted(proposals[-1], z, log_target - _log_blend(proposals, used, z)))
        more = proposals[i].points(step[stops[i] : stops[i + 1]], uniform[stops[i] : stops[i + 1]])
        z = np.concatenate((z, more), axis=1)
        log_target = np.concatenate((log_target, _log_density(own, angles_deg, more)), axis=1)
    log_ratio = log_target - _log_blend(proposals, used, z)
    top = log_ratio.max(axis=1)
    weights = np.exp(log_ratio - top[:, None])
    mean_weight = weights.mean(axis=1)
    share = weights / weights.sum(axis=1, keepdims=True)
    x = axes.to_x(z)
    mean = np.einsum("mp,mpj->mj", share, x)
    sd = np.sqrt(np.einsum("mp,mpj->mj", share, (x - mean[:, None, :]) ** 2))
    # systematic resampling over the points as the Sobol sequence has them, which is as good as at random
    places = (np.arange(_KEPT) + 0.5) / _KEPT
    kept = np.sum(np.cumsum(share, axis=1)[:, :, None] < places, axis=1)
    draws = x[row, np.minimum(kept, size - 1)]
    error = weights.std(axis=1) / mean_weight / np.sqrt(size)
    return Conditionals(top + np.log(mean_weight), error, mean, sd, draws)


def _log_density(own: ConditionalPosterior, angles_deg: Array, z: Array) -> Array:
    """Log density over normal scores z (m, p, n), row i having the sequence i, (m, p)."""
    axes, (m, p, n) = own.axes, z.shape
    z = z.reshape(m * p, n)
    x = axes.to_x(z)
    inside = np.all((z >= axes.lower) & (z <= axes.upper), axis=1) & np.isfinite(own.template.log_prior(x))
    found = np.full(m * p, -np.inf)
    # every row of a stack must have its parameter set: those outside the support go first
    rows = np.flatnonzero(inside)
    if len(rows):
        at = own.at(angles_deg, rows // p)
        found[rows] = at.log_prob(x[rows]) + np.log(axes.slope(x[rows], z[rows])).sum(axis=1)
    return found.reshape(m, p)


@cache
def _proposal_points(n: int, log2_points: int) -> tuple[Array, Array]:
    """Points of a standard Student-t (2^log2_points, n), and uniform ones that choose its component."""
    uniform = qmc.Sobol(n + 2, rng=np.random.default_rng(0)).random(1 << log2_points)
    # a Student-t is a Gaussian over the root of a chi-squared variable
    return ndtri(uniform[:, :n]) / np.sqrt(chi2.ppf(uniform[:, n], _NU) / _NU)[:, None], uniform[:, n + 1]


def _log_student_t(away: Array, factor: Array) -> Array:
    """Log density of Student-t's ``away`` (m, p, n) from their centres, factors (m, n, n), (m, p)."""
    n = away.shape[2]
    squared = np.sum(np.einsum("mij,mpj->mpi", np.linalg.inv(factor), away) ** 2, axis=2)
    log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    constant = gammaln(0.5 * (_NU + n)) - gammaln(0.5 * _NU) - 0.5 * n * np.log(_NU * np.pi)
    return np.asarray(constant - log_det[:, None] - 0.5 * (_NU + n) * np.log1p(squared / _NU))
