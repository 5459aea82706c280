"""Particle swarms for constants in a box and, beside them, ply angles on a grid: eq. (1) to (5).

Constants move by eq. (1) and (2), memberships of the ply angles by eq. (5); a swarm without unknown plies has
empty memberships and is the plain one. The objective is called once per iteration, on the feasible particles.

Memberships X and their velocities V, the matrices of eq. (3) and (4), are arrays ``(particles, plies,
angles)``: a column of the paper is the last axis. How a matrix becomes a sequence, and how a column that
has lost all its members is replaced, is as of H. Liu, A. Abraham and A. E. Hassanien (Future Generation
Computer Systems 26, 2010, 1336-1343): the row of the largest membership, and a column drawn anew.

The paper gives no settings. w = 0.7298 and c1 = c2 = 1.49618 are the inertia form of the constriction
coefficient with phi = 4.1 (M. Clerc, J. Kennedy, IEEE Trans. Evol. Comput. 6, 2002, 58-73; R. C. Eberhart,
Y. Shi, Proc. CEC 2000, 84-88). Swarms of 20 to 100 particles differ little (D. Bratton, J. Kennedy, Proc.
IEEE Swarm Intelligence Symposium 2007, 120-127); 40 is that of the standard swarm of 2011 (M. Clerc, Standard
particle swarm optimisation, 2012), as is what happens at a bound (`confine`; compared by S. Helwig, J.
Branke, S. Mostaghim, IEEE Trans. Evol. Comput. 17, 2013, 259-271). Velocities start at zero (A. Engelbrecht,
Proc. IEEE Swarm Intelligence Symposium 2012).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias

import numpy as np

from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Hybrid, Material, joined_name, split_name
from cpam_bayes.plate.laminate import MaterialSymmetry
from cpam_bayes.running import cut_short, is_time_up

Objective: TypeAlias = Callable[[Array], Array]
SequenceObjective: TypeAlias = Callable[[Array, Array], Array]
Feasible: TypeAlias = Callable[[Array], Array]
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
    "setting": "{name} = {value!r} is not accepted: it must be {rule}",
}
"""All message texts by event."""


@dataclass(frozen=True, slots=True)
class SwarmSettings:
    """Numerical settings of the swarm; `cpam_bayes.inference.swarm` names their sources.

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


def decode(memberships: Array) -> Array:
    """Sequences from fuzzy matrices: for each ply the angle of the largest membership.

    memberships : (..., n_plies, n_angles) -> (..., n_plies) grid indices.
    """
    return np.asarray(np.argmax(memberships, axis=-1), dtype=np.int64)


def normalised(memberships: Array, rng: np.random.Generator) -> Array:
    """Memberships normalised as in section 3: none negative, those of one ply summing to 1.

    A ply without any positive membership gets uniform random ones, see the module's docstring.

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


_BOUNCE: Final = -0.5
"""Factor on the velocity of a component that was stopped at a bound (Clerc 2012)."""

_MAJORITY: Final = 0.9
"""Fraction of the particles that must agree."""

_FLOOR: Final = 1e-6
"""Fraction of the start's best value that is added to the best value as the reference of an improvement.

Without it a misfit that goes to zero would improve by the same factor for ever.
"""


@dataclass(frozen=True, slots=True)
class SwarmProblem:
    """An objective over constants in a box and, if there are unknown plies, sequences on a grid.

    objective : constants (m, n_constants), grid indices (m, n_plies) -> (m,), called with feasible particles
    only.
    feasible : (m, n_constants) -> (m,) bool.
    lower, upper : (n_constants,) bounds, finite.
    n_plies, n_angles : unknown plies and angles of the grid, 0 of both for constants alone.
    """

    objective: SequenceObjective
    feasible: Feasible
    lower: Array
    upper: Array
    n_plies: int = 0
    n_angles: int = 0


@dataclass(frozen=True, slots=True)
class SwarmState:
    """The swarm between two iterations; arrays begin with (particles, ...).

    positions, velocities : (..., n_constants), x and v of eq. (1) and (2).
    memberships, drifts : (..., n_plies, n_angles), X and V of eq. (5).
    personal_bests, best_memberships : personal bests.
    personal_values : (particles,), infinite for a particle that was never feasible.
    history : best value after the start and after each iteration.
    evaluations : particles sent to the objective so far.
    """

    positions: Array
    velocities: Array
    memberships: Array
    drifts: Array
    personal_bests: Array
    best_memberships: Array
    personal_values: Array
    history: tuple[float, ...]
    evaluations: int

    @property
    def leader(self) -> int:
        """Index of the particle that holds the best position of the swarm."""
        return int(np.argmin(self.personal_values))


@dataclass(frozen=True, slots=True)
class SwarmResult:
    """End of a swarm, and its status.

    best : (n_constants,) and sequence : (n_plies,) grid indices of the smallest value.
    personal_bests, personal_values : each particle's best, the values infinite for a particle that was never
    feasible.
    iterations : number after the start.
    evaluations : forward solves; infeasible particles cost none.
    history : (iterations + 1,) best value so far.
    message : the status in words.
    """

    best: Array = field(repr=False)
    sequence: Array
    value: float
    personal_bests: Array = field(repr=False)
    personal_values: Array = field(repr=False)
    iterations: int
    evaluations: int
    status: Status
    history: Array = field(repr=False)
    message: str


def confine(positions: Array, velocities: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Put particles that left the box back on its bounds and reverse their velocities.

    The position goes to the bound that was crossed, the velocity of that component changes sign
    and halves (Clerc 2012). An optimum on a bound is hit exactly, and a swarm that was pressed onto a bound
    without an optimum can still leave it.

    positions, velocities : (particles, n_constants).
    lower, upper : (n_constants,).
    """
    inside = np.clip(positions, lower, upper)
    return inside, np.where(inside != positions, _BOUNCE * velocities, velocities)


