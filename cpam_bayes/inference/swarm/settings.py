"""Settings of a particle swarm, and the texts of all that can happen to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IndexArray: TypeAlias = NDArray[np.int64]
Objective: TypeAlias = Callable[[FloatArray], FloatArray]
SequenceObjective: TypeAlias = Callable[[FloatArray, IndexArray], FloatArray]
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
    "fuzzy converged": (
        "the fuzzy swarm converged after {iterations} iterations: {agreeing} of its {particles} particles "
        "agree on the sequence and on the constants"
    ),
    "fuzzy budget": (
        "the fuzzy swarm used its budget of {iterations} iterations before it converged: {agreeing} of its "
        "{particles} particles agree on the sequence and on the constants; allow more iterations, or "
        "more particles"
    ),
    "no grid": (
        "fuzzy swarm: received {n_plies} unknown plies and a grid of {n_angles} angles, "
        "accepted: 1 or more of each"
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

    Raises ``ValueError`` if a setting is out of its range.
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


def _require(name: str, value: float, accepted: bool, rule: str) -> None:
    if not accepted:
        raise ValueError(TEXTS["setting"].format(name=name, value=value, rule=rule))
