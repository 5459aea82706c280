"""The start of a particle swarm, and swarms over a box alone: eq. (1), (2), sections 5.1, 5.2.

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

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cpam_bayes.inference.swarm.settings import (
    TEXTS,
    Feasible,
    FloatArray,
    IndexArray,
    Objective,
    SwarmSettings,
)
from cpam_bayes.inference.swarm.swarm import SwarmProblem, SwarmResult, minimise_problem
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate.elasticity import MaterialSymmetry
from cpam_bayes.plate.records import Hybrid, Material
from cpam_bayes.plate.units import joined_name, split_name

__all__ = ["SwarmResult", "SwarmSettings", "initial_swarm", "material_swarm", "minimise"]


def material_swarm(
    material: Material | Hybrid, unknowns: ParameterSet, n: int, rng: np.random.Generator
) -> FloatArray:
    """Draw the start positions of the unknown constants of a plate, `initial_swarm` for each material.

    Constants that are not among the unknowns have their reference value.

    Returns (n, unknowns.size), columns as in ``unknowns.names``.

    Raises ``ValueError`` if the bounds leave no room for the constraints.
    """
    drawn: dict[str, FloatArray] = {}
    for name, part in material.parts.items():
        of_part = tuple(p for p in unknowns.parameters if split_name(p.name)[0] == name)
        plain = ParameterSet(tuple(replace(p, name=split_name(p.name)[1]) for p in of_part))
        known = tuple((k, v) for k, v in part.constants.items() if k not in plain)
        swarm = initial_swarm(replace(plain, fixed=known), part.symmetry, n, rng)
        drawn |= {joined_name(name, k): column for k, column in zip(plain.names, swarm.T, strict=True)}
    return np.column_stack([drawn[name] for name in unknowns.names])


def initial_swarm(
    parameters: ParameterSet,
    symmetry: MaterialSymmetry,
    n: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Draw the start positions of section 5.1 within the bounds.

    E2 is uniform in its bounds, E1 uniform between E2 and its upper bound, nu12 uniform in
    [-sqrt(E1/E2), sqrt(E1/E2)] cut to its bounds, all others uniform in theirs. E2 is drawn below
    the upper bound of E1, and E1 not below its own lower bound, so that every particle lies in
    the box. The order of the two is that of a transversely isotropic ply: an isotropic one has E1 = E2 by
    eq. (11), and of an orthotropic one both are uniform in their bounds.

    parameters : the unknowns, SI units; a fixed E1 or E2 among them limits the other one.
    symmetry : of the ply.
    n : number of particles.

    Returns (n, parameters.size), columns as in ``parameters.names``.

    Raises ``ValueError`` if the bounds leave no room for the constraints.
    """
    if n < 1:
        raise ValueError(TEXTS["no particle"].format(particles=n))
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
    lower: FloatArray,
    upper: FloatArray,
    start: FloatArray,
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

    def without_sequence(constants: FloatArray, sequences: IndexArray) -> FloatArray:
        return objective(constants)

    lower, upper = (np.asarray(bound, dtype=np.float64) for bound in (lower, upper))
    return minimise_problem(
        SwarmProblem(without_sequence, feasible, lower, upper), start, settings, rng, progress=progress
    )


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
