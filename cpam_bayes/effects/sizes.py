"""Sizes, thickness and density that differ from those stated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from cpam_bayes.effects.effect import Effect, PlateFacts, either_sign, with_state
from cpam_bayes.mechanics.problem import PlateState, Problem, Values


def _scaled(size: str, parameter: str) -> Callable[[Problem, PlateFacts], Problem]:
    """One of the plate's numbers times 1 + its relative deviation."""

    def change(problem: Problem, facts: PlateFacts) -> Problem:
        del facts
        return with_state(problem, partial(_scaled_size, size, parameter))

    return change


def _scaled_size(size: str, parameter: str, state: PlateState, values: Values) -> PlateState:
    return replace(state, **{size: getattr(state, size) * (1.0 + values[parameter])})


def _relative(name: str, sd: float, note: str) -> Effect:
    parameter = f"{name}_deviation"
    return Effect(
        name,
        "size",
        "coefficients",
        (either_sign(parameter, "", sd),),
        note,
        _scaled(name, parameter),
        absorbed=name in ("thickness", "density"),
    )


THICKNESS = _relative("thickness", 0.01, "every thin-plate frequency grows with h; as stiffer moduli would")
DENSITY = _relative("density", 0.01, "every frequency falls with rho^-1/2; as softer moduli would")
LENGTH = _relative("length", 0.002, "a (1 + deviation)")
WIDTH = _relative("width", 0.002, "b (1 + deviation)")


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
    "clamp_length",
    "clamp",
    "coefficients",
    (either_sign("clamp_shift", "m", 0.5e-3),),
    "the clamp grips further out or in than measured: a longer or shorter cantilever",
    _clamp_length,
    applies_to=_is_clamped,
)
