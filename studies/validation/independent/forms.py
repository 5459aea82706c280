"""Forms of causes on real plates, each different from the catalogue's, on the independent elements.

A clamp lets go abruptly, an accelerometer has a footprint and a cable, foam supports are small, damage has an
outline, thickness has steps. A form makes the matrices of the plate that has it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from validation.independent import elements
from validation.independent.elements import Elements
from validation.independent.true_plate import TruePlate

Array = NDArray[np.float64]
Place = tuple[float, float]
Matrices = tuple[csr_array[Any], csr_array[Any], NDArray[np.int64]]
# From -1 to 1 along both sides, (2, q) to (q,); or from 0 to 1 along an edge, to its compliance.
Profile = Callable[[Array], NDArray[Any]]

# Elements along x and y; fine along a clamped edge, x = 0, where the end of a grip is a singularity.
MESHES = {"F": (16, 16), "C": (12, 32)}
RIGID_MOTIONS = 6
# Compliances of edges that count as rigid, in units of side / D and side^3 / D.
_RIGID = {"turn": 1e-6, "shift": 1e-8}
# An accelerometer: height of its centre above the surface, m, and cable's share of its mass.
_HEIGHT, _CABLE = 4e-3, 0.25
# Bending stiffness relative to the plate's under wax or tape a fifth of a millimetre thick.
_TAPED = 1.15
# Side of a pad of foam, m.
_PAD = 15e-3


@dataclass(frozen=True, slots=True)
class Bench:
    """A plate without a flaw on its elements.

    laminate : stiffness, (8, 8)
    bare : matrices without a flaw
    frequencies : Hz, of as many modes as requested
    """

    plate: TruePlate
    mesh: Elements
    strain: csr_array[Any]
    laminate: Array
    bare: Matrices
    frequencies: Array

    @property
    def sides(self) -> Array:
        """Length and width, m."""
        return np.array([self.plate.length, self.plate.width])

    def solved(self, changed: Matrices) -> Array:
        """ln f of the plate with other matrices."""
        return _ln_f(self.plate, changed, len(self.frequencies), float(self.frequencies[0]))


def _ln_f(plate: TruePlate, changed: Matrices, n_modes: int, about: float) -> Array:
    rigid = 0 if "C" in plate.edges else RIGID_MOTIONS
    f, _ = elements.frequencies(*changed, n_modes, rigid, about)
    return np.asarray(np.log(f))


def bench(plate: TruePlate, n_modes: int, shape: tuple[int, int] | None = None) -> Bench:
    """A plate, free or clamped at x = 0, on elements of this shape or of the default for that edge."""
    sides = np.array([[plate.length], [plate.width]])
    mesh = elements.elements(lambda p: sides * p, shape or MESHES[plate.edges[0]])
    strain, laminate = elements.strains(mesh), _with_resin(plate, np.zeros(2))
    k = elements.stiffness(mesh, strain, np.tile(laminate, (mesh.points.shape[1], 1, 1)))
    clamped = [i * mesh.n + mesh.held["x0"] for i in range(len(elements.FIELDS))]
    held = np.concatenate(clamped) if "C" in plate.edges else np.array([], dtype=np.int64)
    bare = k, _mass(plate, mesh, np.ones(mesh.mass_points.shape[1])), held
    about = float(
        np.sqrt(laminate[5, 5] / (plate.density * plate.thickness)) / (2.0 * plate.length * plate.width)
    )
    return Bench(plate, mesh, strain, laminate, bare, np.exp(_ln_f(plate, bare, n_modes, about)))


def _mass(plate: TruePlate, mesh: Elements, thickness: Array) -> csr_array[Any]:
    """M for a thickness relative to the nominal one at the points of the mass rule."""
    per_area = plate.density * plate.thickness * thickness
    return elements.mass(mesh, per_area, per_area * (plate.thickness * thickness) ** 2 / 12.0)


def of_stiffness(on: Bench, c: Array) -> Matrices:
    """Matrices of the plate with another laminate stiffness at every point, (q, 8, 8)."""
    _, m, held = on.bare
    return elements.stiffness(on.mesh, on.strain, c), m, held


# Clamps


def _sprung(on: Bench, turn: Profile, shift: Profile) -> Matrices:
    """Matrices of the plate with its clamped edge on springs.

    turn, shift : compliance along it in units of side / D and side^3 / D (w), side / A (u, v); infinite where
        it is loose
    """
    k, m, _ = on.bare
    side, c = on.plate.length, on.laminate
    bending, membrane = c[3, 3], c[0, 0]
    units = {"u": membrane / side, "v": membrane / side, "w": bending / side**3}
    units |= {"phi_x": bending / side, "phi_y": bending / side}
    for name, unit in units.items():
        gives, rigid = (turn, _RIGID["turn"]) if name.startswith("phi") else (shift, _RIGID["shift"])
        form = elements.edge_form(on.mesh, "x0", partial(_spring, unit, gives, rigid))
        k = k + elements.on_field(on.mesh, name, form)
    return csr_array(k), m, np.array([], dtype=np.int64)


def _spring(unit: float, gives: Profile, rigid: float, along: Array) -> Array:
    return np.asarray(unit / (gives(along) + rigid))


def _none(along: Array) -> Array:
    return np.zeros_like(along)


def _loose_where(is_loose: Callable[[Array, float], NDArray[Any]]) -> Callable[[float], Profile]:
    return lambda size: lambda s: np.where(is_loose(s, size), np.inf, 0.0)


_LOOSE = {
    "abruptly, from one end": _loose_where(lambda s, size: s < size),
    "abruptly, from both ends": _loose_where(lambda s, size: np.minimum(s, 1.0 - s) < size / 2.0),
    "abruptly, between bolts": _loose_where(lambda s, size: np.abs(s - 0.6) < size / 2.0),
}
# Compliance along the edge relative to its mean.
_UNEVEN: dict[str, Profile] = {
    "softer towards one end": lambda s: 1.0 + 0.8 * (2.0 * s - 1.0),
    "softer at both ends": lambda s: 0.4 + 1.8 * (2.0 * s - 1.0) ** 2,
    "softer between bolts": lambda s: 1.0 - 0.8 * np.cos(6.0 * np.pi * s),
}


def _slipping(loose: Callable[[float], Profile], on: Bench, size: float, place: Place) -> Matrices:
    return _sprung(on, loose(size), loose(size))


def _resting(on: Bench, size: float, place: Place) -> Matrices:
    """Where the clamp does not grip, the plate rests on it and may rotate."""
    return _sprung(on, _LOOSE["abruptly, from one end"](size), _none)


def _uneven(along: Profile, turn: float, shift: float, on: Bench, size: float, place: Place) -> Matrices:
    return _sprung(on, lambda s: turn * size * along(s), lambda s: shift * size * along(s))


# Masses and pads


def _disc(on: Bench, place: Place, diameter: float) -> Array:
    """Points (2, p) on the unit square that represent a disc."""
    grid = np.stack(np.meshgrid(*[np.linspace(-0.4, 0.4, 5)] * 2)).reshape(2, -1)
    inside = grid[:, np.hypot(*grid) < 0.46]
    return np.clip(np.array(place)[:, None] + diameter * inside / on.sides[:, None], 0.0, 1.0)


def _spread(on: Bench, points: Array) -> csr_array[Any]:
    """Mean of the square of a field over points, (n, n)."""
    value = elements.at_points(on.mesh, points)
    return csr_array(value.T @ value / points.shape[1])


def _loaded(on: Bench, mass: float, points: Array, height: float) -> csr_array[Any]:
    """Mass matrix of the plate with a mass that is spread over points."""
    spread = _spread(on, points)
    rotary = mass * (on.plate.thickness / 2.0 + height) ** 2
    m = on.bare[1]
    for name in elements.FIELDS:
        m = m + (rotary if name.startswith("phi") else mass) * elements.on_field(on.mesh, name, spread)
    return csr_array(m)


def _footprint(diameter: float, stiffer: float, on: Bench, size: float, place: Place) -> Matrices:
    """A mass, a fraction of the plate's, on a disc under which the stiffness is multiplied by ``stiffer``."""
    k, _, held = on.bare
    m = _loaded(on, size * on.plate.total_mass, _disc(on, place, diameter), _HEIGHT)
    if stiffer != 1.0:
        off = on.mesh.points - (on.sides * place)[:, None]
        k, _, _ = _softer(on, np.hypot(*off) < diameter / 2.0, 1.0 - stiffer)
    return k, m, held


