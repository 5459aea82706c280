"""Gradient, curvature and Hessian of a posterior against differences and closed forms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import t

from cpam_bayes.forward_model.model import NO_PARAMETERS, PlateModel, converged_model
from cpam_bayes.inference.derivatives import (
    coordinates,
    expand,
    expand_u,
    hessian_u,
    information,
    log_density,
)
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.parameters import ScaledStudentT, TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement, Specimen, builtin
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, measurement
from tests.toy_models import ToyModel, independent, listed, parameters

ERROR = np.array([1e-3, 2e-3, 1e-3, 3e-3])


def curved(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Five frequencies that are not linear in two parameters."""
    mean, slope = np.append(MEAN_HZ, 500.0), np.vstack((SLOPE_HZ, [5.0, 5.0]))
    z = x @ slope.T
    return mean + z + 0.01 * z**2, (1.0 + 0.02 * z)[:, :, None] * slope


PRIORS = {
    "uniform": parameters(a=Uniform(-2.0, 2.0), b=Uniform(-2.0, 2.0)),
    "normal": parameters(
        a=TruncatedNormal(0.1, 0.3, -2.0, 2.0), b=TruncatedNormal(0.0, 0.5, -np.inf, np.inf)
    ),
    "student": parameters(a=ScaledStudentT(0.4, 4.0, -2.0, 2.0), b=Uniform(-2.0, 2.0)),
}


def some_posterior(case: str) -> Posterior:
    model = ToyModel(PRIORS.get(case, PRIORS["uniform"]), curved)
    error = np.append(ERROR, 1e-3)
    inferred = measurement(None, resolution=1.0)
    if case == "student noise":
        return plate_posterior(model, inferred, error, degrees_of_freedom=4.0)
    if case == "absolute noise":
        return plate_posterior(model, inferred, error, likelihood="absolute")
    if case == "own deviations":
        return plate_posterior(model, listed(inferred.frequencies, np.array([1.0, 3.0, 2.0, 5.0])), error)
    if case == "incomplete":
        gaps = Measurement(inferred.frequencies[[0, 1, 3]], 1.0, None, None, ("",) * 3, complete=False)
        return plate_posterior(model, gaps, error)
    return plate_posterior(model, inferred, error)


CASES = [*PRIORS, "student noise", "absolute noise", "own deviations", "incomplete"]


def vectors(posterior: Posterior, m: int = 12) -> np.ndarray:
    x = posterior.parameters.sample(np.random.default_rng(0), m)
    inside = (x > posterior.parameters.lower + 0.01) & (x < posterior.parameters.upper - 0.01)
    return np.where(inside, x, 0.05)


def differences(posterior: Posterior, x: np.ndarray, step: float) -> np.ndarray:
    """Central differences of the log probability, in units of a step of each coordinate u, (m, n)."""
    h = step * coordinates(posterior).slope(x)
    unit = np.eye(x.shape[1])
    return np.stack(
        [(posterior.log_prob(x + h * e) - posterior.log_prob(x - h * e)) / (2.0 * step) for e in unit], axis=1
    )


@pytest.mark.parametrize("case", CASES)
def test_gradient_is_the_limit_of_differences(case: str) -> None:
    own = some_posterior(case)
    x = vectors(own)
    e = expand(own, x)
    value, gradient = e.value, e.gradient
    np.testing.assert_allclose(value, own.log_prob(x), rtol=1e-12)
    gradient = gradient * coordinates(own).slope(x)
    coarse, fine = (differences(own, x, h) for h in (2e-4, 1e-4))
    extrapolated = (4.0 * fine - coarse) / 3.0
    size = np.abs(gradient).max(axis=1, keepdims=True)
    # rounding of a log probability of some 1e3 over the step of 1e-4, beside gradients of some 1e2
    np.testing.assert_array_less(np.abs(gradient - extrapolated) / size, 1e-6)


@pytest.mark.parametrize("case", CASES)
def test_a_stack_gives_what_each_vector_gives(case: str) -> None:
    own = some_posterior(case)
    x = vectors(own, 5)
    together = expand(own, x)
    for i in range(5):
        alone = expand(own, x[i : i + 1])
        assert alone.value[0] == pytest.approx(together.value[i], rel=1e-12)
        # summed pairings are differenced: rounding over the square of the step
        near = {"rtol": 1e-9} if own.measurement.complete else {"rtol": 1e-4, "atol": 1e-2}
        np.testing.assert_allclose(alone.gradient[0], together.gradient[i], **near)
        np.testing.assert_allclose(alone.curvature[0], together.curvature[i], **near)


def test_outside_the_support_the_gradient_is_zero_and_the_model_is_not_asked() -> None:
    own = some_posterior("uniform")
    x = np.array([[9.0, 0.0, 0.01], [0.1, 0.0, 0.01]])
    e = expand(own, x)
    value, gradient = e.value, e.gradient
    assert value[0] == -np.inf
    np.testing.assert_array_equal(gradient[0], 0.0)
    assert np.isfinite(value[1])
    assert np.any(gradient[1] != 0.0)


def test_curvature_of_known_gaussian_noise_is_that_of_least_squares() -> None:
    own = plate_posterior(LinearModel(), measurement(0.01), np.zeros(4))
    weight = 1.0 / (0.01 * own.measurement.frequencies) ** 2
    expected = SLOPE_HZ.T @ (weight[:, None] * SLOPE_HZ)
    np.testing.assert_allclose(expand(own, np.array([[0.3, 0.1]])).curvature[0], expected, rtol=1e-12)


