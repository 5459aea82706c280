"""The paper's fourteen tables beside what this package computes; writes docs/comparison.md and its rows.

python studies/19_paper.py [--quick] [--missing] [--page] [--stored] [--workers N] [--executor SPEC]
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from cpam_bayes.command import add_executor_options
from cpam_bayes.fingerprint import fingerprint
from cpam_bayes.printed.tables import NUMBERS, identified_layups, printed_table
from cpam_bayes.questions.paper import compared, computations, tasks_of
from cpam_bayes.questions.paper.present import page, row_table
from cpam_bayes.questions.paper.work import (
    FULL,
    QUICK,
    Task,
    comes_with_the_package,
    diagnosis_row,
    frequency_scale,
    packaged,
    read,
)
from cpam_bayes.render.report import csv_text
from cpam_bayes.render.terminal import Terminal
from cpam_bayes.storage import cache_directory
from validation.fingerprints import fingerprint_of_study
from validation.reporting import save_results, study_parser, write_sections

Results = dict[str, Any]
Tasks = dict[Task, Results]

FOLDER = Path(__file__).parent
RESULTS = FOLDER / "results" / f"{Path(__file__).stem}.json"
STORED = Path(cb.__file__).parent / "data" / "paper" / "computed"

KEYS = {
    "quick": "whether this is the small version",
    "paper": "the document of `cpam-bayes paper --json`",
    "computations": "one each: title, and fingerprint of the code that did it",
}
COMPUTED_BY = "cpam_bayes.questions.paper.work"
SEED = 0
# Version and date of the study runs from which the package's stored results were taken.
RUNS = {
    "02_agreement": {"version": "0.2.0", "date": "2026-11-30"},
    "07_fpso": {"version": "0.2.0", "date": "2026-12-01"},
    "08_sequences": {"version": "0.2.0", "date": "2026-11-30"},
    "12_findings": {"version": "0.2.0", "date": "2026-12-01"},
}


def run(quick: bool, executor: str | None = "serial", workers: int | None = None) -> Results:
    """Results for all tables; quick: Table 7 with the small effort."""
    numbers = (7,) if quick else NUMBERS
    return judged(quick, numbers, computed(quick, False, executor, workers))


def judged(quick: bool, numbers: tuple[int, ...], tasks: Tasks) -> Results:
    """Results from finished computations, in the form that is saved."""
    done = [{"case": task.title, "fingerprint": found["fingerprint"]} for task, found in tasks.items()]
    document = compared(numbers, tasks, seed=SEED, quick=quick).to_dict()
    return {"quick": quick, "paper": document, "computations": done}


def computed(quick: bool, missing: bool, executor: str | None, workers: int | None) -> Tasks:
    """Run the computations, continuing a stopped run; missing : only those that the package lacks."""
    directory, effort = cache_directory() / "paper", QUICK if quick else FULL

    def known(task: Task) -> Results | None:
        return read(directory, effort, task) or (comes_with_the_package(task) if missing else None)

    numbers = (7,) if quick else NUMBERS
    spec, watch = executor or "processes", Terminal(quick)
    return computations(numbers, effort, SEED, known, directory, spec, workers, watch)


def stamped(found: Results) -> Results:
    """A computation of today's code with the fingerprint of its study, which undoes equivalent changes."""
    is_of_today = found["fingerprint"] == fingerprint(COMPUTED_BY)
    return {**found, "fingerprint": fingerprint_of_study(RESULTS.stem)} if is_of_today else found


def from_package() -> Results:
    """The results from the computations that come with the package, without computing anything."""
    packaged.cache_clear()
    tasks = dict.fromkeys(task for number in NUMBERS for task in tasks_of(number, SEED))
    found = {task: results for task in tasks if (results := comes_with_the_package(task)) is not None}
    return judged(False, NUMBERS, found)


def sections(results: Results) -> dict[str, str]:
    """The content of docs/comparison.md."""
    return {"tables": page(results["paper"])}


def rows_file(results: Results) -> str:
    """The content of docs/comparison.csv."""
    return csv_text(row_table(results["paper"]))


def stored(name: str) -> Results:
    """Results that come with the package under a name, made from those of studies 02, 07, 08 and 12."""
    return STORED_BY[name]()


