"""Plates of three-dimensional bricks that differ from their file: flaws in geometry, masses and supports.

The decks share mesh and cards with those of `forward_model.calculix`, and nothing with the effects of the
catalogue: a taper moves nodes, a soft clamp is springs on the edge face, a missing corner is omitted
elements.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.calculix.deck import (
    Deck,
    PlateMesh,
    brick_mesh,
    element_counts,
    grid_lines,
    integer_lines,
    layer_boundaries,
    material_card,
    node_block,
    number_line,
    orientation_card,
    ply_runs,
)
from cpam_bayes.forward_model.calculix.run import CalculixError, deformation_modes, read_eigenvalues, run_deck
from cpam_bayes.mechanics.problem import rigid_body_count
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.edges import EDGES
from cpam_bayes.plate.layup import from_angles

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_IN_PLANE = 160
# Weight of a vertex of an element's face relative to a mid-side node: in proportion to the diagonal of the
# mass matrix, hence positive.
_VERTEX_WEIGHT = 3.0 / 16.0


@dataclass(frozen=True, slots=True)
class Mass:
    """A mass on top of the plate, at a mesh vertex that is placed there: kg; x, y m."""

    mass: float
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class Patch:
    """A rectangle whose plies keep a fraction of every modulus, through the whole thickness; m."""

    x: tuple[float, float]
    y: tuple[float, float]
    kept: float


@dataclass(frozen=True, slots=True)
class Notch:
    """A rectangle missing at the corner x = length, y = width; sides in m."""

    along_x: float
    along_y: float


@dataclass(frozen=True, slots=True)
class Springs:
    """Springs that hold the clamped faces instead of a rigid fixture, N/m3.

    normal : along the normal of the face; a rotation of the edge stretches it in proportion to z
    along : along the edge
    transverse : along the normal of the plate
    """

    normal: float
    along: float
    transverse: float


@dataclass(frozen=True, slots=True)
class Heat:
    """Residual stress of a plate that is warmer in the middle: isotropic strain alpha T cos^2 cos^2.

    strain : thermal strain of a free piece in the middle
    """

    strain: float


@dataclass(frozen=True, slots=True)
class Flaws:
    """Flaws of a plate, none by default.

    masses : on top of it
    turned_deg : rotation of all plies
    taper : (x, y), thickness h (1 + t s) with s from -1 to 1, the midplane remaining plane
    sag : (x, y), m: midplane at z = sag_x (1 - s_x^2) + sag_y (1 - s_y^2)
    """

    masses: tuple[Mass, ...] = ()
    turned_deg: float = 0.0
    taper: tuple[float, float] = (0.0, 0.0)
    sag: tuple[float, float] = (0.0, 0.0)
    patch: Patch | None = None
    notch: Notch | None = None
    springs: Springs | None = None
    heat: Heat | None = None


def flawed_frequencies(
    specimen: Specimen,
    constants: Mapping[str, float],
    n_modes: int,
    flaws: Flaws = Flaws(),
    *,
    in_plane: int = _IN_PLANE,
    timeout: float | None = None,
) -> Array:
    """The n lowest natural frequencies of a plate with flaws by CalculiX on 20-node bricks, (n,) Hz.

    constants, in_plane : as for `plate_deck`.
    timeout : s.

    Raises ValueError for what `flawed_deck` refuses, and CalculixError as `run_deck` does or if the number of
    modes is wrong.
    """
    deck = flawed_deck(specimen, constants, n_modes, flaws, in_plane=in_plane)
    eigenvalues = read_eigenvalues(run_deck(deck.text, timeout=timeout))
    places = deformation_modes(eigenvalues, deck.n_rigid)[:n_modes]
    if len(places) < n_modes:
        raise CalculixError(f"CalculiX: {n_modes} modes asked for, {len(places)} found")
    return np.asarray(np.sqrt(eigenvalues[places]) / (2 * np.pi))


def extrapolated_frequencies(
    specimen: Specimen,
    constants: Mapping[str, float],
    n_modes: int,
    flaws: Flaws,
    coarse: int,
    fine: int,
) -> Array:
    """The n lowest frequencies extrapolated from two meshes, (n,) Hz; coarse, fine : elements in the plane.

    The error is taken to fall with the square of the number of elements in the plane; the finer mesh has
    twice as many.

    Raises CalculixError as `flawed_frequencies` does.
    """
    rough, good = (
        flawed_frequencies(specimen, constants, n_modes, flaws, in_plane=n) for n in (coarse, fine)
    )
    return np.asarray(good - (rough - good) / 3.0)


def flawed_deck(
    specimen: Specimen,
    constants: Mapping[str, float],
    n_modes: int,
    flaws: Flaws = Flaws(),
    *,
    in_plane: int = _IN_PLANE,
) -> Deck:
    """The deck of a plate with flaws, including the known masses of the file.

    Raises ValueError for edges other than F and C, springs without a clamped edge, heat with one, and for
    impossible constants.
    """
    plate = specimen.plate
    if set(plate.edges) - set("FC"):
        raise ValueError(f"edges of bricks with flaws: received {plate.edges}, accepted: F and C")
    if flaws.springs is not None and "C" not in plate.edges:
        raise ValueError("springs: received for a free plate, accepted: with a clamped edge")
    if flaws.heat is not None and plate.edges != "FFFF":
        raise ValueError(f"heat: received with edges {plate.edges}, accepted: FFFF")
    runs = ply_runs(plate)
    z, owner = layer_boundaries(runs.heights)
    mesh = brick_mesh(*_lines(specimen, flaws, in_plane), z)
    kept = _kept_elements(mesh, plate.length, plate.width, flaws.notch)
    turned = from_angles(_turned(runs.angles, flaws.turned_deg)).angles_deg
    unique, which = np.unique(turned, return_inverse=True)
    moved = replace(mesh, nodes=_moved(mesh.nodes, plate.length, plate.width, flaws))
    fields = [
        _elements(moved, kept, owner, _patch_elements(mesh, flaws.patch)),
        *(orientation_card(k, angle) for k, angle in enumerate(unique)),
        _material(constants, plate.density, "PLY", flaws.heat),
    ]
    regions = ["PLY"]
    if flaws.patch is not None:
        soft = {k: v if k == "nu12" else v * flaws.patch.kept for k, v in constants.items()}
        fields.append(_material(soft, plate.density, "SOFT", None))
        regions.append("SOFT")
    fields += [
        f"*SOLID SECTION, ELSET={region}_{run + 1}, MATERIAL={region}, ORIENTATION=ANGLE_{angle + 1}"
        for region in regions
        for run, angle in enumerate(which.tolist())
    ]
    number = mesh.elements.shape[0] * mesh.elements.shape[1]
    masses = _every_mass(specimen, flaws)
    for k, mass in enumerate(masses, start=1):
        node = mesh.node_at(mass.x, mass.y)
        fields.append(f"*ELEMENT, TYPE=MASS, ELSET=MASS_{k}\n{number + k}, {node}")
        fields.append(f"*MASS, ELSET=MASS_{k}\n{number_line([mass.mass])}")
    fields += _held(plate.edges, mesh, flaws.springs, number + len(masses))
    n_rigid = rigid_body_count(plate.edges)
    asked = n_modes + n_rigid
    steps = f"*STEP\n*FREQUENCY\n{asked}\n*END STEP"
    if flaws.heat is not None:
        fields.append("*INITIAL CONDITIONS, TYPE=TEMPERATURE\nALL, 0.")
        steps = _stressed_steps(mesh, plate.length, plate.width, flaws.heat, asked)
    used = np.unique(mesh.elements.reshape(mesh.elements.shape[0], -1, 20)[:, kept])
    heading = f"*HEADING\nbricks, layup {from_angles(turned.tolist()).text[:40]}, edges {plate.edges}"
    text = "\n".join([heading, _used_nodes(moved, used), *fields, steps]) + "\n"
    return Deck(text, moved, n_rigid)


def _every_mass(specimen: Specimen, flaws: Flaws) -> list[Mass]:
    return [*(Mass(s.mass, s.x, s.y) for s in specimen.sensors), *flaws.masses]


def _lines(specimen: Specimen, flaws: Flaws, in_plane: int) -> tuple[Array, Array]:
    plate = specimen.plate
    along_x, along_y = element_counts(plate.length, plate.width, in_plane)
    masses = _every_mass(specimen, flaws)
    xs, ys = [m.x for m in masses], [m.y for m in masses]
    if flaws.patch is not None:
        xs += flaws.patch.x
        ys += flaws.patch.y
    if flaws.notch is not None:
        xs.append(plate.length - flaws.notch.along_x)
        ys.append(plate.width - flaws.notch.along_y)
    edges = plate.edges
    return (
        grid_lines(plate.length, along_x, plate.thickness, (edges[0], edges[2]), xs),
        grid_lines(plate.width, along_y, plate.thickness, (edges[1], edges[3]), ys),
    )


def _turned(angles: Array, by: float) -> list[float]:
    turned = np.mod(angles + by + 90.0, 180.0) - 90.0
    return [90.0 if a == -90.0 else float(a) for a in turned]


def _centres(mesh: PlateMesh) -> tuple[Array, Array]:
    """x and y of the centre of every element in the plane, (n_elements,) m each."""
    centre = mesh.nodes[mesh.elements[0] - 1].mean(axis=1)
    return centre[:, 0], centre[:, 1]


def _kept_elements(mesh: PlateMesh, length: float, width: float, notch: Notch | None) -> NDArray[np.bool_]:
    x, y = _centres(mesh)
    if notch is None:
        return np.ones(len(x), dtype=bool)
    return np.asarray(~((x > length - notch.along_x) & (y > width - notch.along_y)))


def _patch_elements(mesh: PlateMesh, patch: Patch | None) -> NDArray[np.bool_]:
    x, y = _centres(mesh)
    if patch is None:
        return np.zeros(len(x), dtype=bool)
    return np.asarray((x > patch.x[0]) & (x < patch.x[1]) & (y > patch.y[0]) & (y < patch.y[1]))


def _moved(nodes: Array, length: float, width: float, flaws: Flaws) -> Array:
    s_x, s_y = 2.0 * nodes[:, 0] / length - 1.0, 2.0 * nodes[:, 1] / width - 1.0
    z = nodes[:, 2] * (1.0 + flaws.taper[0] * s_x) * (1.0 + flaws.taper[1] * s_y)
    z = z + flaws.sag[0] * (1.0 - s_x**2) + flaws.sag[1] * (1.0 - s_y**2)
    return np.column_stack((nodes[:, :2], z))


def _used_nodes(mesh: PlateMesh, used: Integers) -> str:
    """Card of the nodes used by elements; unused ones would be free bodies without mass."""
    if len(used) == len(mesh.nodes):
        return node_block(mesh)
    rows = (f"{n}, {number_line(mesh.nodes[n - 1].tolist())}" for n in used.tolist())
    return "\n".join(["*NODE, NSET=ALL", *rows])


def _elements(mesh: PlateMesh, kept: NDArray[np.bool_], owner: Integers, patch: NDArray[np.bool_]) -> str:
    lines: list[str] = []
    for region, where in (("PLY", kept & ~patch), ("SOFT", kept & patch)):
        for layer, run in enumerate(owner.tolist()):
            if not where.any():
                continue
            lines.append(f"*ELEMENT, TYPE=C3D20R, ELSET={region}_{run + 1}")
            for k in np.flatnonzero(where).tolist():
                number = layer * len(kept) + k + 1
                nodes = mesh.elements[layer, k].tolist()
                lines.append(f"{number}, " + integer_lines(nodes, first_line=15))
    return "\n".join(lines)


def _material(constants: Mapping[str, float], density: float, name: str, heat: Heat | None) -> str:
    card = material_card(constants, "transversely_isotropic", density, name)
    # coefficient of one, so that a temperature is a strain
    return card if heat is None else f"{card}\n*EXPANSION\n1.0"


def _held(edges: str, mesh: PlateMesh, springs: Springs | None, number: int) -> Iterable[str]:
    for edge, condition in zip(EDGES, edges, strict=True):
        if condition != "C":
            continue
        if springs is None:
            yield f"*NSET, NSET=EDGE_{edge.upper()}\n" + integer_lines(mesh.edges[edge].tolist())
            yield f"*BOUNDARY\nEDGE_{edge.upper()}, 1, 3"
            continue
        in_plane = (springs.normal, springs.along)
        stiffnesses = (*(in_plane if edge[0] == "x" else in_plane[::-1]), springs.transverse)
        area = _nodal_areas(mesh, edge)
        weights = np.round(list(area.values()), 15)
        for k, weight in enumerate(np.unique(weights), start=1):
            nodes = [n for n, a in zip(area, weights, strict=True) if a == weight]
            for degree, stiffness in enumerate(stiffnesses, start=1):
                name = f"SPRING_{edge.upper()}_{k}_{degree}"
                yield f"*ELEMENT, TYPE=SPRING1, ELSET={name}"
                for node in nodes:
                    number += 1
                    yield f"{number}, {node}"
                yield f"*SPRING, ELSET={name}\n{degree}\n{weight * stiffness:.10e}"


def _nodal_areas(mesh: PlateMesh, edge: str) -> dict[int, float]:
    """Area of an edge's face that each of its nodes represents, m2."""
    on_edge = set(mesh.edges[edge].tolist())
    along = 1 if edge[0] == "x" else 0
    areas: dict[int, float] = {}
    for nodes in mesh.elements.reshape(-1, 20).tolist():
        face = [n for n in nodes if n in on_edge]
        if len(face) != 8:
            continue
        points = mesh.nodes[np.array(face) - 1][:, [along, 2]]
        sides = np.ptp(points, axis=0)
        middle = points.min(axis=0) + sides / 2.0
        is_vertex = np.all(np.abs(points - middle) > 0.25 * sides, axis=1)
        weights = np.where(is_vertex, _VERTEX_WEIGHT, 1.0)
        for node, share in zip(face, (weights / weights.sum() * sides.prod()).tolist(), strict=True):
            areas[node] = areas.get(node, 0.0) + share
    return areas


def _stressed_steps(mesh: PlateMesh, length: float, width: float, heat: Heat, asked: int) -> str:
    """A static step that heats the plate, held against rigid motion only, then its modes when set free."""
    x, y = mesh.nodes[:, 0], mesh.nodes[:, 1]
    strain = heat.strain * np.sin(np.pi * x / length) ** 2 * np.sin(np.pi * y / width) ** 2
    rows = (f"{n}, {number_line([t])}" for n, t in enumerate(strain.tolist(), start=1))
    top = mesh.surfaces[-1]
    a, b, c = int(top[0, 0]), int(top[-1, 0]), int(top[0, -1])
    held = f"{a}, 1, 3\n{b}, 2, 3\n{c}, 3, 3"
    return "\n".join(
        [
            f"*STEP\n*STATIC\n*BOUNDARY\n{held}\n*TEMPERATURE",
            *rows,
            f"*END STEP\n*STEP, PERTURBATION\n*FREQUENCY\n{asked}\n*BOUNDARY, OP=NEW\n*END STEP",
        ]
    )
