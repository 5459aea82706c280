"""The input deck of a plate in ABAQUS format, which ABAQUS and CalculiX both read, and the mesh in it.

Units are N, m, kg and s. The mesh has 8-node shells, or 20-node bricks in layers through the thickness:
regular grids of vertices and of the middles between two neighbouring ones; a node is where at most one of its
indices is a middle. Edge elements are narrow: a free edge has a twisting boundary layer as wide as the
thickness, and the stress at a clamped face is singular.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.mechanics.problem import rigid_body_count
from cpam_bayes.plate import Plate, Specimen
from cpam_bayes.plate.edges import CONDITIONS, EDGES, conditions
from cpam_bayes.plate.laminate import (
    CONSTANTS,
    MaterialSymmetry,
    constants_of,
    equal_plies,
    run_starts,
    through_thickness_poisson,
)

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_FEWEST_INSIDE = 2
# Fewest layers of bricks: the shear stress of a homogeneous plate is a parabola in z.
_LAYERS = 4
# Below this fraction of the spacing a sensor is taken to sit on a grid line.
_ON_LINE = 1e-9

# Nodes of an element by their offset from its first vertex on the grid of half steps: vertices,
# then middles, in the order that ABAQUS and CalculiX share.
_FACE = [(0, 0), (2, 0), (2, 2), (0, 2)]
_SIDES = [(1, 0), (2, 1), (1, 2), (0, 1)]
_SHELL = np.array(_FACE + _SIDES)
_BRICK = np.array(
    [(*p, 0) for p in _FACE]
    + [(*p, 2) for p in _FACE]
    + [(*p, 0) for p in _SIDES]
    + [(*p, 2) for p in _SIDES]
    + [(*p, 1) for p in _FACE]
)


@dataclass(frozen=True, slots=True, eq=False)
class PlateMesh:
    """Nodes and elements, numbered from 1.

    nodes : (n, 3) m, z = 0 at the midplane.
    elements : (n_layers, n_elements, 8 or 20) node numbers, layers from the bottom up, one for shells.
    edges : nodes of x0, y0, x1, y1.
    surfaces : (2, nx, ny) vertices on the bottom and on top of bricks, (1, nx, ny) of shells.
    x, y : (nx,), (ny,) m, their coordinates.
    """

    nodes: Floats
    elements: Integers
    edges: dict[str, Integers]
    surfaces: Integers
    x: Floats
    y: Floats

    def node_at(self, x: float, y: float) -> int:
        """The vertex nearest to a point, on top of bricks."""
        i, j = np.argmin(np.abs(self.x - x)), np.argmin(np.abs(self.y - y))
        return int(self.surfaces[-1, i, j])


def element_counts(length: float, width: float, in_plane: int) -> tuple[int, int]:
    """Numbers of elements along x and y, about square and about ``in_plane`` in all, at least 4 each."""
    along_x = round(np.sqrt(in_plane * length / width))
    along_y = round(np.sqrt(in_plane * width / length))
    return max(along_x, 4), max(along_y, 4)


def grid_lines(
    length: float, n: int, thickness: float, ends: tuple[str, str], points: Sequence[float] = ()
) -> Floats:
    """Boundaries of about n elements on [0, length], one at each of ``points``.

    ends : letters of the conditions at 0 and at length. Edge elements are narrow where the
    uniform spacing is wider than the boundary layer there.
    """
    spacing = length / n
    low, high = (
        np.cumsum([w * thickness for w in CONDITIONS[end].brick_widths if w * thickness < spacing])
        for end in ends
    )
    first, last = (edge[-1] if edge.size else 0.0 for edge in (low, high))
    inside = max(n - low.size - high.size, _FEWEST_INSIDE)
    middle = np.linspace(first, length - last, inside + 1)
    lines = np.unique(np.concatenate(([0.0], low, middle, length - high, [length])))
    return _through(lines, points, _ON_LINE * spacing)


def _through(lines: Floats, points: Sequence[float], tolerance: float) -> Floats:
    """The lines with the nearest moved onto each point, or one added where the nearest is fixed."""
    fixed = [lines[0], lines[-1]]
    for point in points:
        nearest = int(np.argmin(np.abs(lines - point)))
        if lines[nearest] not in fixed:
            lines[nearest] = point
        elif abs(lines[nearest] - point) > tolerance:
            lines = np.sort(np.append(lines, point))
        fixed.append(point)
    return lines


def layer_boundaries(heights: Floats) -> tuple[Floats, Integers]:
    """Boundaries z (n_layers + 1,) of layers of bricks, and the run of plies each belongs to.

    heights : (n_runs,) m, thicknesses of the runs of equal plies, bottom to top. A run has one
    layer, or more where it is thicker than a quarter of the plate.
    """
    fraction = heights / heights.sum()
    counts = np.maximum(np.ceil(fraction * _LAYERS - 1e-9), 1).astype(np.int64)
    owner = np.repeat(np.arange(len(heights)), counts)
    z = np.concatenate(([0.0], np.cumsum((heights / counts)[owner])))
    return z - z[-1] / 2, owner


def shell_mesh(x: Floats, y: Floats) -> PlateMesh:
    """8-node shells between the lines x and y."""
    return _grid_mesh((x, y), _SHELL)


def brick_mesh(x: Floats, y: Floats, z: Floats) -> PlateMesh:
    """20-node bricks between the lines x, y and z, one layer of elements between two z."""
    return _grid_mesh((x, y, z), _BRICK)


def _grid_mesh(lines: tuple[Floats, ...], offsets: Integers) -> PlateMesh:
    steps = [_with_middles(axis) for axis in lines]
    index = np.indices([len(axis) for axis in steps])
    is_node = (index % 2).sum(axis=0) <= 1
    number = np.zeros(is_node.shape, dtype=np.int64)
    number[is_node] = np.arange(1, np.count_nonzero(is_node) + 1)

    nodes = np.zeros((np.count_nonzero(is_node), 3))
    for k, axis in enumerate(steps):
        nodes[:, k] = axis[index[k][is_node]]

    # First vertex of every element, layer by layer.
    firsts = np.indices([len(axis) - 1 for axis in lines]) * 2
    corners = np.moveaxis(firsts, 0, -1).reshape(*firsts.shape[1:3], -1, len(lines))
    at = np.moveaxis(corners, 2, 0).reshape(corners.shape[2], -1, 1, len(lines)) + offsets
    elements = number[tuple(np.moveaxis(at, -1, 0))]

    edges = {}
    for name in EDGES:
        side = -1 if name[1] == "1" else 0
        on_edge = np.take(number, side, axis="xy".index(name[0]))
        edges[name] = on_edge[on_edge > 0]
    vertices = number[::2, ::2]
    surfaces = vertices[None] if vertices.ndim == 2 else np.moveaxis(vertices[..., [0, -1]], -1, 0)
    return PlateMesh(nodes, elements, edges, surfaces, x=lines[0], y=lines[1])


def _with_middles(axis: Floats) -> Floats:
    steps = np.empty(2 * len(axis) - 1)
    steps[::2] = axis
    steps[1::2] = (axis[1:] + axis[:-1]) / 2
    return steps


Element = Literal["shell", "brick"]

# Degree of freedom that holds a field: a rotation phi_x of the normal turns about y.
_DEGREE_OF_FREEDOM = {"u": 1, "v": 2, "w": 3, "phi_y": 4, "phi_x": 5}
_TYPE: dict[Element, str] = {"shell": "S8R", "brick": "C3D20R"}

_SHELLS_IN_PLANE = 256
# A budget of bricks limits the elements in the plane: with 31 layers, 128 leave an error of
# 0.1 % in the tenth mode of the thick plates; with 4, more than 320 gain 0.03 %.
_BRICKS = 4000
_BRICKS_IN_PLANE = (128, 320)
_MAX_BRICKS = 60_000

# CalculiX reads 20 characters of a number and drops the rest, an exponent included.
_NUMBER = ".12g"


@dataclass(frozen=True, slots=True, eq=False)
class Deck:
    """A deck and its mesh; n_rigid : number of rigid-body motions that the edges leave free."""

    text: str
    mesh: PlateMesh
    n_rigid: int


def plate_deck(
    specimen: Specimen,
    constants: Mapping[str, float],
    element: Element,
    n_modes: int,
    *,
    in_plane: int | None = None,
) -> Deck:
    """The deck of a specimen: mesh, plies, edges, known masses, a step for its modes.

    Shells are S8R with a composite section. Bricks are C3D20R in layers, with own layers for each
    run of equal plies. Plies are those of `material_card`. Bricks are held on the whole face of an edge.

    constants : E1, E2, nu12, G12, G13, G23, all six, Pa or dimensionless; of a hybrid those of each material.
    n_modes : deformation modes; the step requests the rigid-body motions too.
    in_plane : elements in the plane; by default enough for the first ten modes.

    Raises ValueError for unknown angles, a mesh file, constants that are incomplete or that no
    material can have, and for more bricks than can be solved.
    """
    plate = specimen.plate
    _check(specimen, element, n_modes, in_plane)
    runs = ply_runs(plate)
    cards = _material_cards(specimen, constants, runs)
    if element == "shell":
        lines = _lines(specimen, in_plane or _SHELLS_IN_PLANE)
        mesh, owner = shell_mesh(*lines), np.zeros(1, dtype=np.int64)
    else:
        z, owner = layer_boundaries(runs.heights)
        lines = _lines(specimen, in_plane or int(np.clip(_BRICKS // len(owner), *_BRICKS_IN_PLANE)))
        _check_size(lines, len(owner))
        mesh = brick_mesh(*lines, z)
    unique, which = np.unique(runs.angles, return_inverse=True)
    n_rigid = rigid_body_count(plate.edges)
    parts = [
        _heading(specimen, element),
        node_block(mesh),
        *_elements(mesh, owner, _TYPE[element]),
        *(orientation_card(k, angle) for k, angle in enumerate(unique)),
        *cards.values(),
        *(
            [_shell_section(runs, which, tuple(cards))]
            if element == "shell"
            else [_solid_section(k, int(o), tuple(cards)[runs.material[k]]) for k, o in enumerate(which)]
        ),
        *_masses(specimen, mesh),
        *_boundaries(plate.edges, mesh, element),
        "*NSET, NSET=SURFACES\n" + integer_lines(mesh.surfaces.ravel().tolist()),
        f"*STEP\n*FREQUENCY\n{n_modes + n_rigid}",
        "*NODE PRINT, NSET=SURFACES\nU\n*END STEP",
    ]
    return Deck("\n".join(parts) + "\n", mesh, n_rigid)


def _check(specimen: Specimen, element: str, n_modes: int, in_plane: int | None) -> None:
    plate = specimen.plate
    if element not in get_args(Element):
        raise ValueError(f"element: received {element!r}, accepted: shell, brick")
    if n_modes < 1:
        raise ValueError(f"number of modes: received {n_modes}, accepted: 1 or more")
    if in_plane is not None and in_plane < 1:
        raise ValueError(f"elements in the plane: received {in_plane}, accepted: 1 or more")
    if plate.layup.n_unknown:
        raise ValueError(
            f"layup {plate.layup.text} has {plate.layup.n_unknown} unknown angles; a deck needs a known layup"
        )
    if plate.mesh is not None:
        raise ValueError(
            f"plate {specimen.name} takes its outline from {plate.mesh.name}; "
            "decks are written for rectangular plates"
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlyRuns:
    """The runs of equal neighbouring plies of a plate, bottom to top.

    angles : (m,) degrees
    heights : (m,) m
    material : (m,) indices into ``names``, the materials of a hybrid
    density : (m,) kg/m3
    """

    angles: NDArray[np.float64]
    heights: NDArray[np.float64]
    material: NDArray[np.int64]
    density: NDArray[np.float64]
    names: tuple[str, ...]


def ply_runs(plate: Plate) -> PlyRuns:
    """The runs of equal neighbouring plies of a plate with known angles."""
    angles = plate.layup.angles_deg
    plies = plate.layup.plies or equal_plies(len(angles))
    starts = run_starts(angles, plies)
    return PlyRuns(
        angles=angles[starts],
        heights=np.diff(plies.interfaces[np.append(starts, len(angles))]) * plate.thickness,
        material=plies.material[starts],
        density=plies.density[starts] * plate.density,
        names=plies.names,
    )


def _material_cards(specimen: Specimen, constants: Mapping[str, float], runs: PlyRuns) -> dict[str, str]:
    """The card of each material by its name in the deck, in the order of the runs' names."""
    cards = {}
    for k, name in enumerate(runs.names):
        in_deck = f"PLY_{k + 1}" if name else "PLY"
        density = float(runs.density[np.flatnonzero(runs.material == k)[0]])
        part = specimen.material.parts[name]
        about = f"** material {name}\n" if name else ""
        cards[in_deck] = about + material_card(constants_of(constants, name), part.symmetry, density, in_deck)
    return cards


