"""How often a single swarm finds the best constants, and how often several, polished, do.

python studies/20_swarms.py [--quick] [--only C1 ...]

The best misfit known for a plate is the least of all runs and of an exhaustive search: scipy's least squares
(SLSQP if it violates E1 > E2) from the best 100 of 4096 points that fill the search bounds. A run succeeds if
its misfit is within 0.1 %.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares, minimize
from scipy.stats import qmc

from cpam_bayes.identification.search import MOST_SWARMS, Search, misfit, required, search
from cpam_bayes.plate import Specimen, builtin, to_user, user_name
from validation.reporting import (
    save_results,
    study_parser,
    with_saved,
)

Results = dict[str, Any]

HERE = Path(__file__).parent
RESULTS = HERE / "results" / f"{Path(__file__).stem}.json"
PLATES = ("D&G", "A1", "A2", "B1", "B2", "C1", "C2", "C3", "C4", "D1", "D2", "D3", "D4")
SEEDS = 20
CLOSE = 1e-3
POINTS, STARTS = 4096, 100
# Least fraction by which E1 exceeds E2.
_MARGIN = 1e-7

KEYS = {
    "quick": "whether this is the small version",
    "seeds": "number of seeds",
    "close": "relative distance from the best misfit known within which a run has found it",
    "plates": "one a plate: the best misfit of all searches, its constants, that of the exhaustive search, "
    "and of single swarms and of several: runs that found it, solves and seconds of one run",
}


def run(
    quick: bool = False, only: Sequence[str] = (), keep: Callable[[Results], None] = lambda results: None
) -> Results:
    """Results for every plate with every seed; quick: one plate, two seeds."""
    names = [name for name in PLATES if not only or name in only]
    names, seeds = (["A1"], 2) if quick else (names, SEEDS)
    rows = []
    for name in names:
        rows.append(plate(builtin(name), seeds))
        if not quick:
            print(line(rows[-1]), file=sys.stderr, flush=True)
            keep({"quick": quick, "seeds": seeds, "close": CLOSE, "plates": rows})
    return {"quick": quick, "seeds": seeds, "close": CLOSE, "plates": rows}


def plate(specimen: Specimen, seeds: int) -> Results:
    """Results for one plate: the exhaustive search, then both methods with every seed."""
    ways: dict[str, list[Search]] = {}
    seconds: dict[str, float] = {}
    # all run on the model converged at the first answer
    centre = search(specimen, 0, swarms=MOST_SWARMS).centre
    for way, swarms in (("single", 1), ("several", MOST_SWARMS)):
        start = time.process_time()
        ways[way] = [search(specimen, seed, swarms=swarms, centre=centre) for seed in range(seeds)]
        seconds[way] = (time.process_time() - start) / seeds
    everywhere = exhaustive(specimen, ways["several"][0])
    found = [s.swarm for runs in ways.values() for s in runs]
    best = min(found, key=lambda s: s.value)
    least = min(best.value, everywhere)
    names = required(specimen)[1].names
    return {
        "case": specimen.name,
        "best": least,
        "constants": {user_name(n): to_user(n, float(v)) for n, v in zip(names, best.best, strict=True)},
        "exhaustive": everywhere,
        **{
            way: {
                "found": sum(s.swarm.value <= (1.0 + CLOSE) * least for s in runs),
                "converged": sum(s.swarm.status == "converged" for s in runs),
                "wrong": sum(
                    s.swarm.status == "converged" and s.swarm.value > (1.0 + CLOSE) * least for s in runs
                ),
                "forward_solves": float(np.mean([s.swarm.evaluations for s in runs])),
                "swarms": float(np.mean([s.swarms for s in runs])),
                "seconds": seconds[way],
            }
            for way, runs in ways.items()
        },
    }


def exhaustive(specimen: Specimen, searched: Search) -> float:
    """Least misfit by scipy's trust-region least squares, from the best of points that fill the bounds.

    If it ends with E2 above E1, sequential quadratic programming enforces the constraint.
    """
    measurement, unknowns = required(specimen)
    f, model = measurement.frequencies, searched.model
    lower, upper = unknowns.lower, unknowns.upper
    points = lower + (upper - lower) * qmc.Sobol(len(lower), seed=1).random(POINTS)
    points = points[model.full.admissible(points)]
    values = misfit(model.predict(points).frequencies[:, : len(f)], f, "absolute")
    least, scale = np.inf, float(values.min())

    def stiffer_along(u: np.ndarray) -> float:
        x = dict(zip(unknowns.names, lower + (upper - lower) * u, strict=True))
        return float(x["E1"] / x["E2"] - 1.0) - _MARGIN

    for start in points[np.argsort(values)[:STARTS]]:

        def residual(u: np.ndarray) -> np.ndarray:
            return np.asarray(model.predict(lower + (upper - lower) * u).frequencies[0, : len(f)] - f)

        def slope(u: np.ndarray) -> np.ndarray:
            prediction = model.predict(lower + (upper - lower) * u, jacobian=True)
            assert prediction.jacobian is not None
            return np.asarray(prediction.jacobian[0, : len(f)] * (upper - lower))

        def admissible(u: np.ndarray) -> bool:
            return bool(model.full.admissible(lower + (upper - lower) * u[None])[0])

        unit = np.clip((start - lower) / (upper - lower), 1e-6, 1.0 - 1e-6)
        end = least_squares(residual, unit, jac=slope, bounds=(0.0, 1.0), xtol=1e-12, ftol=1e-12)
        if admissible(end.x):
            least = min(least, 2.0 * end.cost)
        elif {"E1", "E2"} <= set(unknowns.names):
            # the optimum is at the limit of eq. (9): E1 > E2
            within = minimize(
                lambda u: np.sum(residual(u) ** 2) / scale,
                unit,
                jac=lambda u: 2.0 * slope(u).T @ residual(u) / scale,
                method="SLSQP",
                bounds=[(0.0, 1.0)] * len(unit),
                constraints={"type": "ineq", "fun": stiffer_along},
                options={"ftol": 1e-12, "maxiter": 200},
            )
            if admissible(within.x):
                least = min(least, within.fun * scale)
    return float(least)


def line(row: Results) -> str:
    """Result for one plate in a line."""
    single, several = row["single"], row["several"]
    return (
        f"{row['case']}: F {row['best']:.5g} (exhaustive {row['exhaustive']:.5g}); single swarm "
        f"{single['found']} found, {single['wrong']} converged elsewhere, {single['seconds']:.2f} s; several "
        f"{several['found']} found, {several['wrong']} elsewhere, {several['seconds']:.2f} s"
    )


def main() -> None:
    """Run the study and save the results."""
    parser = study_parser(__doc__)
    parser.add_argument("--only", nargs="+", default=(), help="names of plates")
    args = parser.parse_args()

    def keep(results: Results) -> None:
        save_results(RESULTS, with_saved(results, RESULTS, PLATES))

    for row in run(args.quick, args.only, keep)["plates"]:
        print(line(row))


if __name__ == "__main__":
    main()
