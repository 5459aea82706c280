"""The paper's fourteen tables beside what this package computes; writes docs/comparison.md and its rows.

python studies/19_paper.py [--quick] [--page] [--stored] [--workers N] [--executor SPEC]
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from cpam_bayes.command import add_executor_options
from cpam_bayes.printed.tables import identified_layups, printed_table
from cpam_bayes.questions.paper.present import page, row_table
from cpam_bayes.questions.paper.work import diagnosis_row
from cpam_bayes.render.report import csv_text
from cpam_bayes.render.terminal import Terminal
from validation.reporting import (
    save_results,
    study_parser,
    write_sections,
)

Results = dict[str, Any]

FOLDER = Path(__file__).parent
RESULTS = FOLDER / "results" / f"{Path(__file__).stem}.json"
STORED = Path(cb.__file__).parent / "data" / "paper" / "computed"

KEYS = {
    "quick": "whether this is the small version",
    "paper": "the document of `cpam-bayes paper --json`",
}
SEED = 0
# When the studies that the package's stored results are taken from were run.
DATES = {"02_agreement": "2026-11-21", "08_sequences": "2026-11-22", "12_findings": "2026-11-23"}


def run(quick: bool, executor: str | None = "serial", workers: int | None = None) -> Results:
    """All tables; quick: Table 7 with the small effort."""
    number = 7 if quick else None
    spec = executor or "processes"
    result = cb.paper(number, quick=quick, seed=SEED, executor=spec, workers=workers, watch=Terminal(quick))
    return {"quick": quick, "paper": result.to_dict()}


def sections(results: Results) -> dict[str, str]:
    """The content of docs/comparison.md."""
    return {"tables": page(results["paper"])}


def rows_file(results: Results) -> str:
    """The content of docs/comparison.csv."""
    return csv_text(row_table(results["paper"]))


def stored() -> dict[str, Results]:
    """The results that come with the package, from those of studies 02, 08 and 12."""
    agreement, sequences, findings = (
        json.loads((FOLDER / "results" / f"{name}.json").read_text("utf-8")) for name in DATES
    )
    plates = {row["plate"]: row for row in agreement["specimens"] if row["bricks"] is not None}
    cases = {row["case"]: row for row in sequences["cases"] if row["case"] in identified_layups()}
    measured = {row.specimen for n in (1, 4) for row in printed_table(n).rows}
    alone = {row["plates"][0]: row for row in findings["groups"] if len(row["plates"]) == 1}
    diagnosed = {name: row for name, row in alone.items() if name in measured}
    common = {name: {"version": cb.__version__, "date": DATES[name]} for name in DATES}
    return {
        "calculix": {
            **common["02_agreement"],
            "command": "python studies/02_agreement.py",
            "seconds": sum(row["bricks"]["seconds"] for row in plates.values()),
            "seconds_each": {name: row["bricks"]["seconds"] for name, row in plates.items()},
            "frequencies_hz": {
                name: [
                    f * (1.0 + d / 100.0)
                    for f, d in zip(row["frequencies_hz"], row["bricks"]["deviations_percent"], strict=True)
                ]
                for name, row in plates.items()
            },
        },
        "sequences": {
            **common["08_sequences"],
            "command": "python studies/08_sequences.py",
            "seconds": sum(row["seconds"] for row in cases.values()),
            "cases": {
                name: {
                    **{key: row[key] for key in ("enumerated", "credible_95_count", "unaccounted")},
                    "most_probable": {k: row["most_probable"][k] for k in ("angles_deg", "probability")},
                    "printed": row["printed"],
                }
                for name, row in cases.items()
            },
        },
        "diagnoses": {
            **common["12_findings"],
            "command": "python studies/12_findings.py",
            "seconds": sum(row["seconds"] for row in diagnosed.values()),
            "plates": {name: diagnosis_row(row) for name, row in diagnosed.items()},
        },
    }


def main() -> None:
    """Run the study, save the results and write the page."""
    parser = study_parser(__doc__)
    parser.add_argument("--page", action="store_true", help="only write the page from the saved results")
    parser.add_argument(
        "--stored", action="store_true", help="only write the results that come with the package"
    )
    add_executor_options(parser)
    args = parser.parse_args()
    if args.stored:
        for name, content in stored().items():
            save_results(STORED / f"{name}.json", content)
        return
    if not args.page:
        results = run(args.quick, args.executor, args.workers)
        if args.quick:
            print(page(results["paper"]))
            return
        save_results(RESULTS, results)
    saved = json.loads(RESULTS.read_text("utf-8"))
    write_sections(FOLDER.parent, RESULTS.stem, sections(saved))
    (FOLDER.parent / "docs" / "comparison.csv").write_text(rows_file(saved), encoding="utf-8", newline="")


if __name__ == "__main__":
    main()
