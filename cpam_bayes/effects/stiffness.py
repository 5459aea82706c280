"""Stiffness that the layup does not have as computed: transverse shear, G13, resin at the faces."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import (
    MICROMETRE,
    PERCENT,
    Effect,
    PlateFacts,
    either_sign,
    one_sided,
    per_thickness,
    with_state,
)
from cpam_bayes.mechanics.problem import Array, PlateState, Problem, Values
from cpam_bayes.plate.laminate import SHEAR, reduced_stiffness, thickness_powers

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
    """G13 (1 + r)."""
    del facts
    return with_state(problem, _of_other_g13)


def _of_other_g13(state: PlateState, values: Values) -> PlateState:
    g13 = np.asarray(state.constants["G13"]) * (1.0 + values["shear_ratio_deviation"])
    return replace(state, constants={**state.constants, "G13": g13})


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
    title="transverse shear stiffness other than computed",
    family="stiffness",
    belongs_to="material",
    parameters=(either_sign("log_shear_factor", "", 0.3, 2.4, gross=0.8),),
    note="A_s exp(t): nothing on thin plates, the higher modes of thick ones",
    check="Measure further, higher modes; they depend on it most.",
    change=_transverse_shear,
    sign=1,
)
SHEAR_RATIO = Effect(
    name="shear_ratio",
    title="shear modulus G13 other than assumed",
    family="stiffness",
    belongs_to="material",
    parameters=(either_sign("shear_ratio_deviation", "", 0.25, (-0.8, 2.0), gross=0.5, shown=PERCENT),),
    note="G13 (1 + r), which is G12 unless given",
    check="Look up G13 of the material, or test a short beam.",
    change=_shear_ratio,
    applies_to=_is_composite,
    sign=1,
)
RESIN_SKIN = Effect(
    name="resin_skin",
    title="layers of resin on the faces",
    family="stiffness",
    belongs_to="plate",
    parameters=(one_sided("skin_thickness", "m", 50e-6, 400e-6, shown=MICROMETRE),),
    note="plies fill h - 2 t, cured epoxy the rest: all bending modes fall alike, the constants absorb it",
    check="Examine a micrograph of the cross-section.",
    change=_resin_skin,
    applies_to=_is_composite,
    size_factor=per_thickness,
    sign=-1,
)
