"""The posterior of a plate's parameters: noise, priors and pairing over a forward model.

Scale and shape of the noise are independent of each other and of the model: the scale is one number per
frequency, which multiplies an amplitude; the shape is Gaussian or Student's t.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Final, Literal

import numpy as np
from scipy.special import gammaln, logsumexp

from cpam_bayes.forward_model.labels import Alternative, LabelledModel
from cpam_bayes.forward_model.model import ForwardModel, Prediction
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.inference.pairing import (
    Pairing,
    PairingPrior,
    labelled_log_likelihood,
    most_probable_labelled_pairing,
    pair_probabilities,
)
from cpam_bayes.inference.scores import Expansion, NormalScores
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT
from cpam_bayes.plate import Measurement

Likelihood = Literal["relative", "absolute"]

# Prior of an inferred amplitude: half-Student-t of scale 1 % of a frequency, degrees of freedom, bounds.
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
    """Noise of frequency i if it belongs to mode j.

    sigma_ij^2 = (a b_i)^2 + resolution^2 / 12 + (e_j f_j)^2. With Student-t noise sigma is its scale.

    scale : (n,) b, Hz: the listed frequencies for relative noise, ones for noise that is the same in all
    modes, as in eq. (7), the file's own where it gives one for each frequency.
    amplitude : a, or its parameter where it is inferred.
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
        """sigma (m, n, n_modes), Hz, for amplitudes (m,) and predicted frequencies (m, n_modes)."""
        variance = (amplitude[:, None] * self.scale) ** 2 + self.rounding
        return np.asarray(np.sqrt(variance[:, :, None] + (self.solver_error * predicted)[:, None, :] ** 2))

    def log_density(self, z: Array) -> Array:
        """Log density (...) of standardised residuals."""
        nu = self.degrees_of_freedom
        if np.isinf(nu):
            return np.asarray(-0.5 * z**2 - 0.5 * np.log(2 * np.pi))
        constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * np.pi)
        return np.asarray(constant - (nu + 1) / 2 * np.log1p(z**2 / nu))

    def sample(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Random standardised residuals."""
        nu = self.degrees_of_freedom
        return rng.standard_normal(shape) if np.isinf(nu) else rng.standard_t(nu, size=shape)

    def suggested(self, residuals: Array) -> float:
        """Amplitude suggested by residuals (n,), Hz, well within its prior's bounds; or the given one."""
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
    the minimum of F of eq. (7). Individual standard deviations in the file override the first.
    Raises ``ValueError`` where the file gives what "absolute" is to infer, or for degrees of
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
    """Key with which the plate file gives the repeatability, ``None`` without one."""
    if measurement.frequency_sd is not None:
        return "frequency_sd_hz"
    return None if measurement.relative_std is None else "relative_std"


NOISE = "relative_std"


class SolverError(ValueError):
    """Error of a forward model that returned values which are no frequencies."""


@dataclass(frozen=True, slots=True)
class Posterior(LogDensity):
    """Log probability of parameter vectors, given measured frequencies that are independent of each other.

    parameters : those of the model, then the amplitude of the noise where it is inferred.
    labelled : (n_frequencies,) bool, frequencies whose mode is fixed by a label: the model has that mode at
    the index of the frequency.
    """

    model: ForwardModel
    measurement: Measurement
    parameters: ParameterSet
    scores: NormalScores
    noise_model: NoiseModel
    labelled: Array
    pairing: PairingPrior
    alternatives: tuple[Alternative, ...] = ()

    @property
    def n_model(self) -> int:
        """Number of the model's parameters, which come first."""
        return self.model.parameters.size

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
        """Amplitude (m,) of the noise at parameter vectors (m, n_parameters)."""
        given = self.noise_model.amplitude
        return np.full(len(x), given) if isinstance(given, float) else x[:, -1]

    def noise(self, x: Array, predicted: Array) -> Array:
        """Standard deviations, Hz, of the measured frequencies about predicted ones.

        x (m, n_parameters), predicted (m, n_modes) -> (m, n_frequencies, n_modes).
        """
        return self.noise_model.sd(self.amplitude(x), predicted)

    def predict(self, x: Array) -> Array:
        """Frequencies (m, n_modes), Hz, of the model at parameter vectors (m, n_parameters).

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
        """Whether every frequency belongs to the mode of the same index, and no pairings are summed over."""
        return self.measurement.complete and not self.alternatives

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood (m,) of parameter vectors (m, n_parameters), -inf outside the constraints.

        Raises ``SolverError`` where it would not be a number.
        """
        value, inside = np.full(len(x), -np.inf), self.admissible(x)
        if not inside.any():
            return value
        x = x if inside.all() else x[inside]
        predicted = self.predict(x)
        of_pairs, in_range = self.of_pairs(predicted, self.noise(x, predicted)), self.in_range(predicted)
        if self.alternatives:
            value[inside] = logsumexp(self._by_alternative(of_pairs, in_range), axis=0)
        else:
            value[inside] = self._log_likelihood(of_pairs, in_range)
        if np.isnan(value).any():
            where = x[int(np.argmax(np.isnan(value[inside])))]
            raise SolverError(f"the log probability is not a number at {self._described(where)}")
        return value

    def expand_likelihood(self, x: Array) -> Expansion:
        """Log likelihood, gradient and Fisher information over the parameters x (m, n).

        Where pairings are summed over, the last is the negative Hessian for a model that is linear in its
        parameters, with negative eigenvalues set to zero.
        """
        inside, expand = self.admissible(x), _one_to_one if self.is_one_to_one else _summed
        if len(x) and inside.all():
            return expand(self, x)
        m, n = x.shape
        found = Expansion(np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n)))
        if inside.any():
            e = expand(self, x[inside])
            found.value[inside], found.gradient[inside], found.curvature[inside] = (
                e.value,
                e.gradient,
                e.curvature,
            )
        return found

    def far_off(self, z: Array) -> Array:
        """Minus the log density (m,) at scores (m, n)."""
        return -self.log_density(z)

    def admissible(self, x: Array) -> Array:
        """Mask (m,) of the parameter vectors (m, n_parameters) that satisfy the constraints (9)."""
        return self.model.admissible(x[:, : self.model.parameters.size])

    def _by_alternative(self, density: Array, in_range: Array) -> Array:
        """Log likelihood (n_alternatives, m) of every alternative pairing, its probability included."""
        return np.stack(
            [
                one.log_probability + self._log_likelihood(density[:, :, one.places], in_range[:, one.places])
                for one in self.alternatives
            ]
        )

    def _log_likelihood(self, density: Array, in_range: Array) -> Array:
        """Log likelihood (m,) from densities (m, n_f, n_modes) with labelled modes at their own indices."""
        if self.measurement.complete:
            i = np.arange(self.measurement.size)
            return np.asarray(density[:, i, i].sum(axis=1))
        return labelled_log_likelihood(density, in_range, self.span, self._known, self.pairing)

    @property
    def _known(self) -> Array:
        """Mode (n_f,) of each labelled frequency, -1 for the others."""
        return np.where(self.labelled, np.arange(len(self.labelled)), -1)

    def of_pairs(self, predicted: Array, sigma: Array) -> Array:
        """Log density (m, n_f, n_modes) of every measured frequency about every predicted one."""
        z = (self.measurement.frequencies[None, :, None] - predicted[:, None, :]) / sigma
        return self.noise_model.log_density(z) - np.log(sigma)

    def most_probable_pairing(self, x: Array) -> Pairing:
        """The most probable pairing of frequencies and modes at one parameter vector (n_parameters,)."""
        measurement = self.measurement
        if self.is_one_to_one:
            return Pairing(np.arange(measurement.size), np.empty(0, dtype=int), 0.0)
        predicted = self.predict(x[None])
        density, in_range = (
            self.of_pairs(predicted, self.noise(x[None], predicted)),
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
        """Probability (n,) of each frequency's assignment in a pairing, over draws (m, n_parameters)."""
        predicted = self.predict(draws)
        of_pair = pair_probabilities(
            self.of_pairs(predicted, self.noise(draws, predicted)),
            self.in_range(predicted),
            self.span,
            self.pairing,
        ).mean(axis=0)
        taken = of_pair[np.arange(len(pairing.mode)), pairing.mode]
        return np.asarray(np.where(pairing.mode >= 0, taken, 1.0 - of_pair.sum(axis=1)))

    def in_range(self, predicted: Array) -> Array:
        """Mask of the modes that a complete list would contain: those up to the highest listed frequency."""
        return np.asarray(predicted <= self.measurement.frequencies[-1])

    @property
    def span(self) -> float:
        """Width of the measured range, Hz."""
        return float(self.measurement.frequencies[-1])

    def log_prior(self, x: Array) -> Array:
        """Log prior (m,) of parameter vectors (m, n_parameters), -inf outside the support."""
        log_prior = self.parameters.log_prior(x)
        inside = np.isfinite(log_prior)
        allowed = inside.copy()
        allowed[inside] = self.admissible(x[inside])
        return np.where(allowed, log_prior, -np.inf)

    def log_prob(self, x: Array) -> Array:
        """Log posterior up to a constant, -inf outside the support, (m, n_parameters) -> (m,).

        Raises ``SolverError`` where it would not be a number.
        """
        x = np.atleast_2d(x)
        value = self.log_prior(x)
        inside = np.isfinite(value)
        if inside.any():
            value[inside] += self.log_likelihood(x[inside])
        return value

    def _described(self, x: Array) -> str:
        """Text of parameters and their values, SI; ``x`` may be those of the model alone."""
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
    tolerant : the model with further parameters, which predicts the same modes.

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
    scores = NormalScores(parameters)
    return Posterior(predicting, measurement, parameters, scores, noise, labelled, pairing, alternatives)


# Step of the complex-step derivative: any small number will do, no digits are lost.
_COMPLEX_STEP = 1e-30
# Steps of central differences of a summed likelihood along the model's tangent, for first and for second
# derivatives, in standard deviations of the priors, for the noise in its logarithm.
_STEP, _SECOND_STEP = 1e-5, 1e-4
# Differences of a summed likelihood that are computed at once: so many fit in a processor's cache.
_MOST_AT_ONCE = 1000


def _one_to_one(posterior: Posterior, x: Array) -> Expansion:
    """Expansion for a complete list: every frequency depends on its own mode alone.

    The Fisher information of location and log scale of a Student-t density of nu degrees of freedom is
    (nu + 1) / (nu + 3) / sigma^2 and 2 nu / (nu + 3) (Lange, Little and Taylor, 1989).
    """
    n_plate, n_f = posterior.model.parameters.size, posterior.measurement.size
    prediction = posterior.model.predict(x[:, :n_plate], jacobian=True)
    assert prediction.jacobian is not None
    f = prediction.frequencies
    slope = np.zeros((len(x), n_f, x.shape[1]))  # d f_i / dx
    slope[:, :, :n_plate] = prediction.jacobian[:, :n_f]
    i = np.arange(n_f)

    def paired(x: Array, f: Array) -> tuple[Array, Array]:
        sigma = posterior.noise(x, f)
        return posterior.of_pairs(f, sigma)[:, i, i], sigma[:, i, i]

    step = 1j * _COMPLEX_STEP
    density, sigma = paired(x, f + step)
    value, sigma_0 = density.real.sum(axis=1), sigma.real
    by_f = density.imag / _COMPLEX_STEP
    gradient = np.einsum("mi,mij->mj", by_f, slope)
    log_sigma = (sigma.imag / _COMPLEX_STEP / sigma_0)[..., None] * slope  # d log sigma_i / dx
    for j in range(n_plate, x.shape[1]):
        density, sigma = paired(x + step * (np.arange(x.shape[1]) == j), f)
        gradient[:, j] += density.imag.sum(axis=1) / _COMPLEX_STEP
        log_sigma[:, :, j] += sigma.imag / _COMPLEX_STEP / sigma_0
    nu = posterior.degrees_of_freedom
    location, scale = posterior.noise_model.information, 2.0 if np.isinf(nu) else 2.0 * nu / (nu + 3.0)
    weighted = slope / sigma_0[..., None]
    curvature = location * _gram(weighted) + scale * _gram(log_sigma)
    return Expansion(value, gradient, curvature)


def _gram(a: Array) -> Array:
    return np.asarray(np.swapaxes(a, 1, 2) @ a)


@dataclass(frozen=True, slots=True)
class _Tangent:
    """The tangent of a model at m points, which is linear in its parameters."""

    parameters: ParameterSet
    at: Array
    frequencies: Array
    jacobian: Array

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        away = np.einsum("mij,mj->mi", self.jacobian, x - self.at)
        return Prediction(self.frequencies + away, self.jacobian if jacobian else None)

    def admissible(self, x: Array) -> Array:
        return np.ones(len(x), dtype=bool)


@dataclass(frozen=True, slots=True)
class _TangentPosterior(Posterior):
    """A posterior over a tangent, with the modes in range held as at its points.

    A mode enters the range at the highest listed frequency, next to which every optimum lies: a
    difference across that small jump would not measure the slope.
    """

    seen: Array = field(default_factory=lambda: np.empty((0, 0), dtype=bool))

    def in_range(self, predicted: Array) -> Array:
        return self.seen


def _summed(posterior: Posterior, x: Array) -> Expansion:
    """Expansion where pairings are summed over: differences along the model's tangent, without solves."""
    n_plate, n = posterior.model.parameters.size, x.shape[1]
    prediction = posterior.model.predict(x[:, :n_plate], jacobian=True)
    assert prediction.jacobian is not None
    seen = posterior.in_range(prediction.frequencies)
    slope, unit = posterior.parameters.prior_sd * np.ones_like(x), np.eye(n)
    slope[:, n_plate:] = x[:, n_plate:]  # of the noise, a scale, in its logarithm
    pairs = np.array([(j, k) for j in range(n) for k in range(j + 1)])
    j, k = pairs.T
    first, second = _STEP * unit, _SECOND_STEP * unit
    offsets = np.concatenate(
        (np.zeros((1, n)), first, -first, *(s * second[j] + t * second[k] for s in (1, -1) for t in (1, -1)))
    )
    changed = {f.name: getattr(posterior, f.name) for f in fields(Posterior)}
    values = np.empty((len(x), len(offsets)))
    block = max(_MOST_AT_ONCE // len(offsets), 1)
    for rows in (slice(i, i + block) for i in range(0, len(x), block)):
        at, of_model, frequencies, jacobian, in_range = (
            np.repeat(a[rows], len(offsets), axis=0)
            for a in (x, x[:, :n_plate], prediction.frequencies, prediction.jacobian, seen)
        )
        tangent = _Tangent(posterior.model.parameters, of_model, frequencies, jacobian)
        along = _TangentPosterior(**changed | {"model": tangent}, seen=in_range)
        moved = at + (offsets * slope[rows, None]).reshape(at.shape)
        values[rows] = along.log_likelihood(moved).reshape(-1, len(offsets))
    value, up, down, *corners = np.split(values, np.cumsum([1, n, n, *[len(pairs)] * 3]), axis=1)
    gradient = (up - down) / (2.0 * _STEP)
    bend = np.empty((len(x), n, n))
    bend[:, j, k] = bend[:, k, j] = -(corners[0] - corners[1] - corners[2] + corners[3]) / (
        4.0 * _SECOND_STEP**2
    )
    values, vectors = np.linalg.eigh(bend)
    bend = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    inverse = 1.0 / slope
    return Expansion(value[:, 0], gradient * inverse, bend * inverse[:, :, None] * inverse[:, None, :])


def gauss_newton_covariance(posterior: Posterior, x: Array) -> Array:
    """(F + P^-1)^-1 at x (n,), F the information of the data, P the covariance of the priors, (n, n).

    A direction that the data leave open keeps its prior's width.
    """
    by_sd = 1.0 / posterior.parameters.prior_sd
    of_prior = by_sd[:, None] * posterior.parameters.precision * by_sd
    return np.asarray(np.linalg.inv(posterior.expand_likelihood(x[None]).curvature[0] + of_prior))
