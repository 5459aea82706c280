"""The paper's noise study, Tables 10 to 14, beside posteriors at the same noise.

python studies/04_sensitivity.py [--quick] [--workers N]
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from cpam_bayes.inference.chains.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.paper import perturbation_table
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import builtin
from cpam_bayes.repetition.perturbation import INTERPRETATIONS, Interpretation
from cpam_bayes.repetition.study import ENSEMBLE_SETTINGS, model_list, sensitivity
from cpam_bayes.report.documents import json_text
from cpam_bayes.report.repetition.screen import sensitivity_document
from cpam_bayes.report.repetition.words import printed_table, sensitivity_warnings
from cpam_bayes.report.tables import Column, Table, screen_text
from cpam_bayes.validation.study_results import save_results

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


def run(quick: bool, executor: Executor | None = None) -> Results:
    """All five plates; quick: A2 with three groups at one level, far from converged."""
    plates = PLATES[:1] if quick else PLATES
    return {
        "quick": quick,
        "model": [_study(name, "model", INTERPRETATIONS, quick, executor) for name in plates],
        "measured": [_study(name, "measured", ("rms",), quick, executor) for name in plates],
    }


def _study(
    name: str, source: str, readings: tuple[Interpretation, ...], quick: bool, executor: Executor | None
) -> Results:
    specimen = builtin(name)
    if source == "model":
        assert specimen.measurement is not None
        specimen = model_list(specimen, specimen.measurement.size)
    result = sensitivity(
        specimen,
        SEED,
        source="model" if source == "model" else "measured",
        levels=LEVELS[:1] if quick else LEVELS,
        groups=3 if quick else GROUPS,
        readings=readings,
        swarm_settings=SwarmSettings(particles=20, iterations=60) if quick else None,
        chains=EnsembleSettings(walkers=16, round_steps=150, most_steps=150) if quick else ENSEMBLE_SETTINGS,
        executor=executor,
    )
    table = printed_table(result, perturbation_table(name))
    document = sensitivity_document(result, SEED, table, sensitivity_warnings(result))
    plain: Results = json.loads(json_text(document))
    return plain


def show(results: Results) -> None:
    """Print one row for each plate, level, reading and constant."""
    columns = (
        *(Column("plate"), Column("noise %", number=True), Column("reading"), Column("name")),
        *(Column(h, number=True) for h in ("paper %", "error %", "se %", "posterior %", "sd ratio")),
        Column("verdict"),
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
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the small version; nothing is saved")
    parser.add_argument("--workers", type=int, metavar="N", help="number of processes (default: one a core)")
    args = parser.parse_args()
    with open_executor(None, args.workers) as executor:
        results = run(args.quick, executor)
    show(results)
    if not args.quick:
        save_results(RESULTS, results)


if __name__ == "__main__":
    main()
