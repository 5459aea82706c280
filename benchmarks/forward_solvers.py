"""Our forward solver beside others on the same plates: time and accuracy in one run.

python -m benchmarks.forward_solvers [--quick] [--rounds N] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.building import STACK, Ours, prepare
from benchmarks.cases import CASES, Array, Converged, converged, worst_error
from benchmarks.entries import FULL, Entry, our_entries, peer_entries
from benchmarks.targets import models, speeds
from benchmarks.timing import busy_processes, interleaved, ratio
from cpam_bayes.render.report import Heading, Table, remarks
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.running import single_blas_thread

Results = dict[str, Any]

# Accuracy that a peer has to reach, relative error of the worst frequency; coarse ones do in a quick run.
ACCURACY, QUICK_ACCURACY = 1e-3, 1e-2


@single_blas_thread
def run(quick: bool = False, rounds: int | None = None) -> Results:
    """Time all installed solvers; benchmarks/README.md says what the keys of the results mean."""
    cases = CASES[:1] if quick else CASES
    accuracy = QUICK_ACCURACY if quick else ACCURACY
    rounds = rounds or (2 if quick else 9)
    load = [busy_processes()]
    known = {case.name: converged(case) for case in cases}
    ours = [prepare(case, quick) for case in cases]
    entries = [entry for one in ours for entry in our_entries(one, known[one.case.name])]
    for case in cases:
        if case.is_bare:
            entries += peer_entries(case, known[case.name], accuracy, quick)
    calls = {entry.key: entry.call for entry in entries}
    timed = interleaved(calls, rounds, shortest=0.002 if quick else 0.01)
    building = [_building(one) for one in ours]
    times = {entry.key: timed[entry.key] / entry.sets for entry in entries}
    # against coarse peers the ratios would mean nothing
    targets = [] if quick else [t for case in cases for t in speeds(case, entries, times, accuracy)]
    for one in [] if quick else building:
        targets += models(one["case"], one["reduction_error"], one["seconds"], one["peak_mib"])
    return {
        "quick": quick,
        "rounds": rounds,
        "stack": STACK,
        "accuracy": accuracy,
        "load": [*load, busy_processes()],
        "converged": {name: _as_data(found) for name, found in known.items()},
        "rows": [_row(entry, times) for entry in entries],
        "building": building,
        "targets": [{**asdict(target), "reached": target.reached} for target in targets],
        "missing": _missing(),
    }


def _missing() -> list[str]:
    found = []
    if not peers.has_panels():
        found.append("panels: not installed; pip install panels==0.14")
    if not peers.has_calculix():
        found.append("CalculiX: not installed; Debian's package is calculix-ccx")
    return found


def _as_data(known: Converged) -> Results:
    return {
        "energy_consistent_hz": known.energy_consistent.tolist(),
        "five_sixths_hz": known.five_sixths.tolist(),
        "error": known.error,
    }


def _building(ours: Ours) -> Results:
    full, reduced = ours.full, ours.reduced
    exact = full.predict(ours.x).frequencies
    return {
        "case": ours.case.name,
        "parameters": full.parameters.size,
        "seconds": ours.seconds,
        "peak_mib": ours.peak_mib,
        "full_sizes": [block.size for block in full.operator.blocks],
        "reduced_sizes": [block.size for block in reduced.fast.operator.blocks],
        "reduction_error": worst_error(reduced.predict(ours.x).frequencies, exact),
    }


def _row(entry: Entry, times: Mapping[tuple[str, str], Array]) -> Results:
    own = times[entry.key]
    to_ours = ratio(own, times[entry.case, FULL])
    return {
        "case": entry.case,
        "solver": entry.solver,
        "size": entry.size,
        "sets": entry.sets,
        "rounds": int(np.isfinite(own).sum()),
        "median_s": float(np.nanmedian(own)),
        "ratio": to_ours.median,
        "ratio_quartiles": [to_ours.low, to_ours.high],
        "error": entry.error,
    }


def tables(results: Results) -> tuple[Table, ...]:
    """Tables of the results of ``run``."""
    rows = tuple(
        (
            row["case"],
            row["solver"],
            row["size"],
            _duration(row["median_s"]),
            _number(row["ratio"]),
            "{} to {}".format(*(_number(q) for q in row["ratio_quartiles"])),
            "" if row["error"] is None else f"{row['error']:.1e}",
        )
        for row in results["rows"]
    )
    columns = (
        *(Heading(heading) for heading in ("case", "solver", "size")),
        *(Heading(heading, True) for heading in ("median", "ratio to ours", "quartiles", "worst error")),
    )
    title = (
        "Time of one parameter set and its ratio to our full solve of the case, "
        f"medians of up to {results['rounds']} rounds"
    )
    return (
        Table(title, columns, rows),
        _targets_table(results["targets"]),
        remarks("Left out", tuple(results["missing"])),
        remarks("Load of the machine, before and after", (_loads(results["load"]),)),
    )


def _targets_table(targets: list[Results]) -> Table:
    rows = tuple(
        (
            target["case"],
            target["what"],
            _number(target["found"]),
            "" if target["reach"] is None else _number(target["reach"]),
            target["unit"],
            {True: "yes", False: "no", None: ""}[target["reached"]],
            target["against"],
        )
        for target in targets
    )
    headings = ("case", "what", "found", "to reach", "unit", "reached", "against")
    columns = tuple(Heading(heading, heading in ("found", "to reach")) for heading in headings)
    return Table("Figures to reach", columns, rows)


def _loads(load: list[float | None]) -> str:
    shown = ["not known" if value is None else f"{value:.1f}" for value in load]
    return f"{', '.join(shown)} processes on {os.cpu_count()} cores"


def _duration(seconds: float) -> str:
    unit, size = next(
        ((unit, size) for unit, size in (("s", 1.0), ("ms", 1e-3)) if seconds >= size), ("us", 1e-6)
    )
    return f"{_number(seconds / size)} {unit}"


def _number(value: float) -> str:
    if 0.0 < abs(value) < 1e-3:
        return f"{value:.1e}"
    return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"


def main() -> None:
    """Run the benchmark, print its tables and save its results if asked."""
    parser = argparse.ArgumentParser(description="Time our forward solver beside others.")
    parser.add_argument("--quick", action="store_true", help="one plate and coarse peers: does it run")
    parser.add_argument("--rounds", type=int, help="repetitions of every solver, 9 if left out")
    parser.add_argument("--json", type=Path, metavar="FILE", help="save the results")
    given = parser.parse_args()
    results = run(given.quick, given.rounds)
    print(screen_text(tables(results), sys.stdout))
    if given.json is not None:
        given.json.parent.mkdir(parents=True, exist_ok=True)
        given.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
