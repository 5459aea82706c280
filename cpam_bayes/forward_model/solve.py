"""Natural frequencies and mode shapes of a plate from its reference constants: the question `forward`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from cpam_bayes.arguments import checked
from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.labels import label_warnings, paired_shapes, shape_warnings, spare_modes
from cpam_bayes.forward_model.mode_shapes.assurance import ShapePairing
from cpam_bayes.forward_model.model import NO_PARAMETERS, PlateModel, converged_model, reference_constants
from cpam_bayes.forward_model.preconditions import (
    explained_failures,
    require_choice,
    require_modes,
    require_seed,
    require_supported,
    units_warning,
)
from cpam_bayes.forward_model.sandwich import sandwich_warnings
from cpam_bayes.mechanics.shapes import (
    UNIT_SQUARE,
    Extent,
    Mode,
    describe_modes,
    grid_points,
    shapes_at,
    shapes_on_grid,
)
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.result import SILENT, PlateResult, Watch

Array = NDArray[np.float64]
Solver = Literal["ritz", "fem", "ccx"]
Element = Literal["brick", "shell"]


DEFAULT_MODES: Final = 10
LARGE_ERROR: Final = 1e-3
"""Relative error of the solver from which it is no longer small, where the noise is not known."""


@dataclass(frozen=True, slots=True)
class ModeShape:
    """Displacements of one mode on a regular grid of the plate, (nx, ny) each, of any scale.

    They are NaN off the plate: in a hole, or beyond an oblique edge.
    """

    u: Array
    v: Array
    w: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ForwardResult(PlateResult):
    """Modes of a plate with its reference constants.

    Attributes
    ----------
    solver : in words
    modes : frequency (Hz), kind and label of each mode, ascending
    error : (n_modes,) estimated relative error of the frequencies, NaN where there is no estimate
    shapes : one for each mode
    seconds : wall clock
    no_estimate : why there is no estimate of the error
    extent : m, least and greatest x, and y, of the shapes' grid; None for the rectangle
    by_shape : what measured shapes say of the modes, None without them
    """

    question: ClassVar[str] = "forward"
    command: ClassVar[str] = "forward"

    solver: str
    modes: tuple[Mode, ...]
    error: Array
    shapes: tuple[ModeShape, ...]
    seconds: float
    no_estimate: str = ""
    extent: tuple[tuple[float, float], tuple[float, float]] | None = None
    by_shape: ShapePairing | None = None

    @property
    def frequencies(self) -> Array:
        """Natural frequencies, (n_modes,) Hz."""
        return np.array([mode.frequency for mode in self.modes])


@dataclass(frozen=True, slots=True)
class _Solution:
    """The fields of `ForwardResult`; specimen : as computed, see `ElementModel.specimen`.

    at_nodes : (n_modes, 3, n_nodes) shapes at the nodes of the measured ones, None without them.
    """

    specimen: Specimen
    solver: str
    modes: tuple[Mode, ...]
    error: Array
    shapes: Array
    at_nodes: Array | None
    no_estimate: str = ""
    extent: tuple[tuple[float, float], tuple[float, float]] | None = None


@checked
def forward(
    plate: PlateLike,
    n_modes: int | None = None,
    *,
    solver: Solver | None = None,
    element: Element | None = None,
    seed: int = 0,
    watch: Watch = SILENT,
) -> ForwardResult:
    """Natural frequencies and mode shapes of a plate from its reference constants.

    First-order shear deformation theory, or three-dimensional bricks with ``solver="ccx"``.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns
    n_modes : number of modes; as many as were measured, or 10, where left out
    solver : "ritz", "fem" (finite elements, which also take a mesh) or "ccx" (the program CalculiX);
        "fem" for a plate with a mesh and "ritz" for the others where left out
    element : "brick" or "shell", with ``solver="ccx"`` only

    Raises
    ------
    ValueError
        If the plate cannot be read or computed by that solver.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.forward("C1", n_modes=3)
    >>> [round(float(f), 1) for f in result.frequencies]
    [100.3, 298.6, 324.5]
    """
    require_seed(seed)
    require_modes(n_modes)
    if solver is not None:
        require_choice("solver", solver, tuple(_SOLVERS))
    specimen = read_plate(plate)
    name = solver or ("ritz" if specimen.plate.mesh is None else "fem")
    advice = f"--solver {name} computes rectangular plates only; use --solver fem"
    no_air = "CalculiX computes plates in vacuum; leave air_density_kg_m3 out, or use --solver ritz or fem"
    require_supported(specimen, None if name == "fem" else advice, no_air if name == "ccx" else None)
    solve = _SOLVERS[name]
    if element is not None:
        if name != "ccx":
            raise ValueError(f"--element: received {element}, accepted: with --solver ccx only")
        solve = partial(_ccx, element=element)
    n = n_modes or measured_modes(specimen)
    watch.announce(f"forward {specimen.name}: {n} modes, solver {name}")
    start = time.perf_counter()
    with explained_failures(specimen):
        solution = solve(specimen, n)
    seconds = time.perf_counter() - start
    slips = tuple(_slips(specimen, solution))
    measurement = specimen.measurement
    pairing, labels = None, [] if measurement is None else label_warnings(measurement, solution.modes)
    if measurement is not None and measurement.shapes is not None and solution.at_nodes is not None:
        pairing = paired_shapes(measurement.shapes, solution.at_nodes, solution.modes, solution.specimen)
        labels += shape_warnings(pairing, measurement)
    sandwich = () if name == "ccx" else sandwich_warnings(solution.specimen, solution.modes)
    return ForwardResult(
        seed=seed,
        warnings=(*slips, *labels, *error_warning(solution.error), *sandwich),
        slips=slips,
        specimen=solution.specimen,
        air_shifts=air_shifts(specimen),
        solver=solution.solver,
        modes=solution.modes,
        error=solution.error,
        shapes=tuple(ModeShape(*shape) for shape in solution.shapes),
        seconds=seconds,
        no_estimate=solution.no_estimate,
        extent=solution.extent,
        by_shape=pairing,
    )


def measured_modes(specimen: Specimen) -> int:
    """As many modes as were measured, some more beside measured shapes, or 10."""
    measurement = specimen.measurement
    if measurement is None:
        return DEFAULT_MODES
    return measurement.size + (spare_modes(measurement) if measurement.shapes is not None else 0)


def error_warning(error: Array, limit: float = LARGE_ERROR) -> list[str]:
    """A warning if the solver's estimated relative error (n_modes,) is above a limit."""
    worst = float(np.max(error))
    if not worst > limit:
        return []
    return [
        f"the solver's error is up to {significant(100 * worst, 2)} % of a frequency "
        f"(mode {int(np.argmax(error)) + 1}), which is not small here"
    ]


