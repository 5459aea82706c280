"""How the cost of answers grows: modes, parameters, plies, causes, stacking sequences, plates, workers.

python studies/23_growth.py [--quick] [--only NAME ...] [--most S]

Costs are the CPU seconds of one process without a stored model; on a shared machine two runs differed by up
to 60 %. A curve has an exponent p by least squares of log cost over log size, cost ~ size^p. The plate is a
free cross-ply, its lists come from the plate model with 0.2 % of noise. Curves of the forward solver are from
study 03, and those of stacking sequences by their number from study 08, in seconds of two cores. A curve
ends where the next size is expected to take more than S seconds. For batches on a Dask cluster the cost is
the CPU seconds of the busiest worker, as if each had a core to itself, and those of the process that hands
out the plates. Every curve is saved as soon as it is done, and saved curves that are not named are kept.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import cpam_bayes as cb
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.forward_model.build import forget_models
from cpam_bayes.stacking.posterior import stacking_posterior
from validation.reporting import (
    counted,
    in_digits,
    listed,
    paragraph,
    save_results,
    saved_results,
    study_parser,
    with_saved,
    write_sections,
)

Results = dict[str, Any]
Plate = dict[str, Any]
Call = Callable[[], Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"
SOLVER, STACKING = (RESULTS.with_name(f"{name}.json") for name in ("03_solver_growth", "08_sequences"))

KEYS = {
    "quick": "whether this is the small version",
    "curves": "one a question and a size: points of size and processor's seconds, the exponent and its error",
    "cluster": "one a batch on a Dask cluster: plates, workers, wall clock, and processor's seconds of the "
    "process that hands out the plates and of the busiest worker",
}

SEED = 0
CONSTANTS = {"E1_GPa": 121.2, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25}
BOUNDS = {"E1_GPa": [60, 200], "E2_GPa": [5, 20], "nu12": [0.1, 0.45], "G12_GPa": [3, 15]}
SIZES = {"thickness_mm": 0.02, "density_kg_m3": 8.0, "length_mm": 0.3, "width_mm": 0.3}
LAYUP = "[(0/90)_8]_s"
NOISE = 0.002
TWO_ANGLES, GRID_DEG = "[(?/?)_8]_s", 15.0
# Effects of a plate without clamps.
OF_FREE_PLATES = tuple(effect for effect in CATALOGUE if "clamp" not in effect.name)
# Relative scatter of the constants from plate to plate.
SCATTER = 0.02
THOUSAND, WORKERS = 1000, (1, 2, 4, 8)


class Curve(NamedTuple):
    """Cost of a question against a size; ``call`` : makes the plates of a size, returns the timed call."""

    question: str
    size: str
    sizes: tuple[int, ...]
    call: Callable[[int], Call]

    @property
    def name(self) -> str:
        """Name of the curve in the results."""
        return f"{self.question}, {self.size}"


# Plates


def plate(
    layup: str = LAYUP,
    *,
    modes: int = 6,
    parameters: int = 4,
    grid: float | None = None,
    seed: int = SEED,
    scatter: float = 0.0,
) -> Plate:
    """The cross-ply with a list of its own; its unknown angles are 0 and 90 in turn.

    parameters : constants first, then sizes with a standard deviation
    """
    rng = np.random.default_rng(seed)
    whole = {"length_mm": 260.0, "width_mm": 220.0, "thickness_mm": 3.2, "density_kg_m3": 1590.0}
    angles = iter(["0", "90"] * layup.count("?"))
    known = "".join(next(angles) if letter == "?" else letter for letter in layup)
    true = {n: v * (1.0 + scatter * rng.standard_normal()) for n, v in CONSTANTS.items()}
    material = {"name": "carbon/epoxy", "isotropic": False}
    built = {
        "name": f"plate {seed}",
        "plate": {**whole, "layup": known, "edges": "FFFF"},
        "material": {**material, **true},
    }
    noise = 1.0 + NOISE * rng.standard_normal(modes)
    listed = np.sort(cb.forward(built, modes).frequencies * noise).round(3).tolist()
    constants = list(CONSTANTS)[:parameters]
    spread = {n: SIZES[n] for n in list(SIZES)[: max(parameters - len(CONSTANTS), 0)]}
    return {
        "name": built["name"],
        "plate": {**whole, "layup": layup, "edges": "FFFF", **({"sd": spread} if spread else {})},
        "material": {**material, **CONSTANTS, "sd": {n: 0.1 * v for n, v in CONSTANTS.items()}},
        "unknowns": {
            **{n: BOUNDS[n] for n in constants},
            **({"angle_grid_deg": grid} if grid is not None else {}),
        },
        "measurement": {"frequencies_hz": listed, "relative_std": NOISE},
    }


def plates(n: int) -> list[Plate]:
    """Plates of one material with scattered constants."""
    return [plate(seed=SEED + i, scatter=SCATTER) for i in range(n)]


def cross_ply(plies: int) -> str:
    """Layup with this number of plies."""
    return f"[(0/90)_{plies // 4}]_s"


# Curves


def swarm(given: Plate) -> Call:
    """Call that identifies the constants by swarm."""
    return lambda: cb.identify(given, seed=SEED)


def posterior(given: Plate) -> Call:
    """Call that samples the posterior with emcee."""
    return lambda: cb.sample(given, seed=SEED)


def diagnosis(*given: Plate, causes: int | None = None) -> Call:
    """Call that diagnoses with the first ``causes`` effects, or all, with gain and detection limits."""
    return lambda: cb.diagnose(*given, seed=SEED, catalogue=OF_FREE_PLATES[:causes])


def stacking(given: Plate) -> Call:
    """Call that computes the probability of every stacking sequence, without the draws that follow."""
    specimen = cb.read_plate(given)
    return lambda: stacking_posterior(specimen, SEED)


def two_angles(layup: str = TWO_ANGLES, **changed: int) -> Plate:
    """The cross-ply with two unknown angles, each repeated in its layup."""
    return plate(layup, grid=GRID_DEG, **changed)


def batch(n: int, hierarchical: bool = False) -> Call:
    """Call that identifies the constants of n plates in a batch."""
    given = plates(n)
    return lambda: cb.batch(*given, seed=SEED, hierarchical=hierarchical)


IDENTIFY, EMCEE = "identify", "identify --backend emcee"
DIAGNOSE, FEW = "diagnose", "diagnose, six causes"
SEQUENCE, BATCH, HIERARCHICAL = "sequence", "batch", "batch --hierarchical"
MODES, PARAMETERS, PLIES = "modes", "parameters", "plies"
CAUSES, PLATES, SEQUENCES = "causes", "plates", "stacking sequences"
FULL, REDUCED, BUILDING = "full solve", "reduced solve", "building the reduced model"


def curves(quick: bool) -> list[Curve]:
    """All curves measured here; quick: one of each kind of call, tiny."""
    if quick:
        return [
            Curve(IDENTIFY, MODES, (4, 5), lambda n: swarm(plate(modes=n))),
            Curve(BATCH, PLATES, (1, 2), batch),
        ]
    modes, parameters, plies = (6, 12, 24, 40, 60), (2, 4, 6, 8), (4, 16, 64)
    many = (1, 2, 5, 10, 20, 50)
    return [
        Curve(IDENTIFY, MODES, modes, lambda n: swarm(plate(modes=n))),
        Curve(IDENTIFY, PARAMETERS, parameters, lambda n: swarm(plate(parameters=n))),
        Curve(IDENTIFY, PLIES, plies, lambda n: swarm(plate(cross_ply(n)))),
        Curve(EMCEE, MODES, modes, lambda n: posterior(plate(modes=n))),
        Curve(EMCEE, PARAMETERS, parameters, lambda n: posterior(plate(parameters=n))),
        Curve(EMCEE, PLIES, plies, lambda n: posterior(plate(cross_ply(n)))),
        Curve(FEW, MODES, modes, lambda n: diagnosis(plate(modes=n), causes=6)),
        Curve(FEW, PARAMETERS, parameters, lambda n: diagnosis(plate(parameters=n), causes=6)),
        Curve(FEW, PLIES, plies, lambda n: diagnosis(plate(cross_ply(n)), causes=6)),
        Curve(FEW, PLATES, many, lambda n: diagnosis(*plates(n), causes=6)),
        Curve(DIAGNOSE, CAUSES, (3, 6, 12, 24), lambda n: diagnosis(plate(), causes=n)),
        Curve(SEQUENCE, MODES, modes, lambda n: stacking(two_angles(modes=n))),
        Curve(SEQUENCE, PARAMETERS, (2, 3, 4), lambda n: stacking(two_angles(parameters=n))),
        Curve(SEQUENCE, PLIES, (8, 64), lambda n: stacking(two_angles(f"[(?/?)_{n // 4}]_s"))),
        Curve(BATCH, PLATES, many, batch),
        Curve(HIERARCHICAL, PLATES, (3, 5, 10, 20, 50), lambda n: batch(n, hierarchical=True)),
    ]


def saved_curves() -> list[Results]:
    """Curves from the saved results of studies 03 and 08."""
    solver, found = saved_results(SOLVER), []
    for question, keys in (
        (FULL, ("full_s",)),
        (REDUCED, ("reduced_s",)),
        (BUILDING, ("converging_s", "reducing_s")),
    ):
        for size in (s for s in (MODES, PARAMETERS, PLIES) if s in solver):
            points = [(p[size], sum(p[key] for key in keys)) for p in solver[size]]
            found.append(row(question, size, points, "03_solver_growth"))
    for noise in ("1 %", "0.2 %"):
        costs = [c for c in saved_results(STACKING)["cost"] if c["case"].endswith(f", {noise}")]
        points = [(c["enumerated"], c["seconds"]) for c in costs]
        found.append(row(f"{SEQUENCE}, {noise} of noise", SEQUENCES, points, "08_sequences"))
    return found


def row(question: str, size: str, points: Sequence[tuple[int, float]], source: str = "") -> Results:
    """A curve with its exponent (the slope of log cost over log size) and its standard error."""
    x, y = (np.log(np.array(column, dtype=float)) for column in zip(*points, strict=True))
    offset = x - x.mean()
    slope, error = float(offset @ y / (offset @ offset)), None
    if len(points) > 2:
        rest = y - y.mean() - slope * offset
        error = float(np.sqrt(rest @ rest / (len(x) - 2) / (offset @ offset)))
    return {
        "case": f"{question}, {size}",
        "question": question,
        "size": size,
        "points": [{"size": n, "seconds": s} for n, s in points],
        "exponent": slope,
        "exponent_error": error,
        "source": source,
    }


# Measuring


def measured(curve: Curve, most: float) -> Results:
    """CPU seconds of two sizes or more, until the next is expected to take more than ``most``."""
    points: list[tuple[int, float]] = []
    for size in curve.sizes:
        if len(points) > 1 and _expected(points, size) > most:
            break
        call = curve.call(size)
        forget_models()
        start = time.process_time()
        call()
        points.append((size, time.process_time() - start))
        print(f"{curve.name} {size}: {points[-1][1]:.1f} s", file=sys.stderr, flush=True)
    return row(curve.question, curve.size, points)


def _expected(points: Sequence[tuple[int, float]], size: int) -> float:
    """Cost of a further size, extrapolated by the slope of the last two points."""
    (before, less), (last, cost) = points[-2:]
    slope = float(np.log(cost / less) / np.log(last / before))
    return cost * float(size / last) ** slope


def on_cluster(n: int, workers: int) -> Results:
    """Cost of a batch of n plates on a freshly started Dask cluster of this machine."""
    from distributed import Client, LocalCluster

    given = plates(n)
    forget_models()
    with (
        LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        start, own = time.perf_counter(), time.process_time()
        address = cluster.scheduler_address.replace("tcp://", "dask://")
        result = cb.batch(*given, seed=SEED, executor=address)
        seconds, own = time.perf_counter() - start, time.process_time() - own
        used = client.run(time.process_time)
    if result.failed:
        raise RuntimeError(f"a plate of the batch has no answer: {result.failed[0].message}")
    print(f"batch of {n} on {workers} workers: {own:.1f} + {max(used.values()):.1f} s", file=sys.stderr)
    return {
        "case": f"{n} plates, {workers} workers",
        "plates": n,
        "workers": workers,
        "seconds": seconds,
        "here_s": own,
        "busiest_worker_s": max(used.values()),
    }


CLUSTER = tuple((n, workers) for n in (2, 8) for workers in (1, 2))
# Longest expected CPU time of a point, s.
MOST_S = 60.0
NAMES = (*(curve.name for curve in curves(quick=False)), "cluster")


def run(
    quick: bool = False,
    only: Sequence[str] = (),
    most: float = MOST_S,
    keep: Callable[[Results], None] = lambda results: None,
) -> Results:
    """Results for all curves, or those named; quick: two short ones, and a cluster of one worker."""
    results: Results = {"quick": quick, "curves": saved_curves(), "cluster": []}
    # libraries that load at first use are not part of the cost
    swarm(plate(modes=4))()
    if any(EMCEE in name or HIERARCHICAL in name for name in only or NAMES) and not quick:
        posterior(plate(modes=4))()
    for curve in curves(quick):
        if quick or not only or curve.name in only:
            results["curves"].append(measured(curve, most))
            if not quick:
                keep(results)
    if quick or not only or "cluster" in only:
        for n, workers in ((1, 1), (2, 1)) if quick else CLUSTER:
            results["cluster"].append(on_cluster(n, workers))
            if not quick:
                keep(results)
    return results


def model_of(cluster: Sequence[Results]) -> tuple[float, float, float]:
    """Fit t = a + b n / N to batches on a cluster by relative least squares: a, b, largest relative error."""
    share = np.array([r["plates"] / r["workers"] for r in cluster])
    seconds = np.array([r["here_s"] + r["busiest_worker_s"] for r in cluster])
    design = np.stack([np.ones_like(share), share], axis=1) / seconds[:, None]
    (a, b), *_ = np.linalg.lstsq(design, np.ones_like(seconds), rcond=None)
    worst = np.abs((a + b * share) / seconds - 1.0).max()
    return float(a), float(b), float(worst)


# Output


def sections(results: Results) -> dict[str, str]:
    """Section of docs/speed.md on the cost of a thousand plates."""
    return {"thousand": _thousand(results["cluster"])}


def _line(curve: Results) -> tuple[str, ...]:
    first, last = curve["points"][0], curve["points"][-1]
    error = "" if curve["exponent_error"] is None else f" +- {curve['exponent_error']:.2f}"
    return (
        *(curve["question"], curve["size"]),
        *(counted(p["size"]) for p in (first, last)),
        *(_short(p["seconds"]) for p in (first, last)),
        f"{curve['exponent']:.2f}{error}",
        _unreached(curve),
    )


def _short(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 10.0 else in_digits(seconds)


def _unreached(curve: Results) -> str:
    """Larger sizes that were not run, and the expected cost of the first of them."""
    points = [(p["size"], p["seconds"]) for p in curve["points"]]
    asked = [n for c in curves(quick=False) if c.name == curve["case"] for n in c.sizes]
    left = [n for n in asked if n > points[-1][0]]
    if not left:
        return ""
    return f"{', '.join(map(str, left))}: {_expected(points, left[0]):.0f} s expected at {left[0]}"


def _thousand(cluster: Sequence[Results]) -> str:
    a, b, worst = model_of(cluster)
    numbers, workers = (sorted({r[key] for r in cluster}) for key in ("plates", "workers"))
    own = max(r["here_s"] / r["plates"] for r in cluster if r["plates"] == max(numbers))
    text = (
        f"Batches of {numbers[0]} to {numbers[-1]} plates on {listed([str(n) for n in workers])} workers of "
        "a new Dask cluster, as if each had its own core (processor seconds), follow t = a + b n / N for n "
        f"plates on N workers, a = {a:.1f} s, b = {b:.1f} s, within {100 * worst:.0f} %. More than "
        f"{workers[-1]} workers and the network were not measured; more than about {b / own:.0f} would wait "
        f"for the process that hands out plates. {counted(THOUSAND)} plates would take"
    )
    able = [n for n in WORKERS if n < b / own]
    minutes = listed([f"{(a + b * THOUSAND / n) / 60.0:.0f}" for n in able])
    return paragraph(f"{text} {minutes} minutes on {listed(list(map(str, able)))} workers.")


def show(results: Results) -> None:
    """Print the exponents and the model."""
    for curve in results["curves"]:
        print(" | ".join(_line(curve)))
    if results["cluster"]:
        print("t = a + b n / N: a {:.2f} s, b {:.2f} s, within {:.1%}".format(*model_of(results["cluster"])))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study, print and save its results, and write the page."""
    parser = study_parser(__doc__)
    parser.add_argument(
        "--only", nargs="+", default=(), choices=NAMES, metavar="NAME", help=f"of: {'; '.join(NAMES)}"
    )
    parser.add_argument(
        "--most", type=float, default=MOST_S, metavar="S", help="of a processor, for a point (60 s)"
    )
    given = parser.parse_args(arguments)

    def kept(results: Results) -> Results:
        order = [c["case"] for c in saved_curves()] + list(NAMES)
        order += [f"{n} plates, {workers} workers" for n, workers in CLUSTER]
        return with_saved(results, RESULTS, order)

    results = run(given.quick, given.only, given.most, lambda results: save_results(RESULTS, kept(results)))
    if not given.quick:
        results = kept(results)
        save_results(RESULTS, results)
        if results["cluster"]:
            write_sections(Path(__file__).parents[1], RESULTS.stem, sections(results))
    show(results)


if __name__ == "__main__":
    main()
