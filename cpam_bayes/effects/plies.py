"""Plies other than stated: turned, softened, damaged, under residual stress, or of another material."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import (
    EVEN,
    MEGAPASCAL,
    MICROMETRE,
    PERCENT,
    Effect,
    LocalForm,
    Place,
    PlateFacts,
    anywhere,
    coordinate,
    either_sign,
    one_sided,
    per_thickness,
    place_text,
    stacked,
    with_state,
)
from cpam_bayes.mechanics.affine import Bell, Box, Polynomial, Product
from cpam_bayes.mechanics.problem import (
    LAMINATE_ENTRIES,
    LAMINATE_FORMS,
    Array,
    Atom,
    Form,
    PlateState,
    Problem,
    StateFunction,
    Term,
    Values,
    laminate_coefficients,
)
from cpam_bayes.parameters import LogUniform, Parameter
from cpam_bayes.plate import split_name
from cpam_bayes.plate.laminate import SHEAR, LaminateGeometry, reduced_stiffness, thickness_powers

# Log of the factor within which transverse shear moduli of a composite differ from the assumed ones.
_FACTOR_TWO = float(np.log(2.0))


def rotated(geometry: LaminateGeometry, angle_deg: Array) -> LaminateGeometry:
    """The layup with every ply turned by an angle (...), degrees.

    cos 2(t + a) = cos 2a cos 2t - sin 2a sin 2t and so on: a geometry is linear in the angle functions of
    its plies.
    """
    a = np.deg2rad(1.0) * np.asarray(angle_deg)
    turn = np.zeros((*a.shape, 5, 5), dtype=a.dtype)
    turn[..., 0, 0] = 1.0
    for k, (cosine, sine) in ((2, (1, 3)), (4, (2, 4))):
        turn[..., cosine, cosine] = turn[..., sine, sine] = np.cos(k * a)
        turn[..., sine, cosine] = np.sin(k * a)
        turn[..., cosine, sine] = -np.sin(k * a)

    def of_layup(functions: Array) -> Array:
        """Turned functions (..., 5 n) of each material."""
        apart = functions.reshape(*functions.shape[:-1], -1, 5)
        turned = np.einsum("...ij,...mj->...mi", turn, apart)
        return np.asarray(turned.reshape(*turned.shape[:-2], -1))

    def of_points(functions: Array) -> Array:
        """Turned functions (..., n_points, 5 n)."""
        apart = functions.reshape(*functions.shape[:-1], -1, 5)
        turned = np.einsum("...ij,...pmj->...pmi", turn, apart)
        return np.asarray(turned.reshape(*turned.shape[:-2], -1))

    return replace(
        geometry,
        in_plane=of_layup(geometry.in_plane),
        coupling=of_layup(geometry.coupling),
        flexural=of_layup(geometry.flexural),
        ply=of_points(geometry.ply),
        first=of_points(geometry.first),
        zeroth=None if geometry.zeroth is None else of_points(geometry.zeroth),
    )


def _misorientation(problem: Problem, facts: PlateFacts) -> Problem:
    """All angles + alpha."""
    del facts
    return with_state(problem, _turned)


def _turned(state: PlateState, values: Values) -> PlateState:
    turn = np.asarray(values["misorientation_deg"])
    if isinstance(state.layup, LaminateGeometry):
        return replace(state, layup=rotated(state.layup, turn))
    return replace(state, layup=state.layup + turn[..., None])


def _ply_pair(parameter: str, which: Callable[[int], int], problem: Problem, facts: PlateFacts) -> Problem:
    """One ply and its mirror image about the midplane turned by one angle."""
    n = facts.layup.n_plies
    turned = np.zeros(n)
    turned[which(n)] = turned[n - 1 - which(n)] = 1.0
    return with_state(problem, partial(_pair_turned, parameter, facts.layup.angles_deg, turned))


def _pair_turned(
    parameter: str, angles_deg: Array, turned: Array, state: PlateState, values: Values
) -> PlateState:
    known = isinstance(state.layup, LaminateGeometry)
    angles = angles_deg if known else np.asarray(state.layup)
    return replace(state, layup=angles + np.asarray(values[parameter])[..., None] * turned)


def _has_plies(facts: PlateFacts) -> bool:
    return not facts.isotropic


def _has_inner_plies(facts: PlateFacts) -> bool:
    return not facts.isotropic and facts.layup.n_plies >= 4


def _outermost(n_plies: int) -> int:
    del n_plies
    return 0


def _inner(n_plies: int) -> int:
    """Index of the last ply but one before the midplane."""
    return n_plies // 2 - 2


MISORIENTATION = Effect(
    name="misorientation",
    title="plate cut off-axis",
    family="layup",
    belongs_to="plate",
    parameters=(either_sign("misorientation_deg", "deg", 2.0, 90.0, gross=EVEN),),
    note="all angles + alpha",
    check="Measure the angle between an edge and the fibres of a surface ply.",
    change=_misorientation,
    applies_to=_has_plies,
    even=True,
    drawn="plies",
)
OUTER_PLY_ANGLE = Effect(
    name="outer_ply_angle",
    title="misaligned outer plies",
    family="layup",
    belongs_to="plate",
    parameters=(either_sign("outer_ply_deg", "deg", 5.0, 90.0, gross=EVEN),),
    note="the outermost plies of both faces are turned by one angle",
    check="Measure the fibre angle on both faces, and compare the layup sheet.",
    change=partial(_ply_pair, "outer_ply_deg", _outermost),
    applies_to=_has_plies,
    even=True,
    drawn="plies",
)
INNER_PLY_ANGLE = Effect(
    name="inner_ply_angle",
    title="misaligned inner plies",
    family="layup",
    belongs_to="plate",
    parameters=(either_sign("inner_ply_deg", "deg", 20.0, 90.0, gross=EVEN),),
    note="the second plies from the midplane are turned: bending hardly depends on them",
    check="Compare the layup sheet, or examine a micrograph of an offcut.",
    change=partial(_ply_pair, "inner_ply_deg", _inner),
    applies_to=_has_inner_plies,
    even=True,
    drawn="plies",
)


# Extent over the shorter side: from a spot of a few thicknesses to two thirds of the plate.
_EXTENT = LogUniform(0.03, 0.35)
# Lost part of the stiffness: one standard deviation, and the largest with which the plate is one piece.
_SCALE, _DEEPEST = 0.2, 0.95
# Forms of bending and of transverse shear.
_SOFTENED = np.flatnonzero(LAMINATE_ENTRIES.min(axis=0) >= 3)


def _damage_at(form: LocalForm, place: Place) -> Effect:
    """The damage of one form at (x, y) with an extent."""
    return replace(
        DAMAGE,
        change=partial(_damaged, form, place),
        parameters=DAMAGE.parameters[:1],
        place=place,
        at=None,
        local=form,
        alternatives=(),
        variant=f"{_WORDS[form]} {place_text(place[:2])}, extent {place[2]:.3g}",
    )


def _damaged(form: LocalForm, place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    """D and A_s times 1 - d g(x, y).

    g is exp(-r^2 / (2 R^2)), r the distance from the place, or 1 in the square |x|, |y| <= R about it; R is
    the extent times the shorter side. Mass and membrane stiffness stay.
    """
    x, y, extent = place
    radius = extent * min(facts.length, facts.width)
    profile = Bell if form == "bell" else Box
    weight = Product(profile(x, radius / facts.length), profile(y, radius / facts.width))
    forms = tuple(replace(LAMINATE_FORMS[q], weight=weight) for q in _SOFTENED)
    return problem.with_terms(Term("damage", "stiffness", forms, _lost))


def _lost(state: PlateState, values: Values) -> Array:
    plain = laminate_coefficients(state, values)[..., _SOFTENED]
    return np.asarray(-np.asarray(values["damage"])[..., None] * plain)


_WORDS: dict[LocalForm, str] = {"bell": "smooth", "rectangle": "with a sharp edge"}

_BELL = Effect(
    name="damage",
    title="local damage",
    family="damage",
    belongs_to="plate",
    parameters=(
        one_sided("damage", "", _SCALE, _DEEPEST, shown=PERCENT),
        coordinate("damage_x"),
        coordinate("damage_y"),
        Parameter("damage_extent", "", _EXTENT, _EXTENT.mean, PERCENT),
    ),
    note=(
        "D and A_s less by a bell (extent: its sd) or in a square (extent: half its side) at any (x, y), "
        "of 3 to 35 % of the shorter side; both forms are equally probable"
    ),
    check="Tap or C-scan the plate there.",
    change=anywhere,
    sign=-1,
    at=partial(_damage_at, "bell"),
    local="bell",
    variant=_WORDS["bell"],
    form_error=0.07,
)
DAMAGE = replace(
    _BELL,
    alternatives=(
        replace(_BELL, at=partial(_damage_at, "rectangle"), local="rectangle", variant=_WORDS["rectangle"]),
    ),
)


# Cured epoxy: Daniel and Ishai, Engineering Mechanics of Composite Materials, table A.2.
_RESIN = {"E1": 3.5e9, "E2": 3.5e9, "nu12": 0.35, "G12": 3.5e9 / 2.7}


def _transverse_shear(problem: Problem, facts: PlateFacts) -> Problem:
    """A_s exp(t)."""
    del facts
    return with_state(problem, _of_other_shear)


def _of_other_shear(state: PlateState, values: Values) -> PlateState:
    factor = np.exp(np.asarray(values["log_shear_factor"]))[..., None, None]
    return replace(state, changes=(*state.changes, partial(_scaled_shear, factor)))


def _scaled_shear(factor: Array, stiffness: Array) -> Array:
    shape = np.broadcast_shapes(stiffness.shape, factor.shape)
    scaled = np.array(np.broadcast_to(stiffness, shape), dtype=np.result_type(stiffness, factor))
    scaled[..., SHEAR, SHEAR] *= factor
    return scaled


def _shear_ratio(problem: Problem, facts: PlateFacts) -> Problem:
    """G13 (1 + r), of each material."""
    del facts
    return with_state(problem, _of_other_g13)


def _of_other_g13(state: PlateState, values: Values) -> PlateState:
    factor = 1.0 + values["shear_ratio_deviation"]
    of_each = {
        name: np.asarray(value) * factor
        for name, value in state.constants.items()
        if split_name(name)[1] == "G13"
    }
    return replace(state, constants={**state.constants, **of_each})


def _resin_skin(problem: Problem, facts: PlateFacts) -> Problem:
    """The plies fill h - 2 t, pure resin the rest; h and the mass are as measured.

    A = A_plies + 2 t Q, D = D_plies + (h^3 - (h - 2 t)^3) / 12 Q with Q of the resin; the faces carry
    no transverse shear, A_s is that of the plies.
    """
    del facts
    return with_state(problem, _of_a_thinner_core)


def _of_a_thinner_core(state: PlateState, values: Values) -> PlateState:
    h = np.asarray(state.thickness)
    core = h - 2.0 * np.asarray(values["skin_thickness"])
    return replace(state, changes=(*state.changes, partial(_between_skins, h, core)))


def _between_skins(h: Array, core: Array, stiffness: Array) -> Array:
    q11, q12, q22, q66 = reduced_stiffness(_RESIN)
    q = np.array([[q11, q12, 0.0], [q12, q22, 0.0], [0.0, 0.0, q66]])
    sandwich = stiffness * thickness_powers(core / h)
    sandwich[..., :3, :3] += (h - core)[..., None, None] * q
    sandwich[..., 3:6, 3:6] += ((h**3 - core**3) / 12)[..., None, None] * q
    return np.asarray(sandwich)


def _is_composite(facts: PlateFacts) -> bool:
    return not facts.isotropic


TRANSVERSE_SHEAR = Effect(
    name="transverse_shear",
    title="transverse shear stiffness",
    family="stiffness",
    belongs_to="material",
    parameters=(either_sign("log_shear_factor", "", 0.3, _FACTOR_TWO),),
    note="A_s exp(t): nothing on thin plates, the higher modes of thick ones",
    check="Measure further, higher modes; they depend on it most.",
    change=_transverse_shear,
    sign=1,
)
SHEAR_RATIO = Effect(
    name="shear_ratio",
    title="shear modulus G13",
    family="stiffness",
    belongs_to="material",
    parameters=(either_sign("shear_ratio_deviation", "", 0.25, (-0.5, 1.0), shown=PERCENT),),
    note="G13 (1 + r), which is G12 unless given",
    check="Look up G13 of the material, or test a short beam.",
    change=_shear_ratio,
    applies_to=_is_composite,
    sign=1,
)
RESIN_SKIN = Effect(
    name="resin_skin",
    title="resin-rich faces",
    family="stiffness",
    belongs_to="plate",
    parameters=(one_sided("skin_thickness", "m", 50e-6, 400e-6, shown=MICROMETRE),),
    note="plies fill h - 2 t, cured epoxy the rest: all bending modes fall alike, the constants absorb it",
    check="Examine a micrograph of the cross-section.",
    change=_resin_skin,
    applies_to=_is_composite,
    size_factor=per_thickness,
    sign=-1,
    form_error=0.1,
)


def _has_references(facts: PlateFacts) -> bool:
    return facts.has_references


MATERIAL = Effect(
    name="material",
    title="different material",
    family="material",
    belongs_to="material",
    parameters=(),
    note="[material.sd] is dropped: of the constants only the search bounds of [unknowns] are known",
    check="Read the material's certificate again, or test a coupon in tension.",
    drops_references=True,
    applies_to=_has_references,
)


# g(s) = (1 - s^2)^2: it and its slope vanish at both ends, so that no edge carries load.
_G = Polynomial((1.0, 0.0, -2.0, 0.0, 1.0))
# Largest value of N_x per unit of F0 4 / b^2: g(0) g''(1).
_PEAK = 8.0
# Stresses at which a plate is taken for flat, in min(sqrt(D11 D22), 4 D66) / (h b^2) with b the shorter side:
# the 17 built-in plates buckle between -70 and -44 and above 82.
_LEAST, _MOST = -35.0, 65.0


def _membrane_stress(problem: Problem, facts: PlateFacts) -> Problem:
    """K += integral of grad w . N grad w with N of the Airy function F = F0 g(s_x) g(s_y).

    N_x = F,yy, N_y = F,xx, N_xy = -F,xy are in equilibrium with free edges; F0 gives max |N| / h the
    value of the parameter (Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, section 90).
    """
    del facts
    problem = replace(problem, admissible=partial(_unbuckled, problem.state, problem.admissible))
    first, second = _G.derivative(), _G.derivative(2)
    w_x, w_y = Atom("w", "x"), Atom("w", "y")
    forms = (
        Form(w_x, w_x, weight=Product(_G, second)),
        Form(w_y, w_y, weight=Product(second, _G)),
        Form(w_x, w_y, weight=Product(first, first)),
    )

    return problem.with_terms(Term("membrane_stress", "stiffness", forms, _stress_coefficients))


def _unbuckled(plate: StateFunction, admissible: Callable[[Values], Array], values: Values) -> Array:
    """True where the plate stays flat under the stress; beyond, it has another shape and frequencies."""
    state, stress = plate(values), np.real(values["residual_stress"])
    d = np.real(state.stiffness())
    a, b = np.real(state.length), np.real(state.width)
    bending = np.sqrt(d[..., 3, 3] * d[..., 4, 4])
    rigidity = np.minimum(bending, 4.0 * d[..., 5, 5]) / (np.real(state.thickness) * np.minimum(a, b) ** 2)
    return np.asarray(admissible(values) & (stress > _LEAST * rigidity) & (stress < _MOST * rigidity))


def _stress_coefficients(state: PlateState, values: Values) -> Array:
    a, b = np.asarray(state.length), np.asarray(state.width)
    # N_x and N_y are largest in the middle of the longer edges, N_xy is smaller anywhere
    shorter = np.where(np.real(a) < np.real(b), a, b)
    f0 = np.asarray(values["residual_stress"]) * state.thickness * shorter**2 / (4.0 * _PEAK)
    # d2/dy2 = 4/b^2 d2/ds2; (w,x)^2 = (1/a d/dxi)^2; area a b
    normal = f0 * 4.0 / (a * b)
    return stacked(normal, normal, -normal)


MEMBRANE_STRESS = Effect(
    name="membrane_stress",
    title="residual stress",
    family="stress",
    belongs_to="plate",
    parameters=(either_sign("residual_stress", "Pa", 0.3e6, 10e6, shown=MEGAPASCAL),),
    note="integral of grad w . N grad w, N from (1 - x^2)^2 (1 - y^2)^2 with max abs N / h given: "
    "raises some modes and lowers others",
    check="Measure again after annealing, or cut the plate and gauge the strain that this releases.",
    change=_membrane_stress,
)