def _cabled(diameter: float, on: Bench, size: float, place: Place) -> Matrices:
    """Part of the mass is a cable that is taped along x to the far edge."""
    k, m, held = _footprint(diameter, 1.0, on, (1.0 - _CABLE) * size, place)
    line = np.linspace(place[0], 1.0, 12)
    along = replace(on, bare=(k, m, held))
    mass = _CABLE * size * on.plate.total_mass
    return k, _loaded(along, mass, np.stack([line, np.full_like(line, place[1])]), 0.0), held


def padded(places: Array, shares: Array, on: Bench, size: float, place: Place) -> Matrices:
    """Pads on which a rigid plate would bounce at this fraction of its first frequency."""
    k, m, held = on.bare
    whole = (2.0 * np.pi * size * on.frequencies[0]) ** 2 * on.plate.total_mass
    for (x, y), share in zip(places, shares, strict=True):
        k = k + whole * share * elements.on_field(on.mesh, "w", _spread(on, _disc(on, (x, y), _PAD)))
    return csr_array(k), m, held


def _pads(x: float, y: float, shares: Sequence[float] = (0.25,) * 4) -> Callable[..., Matrices]:
    corners = np.array([(x, y), (1.0 - x, y), (x, 1.0 - y), (1.0 - x, 1.0 - y)])
    return partial(padded, corners, np.array(shares))


