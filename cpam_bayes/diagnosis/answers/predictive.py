"""Whether a model explains the frequency lists, against the repeatability that is stated or believed."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.sharing import shared_out
from cpam_bayes.diagnosis.evidence.tested import Tested
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.forward_model.slips import birge_ratio

Array = NDArray[Any]

# Scores of an inferred repeatability that its prior is averaged over; its tail is wanted down to 1e-6.
_SCORES = np.linspace(-5.0, 5.0, 41)
# Nodes of the quadrature that the parameters are refitted from, and the mass that makes one worth it.
_MOST_STARTS, _NODE_FRACTION = 8, 1e-3


def explains(tested: Tested) -> float:
    """Predictive p-value of a hypothesis: whether noise alone leaves such residuals.

    With T = r^T S^-1 r of the residuals at the most probable parameters, S the covariance of noise and
    discrepancy,

        p = integral of P(chi2_nu >= T(a)) p(a) da,  nu = n - tr H,

    over the repeatability a: the one that is stated, or the prior of one that is inferred, not its posterior,
    which any misfit widens until it is explained. H = A (A^T A + I)^-1 A^T projects on what the parameters
    answer within their priors, A their derivatives over normal scores in units of the noise; the mean of T
    over the prior predictive distribution is nu (Gelman et al., Bayesian Data Analysis, 3rd ed., 6.3, of the
    check). The parameters are fitted again for every a.
    """
    comparison = tested.marginal.comparison
    z = _starts(tested)
    if comparison.noise is None:
        amplitudes, weight = np.empty(0), np.ones(1)
    else:
        amplitudes = comparison.parameters.parameters[comparison.noise].prior.from_normal(_SCORES)
        weight = np.exp(-0.5 * _SCORES**2)
    misfit, effective = _refitted(comparison, z, amplitudes)
    p = np.asarray(chi2.sf(misfit, len(comparison.listed.frequencies) - effective))
    return float(weight @ p.max(axis=0) / weight.sum())


def within_stated_noise(tested: Tested, n_constants: int) -> bool:
    """Whether noise as stated explains what a hypothesis leaves of the lists, by `birge_ratio`.

    Of its most probable parameters, over the frequencies whose noise is stated; the discrepancy of an error
    outside the catalogue is no noise.
    """
    marginal = tested.marginal
    listed = marginal.comparison.listed
    predicted, _ = marginal.comparison.predict(marginal.best[None])
    stated = listed.scale == 0.0
    standardised = (listed.frequencies - predicted[0])[stated] / np.sqrt(listed.variance[stated])
    return birge_ratio(standardised, n_constants) == 1.0


@dataclass(frozen=True, slots=True)
class PredictiveChecks:
    """Predictive p-values of hypotheses, each computed once, at the latest when it is asked for.

    A hypothesis that is weighed again with other priors keeps its marginal likelihood, and so its p-value.
    """

    _known: dict[int, tuple[Marginal, float]] = field(default_factory=dict)

    def compute(
        self, cases: Sequence[PlateCase], tested: Sequence[Tested], executor: Executor | None
    ) -> None:
        """The p-values of hypotheses about some plates, side by side on an executor."""
        for t, p in zip(tested, shared_out(explains, cases, tested, executor), strict=True):
            self._known[id(t.marginal)] = (t.marginal, p)

    def p_value(self, tested: Tested) -> float:
        """`explains` of a hypothesis."""
        key = id(tested.marginal)
        if key not in self._known:
            # held with its p-value, so that no other marginal likelihood can have the same number
            self._known[key] = (tested.marginal, explains(tested))
        return self._known[key][1]


def _starts(tested: Tested) -> Array:
    """Scores (s, n) of the nodes that carry mass, the best first."""
    marginal = tested.marginal
    order = np.argsort(-marginal.weight, kind="stable")[:_MOST_STARTS]
    return marginal.z[[i for k, i in enumerate(order) if not k or marginal.weight[i] > _NODE_FRACTION]]


def _refitted(comparison: Comparison, z: Array, amplitudes: Array) -> tuple[Array, Array]:
    """T and tr H for starts (s, n) at amplitudes (a,) of the noise, (s, a) each.

    One step of Gauss and Newton from each start; the better one of start and step counts.
    """
    f = comparison.listed.frequencies
    a = max(len(amplitudes), 1)
    free = np.delete(np.arange(z.shape[1]), comparison.nuisance)
    x = comparison.scores.to_x(z)
    predicted, jacobian = comparison.predict(x, jacobian=True)
    assert jacobian is not None
    slope = (jacobian * comparison.scores.slope(x, z)[:, None, :])[:, :, free]
    at = np.repeat(x[:, None], a, axis=1)
    if comparison.noise is not None:
        at[:, :, [c for c in comparison.amplitudes if c >= 0]] = amplitudes[:, None]
    covariance = comparison.covariance(at.reshape(len(z) * a, -1))
    back = np.linalg.inv(np.linalg.cholesky(covariance)).reshape(len(z), a, len(f), len(f))
    scaled = back @ slope[:, None]
    residual = np.einsum("samn,sn->sam", back, f - predicted)
    fisher = np.swapaxes(scaled, 2, 3) @ scaled
    gradient = np.einsum("sami,sam->sai", scaled, residual) - z[:, None, free]
    inverse = np.linalg.inv(fisher + np.eye(len(free)))
    moved = np.repeat(z[:, None], a, axis=1)
    moved[:, :, free] += np.einsum("saij,saj->sai", inverse, gradient)
    # a step may lead where the plate buckles
    inside, new, _ = comparison.predict_inside(comparison.scores.to_x(moved.reshape(len(z) * a, -1)))
    again = np.full((len(z) * a, len(f)), np.inf)
    again[inside] = np.einsum("mij,mj->mi", back.reshape(-1, *back.shape[2:])[inside], f - new)
    before, after = np.sum(residual**2, axis=2), np.sum(again**2, axis=1).reshape(len(z), a)
    after = np.where(np.isfinite(after), after, np.inf)
    return np.minimum(before, after), np.einsum("saij,saji->sa", inverse, fisher)
