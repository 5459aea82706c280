"""The posterior of a plate's parameters: noise, priors and pairing over a forward model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.forward_model.labels import Alternative, LabelledModel
from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.inference.noise import NOISE_PRIOR, Likelihood, NoiseModel, noise_model
from cpam_bayes.inference.pairing import (
    DEFAULT_PAIRING,
    Pairing,
    PairingPrior,
    labelled_log_likelihood,
    most_probable_labelled_pairing,
)
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Measurement

__all__ = ["NOISE", "NOISE_PRIOR", "ForwardModel", "Posterior", "SolverError", "plate_posterior"]

Array = NDArray[Any]

NOISE = "relative_std"


class SolverError(ValueError):
    """A forward model returned something that is no frequency."""


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

    parameters : those of the model, then the amplitude of the noise where it is inferred.
    labelled : (n_frequencies,) bool, frequencies whose mode is known by its label: the model gives it at the
    frequency's own place among its modes.
    """

    model: ForwardModel
    measurement: Measurement
    parameters: ParameterSet
    noise_model: NoiseModel
    labelled: Array
    pairing: PairingPrior = DEFAULT_PAIRING
    alternatives: tuple[Alternative, ...] = ()

    @property
    def noise_is_inferred(self) -> bool:
        """Whether the amplitude of the noise is a parameter, the last one."""
        return self.noise_model.parameter is not None

    @property
    def noise_name(self) -> str | None:
        """Name of the noise's amplitude where it is inferred."""
        parameter = self.noise_model.parameter
        return None if parameter is None else parameter.name

    @property
    def degrees_of_freedom(self) -> float:
        """Of Student-t noise, infinite for Gaussian noise."""
        return self.noise_model.degrees_of_freedom

    def amplitude(self, x: Array) -> Array:
        """Amplitude of the noise at parameter vectors (m, n_parameters), (m,)."""
        given = self.noise_model.amplitude
        return np.full(len(x), given) if isinstance(given, float) else x[:, -1]

    def noise(self, x: Array, predicted: Array) -> Array:
        """Standard deviations of the measured frequencies, if they belong to predicted ones, Hz.

        x (m, n_parameters), predicted (m, n_modes) -> (m, n_frequencies, n_modes).
        """
        return self.noise_model.sd(self.amplitude(x), predicted)

    def predict(self, x: Array) -> Array:
        """Frequencies of the model at parameter vectors (m, n_parameters), (m, n_modes) Hz.

        Raises ``SolverError`` if one of them is not a number.
        """
        x_plate = x[:, : self.model.parameters.size]
        predicted = self.model.predict(x_plate).frequencies
        wrong = ~np.isfinite(predicted)
        if wrong.any():
            row, mode = np.argwhere(wrong)[0]
            raise SolverError(
                f"the plate solver returned {predicted[row, mode]} Hz for mode {mode + 1} at "
                f"{self._described(x_plate[row])}; check the sizes and the bounds of the unknowns in the "
                "plate file"
            )
        return predicted

    @property
    def is_one_to_one(self) -> bool:
        """Whether every frequency belongs to the mode at its own place, and no pairings are summed over."""
        return self.measurement.complete and not self.alternatives

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood of parameter vectors (m, n_parameters), (m,)."""
        predicted = self.predict(x)
        density, in_range = self.log_density(predicted, self.noise(x, predicted)), self.in_range(predicted)
        if not self.alternatives:
            return self._log_likelihood(density, in_range)
        return np.asarray(logsumexp(self._by_alternative(density, in_range), axis=0))

    def _by_alternative(self, density: Array, in_range: Array) -> Array:
        """Log likelihood by every alternative pairing with its probability, (n_alternatives, m)."""
        return np.stack(
            [
                one.log_probability + self._log_likelihood(density[:, :, one.places], in_range[:, one.places])
                for one in self.alternatives
            ]
        )

    def _log_likelihood(self, density: Array, in_range: Array) -> Array:
        """Log likelihood (m,) of densities (m, n_f, n_modes) with every labelled mode at its place."""
        if self.measurement.complete:
            i = np.arange(self.measurement.size)
            return np.asarray(density[:, i, i].sum(axis=1))
        return labelled_log_likelihood(density, in_range, self.span, self.labelled, self.pairing)

    def log_density(self, predicted: Array, sigma: Array) -> Array:
        """Log density of every measured frequency about every predicted one, (m, n_f, n_modes)."""
        z = (self.measurement.frequencies[None, :, None] - predicted[:, None, :]) / sigma
        return self.noise_model.log_density(z) - np.log(sigma)

    def most_probable_pairing(self, x: Array) -> Pairing:
        """Which frequency is which of the model's modes at one parameter vector (n_parameters,)."""
        measurement = self.measurement
        if self.is_one_to_one:
            return Pairing(np.arange(measurement.size), np.empty(0, dtype=int), 0.0)
        predicted = self.predict(x[None])
        density, in_range = (
            self.log_density(predicted, self.noise(x[None], predicted)),
            self.in_range(predicted),
        )
        places, log_probability = np.arange(predicted.shape[1]), 0.0
        if self.alternatives:
            each = self._by_alternative(density, in_range)[:, 0]
            best = int(np.argmax(each))
            places, log_probability = self.alternatives[best].places, float(each[best] - logsumexp(each))
        if measurement.complete:
            return Pairing(places[: measurement.size], np.empty(0, dtype=int), log_probability)
        pairing = most_probable_labelled_pairing(
            density[0][:, places], in_range[0, places], self.span, self.labelled, self.pairing
        )
        mode = np.where(pairing.mode >= 0, places[pairing.mode], -1)
        return Pairing(mode, np.sort(places[pairing.missed]), pairing.log_probability + log_probability)

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
        """Log posterior but for a constant, -inf outside the support, (m, n_parameters) -> (m,).

        Raises ``SolverError`` where it would not be a number.
        """
        x = np.atleast_2d(x)
        value = self.log_prior(x)
        inside = np.isfinite(value)
        if inside.any():
            value[inside] += self.log_likelihood(x[inside])
            if np.isnan(value).any():
                where = x[int(np.argmax(np.isnan(value)))]
                raise SolverError(f"the log probability is not a number at {self._described(where)}")
        return value

    def _described(self, x: Array) -> str:
        """Parameters and their values, SI, in words; ``x`` may be those of the model alone."""
        named = zip(self.parameters.parameters, x, strict=False)
        return ", ".join(f"{p.name} = {value:.6g} {p.unit}".rstrip() for p, value in named)