def start_swarm(problem: SwarmProblem, start: Array, rng: np.random.Generator) -> SwarmState:
    """Evaluate start constants with uniformly drawn memberships, all velocities zero.

    start : (particles, n_constants), inside the bounds, for instance of ``initial_swarm``.

    Raises ``ValueError`` if no particle is feasible with a finite value.
    """
    positions = np.array(start, dtype=np.float64)
    # without plies nothing is drawn, whatever the number of angles
    shape = (len(positions), problem.n_plies, max(problem.n_angles, 1))
    memberships = normalised(1.0 - rng.random(shape), rng)
    values, solves = _evaluate(problem, positions, memberships)
    if not np.isfinite(values).any():
        reason = "nothing finite" if solves else "nothing feasible"
        raise ValueError(TEXTS[reason].format(particles=solves or len(positions)))
    return SwarmState(
        positions=positions,
        velocities=np.zeros_like(positions),
        memberships=memberships,
        drifts=np.zeros_like(memberships),
        personal_bests=positions,
        best_memberships=memberships,
        personal_values=values,
        history=(float(values.min()),),
        evaluations=solves,
    )


def step_swarm(
    problem: SwarmProblem, state: SwarmState, settings: SwarmSettings, rng: np.random.Generator
) -> SwarmState:
    """Move every particle once, eq. (1), (2) and (5), and evaluate the feasible ones.

    v <- w v + c1 r1 (p_i - x) + c2 r2 (p_g - x) and x <- x + v, then ``confine``; memberships likewise,
    then ``normalised``. Drawn for every particle and component, in the order r1, r2 of the constants, R1,
    R2 of the memberships.
    """

    def moved(x: Array, v: Array, best: Array) -> tuple[Array, Array]:
        r1, r2 = rng.random(x.shape), rng.random(x.shape)
        v = settings.inertia * v + settings.c1 * r1 * (best - x) + settings.c2 * r2 * (best[state.leader] - x)
        return x + v, v

    positions, velocities = moved(state.positions, state.velocities, state.personal_bests)
    positions, velocities = confine(positions, velocities, problem.lower, problem.upper)
    memberships, drifts = moved(state.memberships, state.drifts, state.best_memberships)
    memberships = normalised(memberships, rng)
    values, solves = _evaluate(problem, positions, memberships)
    better = values < state.personal_values
    personal_values = np.where(better, values, state.personal_values)
    return SwarmState(
        positions=positions,
        velocities=velocities,
        memberships=memberships,
        drifts=drifts,
        personal_bests=np.where(better[:, None], positions, state.personal_bests),
        best_memberships=np.where(better[:, None, None], memberships, state.best_memberships),
        personal_values=personal_values,
        history=(*state.history, float(personal_values.min())),
        evaluations=state.evaluations + solves,
    )


def swarm_spread(problem: SwarmProblem, state: SwarmState) -> float:
    """Distance from the swarm's best within which nine in ten of the best positions lie.

    The distance is that of the component that differs most, as a fraction of its bounds' distance.
    The last tenth is left out because a few particles stay behind for hundreds of iterations
    without changing the answer. Particles that were never feasible count with their start.
    """
    away = np.abs(state.personal_bests - state.personal_bests[state.leader])
    farthest = np.max(away / (problem.upper - problem.lower), axis=1)
    return float(np.quantile(farthest, _MAJORITY))


