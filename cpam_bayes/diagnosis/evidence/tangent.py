"""A plate's frequencies as powers of its constants about one point: what screening takes them to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.inference.posterior import ForwardModel
from cpam_bayes.parameters import ParameterSet

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class TangentModel:
    """ln f = ln f_0 + S (ln x - ln x_0): exact to first order, and where one constant scales all of them.

    exact : the model that it stands for.
    x : (n,) where it touches it.
    log_f : (n_modes,).
    slope : (n_modes, n), d ln f / d ln x; all parameters are positive.
    """

    exact: ForwardModel
    x: Array
    log_f: Array
    slope: Array

    @property
    def parameters(self) -> ParameterSet:
        """Those of the exact model."""
        return self.exact.parameters

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives."""
        x = np.atleast_2d(x)
        f = np.exp(self.log_f + (np.log(x) - np.log(self.x)) @ self.slope.T)
        return Prediction(f, f[..., None] * self.slope / x[:, None, :] if jacobian else None)

    def admissible(self, x: Array) -> Array:
        """Those of the exact model."""
        return self.exact.admissible(x)


def tangents(cases: Sequence[PlateCase], none: Comparison, x: Array) -> dict[int, ForwardModel]:
    """Tangent models of all plates at parameters x (n,) of the plain model."""
    models: dict[int, ForwardModel] = {}
    for i, (case, part) in enumerate(zip(cases, none.model.parts, strict=True)):
        x_plate = part.plate_vector(x[None])
        prediction = case.models.bare.predict(x_plate, jacobian=True)
        assert prediction.jacobian is not None
        f = prediction.frequencies[0]
        slope = prediction.jacobian[0] * x_plate[0] / f[:, None]
        models[i] = TangentModel(case.models.bare, x_plate[0], np.log(f), slope)
    return models
