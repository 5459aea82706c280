"""Plates with other sizes, thickness or density than stated, or other shape: taper, skew, warp, outline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import comb
from typing import Literal

import numpy as np
from numpy.polynomial import polynomial

from cpam_bayes.effects.effect import (
    EVEN,
    MILLIMETRE,
    PERCENT,
    Effect,
    Place,
    PlateFacts,
    either_sign,
    misstated,
    per_thickness,
    symmetries,
    with_state,
)
from cpam_bayes.mechanics.affine import LINE, ONE, Box, Polynomial, Product, power
from cpam_bayes.mechanics.problem import (
    LAMINATE_FORMS,
    MASS_FORMS,
    STRAIN_ATOMS,
    THICKNESS_POWERS,
    Array,
    Atom,
    CoefficientFunction,
    Form,
    MatrixKind,
    PlateState,
    Problem,
    Term,
    Values,
    inertia_coefficients,
    laminate_coefficients,
)
from cpam_bayes.parameters import Parameter, Uniform
from cpam_bayes.plate.edges import Field, conditions


def _scaled(size: str, parameter: str) -> Callable[[Problem, PlateFacts], Problem]:
    """Change that multiplies one plate number by 1 + its deviation; a weighed plate keeps its mass."""
    return partial(_with_scaled, size, parameter)


def _with_scaled(size: str, parameter: str, problem: Problem, facts: PlateFacts) -> Problem:
    return with_state(problem, partial(_scaled_size, size, parameter, facts.weighed and size != "density"))


def _scaled_size(
    size: str, parameter: str, keeps_mass: bool, state: PlateState, values: Values
) -> PlateState:
    factor = 1.0 + values[parameter]
    scaled = replace(state, **{size: getattr(state, size) * factor})
    return replace(scaled, density=state.density / factor) if keeps_mass else scaled


def _relative(
    name: str,
    deviation: Parameter,
    *,
    title: str,
    note: str,
    check: str,
    sign: Literal[-1, 0, 1] = 0,
) -> Effect:
    return Effect(
        name=name,
        title=title,
        family="size",
        belongs_to="plate",
        parameters=(deviation,),
        note=note,
        check=check,
        change=_scaled(name, deviation.name),
        sign=sign,
    )


THICKNESS = _relative(
    "thickness",
    misstated("thickness_deviation", 0.2, (-0.6, 1.5)),
    title="wrong thickness",
    note="h (1 + deviation): thin-plate frequencies grow with h, as with stiffer moduli",
    check="Gauge the thickness at ten points or more.",
    sign=1,
)
DENSITY = _relative(
    "density",
    misstated("density_deviation", 0.2, (-0.8, 2.0)),
    title="wrong density",
    note="rho (1 + deviation): frequencies fall with rho^-1/2, as with softer moduli",
    check="Weigh the plate and state its mass.",
    sign=-1,
)
LENGTH = _relative(
    "length",
    misstated("length_deviation", 0.05, 0.4),
    title="wrong length",
    note="a (1 + deviation)",
    check="Measure the length along both edges.",
)
WIDTH = _relative(
    "width",
    misstated("width_deviation", 0.05, 0.4),
    title="wrong width",
    note="b (1 + deviation)",
    check="Measure the width along both edges.",
)
# Sides closer than this are not exchanged: the change is within the tolerance of either.
_SQUARE = 0.005


def _sides_differ(facts: PlateFacts) -> bool:
    """Whether exchanging the sides gives another plate; not with known masses, whose places are known."""
    apart = abs(facts.length / facts.width - 1.0) > _SQUARE
    turned = facts.isotropic and len(set(facts.edges)) == 1
    return apart and not turned and not facts.loaded


def _exchanged(state: PlateState, values: Values) -> PlateState:
    del values
    return replace(state, length=state.width, width=state.length)


def _exchange(problem: Problem, facts: PlateFacts) -> Problem:
    del facts
    return with_state(problem, _exchanged)


def _sides_of(facts: PlateFacts) -> tuple[Effect, ...]:
    """Form with a and b exchanged; between equal edges its spectrum is that of the layup turned."""
    alike = len(set(facts.edges)) == 1
    title = f"{SWAPPED_SIDES.title}, or the layup turned by 90 degrees" if alike else SWAPPED_SIDES.title
    return (replace(SWAPPED_SIDES, change=_exchange, title=title),)


SWAPPED_SIDES = Effect(
    name="swapped_sides",
    title="length and width exchanged",
    family="size",
    belongs_to="plate",
    parameters=(),
    note="a and b exchanged; between four equal edges the spectrum is that of the layup turned by 90 degrees",
    check="Compare which side runs along the 0 degree direction with length_mm of the file.",
    on_plate=_sides_of,
    applies_to=_sides_differ,
)


def _clamped_axes(facts: PlateFacts) -> tuple[str, ...]:
    x0, y0, x1, y1 = conditions(facts.edges)
    ends = {"length": (x0, x1), "width": (y0, y1)}
    return tuple(size for size, pair in ends.items() if any(edge.is_clamp for edge in pair))


def _clamp_length(problem: Problem, facts: PlateFacts) -> Problem:
    return with_state(problem, partial(_longer, _clamped_axes(facts)))


def _longer(sizes: tuple[str, ...], state: PlateState, values: Values) -> PlateState:
    return replace(state, **{size: getattr(state, size) + values["clamp_shift"] for size in sizes})


def _is_clamped(facts: PlateFacts) -> bool:
    return bool(_clamped_axes(facts))


CLAMP_LENGTH = Effect(
    name="clamp_length",
    title="wrong free length",
    family="clamp",
    belongs_to="test",
    parameters=(either_sign("clamp_shift", "m", 0.5e-3, 40e-3, gross=5e-3, shown=MILLIMETRE),),
    note="a + delta, of the side across the clamp",
    check="Measure the free length from the jaws of the clamp.",
    change=_clamp_length,
    applies_to=_is_clamped,
    sign=-1,
)


# Powers of h in the coefficients of MASS_FORMS.
_MASS_POWERS = np.array([1, 1, 1, 3, 3])


def _taper(parameter: str, axis: str, problem: Problem, facts: PlateFacts) -> Problem:
    """Thickness h (1 + t s), s from -1 to 1 across the plate, the midplane staying plane.

    (1 + t s)^p = sum_k C(p, k) t^k s^k with p = 1 for A, A_s and the mass, 2 for B, 3 for D and the
    rotary inertia: further forms with the weights s^k.
    """
    del facts
    return problem.with_terms(
        _taper_term(parameter, axis, LAMINATE_FORMS, THICKNESS_POWERS, laminate_coefficients, "stiffness"),
        _taper_term(parameter, axis, MASS_FORMS, _MASS_POWERS, inertia_coefficients, "mass"),
    )


def _taper_term(
    parameter: str,
    axis: str,
    forms: tuple[Form, ...],
    powers: Array,
    plain: CoefficientFunction,
    matrix: MatrixKind,
) -> Term:
    rows = [(q, int(p), k) for q, p in enumerate(powers) for k in range(1, int(p) + 1)]
    which = np.array([q for q, _, _ in rows])
    binomial = np.array([float(comb(p, k)) for _, p, k in rows])
    order = np.array([k for _, _, k in rows])
    weights = {
        k: Product(power(k), ONE) if axis == "x" else Product(ONE, power(k)) for k in set(order.tolist())
    }
    weighted = tuple(replace(forms[q], weight=weights[k]) for q, _, k in rows)
    coefficients = partial(_taper_coefficients, parameter, plain, which, binomial, order)
    return Term(parameter, matrix, weighted, coefficients)


def _taper_coefficients(
    parameter: str,
    plain: CoefficientFunction,
    which: Array,
    binomial: Array,
    order: Array,
    state: PlateState,
    values: Values,
) -> Array:
    t = np.asarray(values[parameter])[..., None]
    return np.asarray(plain(state, values)[..., which] * binomial * t**order)


def _skew(problem: Problem, facts: PlateFacts) -> Problem:
    """A parallelogram: the edges x = 0 and x = length lean by an angle; see ``PlateState.skew``.

    A weighed plate keeps its mass.
    """
    # rotation in the plane has v = x, which changes along eta too
    content = (*problem.rigid_content, ("v", (0, 1)))
    return replace(with_state(problem, partial(_skewed, facts.weighed)), rigid_content=content)


def _skewed(keeps_mass: bool, state: PlateState, values: Values) -> PlateState:
    skew = np.deg2rad(1.0) * np.asarray(values["skew_deg"])
    density = state.density / np.cos(skew) if keeps_mass else state.density
    return replace(state, skew=skew, density=density)


# Membrane strains that an initial deflection w0 adds, eps' = w0,x w,x and so on: row, atom of w, weight along
# x and along y, axis of the derivative of w0. Its slopes are -4 sag_x s_x / a and -4 sag_y s_y / b.
_SLOPES = (
    (0, Atom("w", "x"), (LINE, ONE), "x"),
    (1, Atom("w", "y"), (ONE, LINE), "y"),
    (2, Atom("w", "y"), (LINE, ONE), "x"),
    (2, Atom("w", "x"), (ONE, LINE), "y"),
)


def _times(a: Polynomial, b: Polynomial) -> Polynomial:
    return Polynomial(tuple(polynomial.polymul(np.array(a.coefficients), np.array(b.coefficients)).tolist()))


def _warp(problem: Problem, facts: PlateFacts) -> Problem:
    """A shallow shell, w0 = sag_x (1 - s_x^2) + sag_y (1 - s_y^2).

    Its curvatures are 8 sag_x / a^2 and 8 sag_y / b^2, with sag_x = 2^1/2 sag cos(direction) and
    sag_y = 2^1/2 sag sin(direction), whose root mean square is the sag: at 45 deg it is a cap, at 0 deg and
    90 deg a cylinder, at -45 deg and 135 deg a saddle.

    Marguerre's theory: eps_x += w0,x w,x, eps_y += w0,y w,y, gamma_xy += w0,x w,y + w0,y w,x (Proc. 5th
    Int. Congr. Appl. Mech., 1938).
    """
    del facts
    forms: list[Form] = []
    # (row, row, powers of 1/a and 1/b, factor, powers of sag_x and sag_y)
    table: list[tuple[int, int, Array, float, Array]] = []

    def slope(atom: Atom, along: str) -> Array:
        """Powers of 1/a and 1/b in an added strain: a derivative of w0 times one of w."""
        return _counted(atom.derivative, along)

    for i, row in enumerate(STRAIN_ATOMS[:6]):
        for atom, size in row:
            plain = np.array([size == "length", size == "width"], dtype=float)
            for j, added, weight, along in _SLOPES:
                forms.append(Form(atom, added, weight=Product(*weight)))
                table.append((i, j, plain + slope(added, along), -4.0, _counted(along)))
    for m, (i, left, w_left, along_left) in enumerate(_SLOPES):
        for n, (j, right, w_right, along_right) in enumerate(_SLOPES[m:], start=m):
            square = Product(_times(w_left[0], w_right[0]), _times(w_left[1], w_right[1]))
            twice = 2.0 if m != n and left == right else 1.0
            forms.append(Form(left, right, weight=square))
            sides = slope(left, along_left) + slope(right, along_right)
            table.append((i, j, sides, 16.0 * twice, _counted(along_left, along_right)))
    rows, columns = np.array([r[0] for r in table]), np.array([r[1] for r in table])
    sides = np.array([r[2] for r in table])
    factor, sags = np.array([r[3] for r in table]), np.array([r[4] for r in table])
    coefficients = partial(_warp_coefficients, rows, columns, sides, factor, sags)
    # rigid tilting has w = x or y, with the u and v that keep the cap from stretching
    squares: tuple[Field, ...] = ("u", "v")
    tilting = tuple((field, powers) for field in squares for powers in ((2, 0), (0, 2)))
    warped = replace(problem, rigid_content=problem.rigid_content + tilting)
    return warped.with_terms(Term("warp", "stiffness", tuple(forms), coefficients))


def _counted(*axes: str) -> Array:
    """Counts (2,) of x and of y among some axes, integers: a negative sag has no other powers."""
    return np.array([axes.count("x"), axes.count("y")])


def _warp_coefficients(
    rows: Array, columns: Array, sides: Array, factor: Array, sags: Array, state: PlateState, values: Values
) -> Array:
    length, width = np.asarray(state.length)[..., None], np.asarray(state.width)[..., None]
    sag, direction = np.asarray(values["sag"]), np.deg2rad(1.0) * np.asarray(values["sag_direction_deg"])
    along_x, along_y = (np.sqrt(2.0) * sag * turned(direction) for turned in (np.cos, np.sin))
    scale = factor * length ** (1.0 - sides[:, 0]) * width ** (1.0 - sides[:, 1])
    # integer powers: a negative sag has no other
    scale = (
        scale * along_x[..., None] ** sags[:, 0].astype(int) * along_y[..., None] ** sags[:, 1].astype(int)
    )
    return np.asarray(state.stiffness()[..., rows, columns] * scale)


def _tapered(name: str, axis: str, side: str) -> Effect:
    return Effect(
        name=name,
        title=f"thickness taper along {axis}",
        family="shape",
        belongs_to="plate",
        parameters=(either_sign(name, "", 0.03, 0.6, gross=EVEN, shown=PERCENT),),
        note=f"h (1 + t s), s from -1 to 1; of first order where edges {axis} = 0 and {axis} = {side} differ",
        check=f"Gauge the thickness at both ends in {axis}.",
        change=partial(_taper, name, axis),
        even=True,
    )


def _edges_may_lean(facts: PlateFacts) -> bool:
    return not any(edge.follows_axis for edge in conditions(facts.edges))


TAPER_X = _tapered("taper_x", "x", "length")
TAPER_Y = _tapered("taper_y", "y", "width")
SKEW = Effect(
    name="skew",
    title="corners not square",
    family="shape",
    belongs_to="plate",
    parameters=(either_sign("skew_deg", "deg", 1.0, 20.0, gross=EVEN),),
    note="gradients of a parallelogram; the plies stay along x",
    check="Measure both diagonals.",
    change=_skew,
    applies_to=_edges_may_lean,
    even=True,
    drawn="corners",
)
WARP = Effect(
    name="warp",
    title="plate not flat",
    family="shape",
    belongs_to="plate",
    parameters=(
        either_sign("sag", "m", 0.5e-3, 8e-3, gross=EVEN, shown=MILLIMETRE),
        Parameter("sag_direction_deg", "deg", Uniform(-45.0, 135.0), 45.0),
    ),
    note="shallow shell, kappa = 8 s_x / a^2, 8 s_y / b^2, s^2 = (s_x^2 + s_y^2) / 2: bending stretches it",
    check="Lay the plate on a surface plate and gauge its sag along both sides.",
    directions=("sag_direction_deg",),
    change=_warp,
    size_factor=per_thickness,
    even=True,
    couples_stretching=True,
)


# Sides of the square over the shorter side of the plate: each also covers cuts down to 0.6 of it.
_CUTS = (0.06, 0.10, 0.16, 0.25)
_CORNERS = ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0), (0.0, 0.0))


def _cut(place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    """K and M minus those of a square at a corner, times the share of it that is missing.

    A smaller cut of any outline acts as a part of the square does; the whole square leaves the stiffness and
    mass of the rest. A weighed plate keeps its mass.
    """
    x, y, extent = place
    side = extent * min(facts.length, facts.width)
    weight = Product(Box(x, side / facts.length), Box(y, side / facts.width))
    share = side**2 / (facts.length * facts.width)
    parts: tuple[tuple[MatrixKind, tuple[Form, ...], CoefficientFunction], ...] = (
        ("stiffness", LAMINATE_FORMS, laminate_coefficients),
        ("mass", MASS_FORMS, inertia_coefficients),
    )
    changed = with_state(problem, _without_corner) if facts.weighed else problem
    for kind, forms, plain in parts:
        there = tuple(replace(form, weight=weight) for form in forms)
        changed = changed.with_terms(Term("outline", kind, there, partial(_lacking, share, plain)))
    return changed


def _lacking(share: float, plain: CoefficientFunction, state: PlateState, values: Values) -> Array:
    missing = np.asarray(values["missing_area"])[..., None] / share
    return np.asarray(-missing * plain(state, values))


def _without_corner(state: PlateState, values: Values) -> PlateState:
    return replace(state, density=state.density / (1.0 - np.asarray(values["missing_area"])))


def _share(extent: float, facts: PlateFacts) -> float:
    """Area of the square over the plate's, minus one hundredth of it: the plate stays one piece."""
    return 0.99 * extent**2 * min(facts.length, facts.width) / max(facts.length, facts.width)


