"""Masses that move with the plate: known ones, a forgotten one at any place, and the air."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from scipy.special import eval_chebyu, expn, jv

from cpam_bayes.effects.effect import (
    GRAM,
    MILLIMETRE,
    Effect,
    Place,
    PlateFacts,
    anywhere,
    coordinate,
    one_sided,
    place_text,
    stacked,
    symmetries,
)
from cpam_bayes.mechanics.problem import Array, Atom, Form, PlateState, Problem, Region, Term, Values
from cpam_bayes.parameters import LogUniform, Parameter, TruncatedNormal
from cpam_bayes.plate.edges import EDGES, FIELDS, PLACES, conditions

# Over the mass of the plate: one standard deviation, and the heaviest that a point mass describes.
_SCALE, _HEAVIEST = 0.01, 0.1
# Radius of gyration about the surface that a mass is fixed to, m. A cube of side s has s (1/6 + 1/4)^(1/2):
# 3 mm for half a gram to 19 mm for 50 g with the 2 to 5 g/cm3 of accelerometers; less if flat.
_GYRATION = LogUniform(1e-3, 20e-3)


def add_known_mass(problem: Problem, mass: float, x: float, y: float) -> Problem:
    """The problem with a point mass glued to the surface of the plate at (x, y).

    M += m (u^2 + v^2 + w^2) + m (h / 2)^2 (phi_x^2 + phi_y^2) at the point: the second part is the
    rotary inertia of a mass that sits on the surface, half a thickness off the midplane.

    mass : kg; x, y : m from the corner x = y = 0.
    """
    place = (x / float(problem.nominal.length), y / float(problem.nominal.width))
    return problem.with_terms(_point_mass("known_mass", place, mass, 0.0))


def _sensor_at(place: Place) -> Effect:
    return replace(
        SENSOR_MASS,
        change=partial(_with_sensor, place),
        parameters=SENSOR_MASS.parameters[:1],
        place=place,
        at=None,
        variant=f"{place_text(place[:2])}, radius of gyration {1e3 * place[2]:.3g} mm",
    )


def _plate_mass(facts: PlateFacts) -> float:
    return facts.mass


def _with_sensor(place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    del facts
    x, y, gyration = place
    return problem.with_terms(_point_mass("sensor_mass", (x, y), None, gyration))


def _point_mass(name: str, place: tuple[float, float], mass: float | None, gyration: float) -> Term:
    """The term of a mass at a place.

    mass : kg, None where it is the parameter ``sensor_mass``
    gyration : radius of gyration about the surface, m
    """
    forms = tuple(Form(Atom(f), Atom(f), Region("point", point=place)) for f in FIELDS)
    of = mass if mass is not None else "sensor_mass"
    return Term(name, "mass", forms, partial(_coefficients, of, gyration))


def _coefficients(of: str | float, gyration: float, state: PlateState, values: Values) -> Array:
    """Coefficients (..., 5) of u, v, w and of the rotations.

    of : kg, or the name of the parameter that is the mass
    """
    mass = np.asarray(values[of] if isinstance(of, str) else of)
    rotary = mass * ((np.asarray(state.thickness) / 2) ** 2 + gyration**2)
    return stacked(*[mass + 0.0 * rotary] * 3, *[rotary] * 2)


SENSOR_MASS = Effect(
    name="sensor_mass",
    title="added mass",
    family="mass",
    belongs_to="plate",
    # of a plate of one kilogram
    parameters=(
        one_sided("sensor_mass", "kg", _SCALE, _HEAVIEST, shown=GRAM),
        coordinate("mass_x"),
        coordinate("mass_y"),
        Parameter("mass_gyration", "m", _GYRATION, _GYRATION.mean, MILLIMETRE),
    ),
    note=(
        "point mass m and its rotary inertia ((h / 2)^2 + r^2) m at any (x, y), radius of gyration r of "
        "1 to 20 mm; 1 sd is 1 % of the plate's mass"
    ),
    check="Weigh what was on the plate and state it in the plate file, or measure without contact.",
    change=anywhere,
    size_factor=_plate_mass,
    sign=-1,
    at=_sensor_at,
    local="point",
    smooth=("mass_gyration",),
    form_error=0.09,
)


# Over the mass of the plate: plastic tape along an edge, 19 mm wide and 0.15 mm thick (4 g/m), and a strip
# along an edge as heavy as the plate under it and a twentieth as wide.
_STRIP, _BROADEST = 0.003, 0.05


def _with_strip(edge: int, problem: Problem, facts: PlateFacts) -> Problem:
    """M += m / L integral of u^2 + v^2 + w^2 + (h / 2)^2 (phi_x^2 + phi_y^2) along an edge of length L."""
    del facts
    forms = tuple(Form(Atom(f), Atom(f), Region("edge", EDGES[edge])) for f in FIELDS)
    return problem.with_terms(Term("edge_mass", "mass", forms, partial(_coefficients, "edge_mass", 0.0)))


def _alike(edge: int, facts: PlateFacts) -> tuple[int, ...]:
    """An edge, and the opposite one where that is its image."""
    *mirrored, turned = symmetries(facts)
    return (edge, (edge + 2) % 4) if mirrored[edge % 2] or turned else (edge,)


def _may_carry_strip(edge: int, facts: PlateFacts) -> bool:
    """Whether an edge is free and, of two images, the later one."""
    return conditions(facts.edges)[edge].is_free and edge == max(_alike(edge, facts))


_STRIPS = tuple(
    Effect(
        name="edge_mass",
        title="tape, glue or flash along an edge",
        family="mass",
        belongs_to="plate",
        # of a plate of one kilogram
        parameters=(one_sided("edge_mass", "kg", _STRIP, _BROADEST, shown=GRAM),),
        note="line mass m / L along a free edge or the edge that is its image, for a plate of 1 kg",
        check="Clean all edges, or weigh what is on them.",
        change=partial(_with_strip, edge),
        applies_to=partial(_may_carry_strip, edge),
        size_factor=_plate_mass,
        sign=-1,
        edges=partial(_alike, edge),
        variant=f"along {PLACES[edge]}",
    )
    for edge in (2, 3, 0, 1)
)
EDGE_MASS = replace(_STRIPS[0], alternatives=_STRIPS[1:])


# Functions along each side: added masses are converged to 1e-4, relative.
_ORDER = 12
# Wave numbers, in units of 2 / side, up to which Bessel functions are integrated; beyond, their mean.
_CUTOFF = 400.0


@dataclass(frozen=True, slots=True)
class PressureJumps:
    """Functions g_k of the plate with rho sum (integral of g_k w)^2 = twice the kinetic energy of the air.

    The jump of the velocity potential is a sum of chi_mn = sqrt(1 - x^2) U_m(x) sqrt(1 - y^2) U_n(y),
    x and y from -1 to 1; its energy is c^T Lambda c with Lambda = 1/2 int |k| chi chi* d2k / (4 pi^2).
    The added mass for the plate's velocity w is F^T Lambda^-1 F, F = int chi w. length, width : m.
    """

    length: float
    width: float

    def __call__(self, points: Array) -> Array:
        """Values (n, r) at reference points (n, 2), times the plate's area."""
        x, y = (_jumps(2.0 * points[:, i] - 1.0) for i in (0, 1))
        chi = (x[:, :, None] * y[:, None, :]).reshape(len(points), -1)
        return np.asarray(chi @ _inverse_root(self.length, self.width)) * (self.length * self.width)


