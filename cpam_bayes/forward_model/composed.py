"""Frequencies of the lists of one or several plates, each with its effects, from one parameter vector."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cpam_bayes.forward_model.model import ForwardModel, Prediction
from cpam_bayes.forward_model.reduced import ReducedModel, basis_error, focused
from cpam_bayes.mechanics.problem import Array, Values
from cpam_bayes.parameters import ParameterSet

_STEP = 1e-30
# Size of a block from which a second projection pays.
LARGE_BASIS = 80


@dataclass(frozen=True, slots=True)
class Change:
    """An effect in the model of one plate.

    names, columns : of the effect's parameters, in the joint vector
    model : of the plate with the effect, in the plate's parameters and then the effect's; ``None`` where
        the effect acts on the frequencies
    observe : frequencies (..., n_modes) and values (...) -> frequencies
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    model: ForwardModel | None = None
    observe: Callable[[Array, Values], Array] | None = None


@dataclass(frozen=True, slots=True)
class Part:
    """One plate under one test.

    bare : its model
    columns : (n,) of its parameters in the joint vector
    scatter : (n,) columns of their relative deviations from these, -1 for none
    changes : the effects that it has
    modes : (n_f,) the model mode of each frequency of its list
    misread : misread frequencies, each with the column of its relative error
    """

    bare: ForwardModel
    columns: Array
    scatter: Array
    changes: tuple[Change, ...]
    modes: Array
    misread: tuple[tuple[int, int], ...] = ()

    def plate_vector(self, x: Array) -> Array:
        """Parameters of the plate at joint vectors (m, n), (m, n_plate)."""
        vector = x[:, self.columns]
        varied = self.scatter >= 0
        if varied.any():
            vector = vector.copy()
            vector[:, varied] *= 1.0 + x[:, self.scatter[varied]]
        return np.asarray(vector)


@dataclass(frozen=True, slots=True)
class ComposedModel:
    """Frequencies of the lists of all plates, one after the other, from one parameter vector.

    The relative shifts of two effects of one plate add: ln f = ln f_1 + ln f_2 - ln f_0, with f_0 of the
    bare plate.
    """

    parameters: ParameterSet
    parts: tuple[Part, ...]

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        """Frequencies at parameter vectors (m, n) and, if asked, their derivatives."""
        x = np.atleast_2d(x)
        x = x[:, : self.parameters.size]
        predictions = [_predict(part, x, jacobian) for part in self.parts]
        slopes = [f.jacobian for f in predictions if f.jacobian is not None]
        return Prediction(
            np.concatenate([f.frequencies for f in predictions], axis=1),
            np.concatenate(slopes, axis=1) if jacobian else None,
        )

    def admissible(self, x: Array) -> Array:
        """Whether parameter vectors (m, n) satisfy the constraints (9) of every plate and of its effects."""
        x = np.atleast_2d(x)
        admissible = np.ones(len(x), dtype=bool)
        for part in self.parts:
            vector = part.plate_vector(x)
            admissible &= part.bare.admissible(vector)
            for change in part.changes:
                if change.model is not None:
                    admissible &= change.model.admissible(_extended(vector, x, change))
        return admissible

    def basis_error(self, x: Array) -> float | None:
        """Largest relative error of a listed frequency from the reduced bases, by full solves at x (m, n).

        ``None`` where no model in use is a ``ReducedModel``.
        """
        x = np.atleast_2d(x)[:, : self.parameters.size]
        errors = []
        for part in self.parts:
            vector = part.plate_vector(x)
            of_plate = [change for change in part.changes if change.model is not None]
            asked = [(change.model, _extended(vector, x, change)) for change in of_plate]
            if len(of_plate) != 1:
                asked.append((part.bare, vector))
            modes = part.modes[part.modes >= 0]
            errors += [
                basis_error(model, at)[:, modes].max(initial=0.0)
                for model, at in asked
                if isinstance(model, ReducedModel)
            ]
        return float(max(errors)) if errors else None

    def without_changes(self) -> ComposedModel:
        """The bare plates with the same lists."""
        return replace(self, parts=tuple(replace(part, changes=()) for part in self.parts))

    def about(
        self, x: Array, tolerance: float, fraction: float, *, least_size: int = LARGE_BASIS
    ) -> ComposedModel:
        """The model with its reduced models on fewer basis vectors, enough about parameter vectors x (m, n).

        tolerance, fraction : as in ``focused``
        least_size : models whose largest block is smaller are kept

        Raises ``RigidBodyError`` where a plate has no modes at one of them.
        """
        known: dict[int, ForwardModel] = {}

        def smaller(model: ForwardModel, of_model: Array) -> ForwardModel:
            if not isinstance(model, ReducedModel):
                return model
            if max(block.size for block in model.fast.operator.blocks) < least_size:
                return model
            if id(model) not in known:
                known[id(model)] = focused(model, of_model, tolerance, fraction)
            return known[id(model)]

        x = np.atleast_2d(x)[:, : self.parameters.size]
        parts = []
        for part in self.parts:
            vector = part.plate_vector(x)
            changes = tuple(
                change
                if change.model is None
                else replace(change, model=smaller(change.model, _extended(vector, x, change)))
                for change in part.changes
            )
            is_bare_used = sum(change.model is not None for change in changes) != 1
            bare = smaller(part.bare, vector) if is_bare_used else part.bare
            parts.append(replace(part, bare=bare, changes=changes))
        return replace(self, parts=tuple(parts))


