"""How long users wait for an answer from nothing, before and after a change, in one run.

python -m benchmarks.waits [--before TREE] [--only NAME ...] [--rounds N] [--limit S] [--json FILE]

Every case runs in a process of its own with an empty cache, before and after in turn. With --json FILE each
case is saved as soon as it is done; cases already in FILE that are not run again are kept.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from benchmarks.fresh import Wait, waited
from benchmarks.timing import busy_processes
from benchmarks.wait_tables import sections, tables
from cpam_bayes.render.terminal import screen_text
from studies.validation.reporting import save_results, with_saved, write_sections

Results = dict[str, Any]
Keep = Callable[[Results], None]

ROOT = Path(__file__).resolve().parent.parent
# The results that docs/speed.md is written from.
RESULTS = ROOT / "benchmarks" / "results" / "waits.json"
PLATES = ROOT / "benchmarks" / "plates"

KEYS = {
    "quick": "whether this is the small version",
    "waits": "one a command: what it is, seconds and GiB to reach, before and after",
    "solver": "one a row of benchmarks/forward_solvers.py: what it is, what to reach, before and after",
}


class Case(NamedTuple):
    """A command and its targets.

    what : row of the table that it belongs to
    reach_s, reach_gib : wall clock and memory on two quiet cores
    """

    name: str
    what: str
    arguments: tuple[str, ...]
    reach_s: float | None = None
    reach_gib: float | None = None


def _case(name: str, what: str, command: str, reach_s: float, reach_gib: float | None = None) -> Case:
    return Case(name, what, tuple(command.split()), reach_s, reach_gib)


def _sequences(what: str, names: str, reach_s: float) -> list[Case]:
    return [_case(f"sequence {n}", what, f"sequence {n}", reach_s, 3.0) for n in names.split()]


POSTERIOR, FIRST, SEQUENCE = "posterior from nothing", "first diagnose", "sequence, printed frequencies"
CASES = (
    _case("posterior C1", POSTERIOR, "identify C1 --backend emcee", 5.0),
    _case("posterior D1", POSTERIOR, "identify D1 --backend emcee", 12.0),
    _case("diagnose C1", FIRST, "diagnose C1", 7.0),
    _case("diagnose cross-ply, 12 modes", FIRST, f"diagnose {PLATES / 'cross_ply.toml'}", 15.0),
    _case("diagnose D4", FIRST, "diagnose D4", 60.0),
    _case("diagnose cross-ply, one sensor", FIRST, f"diagnose {PLATES / 'cross_ply_sensor.toml'}", 30.0),
    _case(
        *("sequence panel, two angles", f"{SEQUENCE}: two angles"),
        *(f"sequence {PLATES / 'panel_two_angles.toml'}", 15.0),
    ),
    *_sequences(f"{SEQUENCE}: thin, four angles", "C1 C2 C3 C4", 60.0),
    *_sequences(f"{SEQUENCE}: thick, four angles", "D2 D3 D4", 180.0),
    *_sequences(f"{SEQUENCE}: six angles", "F1 F2 G1", 180.0),
    *_sequences(f"{SEQUENCE}: six angles of G2", "G2", 300.0),
)
QUICK = Case("forward A1", "frequencies", ("forward", "A1"))


class SolverRow(NamedTuple):
    """A row of the forward solvers' targets; among several that are alike, the one at ``place``."""

    name: str
    case: str
    target: str
    unit: str
    reach: float
    at_least: bool
    place: int = 0


# The second of two alike is against all peers, including those that solve bending alone.
SOLVER_ROWS = (
    SolverRow("full solve C1, fastest peer", "C1", "a full solve", "times faster", 40.0, True, -1),
    SolverRow("full solve D1, fastest peer", "D1", "a full solve", "times faster", 12.0, True, -1),
    SolverRow(
        "reduced solve, any layup, peer with five fields",
        *("C1, any layup", "a reduced solve in 64", "times faster", 500.0, True),
    ),
    SolverRow(
        "worst relative error of a reduced solve",
        "C1, any layup",
        "worst error of the reduction",
        "",
        1e-4,
        False,
    ),
    SolverRow("derivatives, any layup", "C1, any layup", "with derivatives", "solves", 2.0, False),
    SolverRow(
        "derivatives, mass in a corner", "C1, mass in a corner", "with derivatives", "solves", 2.0, False
    ),
)
SOLVER = "solver"
NAMES = (*(case.name for case in CASES), SOLVER)
# Time limit for the forward solvers, s.
_SOLVER_LIMIT = 1800.0


def run(
    quick: bool = False,
    before: Path | None = None,
    only: Sequence[str] = (),
    rounds: int = 1,
    limit: float = 1800.0,
    keep: Keep = lambda results: None,
) -> Results:
    """Measure the named cases, or all; benchmarks/README.md says what the keys mean."""
    results: Results = {"quick": quick, "waits": [], "solver": []}
    trees = {"before": before, "after": ROOT}
    for case in [QUICK] if quick else [c for c in CASES if not only or c.name in only]:
        results["waits"].append(_row(case, trees, rounds, limit))
        keep(results)
    if not quick and (not only or SOLVER in only):
        results["solver"] = _solver_rows(trees)
        keep(results)
    return results


