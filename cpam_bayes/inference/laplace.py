"""Gaussian picture of a posterior about its optimum: optimum, covariance, Jacobian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from cpam_bayes.posterior import Posterior

Array = NDArray[Any]

_STEP = 1e-4


@dataclass(frozen=True, slots=True)
class GaussianPicture:
    """A posterior as a Gaussian about one optimum.

    optimum : (n,). covariance : (n, n), the inverse of the Gauss-Newton Hessian with the variances
    of the priors added, so that a direction which the data leave open keeps its prior's width.
    """

    optimum: Array
    log_prob: float
    covariance: Array


def optimise(posterior: Posterior, start: Array) -> GaussianPicture:
    """The optimum of the posterior next to ``start`` (n,), bounded by the priors' support.

    Bounded quasi-Newton (L-BFGS-B) in coordinates scaled by the priors' standard deviations.
    """
    parameters = posterior.parameters
    scale = prior_sd(posterior)
    floor = float(posterior.log_prob(start[None])[0])
    if not np.isfinite(floor):
        raise ValueError("the start of an optimisation lies outside the support of the prior")

    def cost(z: Array) -> tuple[float, Array]:
        x = np.clip(z * scale, parameters.lower, parameters.upper)
        step = _STEP * scale * np.eye(len(x))
        both = np.clip(np.concatenate((x + step, x - step)), parameters.lower, parameters.upper)
        values = posterior.log_prob(np.vstack((x, both)))
        values = -np.where(np.isfinite(values), values, floor - 1e3)
        up, down = np.split(values[1:], 2)
        width = np.diagonal(both[: len(x)]) - np.diagonal(both[len(x) :])
        return float(values[0]), np.asarray((up - down) / width * scale)

    bounds = list(zip(parameters.lower / scale, parameters.upper / scale, strict=True))
    found = minimize(cost, start / scale, jac=True, bounds=bounds, method="L-BFGS-B")
    best = np.clip(found.x * scale, parameters.lower, parameters.upper)
    value = float(posterior.log_prob(best[None])[0])
    if not value >= floor:
        best, value = start, floor
    return GaussianPicture(best, value, gauss_newton_covariance(posterior, best))


def prior_sd(posterior: Posterior) -> Array:
    """Standard deviations of the priors, (n,)."""
    return np.array([p.prior.sd for p in posterior.parameters.parameters])


def gauss_newton_covariance(posterior: Posterior, x: Array) -> Array:
    """(J^T S^-1 J + F_s + P^-1)^-1 at x (n,), one to one pairing assumed, (n, n).

    S are the noise variances, F_s = sum (s f_i^2 / sigma_i^2)^2 * 2 the Fisher information of the
    relative noise where it is a parameter, P the priors' variances.
    """
    model, n_plate = posterior.model, posterior.model.parameters.size
    prediction = model.predict(x[None, :n_plate], jacobian=True)
    assert prediction.jacobian is not None
    n_f = posterior.measurement.size
    predicted, jacobian = prediction.frequencies[:, :n_f], prediction.jacobian[0, :n_f]
    sigma = np.diagonal(posterior.noise(x[None], prediction.frequencies)[0])[: len(predicted[0])]
    precision = np.diag(1.0 / prior_sd(posterior) ** 2)
    weighted = jacobian / sigma[: len(jacobian), None]
    precision[:n_plate, :n_plate] += weighted.T @ weighted
    if posterior.noise_is_inferred:
        f = posterior.measurement.frequencies
        precision[-1, -1] += 2.0 * np.sum((x[-1] * f**2 / sigma**2) ** 2)
    return np.linalg.inv(precision)
