"""Sizes, thickness and density that differ from those stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Literal

from cpam_bayes.effects.effect import MILLIMETRE, PERCENT, Effect, PlateFacts, either_sign, with_state
from cpam_bayes.mechanics.problem import PlateState, Problem, Values
from cpam_bayes.parameters import Parameter


def _scaled(size: str, parameter: str) -> Callable[[Problem, PlateFacts], Problem]:
    """One of the plate's numbers times 1 + its relative deviation."""
    return partial(_with_scaled, size, parameter)


def _with_scaled(size: str, parameter: str, problem: Problem, facts: PlateFacts) -> Problem:
    del facts
    return with_state(problem, partial(_scaled_size, size, parameter))


def _scaled_size(size: str, parameter: str, state: PlateState, values: Values) -> PlateState:
    return replace(state, **{size: getattr(state, size) * (1.0 + values[parameter])})


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
    either_sign("thickness_deviation", "", 0.01, (-0.6, 1.5), gross=0.2, shown=PERCENT),
    title="thickness other than stated",
    note="h (1 + deviation): thin-plate frequencies grow with h, as with stiffer moduli",
    check="Gauge the thickness at ten points or more.",
    sign=1,
)
DENSITY = _relative(
    "density",
    either_sign("density_deviation", "", 0.01, (-0.8, 2.0), gross=0.2, shown=PERCENT),
    title="density other than stated",
    note="rho (1 + deviation): frequencies fall with rho^-1/2, as with softer moduli",
    check="Weigh the plate and state its mass.",
    sign=-1,
)
LENGTH = _relative(
    "length",
    either_sign("length_deviation", "", 0.002, 0.4, gross=0.05, shown=PERCENT),
    title="length other than stated",
    note="a (1 + deviation)",
    check="Measure the length along both edges.",
)
WIDTH = _relative(
    "width",
    either_sign("width_deviation", "", 0.002, 0.4, gross=0.05, shown=PERCENT),
    title="width other than stated",
    note="b (1 + deviation)",
    check="Measure the width along both edges.",
)


def _clamped_axes(facts: PlateFacts) -> tuple[str, ...]:
    ends = {"length": (facts.edges[0], facts.edges[2]), "width": (facts.edges[1], facts.edges[3])}
    return tuple(size for size, pair in ends.items() if "C" in pair)


def _clamp_length(problem: Problem, facts: PlateFacts) -> Problem:
    return with_state(problem, partial(_longer, _clamped_axes(facts)))


def _longer(sizes: tuple[str, ...], state: PlateState, values: Values) -> PlateState:
    return replace(state, **{size: getattr(state, size) + values["clamp_shift"] for size in sizes})


def _is_clamped(facts: PlateFacts) -> bool:
    return bool(_clamped_axes(facts))


CLAMP_LENGTH = Effect(
    name="clamp_length",
    title="free length other than stated",
    family="clamp",
    belongs_to="test",
    parameters=(either_sign("clamp_shift", "m", 0.5e-3, 40e-3, gross=5e-3, shown=MILLIMETRE),),
    note="a + delta, of the side across the clamp",
    check="Measure the free length from the jaws of the clamp.",
    change=_clamp_length,
    applies_to=_is_clamped,
    sign=-1,
)
