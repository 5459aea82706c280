"""Evidence of stacking sequences by importance sampling, many sequences at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.forward_model.focused import focused
from cpam_bayes.inference.importance import staged_importance
from cpam_bayes.inference.student_mixture import Mixture, shrunk_moments
from cpam_bayes.stacking.conditional.posterior import (
    CURVATURE_FLOOR,
    ConditionalFits,
    ConditionalPosterior,
    joined,
)
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Degrees of freedom and widening of the proposals of importance sampling. Light tails scatter less with few
# points; the mean of 512 weights is too small with them where a constant is left open.
_LIGHT, _HEAVY = (6.0, 1.1), (3.0, 1.3)
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
# Least weight of an optimum that counts in a proposal, and the least fraction that it then gets.
_USED, _LEAST_FRACTION = 1e-4, 0.1


@dataclass(frozen=True, slots=True)
class RefinementSettings:
    """When importance sampling of a stacking sequence takes more trouble.

    refitted_from : log2 of the points from which on the proposal is refitted.
    resampled_from : log2 of the points from which on the proposal has heavy tails, and an unsure evidence is
        sampled again.
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

    log_evidence : (m,).
    error, effective_size, k_hat : (m,) as in ``Weighted``.
    mean, sd : (m, n) of the parameters.
    draws : (m, 8, n), equally probable.
    """

    log_evidence: Array
    error: Array
    effective_size: Array
    k_hat: Array
    mean: Array
    sd: Array
    draws: Array

    def __getitem__(self, rows: Any) -> Conditionals:
        """Those of some of the sequences."""
        return Conditionals(*(getattr(self, name)[rows] for name in self.__slots__))


@single_blas_thread
def importance_evidence(
    conditional: ConditionalPosterior,
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
    found = _in_parts(conditional, angles_deg, fits, log2_points, settings)
    for more in _MORE if log2_points >= settings.resampled_from else ():
        unsure = np.flatnonzero(found.error > settings.unsure)
        if not len(unsure):
            break
        again = joined(
            [
                _importance(basis, angles_deg[[i]], fits[[i]], log2_points + more, settings)
                for i in unsure
                for basis in [_on_own_basis(conditional, angles_deg[i], found[i], settings.large)]
            ]
        )
        place = np.arange(len(angles_deg))
        place[unsure] = len(angles_deg) + np.arange(len(unsure))
        found = joined([found, again])[place]
    return found


def _in_parts(
    conditional: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int,
    settings: RefinementSettings,
) -> Conditionals:
    each = max(_POINTS >> log2_points, 1)
    return joined(
        [
            _importance(conditional, angles_deg[i : i + each], fits[i : i + each], log2_points, settings)
            for i in range(0, len(angles_deg), each)
        ]
    )


def _on_own_basis(
    conditional: ConditionalPosterior, angles_deg: Array, known: Conditionals, large: int
) -> ConditionalPosterior:
    """The posterior on a basis for one sequence (k,) and what is known of its constants.

    These are spread independently, which covers the posterior whatever its correlations are.
    """
    if max(block.size for block in conditional.model.fast.operator.blocks) < large:
        return conditional
    p = conditional.parameters
    spread = ndtri(qmc.Sobol(p.size, rng=np.random.default_rng(0)).random(_OWN_SETS))
    some = np.clip(known.mean + _OWN_WIDER * known.sd * spread, p.lower, p.upper)
    some = np.concatenate((known.draws, some[np.isfinite(conditional.template.log_prior(some))]))
    noise = conditional.least_noise(known.draws)
    constants = some[:, : conditional.template.model.parameters.size]
    x = np.column_stack((np.broadcast_to(angles_deg, (len(some), len(angles_deg))), constants))
    return replace(conditional, model=focused(conditional.model, x, min(_OWN_ERROR, _OWN_SHARE * noise)))


def _about_optima(fits: ConditionalFits, freedom: float, wider: float) -> Mixture:
    used = fits.weight > _USED
    share = np.where(used, np.maximum(fits.weight, _LEAST_FRACTION), 0.0)
    covariance = np.linalg.inv(fits.curvature + CURVATURE_FLOOR * np.eye(fits.optima.shape[2]))
    factor = np.linalg.cholesky(covariance) * wider
    return Mixture(share / share.sum(axis=1, keepdims=True), fits.optima, factor, freedom)


def _importance(
    conditional: ConditionalPosterior,
    angles_deg: Array,
    fits: ConditionalFits,
    log2_points: int,
    settings: RefinementSettings,
) -> Conditionals:
    stages = _STAGES if log2_points >= settings.refitted_from else (1.0,)
    target = partial(_log_density, conditional, angles_deg)
    freedom, wider = _HEAVY if log2_points >= settings.resampled_from else _LIGHT
    refitted = partial(shrunk_moments, least=_LEAST_FRACTION, wider=wider, prior_points=_PRIOR_POINTS)
    found = staged_importance(target, _about_optima(fits, freedom, wider), log2_points, stages, refitted)
    x = conditional.axes.to_x(found.points)
    mean = np.einsum("mp,mpj->mj", found.weight, x)
    sd = np.sqrt(np.einsum("mp,mpj->mj", found.weight, (x - mean[:, None, :]) ** 2))
    # systematic resampling over the points as the Sobol sequence has them, which is as good as at random
    places = (np.arange(_KEPT) + 0.5) / _KEPT
    kept = np.sum(np.cumsum(found.weight, axis=1)[:, :, None] < places, axis=1)
    draws = x[np.arange(len(x))[:, None], np.minimum(kept, x.shape[1] - 1)]
    return Conditionals(
        found.log_evidence, found.standard_error, found.effective_size, found.k_hat, mean, sd, draws
    )


def _log_density(conditional: ConditionalPosterior, angles_deg: Array, z: Array) -> Array:
    """Log density over normal scores z (m, p, n), row i having the sequence i, (m, p)."""
    axes, (m, p, n) = conditional.axes, z.shape
    z = z.reshape(m * p, n)
    x = axes.to_x(z)
    inside = np.all((z >= axes.lower) & (z <= axes.upper), axis=1) & np.isfinite(
        conditional.template.log_prior(x)
    )
    found = np.full(m * p, -np.inf)
    # every row of a stack must have its parameter set: those outside the support go first
    rows = np.flatnonzero(inside)
    if len(rows):
        at = conditional.at(angles_deg, rows // p)
        found[rows] = at.log_likelihood(x[rows]) + axes.log_prior(z[rows])
    return found.reshape(m, p)