def _slips(specimen: Specimen, solution: _Solution) -> list[str]:
    """A plate that looks like one in other units."""
    slips: list[str] = []
    measurement = specimen.measurement
    if measurement is not None and measurement.complete:
        n = min(measurement.size, len(solution.modes))
        predicted = np.array([mode.frequency for mode in solution.modes[:n]])
        slips += units_warning(
            predicted / measurement.frequencies[:n], weighed=specimen.plate.mass is not None
        )
    return slips


def _ritz(specimen: Specimen, n_modes: int) -> _Solution:
    """First-order shear deformation theory on a converged Ritz space."""
    model = converged_model(specimen, NO_PARAMETERS, n_modes)
    modes, shapes, at_nodes = _described(model, specimen)
    return _Solution(specimen, "Ritz, first-order shear deformation", modes, model.error, shapes, at_nodes)


def _fem(specimen: Specimen, n_modes: int) -> _Solution:
    """First-order shear deformation theory on 8-node elements, on a rectangle or on the mesh of a file."""
    from cpam_bayes.forward_model.elements import element_model

    solved = element_model(specimen, n_modes)
    plate, space = solved.specimen.plate, solved.space
    (x0, x1), (y0, y1) = space.extent
    extent: Extent = (x0 / plate.length, x1 / plate.length), (y0 / plate.width, y1 / plate.width)
    modes, shapes, at_nodes = _described(solved.model, solved.specimen, extent)
    n = shapes.shape[-1]
    shapes[:, :, ~space.covers(grid_points(extent, n)).reshape(n, n)] = np.nan
    on = "" if plate.mesh is None else f" of {plate.mesh.name}, {space.area * 1e6:.6g} mm2"
    return _Solution(
        solved.specimen,
        f"finite elements, first-order shear deformation, {space.n_elements} 8-node elements{on}",
        modes,
        solved.model.error,
        shapes,
        at_nodes,
        "" if plate.mesh is None else "not known: the mesh of a file is the only one",
        space.extent,
    )


def _ccx(specimen: Specimen, n_modes: int, element: Element = "brick") -> _Solution:
    """Three-dimensional bricks, or shells, solved by the program CalculiX."""
    from cpam_bayes.forward_model.calculix import solve_modes

    solved = solve_modes(specimen, reference_constants(specimen), n_modes, element=element)
    name = {"brick": "20-node bricks, layers of C3D20R", "shell": "8-node composite shells, S8R"}[element]
    points, at_nodes = _nodes(specimen), None
    if points is not None:
        side = np.linspace(0.0, 1.0, solved.shapes.shape[-1])
        grid = RegularGridInterpolator((side, side), np.moveaxis(solved.shapes, (0, 1), (2, 3)))
        at_nodes = np.moveaxis(grid(points), 0, -1)
    return _Solution(
        specimen=specimen,
        solver=f"CalculiX, {name}",
        modes=solved.modes,
        error=np.full(n_modes, np.nan),
        shapes=solved.shapes,
        at_nodes=at_nodes,
        no_estimate="not estimated",
    )


_SOLVERS: Final = {"ritz": _ritz, "fem": _fem, "ccx": _ccx}


def _described(
    model: PlateModel, specimen: Specimen, extent: Extent = UNIT_SQUARE
) -> tuple[tuple[Mode, ...], Array, Array | None]:
    """Modes of a model without parameters, and their u, v, w on a grid and at measured nodes."""
    none = np.empty((1, 0))
    spectrum = model.spectrum(none, vectors=True)
    _, mass = model.coefficients(none)
    modes = describe_modes(model.operator, spectrum, mass, extent)
    points = _nodes(specimen)
    at_nodes = None if points is None else shapes_at(model.operator, spectrum, points)
    return modes, shapes_on_grid(model.operator, spectrum, extent), at_nodes


def _nodes(specimen: Specimen) -> Array | None:
    """Nodes of the measured shapes in reference coordinates, (n, 2)."""
    measurement, plate = specimen.measurement, specimen.plate
    if measurement is None or measurement.shapes is None:
        return None
    return np.asarray(measurement.shapes.points / (plate.length, plate.width))