# Stiffness and thickness


def _softer(on: Bench, depth: Array, loss: float) -> Matrices:
    return of_stiffness(on, on.laminate * (1.0 - loss * depth)[:, None, None])


# From places (2, q) about the centre of the damage, in units of its extent, to its depth.
_OUTLINES: dict[str, Profile] = {
    "ellipse": lambda p: np.hypot(p[0] / 1.5, p[1] / 0.7) < 1.0,
    "strip": lambda p: (np.abs(p[0] + p[1]) < 2.0**0.5 * 2.0) & (np.abs(p[0] - p[1]) < 2.0**0.5 * 0.5),
    "two spots": lambda p: np.minimum(np.hypot(p[0] - 1.0, p[1]), np.hypot(p[0] + 1.0, p[1] - 0.5)) < 0.7,
    "corner of an L": lambda p: (np.max(np.abs(p), axis=0) < 1.0) & (np.min(p, axis=0) < 0.0),
    "deeper at one side": lambda p: np.where(np.hypot(*p) < 1.0, 0.5 * (1.0 + p[0]), 0.0),
}


def _damaged(outline: Profile, extent: float, on: Bench, size: float, place: Place) -> Matrices:
    off = on.mesh.points - (on.sides * place)[:, None]
    return _softer(on, np.asarray(outline(off / (extent * on.sides.min())), dtype=float), size)


# From distances (2, q) from the edges at a corner, in units of a leg, to whether the place is missing.
_CORNERS: dict[str, Profile] = {
    "rectangle along x": lambda p: (p[0] < 1.5) & (p[1] < 0.75),
    "rectangle along y": lambda p: (p[0] < 0.75) & (p[1] < 1.5),
    "chamfer": lambda p: p[0] + p[1] < 1.5,
    "rounded": lambda p: (np.hypot(2.0 - p[0], 2.0 - p[1]) > 2.0) & (np.max(p, axis=0) < 2.0),
    "broken": lambda p: (p[0] + 0.4 * p[1] < 1.1) & (p[0] + 2.0 * p[1] < 2.2),
}
# Fraction of stiffness and mass that remains of a missing part.
_REMAINS = 1e-3


