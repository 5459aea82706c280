"""A true plate, its natural frequencies, and its possible flaws, of any size and place."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from validation.independent import elements
from validation.independent.elements import EDGES, Elements

Array = NDArray[np.float64]
Aux = dict[str, Any]

# Compliances of edges that count as rigid, in units of side / D, side^3 / D and side / A.
_RIGID = {"turn": 1e-6, "shift": 1e-8}
# Fields that a simple support across an axis fixes: w, and those along it.
_SUPPORTED = {"x": ("v", "w", "phi_y"), "y": ("u", "w", "phi_x")}
# Number of rigid-body motions of a free plate.
_RIGID_MOTIONS = 6


@dataclass(frozen=True, slots=True)
class Mass:
    """A mass on the plate, kg, at a place in m, with its rotary inertia, kg m2."""

    mass: float
    x: float
    y: float
    rotary: float = 0.0


@dataclass(frozen=True, slots=True)
class Patch:
    """Where the plate is softer: stiffness (1 - loss), over half widths in m about a place in m.

    form : "rectangle", "ellipse", or "smooth", a bell whose standard deviations are the half widths.
    gone : whether mass is lost together with stiffness, as in a hole or a missing corner.
    """

    form: Literal["rectangle", "ellipse", "smooth"]
    x: float
    y: float
    half_x: float
    half_y: float
    loss: float
    gone: bool = False

    def depth(self, points: Array) -> Array:
        """Depth, from 0 to 1, at points (2, q) in m."""
        s, t = (points[0] - self.x) / self.half_x, (points[1] - self.y) / self.half_y
        if self.form == "smooth":
            return np.asarray(np.exp(-0.5 * (s**2 + t**2)))
        inside = np.maximum(np.abs(s), np.abs(t)) if self.form == "rectangle" else np.hypot(s, t)
        return np.asarray((inside <= 1.0).astype(float))


@dataclass(frozen=True, slots=True)
class TruePlate:
    """A plate with all its flaws; the defaults are nominal.

    length, width, thickness : m.
    density : kg/m3.
    edges : F, S or C at x=0, y=0, x=length, y=width; all F, or such that no rigid-body motion remains.
    angles_deg : plies of equal thickness, bottom to top.
    constants : of the ply, Pa.
    correction : shear correction factor; None: energy-consistent.
    taper : relative growth of the thickness from the middle to the far edges along x and y.
    skins : resin on each face, m, within the thickness.
    log_shear : ln of a factor on the transverse shear stiffness.
    skew_deg : angle by which the sides along y lean.
    sag : rise of a shallow cap at its centre, m.
    stress : largest residual normal stress, Pa.
    masses, patches : with their places.
    strips : edges with a mass along them, kg.
    foundation_hz : frequency at which the plate bounces on a uniform soft bed.
    turn, shift : compliances of the clamp, in units of side / D and side^3 / D (w), side / A (u, v); shift
        of a simple support is that of w.
    loose : fraction of each clamped edge, from its first end, that is not gripped.
    scale, tan_delta : change the frequencies to ln f + ln(1 + scale) + tan_delta / pi * ln(f / f_1).
    bias : difference of ln f between three dimensions and the elements, mode by mode; zero beyond its end.
    """

    length: float
    width: float
    thickness: float
    density: float
    edges: str
    angles_deg: tuple[float, ...]
    constants: Mapping[str, float]
    correction: float | None = None
    taper: tuple[float, float] = (0.0, 0.0)
    skins: tuple[float, float] = (0.0, 0.0)
    log_shear: float = 0.0
    skew_deg: float = 0.0
    sag: float = 0.0
    stress: float = 0.0
    masses: tuple[Mass, ...] = ()
    patches: tuple[Patch, ...] = ()
    strips: tuple[tuple[str, float], ...] = ()
    foundation_hz: float = 0.0
    turn: float = 0.0
    shift: float = 0.0
    loose: float = 0.0
    scale: float = 0.0
    tan_delta: float = 0.0
    bias: tuple[float, ...] = ()
    mesh: int = field(default=elements.ELEMENTS)

    @property
    def total_mass(self) -> float:
        """Nominal mass, kg."""
        return self.length * self.width * self.thickness * self.density


def natural_frequencies(plate: TruePlate, n_modes: int) -> Array:
    """Lowest natural frequencies, Hz, without the rigid-body motions of a free plate."""
    f, _ = modes(plate, n_modes)
    return observed(plate, f)


def observed(plate: TruePlate, f: Array) -> Array:
    """Frequencies with the effects of three dimensions, a viscoelastic material and the analyser."""
    bias = np.zeros(len(f))
    bias[: len(plate.bias)] = plate.bias[: len(f)]
    return np.asarray(f * (f / f[0]) ** (plate.tan_delta / np.pi) * (1.0 + plate.scale) * np.exp(bias))


def weight(plate: TruePlate) -> float:
    """Mass of the plate with its flaws but without attached masses, kg."""
    bare = replace(plate, masses=(), strips=())
    mesh, _ = _mesh_of(bare)
    _, m, _ = matrices(bare)
    w = slice(elements.FIELDS.index("w") * mesh.n, (elements.FIELDS.index("w") + 1) * mesh.n)
    return float(m[w, w].sum())


def modes(plate: TruePlate, n_modes: int) -> tuple[Array, Array]:
    """Natural frequencies of the plate itself, Hz, and its modes (5 n, n_modes) at the nodes."""
    k, m, held = matrices(plate)
    rigid = _RIGID_MOTIONS if is_free(plate) else 0
    return elements.frequencies(k, m, held, n_modes, rigid, _about(plate))


def sensitivities(plate: TruePlate, names: tuple[str, ...], n_modes: int) -> tuple[Array, Array]:
    """ln f of the plate and d ln f / d ln(constant), (n_modes,) and (n_modes, n_names), modes in order.

    For each mode from its shape, d lambda = phi^T dK phi; a constant derived from another moves with it.
    """
    f, shapes = modes(plate, n_modes)
    mesh, strain = _mesh_of(plate)
    bent = (strain @ shapes).reshape(-1, 8, shapes.shape[1])
    columns = []
    for name in names:
        step = 1e-5
        c = [_stiffness_at(_with(plate, name, side * step), mesh) for side in (1.0, -1.0)]
        change = (c[0] - c[1]) / (2.0 * step) * mesh.weights[:, None, None]
        energy = np.einsum("qik,qij,qjk->k", bent, change, bent, optimize=True)
        columns.append(energy / (2.0 * (2.0 * np.pi * f) ** 2))
    return np.log(observed(plate, f)), np.stack(columns, axis=1)


def matrices(plate: TruePlate) -> tuple[csr_array[Any], csr_array[Any], NDArray[np.int64]]:
    """K, M and the unknowns that are fixed."""
    mesh, strain = _mesh_of(plate)
    k = elements.stiffness(mesh, strain, _stiffness_at(plate, mesh))
    if plate.stress:
        k = k + elements.on_field(mesh, "w", _stressed(plate, mesh))
    per_area = plate.density * _thickness(plate, mesh.mass_unit) * _present(plate, mesh.mass_points)
    if plate.foundation_hz:
        bed = (2.0 * np.pi * plate.foundation_hz) ** 2 * plate.density * plate.thickness
        value = mesh.mass_value
        k = k + elements.on_field(
            mesh, "w", csr_array(value.T @ elements.scaled(bed * mesh.mass_weights, value))
        )
    m = elements.mass(mesh, per_area, per_area * _thickness(plate, mesh.mass_unit) ** 2 / 12.0)
    for mass in plate.masses:
        at = elements.at_points(mesh, np.array([[mass.x / plate.length], [mass.y / plate.width]]))
        spread = csr_array(at.T @ at)
        for name in ("u", "v", "w"):
            m = m + mass.mass * elements.on_field(mesh, name, spread)
        for name in ("phi_x", "phi_y"):
            turning = mass.rotary + mass.mass * (plate.thickness / 2.0) ** 2
            m = m + turning * elements.on_field(mesh, name, spread)
    for edge, kg in plate.strips:
        line = kg * elements.edge_form(mesh, edge, np.ones_like) / mesh.edges[edge][1].sum()
        for name in ("u", "v", "w"):
            m = m + elements.on_field(mesh, name, line)
    springs, held = _supports(plate, mesh)
    return csr_array(k + springs), csr_array(m), held


def _supports(plate: TruePlate, mesh: Elements) -> tuple[csr_array[Any], NDArray[np.int64]]:
    """Springs of compliant clamps and supports, and the fixed unknowns of rigid ones."""
    soft = plate.turn > 0.0 or plate.shift > 0.0 or plate.loose > 0.0
    springs = csr_array((5 * mesh.n, 5 * mesh.n))
    held: list[NDArray[np.int64]] = [np.array([], dtype=np.int64)]
    c = _nominal(plate)
    for edge, kind in zip(EDGES, plate.edges, strict=True):
        if kind == "F":
            continue
        axis = "xy".index(edge[0])
        side = (plate.length, plate.width)[axis]
        bending, membrane = c[3 + axis, 3 + axis], c[axis, axis]
        density = {
            "w": bending / side**3 / (plate.shift + _RIGID["shift"]),
            "u": membrane / side / (plate.shift + _RIGID["shift"]),
            "phi_x": bending / side / (plate.turn + _RIGID["turn"]),
        }
        density |= {"v": density["u"], "phi_y": density["phi_x"]}
        for i, name in enumerate(elements.FIELDS):
            if kind == "S" and name not in _SUPPORTED[edge[0]]:
                continue
            gives = plate.shift if name in ("u", "v", "w") else plate.turn
            firm = gives == 0.0 and plate.loose == 0.0 if kind == "C" else gives == 0.0 or name != "w"
            if not soft or firm:
                held.append(i * mesh.n + mesh.held[edge])
                continue
            grip = lambda along, k=density[name]: k * (along >= plate.loose)  # noqa: E731
            springs = springs + elements.on_field(mesh, name, elements.edge_form(mesh, edge, grip))
    return springs, np.unique(np.concatenate(held))


def _nominal(plate: TruePlate) -> Array:
    return _laminate(
        tuple(sorted(elements.completed(plate.constants).items())),
        plate.angles_deg,
        plate.thickness,
        plate.skins,
        plate.correction,
    )


@lru_cache(maxsize=64)
def _laminate(
    constants: tuple[tuple[str, float], ...],
    angles_deg: tuple[float, ...],
    thickness: float,
    skins: tuple[float, float],
    correction: float | None,
) -> Array:
    ply = (thickness - sum(skins)) / len(angles_deg)
    ply_constants = dict(constants)
    plies = [(ply_constants, angle, ply) for angle in angles_deg]
    resin = elements.completed(elements.RESIN)
    if skins[0]:
        plies.insert(0, (resin, 0.0, skins[0]))
    if skins[1]:
        plies.append((resin, 0.0, skins[1]))
    return elements.laminate_stiffness(plies, correction)


def _stiffness_at(plate: TruePlate, mesh: Elements) -> Array:
    """Laminate stiffness at every point of the quadrature, (q, 8, 8)."""
    c = _nominal(plate).copy()
    c[6:, 6:] *= np.exp(plate.log_shear)
    rise = _thickness(plate, mesh.unit) / plate.thickness
    power = np.ones((8, 8))
    power[:3, 3:6] = power[3:6, :3] = 2.0
    power[3:6, 3:6] = 3.0
    left = _present(plate, mesh.points)
    for patch in plate.patches:
        if not patch.gone:
            left = left * (1.0 - patch.loss * patch.depth(mesh.points))
    return np.asarray(c * rise[:, None, None] ** power * left[:, None, None])


def _thickness(plate: TruePlate, unit: Array) -> Array:
    s = 2.0 * unit - 1.0
    return np.asarray(plate.thickness * (1.0 + plate.taper[0] * s[0] + plate.taper[1] * s[1]))


def _present(plate: TruePlate, points: Array) -> Array:
    """Fraction of the plate that is present; a thousandth remains of what is cut away."""
    out = np.ones(points.shape[1])
    for patch in plate.patches:
        if patch.gone:
            out = out * (1.0 - min(patch.loss, 0.999) * patch.depth(points))
    return out


def _stressed(plate: TruePlate, mesh: Elements) -> csr_array[Any]:
    """Integral of grad w . N grad w, with N from the Airy function F (1 - s^2)^2 (1 - t^2)^2."""
    s, t = 2.0 * mesh.unit - 1.0
    a, b = plate.length, plate.width
    force = plate.stress * plate.thickness
    scale = force * min(a, b) ** 2 / 32.0  # |N| is largest, 8 in units of 4 F / b^2, in the middle of an edge
    bell = [(1.0 - z**2) ** 2 for z in (s, t)]
    slope = [-4.0 * z * (1.0 - z**2) for z in (s, t)]
    bend = [12.0 * z**2 - 4.0 for z in (s, t)]
    n_x, n_y = scale * bell[0] * bend[1] * 4.0 / b**2, scale * bend[0] * bell[1] * 4.0 / a**2
    n_xy = -scale * slope[0] * slope[1] * 4.0 / (a * b)
    x, y = mesh.slope
    w = mesh.weights
    out = x.T @ elements.scaled(w * n_x, x) + y.T @ elements.scaled(w * n_y, y)
    return csr_array(out + x.T @ elements.scaled(w * n_xy, y) + y.T @ elements.scaled(w * n_xy, x))


def _mesh_of(plate: TruePlate) -> tuple[Elements, csr_array[Any]]:
    return _meshed(plate.length, plate.width, plate.skew_deg, plate.sag, plate.mesh)


@lru_cache(maxsize=12)
def _meshed(
    length: float, width: float, skew_deg: float, sag: float, n: int
) -> tuple[Elements, csr_array[Any]]:
    lean = np.tan(np.radians(skew_deg))
    # an oblique side keeps its length
    rise = np.cos(np.radians(skew_deg))

    def outline(p: Array) -> Array:
        y = width * rise * p[1]
        return np.stack([length * p[0] + lean * y, y])

    mesh = elements.elements(outline, (n, n))
    if not sag:
        return mesh, elements.strains(mesh)
    # w0 = s (1 - s_x^2 - s_y^2): a sag of 8 s / a^2 and 8 s / b^2 in curvature
    slopes = [-8.0 * sag / side * (mesh.unit[i] - 0.5) for i, side in enumerate((length, width))]
    return mesh, elements.strains(mesh, (slopes[0], slopes[1]))


def _with(plate: TruePlate, name: str, step: float) -> TruePlate:
    """The plate with a constant multiplied by 1 + step."""
    return replace(plate, constants={**plate.constants, name: plate.constants[name] * (1.0 + step)})


def _about(plate: TruePlate) -> float:
    """A frequency of the order of the first, Hz."""
    c = _nominal(plate)
    per_area = plate.density * plate.thickness
    return float(0.5 * np.sqrt(c[5, 5] / per_area) / (plate.length * plate.width))


# Flaws

# Degrees of freedom of the Student-t priors of sizes.
DEGREES_OF_FREEDOM = 4.0
# An accelerometer's radius of gyration, m.
_GYRATION = 4e-3


@dataclass(frozen=True, slots=True)
class Flaw:
    """A cause and its implementation on a plate.

    scale : plate -> standard deviation of its size by the physics of effects, in its unit.
    most : plate -> the physical limit.
    apply : plate, size, other drawn quantities -> plate.
    draw : the other quantities: places, forms.
    two_sided : whether the size has either sign.
    applies : whether a plate can have it.
    stated : size, other drawn quantities, mass of the plate in kg -> the size in a detection limit's measure,
        SI and degrees; None if the form is another.
    """

    cause: str
    scale: Callable[[TruePlate], float]
    most: Callable[[TruePlate], float]
    apply: Callable[[TruePlate, float, Aux], TruePlate]
    two_sided: bool = True
    draw: Callable[[TruePlate, np.random.Generator], Aux] = lambda plate, rng: {}
    applies: Callable[[TruePlate], bool] = lambda plate: True
    stated: Callable[[float, Aux, float], float | None] = lambda size, aux, mass: abs(size)

    def prior_size(self, plate: TruePlate, rng: np.random.Generator) -> float:
        """A size drawn from the prior, within the physical limit."""
        while True:
            size = float(self.scale(plate) * rng.standard_t(DEGREES_OF_FREEDOM))
            size = size if self.two_sided else abs(size)
            if abs(size) <= self.most(plate):
                return size


def _fixed(value: float) -> Callable[[TruePlate], float]:
    return lambda plate: value


def _is_clamped(plate: TruePlate) -> bool:
    return "C" in plate.edges


def is_free(plate: TruePlate) -> bool:
    """Whether no edge is held."""
    return set(plate.edges) == {"F"}


def has_plies(plate: TruePlate) -> bool:
    """Whether it is a laminate."""
    return len(plate.angles_deg) > 1


def _is_cross_ply(plate: TruePlate) -> bool:
    return len(set(plate.angles_deg)) > 1


def _turned(plate: TruePlate, size: float, at: tuple[int, ...]) -> TruePlate:
    angles = tuple(a + size if i in at else a for i, a in enumerate(plate.angles_deg))
    return replace(plate, angles_deg=angles)


def _outer(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return _turned(plate, size, (0, len(plate.angles_deg) - 1))


def _inner(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    middle = len(plate.angles_deg) // 2
    return _turned(plate, size, (middle - 2, middle + 1))


def _anywhere(plate: TruePlate, rng: np.random.Generator) -> Aux:
    x, y = rng.uniform(0.02, 0.98, 2)
    return {"x": float(x), "y": float(y)}


def _loaded(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    m = size * plate.total_mass
    mass = Mass(m, aux["x"] * plate.length, aux["y"] * plate.width, m * _GYRATION**2)
    return replace(plate, masses=(*plate.masses, mass))


def _patch(plate: TruePlate, rng: np.random.Generator) -> Aux:
    """A patch of random form, its half widths from a twentieth to a quarter of the sides."""
    half = np.exp(rng.uniform(np.log(0.05), np.log(0.25), 2))
    form = str(rng.choice(["rectangle", "ellipse", "smooth"]))
    if form == "smooth":
        half = half / 2.0
    x, y = rng.uniform(0.05, 0.95, 2)
    return {"form": form, "x": float(x), "y": float(y), "half": [float(h) for h in half]}


def _softer(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    half = [h * side for h, side in zip(aux["half"], (plate.length, plate.width), strict=True)]
    patch = Patch(aux["form"], aux["x"] * plate.length, aux["y"] * plate.width, half[0], half[1], size)
    return replace(plate, patches=(*plate.patches, patch))


def _cut(plate: TruePlate, rng: np.random.Generator) -> Aux:
    """A hole, or a free corner cut off, with the ratio of its widths."""
    ratio = float(np.exp(rng.uniform(-0.5, 0.5)))
    if rng.random() < 0.5:
        x, y = rng.uniform(0.15, 0.85, 2)
        return {"form": "ellipse", "x": float(x), "y": float(y), "ratio": ratio}
    x = 1.0 if _is_clamped(plate) else float(rng.integers(2))
    return {"form": "rectangle", "x": x, "y": float(rng.integers(2)), "ratio": ratio}


def _without(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    """Remove a part whose half widths are this fraction of the sides, times and over their ratio."""
    half_x, half_y = size * plate.length * aux["ratio"], size * plate.width / aux["ratio"]
    gap = Patch(aux["form"], aux["x"] * plate.length, aux["y"] * plate.width, half_x, half_y, 1.0, gone=True)
    return replace(plate, patches=(*plate.patches, gap))


def _missing_corner(size: float, aux: Aux, mass: float) -> float | None:
    """Missing fraction of the area for a corner; a hole has no limit."""
    return size**2 if aux["form"] == "rectangle" else None


def _soft(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return replace(plate, turn=_turn(size, aux), shift=0.002 * size / aux["ratio"])


def _turn(size: float, aux: Aux) -> float:
    return 0.02 * size * float(aux["ratio"])


def _ratio(plate: TruePlate, rng: np.random.Generator) -> Aux:
    return {"ratio": float(np.exp(rng.uniform(-0.8, 0.8)))}


def _number(name: str) -> Callable[[TruePlate, float, Aux], TruePlate]:
    def apply(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
        changed: dict[str, Any] = {name: size}
        return replace(plate, **changed)

    return apply


def _scaled(name: str) -> Callable[[TruePlate, float, Aux], TruePlate]:
    return lambda plate, size, aux: replace(plate, **{name: getattr(plate, name) * (1.0 + size)})


def _longer(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return replace(plate, length=plate.length + size)


def _tapered(axis: int) -> Callable[[TruePlate, float, Aux], TruePlate]:
    return lambda plate, size, aux: replace(plate, taper=(size, 0.0) if axis == 0 else (0.0, size))


def _all_turned(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return _turned(plate, size, tuple(range(len(plate.angles_deg))))


def _other_ratio(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    given = plate.constants.get("G13", plate.constants["G12"])
    return replace(plate, constants={**plate.constants, "G13": given * (1.0 + size)})


FLAWS: dict[str, Flaw] = {
    flaw.cause: flaw
    for flaw in (
        Flaw("clamp_rotation", _fixed(0.02), _fixed(1.0), _number("turn"), False, applies=_is_clamped),
        Flaw("clamp_translation", _fixed(0.002), _fixed(0.05), _number("shift"), False, applies=_is_clamped),
        Flaw(
            "soft_clamp",
            _fixed(1.0),
            _fixed(20.0),
            _soft,
            False,
            _ratio,
            _is_clamped,
            stated=lambda size, aux, mass: _turn(size, aux),
        ),
        Flaw("clamp_slip", _fixed(0.05), _fixed(0.3), _number("loose"), False, applies=_is_clamped),
        Flaw("clamp_length", _fixed(5e-4), _fixed(0.015), _longer, applies=_is_clamped),
        Flaw(
            "sensor_mass",
            _fixed(0.01),
            _fixed(0.1),
            _loaded,
            False,
            _anywhere,
            stated=lambda size, aux, mass: size * mass,
        ),
        Flaw("support", _fixed(8.0), _fixed(25.0), _number("foundation_hz"), False, applies=is_free),
        Flaw("thickness", _fixed(0.01), _fixed(0.3), _scaled("thickness")),
        Flaw("density", _fixed(0.01), _fixed(0.4), _scaled("density")),
        Flaw("length", _fixed(0.002), _fixed(0.1), _scaled("length")),
        Flaw("width", _fixed(0.002), _fixed(0.1), _scaled("width")),
        Flaw("frequency_scale", _fixed(0.002), _fixed(0.02), _number("scale")),
        Flaw("taper_x", _fixed(0.03), _fixed(0.3), _tapered(0)),
        Flaw("taper_y", _fixed(0.03), _fixed(0.3), _tapered(1)),
        Flaw("skew", _fixed(1.0), _fixed(10.0), _number("skew_deg"), applies=is_free),
        Flaw("misorientation", _fixed(2.0), _fixed(45.0), _all_turned, applies=has_plies),
        Flaw("outer_ply_angle", _fixed(5.0), _fixed(45.0), _outer, applies=has_plies),
        Flaw("inner_ply_angle", _fixed(20.0), _fixed(90.0), _inner, applies=_is_cross_ply),
        Flaw("warp", _fixed(5e-4), lambda p: 3.0 * p.thickness, _number("sag")),
        Flaw("membrane_stress", _fixed(3e5), _fixed(6e6), _number("stress")),
        Flaw("transverse_shear", _fixed(0.3), _fixed(1.5), _number("log_shear")),
        Flaw("shear_ratio", _fixed(0.25), _fixed(0.8), _other_ratio, applies=has_plies),
        Flaw("damage", _fixed(0.2), _fixed(0.9), _softer, False, _patch),
        Flaw("outline", _fixed(0.03), _fixed(0.15), _without, False, _cut, stated=_missing_corner),
        Flaw(
            "resin_skin",
            _fixed(5e-5),
            _fixed(2.5e-4),
            lambda plate, size, aux: replace(plate, skins=(size, size)),
            False,
            applies=has_plies,
        ),
        Flaw("viscoelastic", _fixed(0.01), _fixed(0.08), _number("tan_delta"), False),
    )
}
