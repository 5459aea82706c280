"""Checks of a posterior against its data: replicate lists, modes left out."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.diagnostics.identifiability import information, paired, weighted_jacobian
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior

Array = NDArray[Any]

# Pareto k-hat above which importance sampling does not replace leaving a mode out.
K_HAT_LIMIT = 0.7
# Leverage from draws above which their spread is not taken for that of a Gaussian: where a posterior
# has several optima it is wider than the noise allows.
MOST_LEVERAGE = 0.95


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Each paired frequency predicted from all the others, (n_pairs,) each.

    residual : measured less predicted, Hz.
    sd : of the prediction and the noise together, Hz.
    leverage : weight of a mode's frequency in its own prediction, 0 to 1.
    basis : whether predictions and their spread are those of the draws or of a linearisation at the optimum.
    """

    residual: Array
    sd: Array
    leverage: Array
    basis: Literal["draws", "optimum"]

    @property
    def standardised(self) -> Array:
        """Residuals over their standard deviations."""
        return np.asarray(self.residual / self.sd)

    @property
    def log_score(self) -> float:
        """Sum of the Gaussian log densities of the frequencies left out, per Hz each."""
        log_densities = -0.5 * self.standardised**2 - np.log(self.sd) - 0.5 * np.log(2.0 * np.pi)
        return float(log_densities.sum())


@dataclass(frozen=True, slots=True)
class ImportanceLeftOut:
    """Leave-one-out log score by Pareto-smoothed importance sampling.

    log_score, standard_error : sum over the frequencies.
    k_hat : (n,) of each.
    """

    log_score: float
    standard_error: float
    k_hat: Array

    @property
    def reliable(self) -> bool:
        """Whether every k-hat is below 0.7."""
        return bool(np.all(self.k_hat < K_HAT_LIMIT))


def predictive_p_value(
    posterior: Posterior, draws: Array, frequencies: Array, pairing: Pairing, rng: np.random.Generator
) -> float:
    """Probability of a replicate list with larger standardised residuals than the measured one.

    The discrepancy is the sum of squared standardised residuals at each draw (Gelman, Meng and Stern,
    1996), of the frequencies that have a mode. draws (m, n), frequencies (m, n_modes) predicted there.
    """
    rows, columns = paired(pairing)
    sigma = posterior.noise(draws, frequencies)[:, rows, columns]
    measured = posterior.measurement.frequencies[rows]
    observed = np.sum(((measured - frequencies[:, columns]) / sigma) ** 2, axis=1)
    noise = posterior.noise_model.sample(rng, sigma.shape)
    return float(np.mean(np.sum(noise**2, axis=1) >= observed))


def leave_one_out(
    posterior: Posterior, draws: Array, frequencies: Array, pairing: Pairing, optimum: Array
) -> LeftOut:
    """Leave-one-mode-out residuals in closed form.

    Let the posterior of a mode's frequency be N(m, v) and its noise variance sigma^2. Taking its own
    datum f out of that Gaussian leaves, with the leverage h = v / sigma^2, the residual
    (f - m) / (1 - h) and the predictive variance sigma^2 / (1 - h): for a linear Gaussian model those
    of a refit without the mode (Cook and Weisberg, 1982; as the cavity of an approximate posterior,
    Vehtari et al., 2016). m and v are those of the draws, in which bounds and curvature are. Where that
    gives a leverage above 0.95 the posterior is no Gaussian, and h is the diagonal of
    A (A^T A + 1)^-1 A^T, A the weighted Jacobian at the optimum, where the residuals are taken too.

    The noise stays as all modes together have it: a mode that is far off widens it a little, and its
    standardised residual is that much too small. Student-t noise counts with the variance that gives
    the same information for v and with its own variance in the prediction.

    draws : (m, n).
    frequencies : (m, n_modes) predicted there, Hz.
    optimum : (n,).
    """
    rows, columns = paired(pairing)
    nu = posterior.degrees_of_freedom
    measured = posterior.measurement.frequencies[rows]
    wider = 1.0 if np.isinf(nu) else nu / (nu - 2.0) * information(nu)
    predicted = frequencies[:, columns]
    squared = np.mean(posterior.noise(draws, frequencies)[:, rows, columns] ** 2, axis=0)
    squared /= information(nu)
    leverage = predicted.var(axis=0) / squared
    if np.all(leverage <= MOST_LEVERAGE):
        return cavity(measured - predicted.mean(axis=0), leverage, squared, "draws", wider)
    jacobian = weighted_jacobian(posterior, optimum, pairing)
    hessian = jacobian.T @ jacobian + np.eye(jacobian.shape[1])
    leverage = np.einsum("ij,ji->i", jacobian, np.linalg.solve(hessian, jacobian.T))
    there = posterior.predict(optimum[None])
    squared = posterior.noise(optimum[None], there)[0, rows, columns] ** 2 / information(nu)
    return cavity(measured - there[0, columns], leverage, squared, "optimum", wider)


def cavity(
    residual: Array,
    leverage: Array,
    noise_variance: Array,
    basis: Literal["draws", "optimum"],
    wider: float = 1.0,
) -> LeftOut:
    """Each mode taken out of residuals, leverages and noise variances that have it, (n_pairs,) each.

    wider : the noise variance of a prediction over that which the leverage counts.
    """
    remaining = 1.0 - leverage
    sd = np.sqrt(noise_variance * (leverage / remaining + wider))
    return LeftOut(residual / remaining, sd, leverage, basis)


def importance_leave_one_out(log_density: Array) -> ImportanceLeftOut:
    """Leave-one-out log score from the log density of every frequency at every draw.

    Pareto-smoothed importance sampling (Vehtari, Gelman and Gabry, 2017).

    log_density : (m, n), draws independent of each other.
    """
    import arviz

    loo: Callable[..., Any] = arviz.loo
    with warnings.catch_warnings():
        # arviz announces its next version, and warns of what k-hat says here
        warnings.simplefilter("ignore")
        data = arviz.from_dict(
            log_likelihood={"f": log_density[None]}, posterior={"any": np.zeros((1, len(log_density)))}
        )
        result = loo(data, pointwise=True, reff=1.0)
    return ImportanceLeftOut(float(result.elpd_loo), float(result.se), np.asarray(result.pareto_k))
