"""Simulation-based calibration: is a posterior as wide as it says, on a thin and on a thick plate?

python studies/05_calibration.py [--quick] [--workers N | --executor SPEC] [--repetitions N] [--store DIR]

Constants and noise are drawn from their priors, a list is simulated by the reduced model that the posterior
uses too, it is sampled, and the truth is ranked among 99 draws (cpam_bayes/calibration.py). Repetitions are
saved one by one, and a stopped run continues where it was.
"""

from __future__ import annotations

import sys
from concurrent.futures import Executor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.calibration import (
    N_DRAWS,
    SETTINGS,
    Band,
    Experiment,
    PlateSource,
    Repetition,
    calibrate,
    coverage,
    parameter_names,
    rank_statistics,
)
from cpam_bayes.command import add_executor_options
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parallel import open_executor
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.storage import cache_directory
from validation.draw_store import stored_calibration
from validation.reporting import (
    save_results,
    study_parser,
)

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "draws": "draws that a true value is ranked among",
    "band_probability": "of the simultaneous bands",
    "plates": "one each: what was repeated, chains, bands, and by parameter counts, p-values, coverage",
}

SEED = 0
PLATES = {"C1": 6, "D1": 10}
RESOLUTION_HZ = 1.0  # as in the plate files
REPETITIONS, QUICK_REPETITIONS = 500, 5
BAND_PROBABILITY, BINS = 0.95, 20
QUICK_SETTINGS = replace(SETTINGS, round_steps=100, most_steps=100)


def run(
    quick: bool,
    executor: Executor | None = None,
    store: Path | None = None,
    repetitions: int | None = None,
) -> Results:
    """Results for both plates; quick: a few repetitions of the thin one with chains too short to trust."""
    plates = dict([next(iter(PLATES.items()))]) if quick else PLATES
    n = repetitions or (QUICK_REPETITIONS if quick else REPETITIONS)
    return {
        "quick": quick,
        "draws": N_DRAWS,
        "band_probability": BAND_PROBABILITY,
        "plates": [_plate(name, modes, n, quick, executor, store) for name, modes in plates.items()],
    }


def _plate(
    name: str, modes: int, n: int, quick: bool, executor: Executor | None, store: Path | None
) -> Results:
    experiment = Experiment(
        source=PlateSource(name, modes),
        resolution=RESOLUTION_HZ,
        relative_std=None,
        seed=SEED,
        settings=QUICK_SETTINGS if quick else SETTINGS,
        swarm=SwarmSettings(particles=10, iterations=20) if quick else SwarmSettings(),
    )

    def tell(done: int) -> None:
        print(f"\r{name}: {done} of {n}", end="" if done < n else "\n", file=sys.stderr, flush=True)

    if store is None:
        found = calibrate(experiment, n, executor=executor)
    else:
        found = stored_calibration(experiment, n, store / f"{name}.jsonl", executor=executor, progress=tell)
    return summary(name, modes, parameter_names(experiment), found)


def summary(name: str, modes: int, names: tuple[str, ...], found: tuple[Repetition, ...]) -> Results:
    """Summary of the ranks of one plate."""
    ranks, below = np.array([r.ranks for r in found]), np.array([r.below for r in found])
    statistics = rank_statistics(
        ranks, N_DRAWS + 1, np.random.default_rng(SEED), n_bins=BINS, probability=BAND_PROBABILITY
    )
    return {
        "plate": name,
        "modes": modes,
        "repetitions": len(found),
        "converged": sum(r.converged for r in found),
        "ordered_lists": sum(r.ordered for r in found),
        "median_steps": float(np.median([r.steps for r in found])),
        "largest_r_hat": float(max(r.r_hat for r in found)),
        "least_effective": float(min(r.effective for r in found)),
        "histogram_band": _band(statistics.histogram_band),
        "ecdf_band": _band(statistics.ecdf_band),
        "parameters": [
            {
                "name": parameter,
                "counts": own.counts.tolist(),
                "cumulative": own.cumulative.tolist(),
                "chi_square_p": own.chi_square_p,
                "ecdf_p": own.ecdf_p,
                "corrected_p": own.corrected_p,
                "coverage": [asdict(c) for c in coverage(below[:, i])],
            }
            for i, (parameter, own) in enumerate(zip(names, statistics.parameters, strict=True))
        ],
    }


def _band(band: Band) -> Results:
    return {"lower": band.lower.tolist(), "upper": band.upper.tolist()}


def show(results: Results) -> None:
    """Print the results as tables."""
    tables = []
    for plate in results["plates"]:
        rows = tuple(
            (
                p["name"],
                f"{p['chi_square_p']:.3f}",
                f"{p['ecdf_p']:.3f}",
                f"{p['corrected_p']:.3f}",
                *(f"{100 * c['share']:.1f}({100 * c['standard_error']:.1f})" for c in p["coverage"]),
            )
            for p in plate["parameters"]
        )
        levels = [f"{100 * c['level']:g} %" for c in plate["parameters"][0]["coverage"]]
        headings = ("chi-square p", "ECDF p", "corrected", *(f"in {level}" for level in levels))
        title = (
            f"{plate['plate']}: {plate['repetitions']} repetitions, {plate['converged']} converged; "
            "p-values of the ranks, coverage in per cent"
        )
        columns = (Heading("parameter"), *(Heading(heading, True) for heading in headings))
        tables.append(Table(title, columns, rows))
    print(screen_text(tuple(tables), sys.stdout))


def main() -> None:
    """Run the study, print its tables and save the results."""
    parser = study_parser(__doc__)
    add_executor_options(parser)
    parser.add_argument(
        "--repetitions", type=int, metavar="N", help=f"of each plate (default: {REPETITIONS})"
    )
    parser.add_argument(
        "--store",
        type=Path,
        metavar="DIR",
        default=cache_directory() / "calibration",
        help="where repetitions are kept, a file a plate (default: in the package's cache)",
    )
    args = parser.parse_args()
    with open_executor(args.executor, args.workers) as executor:
        results = run(args.quick, executor, None if args.quick else args.store, args.repetitions)
    show(results)
    if not args.quick:
        save_results(RESULTS, results)


if __name__ == "__main__":
    main()