def test_curvature_is_the_expected_one_for_student_t_noise() -> None:
    """Fisher information by quadrature of the squared score, for the location and the log scale."""
    nu = 4.0
    own = replace(
        plate_posterior(LinearModel(), measurement(None), np.zeros(4), degrees_of_freedom=nu), pairing=()
    )
    x = np.array([[0.3, 0.1, 0.02]])
    sigma = 0.02 * own.measurement.frequencies

    def location(z: float) -> float:
        return ((nu + 1) * z / (nu + z**2)) ** 2 * float(t.pdf(z, nu))

    def log_scale(z: float) -> float:
        return ((nu + 1) * z**2 / (nu + z**2) - 1.0) ** 2 * float(t.pdf(z, nu))

    by_location, by_scale = (quad(f, -np.inf, np.inf)[0] for f in (location, log_scale))
    found = information(own, x)[0]
    weighted = SLOPE_HZ / sigma[:, None]
    np.testing.assert_allclose(found[:2, :2], by_location * weighted.T @ weighted, rtol=1e-7)
    assert found[2, 2] * 0.02**2 == pytest.approx(4 * by_scale, rel=1e-7)


def test_curvature_of_a_prior_is_its_own() -> None:
    sd = 0.3
    own = plate_posterior(
        LinearModel(parameters(a=TruncatedNormal(0.1, sd, -2.0, 2.0), b=Uniform(-2.0, 2.0))),
        measurement(0.01),
        np.zeros(4),
    )
    x = np.array([[0.3, 0.1]])
    added = expand(own, x).curvature - information(own, x)
    np.testing.assert_allclose(added[0], np.diag([1.0 / sd**2, 0.0]), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("at", [np.array([0.3, 0.1]), np.array([2.0, -2.0])], ids=["inside", "on bounds"])
def test_exact_hessian_of_a_linear_model_is_that_of_least_squares(at: np.ndarray) -> None:
    own = plate_posterior(LinearModel(), measurement(0.01), np.zeros(4))
    axes = coordinates(own)
    weight = 1.0 / (0.01 * own.measurement.frequencies) ** 2
    expected = SLOPE_HZ.T @ (weight[:, None] * SLOPE_HZ) * axes.scale[:, None] * axes.scale
    found = hessian_u(own, axes, axes.to_u(at), np.full(2, 0.05))
    # the gradient is linear: rounding alone, 1e-16 of some 1e3 over steps of 5e-5
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-6)


def test_exact_hessian_is_the_second_difference_of_the_log_density() -> None:
    own = some_posterior("student noise")
    axes = coordinates(own)
    u = axes.to_u(np.array([0.4, -0.3, 0.01]))
    found = hessian_u(own, axes, u, np.array([0.05, 0.05, 0.4]))
    h, unit = 1e-3, np.eye(3)
    for i in range(3):
        for j in range(3):
            corners = np.stack([u + h * (a * unit[i] + b * unit[j]) for a in (1, -1) for b in (1, -1)])
            second = log_density(own, axes, corners) @ np.array([1, -1, -1, 1]) / (4 * h**2)
            # third derivatives, over a step of a thousandth
            assert -found[i, j] == pytest.approx(second, rel=2e-3, abs=0.05)


def test_coordinates_carry_the_gradient_and_come_back() -> None:
    own = some_posterior("uniform")
    axes = coordinates(own)
    x = vectors(own, 4)
    np.testing.assert_allclose(axes.to_x(axes.to_u(x)), x, rtol=1e-14)
    u = axes.to_u(x)
    found, h = expand_u(own, axes, u), 1e-4
    np.testing.assert_allclose(found.value, log_density(own, axes, u), rtol=1e-12)
    for j, e in enumerate(np.eye(3)):
        slope = (log_density(own, axes, u + h * e) - log_density(own, axes, u - h * e)) / (2 * h)
        np.testing.assert_allclose(found.gradient[:, j], slope, rtol=1e-4, atol=1e-3)


@dataclass(frozen=True)
class Plate:
    specimen: Specimen
    model: PlateModel


@pytest.fixture(scope="module")
def plate() -> Plate:
    specimen = builtin("A1")
    f = converged_model(specimen, NO_PARAMETERS, 6).predict(np.empty((1, 0))).frequencies[0]
    assert specimen.measurement is not None
    own = replace(specimen, measurement=replace(specimen.measurement, frequencies=f))
    return Plate(own, converged_model(own, own.unknowns, 6))


def test_gradient_of_a_real_plate_is_the_limit_of_differences(plate: Plate) -> None:
    assert plate.specimen.measurement is not None
    own = plate_posterior(plate.model, plate.specimen.measurement, plate.model.error)
    x = own.parameters.sample(np.random.default_rng(1), 40)
    x = x[np.isfinite(own.log_prob(x)) & (x[:, -1] > 1e-3)][:6]
    gradient = expand(own, x).gradient
    gradient = gradient * coordinates(own).slope(x)
    size = np.abs(gradient).max(axis=1, keepdims=True)
    # eigenvalues are known to some 1e-9, differences of them to 1e-9 over the step of 1e-4
    np.testing.assert_array_less(np.abs(gradient - differences(own, x, 1e-4)) / size, 1e-4)


def test_independent_parameters_have_a_diagonal_curvature() -> None:
    own = independent((3.0, 7.0))
    found = expand(own, np.array([[0.2, 0.4]]))
    np.testing.assert_allclose(found.curvature[0], 100.0 * np.eye(2), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.gradient[0], [10.0, 30.0], rtol=1e-10)