def corner_images(corner: Place, facts: PlateFacts) -> tuple[Place, ...]:
    """A corner (x, y), each 0 or 1, and those that no frequency distinguishes from it."""
    x, y = corner[:2]
    in_x, in_y, turned = symmetries(facts)
    ways = ((in_x, (1.0 - x, y)), (in_y, (x, 1.0 - y)), (turned, (1.0 - x, 1.0 - y)))
    return ((x, y), *(image for alike, image in ways if alike))


def _may_lack(corner: Place, facts: PlateFacts) -> bool:
    """Whether both edges at a corner are free, and it is the first of its images."""
    x0, y0, x1, y1 = conditions(facts.edges)
    is_free = (x1 if corner[0] else x0).is_free and (y1 if corner[1] else y0).is_free
    return is_free and corner == min(corner_images(corner, facts), key=_CORNERS.index)


_OUTLINES = tuple(
    Effect(
        name="outline",
        title="corner missing",
        family="shape",
        belongs_to="plate",
        parameters=(Parameter("missing_area", "", Uniform(0.0, 1.0), 0.0, ("% of the area", 100.0)),),
        note="K and M without a part of a square at a free corner, of 6, 10, 16 or 25 % of the shorter side",
        check="Look at the corners for a piece that is cut or broken off.",
        change=partial(_cut, (*corner, extent)),
        applies_to=partial(_may_lack, corner),
        size_factor=partial(_share, extent),
        place=(*corner, extent),
        variant=(
            f"at x = {'length' if corner[0] else '0'}, y = {'width' if corner[1] else '0'}, "
            f"within {100.0 * extent:.0f} % of the shorter side"
        ),
        drawn="corner",
        form_error=0.23,
    )
    for corner in _CORNERS
    for extent in _CUTS
)
OUTLINE = replace(_OUTLINES[0], alternatives=_OUTLINES[1:])
