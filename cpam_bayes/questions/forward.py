"""The question `forward`: natural frequencies and mode shapes of a plate from its reference constants."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from cpam_bayes.answer import Notice
from cpam_bayes.command import MODES, PLATE, Command, option
from cpam_bayes.errors import checked
from cpam_bayes.formatting import NOT_KNOWN, signed, significant
from cpam_bayes.forward_model.labels import (
    MeasuredFrequency,
    ShapePairing,
    label_notices,
    measured_modes,
    measured_of_modes,
    paired_shapes,
    shape_notices,
)
from cpam_bayes.forward_model.model import (
    NO_PARAMETERS,
    PlateModel,
    air_shifts,
    converged_model,
    reference_constants,
)
from cpam_bayes.forward_model.preconditions import (
    SUSPICIOUS_RATIO,
    error_notices,
    explained_failures,
    require_choice,
    require_modes,
    require_seed,
    require_supported,
    stated_slips,
    units_notices,
)
from cpam_bayes.forward_model.three_dimensions import sandwich_notices
from cpam_bayes.mechanics.modes import (
    UNIT_SQUARE,
    Extent,
    Mode,
    describe_modes,
    grid_points,
    shapes_at,
    shapes_on_grid,
)
from cpam_bayes.plate import (
    Material,
    PlateLike,
    Specimen,
    joined_name,
    read_plate,
    to_user,
    unit_of,
    user_name,
)
from cpam_bayes.plate.edges import ALL_FREE
from cpam_bayes.render.figures import extent_of, shapes_figure
from cpam_bayes.render.handling import Handling, handling_drawing, handling_of, handling_section
from cpam_bayes.render.plate import assurance_drawings, assurance_sections, plate_section, shape_keys
from cpam_bayes.render.report import (
    COMPUTATION,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    Table,
    facts,
    modes_caption,
    plate_keys,
)
from cpam_bayes.render.sentences import mismatch_step, plate_argument
from cpam_bayes.result import PlateResult, present
from cpam_bayes.running import SILENT, Watch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Solver = Literal["ritz", "fem", "ccx"]
Element = Literal["brick", "shell"]


@dataclass(frozen=True, slots=True)
class ModeShape:
    """Displacements of one mode on a regular grid of the plate, (nx, ny) each, arbitrary scale.

    NaN off the plate: in a hole, or beyond an oblique edge.
    """

    u: Array
    v: Array
    w: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ForwardResult(PlateResult):
    """Modes of a plate at its reference constants.

    Attributes
    ----------
    solver : in words
    modes : frequency (Hz), kind and label of each mode, ascending
    error : (n_modes,) estimated relative error of the frequencies, NaN where there is no estimate
    shapes : one for each mode
    seconds : wall clock
    no_estimate : why there is no estimate of the error
    extent : m, least and greatest x, and y, of the shapes' grid; None for the rectangle
    by_shape : pairing of the modes by measured shapes, None without shapes
    """

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

    @property
    def handling(self) -> Handling | None:
        """Where to hold the plate, where to hit it and where to measure these modes."""
        return handling_of(self.specimen, self.modes, self.shapes)


@dataclass(frozen=True, slots=True)
class _Solution:
    """The fields of `ForwardResult`; specimen : as computed, see `ElementModel.specimen`.

    at_nodes : (n_modes, 3, n_nodes) shapes at the nodes of the measured shapes, None without these.
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
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    n_modes : number of modes; as many as were measured, or 10, if left out
    solver : "ritz", "fem" (finite elements, also on a mesh) or "ccx" (the program CalculiX);
        if left out, "fem" for a plate with a mesh, else "ritz"
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
    measurement = specimen.measurement
    pairing = None
    if measurement is not None and measurement.shapes is not None and solution.at_nodes is not None:
        pairing = paired_shapes(measurement.shapes, solution.at_nodes, solution.modes, solution.specimen)
    return ForwardResult(
        seed=seed,
        notices=(
            *stated_slips(specimen),
            *_slips(specimen, solution),
            *(() if measurement is None else label_notices(measurement, solution.modes)),
            *(() if measurement is None else shape_notices(pairing, measurement)),
            *error_notices(solution.error),
            *(() if name == "ccx" else sandwich_notices(solution.specimen, solution.modes)),
        ),
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


def handling_before(plate: Mapping[str, Any]) -> Handling | None:
    """Where to hold and hit a plate to be measured, from its table; None where other entries are missing."""
    try:
        return forward({key: value for key, value in plate.items() if key != "measurement"}).handling
    except ValueError:
        return None


def _slips(specimen: Specimen, solution: _Solution) -> tuple[Notice, ...]:
    measurement = specimen.measurement
    if measurement is None or not measurement.complete:
        return ()
    n = min(measurement.size, len(solution.modes))
    predicted = np.array([mode.frequency for mode in solution.modes[:n]])
    return units_notices(predicted / measurement.frequencies[:n], specimen.plate, "slip")


def _ritz(specimen: Specimen, n_modes: int) -> _Solution:
    """First-order shear deformation theory, on a converged Ritz space."""
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
    """Three-dimensional bricks, or shells, by the program CalculiX."""
    from cpam_bayes.forward_model.calculix.run import solve_modes

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
    """Modes of a model without parameters, and their u, v, w on a grid and at the measured nodes."""
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


class _Row(NamedTuple):
    """A mode and its measured frequency, if any."""

    number: int
    mode: Mode
    error: float
    measured: MeasuredFrequency | None


def _difference(row: _Row) -> str | None:
    """Computed / measured - 1 in %, or the factor where the units must be wrong."""
    if row.measured is None:
        return None
    ratio = row.mode.frequency / row.measured.hz
    if 1.0 / SUSPICIOUS_RATIO <= ratio <= SUSPICIOUS_RATIO:
        return signed(100.0 * (ratio - 1.0), 2)
    return f"{significant(ratio, 3)} times"


_MODES: Final = (
    Column("mode", None, lambda r: r.number, number=True),
    Column("Hz", "frequency_hz", lambda r: r.mode.frequency, lambda f: significant(f, 6), number=True),
    Column("kind", "kind", lambda r: r.mode.kind),
    Column("label", "label", lambda r: r.mode.label),
    Column(None, "in_plane_share", lambda r: r.mode.in_plane_fraction),
    Column(None, "relative_error_estimate", lambda r: r.error),
    Column("measured Hz", "measured_hz", lambda r: r.measured and r.measured.hz, lambda f: f"{f:.10g}", True),
    Column("difference %", None, _difference, number=True),
    Column(None, "paired_by", lambda r: r.measured and r.measured.by),
)
_PAIRED_BY: Final = Column("paired by", None, lambda r: r.measured and r.measured.by)
_CONSTANTS: Final = (
    Column("name", None, lambda c: c[0]),
    Column("value", "value", lambda c: to_user(c[0], c[1]), lambda v: f"{v:.6g}", number=True),
    Column("unit", None, lambda c: unit_of(c[0])),
    Column("from", "source", lambda c: c[2]),
)


@present.register
def _present(result: ForwardResult) -> Report:
    specimen, by_shape = result.specimen, result.by_shape
    measured = measured_of_modes(specimen, result.modes, by_shape)
    each = zip(result.modes, result.error, measured, strict=True)
    rows = tuple(_Row(i, mode, float(error), m) for i, (mode, error, m) in enumerate(each, 1))
    named = any(m is not None and m.by != "order" for m in measured)
    modes = Rows("modes", (*_MODES, *((_PAIRED_BY,) if named else ())), rows)
    constants = Rows("constants", _CONSTANTS, tuple(_constants_with_origin(specimen)))
    worst = float(np.max(result.error))
    handling = result.handling
    return Report(
        summary=result.screen(
            headline=_headline(rows),
            tables=(modes.table("Modes"),),
            lines=(_exactness(result), *(() if _list_is_paired(result) else (_UNPAIRED,))),
            next_step=_next_step(result),
        ),
        sections=(
            plate_section(specimen, result.air_shifts),
            Section("Modes", (constants.table("Reference constants"),), ("modes",), folded=False),
            *handling_section(handling),
            *assurance_sections(by_shape, specimen.measurement),
            Section(COMPUTATION, (_computation(result),)),
        ),
        document={
            **plate_keys(result.command, result.seed, specimen),
            "solver": result.solver,
            "modes": modes.records(),
            **shape_keys(by_shape, specimen.measurement),
            "handling": None if handling is None else handling.keys,
            "relative_error_estimate": worst,
            "no_error_estimate": result.no_estimate or None,
            "constants": {
                user_name(name): keys
                for (name, *_), keys in zip(constants.rows, constants.records(), strict=True)
            },
            "air_density_kg_m3": specimen.air_density,
            "seconds": result.seconds,
            "warnings": list(result.warnings),
            "notes": list(specimen.notes),
        },
        drawings=(
            Drawing(
                "modes",
                partial(_shapes, result),
                modes_caption([(m.frequency, m.label or m.kind) for m in result.modes]),
            ),
            *handling_drawing(specimen, handling),
            *assurance_drawings(specimen.name, by_shape, specimen.measurement),
        ),
        rows=(modes, constants),
    )


def _shapes(result: ForwardResult) -> Figure:
    """All mode shapes: deflection with nodal lines, or the deformed grid for in-plane modes."""
    plate = result.specimen.plate
    extent = extent_of(plate.length, plate.width)
    if result.extent is not None:
        (x0, x1), (y0, y1) = result.extent
        extent = (1e3 * x0, 1e3 * x1, 1e3 * y0, 1e3 * y1)
    return shapes_figure(
        f"{result.specimen.name}, edges {plate.edges}, {result.solver}",
        [f"{i}: {m.frequency:.6g} Hz\n{m.kind} {m.label}" for i, m in enumerate(result.modes, 1)],
        [np.stack((shape.u, shape.v, shape.w)) for shape in result.shapes],
        [mode.in_plane_fraction > 0.5 for mode in result.modes],
        extent,
        plate.edges if plate.mesh is None else ALL_FREE,
    )


_UNPAIRED: Final = "The list may lack modes: a frequency without label or shape is beside no mode."


def _headline(rows: tuple[_Row, ...]) -> str:
    f = [row.mode.frequency for row in rows]
    if len(f) == 1:
        said = f"1 natural frequency, {significant(f[0], 4)} Hz, from the reference constants."
    else:
        span = f"{significant(f[0], 4)} to {f[-1]:.4g}"
        said = f"{len(f)} natural frequencies, {span} Hz, from the reference constants."
    return f"{said}{_beside(rows)}"


def _beside(rows: tuple[_Row, ...]) -> str:
    ratios = np.array([row.mode.frequency / row.measured.hz for row in rows if row.measured is not None])
    if not ratios.size:
        return ""
    if not 1.0 / SUSPICIOUS_RATIO <= float(np.median(ratios)) <= SUSPICIOUS_RATIO:
        low, high = (significant(float(v), 3) for v in (ratios.min(), ratios.max()))
        return f" They are {low if low == high else f'{low} to {high}'} times the measured ones."
    off = ratios - 1.0
    rms = significant(100.0 * float(np.sqrt(np.mean(off**2))), 2)
    low, high = (signed(100.0 * float(v), 1) for v in (off.min(), off.max()))
    return f" They differ from the measured ones by {low} to {high} % ({rms} % rms)."


def _exactness(result: ForwardResult) -> str:
    worst = float(np.max(result.error))
    if not np.isfinite(worst):
        return f"Solver: {result.solver}; its error is {result.no_estimate or NOT_KNOWN}."
    return f"Solver: {result.solver}, exact to about {significant(100 * worst, 2)} %."


def _next_step(result: ForwardResult) -> str:
    specimen = result.specimen
    for step in mismatch_step(specimen, result.notices):
        return step
    if specimen.measurement is None or not specimen.unknowns.size:
        missing = "measured frequencies" if specimen.measurement is None else "the unknown constants"
        return f"add {missing} to the plate file, and identify the constants."
    return f"what are the plate's constants?  cpam-bayes identify {plate_argument(specimen)}"


def _computation(result: ForwardResult) -> Table:
    worst = float(np.max(result.error))
    error = f"about {significant(100 * worst, 2)} % of a frequency in the worst mode, estimated"
    return facts(
        "Computation",
        (
            ("solver", result.solver),
            ("error", error if np.isfinite(worst) else result.no_estimate or "no estimate"),
            ("labels", "nodal lines across x and across y; half-waves between two held edges"),
            ("time", f"{result.seconds:.1f} s"),
        ),
    )


def _list_is_paired(result: ForwardResult) -> bool:
    """Whether the measured frequencies can be paired: by shape or label, or in a complete list."""
    measurement = result.specimen.measurement
    if measurement is None or measurement.complete:
        return True
    return all(measurement.labels) if result.by_shape is None else bool((result.by_shape.modes >= 0).all())


def _constants_with_origin(specimen: Specimen) -> list[tuple[str, float, str]]:
    """Name, value in SI and origin of every constant of the plate."""
    return [
        (joined_name(of, name), value, origin)
        for of, part in specimen.material.parts.items()
        for name, value, origin in _of_material(part)
    ]


def _of_material(material: Material) -> list[tuple[str, float, str]]:
    complete = material.complete()
    if material.isotropic:
        origins = dict.fromkeys(("E1", "nu12"), "plate file") | {"G12": "eq. (11)"}
    else:
        origins = dict.fromkeys(complete, "plate file")
        origins |= {"G13": "G12"} if "G13" not in material.constants else {}
        g23 = "G12" if material.symmetry == "orthotropic" else "eq. (6)"
        origins |= {"G23": g23} if "G23" not in material.constants else {}
    return [(name, float(complete[name]), origin) for name, origin in origins.items()]


COMMAND: Final = Command(
    forward,
    (
        PLATE,
        option(
            "--solver",
            choices=tuple(_SOLVERS),
            help="ritz; fem: finite elements, which also take [plate] mesh; ccx: the program CalculiX "
            "(default: fem for a plate with a mesh, ritz for the others)",
        ),
        option(
            "--element",
            choices=get_args(Element),
            help="ccx: brick, 20 nodes, in layers of plies, or shell, 8 nodes (default: brick)",
        ),
        MODES,
    ),
)
