"""The posterior of a plate's parameters: noise, priors and pairing over a forward model.

Scale and shape of the noise are independent of each other and of the model: a scale is one number for every
frequency, by which an amplitude is multiplied; the shape is Gaussian or Student's t.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.special import gammaln, logsumexp

from cpam_bayes.forward_model.labels import Alternative, LabelledModel
from cpam_bayes.forward_model.model import ForwardModel
from cpam_bayes.inference.pairing import (
    Pairing,
    PairingPrior,
    labelled_log_likelihood,
    most_probable_labelled_pairing,
    pair_probabilities,
)
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT
from cpam_bayes.plate import Measurement

Likelihood = Literal["relative", "absolute"]

# Prior of an inferred amplitude: half a Student-t, 1 % of a frequency wide; its bounds.
_WIDTH, _FREEDOM, _LEAST, _MOST = 0.01, 4.0, 1e-5, 0.3
NOISE_PRIOR: Final = ScaledStudentT(_WIDTH, _FREEDOM, _LEAST, _MOST)


@dataclass(frozen=True, slots=True)
class _Scale:
    """A scale of noise: name and unit of its amplitude, and what the amplitude multiplies."""

    name: str
    unit: str
    of: Callable[[Array], Array]


_SCALES: Final[Mapping[Likelihood, _Scale]] = {
    "relative": _Scale("relative_std", "", np.array),
    "absolute": _Scale("absolute_sd", "Hz", np.ones_like),
}
NOISE_NAMES: Final = tuple(scale.name for scale in _SCALES.values())
"""Names that an inferred amplitude of the noise may have."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Scatter of frequency i if it belongs to mode j.

    sigma_ij^2 = (a b_i)^2 + resolution^2 / 12 + (e_j f_j)^2. With Student-t noise sigma is its scale.

    scale : (n,) b, Hz: the listed frequencies for relative noise, ones for noise that is the same in all
    modes, as in eq. (7), the file's own where it gives one for each.
    amplitude : a, or the parameter that it is.
    rounding : resolution^2 / 12, Hz^2.
    solver_error : (n_modes,) e, relative.
    degrees_of_freedom : of the Student-t shape, infinite for the Gaussian one.
    """

    scale: Array
    amplitude: float | Parameter
    rounding: float
    solver_error: Array
    degrees_of_freedom: float = np.inf

    @property
    def parameter(self) -> Parameter | None:
        """The amplitude as a parameter, ``None`` where it is given."""
        return self.amplitude if isinstance(self.amplitude, Parameter) else None

    @property
    def information(self) -> float:
        """Fisher information of the location of a standardised residual."""
        nu = self.degrees_of_freedom
        return 1.0 if np.isinf(nu) else (nu + 1.0) / (nu + 3.0)

    def sd(self, amplitude: Array, predicted: Array) -> Array:
        """sigma for amplitudes (m,) and predicted frequencies (m, n_modes), (m, n, n_modes) Hz."""
        variance = (amplitude[:, None] * self.scale) ** 2 + self.rounding
        return np.asarray(np.sqrt(variance[:, :, None] + (self.solver_error * predicted)[:, None, :] ** 2))

    def log_density(self, z: Array) -> Array:
        """Log density of standardised residuals, (...)."""
        nu = self.degrees_of_freedom
        if np.isinf(nu):
            return np.asarray(-0.5 * z**2 - 0.5 * np.log(2 * np.pi))
        constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * np.pi)
        return np.asarray(constant - (nu + 1) / 2 * np.log1p(z**2 / nu))

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Standardised residuals drawn at random."""
        nu = self.degrees_of_freedom
        return rng.standard_normal(shape) if np.isinf(nu) else rng.standard_t(nu, size=shape)

    def suggested(self, residuals: Array) -> float:
        """An inferred amplitude that residuals (n,) Hz suggest, well within the bounds of its prior."""
        if not isinstance(self.amplitude, Parameter):
            return self.amplitude
        prior = self.amplitude.prior
        rms = float(np.sqrt(np.mean((residuals / self.scale) ** 2)))
        return float(np.clip(rms, 2 * prior.lower, 0.5 * prior.upper))


