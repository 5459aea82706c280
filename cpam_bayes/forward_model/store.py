"""Reduced models on disk: built once for a plate, its parameters and this version of the package."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.fingerprint import fingerprint
from cpam_bayes.forward_model.model import (
    PlateModel,
    converged_model,
    convergence_samples,
    model_on_basis,
    plate_problem,
)
from cpam_bayes.forward_model.reduced import (
    DEFAULT_SETTINGS,
    ReducedModel,
    ReductionSettings,
    ResidualForm,
    reduce,
)
from cpam_bayes.mechanics.affine import AffineMatrix, AffineOperator, DenseBlock
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT, ShearModel
from cpam_bayes.running import single_blas_thread
from cpam_bayes.storage import model_file, read_model, write_model

Array = NDArray[Any]

# To be raised when the same inputs give other numbers.
_FORMAT = 7
_NEEDED = {"basis", "keep", "error", "reference", "rounding"}


def model_key(
    specimen: Specimen,
    parameters: ParameterSet,
    n_modes: int,
    shear: ShearModel,
    settings: ReductionSettings,
    centre: Array | None,
) -> str:
    """Hash of all that a reduced model depends on: the plate, not what was measured of it."""
    plate = specimen.plate
    content = {
        "format": _FORMAT,
        "sources": fingerprint(__name__),
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
        "shear": shear.factor,
        "settings": asdict(settings),
        "centre": None if centre is None else [repr(float(c)) for c in centre],
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


@single_blas_thread
def reduced_model(
    specimen: Specimen,
    parameters: ParameterSet,
    n_modes: int,
    *,
    shear: ShearModel = ENERGY_CONSISTENT,
    settings: ReductionSettings = DEFAULT_SETTINGS,
    centre: Array | None = None,
    directory: Path | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> ReducedModel:
    """The reduced model of a specimen over the prior box of its parameters, from disk if it is there.

    centre : the parameter vector about which the plate model is converged most tightly, by default
    the reference constants. A file that cannot be read or written is passed over, a damaged one set aside:
    the model is built again. ``notify`` is called with what takes long. The model is the same bit for bit
    whether it was read or built.
    """
    key = model_key(specimen, parameters, n_modes, shear, settings, centre)
    problem = plate_problem(specimen, parameters, shear)

    def build() -> ReducedModel:
        notify("converging the plate model")
        full = converged_model(specimen, parameters, n_modes, shear, centre=centre)
        notify("building the reduced model")
        # the seed is fixed: a model does not depend on the run that first needed it
        return reduce(full, np.random.default_rng(0), settings)

    samples = convergence_samples(specimen, problem, centre).x
    return stored_model(key, problem, samples, n_modes, build, directory)


def stored_model(
    key: str,
    problem: Problem,
    samples: Array,
    n_modes: int,
    build: Callable[[], ReducedModel],
    directory: Path | None = None,
    *,
    light: bool = False,
) -> ReducedModel:
    """The reduced model of a problem from disk, or built and stored under a key.

    samples : (m, n_parameters), where the symmetries of the problem are read off.
    light : without the matrices of the full space, which take most of the time and memory; only predictions
    are asked of it.
    """
    path = model_path(key, directory)
    stored = read_model(path)
    if stored is not None and stored.keys() >= _NEEDED:
        error, basis = stored["error"], _basis(stored)
        if light:
            return _unpack(stored, _without_matrices(problem, n_modes, error, basis))
        return _unpack(stored, model_on_basis(problem, samples, n_modes, error, basis))
    reduced = build()
    write_model(path, _pack(reduced))
    return without_matrices(reduced) if light else reduced


def without_matrices(reduced: ReducedModel) -> ReducedModel:
    """A reduced model without the matrices of the full space; only predictions are asked of it."""
    full = reduced.full
    assert full.basis is not None
    problem = full.operator.problem
    return replace(reduced, full=_without_matrices(problem, full.n_modes, full.error, full.basis))


def model_path(key: str, directory: Path | None = None) -> Path:
    """File of the reduced model with a key."""
    return model_file(key, directory)


def _without_matrices(
    problem: Problem, n_modes: int, error: Array, basis: tuple[RitzSettings, Array]
) -> PlateModel:
    settings, keep = basis
    space = ritz_space(problem.edges, problem.nominal, settings).restricted(keep)
    return PlateModel(AffineOperator(problem, space, ()), n_modes, error, basis)


def _basis(stored: dict[str, Array]) -> tuple[RitzSettings, Array]:
    return RitzSettings(**json.loads(str(stored["basis"]))), stored["keep"]


def _pack(reduced: ReducedModel) -> dict[str, Array]:
    assert reduced.full.basis is not None
    settings, keep = reduced.full.basis
    arrays = {
        "basis": np.array(json.dumps(asdict(settings))),
        "keep": keep,
        "error": reduced.full.error,
        "reference": reduced.reference,
        "rounding": reduced.rounding,
    }
    for i, form in enumerate(reduced.residuals):
        arrays[f"{i}_images"] = form.images
    for i, block in enumerate(reduced.fast.operator.blocks):
        arrays[f"{i}_n_terms"] = np.array(block.n_terms)
        for name, matrix in (("stiffness", block.stiffness), ("mass", block.mass)):
            arrays[f"{i}_{name}"], arrays[f"{i}_{name}_active"] = matrix.stack, matrix.active
    return arrays


def _unpack(stored: dict[str, Array], full: PlateModel) -> ReducedModel:
    blocks, forms = [], []
    for i in range(sum(name.endswith("_n_terms") for name in stored)):
        stiffness, mass = (
            AffineMatrix(stored[f"{i}_{name}"], stored[f"{i}_{name}_active"])
            for name in ("stiffness", "mass")
        )
        n_k, n_m = stored[f"{i}_n_terms"].tolist()
        index = np.arange(stiffness.stack.shape[-1])
        blocks.append(DenseBlock(stiffness, mass, index, (n_k, n_m)))
        if f"{i}_images" in stored:
            forms.append(ResidualForm(stored[f"{i}_images"]))
    operator = AffineOperator(full.operator.problem, full.operator.space, tuple(blocks))
    fast = PlateModel(operator, full.n_modes, full.error)
    return ReducedModel(full, fast, tuple(forms), stored["reference"], stored["rounding"])
