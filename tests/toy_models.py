"""Minimal forward models, for posteriors that can be integrated by hand or by quadrature."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Measurement
from cpam_bayes.priors import Prior


@dataclass(frozen=True)
class ToyModel:
    """A model with a function of parameter vectors (m, n) that returns frequencies and their Jacobian."""

    parameters: ParameterSet
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    allowed: Callable[[np.ndarray], np.ndarray] = lambda x: np.ones(len(x), dtype=bool)

    def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
        f, slope = self.function(np.atleast_2d(x))
        return Prediction(f, slope if jacobian else None)

    def admissible(self, x: np.ndarray) -> np.ndarray:
        return self.allowed(np.atleast_2d(x))


def parameters(**priors: Prior) -> ParameterSet:
    return ParameterSet(tuple(Parameter(name, "", prior) for name, prior in priors.items()))


def listed(f: np.ndarray, sd: np.ndarray | None, *, relative: float | None = None) -> Measurement:
    """A complete list with a standard deviation for each frequency, Hz, or another kind of noise."""
    return Measurement(np.asarray(f, float), 0.0, relative, sd, ("",) * len(f), complete=True)


def linear(mean: np.ndarray, slope: np.ndarray, own: ParameterSet) -> ToyModel:
    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return mean + x @ slope.T, np.broadcast_to(slope, (len(x), *slope.shape))

    return ToyModel(own, function)


def independent(off: tuple[float, ...], sd: float = 1.0) -> Posterior:
    """Parameters uniform on [0, 1], each shifting one frequency by 10 Hz, measured ``off`` from that at 0.
    The posterior is a product of Gaussians, mean off / 10 and standard deviation sd / 10, cut to [0, 1]."""
    n = len(off)
    mean = 100.0 * np.arange(1, n + 1)
    model = linear(mean, 10.0 * np.eye(n), parameters(**{f"p{i}": Uniform(0.0, 1.0) for i in range(n)}))
    return plate_posterior(model, listed(mean + np.array(off), np.full(n, sd)), np.zeros(n))


def two_peaks(separation: float = 1.0) -> Posterior:
    """One frequency measures a^2, so that a and -a are equally probable; another measures b + a."""
    own = parameters(a=Uniform(-2.0, 2.0), b=Uniform(-2.0, 2.0))

    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = x.T
        zero, one = np.zeros_like(a), np.ones_like(a)
        f = np.stack((100.0 + 10.0 * a**2, 200.0 + 10.0 * (a + b)), axis=1)
        return f, np.stack((np.stack((20.0 * a, zero), 1), np.stack((10.0 * one, 10.0 * one), 1)), axis=1)

    data = listed(np.array([100.0 + 10.0 * separation**2, 203.0]), np.array([1.0, 2.0]))
    return plate_posterior(ToyModel(own, function), data, np.zeros(2))


def crossing() -> Posterior:
    """Two modes that cross at a = 0, sorted, so that each frequency has a kink there.
    The list is met exactly at (0.4, 0.7); at a < 0 both frequencies take the other mode's slope."""
    own = parameters(a=Uniform(-1.0, 1.0), b=Uniform(-1.0, 1.0))
    mean, slope = np.array([200.0, 200.0]), np.array([[10.0, 6.0], [-10.0, 9.0]])

    def function(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        f = mean + x @ slope.T
        order = np.argsort(f, axis=1, kind="stable")
        third = 300.0 + 20.0 * x[:, :1] + 25.0 * x[:, 1:]
        jacobian = np.concatenate((slope[order], np.full((len(x), 1, 2), [20.0, 25.0])), axis=1)
        return np.concatenate((np.take_along_axis(f, order, axis=1), third), axis=1), jacobian

    model = ToyModel(own, function)
    f = model.predict(np.array([[0.4, 0.7]])).frequencies[0]
    return plate_posterior(model, listed(f, np.array([0.05, 0.05, 2.0])), np.zeros(3))


def integral(posterior: Posterior, edges: tuple[np.ndarray, ...]) -> float:
    """Log of the integral of exp(log_prob) over a grid, by the trapezoidal rule."""
    grid = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1)
    value = posterior.log_prob(grid.reshape(-1, len(edges))).reshape(grid.shape[:-1])
    total = np.exp(value - value.max())
    for edge in reversed(edges):
        total = np.trapezoid(total, edge, axis=-1)
    return float(np.log(total) + value.max())


def integral_over_noise(posterior: Posterior, lower: float = 1e-4, upper: float = 0.3) -> float:
    """Log of the integral over two parameters and the noise of a linear model, exact to about 1e-3."""
    f = posterior.measurement.frequencies  # at each noise level the grid is as fine as the Gaussian
    prediction = posterior.model.predict(np.zeros((1, 2)), jacobian=True)
    weighted = prediction.jacobian[0] / f[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    mean = covariance @ weighted.T @ (f / f - prediction.frequencies[0] / f)
    noise = np.geomspace(lower * (1 + 1e-9), upper * (1 - 1e-9), 80)
    values = []
    for s in noise:
        reach = 8.0 * s * np.sqrt(np.diag(covariance))
        edges = [np.linspace(max(-2.0, m - r), min(2.0, m + r), 41) for m, r in zip(mean, reach, strict=True)]
        grid = np.stack(np.meshgrid(*edges, indexing="ij"), axis=-1).reshape(-1, 2)
        height = np.exp(posterior.log_prob(np.column_stack((grid, np.full(len(grid), s))))).reshape(41, 41)
        values.append(s * np.trapezoid(np.trapezoid(height, edges[1], axis=1), edges[0]))
    return float(np.log(np.trapezoid(values, np.log(noise))))
