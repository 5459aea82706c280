"""Particle swarm optimisation, eq. (1), (2) and sections 5.1, 5.2 of the paper.

The swarm works on arrays of shape ``(particles, components)`` and calls the objective once an
iteration, on the stack of the feasible particles. Starting, stepping and stopping (`start_swarm`,
`step_swarm`, `stop_reason`) take a frozen state and return a new value; `minimise` is the loop
round them.

The paper gives no settings. Those of `SwarmSettings` come from the literature:

* w = 0.7298 and c1 = c2 = 1.49618 are the inertia form of the constriction coefficient with
  phi = 4.1 (M. Clerc, J. Kennedy, IEEE Trans. Evol. Comput. 6, 2002, 58-73; R. C. Eberhart,
  Y. Shi, Proc. CEC 2000, 84-88);
* swarms of 20 to 100 particles differ little (D. Bratton, J. Kennedy, Proc. IEEE Swarm
  Intelligence Symposium 2007, 120-127, who take 50); 40 is the size of the standard swarm of 2011
  (M. Clerc, Standard particle swarm optimisation, 2012);
* velocities start at zero (A. Engelbrecht, Proc. IEEE Swarm Intelligence Symposium 2012);
* a particle that leaves the box is put back on the bound it crossed, and turns round with half
  its speed in that component (Clerc 2012, as above; S. Helwig, J. Branke, S. Mostaghim, IEEE
  Trans. Evol. Comput. 17, 2013, 259-271, compare the ways to do it). Stopping it there instead,
  or keeping its speed, lets a swarm settle on a bound that holds no optimum.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from cpam_bayes.inference.swarm.settings import (
    TEXTS,
    Feasible,
    FloatArray,
    Objective,
    Status,
    SwarmProblem,
    SwarmResult,
    SwarmSettings,
    SwarmState,
)
from cpam_bayes.parameters import ParameterSet

__all__ = [
    "SwarmProblem",
    "SwarmResult",
    "SwarmSettings",
    "SwarmState",
    "confine",
    "initial_swarm",
    "minimise",
    "start_swarm",
    "step_swarm",
    "stop_reason",
    "swarm_spread",
]

_BOUNCE: Final = -0.5
"""Share of the velocity kept by a component that was stopped at a bound (Clerc 2012)."""

_MAJORITY: Final = 0.9
"""Share of the particles that have to agree."""

_FLOOR: Final = 1e-6
"""Share of the start's best value that an improvement is measured against, beside the best value.

Without it a misfit that goes to zero would improve by the same factor for ever.
"""


def initial_swarm(
    parameters: ParameterSet,
    isotropic: bool,
    n: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Draw the start positions of section 5.1 within the bounds.

    E2 is uniform in its bounds, E1 uniform between E2 and its upper bound, nu12 uniform in
    [-sqrt(E1/E2), sqrt(E1/E2)] cut to its bounds, all others uniform in theirs. E2 is drawn below
    the upper bound of E1, and E1 not below its own lower bound, so that every particle lies in
    the box. For an isotropic plate E1 = E2 by eq. (11): the order of the two is not asked for.

    Parameters
    ----------
    parameters : the unknowns, SI units; a fixed E1 or E2 among them limits the other one
    isotropic : whether eq. (11) holds
    n : number of particles
    rng : source of the draws

    Returns
    -------
    positions : (n, parameters.size), columns as in ``parameters.names``

    Raises
    ------
    ValueError
        If the bounds leave no room for the constraints.
    """
    if n < 1:
        raise ValueError(TEXTS["no particle"].format(particles=n))
    bounds = dict(zip(parameters.names, zip(parameters.lower, parameters.upper, strict=True), strict=True))
    drawn = {name: np.full(n, value) for name, value in parameters.fixed}
    edge = np.ones(n)  # sqrt(E1 / E2)
    if not isotropic and "E2" in bounds:
        low, high = bounds["E2"]
        top = bounds["E1"][1] if "E1" in bounds else drawn.get("E1", np.inf)
        drawn["E2"] = _draw("E2", low, np.minimum(high, top), n, rng)
    if not isotropic and "E1" in bounds:
        low, high = bounds["E1"]
        drawn["E1"] = _draw("E1", np.maximum(low, drawn.get("E2", low)), high, n, rng)
    if not isotropic and "E1" in drawn and "E2" in drawn:
        edge = np.sqrt(drawn["E1"] / drawn["E2"])
    for name, (low, high) in bounds.items():
        if name == "nu12":
            drawn[name] = _draw(name, np.maximum(low, -edge), np.minimum(high, edge), n, rng)
        elif name not in drawn:
            drawn[name] = _draw(name, low, high, n, rng)
    return np.column_stack([drawn[name] for name in parameters.names])