def _lines(specimen: Specimen, in_plane: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    plate, sensors = specimen.plate, specimen.sensors
    along_x, along_y = element_counts(plate.length, plate.width, in_plane)
    ends_x, ends_y = (plate.edges[0], plate.edges[2]), (plate.edges[1], plate.edges[3])
    return (
        grid_lines(plate.length, along_x, plate.thickness, ends_x, [s.x for s in sensors]),
        grid_lines(plate.width, along_y, plate.thickness, ends_y, [s.y for s in sensors]),
    )


def _check_size(lines: tuple[NDArray[np.float64], ...], n_layers: int) -> None:
    count = n_layers * (len(lines[0]) - 1) * (len(lines[1]) - 1)
    if count > _MAX_BRICKS:
        raise ValueError(
            f"bricks: {n_layers} layers, one or more for each run of equal plies, make {count} "
            f"elements, accepted: up to {_MAX_BRICKS}; take shells or fewer elements in the plane"
        )


def material_card(
    constants: Mapping[str, float], symmetry: MaterialSymmetry, density: float, name: str = "PLY"
) -> str:
    """The card of a ply's material, with through-thickness constants that hardly affect plates.

    E3 = E2, nu13 = nu12 and nu23 by eq. (6); for an orthotropic ply E3 is the smaller of E1 and E2, nu13 and
    nu23 are 0.

    constants, density : as for `plate_deck`; kg/m3.

    Raises ValueError for constants that are incomplete or that no material can have.
    """
    missing = [name for name in CONSTANTS if name not in constants]
    if missing:
        raise ValueError(
            f"elastic constants of a deck: {', '.join(missing)} missing, required: all of "
            f"{', '.join(CONSTANTS)}; elasticity.complete_constants fills in what follows"
        )
    E1, E2, nu12, G12, G13, G23 = (float(constants[name]) for name in CONSTANTS)
    E3, nu13, nu23 = _through_thickness(E1, E2, nu12, symmetry)
    moduli = (E1, E2, G12, G13, G23)
    if not (all(0.0 < v < np.inf for v in moduli) and _is_positive_definite((E1, E2, E3), nu12, nu13, nu23)):
        given = ", ".join(f"{name} = {float(constants[name]):.4g}" for name in CONSTANTS)
        raise ValueError(
            f"elastic constants: received {given}, accepted: positive moduli and Poisson's ratios "
            f"that make a positive definite compliance, with nu13 = {nu13:.4g} and nu23 = {nu23:.4g}"
        )
    engineering = (E1, E2, E3, nu12, nu13, nu23, G12, G13, G23)
    return "\n".join(
        [
            f"*MATERIAL, NAME={name}",
            "*ELASTIC, TYPE=ENGINEERING CONSTANTS",
            number_line(engineering[:8]),
            number_line(engineering[8:]),
            "*DENSITY",
            number_line([density]),
        ]
    )


def _through_thickness(
    E1: float, E2: float, nu12: float, symmetry: MaterialSymmetry
) -> tuple[float, float, float]:
    """E3, nu13 and nu23."""
    if symmetry == "orthotropic":
        return min(E1, E2), 0.0, 0.0
    if nu12 == 1.0:  # where eq. (6) has a pole
        return E2, nu12, np.inf
    return E2, nu12, float(through_thickness_poisson(E1, E2, nu12))


def _is_positive_definite(moduli: tuple[float, float, float], nu12: float, nu13: float, nu23: float) -> bool:
    """Whether the compliance of the three normal stresses, times E1, is positive definite."""
    if not np.all(np.isfinite((*moduli, nu12, nu13, nu23))):
        return False
    to_2, to_3 = moduli[0] / moduli[1], moduli[0] / moduli[2]
    compliance = [[1.0, -nu12, -nu13], [-nu12, to_2, -nu23 * to_2], [-nu13, -nu23 * to_2, to_3]]
    return bool(np.linalg.eigvalsh(compliance)[0] > 0.0)


def _heading(specimen: Specimen, element: Element) -> str:
    plate = specimen.plate
    about = f"Plate {specimen.name}, layup {plate.layup.text}, edges {plate.edges}"
    shown = "".join(c if c.isascii() and c.isprintable() else "?" for c in about)
    return "\n".join(["*HEADING", shown[:78], f"** {_TYPE[element]}; units N, m, kg, s; midplane at z = 0"])


def node_block(mesh: PlateMesh) -> str:
    """The card of all nodes, set ALL."""
    rows = enumerate(mesh.nodes.tolist(), start=1)
    return "\n".join(["*NODE, NSET=ALL", *(f"{n}, {number_line(xyz)}" for n, xyz in rows)])


def _elements(mesh: PlateMesh, owner: NDArray[np.int64], kind: str) -> Iterable[str]:
    """One block for each layer; layers of one run of plies share an element set."""
    first = 1
    for layer, run in zip(mesh.elements, owner.tolist(), strict=True):
        yield f"*ELEMENT, TYPE={kind}, ELSET=PLIES_{run + 1}"
        for number, nodes in enumerate(layer.tolist(), start=first):
            yield f"{number}, " + integer_lines(nodes, first_line=15)
        first += len(layer)


def orientation_card(index: int, angle_deg: float) -> str:
    """The card of ply axes turned by an angle from x, named ANGLE_1 for index 0."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    axes = np.round([c, s, 0.0, -s, c, 0.0], 12) + 0.0
    return "\n".join(
        [
            f"** {angle_deg:g} degrees from x",
            f"*ORIENTATION, NAME=ANGLE_{index + 1}, SYSTEM=RECTANGULAR",
            number_line(axes.tolist()),
        ]
    )


def _shell_section(runs: PlyRuns, which: NDArray[np.int64], cards: tuple[str, ...]) -> str:
    """The card of runs from the bottom up: thickness, points of Simpson's rule (ABAQUS), material, axes."""
    rows = (
        f"{t:{_NUMBER}}, 3, {cards[m]}, ANGLE_{o + 1}"
        for t, m, o in zip(runs.heights, runs.material, which, strict=True)
    )
    return "\n".join(["*SHELL SECTION, COMPOSITE, ELSET=PLIES_1", *rows])


def _solid_section(run: int, orientation: int, card: str) -> str:
    name = f"ANGLE_{orientation + 1}"
    return f"*SOLID SECTION, ELSET=PLIES_{run + 1}, MATERIAL={card}, ORIENTATION={name}"


def _masses(specimen: Specimen, mesh: PlateMesh) -> Iterable[str]:
    number = mesh.elements.shape[0] * mesh.elements.shape[1]
    for k, sensor in enumerate(specimen.sensors, start=1):
        node = mesh.node_at(sensor.x, sensor.y)
        yield f"*ELEMENT, TYPE=MASS, ELSET=SENSOR_{k}\n{number + k}, {node}"
        yield f"*MASS, ELSET=SENSOR_{k}\n{number_line([sensor.mass])}"


def _boundaries(edges: str, mesh: PlateMesh, element: Element) -> Iterable[str]:
    for name, condition in zip(EDGES, conditions(edges), strict=True):
        held = sorted(_DEGREE_OF_FREEDOM[f] for f in condition.held(name))
        if element == "brick":  # a face that does not move does not turn
            held = [d for d in held if d <= 3]
        if not held:
            continue
        yield f"*NSET, NSET=EDGE_{name.upper()}\n" + integer_lines(mesh.edges[name].tolist())
        yield "*BOUNDARY\n" + "\n".join(f"EDGE_{name.upper()}, {d}" for d in held)


def number_line(values: Iterable[float]) -> str:
    """Numbers on one line, as both programs read them."""
    return ", ".join(f"{v:{_NUMBER}}" for v in values)


def integer_lines(numbers: list[int], first_line: int = 16) -> str:
    """Numbers, at most 16 a line as ABAQUS reads them; continued lines end in a comma."""
    cuts = [0, *range(first_line, len(numbers), 16), len(numbers)]
    rows = (numbers[a:b] for a, b in pairwise(cuts))
    return ",\n".join(", ".join(map(str, row)) for row in rows)
