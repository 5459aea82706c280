"""Fuzzy particle swarm for ply angles beside the continuous one for constants, section 3, eq. (3) to (5).

The memberships X and their velocities V of one particle are the matrices of eq. (3) and (4): a column
for each unknown ply, a row for each angle of the grid (10). They are held here as arrays of shape
``(particles, plies, angles)``, so that a column of the paper is the last axis. The constants of a
particle move by eq. (1) and (2). Both have one personal best, the position of the smallest value, and
one leader.

The paper leaves open how a matrix becomes a sequence, where the fuzzy swarm starts and what is done
with a column that has lost all its members. H. Liu, A. Abraham and A. E. Hassanien (Future Generation
Computer Systems 26, 2010, 1336-1343), whose scheduling problem section 3 describes, take the row of
the largest membership and draw an empty column anew; both are done here. The start is drawn uniformly
and at rest, as the constants are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.swarm.pso import confine
from cpam_bayes.inference.swarm.settings import TEXTS, Feasible, FloatArray, Status, SwarmSettings

__all__ = [
    "FuzzyProblem",
    "FuzzyResult",
    "FuzzyState",
    "decode",
    "fuzzy_stop_reason",
    "minimise_fuzzy",
    "normalised",
    "start_fuzzy",
    "step_fuzzy",
]

IndexArray: TypeAlias = NDArray[np.int64]
SequenceObjective: TypeAlias = Callable[[FloatArray, IndexArray], FloatArray]

_MAJORITY: Final = 0.9
"""Share of the particles that have to agree, as in the continuous swarm."""

_FLOOR: Final = 1e-6
"""Share of the start's best value that an improvement is measured against, beside the best value."""

_ENDS: Final = {
    "converged": (
        "the fuzzy swarm converged after {iterations} iterations: {agreeing} of its {particles} particles "
        "agree on the sequence and on the constants"
    ),
    "budget": (
        "the fuzzy swarm used its budget of {iterations} iterations before it converged: {agreeing} of its "
        "{particles} particles agree on the sequence and on the constants; allow more iterations, or "
        "more particles"
    ),
}


@dataclass(frozen=True, slots=True)
class FuzzyProblem:
    """What is minimised over constants in a box and sequences on a grid.

    objective : constants (m, n_constants), grid indices (m, n_plies) -> (m,), called with feasible
    particles only. feasible : (m, n_constants) -> (m,) bool. lower, upper : (n_constants,) bounds.
    n_plies, n_angles : unknown plies and angles of the grid.

    Raises ``ValueError`` if bounds are not finite or not in order, or without a ply or an angle.
    """

    objective: SequenceObjective
    feasible: Feasible
    lower: FloatArray
    upper: FloatArray
    n_plies: int
    n_angles: int

    def __post_init__(self) -> None:
        for index, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise ValueError(TEXTS["bounds"].format(index=index, low=float(low), high=float(high)))
        if self.n_plies < 1 or self.n_angles < 1:
            raise ValueError(
                f"fuzzy swarm: received {self.n_plies} unknown plies and a grid of {self.n_angles} angles, "
                "accepted: 1 or more of each"
            )


@dataclass(frozen=True, slots=True)
class FuzzyState:
    """The swarm between two iterations; arrays begin with (particles, ...).

    constants, velocities : (..., n_constants), x and v of eq. (1) and (2). memberships, drifts :
    (..., n_plies, n_angles), X and V of eq. (5). best_constants, best_memberships : personal bests.
    best_values : (particles,), infinite for a particle that never was feasible. history : best value
    after the start and after each iteration. evaluations : particles sent to the objective until now.
    """

    constants: FloatArray
    velocities: FloatArray
    memberships: FloatArray
    drifts: FloatArray
    best_constants: FloatArray
    best_memberships: FloatArray
    best_values: FloatArray
    history: tuple[float, ...]
    evaluations: int

    @property
    def leader(self) -> int:
        """Index of the particle that holds the best position of the swarm."""
        return int(np.argmin(self.best_values))


