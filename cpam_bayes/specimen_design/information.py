"""What the frequencies of a specimen would say about its constants: Laplace's approximation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.model import PlateModel, plate_problem, reference_vector, size_parameters
from cpam_bayes.mechanics.convergence import Tolerance, converge
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen

__all__ = ["Expected", "Response", "Test", "expected_information", "response_of"]

Array = NDArray[Any]

# A tenth of a usual measurement's noise will do.
_TOLERANCE = Tolerance(kept=3e-4, rich=2e-4)
# Constants beside the reference ones, so that equal ones make no symmetry; relative.
_BESIDE = 0.01


@dataclass(frozen=True, slots=True)
class Response:
    """Frequencies of a specimen at the reference constants.

    frequencies : (n_modes,) Hz
    slopes : (n_modes, n) their derivatives by the constants, then by the sizes with a standard deviation, for
        each standard deviation of the prior, Hz
    error : (n_modes,) estimated relative error
    """

    frequencies: Array
    slopes: Array
    error: Array


@dataclass(frozen=True, slots=True)
class Test:
    """How frequencies would be measured; relative_std : repeatability, resolution : Hz."""

    __test__ = False  # it is none of pytest's

    relative_std: float
    resolution: float


@dataclass(frozen=True, slots=True)
class Expected:
    """What a list would leave.

    information : about the constants asked for, nats
    each : (n,) about each constant alone, nats
    sd : (n,) standard deviations of the constants, SI
    """

    information: float
    each: Array
    sd: Array


def response_of(specimen: Specimen, n_modes: int) -> Response:
    """The frequencies of a specimen and their derivatives, on a Ritz space converged at the reference.

    Raises ``RigidBodyError`` where bending cannot be told from rounding.
    """
    parameters = specimen.unknowns.union(size_parameters(specimen))
    problem = plate_problem(specimen, parameters)
    x = reference_vector(specimen, parameters)
    beside = x * (1.0 + _BESIDE * np.linspace(-1.0, 1.0, len(x)))
    samples = np.stack((x, np.clip(beside, parameters.lower, parameters.upper)))
    samples = samples[problem.admissible(parameters.mapping(samples)) | np.array([True, False])]
    converged = converge(problem, parameters.mapping(samples), n_modes, _TOLERANCE)
    predicted = PlateModel(converged.operator, n_modes, converged.error).predict(x, jacobian=True)
    assert predicted.jacobian is not None
    return Response(
        predicted.frequencies[0], predicted.jacobian[0] * prior_sd(parameters), converged.error[:n_modes]
    )


def prior_sd(parameters: ParameterSet) -> Array:
    """Standard deviations of the priors, (n,)."""
    return np.array([p.prior.sd for p in parameters.parameters])


def expected_information(
    response: Response, n_modes: int, test: Test, prior: Array, asked: Array
) -> Expected:
    """The information of the lowest modes about constants, with everything else integrated over.

    The posterior at the reference is Gaussian with the precision F + P^-1, F = J^T S^-1 J the Fisher
    information of the frequencies and P the variances of the priors. The expected information is
    I = 1/2 (log det P_A - log det C_A), C_A the block of the constants asked for in (F + P^-1)^-1
    (Lindley, 1956; Chaloner and Verdinelli, 1995). S = (relative_std f)^2 + resolution^2 / 12 +
    (solver's error)^2.

    prior : (n,) standard deviations of the constants' priors; asked : (n,) bool
    """
    f = response.frequencies[:n_modes]
    noise = (test.relative_std * f) ** 2 + test.resolution**2 / 12.0 + (response.error[:n_modes] * f) ** 2
    j = response.slopes[:n_modes] / np.sqrt(noise)[:, None]
    covariance = np.linalg.inv(j.T @ j + np.eye(j.shape[1]))  # in units of the priors
    n = len(prior)
    of_constants = covariance[:n, :n]
    spread = np.sqrt(np.diagonal(of_constants))
    block = of_constants[np.ix_(asked, asked)]
    return Expected(-0.5 * float(np.linalg.slogdet(block)[1]), -np.log(spread), spread * prior)
