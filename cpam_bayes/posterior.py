"""The posterior of a plate's parameters: noise, priors and pairing over a forward model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from cpam_bayes.measurement import Measurement
from cpam_bayes.model import Prediction
from cpam_bayes.pairing import DEFAULT_PAIRING, PairingPrior, monotone_log_likelihood
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT

Array = NDArray[Any]

NOISE = "relative_std"
# Prior of the relative noise where the file does not give it: half a Student-t, 1 % wide.
NOISE_PRIOR = ScaledStudentT(0.01, 4.0, 1e-5, 0.3)


class ForwardModel(Protocol):
    """What a posterior asks of a plate."""

    @property
    def parameters(self) -> ParameterSet:
        """Parameters of the plate, in the order of the vectors."""
        ...

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n)."""
        ...

    def admissible(self, x: Array) -> Array:
        """Whether parameter vectors (m, n) are physical, (m,) bool."""
        ...


@dataclass(frozen=True, slots=True)
class Posterior:
    """Log probability of parameter vectors, given measured frequencies.

    sigma_i^2 = (s f_i)^2 + resolution^2 / 12 + (e_i f_i)^2, s being the repeatability of the file, or
    the last parameter where the file leaves it out, and e_i the relative error of the solver.

    parameters : those of the model, then ``relative_std`` where it is inferred. solver_error :
    (n_modes,) relative. degrees_of_freedom : of Student-t noise, infinite for Gaussian noise.
    """

    model: ForwardModel
    measurement: Measurement
    parameters: ParameterSet
    solver_error: Array
    degrees_of_freedom: float = np.inf
    pairing: PairingPrior = DEFAULT_PAIRING

    @property
    def noise_is_inferred(self) -> bool:
        """Whether the relative noise is a parameter."""
        return NOISE in self.parameters

    def noise(self, x: Array, predicted: Array) -> Array:
        """Standard deviations of the measured frequencies, if they belong to predicted ones, Hz.

        x (m, n_parameters), predicted (m, n_modes) -> (m, n_frequencies, n_modes).
        """
        own = self.measurement
        f = own.frequencies
        if own.frequency_sd is not None:
            repeatability = np.broadcast_to(own.frequency_sd, (len(x), len(f)))
        else:
            s = x[:, -1:] if self.noise_is_inferred else np.full((len(x), 1), own.relative_std or 0.0)
            repeatability = s * f
        variance = repeatability**2 + own.resolution**2 / 12
        return np.asarray(np.sqrt(variance[:, :, None] + (self.solver_error * predicted)[:, None, :] ** 2))

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood of parameter vectors (m, n_parameters), (m,)."""
        predicted = self.model.predict(x[:, : self.model.parameters.size]).frequencies
        density = self.log_density(predicted, self.noise(x, predicted))
        n = self.measurement.size
        if self.measurement.complete:
            i = np.arange(n)
            return np.asarray(density[:, i, i].sum(axis=1))
        return monotone_log_likelihood(density, self.in_range(predicted), self.span, self.pairing)

    def log_density(self, predicted: Array, sigma: Array) -> Array:
        """Log density of every measured frequency about every predicted one, (m, n_f, n_modes)."""
        z = (self.measurement.frequencies[None, :, None] - predicted[:, None, :]) / sigma
        nu = self.degrees_of_freedom
        if np.isinf(nu):
            return np.asarray(-0.5 * z**2 - np.log(sigma) - 0.5 * np.log(2 * np.pi))
        constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * np.pi)
        return np.asarray(constant - np.log(sigma) - (nu + 1) / 2 * np.log1p(z**2 / nu))

    def in_range(self, predicted: Array) -> Array:
        """Modes that a complete list would contain: none lies above the highest frequency listed."""
        return np.asarray(predicted <= self.measurement.frequencies[-1])

    @property
    def span(self) -> float:
        """Width of the measured range, Hz."""
        return float(self.measurement.frequencies[-1])

    def log_prior(self, x: Array) -> Array:
        """Log prior of parameter vectors (m, n_parameters), -inf outside the support, (m,)."""
        log_prior = self.parameters.log_prior(x)
        inside = np.isfinite(log_prior)
        allowed = inside.copy()
        allowed[inside] = self.model.admissible(x[inside][:, : self.model.parameters.size])
        return np.where(allowed, log_prior, -np.inf)

    def log_prob(self, x: Array) -> Array:
        """Log posterior but for a constant, -inf outside the support, (m, n_parameters) -> (m,)."""
        x = np.atleast_2d(x)
        found = self.log_prior(x)
        inside = np.isfinite(found)
        if inside.any():
            found[inside] += self.log_likelihood(x[inside])
        return found


def plate_posterior(
    model: ForwardModel,
    measurement: Measurement,
    solver_error: Array,
    *,
    degrees_of_freedom: float = np.inf,
    pairing: PairingPrior = DEFAULT_PAIRING,
) -> Posterior:
    """The posterior of a model's parameters, with the noise among them if the file leaves it out."""
    parameters = model.parameters
    if measurement.relative_std is None and measurement.frequency_sd is None:
        parameters = parameters.union(ParameterSet((Parameter(NOISE, "", NOISE_PRIOR),)))
    return Posterior(model, measurement, parameters, solver_error, degrees_of_freedom, pairing)