def noise_model(
    measurement: Measurement,
    solver_error: Array,
    likelihood: Likelihood = "relative",
    degrees_of_freedom: float = np.inf,
) -> NoiseModel:
    """The noise of a list of frequencies.

    likelihood : "relative", sd s f_i with the file's repeatability s, or s inferred where the file
    leaves it out; "absolute", one sd in Hz for all modes, inferred: the likelihood whose maximum is
    the minimum of F of eq. (7). Standard deviations that the file gives one by one overrule the
    first. Raises ``ValueError`` where the file gives what "absolute" is to infer, or for degrees of
    freedom that are not above 2.

    The prior of an inferred amplitude is the same on both scales at the root mean square frequency.
    """
    if not degrees_of_freedom > 2.0:
        raise ValueError(
            f"degrees of freedom of the noise: received {degrees_of_freedom}, accepted: above 2, or "
            "infinite for Gaussian noise"
        )
    f = measurement.frequencies
    given = _given(measurement)
    if given is not None and likelihood == "absolute":
        raise ValueError(
            f"measurement.{given}: the absolute likelihood infers one standard deviation in Hz for all "
            f"modes, eq. (7); leave {given} out, or take the relative likelihood"
        )
    rounding = measurement.resolution**2 / 12
    if measurement.frequency_sd is not None:
        return NoiseModel(measurement.frequency_sd, 1.0, rounding, solver_error, degrees_of_freedom)
    scale = _SCALES[likelihood]
    unit = scale.of(f)
    if measurement.relative_std is not None:
        return NoiseModel(unit, measurement.relative_std, rounding, solver_error, degrees_of_freedom)
    size = float(np.sqrt(np.mean(f**2) / np.mean(unit**2)))
    prior = ScaledStudentT(_WIDTH * size, _FREEDOM, _LEAST * size, _MOST * size)
    parameter = Parameter(scale.name, scale.unit, prior)
    return NoiseModel(unit, parameter, rounding, solver_error, degrees_of_freedom)


def _given(measurement: Measurement) -> str | None:
    """The key by which a plate file gives the repeatability."""
    if measurement.frequency_sd is not None:
        return "frequency_sd_hz"
    return None if measurement.relative_std is None else "relative_std"


NOISE = "relative_std"


class SolverError(ValueError):
    """A forward model returned something that is no frequency."""


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
    pairing: PairingPrior
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
        """Degrees of freedom of Student-t noise, infinite for Gaussian noise."""
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
        return labelled_log_likelihood(density, in_range, self.span, self._known, self.pairing)

    @property
    def _known(self) -> Array:
        """The mode of each labelled frequency, -1 for the others, (n_f,)."""
        return np.where(self.labelled, np.arange(len(self.labelled)), -1)

    def log_density(self, predicted: Array, sigma: Array) -> Array:
        """Log density of every measured frequency about every predicted one, (m, n_f, n_modes)."""
        z = (self.measurement.frequencies[None, :, None] - predicted[:, None, :]) / sigma
        return self.noise_model.log_density(z) - np.log(sigma)

    def most_probable_pairing(self, x: Array) -> Pairing:
        """The most probable pairing of frequencies and modes at one parameter vector (n_parameters,)."""
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
            density[0][:, places], in_range[0, places], self.span, self._known, self.pairing
        )
        mode = np.where(pairing.mode >= 0, places[pairing.mode], -1)
        return Pairing(mode, np.sort(places[pairing.missed]), pairing.log_probability + log_probability)

    def pairing_probability(self, draws: Array, pairing: Pairing) -> Array:
        """Probability that each frequency is what it was paired with, over draws (m, n_parameters), (n,)."""
        predicted = self.predict(draws)
        of_pair = pair_probabilities(
            self.log_density(predicted, self.noise(draws, predicted)),
            self.in_range(predicted),
            self.span,
            self.pairing,
        ).mean(axis=0)
        taken = of_pair[np.arange(len(pairing.mode)), pairing.mode]
        return np.asarray(np.where(pairing.mode >= 0, taken, 1.0 - of_pair.sum(axis=1)))

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
    tolerant: ForwardModel | None = None,
) -> Posterior:
    """The posterior of a model's parameters, with the noise among them if the file leaves it out.

    likelihood, degrees_of_freedom : as of ``noise_model``.
    solver_error : (n_modes,) relative.
    pairing : prior of the pairings of an incomplete list, by default that of the measurement.
    tolerant : the model with further parameters, by which it predicts the same modes.

    Raises ``ValueError`` for a list with labels or shapes unless the model is a ``LabelledModel``.
    """
    noise = noise_model(measurement, solver_error, likelihood, degrees_of_freedom)
    predicting = model if tolerant is None else tolerant
    parameters = predicting.parameters
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
        pairing = PairingPrior.of(measurement)
    return Posterior(predicting, measurement, parameters, noise, labelled, pairing, alternatives)
