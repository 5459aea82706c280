"""A plate solved by finite elements: on the default mesh of its rectangle, or on a mesh from a file."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cpam_bayes.forward_model.model import PlateModel, plate_problem
from cpam_bayes.mechanics.fem import (
    DEFAULT_GRADING,
    FemSpace,
    SparseOperator,
    default_counts,
    discretise_sparse,
    fem_space,
    fem_space_from_mesh,
)
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import Array, Problem
from cpam_bayes.plate import Specimen
from cpam_bayes.running import single_blas_thread

# Order of convergence of the frequencies in the element size.
_RATE = 4
_COARSER = 2


@dataclass(frozen=True, slots=True)
class ElementModel:
    """A plate on finite elements at its reference constants.

    specimen : as computed; the density of a weighed plate follows from the area of its mesh
    model : its error is NaN where it is not known, as on a mesh from a file
    """

    specimen: Specimen
    space: FemSpace
    model: PlateModel


@single_blas_thread
def element_model(specimen: Specimen, n_modes: int) -> ElementModel:
    """Finite elements for a specimen with its reference constants.

    Raises ``ValueError`` for a layup with unknown angles, for a mesh that cannot be used, for a
    known mass that is not on the mesh and for more modes than the mesh has; ``RigidBodyError``
    where modes cannot be distinguished from rounding.
    """
    problem = plate_problem(specimen)
    mesh = specimen.plate.mesh
    if mesh is None:
        space = fem_space(problem.edges, problem.nominal)
    else:
        space = fem_space_from_mesh(mesh, problem.edges, problem.nominal)
        specimen = _weighed(specimen, space)
        problem = plate_problem(specimen)
    operator = discretise_sparse(problem, space, {})
    error = np.full(n_modes, np.nan) if mesh is not None else _error(problem, operator, n_modes)
    return ElementModel(specimen, space, PlateModel(operator, n_modes, error))


def _weighed(specimen: Specimen, space: FemSpace) -> Specimen:
    plate = specimen.plate
    if plate.mass is None:
        return specimen
    return replace(specimen, plate=replace(plate, density=plate.mass / (space.area * plate.thickness)))


def _error(problem: Problem, operator: SparseOperator, n_modes: int) -> Array:
    """Estimated relative error of the frequencies on the default mesh, (n_modes,).

    Richardson's estimate from a mesh of half as many elements a side, |f_2h / f_h - 1| / (2^4 - 1),
    twice: with the outermost elements graded as in the default mesh, for the error of the inner
    ones, and without grading, for that of the layers along the edges.
    """
    fine = _frequencies(operator, n_modes)
    counts = [n // _COARSER for n in default_counts(problem.nominal)]
    coarse = [
        _frequencies(discretise_sparse(problem, space, {}), n_modes)
        for grading in (DEFAULT_GRADING, None)
        for space in [fem_space(problem.edges, problem.nominal, *counts, grading=grading)]
    ]
    return np.asarray(sum(np.abs(f / fine - 1.0) for f in coarse) / (_COARSER**_RATE - 1))


def _frequencies(operator: SparseOperator, n_modes: int) -> Array:
    return np.asarray(solve(operator, *operator.coefficients({}), n_modes).frequencies[0])
