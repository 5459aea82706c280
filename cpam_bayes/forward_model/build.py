"""Reduced models of specimens, as accurate as their lists require; a process makes each of them once."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, astuple, dataclass, replace
from threading import Lock
from typing import Any, Final, TypeVar

import numpy as np

from cpam_bayes.forward_model.model import (
    PlateModel,
    converged_model,
    convergence_samples,
    model_on_basis,
    plate_problem,
)
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS, ReducedModel, ReductionSettings, reduce
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.problem import THEORY_ALONE, Array, Bias
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.running import single_blas_thread
from cpam_bayes.storage import name_unused_models

T = TypeVar("T")

# Error of a basis over the least noise, and its limits.
_SHARE, _LEAST, _MOST = 0.05, 2e-5, 1e-3
# Smallest inferred relative noise to allow for: exact lists have only the error of the fit.
_INFERRED = 1e-3
# Relative change of a side from which trial functions are chosen anew.
_SAME_SPACE: Final = 0.1
# Most models that a process keeps, those used last.
_KEPT: Final = 48


def basis_tolerance(measurement: Measurement) -> float:
    """Relative error of a basis that is negligible beside the noise of a list.

    0.05 of the least relative standard deviation of a frequency, by noise and rounding together; an inferred
    noise counts as 0.1 %.
    """
    stated = _INFERRED if measurement.relative_std is None else measurement.relative_std
    sd = np.hypot(measurement.noise_sd(stated), measurement.resolution / np.sqrt(12.0))
    return float(np.clip(_SHARE * np.min(sd / measurement.frequencies, initial=np.inf), _LEAST, _MOST))


def model_key(
    specimen: Specimen,
    parameters: ParameterSet,
    n_modes: int,
    settings: ReductionSettings,
    centre: Array | None,
) -> str:
    """All that a reduced model depends on, as a text: the plate, not its measurement."""
    plate = specimen.plate
    content = {
        "sizes": [plate.length, plate.width, plate.thickness, plate.density, plate.mass],
        "layup": [
            [repr(float(a)) for a in plate.layup.angles_deg],
            plate.layup.unknown_index.tolist(),
            *(astuple(kind) for kind in plate.layup.kinds),
        ],
        "edges": plate.edges,
        "symmetry": specimen.material.symmetry,
        "constants": sorted(specimen.material.constants.items()),
        "sensors": [[s.mass, s.x, s.y] for s in specimen.sensors],
        "air": specimen.air_density,
        "parameters": [[p.name, repr(p.prior)] for p in parameters.parameters],
        "fixed": sorted(parameters.fixed),
        "n_modes": n_modes,
        "settings": asdict(settings),
        "centre": None if centre is None else [repr(float(c)) for c in centre],
    }
    return json.dumps(content, sort_keys=True)


_made: OrderedDict[str, Any] = OrderedDict()
_lock = Lock()


def remembered(key: str, make: Callable[[], T]) -> T:
    """The object made under a key in this process, made now if it is not kept."""
    with _lock:
        if key in _made:
            _made.move_to_end(key)
            kept: T = _made[key]
            return kept
    name_unused_models()
    model = make()
    with _lock:
        _made[key] = model
        while len(_made) > _KEPT:
            _made.popitem(last=False)
    return model


def forget_models() -> None:
    """Drop all models that this process keeps, to time how long they take to make."""
    with _lock:
        _made.clear()


@single_blas_thread
def reduced_model(
    specimen: Specimen,
    parameters: ParameterSet,
    n_modes: int,
    *,
    settings: ReductionSettings = DEFAULT_SETTINGS,
    centre: Array | None = None,
    near: Neighbour | None = None,
    bias: Bias = THEORY_ALONE,
    notify: Callable[[str], None] = lambda text: None,
) -> ReducedModel:
    """The reduced model of a specimen over the prior box of its parameters.

    bias : of the theory, where measured frequencies are compared with it
    centre : the parameter vector about which the plate model is converged most tightly, by default
    the reference constants. near : where it suits, its trial functions and error are used instead of
    converging anew. ``notify`` is called with each long step. The same request gives the same model.
    """
    key = f"{model_key(specimen, parameters, n_modes, settings, centre)} {bias}"
    with _lock:
        is_made = key in _made
    if near is not None and (is_made or not near.suits(specimen, parameters, n_modes)):
        near = None

    def make() -> ReducedModel:
        notify("converging the plate model")
        if near is None or near.model.basis is None:
            full = converged_model(specimen, parameters, n_modes, centre=centre)
        else:
            problem = plate_problem(specimen, parameters)
            samples = convergence_samples(specimen, problem, centre).x
            full = model_on_basis(problem, samples, n_modes, near.model.error, near.model.basis)
        notify("building the reduced model")
        problem = replace(full.operator.problem, bias=bias)
        full = replace(full, operator=replace(full.operator, problem=problem))
        # the seed is fixed: a model does not depend on the run that first needed it
        return reduce(full, np.random.default_rng(0), settings)

    return remembered(key if near is None else f"{key} near {near.key}", make)


@dataclass(frozen=True, slots=True)
class Neighbour:
    """A plate of slightly different size with its converged model, whose trial functions are used again."""

    specimen: Specimen
    model: PlateModel

    @property
    def key(self) -> str:
        """All that its trial functions depend on."""
        return self._key_of(self.specimen)

    def suits(self, specimen: Specimen, parameters: ParameterSet, n_modes: int) -> bool:
        """Whether they suit a plate: one that differs only in its sizes, and by little."""
        mine, other = self.specimen.plate, specimen.plate
        sides = ((mine.length, other.length), (mine.width, other.width), (mine.thickness, other.thickness))
        sizes = {name: getattr(mine, name) for name in ("length", "width", "thickness", "density", "mass")}
        resized = replace(specimen, plate=replace(other, **sizes))
        return (
            self.model.basis is not None
            and (self.model.parameters.names, self.model.n_modes) == (parameters.names, n_modes)
            and all(abs(b / a - 1.0) < _SAME_SPACE for a, b in sides)
            and self._key_of(resized) == self.key
        )

    def _key_of(self, specimen: Specimen) -> str:
        return model_key(specimen, specimen.unknowns, self.model.n_modes, DEFAULT_SETTINGS, None)


def without_matrices(reduced: ReducedModel) -> ReducedModel:
    """A reduced model without the matrices of the full space, to be sent or kept: it can only predict."""
    operator = reduced.full.operator
    full = replace(reduced.full, operator=AffineOperator(operator.problem, operator.space, ()))
    return replace(reduced, full=full)