def _cut_off(missing: Profile, on: Bench, size: float, place: Place) -> Matrices:
    """A corner is missing; size : of a leg relative to the shorter side."""
    leg, corner = max(size, 1e-9) * on.sides.min(), (on.sides * place)[:, None]
    at, at_mass = (
        1.0 - (1.0 - _REMAINS) * missing(np.abs(points - corner) / leg)
        for points in (on.mesh.points, on.mesh.mass_points)
    )
    k, _, held = of_stiffness(on, on.laminate * at[:, None, None])
    return k, _mass(on.plate, on.mesh, at_mass), held


# Relative thickness along a side from -1 to 1, with mean zero and a difference of 2 between its ends.
THICKNESS: dict[str, Profile] = {
    "step": lambda s: np.where(s > 0.1, 1.1, -0.9),
    "two steps": lambda s: np.where(s > 0.4, 1.0, 0.0) + np.where(s < -0.4, -1.0, 0.0),
    "parabola": lambda s: s + 0.5 * s**2 - 1.0 / 6.0,
    "even, then tapered": lambda s: 2.0 * np.maximum(s, 0.0) - 0.5,
}


def of_thickness(profile: Profile, axis: int, on: Bench, size: float, place: Place) -> Matrices:
    at, at_mass = (1.0 + size * profile(2.0 * u[axis] - 1.0) for u in (on.mesh.unit, on.mesh.mass_unit))
    power = np.ones((8, 8))
    power[3:6, 3:6] = 3.0
    k, _, held = of_stiffness(on, on.laminate * at[:, None, None] ** power)
    return k, _mass(on.plate, on.mesh, at_mass), held


def _skinned(near: Place, far: Place, on: Bench, size: float, place: Place) -> Matrices:
    """Resin on the lower and upper faces, different on the half of the plate at x = 0 and on the other.

    size : relative to the thickness; near, far : skins relative to it
    """
    c = [_with_resin(on.plate, size * on.plate.thickness * np.array(skins)) for skins in (near, far)]
    return of_stiffness(on, np.where((on.mesh.unit[0] < 0.5)[:, None, None], *c))


def _with_resin(plate: TruePlate, skins: Array) -> Array:
    """Stiffness of the plate's plies between resin skins on the lower and upper faces, (8, 8)."""
    ply = (plate.thickness - float(np.sum(skins))) / len(plate.angles_deg)
    resin, of_ply = elements.completed(elements.RESIN), elements.completed(plate.constants)
    faces = [(resin, 0.0, float(t)) for t in skins]
    plies = [(of_ply, angle, ply) for angle in plate.angles_deg]
    return elements.laminate_stiffness([faces[0], *plies, faces[1]], plate.correction)


# Shapes: slopes of a mid-surface along x and y, times half a side, relative to its sag.
_RISES: dict[str, Callable[[Array, Array], tuple[Array, Array]]] = {
    "cosine": lambda s, t: (
        -np.pi / 2.0 * np.sin(np.pi / 2.0 * s) * np.cos(np.pi / 2.0 * t),
        -np.pi / 2.0 * np.cos(np.pi / 2.0 * s) * np.sin(np.pi / 2.0 * t),
    ),
    "bow and twist": lambda s, t: (-2.0 * s + 0.5 * t, 0.5 * s),
    "bowed at one end": lambda s, t: (-2.0 * s * (1.0 + 0.5 * s) + 0.5 * (1.0 - s**2), 0.0 * t),
    "bell": lambda s, t: (-4.0 * s * np.exp(-2.0 * (s**2 + t**2)), -4.0 * t * np.exp(-2.0 * (s**2 + t**2))),
}