def _extended(vector: Array, x: Array, change: Change) -> Array:
    """Parameters of a plate and of its effect, (m, n_plate + n_effect), from its own and joint vectors."""
    return np.column_stack((vector, x[:, list(change.columns)]))


def _predict(part: Part, x: Array, jacobian: bool) -> Prediction:
    vector = part.plate_vector(x)
    of_plate = [change for change in part.changes if change.model is not None]
    if len(of_plate) == 1:
        log_f, slope = _log_prediction(part, vector, x, of_plate[0], jacobian)
    else:
        log_f, slope = _log_prediction(part, vector, x, None, jacobian)
        bare_f, bare_slope = log_f, slope
        for change in of_plate:
            with_f, with_slope = _log_prediction(part, vector, x, change, jacobian)
            log_f = log_f + with_f - bare_f
            slope = slope + with_slope - bare_slope
    f = np.exp(log_f)
    slope = slope * f[..., None]
    for change in part.changes:
        if change.observe is not None:
            f, slope = _observed(change, f, slope, x, jacobian)
    f, slope = f[:, part.modes], slope[:, part.modes]
    for i, column in part.misread:
        factor = 1.0 + x[:, column]
        f, slope = f.copy(), slope.copy()
        if jacobian:
            slope[:, i] *= factor[:, None]
            slope[:, i, column] += f[:, i]
        f[:, i] *= factor
    return Prediction(f, slope if jacobian else None)


def _log_prediction(
    part: Part, vector: Array, x: Array, change: Change | None, jacobian: bool
) -> tuple[Array, Array]:
    """Log frequencies (m, n_modes) and their derivatives over the joint vector, (m, n_modes, n) or a zero."""
    if change is None:
        prediction = part.bare.predict(vector, jacobian=jacobian)
    else:
        assert change.model is not None
        prediction = change.model.predict(_extended(vector, x, change), jacobian=jacobian)
    f = prediction.frequencies
    if prediction.jacobian is None:
        return np.log(f), np.zeros((1, 1, 1))
    plate_slope = prediction.jacobian / f[..., None]
    n = len(part.columns)
    slope = np.zeros((*f.shape, x.shape[1]))
    varied = np.flatnonzero(part.scatter >= 0)
    factor = np.ones_like(vector)
    if len(varied):
        scatter = part.scatter[varied]
        factor[:, varied] = 1.0 + x[:, scatter]
        slope[:, :, scatter] = plate_slope[:, :, varied] * x[:, None, part.columns[varied]]
    slope[:, :, part.columns] += plate_slope[:, :, :n] * factor[:, None, :]
    if change is not None:
        slope[:, :, list(change.columns)] += plate_slope[:, :, n:]
    return np.log(f), slope


def _observed(change: Change, f: Array, slope: Array, x: Array, jacobian: bool) -> tuple[Array, Array]:
    """Frequencies with an effect that acts on them; derivatives by complex step along each parameter."""
    assert change.observe is not None
    values = {name: x[:, column] for name, column in zip(change.names, change.columns, strict=True)}
    new = change.observe(f, values)
    if not jacobian:
        return new, slope
    new_slope = np.empty_like(slope)
    for j in range(slope.shape[2]):
        stepped = {
            name: value + 1j * _STEP * (j == column)
            for (name, value), column in zip(values.items(), change.columns, strict=True)
        }
        new_slope[:, :, j] = np.imag(change.observe(f + 1j * _STEP * slope[:, :, j], stepped)) / _STEP
    return new, new_slope
