"""A forward model whose posterior is known in closed form."""

from dataclasses import dataclass

import numpy as np

from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Measurement

MEAN_HZ = np.array([100.0, 200.0, 300.0, 400.0])
SLOPE_HZ = np.array([[10.0, 0.0], [0.0, 20.0], [15.0, 15.0], [20.0, -10.0]])
BOTH = ParameterSet(tuple(Parameter(name, "", Uniform(-2.0, 2.0)) for name in ("a", "b")))


@dataclass(frozen=True)
class LinearModel:
    """Frequencies MEAN_HZ + SLOPE_HZ x of two parameters that are uniform on [-2, 2]."""

    parameters: ParameterSet = BOTH

    def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
        x = np.atleast_2d(x)
        slope = np.broadcast_to(SLOPE_HZ, (len(x), *SLOPE_HZ.shape))
        return Prediction(MEAN_HZ + x @ SLOPE_HZ.T, slope if jacobian else None)

    def admissible(self, x: np.ndarray) -> np.ndarray:
        return np.ones(np.shape(x)[:-1], dtype=bool)


def measurement(relative_std: float | None, resolution: float = 0.0) -> Measurement:
    f = MEAN_HZ + SLOPE_HZ @ np.array([0.4, -0.3]) + np.array([0.6, -0.9, 0.3, 1.1])
    return Measurement(f, resolution, relative_std, None, ("",) * 4, complete=True)


def exact_gaussian(data: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Mean (2,) and covariance (2, 2) of the posterior if its bounds are far away."""
    assert data.relative_std is not None
    weight = 1.0 / (data.relative_std * data.frequencies) ** 2
    covariance = np.linalg.inv(SLOPE_HZ.T @ (weight[:, None] * SLOPE_HZ))
    return covariance @ SLOPE_HZ.T @ (weight * (data.frequencies - MEAN_HZ)), covariance
