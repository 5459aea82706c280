"""Which combinations of the constants the frequencies determine, and which they leave to the prior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.laplace import prior_sd
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Combination:
    """A product of powers of the plate's parameters that the frequencies see as one number.

    exponents : (n_plate,) the largest in size is 1.
    singular_value : of the weighted Jacobian, the prior's sd over the noise's along the combination.
    noise_sd, prior_sd : standard deviations of the product's logarithm, by the frequencies alone (infinite
    where they say nothing) and by the prior.
    """

    exponents: Array
    singular_value: float
    noise_sd: float
    prior_sd: float

    @property
    def contraction(self) -> float:
        """1 - (posterior sd / prior sd)^2 of a Gaussian prior, between 0 and 1."""
        squared = self.singular_value**2
        return squared / (1.0 + squared)


def weighted_jacobian(posterior: Posterior, x: Array, pairing: Pairing) -> Array:
    """W^(1/2) S^-1 J diag(prior sd) at x (n,): whitened by the noise, scaled by the priors.

    S are the noise's standard deviations of the paired frequencies, W the information of a
    standardised residual, 1 for Gaussian noise and (nu + 1) / (nu + 3) for Student-t noise (Lange,
    Little and Taylor, 1989). (n_pairs, n_plate).
    """
    n = posterior.model.parameters.size
    prediction = posterior.model.predict(x[None, :n], jacobian=True)
    assert prediction.jacobian is not None
    rows, columns = paired(pairing)
    sigma = posterior.noise(x[None], prediction.frequencies)[0, rows, columns]
    weight = np.sqrt(information(posterior.degrees_of_freedom))
    return np.asarray(weight * prediction.jacobian[0, columns] / sigma[:, None] * prior_sd(posterior)[:n])


def information(degrees_of_freedom: float) -> float:
    """Fisher information of the location of a standardised residual."""
    nu = degrees_of_freedom
    return 1.0 if np.isinf(nu) else (nu + 1.0) / (nu + 3.0)


def paired(pairing: Pairing) -> tuple[Array, Array]:
    """Frequencies that have a mode and those modes, (n_pairs,) each."""
    rows = np.flatnonzero(pairing.mode >= 0)
    return rows, pairing.mode[rows]


def combinations(posterior: Posterior, x: Array, pairing: Pairing) -> tuple[Combination, ...]:
    """Combinations of the plate's parameters from the best to the worst determined.

    With the singular value decomposition A = U D V^T of the weighted Jacobian at x, the frequencies
    measure v^T (p - x) / prior sd with sd 1 / d. Since dp = x dln p, that is the logarithm of a product
    of powers v_k x_k / sd_k. Scaling by the priors makes the decomposition the one in which the
    prior (as a Gaussian of the same spread) and the data are both diagonal.
    """
    n = posterior.model.parameters.size
    jacobian = weighted_jacobian(posterior, x, pairing)
    _, singular_values, directions = np.linalg.svd(jacobian, full_matrices=True)
    singular = np.zeros(n)
    singular[: len(singular_values)] = singular_values[:n]
    relative = x[:n] / prior_sd(posterior)[:n]
    return tuple(_combination(v * relative, float(d)) for v, d in zip(directions, singular, strict=True))


def _combination(powers: Array, singular_value: float) -> Combination:
    largest = powers[np.argmax(np.abs(powers))]
    scale = float(1.0 / abs(largest))
    # below rounding of the Jacobian nothing is measured
    noise_sd = scale / singular_value if singular_value > 1e-12 else np.inf
    return Combination(powers / largest, singular_value, noise_sd, scale)