def plate_posterior(
    model: ForwardModel,
    measurement: Measurement,
    solver_error: Array,
    *,
    likelihood: Likelihood = "relative",
    degrees_of_freedom: float = np.inf,
    pairing: PairingPrior | None = None,
) -> Posterior:
    """The posterior of a model's parameters, with the noise among them if the file leaves it out.

    likelihood, degrees_of_freedom : as of ``noise_model``.
    solver_error : (n_modes,) relative.
    pairing : prior of the pairings of an incomplete list, by default that of the measurement.

    Raises ``ValueError`` for a list with labels or shapes unless the model is a ``LabelledModel``.
    """
    noise = noise_model(measurement, solver_error, likelihood, degrees_of_freedom)
    parameters = model.parameters
    if noise.parameter is not None:
        parameters = parameters.union(ParameterSet((noise.parameter,)))
    labelled = np.zeros(measurement.size, dtype=bool)
    alternatives: tuple[Alternative, ...] = ()
    if isinstance(model, LabelledModel):
        labelled[model.rows[model.rows < measurement.size]] = True
        alternatives = model.alternatives
    elif measurement.names_modes:
        raise ValueError(
            "the list of frequencies has labels or shapes and the model does not know them; make it with "
            "labelled_model"
        )
    if pairing is None:
        pairing = PairingPrior(measurement.missed_probability, measurement.false_peaks)
    return Posterior(model, measurement, parameters, noise, labelled, pairing, alternatives)