def _results(study: str) -> Any:
    return json.loads((FOLDER / "results" / f"{study}.json").read_text("utf-8"))


def _seconds(each: dict[str, float]) -> Results:
    """Total seconds, and those of each plate."""
    return {"seconds": sum(each.values()), "seconds_each": each}


def _calculix() -> Results:
    specimens = _results("02_agreement")["specimens"]
    plates = {row["plate"]: row for row in specimens if row["bricks"] is not None}
    return {
        **RUNS["02_agreement"],
        "command": "python studies/02_agreement.py",
        **_seconds({name: row["bricks"]["seconds"] for name, row in plates.items()}),
        "frequencies_hz": {
            name: [
                f * (1.0 + d / 100.0)
                for f, d in zip(row["frequencies_hz"], row["bricks"]["deviations_percent"], strict=True)
            ]
            for name, row in plates.items()
        },
    }


def _sequences() -> Results:
    every = _results("08_sequences")["cases"]
    cases = {row["case"]: row for row in every if row["case"] in identified_layups()}
    return {
        **RUNS["08_sequences"],
        "command": "python studies/08_sequences.py",
        **_seconds({name: row["seconds"] for name, row in cases.items()}),
        "cases": {
            name: {
                **{key: row[key] for key in ("enumerated", "credible_95_count", "unaccounted")},
                "most_probable": {k: row["most_probable"][k] for k in ("angles_deg", "probability")},
                "printed": row["printed"],
            }
            for name, row in cases.items()
        },
    }


def _swarms() -> Results:
    """Final sequences of noise-free searches of angles and constants, for the plates of Tables 11 to 14."""
    names = {row.specimen for n in (11, 12, 13, 14) for row in printed_table(n).rows}
    every = _results("07_fpso")["cases"]
    free = {row["case"]: row for row in every if row["data"] == "printed" and row["case"] in names}
    return {
        **RUNS["07_fpso"],
        "command": "python studies/07_fpso.py",
        **_seconds(
            {
                name: row["cost"]["solve_s"] * sum(run["evaluations"] for run in row["runs"])
                for name, row in free.items()
            }
        ),
        "cases": {
            name: {"angles_deg": [run["angles_deg"] for run in row["runs"]]} for name, row in free.items()
        },
    }


def _diagnoses() -> Results:
    """Diagnoses, each with the factor on the plate's frequencies, which takes a second per plate."""
    groups = _results("12_findings")["groups"]
    alone = {row["plates"][0]: row for row in groups if len(row["plates"]) == 1}
    measured = {row.specimen for n in (1, 4) for row in printed_table(n).rows}
    diagnosed = {name: row for name, row in alone.items() if name in measured}
    return {
        **RUNS["12_findings"],
        "command": "python studies/12_findings.py",
        **_seconds({name: row["seconds"] for name, row in diagnosed.items()}),
        "plates": {name: {**diagnosis_row(row), **frequency_scale(name)} for name, row in diagnosed.items()},
    }


STORED_BY = {"calculix": _calculix, "sequences": _sequences, "swarms": _swarms, "diagnoses": _diagnoses}


def main() -> None:
    """Run the study, save the results and write the page."""
    parser = study_parser(__doc__)
    parser.add_argument("--missing", action="store_true", help="compute only what the package lacks")
    parser.add_argument(
        "--page", action="store_true", help="only judge what comes with the package, and write the page"
    )
    parser.add_argument(
        "--stored", action="store_true", help="only write the results that come with the package"
    )
    add_executor_options(parser)
    args = parser.parse_args()
    if args.stored:
        for name in STORED_BY:
            save_results(STORED / f"{name}.json", stored(name))
        return
    if args.quick:
        print(page(run(True, args.executor, args.workers)["paper"]))
        return
    if not args.page:
        tasks = computed(False, args.missing, args.executor, args.workers)
        content = {"seed": SEED, "tasks": {task.title: stamped(found) for task, found in tasks.items()}}
        save_results(STORED / "tasks.json", content)
    saved = from_package()
    save_results(RESULTS, saved)
    write_sections(FOLDER.parent, RESULTS.stem, sections(saved))
    (FOLDER.parent / "docs" / "comparison.csv").write_text(rows_file(saved), encoding="utf-8", newline="")


if __name__ == "__main__":
    main()