@dataclass(frozen=True, slots=True)
class FuzzyResult:
    """What the swarm found, and how it ended.

    constants : (n_constants,) and sequence : (n_plies,) grid indices of the smallest value.
    personal_constants, personal_sequences, personal_values : each particle's best. iterations : done
    after the start. evaluations : forward solves; infeasible particles cost none. history :
    (iterations + 1,) best value so far. agreeing : particles whose best is the leader's.
    """

    constants: FloatArray = field(repr=False)
    sequence: IndexArray
    value: float
    personal_constants: FloatArray = field(repr=False)
    personal_sequences: IndexArray = field(repr=False)
    personal_values: FloatArray = field(repr=False)
    iterations: int
    evaluations: int
    agreeing: int
    status: Status
    history: FloatArray = field(repr=False)
    message: str


def decode(memberships: FloatArray) -> IndexArray:
    """Sequences of fuzzy matrices: of each ply the angle of the largest membership.

    memberships : (..., n_plies, n_angles) -> (..., n_plies) grid indices.
    """
    return np.asarray(np.argmax(memberships, axis=-1), dtype=np.int64)


def normalised(memberships: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Memberships made lawful as section 3 says: none negative, those of one ply summing to 1.

    A ply without any positive membership gets uniform random ones, see the module's text.

    memberships : (..., n_plies, n_angles), any real numbers.
    """
    positive = np.maximum(memberships, 0.0)
    total = positive.sum(axis=-1, keepdims=True)
    empty = ~(total[..., 0] > 0.0)
    if empty.any():
        # 1 - [0, 1): never all zero
        positive[empty] = 1.0 - rng.random((int(empty.sum()), memberships.shape[-1]))
        total = positive.sum(axis=-1, keepdims=True)
    return np.asarray(positive / total)


def start_fuzzy(problem: FuzzyProblem, start: FloatArray, rng: np.random.Generator) -> FuzzyState:
    """Evaluate start constants beside uniformly drawn memberships, all at rest.

    start : (particles, n_constants), inside the bounds, for instance of ``initial_swarm``.

    Raises ``ValueError`` if the start does not fit the bounds, or if no particle is feasible with a
    finite value.
    """
    constants = np.array(start, dtype=np.float64)
    size = problem.lower.size
    if constants.ndim != 2 or constants.shape[0] < 1 or constants.shape[1] != size:
        raise ValueError(TEXTS["start shape"].format(shape=constants.shape, size=size))
    outside = ~np.all((constants >= problem.lower) & (constants <= problem.upper), axis=1)
    if outside.any():
        raise ValueError(TEXTS["start bounds"].format(index=int(np.argmax(outside))))
    shape = (len(constants), problem.n_plies, problem.n_angles)
    memberships = normalised(1.0 - rng.random(shape), rng)
    values, solves = _evaluate(problem, constants, memberships)
    if not np.isfinite(values).any():
        reason = "nothing finite" if solves else "nothing feasible"
        raise ValueError(TEXTS[reason].format(particles=solves or len(constants)))
    return FuzzyState(
        constants=constants,
        velocities=np.zeros_like(constants),
        memberships=memberships,
        drifts=np.zeros_like(memberships),
        best_constants=constants,
        best_memberships=memberships,
        best_values=values,
        history=(float(values.min()),),
        evaluations=solves,
    )


def step_fuzzy(
    problem: FuzzyProblem, state: FuzzyState, settings: SwarmSettings, rng: np.random.Generator
) -> FuzzyState:
    """Move every particle once, eq. (1), (2) and (5), and evaluate the feasible ones.

    V <- w V + c1 R1 (P_i - X) + c2 R2 (P_g - X) and X <- X + V, element by element, then
    ``normalised``; the constants likewise, then ``confine``. Drawn in the order r1, r2, R1, R2.
    """

    def moved(x: FloatArray, v: FloatArray, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        r1, r2 = rng.random(x.shape), rng.random(x.shape)
        v = settings.inertia * v + settings.c1 * r1 * (own - x) + settings.c2 * r2 * (own[state.leader] - x)
        return x + v, v

    constants, velocities = moved(state.constants, state.velocities, state.best_constants)
    constants, velocities = confine(constants, velocities, problem.lower, problem.upper)
    memberships, drifts = moved(state.memberships, state.drifts, state.best_memberships)
    memberships = normalised(memberships, rng)
    values, solves = _evaluate(problem, constants, memberships)
    better = values < state.best_values
    best_values = np.where(better, values, state.best_values)
    return FuzzyState(
        constants=constants,
        velocities=velocities,
        memberships=memberships,
        drifts=drifts,
        best_constants=np.where(better[:, None], constants, state.best_constants),
        best_memberships=np.where(better[:, None, None], memberships, state.best_memberships),
        best_values=best_values,
        history=(*state.history, float(best_values.min())),
        evaluations=state.evaluations + solves,
    )


def fuzzy_stop_reason(problem: FuzzyProblem, state: FuzzyState, settings: SwarmSettings) -> Status | None:
    """Say why the swarm stops here, or None if it goes on.

    Converged: nine in ten personal bests have the leader's sequence and its constants to
    ``spread_tolerance`` of the bounds, and the best value improved by no more than ``value_tolerance``
    over the last ``patience`` iterations.
    """
    done = len(state.history) - 1
    if done >= settings.patience:
        best = state.history[-1]
        scale = abs(best) + _FLOOR * abs(state.history[0])
        settled = state.history[-1 - settings.patience] - best <= settings.value_tolerance * scale
        if settled and _agreeing(problem, state, settings) >= _MAJORITY * len(state.best_values):
            return "converged"
    return "budget" if done >= settings.iterations else None


def minimise_fuzzy(
    problem: FuzzyProblem,
    start: FloatArray,
    settings: SwarmSettings,
    rng: np.random.Generator,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> FuzzyResult:
    """Minimise a function of constants and a sequence by a fuzzy particle swarm, eq. (1), (2) and (5).

    Particles that are not feasible, or whose objective is not finite, get an infinite value, the
    penalty of section 5.2. The swarm stops when it converged or when its budget is used, and says
    which.

    start : (particles, n_constants), sets the swarm's size; ``settings.particles`` is not read here.
    progress : called with the iteration and the best value, the start first.

    Raises ``ValueError`` if start or a returned array do not fit, or if no particle of the start is
    feasible with a finite value.
    """
    state = start_fuzzy(problem, start, rng)
    status: Status | None = None
    while True:
        if progress is not None:
            progress(len(state.history) - 1, state.history[-1])
        status = fuzzy_stop_reason(problem, state, settings)
        if status is not None:
            return _result(problem, state, settings, status)
        state = step_fuzzy(problem, state, settings, rng)


def _agreeing(problem: FuzzyProblem, state: FuzzyState, settings: SwarmSettings) -> int:
    sequences = decode(state.best_memberships)
    away = np.abs(state.best_constants - state.best_constants[state.leader])
    near = np.all(away <= settings.spread_tolerance * (problem.upper - problem.lower), axis=1)
    return int(np.sum(near & np.all(sequences == sequences[state.leader], axis=1)))


def _result(problem: FuzzyProblem, state: FuzzyState, settings: SwarmSettings, status: Status) -> FuzzyResult:
    iterations = len(state.history) - 1
    sequences = decode(state.best_memberships)
    agreeing = _agreeing(problem, state, settings)
    message = _ENDS[status].format(iterations=iterations, agreeing=agreeing, particles=len(state.best_values))
    return FuzzyResult(
        constants=_read_only(state.best_constants[state.leader]),
        sequence=_read_only(sequences[state.leader]),
        value=state.history[-1],
        personal_constants=_read_only(state.best_constants),
        personal_sequences=_read_only(sequences),
        personal_values=_read_only(state.best_values),
        iterations=iterations,
        evaluations=state.evaluations,
        agreeing=agreeing,
        status=status,
        history=_read_only(np.array(state.history)),
        message=message,
    )


def _evaluate(
    problem: FuzzyProblem, constants: FloatArray, memberships: FloatArray
) -> tuple[FloatArray, int]:
    """The values, infinite where infeasible or not finite, and the number of solves."""
    n = len(constants)
    allowed = np.asarray(problem.feasible(constants), dtype=np.bool_)
    _require_shape("feasible", allowed.shape, n)
    values = np.full(n, np.inf)
    solves = int(allowed.sum())
    if solves:
        reply = problem.objective(constants[allowed], decode(memberships[allowed]))
        reply = np.asarray(reply, dtype=np.float64)
        _require_shape("objective", reply.shape, solves)
        values[allowed] = np.where(np.isfinite(reply), reply, np.inf)
    return values, solves


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def _require_shape(source: str, shape: tuple[int, ...], n: int) -> None:
    if shape != (n,):
        raise ValueError(TEXTS["reply shape"].format(source=source, shape=shape, particles=n, expected=(n,)))
