"""The paper's noise study, Tables 10 to 14, beside posteriors at the same noise.

python studies/04_sensitivity.py [--quick] [--workers N] [--executor SPEC]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from cpam_bayes.command import add_executor_options
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.reporting import (
    save_results,
    study_parser,
)

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "model": "documents of `sensitivity PLATE`, the plate model's own list, both readings",
    "measured": "documents of `sensitivity PLATE --list measured --reading rms`, as the paper did it",
}

SEED = 0
PLATES = ("A2", "C1", "C3", "D1", "D3")
LEVELS = (0.01, 0.05, 0.1)
GROUPS = 10
SMALL_SWARM = SwarmSettings(particles=20, iterations=60)
SHORT_CHAINS = EnsembleSettings(walkers=16, round_steps=150, most_steps=150)


def run(quick: bool, executor: str | None = "serial", workers: int | None = None) -> Results:
    """All five plates; quick: A2 with three groups at one level, far from converged."""
    effort = {"levels": LEVELS, "groups": GROUPS, "executor": executor, "workers": workers}
    if quick:
        effort |= {"levels": LEVELS[:1], "groups": 3, "settings": SMALL_SWARM, "chains": SHORT_CHAINS}
    asked = {"model": {}, "measured": {"readings": ("rms",)}}
    return {
        "quick": quick,
        **{
            source: [
                cb.sensitivity(name, seed=SEED, source=source, **readings, **effort).to_dict()
                for name in (PLATES[:1] if quick else PLATES)
            ]
            for source, readings in asked.items()
        },
    }


def show(results: Results) -> None:
    """Print one row for each plate, level, reading and constant."""
    columns = (
        *(Heading("plate"), Heading("noise %", number=True), Heading("reading"), Heading("name")),
        *(Heading(h, number=True) for h in ("paper %", "error %", "se %", "posterior %", "sd ratio")),
        Heading("verdict"),
    )
    for source in ("model", "measured"):
        rows = [
            row
            for document in results[source]
            for level in document["levels"]
            for reading, own in level["readings"].items()
            for row in _rows(document, level["level_percent"], reading, own["constants"])
        ]
        title = f"Noise on the {source} list; posterior %: its mean against the inversion without noise"
        print(screen_text((Table(title, columns, tuple(rows)),), sys.stdout))


def _rows(document: Results, percent: float, reading: str, constants: Results) -> list[tuple[str, ...]]:
    found = []
    for name, own in constants.items():
        reference = document["without_noise"]["constants"][name]["value"]
        printed = own["paper_percent_error"]
        found.append(
            (
                document["plate"],
                f"{percent:g}",
                reading,
                name,
                "" if printed is None else f"{printed:+.2f}",
                f"{own['percent_error']:+.2f}",
                f"{own['percent_standard_error']:.2f}",
                f"{100 * (own['posterior_mean'] / reference - 1):+.2f}",
                f"{own['sd_ratio']:.2f}",
                ", ".join(own["causes"]) or "agree",
            )
        )
    return found


def main() -> None:
    """Run the study, print its tables and save the results."""
    parser = study_parser(__doc__)
    add_executor_options(parser)
    args = parser.parse_args()
    results = run(args.quick, args.executor, args.workers)
    show(results)
    if not args.quick:
        save_results(RESULTS, results)


if __name__ == "__main__":
    main()
