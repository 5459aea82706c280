"""Plies that do not lie as written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import EVEN, Effect, PlateFacts, either_sign, with_state
from cpam_bayes.mechanics.problem import Array, PlateState, Problem, Values
from cpam_bayes.plate.laminate import LaminateGeometry


def rotated(geometry: LaminateGeometry, angle_deg: Array) -> LaminateGeometry:
    """The layup with every ply turned by an angle (...), degrees.

    cos 2(t + a) = cos 2a cos 2t - sin 2a sin 2t and so on: all that a geometry holds is linear in the
    angle functions of its plies.
    """
    a = np.deg2rad(1.0) * np.asarray(angle_deg)
    turn = np.zeros((*a.shape, 5, 5), dtype=a.dtype)
    turn[..., 0, 0] = 1.0
    for k, (cosine, sine) in ((2, (1, 3)), (4, (2, 4))):
        turn[..., cosine, cosine] = turn[..., sine, sine] = np.cos(k * a)
        turn[..., sine, cosine] = np.sin(k * a)
        turn[..., cosine, sine] = -np.sin(k * a)

    def of_layup(functions: Array) -> Array:
        return np.asarray(np.einsum("...ij,...j->...i", turn, functions))

    def of_points(functions: Array) -> Array:
        return np.asarray(np.einsum("...ij,...pj->...pi", turn, functions))

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
    """The last but one before the midplane."""
    return n_plies // 2 - 2


MISORIENTATION = Effect(
    name="misorientation",
    title="plate cut at an angle to its plies",
    family="layup",
    belongs_to="plate",
    parameters=(either_sign("misorientation_deg", "deg", 2.0, 90.0, gross=EVEN),),
    note="all angles + alpha",
    check="Measure the angle between an edge and the fibres of a surface ply.",
    change=_misorientation,
    applies_to=_has_plies,
    even=True,
)
OUTER_PLY_ANGLE = Effect(
    name="outer_ply_angle",
    title="outermost plies laid at another angle",
    family="layup",
    belongs_to="plate",
    parameters=(either_sign("outer_ply_deg", "deg", 5.0, 90.0, gross=EVEN),),
    note="the outermost plies of both faces are turned by one angle",
    check="Measure the fibre angle on both faces, and compare the layup sheet.",
    change=partial(_ply_pair, "outer_ply_deg", _outermost),
    applies_to=_has_plies,
    even=True,
)
INNER_PLY_ANGLE = Effect(
    name="inner_ply_angle",
    title="inner plies laid at another angle",
    family="layup",
    belongs_to="plate",
    parameters=(either_sign("inner_ply_deg", "deg", 20.0, 90.0, gross=EVEN),),
    note="the second plies from the midplane are turned: bending hardly depends on them",
    check="Compare the layup sheet, or examine a micrograph of an offcut.",
    change=partial(_ply_pair, "inner_ply_deg", _inner),
    applies_to=_has_inner_plies,
    even=True,
)