def _risen(
    rise: Callable[[Array, Array], tuple[Array, Array]], on: Bench, size: float, place: Place
) -> Matrices:
    """A shallow shell; size : sag relative to the thickness."""
    s, t = 2.0 * on.mesh.unit - 1.0
    x, y = (
        size * on.plate.thickness * slope * 2.0 / side
        for slope, side in zip(rise(s, t), on.sides, strict=True)
    )
    risen = replace(on, strain=elements.strains(on.mesh, (x, y)))
    return of_stiffness(risen, np.broadcast_to(on.laminate, (on.mesh.points.shape[1], 8, 8)))


# The forms


@dataclass(frozen=True, slots=True)
class RealForm:
    """A real form of a cause.

    act : plate, size, place -> its matrices
    sizes : in the unit of the form
    places : relative to the sides, for a cause that has a place
    """

    cause: str
    name: str
    act: Callable[[Bench, float, Place], Matrices]
    sizes: tuple[float, ...]
    places: tuple[Place, ...] = ((0.5, 0.5),)


_PLACES = ((0.88, 0.62), (0.64, 0.83))
_FOOTPRINTS = (15e-3, 30e-3)
_EXTENTS = (0.1, 0.2)
_SLIPS, _COMPLIANCES = (0.06, 0.12, 0.2), (1.5, 6.0)
_MASSES, _BOUNCES, _LOSSES = (0.012, 0.045), (0.15, 0.35), (0.3, 0.75)
_LEGS = (0.1, 0.2)
_TAPERS, _SKINS, _SAGS = (0.04, 0.16), (0.02, 0.06), (0.25, 0.9)
# Compliances at one standard deviation of the catalogue.
_SOFT = {"clamp_rotation": (0.02, 0.0), "clamp_translation": (0.0, 0.002), "soft_clamp": (0.02, 0.002)}

FORMS: tuple[RealForm, ...] = (
    *(RealForm("clamp_slip", name, partial(_slipping, loose), _SLIPS) for name, loose in _LOOSE.items()),
    RealForm("clamp_slip", "rests where it is loose", _resting, _SLIPS),
    *(
        RealForm(cause, name, partial(_uneven, along, *soft), _COMPLIANCES)
        for cause, soft in _SOFT.items()
        for name, along in _UNEVEN.items()
    ),
    *(
        RealForm("sensor_mass", f"{name}, {1e3 * d:.0f} mm", act, _MASSES, _PLACES)
        for d in _FOOTPRINTS
        for name, act in (
            ("footprint", partial(_footprint, d, 1.0)),
            ("footprint of wax or tape", partial(_footprint, d, _TAPED)),
            ("with a cable", partial(_cabled, d)),
        )
    ),
    RealForm("support", "four pads at 0.2", _pads(0.2, 0.2), _BOUNCES),
    RealForm("support", "four pads at 0.25", _pads(0.25, 0.25), _BOUNCES),
    RealForm("support", "four pads at 0.3", _pads(0.3, 0.3), _BOUNCES),
    RealForm("support", "four pads at 0.2 and 0.3", _pads(0.2, 0.3), _BOUNCES),
    RealForm("support", "four unequal pads", _pads(0.25, 0.22, (0.15, 0.2, 0.3, 0.35)), _BOUNCES),
    *(
        RealForm("damage", f"{name}, extent {r:g}", partial(_damaged, outline, r), _LOSSES, (place,))
        for name, outline in _OUTLINES.items()
        for r, place in zip(_EXTENTS, _PLACES, strict=True)
    ),
    *(
        RealForm("outline", name, partial(_cut_off, missing), _LEGS, ((1.0, 1.0),))
        for name, missing in _CORNERS.items()
    ),
    *(
        RealForm(f"taper_{axis}", name, partial(of_thickness, profile, "xy".index(axis)), _TAPERS)
        for axis in "xy"
        for name, profile in THICKNESS.items()
    ),
    RealForm("resin_skin", "on one face", partial(_skinned, (2.0, 0.0), (2.0, 0.0)), _SKINS),
    RealForm("resin_skin", "on unequal halves", partial(_skinned, (1.5, 1.5), (0.5, 0.5)), _SKINS),
    *(RealForm("warp", name, partial(_risen, rise), _SAGS) for name, rise in _RISES.items()),
)
