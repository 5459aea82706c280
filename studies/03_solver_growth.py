"""How the cost of the forward solver grows with accuracy, with the number of modes, parameters and plies.

python studies/03_solver_growth.py [--quick]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.forward_model.model import (
    PlateModel,
    angle_parameters,
    converged_model,
    plate_problem,
    training_sets,
)
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS, ReducedModel, ReductionSettings, reduce
from cpam_bayes.mechanics.convergence import Tolerance, rich_frequencies
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.running import single_blas_thread
from validation.reporting import (
    study_main,
)

Array = NDArray[np.float64]
Results = dict[str, Any]
Call = Callable[[], Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "stack": "parameter sets that a reduced model solves together",
    "accuracy": "one basis each: plate, with or without edge exponentials, its size, worst error, full solve",
    "modes": "one number of modes each: sizes, full and reduced solves, LAPACK alone, building, errors",
    "parameters": "one set of parameters each: their names; the rest as for modes",
    "plies": "one number of plies each; the rest as for modes",
}

STACK = 64
MODES = {"C1": 6, "D1": 10}
DEGREES = {"enriched": (6, 7, 8, 9, 10, 12, 14), "plain": (6, 8, 10, 12, 14, 16, 18, 20, 24)}
NUMBERS_OF_MODES = (6, 10, 16, 24, 32, 40, 60)
# Constants join first, in the order of the paper's unknowns, then the angles of C1's group of four plies.
CONSTANTS = ("E1", "E2", "nu12", "G12", "G23")
GROUP = (0.0, 90.0, 0.0, 90.0)
NUMBERS_OF_PARAMETERS = (2, 3, 4, 5, 6, 7, 8, 9)
NUMBERS_OF_PLIES = (4, 8, 16, 32, 64)
_REFERENCE = Tolerance(kept=1e-5, rich=2e-6, largest_degree=30)
_QUICK_SETTINGS = ReductionSettings(training=12, checks=12, rounds=1)


@single_blas_thread
def run(quick: bool) -> Results:
    """Results for all four ladders; quick: two or three small steps of each."""
    rounds = 2 if quick else 9
    settings = _QUICK_SETTINGS if quick else DEFAULT_SETTINGS
    return {
        "quick": quick,
        "stack": STACK,
        "accuracy": _against_accuracy(("C1",) if quick else tuple(MODES), quick, rounds),
        "modes": _against_modes((3, 4) if quick else NUMBERS_OF_MODES, settings, rounds),
        "parameters": _against_parameters((2, 3) if quick else NUMBERS_OF_PARAMETERS, settings, rounds),
        "plies": _against_plies((4, 8) if quick else NUMBERS_OF_PLIES, settings, rounds),
    }


# Accuracy


def _against_accuracy(plates: Iterable[str], quick: bool, rounds: int) -> list[Results]:
    """Time and error of a full solve on ladders of bases, always with the plate's symmetries."""
    points: list[Results] = []
    calls: dict[int, Call] = {}
    for plate in plates:
        problem = plate_problem(cb.read_plate(plate))
        rich = rich_frequencies(problem, {}, MODES[plate], _REFERENCE)
        exact, exact_error = rich.frequencies[0], float(rich.error.max())
        for basis, degrees in DEGREES.items():
            for degree in degrees[:2] if quick else degrees:
                chosen = RitzSettings(degree, degree, layers=1 if basis == "enriched" else 0)
                space = ritz_space(problem.edges, problem.nominal, chosen)
                model = PlateModel(discretise(problem, space, {}), MODES[plate], np.zeros(MODES[plate]))
                call = _prediction(model, np.empty((1, 0)))
                found = call().frequencies[0]
                calls[len(points)] = call
                points.append(
                    {
                        "plate": plate,
                        "basis": basis,
                        "degree": degree,
                        "sizes": _sizes(model),
                        "error": float(np.max(np.abs(found / exact - 1.0))),
                        "reference_error": exact_error,
                    }
                )
    times = _interleaved(calls, rounds)
    for i, point in enumerate(points):
        point["full_s"] = float(np.median(times[i]))
    return _with_ratios(points, ("full_s",))


def _prediction(model: PlateModel | ReducedModel, x: Array, jacobian: bool = False) -> Call:
    return lambda: model.predict(x, jacobian=jacobian)


def _sizes(model: PlateModel) -> list[int]:
    return [block.size for block in model.operator.blocks]


# Number of modes, of parameters, of plies


def _against_modes(numbers: Iterable[int], settings: ReductionSettings, rounds: int) -> list[Results]:
    specimen = cb.read_plate("C1")
    models = [(_built(specimen, specimen.unknowns, n, settings), {"modes": n}) for n in numbers]
    return _measured(models, rounds)


def _against_parameters(numbers: Iterable[int], settings: ReductionSettings, rounds: int) -> list[Results]:
    models = []
    for n in numbers:
        specimen, parameters = _with_parameters(n)
        label = {"parameters": n, "names": list(parameters.names)}
        models.append((_built(specimen, parameters, MODES["C1"], settings), label))
    return _measured(models, rounds)


def _against_plies(numbers: Iterable[int], settings: ReductionSettings, rounds: int) -> list[Results]:
    known, models = cb.read_plate("C1"), []
    for n in numbers:
        # as thick as C1, with thinner alternating plies
        layup = parse_layup(f"[(0/90)_{n // 4}]_s")
        specimen = replace(known, plate=replace(known.plate, layup=layup))
        models.append((_built(specimen, known.unknowns, MODES["C1"], settings), {"plies": n}))
    return _measured(models, rounds)


