"""How measured frequencies scatter about those of their modes: the scale of the noise and its shape.

Scale and shape are independent of each other and of the model: a scale is one number for every
frequency, by which an amplitude is multiplied; the shape is Gaussian or Student's t.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from cpam_bayes.parameters import Parameter, ScaledStudentT
from cpam_bayes.plate import Measurement

Array = NDArray[Any]
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
