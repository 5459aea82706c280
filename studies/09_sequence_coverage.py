"""Do sets of stacking sequences hold the true one as often as they say?

python studies/09_sequence_coverage.py [--quick] [--only NAME ...] [--trials N] [--workers N] [...]

Sequence and constants are drawn from the prior, a list with 1 % noise is simulated by the reduced model that
the evidences use too, and the rank of the true sequence among all is noted
(studies/validation/sequences.py). One case per plate; saved cases are kept.
"""

from __future__ import annotations

import sys
import time
from concurrent.futures import Executor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import cpam_bayes as cb
from cpam_bayes.command import add_executor_options
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.reporting import (
    markdown_table,
    save_results,
    saved_results,
    study_parser,
    with_error,
    with_saved,
    write_sections,
)
from validation.sequences import (
    ALLOWED,
    CoverageSettings,
    Trial,
    stacking_coverage,
    summarised,
)

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "noise": "relative standard deviation of the lists",
    "allowed": "difference of a coverage from its level that passes, in binomial standard deviations",
    "cases": "one a plate: layup, grid, trials one by one, coverage at three levels, seconds",
}

SEED = 0
LEVELS = (0.5, 0.8, 0.95)


class Case(NamedTuple):
    """A variant of a built-in plate, and its unknowns."""

    plate: str
    layup: str
    width: float | None
    step_deg: float
    modes: int
    trials: int


CASES = {
    "thin": Case("C1", "[(?/?)_4]_s", 0.19, 15.0, 6, 300),
    "thick": Case("D1", "[(?/?)_4]_s", None, 15.0, 10, 100),
    "four angles": Case("C1", "[(?/?/?/?)_2]_s", 0.19, 30.0, 6, 100),
}
QUICK = {"thin": CASES["thin"]._replace(step_deg=45.0, trials=6)}
SMALL = CoverageSettings(library=150, log2_points=6)


def specimen_of(case: Case) -> Specimen:
    """The plate of a case; a rectangular one has fewer symmetric images."""
    own = cb.read_plate(case.plate)
    width = own.plate.width if case.width is None else case.width
    plate = replace(own.plate, layup=parse_layup(case.layup), width=width)
    return replace(own, plate=plate, angle_grid_deg=case.step_deg)


def run(
    quick: bool,
    executor: Executor | None = None,
    only: tuple[str, ...] | None = None,
    trials: int | None = None,
) -> Results:
    """Results for all cases, or those named; quick: a few trials of the thin plate on a coarse grid."""
    cases = QUICK if quick else CASES
    settings = SMALL if quick else CoverageSettings()
    return {
        "quick": quick,
        "noise": settings.relative_std,
        "allowed": ALLOWED,
        "cases": [
            _case(name, case, trials or case.trials, settings, executor, quiet=quick)
            for name, case in cases.items()
            if only is None or name in only
        ],
    }


def _case(
    name: str, case: Case, n: int, settings: CoverageSettings, executor: Executor | None, *, quiet: bool
) -> Results:
    begin = time.perf_counter(), time.process_time()

    def tell(done: int, total: int) -> None:
        if not quiet:
            end = "" if done < total else "\n"
            print(f"\r{name}: {done} of {total}", end=end, file=sys.stderr, flush=True)

    found = stacking_coverage(
        specimen_of(case),
        n,
        SEED,
        settings=replace(settings, modes=case.modes),
        executor=executor,
        progress=tell,
    )
    return {
        "case": name,
        **{key: value for key, value in case._asdict().items() if key != "trials"},
        "seconds": time.perf_counter() - begin[0],
        **summary(found),
    }


def summary(found: tuple[Trial, ...]) -> Results:
    """Summary of the trials of one case."""
    coverage = [summarised(found, level) for level in LEVELS]
    return {
        "coverage": [
            {"level": c.level, "covered": c.covered, "sd": c.sd, "z": c.z, "passes": c.passes}
            for c in coverage
        ],
        "p_uniform": coverage[0].p_uniform,
        "median_set_size": float(np.median([t.set_size for t in found])),
        "truth_ranked_first": float(np.mean([t.rank == 1 for t in found])),
        "median_error": float(np.median([t.error for t in found])),
        "trials": [asdict(t) for t in found],
    }


def show(results: Results) -> None:
    """Print the results as a table."""
    headings = (
        "case",
        "layup",
        "trials",
        "level",
        "covered",
        "sd",
        "z",
        "passes",
        "p uniform",
        "set",
        "first",
    )
    rows = tuple(
        (
            c["case"],
            c["layup"],
            str(len(c["trials"])),
            f"{level['level']:g}",
            f"{level['covered']:.3f}",
            f"{level['sd']:.3f}",
            f"{level['z']:+.1f}",
            "yes" if level["passes"] else "NO",
            f"{c['p_uniform']:.3f}",
            f"{c['median_set_size']:g}",
            f"{c['truth_ranked_first']:.2f}",
        )
        for c in results["cases"]
        for level in c["coverage"]
    )
    columns = tuple(Heading(h, h not in {"case", "layup", "passes"}) for h in headings)
    print(screen_text((Table("Randomised credible sets of sequences", columns, rows),), sys.stdout))


def sections(results: Results) -> dict[str, str]:
    """The table of docs/unknown_angles.md on how often sets contain the true stacking sequence."""
    cases = results["cases"]
    levels = [row["level"] for row in cases[0]["coverage"]]
    head = (
        "plates",
        "lists",
        *(f"{100 * level:g} % sets" for level in levels),
        "median 95 % set",
        "first",
    )
    rows = (
        (
            f"{c['case']}, `{c['layup']}`, {c['modes']} frequencies, grid of {c['step_deg']:g} degrees",
            str(len(c["trials"])),
            *(with_error(row["covered"], row["sd"]) for row in c["coverage"]),
            f"{c['median_set_size']:g}",
            f"{100 * c['truth_ranked_first']:.0f} %",
        )
        for c in cases
    )
    return {"coverage": markdown_table(head, rows)}


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--only", nargs="+", choices=tuple(CASES), help="cases to run (default: all)")
    parser.add_argument("--trials", type=int, help="lists of each case")
    add_executor_options(parser)
    args = parser.parse_args()
    only = None if args.only is None else tuple(args.only)
    with open_executor(args.executor, args.workers) as executor:
        if args.quick:
            show(run(True, executor, only, args.trials))
            return
        for name in only or CASES:
            results = run(False, executor, (name,), args.trials)
            save_results(RESULTS, with_saved(results, RESULTS, tuple(CASES)))
    found = saved_results(RESULTS)
    show(found)
    write_sections(Path(__file__).parents[1], RESULTS.stem, sections(found))


if __name__ == "__main__":
    main()