def stop_reason(problem: SwarmProblem, state: SwarmState, settings: SwarmSettings) -> Status | None:
    """Reason why the swarm stops here, or None if it goes on.

    Converged: the particles agree and the best value improved by no more than ``value_tolerance`` over
    the last ``patience`` iterations, relative to the value itself plus a millionth of the start's. They
    agree if `swarm_spread` is at most ``spread_tolerance``; with unknown plies, if nine in ten personal
    bests have the leader's sequence and its constants to ``spread_tolerance`` of the bounds.
    """
    done = len(state.history) - 1
    if done >= settings.patience:
        best = state.history[-1]
        improvement = state.history[-1 - settings.patience] - best
        settled = improvement <= settings.value_tolerance * (abs(best) + _FLOOR * abs(state.history[0]))
        if settled and _agrees(problem, state, settings):
            return "converged"
    return "budget" if done >= settings.iterations else None


def minimise_problem(
    problem: SwarmProblem,
    start: Array,
    settings: SwarmSettings,
    rng: np.random.Generator,
    *,
    progress: Callable[[int, float], None] | None = None,
) -> SwarmResult:
    """Minimise a function of constants and a sequence by a particle swarm, eq. (1), (2) and (5).

    Particles that are not feasible, or whose objective is not finite, get an infinite value, the
    penalty of section 5.2; the former are not sent to the objective. The swarm stops when it has converged
    or used its budget, as its status says; a time limit ends its budget. An interruption is not caught.

    start : (particles, n_constants), sets the swarm's size; ``settings.particles`` is not read here.
    progress : called with the iteration and the best value, the start first.

    Raises ``ValueError`` if no particle of the start is feasible with a finite value.
    """
    state = start_swarm(problem, start, rng)
    while True:
        if progress is not None:
            progress(len(state.history) - 1, state.history[-1])
        status = stop_reason(problem, state, settings)
        if status is None and is_time_up():
            status = "budget"
            cut_short("cut_swarm", done=len(state.history) - 1, of=settings.iterations)
        if status is not None:
            return _result(problem, state, settings, status)
        state = step_swarm(problem, state, settings, rng)


def _agrees(problem: SwarmProblem, state: SwarmState, settings: SwarmSettings) -> bool:
    if problem.n_plies:
        return _agreeing(problem, state, settings) >= _MAJORITY * len(state.personal_values)
    return swarm_spread(problem, state) <= settings.spread_tolerance


def _agreeing(problem: SwarmProblem, state: SwarmState, settings: SwarmSettings) -> int:
    sequences = decode(state.best_memberships)
    away = np.abs(state.personal_bests - state.personal_bests[state.leader])
    near = np.all(away <= settings.spread_tolerance * (problem.upper - problem.lower), axis=1)
    return int(np.sum(near & np.all(sequences == sequences[state.leader], axis=1)))


def _result(problem: SwarmProblem, state: SwarmState, settings: SwarmSettings, status: Status) -> SwarmResult:
    iterations = len(state.history) - 1
    sequences = decode(state.best_memberships)
    text = TEXTS[f"fuzzy {status}" if problem.n_plies else status]
    return SwarmResult(
        best=_read_only(state.personal_bests[state.leader]),
        sequence=_read_only(sequences[state.leader]),
        value=state.history[-1],
        personal_bests=_read_only(state.personal_bests),
        personal_values=_read_only(state.personal_values),
        iterations=iterations,
        evaluations=state.evaluations,
        status=status,
        history=_read_only(np.array(state.history)),
        message=text.format(
            iterations=iterations,
            agreeing=_agreeing(problem, state, settings),
            particles=len(state.personal_values),
            spread=swarm_spread(problem, state),
        ),
    )


def _evaluate(problem: SwarmProblem, positions: Array, memberships: Array) -> tuple[Array, int]:
    """Values, infinite where infeasible or not finite, and the number of solves."""
    n = len(positions)
    allowed = np.asarray(problem.feasible(positions), dtype=np.bool_)
    values = np.full(n, np.inf)
    solves = int(allowed.sum())
    if solves:
        reply = problem.objective(positions[allowed], decode(memberships[allowed]))
        reply = np.asarray(reply, dtype=np.float64)
        values[allowed] = np.where(np.isfinite(reply), reply, np.inf)
    return values, solves