def _with_parameters(n: int) -> tuple[Specimen, ParameterSet]:
    """C1 with n of its constants and angles unknown."""
    n_angles = max(n - len(CONSTANTS), 0)
    plies = "/".join("?" if i < n_angles else f"{angle:g}" for i, angle in enumerate(GROUP))
    specimen = cb.read_plate("C1")
    specimen = replace(specimen, plate=replace(specimen.plate, layup=parse_layup(f"[({plies})_4]_s")))
    # D1 has bounds of G23 too
    known = cb.read_plate("D1").unknowns
    constants = ParameterSet(tuple(known[name] for name in CONSTANTS[:n]))
    return specimen, constants.union(angle_parameters(specimen))


Built = tuple[ReducedModel, float, float]


def _built(specimen: Specimen, parameters: ParameterSet, n_modes: int, settings: ReductionSettings) -> Built:
    """The reduced model, and the CPU seconds for converging the plate and for reducing it."""
    start = time.process_time()
    full = converged_model(specimen, parameters, n_modes)
    converged = time.process_time()
    reduced = reduce(full, np.random.default_rng(0), settings)
    return reduced, converged - start, time.process_time() - converged


def _measured(models: list[tuple[Built, Results]], rounds: int) -> list[Results]:
    calls: dict[tuple[int, str], Call] = {}
    points = []
    for i, ((reduced, converging, reducing), label) in enumerate(models):
        full, fast = reduced.full, reduced.fast
        x = training_sets(full.operator.problem, STACK, np.random.default_rng(1))
        exact = full.predict(x).frequencies
        points.append(
            {
                **label,
                "full_sizes": _sizes(full),
                "reduced_sizes": _sizes(fast),
                "converging_s": converging,
                "reducing_s": reducing,
                "reduction_error": float(np.max(np.abs(reduced.predict(x).frequencies / exact - 1.0))),
            }
        )
        calls[i, "full_s"] = _prediction(full, x[:1])
        calls[i, "reduced_s"] = _prediction(reduced, x)
        calls[i, "derivatives_s"] = _prediction(reduced, x, jacobian=True)
        calls[i, "lapack_s"] = _lapack(fast, x)
    times = _interleaved(calls, rounds)
    names = ("full_s", "reduced_s", "derivatives_s", "lapack_s")
    for i, point in enumerate(points):
        for name in names:
            sets = 1 if name == "full_s" else STACK
            point[name] = float(np.median(times[i, name])) / sets
    return _with_ratios(points, names)


def _lapack(model: PlateModel, x: Array) -> Call:
    """Eigenvalues of the model's own matrices, once assembled."""
    stiffness, _ = model.coefficients(x)
    stacks = [block.dense().stiffness.assemble(stiffness) for block in model.operator.blocks]
    return lambda: [np.linalg.eigvalsh(stack) for stack in stacks]


# Timing


def _interleaved(calls: Mapping[Any, Call], rounds: int) -> dict[Any, Array]:
    """CPU seconds of every call, (rounds,), one round after the other.

    The time of other programs does not count.
    """
    repeats = {name: max(1, round(0.01 / max(_seconds(call, 1), 1e-5))) for name, call in calls.items()}
    rows = [{n: _seconds(call, repeats[n]) / repeats[n] for n, call in calls.items()} for _ in range(rounds)]
    return {name: np.array([row[name] for row in rows]) for name in calls}


def _seconds(call: Call, repeats: int) -> float:
    start = time.process_time()
    for _ in range(repeats):
        call()
    return time.process_time() - start


def _with_ratios(points: list[Results], names: Iterable[str]) -> list[Results]:
    """The points with the ratio of every time to the shortest of its kind."""
    for name in names:
        shortest = min(point[name] for point in points)
        for point in points:
            point[name.removesuffix("_s") + "_ratio"] = point[name] / shortest
    return points


# Output


def show(results: Results) -> None:
    """Print the results as tables."""
    rows = tuple(
        (
            p["plate"],
            p["basis"],
            str(p["degree"]),
            str(sum(p["sizes"])),
            f"{p['error']:.1e}",
            f"{1e3 * p['full_s']:.2f}",
            f"{p['full_ratio']:.1f}",
        )
        for p in results["accuracy"]
    )
    headings = ("plate", "basis", "degree", "unknowns", "worst error", "full, ms", "ratio")
    tables = [Table("Cost against accuracy", _columns(headings, text=2), rows)]
    for kind in ("modes", "parameters", "plies"):
        rows = tuple(
            (
                str(p[kind]),
                str(sum(p["full_sizes"])),
                "+".join(str(n) for n in p["reduced_sizes"] if n > 4),
                f"{1e3 * p['full_s']:.2f}",
                f"{p['full_ratio']:.1f}",
                f"{1e6 * p['reduced_s']:.0f}",
                f"{p['reduced_ratio']:.1f}",
                f"{1e6 * p['derivatives_s']:.0f}",
                f"{1e6 * p['lapack_s']:.0f}",
                f"{p['converging_s'] + p['reducing_s']:.1f}",
                f"{p['reduction_error']:.1e}",
            )
            for p in results[kind]
        )
        headings = (
            *(kind, "unknowns", "reduced", "full, ms", "ratio", "reduced, us", "ratio"),
            *("derivatives, us", "LAPACK, us", "building, s", "reduction error"),
        )
        tables.append(Table(f"Cost against the number of {kind}", _columns(headings), rows))
    print(screen_text(tuple(tables), sys.stdout))


def _columns(headings: tuple[str, ...], text: int = 0) -> tuple[Heading, ...]:
    return tuple(Heading(heading, i >= text) for i, heading in enumerate(headings))


def main() -> None:
    study_main(__doc__, run, show, RESULTS)


if __name__ == "__main__":
    main()
