"""Models of a plate with a change at any place, on disk beside the reduced models."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.local.fields import FieldPart
from cpam_bayes.forward_model.local.model import Change, LocalModel
from cpam_bayes.forward_model.local.patch import Patch
from cpam_bayes.forward_model.local.point_mass import PointMass
from cpam_bayes.forward_model.model import PlateModel
from cpam_bayes.mechanics.affine import AffineMatrix, AffineOperator, DenseBlock
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.mechanics.spaces.ritz import RitzSettings, ritz_space
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.storage.cache import model_file, read_model, write_model
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# To be raised when the same inputs give other numbers.
_FORMAT = 4


@single_blas_thread
def stored_local_model(
    key: str,
    problem: Problem,
    added: ParameterSet,
    build: Callable[[], LocalModel],
    directory: Path | None = None,
) -> LocalModel:
    """The model of a plate with a change at any place from disk, or built and stored under a key.

    problem : the bare plate
    added : parameters of the change

    It is the same bit for bit whether it was read or built.
    """
    path = local_model_path(key, directory)
    stored = read_model(path)
    if stored is None or "scalars" not in stored:
        stored = _pack(build())
        write_model(path, stored)
    return _unpack(stored, problem, added)


def local_model_path(key: str, directory: Path | None = None) -> Path:
    """File of the model with a key."""
    return model_file(f"{key}-local{_FORMAT}", directory)


def _pack(model: LocalModel) -> dict[str, Array]:
    assert model.bare.basis is not None
    arrays = {
        "error": model.bare.error,
        "leading": np.array([model.leading, model.modes], dtype=int),
        "change": _change_fields(model.change),
        "basis": np.array(json.dumps(asdict(model.bare.basis[0]))),
        "scalars": np.array([model.shift]),
        "sectors": np.array(
            [[p.sector, p.block, p.columns.start, p.columns.stop] for p in model.parts], dtype=int
        ),
    }
    for i, block in enumerate(model.bare.operator.blocks):
        arrays[f"{i}_n_terms"] = np.array(block.n_terms)
        for name, matrix in (("stiffness", block.stiffness), ("mass", block.mass)):
            arrays[f"{i}_{name}"], arrays[f"{i}_{name}_active"] = matrix.stack, matrix.active
    for i, part in enumerate(model.parts):
        arrays[f"{i}_tensor"] = part.tensor
    return arrays


def _unpack(stored: dict[str, Array], problem: Problem, added: ParameterSet) -> LocalModel:
    settings = RitzSettings(**json.loads(str(stored["basis"])))
    space = ritz_space(problem.edges, problem.nominal, settings)
    blocks = []
    for i in range(sum(name.endswith("_n_terms") for name in stored)):
        stiffness, mass = (
            AffineMatrix(stored[f"{i}_{name}"], stored[f"{i}_{name}_active"])
            for name in ("stiffness", "mass")
        )
        n_k, n_m = stored[f"{i}_n_terms"].tolist()
        blocks.append(DenseBlock(stiffness, mass, np.arange(stiffness.stack.shape[-1]), (n_k, n_m)))
    parts = tuple(
        FieldPart(s.field, s.x, s.y, number, block, slice(start, stop), stored[f"{i}_tensor"])
        for i, (number, block, start, stop) in enumerate(stored["sectors"].tolist())
        for s in (space.sectors[number],)
    )
    error = stored["error"]
    operator = AffineOperator(problem, space, tuple(blocks))
    bare = PlateModel(operator, len(error), error, (settings, np.empty(0, dtype=bool)))
    shift = float(stored["scalars"][0])
    leading, modes = (tuple(of) for of in stored["leading"].tolist())
    return LocalModel(bare, leading, modes, parts, added, shift, _change(*json.loads(str(stored["change"]))))


def _change_fields(change: Change) -> Array:
    assert isinstance(change, PointMass | Patch)
    return np.array(json.dumps([type(change).__name__, asdict(change)]))


def _change(kind: str, fields: dict[str, Any]) -> Change:
    if kind == "PointMass":
        return PointMass(tuple(fields["loads"]))
    return Patch(fields["form"], tuple(fields["radius"]))