def _jumps(s: Array) -> Array:
    root = np.sqrt(np.maximum(1.0 - s**2, 0.0))
    return np.stack([root * eval_chebyu(m, s) for m in range(_ORDER)], axis=-1)


@lru_cache(maxsize=32)
def _inverse_root(length: float, width: float) -> Array:
    """R (r, r) with R R^T = Lambda^-1, block by block of equal parities, so that these do not mix."""
    energy = jump_energy(length, width)
    parity = [(m % 2, n % 2) for m in range(_ORDER) for n in range(_ORDER)]
    root = np.zeros_like(energy)
    for kind in set(parity):
        alike = np.flatnonzero([p == kind for p in parity])
        inverse = np.linalg.inv(np.linalg.cholesky(energy[np.ix_(alike, alike)]))
        root[np.ix_(alike, alike)] = inverse.T
    root.flags.writeable = False
    return root


def jump_energy(length: float, width: float) -> Array:
    """Lambda of a rectangle, (r, r) with r the number of pairs (m, n), m.

    With |k| = 1 / (2 sqrt(pi)) int_0^inf (1 - exp(-|k|^2 t)) t^-3/2 dt the square root becomes products of
    integrals over one wave number; t = exp(tau) by the trapezoidal rule.
    """
    half = np.array([length, width]) / 2.0
    tau = np.linspace(-26.0, 26.0, 261)
    t = np.exp(tau) * half[0] * half[1]
    in_x, in_y = (_side_integrals(t / a**2) for a in half)
    at_zero = _side_integrals(np.zeros(1))[0]
    whole = np.einsum("mp,nq->mnpq", at_zero, at_zero)
    weight = t**-0.5 * (tau[1] - tau[0]) / (2.0 * np.sqrt(np.pi))
    weight[[0, -1]] /= 2.0
    energy = whole * (weight.sum() + t[-1] ** -0.5 / np.sqrt(np.pi))
    energy -= np.einsum("t,tmp,tnq->mnpq", weight, in_x, in_y, optimize=True)
    r = _ORDER**2
    return np.asarray(0.5 * half[0] * half[1] / (4.0 * np.pi**2) * energy.reshape(r, r))