def _read_only(array: Array) -> Array:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def material_swarm(
    material: Material | Hybrid, unknowns: ParameterSet, n: int, rng: np.random.Generator
) -> Array:
    """Draw the start positions of the unknown constants of a plate, by `initial_swarm` for each material.

    Constants that are not unknown have their reference value.

    Returns (n, unknowns.size), columns as in ``unknowns.names``.

    Raises ``ValueError`` if the bounds leave no room for the constraints.
    """
    drawn: dict[str, Array] = {}
    for name, part in material.parts.items():
        of_part = tuple(p for p in unknowns.parameters if split_name(p.name)[0] == name)
        plain = ParameterSet(tuple(replace(p, name=split_name(p.name)[1]) for p in of_part))
        known = tuple((k, v) for k, v in part.constants.items() if k not in plain)
        swarm = initial_swarm(replace(plain, fixed=known), part.symmetry, n, rng)
        drawn |= {joined_name(name, k): column for k, column in zip(plain.names, swarm.T, strict=True)}
    return np.column_stack([drawn[name] for name in unknowns.names])


def initial_swarm(
    parameters: ParameterSet, symmetry: MaterialSymmetry, n: int, rng: np.random.Generator
) -> Array:
    """Draw the start positions of section 5.1 within the bounds.

    E2 is uniform in its bounds, E1 uniform between E2 and its upper bound, nu12 uniform in
    [-sqrt(E1/E2), sqrt(E1/E2)] cut to its bounds, all others uniform in theirs. E2 is drawn below
    the upper bound of E1, and E1 not below its own lower bound, so that every particle lies in
    the box. This order of the two is for a transversely isotropic ply: an isotropic one has E1 = E2 by
    eq. (11), and for an orthotropic one both are uniform in their bounds.

    parameters : the unknowns, SI units; a fixed E1 or E2 among them limits the other one.
    symmetry : of the ply.
    n : number of particles.

    Returns (n, parameters.size), columns as in ``parameters.names``.

    Raises ``ValueError`` if the bounds leave no room for the constraints.
    """
    bounds = dict(zip(parameters.names, zip(parameters.lower, parameters.upper, strict=True), strict=True))
    drawn = {name: np.full(n, value) for name, value in parameters.fixed}
    edge = np.ones(n)  # sqrt(E1 / E2)
    composite, ordered = symmetry != "isotropic", symmetry == "transversely_isotropic"
    if composite and "E2" in bounds:
        low, high = bounds["E2"]
        top = bounds["E1"][1] if "E1" in bounds else drawn.get("E1", np.inf)
        drawn["E2"] = _draw("E2", low, np.minimum(high, top) if ordered else high, n, rng)
    if composite and "E1" in bounds:
        low, high = bounds["E1"]
        above = np.maximum(low, drawn.get("E2", low)) if ordered else low
        drawn["E1"] = _draw("E1", above, high, n, rng)
    if composite and "E1" in drawn and "E2" in drawn:
        edge = np.sqrt(drawn["E1"] / drawn["E2"])
    for name, (low, high) in bounds.items():
        if name == "nu12":
            drawn[name] = _draw(name, np.maximum(low, -edge), np.minimum(high, edge), n, rng)
        elif name not in drawn:
            drawn[name] = _draw(name, low, high, n, rng)
    return np.column_stack([drawn[name] for name in parameters.names] or [np.empty((n, 0))])


def minimise(
    objective: Objective,
    lower: Array,
    upper: Array,
    start: Array,
    settings: SwarmSettings,
    rng: np.random.Generator,
    *,
    feasible: Feasible,
    progress: Callable[[int, float], None] | None = None,
) -> SwarmResult:
    """Minimise a function over a box by a particle swarm, eq. (1) and (2), see ``minimise_problem``.

    objective : (m, n_constants) -> (m,).
    feasible : (m, n_constants) -> (m,) bool, the constraints of the material.
    lower, upper : (n_constants,).
    """

    def without_sequence(constants: Array, sequences: Array) -> Array:
        return objective(constants)

    lower, upper = (np.asarray(bound, dtype=np.float64) for bound in (lower, upper))
    return minimise_problem(
        SwarmProblem(without_sequence, feasible, lower, upper), start, settings, rng, progress=progress
    )


def _draw(name: str, low: Array | float, high: Array | float, n: int, rng: np.random.Generator) -> Array:
    """Draw n values uniformly between two limits, each one number or one per particle."""
    low, high = np.broadcast_to(low, n), np.broadcast_to(high, n)
    empty = ~(low <= high)
    if empty.any():
        worst = int(np.argmax(empty))
        text = TEXTS["empty range"].format(name=name, low=low[worst], high=high[worst])
        raise ValueError(text)
    return np.clip(low + (high - low) * rng.random(n), low, high)