def confine(
    positions: FloatArray, velocities: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Put particles that left the box back on its bounds and turn them round.

    The position goes to the bound that was crossed, the velocity of that component changes sign
    and halves (Clerc 2012, see the module's text). An optimum on a bound is hit exactly, and a
    swarm that was pressed onto a bound can still leave it.

    Parameters
    ----------
    positions, velocities : (particles, components)
    lower, upper : (components,)

    Returns
    -------
    positions, velocities : (particles, components)
    """
    inside = np.clip(positions, lower, upper)
    return inside, np.where(inside != positions, _BOUNCE * velocities, velocities)


def start_swarm(problem: SwarmProblem, start: FloatArray) -> SwarmState:
    """Evaluate the start positions, at rest.

    Parameters
    ----------
    problem : what is minimised
    start : (particles, components), inside the bounds

    Raises
    ------
    ValueError
        If the start does not fit the bounds, or if no particle is feasible with a finite value.
    """
    positions = np.array(start, dtype=np.float64)
    size = problem.lower.size
    if positions.ndim != 2 or positions.shape[0] < 1 or positions.shape[1] != size:
        raise ValueError(TEXTS["start shape"].format(shape=positions.shape, size=size))
    outside = ~np.all((positions >= problem.lower) & (positions <= problem.upper), axis=1)
    if outside.any():
        raise ValueError(TEXTS["start bounds"].format(index=int(np.argmax(outside))))
    values, solves = _evaluate(problem, positions)
    if not np.isfinite(values).any():
        reason = "nothing finite" if solves else "nothing feasible"
        raise ValueError(TEXTS[reason].format(particles=solves or len(positions)))
    return SwarmState(
        positions=positions,
        velocities=np.zeros_like(positions),
        personal_bests=positions,
        personal_values=values,
        history=(float(values.min()),),
        evaluations=solves,
    )


def step_swarm(
    problem: SwarmProblem, state: SwarmState, settings: SwarmSettings, rng: np.random.Generator
) -> SwarmState:
    """Move every particle once, eq. (1) and (2), and evaluate the feasible ones.

    v <- w v + c1 r1 (p_i - x) + c2 r2 (p_g - x) and x <- x + v, where r1 and r2 are drawn for
    every particle and component, r1 first.

    Parameters
    ----------
    problem : what is minimised
    state : the swarm before the move
    settings : w, c1, c2
    rng : source of r1 and r2
    """
    positions = state.positions
    r1 = rng.random(positions.shape)
    r2 = rng.random(positions.shape)
    velocities = (
        settings.inertia * state.velocities
        + settings.c1 * r1 * (state.personal_bests - positions)
        + settings.c2 * r2 * (state.personal_bests[state.leader] - positions)
    )
    positions, velocities = confine(positions + velocities, velocities, problem.lower, problem.upper)
    values, solves = _evaluate(problem, positions)
    better = values < state.personal_values
    personal_values = np.where(better, values, state.personal_values)
    return SwarmState(
        positions=positions,
        velocities=velocities,
        personal_bests=np.where(better[:, None], positions, state.personal_bests),
        personal_values=personal_values,
        history=(*state.history, float(personal_values.min())),
        evaluations=state.evaluations + solves,
    )


def swarm_spread(problem: SwarmProblem, state: SwarmState) -> float:
    """Distance from the swarm's best within which nine in ten of the best positions lie.

    The distance is that of the component that differs most, as a fraction of its bounds' distance.
    The last tenth is left out because a few particles stay behind for hundreds of iterations
    without changing the answer. Particles that never were feasible count with their start.
    """
    away = np.abs(state.personal_bests - state.personal_bests[state.leader])
    farthest = np.max(away / (problem.upper - problem.lower), axis=1)
    return float(np.quantile(farthest, _MAJORITY))


def stop_reason(problem: SwarmProblem, state: SwarmState, settings: SwarmSettings) -> Status | None:
    """Say why the swarm stops here, or None if it goes on.

    Converged: `swarm_spread` is at most `spread_tolerance` and the best value improved by no
    more than `value_tolerance` over the last `patience` iterations, relative to the value itself
    plus a millionth of the start's.
    """
    done = len(state.history) - 1
    if done >= settings.patience:
        best = state.history[-1]
        improvement = state.history[-1 - settings.patience] - best
        scale = abs(best) + _FLOOR * abs(state.history[0])
        settled = improvement <= settings.value_tolerance * scale
        if settled and swarm_spread(problem, state) <= settings.spread_tolerance:
            return "converged"
    return "budget" if done >= settings.iterations else None


def minimise(
    objective: Objective,
    lower: FloatArray,
    upper: FloatArray,
    start: FloatArray,
    settings: SwarmSettings,
    rng: np.random.Generator,
    *,
    feasible: Feasible,
    progress: Callable[[int, float], None] | None = None,
) -> SwarmResult:
    """Minimise a function over a box by a particle swarm, eq. (1) and (2).

    Particles that are not feasible, or whose objective is not finite, get an infinite value, the
    penalty of section 5.2; the former are not sent to the objective. The swarm stops when it
    converged or when its budget is used, and says which. An interruption is not caught.

    Parameters
    ----------
    objective : (m, components) -> (m,), called at most once an iteration
    lower, upper : (components,) bounds
    start : (particles, components), for instance of `initial_swarm`; sets the swarm's size
    settings : numerical settings; `particles` is not read here
    rng : source of r1 and r2 of eq. (1)
    feasible : (m, components) -> (m,) booleans, the constraints (9)
    progress : called with the iteration and the best value, the start first

    Raises
    ------
    ValueError
        If bounds, start or a returned array do not fit, or if no particle of the start is
        feasible with a finite value.
    """
    problem = SwarmProblem(
        objective=objective,
        feasible=feasible,
        lower=np.asarray(lower, dtype=np.float64),
        upper=np.asarray(upper, dtype=np.float64),
    )
    state = start_swarm(problem, start)
    status: Status | None = None
    while True:
        if progress is not None:
            progress(len(state.history) - 1, state.history[-1])
        status = stop_reason(problem, state, settings)
        if status is not None:
            return _result(problem, state, status)
        state = step_swarm(problem, state, settings, rng)


def _result(problem: SwarmProblem, state: SwarmState, status: Status) -> SwarmResult:
    iterations = len(state.history) - 1
    spread = swarm_spread(problem, state)
    return SwarmResult(
        best=_read_only(state.personal_bests[state.leader]),
        value=state.history[-1],
        personal_bests=_read_only(state.personal_bests),
        personal_values=_read_only(state.personal_values),
        iterations=iterations,
        evaluations=state.evaluations,
        status=status,
        history=_read_only(np.array(state.history)),
        message=TEXTS[status].format(iterations=iterations, spread=spread),
    )


def _evaluate(problem: SwarmProblem, positions: FloatArray) -> tuple[FloatArray, int]:
    """Return the values, infinite where infeasible or not finite, and the number of solves."""
    n = len(positions)
    allowed = np.asarray(problem.feasible(positions), dtype=np.bool_)
    _require_shape("feasible", allowed.shape, n)
    values = np.full(n, np.inf)
    solves = int(allowed.sum())
    if solves:
        reply = np.asarray(problem.objective(positions[allowed]), dtype=np.float64)
        _require_shape("objective", reply.shape, solves)
        values[allowed] = np.where(np.isfinite(reply), reply, np.inf)
    return values, solves


def _draw(
    name: str, low: FloatArray | float, high: FloatArray | float, n: int, rng: np.random.Generator
) -> FloatArray:
    """Draw n values uniformly between two limits, each a number or one for every particle."""
    low, high = np.broadcast_to(low, n), np.broadcast_to(high, n)
    empty = ~(low <= high)
    if empty.any():
        worst = int(np.argmax(empty))
        text = TEXTS["empty range"].format(name=name, low=low[worst], high=high[worst])
        raise ValueError(text)
    return np.clip(low + (high - low) * rng.random(n), low, high)


def _read_only(array: FloatArray) -> FloatArray:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def _require_shape(source: str, shape: tuple[int, ...], n: int) -> None:
    if shape != (n,):
        text = TEXTS["reply shape"].format(source=source, shape=shape, particles=n, expected=(n,))
        raise ValueError(text)