def _row(case: Case, trees: dict[str, Path | None], rounds: int, limit: float) -> Results:
    waits: dict[str, list[Wait]] = {name: [] for name, tree in trees.items() if tree is not None}
    for i in range(rounds):
        # in alternating order, so that a change in the machine's load or temperature favours neither
        for name in list(waits)[:: 1 if i % 2 == 0 else -1]:
            # a case that was stopped once is not tried again
            if not waits[name] or waits[name][-1].exit_status is not None:
                waits[name].append(_answer(case, trees[name] or ROOT, limit))
    return {
        "case": case.name,
        "what": case.what,
        "reach_s": case.reach_s,
        "reach_gib": case.reach_gib,
        "load": busy_processes(),
        **{name: _measured(waits[name], tree) if tree is not None else None for name, tree in trees.items()},
    }


def _answer(case: Case, tree: Path, limit: float) -> Wait:
    options = ("--seed", "0", "--json", "--quiet")
    return waited("cpam_bayes", (*case.arguments, *options), tree, limit)


def _measured(waits: Sequence[Wait], tree: Path) -> Results:
    """Medians over the rounds; ``seconds`` is the limit if it was stopped."""
    done = [w for w in waits if w.exit_status is not None]
    stopped = len(done) < len(waits)
    processor = [w.processor_seconds for w in done if w.processor_seconds is not None]
    return {
        "commit": _commit(tree),
        "rounds": len(waits),
        "stopped": stopped,
        "exit_status": None if stopped else done[-1].exit_status,
        "seconds": max(w.seconds for w in waits) if stopped else median(w.seconds for w in waits),
        "processor_seconds": None if stopped else median(processor),
        "peak_gib": max(w.peak_gib for w in waits),
        "answer": None if stopped else _said(done[-1].document or {}),
    }


def _said(document: Results) -> str | None:
    """The answer in a few words, to check that both trees give the same."""
    with suppress(KeyError, IndexError, TypeError):
        if "modes" in document:
            return f"{document['modes'][0]['frequency_hz']:.4g} Hz"
        if "claim" in document:
            return " ".join([document["claim"], *document["causes"]])
        if "sequences" in document:
            first = document["sequences"][0]
            return f"{first['angles_deg']} with {first['probability']:.2g}"
        if "constants" in document:
            return ", ".join(
                f"{n} {c.get('mean', c.get('value')):.4g}" for n, c in document["constants"].items()
            )
    return None


def _solver_rows(trees: dict[str, Path | None]) -> list[Results]:
    """Rows of the forward solvers, from a separate run in each tree."""
    measured: dict[str, tuple[list[Results], str] | None] = dict.fromkeys(trees)
    for name, tree in trees.items():
        if tree is None:
            continue
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "forward_solvers.json"
            wait = waited(
                "benchmarks.forward_solvers", ("--json", str(file)), tree, _SOLVER_LIMIT, inside=tree
            )
            if wait.exit_status != 0:
                print(f"benchmarks.forward_solvers of {name} ended with {wait.exit_status}", file=sys.stderr)
                continue
            measured[name] = (_targets(file), _commit(tree))
    return [
        {
            "case": row.name,
            "unit": row.unit,
            "reach": row.reach,
            "at_least": row.at_least,
            **{name: _value(row, *of) if of is not None else None for name, of in measured.items()},
        }
        for row in SOLVER_ROWS
    ]


def _targets(file: Path) -> list[Results]:
    targets: list[Results] = json.loads(file.read_text(encoding="utf-8"))["targets"]
    return targets


def _value(row: SolverRow, targets: Sequence[Results], commit: str) -> Results | None:
    alike = [t for t in targets if (t["case"], t["what"]) == (row.case, row.target)]
    if not alike:
        return None
    return {"commit": commit, "found": alike[row.place]["found"], "against": alike[row.place]["against"]}


def _commit(tree: Path) -> str:
    """Commit of a tree, with a plus if files differ from it; empty if git does not report it."""

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", *arguments], cwd=tree, capture_output=True, text=True, check=True
        ).stdout.strip()

    with suppress(OSError, subprocess.CalledProcessError):
        changed = git("status", "--porcelain", "--untracked-files=no", "cpam_bayes")
        return git("rev-parse", "--short", "HEAD") + ("+" if changed else "")
    return ""


def _tree(text: str) -> Path:
    if not (Path(text) / "cpam_bayes" / "__init__.py").exists():
        raise argparse.ArgumentTypeError(f"received {text!r}, accepted: a checkout of this project")
    return Path(text)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark, print its tables, save its results if asked, and write the page from kept ones."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one short command: does it run")
    parser.add_argument("--before", type=_tree, metavar="TREE", help="a checkout of an older version")
    parser.add_argument(
        "--only", nargs="+", default=(), choices=NAMES, metavar="NAME", help=f"of: {', '.join(NAMES)}"
    )
    parser.add_argument("--rounds", type=int, default=1, help="repetitions of every case (1)")
    parser.add_argument("--limit", type=float, default=1800.0, metavar="S", help="of every case (1800 s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="save the results")
    given = parser.parse_args(arguments)
    file: Path | None = given.json

    def keep(results: Results) -> None:
        if file is None:
            return
        order = [*NAMES, *(row.name for row in SOLVER_ROWS)]
        kept = with_saved(results, file, order) if not given.quick else results
        save_results(file, kept)
        if file.resolve() == RESULTS and not given.quick:
            write_sections(ROOT, "waits", sections(kept))

    results = run(given.quick, given.before, given.only, given.rounds, given.limit, keep)
    print(screen_text(tables(results), sys.stdout))


if __name__ == "__main__":
    main()
