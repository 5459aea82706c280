"""What do the noisy lists of Tables 11 to 14 tell of the plies, all stacking sequences weighed?

python studies/30_noisy_layups.py [--quick] [--minutes M]

The ten lists of each of three levels of noise on C1, C3, D1 and D3, the same that the paper's swarm is run on
(`cpam-bayes paper`), their noise stated: bits a ply, and the probabilities of the true and of the printed
angles. The first list of every plate and level comes first, then the second. Runs go on from the saved lists.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.printed.tables import TABLES, printed_table
from cpam_bayes.questions.paper.layups import weighed_list
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.reporting import case_by_case, paragraph, study_parser, write_sections

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"
COMPUTED_BY = "cpam_bayes.questions.paper.layups"

KEYS = {
    "quick": "whether this is the small version",
    "summary": "by plate and level: lists, mean bits by ply, outermost first; how many less of the innermost",
    "cases": "one a list: plate, noise, bits a ply, probabilities of the true and of the printed angles",
}

SEED, LISTS = 0, 10
PLATES = ("C1", "C3", "D1", "D3")


def numbered() -> list[tuple[str, int, float]]:
    """Plate, list of its level, and level of every case, by its number."""
    levels = {p: [r.level_percent for r in printed_table(TABLES[p]).rows if r.level_percent] for p in PLATES}
    return [(plate, i, level) for i in range(LISTS) for plate in PLATES for level in levels[plate]]


def run_case(number: int) -> Results:
    """The posterior over the layups of one list."""
    plate, i, level = numbered()[number]
    begin = time.process_time()
    found = weighed_list(plate, TABLES[plate], level, SEED, i)
    found.pop("constants")
    return {"case": number, "plate": plate, "list": i + 1, **found, "seconds": time.process_time() - begin}


def summary(cases: Sequence[Results]) -> list[Results]:
    """Means over the lists of each plate and level, and what they tell of the innermost ply."""
    found = []
    for plate, level in sorted({(c["plate"], c["level_percent"]) for c in cases}):
        lists = [c for c in cases if (c["plate"], c["level_percent"]) == (plate, level)]
        bits = np.array([c["bits"] for c in lists])
        found.append(
            {
                "plate": plate,
                "level_percent": level,
                "lists": len(lists),
                "mean_bits": bits.mean(axis=0).round(3).tolist(),
                "less_of_innermost": int(np.sum(bits[:, -1] < bits[:, 0])),
                "largest_true_probability": max(c["true_probability"] for c in lists),
                "largest_printed_probability": max(c["printed_probability"] for c in lists),
            }
        )
    return found


def as_results(cases: list[Results], *, quick: bool) -> Results:
    """What is saved of the lists that are done."""
    return {"quick": quick, "summary": summary(cases), "cases": cases}


def run(quick: bool, minutes: float = np.inf) -> Results:
    """The lists that are saved and those that are not, saved one by one; quick: the first one."""
    numbers = range(1) if quick else range(len(numbered()))
    path = None if quick else RESULTS
    return case_by_case(numbers, run_case, partial(as_results, quick=quick), minutes=minutes, path=path)


def show(results: Results) -> None:
    """Print the summary as a table."""
    headings = ("plate", "noise, %", "lists", "bits, outermost", "innermost", "less of the innermost")
    rows = tuple(
        (
            s["plate"],
            f"{s['level_percent']:g}",
            str(s["lists"]),
            f"{s['mean_bits'][0]:.2f}",
            f"{s['mean_bits'][-1]:.2f}",
            str(s["less_of_innermost"]),
        )
        for s in results["summary"]
    )
    print(screen_text((Table("Lists", tuple(Heading(h, h != "plate") for h in headings), rows),)))


def sections(results: Results) -> dict[str, str]:
    """What docs/unknown_angles.md says of the plies."""
    each = results["summary"]
    lists, less = (sum(s[key] for s in each) for key in ("lists", "less_of_innermost"))
    weights = [s["lists"] for s in each]
    outer, inner = (np.average([s["mean_bits"][i] for s in each], weights=weights) for i in (0, -1))
    most = results["cases"][0]["most_bits"]
    return {
        "plies": paragraph(
            f"{lists} noisy lists of Tables 11 to 14, all layups weighed, tell {outer:.2f} bits of the "
            f"outermost angle and {inner:.2f} of the innermost, of {most:.2f}; less of that in {less}."
        )
    }


def main() -> None:
    """Weigh the lists that are not saved yet."""
    parser = study_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=np.inf, help="no further list is begun after these")
    options = parser.parse_args()
    found = run(options.quick, options.minutes)
    show(found)
    if not options.quick:
        write_sections(Path(__file__).parents[1], RESULTS.stem, sections(found))


if __name__ == "__main__":
    main()