def _side_integrals(t: Array) -> Array:
    """Integrals over all k of chi_m chi_p* exp(-k^2 t), (n_t, m, p), t in units of (side / 2)^2.

    The transform of sqrt(1 - x^2) U_m is pi (-i)^m (m + 1) J_{m+1}(k) / k. Beyond the cutoff
    J_{m+1} J_{p+1} is taken at its mean, cos((m - p) pi / 2) / (pi k).
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    panels = np.linspace(0.0, _CUTOFF, int(_CUTOFF / 2) + 1)
    wide = np.diff(panels)[:, None] / 2
    k = ((panels[1:] + panels[:-1])[:, None] / 2 + wide * nodes).ravel()
    w = (wide * weights).ravel()
    order = np.arange(_ORDER)
    bessel = jv(order + 1, k[:, None]) * (order + 1) / k[:, None]
    same = (order[:, None] + order) % 2 == 0
    sign = np.where(same, (-1.0) ** ((order - order[:, None]) // 2), 0.0)
    decay = np.exp(-np.outer(t, k**2)) * w
    near = np.einsum("tk,km,kp->tmp", decay, bessel, bessel, optimize=True) * sign
    beyond = expn(2, _CUTOFF**2 * t) / (2.0 * _CUTOFF**2) / np.pi
    far = np.where(same, np.outer(order + 1, order + 1), 0.0) * beyond[:, None, None]
    return np.asarray(2.0 * np.pi**2 * (near + far))


def _in_air(problem: Problem, density: float | None) -> Problem:
    """M += rho F^T Lambda^-1 F; for other sizes of the plate it scales with the area to the power 3/2."""
    nominal = problem.nominal
    length, width = float(np.real(nominal.length)), float(np.real(nominal.width))
    form = Form(Atom("w"), Atom("w"), Region("projection"), PressureJumps(length, width))
    coefficients = partial(_added_mass, length * width, density)
    return problem.with_terms(Term("air", "mass", (form,), coefficients))


def _added_mass(area: float, density: float | None, state: PlateState, values: Values) -> Array:
    rho = np.asarray(values["air_density"] if density is None else density)
    return np.asarray(rho * (np.asarray(state.area) / area) ** 1.5)[..., None]


def add_air(problem: Problem, density: float) -> Problem:
    """The problem in air of a known density, kg/m3."""
    return _in_air(problem, density)


def _air(problem: Problem, facts: PlateFacts) -> Problem:
    del facts
    return _in_air(problem, None)


def _is_left_out(facts: PlateFacts) -> bool:
    return not facts.air_is_known


AIR = Effect(
    name="air",
    title="surrounding air",
    family="surroundings",
    belongs_to="laboratory",
    # the densities of air in rooms, at any altitude and in any weather
    parameters=(Parameter("air_density", "kg/m3", TruncatedNormal(1.2, 0.06, 0.0, 1.5), null=0.0),),
    note="added mass of an unbaffled plate: always there, never detectable alone",
    check="State the air's density in the plate file; temperature, pressure and humidity give it to 1 %.",
    change=_air,
    applies_to=_is_left_out,
    sign=-1,
)
