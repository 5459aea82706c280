"""Settings, state and result of a particle swarm, and the texts of all that can happen to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
Objective: TypeAlias = Callable[[FloatArray], FloatArray]
Feasible: TypeAlias = Callable[[FloatArray], BoolArray]
Status: TypeAlias = Literal["converged", "budget"]

TEXTS: Final[Mapping[str, str]] = {
    "converged": (
        "the swarm converged after {iterations} iterations: nine in ten of its particles agree "
        "to {spread:.1g} of the distance of the search bounds"
    ),
    "budget": (
        "the swarm used its budget of {iterations} iterations before it converged: nine in ten "
        "of its particles agree to no more than {spread:.1g} of the distance of the search "
        "bounds; allow more iterations or narrow the bounds"
    ),
    "nothing feasible": (
        "no feasible particle among the {particles} of the initial swarm: each violates a "
        "constraint of eq. (9); widen or move the search bounds"
    ),
    "nothing finite": (
        "none of the {particles} feasible particles of the initial swarm has a finite objective; "
        "the forward model fails over the whole search box, check the plate and the bounds"
    ),
    "empty range": (
        "no start value for {name}: the bounds and eq. (9) leave {low:g} to {high:g}, which is "
        "empty; widen the search bounds of the constants"
    ),
    "no particle": "a swarm needs at least one particle, got {particles}",
    "bounds": (
        "component {index}: the lower bound {low!r} and the upper bound {high!r} must be finite, "
        "and the lower one below the upper one"
    ),
    "start shape": ("the start has shape {shape}; one row a particle and {size} components are expected"),
    "start bounds": "particle {index} of the start lies outside the bounds or is not finite",
    "reply shape": "{source} returned shape {shape} for {particles} particles, expected {expected}",
    "setting": "{name} = {value!r} is not accepted: it must be {rule}",
}
"""All texts, by what happened."""


@dataclass(frozen=True, slots=True)
class SwarmSettings:
    """Numerical settings of the swarm; the sources are named in `cpam_bayes.inference.swarm.pso`.

    Attributes
    ----------
    particles : m of the paper, number of particles
    iterations : N of the paper, the budget
    inertia : w of eq. (1)
    c1 : weight of a particle's own best in eq. (1)
    c2 : weight of the swarm's best in eq. (1)
    spread_tolerance : largest spread of the particles' best positions, see `swarm_spread`, that
        counts as converged
    value_tolerance : largest relative improvement of the best value over `patience` iterations
        that counts as converged
    patience : iterations over which the improvement is measured

    Raises
    ------
    ValueError
        If a setting is out of its range.
    """

    particles: int = 40
    iterations: int = 400
    inertia: float = 0.7298
    c1: float = 1.49618
    c2: float = 1.49618
    spread_tolerance: float = 1e-3
    value_tolerance: float = 1e-6
    patience: int = 15

    def __post_init__(self) -> None:
        for name in ("particles", "iterations", "patience"):
            _require(name, getattr(self, name), getattr(self, name) >= 1, "1 or more")
        for name in ("inertia", "c1", "c2", "spread_tolerance", "value_tolerance"):
            value = getattr(self, name)
            _require(name, value, 0.0 <= value < np.inf, "finite and not negative")


@dataclass(frozen=True, slots=True)
class SwarmState:
    """The swarm between two iterations.

    Attributes
    ----------
    positions, velocities, personal_bests : (particles, components)
    personal_values : (particles,), infinite for a particle that never was feasible
    history : best value after the start and after each iteration
    evaluations : particles sent to the objective until now
    """

    positions: FloatArray
    velocities: FloatArray
    personal_bests: FloatArray
    personal_values: FloatArray
    history: tuple[float, ...]
    evaluations: int

    @property
    def leader(self) -> int:
        """Index of the particle that holds the best position of the swarm."""
        return int(np.argmin(self.personal_values))


@dataclass(frozen=True, slots=True)
class SwarmResult:
    """What the swarm found, and how it ended.

    Attributes
    ----------
    best : (components,) position of the smallest value
    value : the smallest value
    personal_bests : (particles, components), every particle's best position
    personal_values : (particles,), infinite for a particle that never was feasible
    iterations : iterations done after the start
    evaluations : forward solves; infeasible particles cost none
    status : "converged" or "budget"
    history : (iterations + 1,) best value so far, the start first
    message : the status in words
    """

    best: FloatArray = field(repr=False)
    value: float
    personal_bests: FloatArray = field(repr=False)
    personal_values: FloatArray = field(repr=False)
    iterations: int
    evaluations: int
    status: Status
    history: FloatArray = field(repr=False)
    message: str


@dataclass(frozen=True, slots=True)
class SwarmProblem:
    """What is minimised, and where.

    Attributes
    ----------
    objective : (m, components) -> (m,), called with feasible particles only
    feasible : (m, components) -> (m,) booleans
    lower, upper : (components,) bounds of the box

    Raises
    ------
    ValueError
        If the bounds are not finite or not in order.
    """

    objective: Objective
    feasible: Feasible
    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        for index, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                text = TEXTS["bounds"].format(index=index, low=float(low), high=float(high))
                raise ValueError(text)


def _require(name: str, value: float, accepted: bool, rule: str) -> None:
    if not accepted:
        raise ValueError(TEXTS["setting"].format(name=name, value=value, rule=rule))
