"""What do a sister plate and a further test of the plate add to a diagnosis?

python studies/13_several_plates.py [--quick] [--workers N | --executor SPEC] [--per-cause N]
    [--causes NAME ...]

A flaw is hidden in a square cross-ply plate with free edges, as large as a signal-to-noise ratio of 8 asks of
its list of six frequencies with 0.2 % of noise. The list is diagnosed alone, with that of a sister plate that
nothing is wrong with and whose constants scatter by 2 %, with that of the same plate clamped on one edge, and
with that of the same plate carrying a known mass near a corner. Lists are those of independent elements
(studies/validation/several_plates.py). A flaw in all setups takes three minutes; saved trials are kept.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.command import add_executor_options
from cpam_bayes.parallel import open_executor
from cpam_bayes.parallel import run as share_out
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.claims import scoring
from validation.fingerprints import stamped
from validation.independent.lists import NOISE, RESOLUTION_HZ, NominalPlate
from validation.independent.true_plate import FLAWS, TruePlate
from validation.reporting import (
    markdown_table,
    save_results,
    saved_results,
    study_parser,
    write_sections,
)
from validation.several_plates import ALONE, SETUPS, SISTER, Laboratory, spread, trial

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "plate": "layup, frequencies in a list, noise, resolution in Hz and signal to noise",
    "setups": "one each: trials, how many of each category, mean probability, spread of the constants",
    "by_cause": "mean probability of the hidden cause in every setup",
    "unreachable": "flaws that cannot have the signal to noise, and why",
    "trials": "the records",
}

SEED = 0
CARBON = {"E1": 130e9, "E2": 8.8e9, "nu12": 0.29, "G12": 4.9e9}
CROSS_PLY = ("[0/90]_2s", (0.0, 90.0, 0.0, 90.0, 90.0, 0.0, 90.0, 0.0))
PLATE = NominalPlate(
    "panel",
    TruePlate(0.25, 0.25, 2.4e-3, 1580.0, "FFFF", CROSS_PLY[1], CARBON),
    CROSS_PLY[0],
    "carbon",
    known=True,
    n_modes=6,
)
RATIO = 8.0
# Flaws of one plate that it has free and clamped: one of each family.
CAUSES = (
    *("sensor_mass", "length", "taper_x", "warp"),
    *("misorientation", "outer_ply_angle", "membrane_stress", "damage"),
)
QUICK_CAUSE, QUICK_AMONG = "length", ("length", "frequency_scale", "viscoelastic")
# The order of rows.
ORDER = tuple(FLAWS)


def run(
    quick: bool,
    executor: Executor | None = None,
    per_cause: int = 1,
    causes: Sequence[str] = CAUSES,
    path: Path | None = None,
) -> Results:
    """The trials that are saved at a path and those that are not, saved one by one; quick: one, not saved,
    among few causes.
    """
    setups = (ALONE, SISTER) if quick else SETUPS
    items = [(cause, n) for n in range(1 if quick else per_cause) for cause in causes]
    items = [(QUICK_CAUSE, 0)] if quick else items
    saved = saved_results(path) if path else {}
    records = [*saved.get("trials", []), *saved.get("unreachable", [])]
    known = {(r["cause"], r["number"]) for r in records}

    def keep(index: int, record: Results) -> None:
        records.append(stamped(record, path) if path else record)
        if path:
            save_results(path, as_results(records, setups, quick=quick))
            print(f"{len(records)} trials", file=sys.stderr, flush=True)

    own = Laboratory(PLATE, RATIO, SEED, setups, QUICK_AMONG if quick else ())
    missing = [item for item in items if item not in known]
    if missing:
        share_out(trial, own, missing, executor, batch_size=1, on_result=keep)
    return as_results(records, setups, quick=quick)


def as_results(records: Sequence[Results], setups: Sequence[str], *, quick: bool) -> Results:
    """What is saved of trials, in the order of causes and numbers."""
    every = sorted(records, key=lambda r: (ORDER.index(r["cause"]), r["number"]))
    done = [r for r in every if "setups" in r]
    return {
        "quick": quick,
        "plate": [PLATE.layup, PLATE.n_modes, NOISE, RESOLUTION_HZ, RATIO],
        "setups": [_summary(setup, done) for setup in setups] if done else [],
        "by_cause": [
            {
                "cause": cause,
                "trials": len(of),
                **{s: float(np.mean([r["setups"][s]["cause_probability"] for r in of])) for s in setups},
            }
            for cause in ORDER
            for of in [[r for r in done if r["cause"] == cause]]
            if of
        ],
        "unreachable": [r for r in every if "unreachable" in r],
        "trials": done,
    }


def _summary(setup: str, records: list[Results]) -> Results:
    own = [r["setups"][setup] for r in records]
    (counts,) = scoring.confusion(own, lambda r: setup)
    cover = scoring.coverage(own)
    return {
        "setup": setup,
        "trials": len(own),
        **{category: counts[category] for category in scoring.CATEGORIES},
        "named": sum(a["claim"] == "named" for a in own),
        "cause_probability": float(np.mean([a["cause_probability"] for a in own])),
        "constants_spread": spread(own, [r["setups"][ALONE] for r in records]),
        "inside": round(cover["share"] * cover["constants"]),
        "constants": cover["constants"],
        "processor_seconds": float(np.mean([a["seconds"] for a in own])),
    }


HEAD = (
    *("measured", "trials", "claimed and right", "claimed and wrong", "other, undecided or none"),
    *("probability of the cause, mean", "constants in their 95 % intervals", "spread of the constants"),
)


def _rows(results: Results) -> list[tuple[str, ...]]:
    return [
        (
            s["setup"],
            str(s["trials"]),
            str(s[scoring.RIGHT]),
            str(s[scoring.WRONG]),
            str(s["trials"] - s[scoring.RIGHT] - s[scoring.WRONG]),
            f"{s['cause_probability']:.2f}",
            f"{s['inside']} of {s['constants']}",
            f"{s['constants_spread']:.2f}",
        )
        for s in results["setups"]
    ]


def show(results: Results) -> None:
    """Print the results as tables."""
    first = Table(
        "What else is measured", tuple(Heading(t, i > 0) for i, t in enumerate(HEAD)), tuple(_rows(results))
    )
    setups = [r["setup"] for r in results["setups"]]
    heads = (Heading("hidden"), Heading("trials", True), *(Heading(s, True) for s in setups))
    lines = tuple(
        (r["cause"], str(r["trials"]), *(f"{r[s]:.2f}" for s in setups)) for r in results["by_cause"]
    )
    print(screen_text((first, Table("Probability of the hidden cause", heads, lines)), sys.stdout))


def sections(results: Results) -> dict[str, str]:
    """The table of docs/hidden_effects.md: what a further plate or test adds."""
    return {"setups": markdown_table(HEAD, _rows(results))}


def main() -> None:
    """Run the study, print its tables and save the results."""
    parser = study_parser(__doc__)
    add_executor_options(parser)
    parser.add_argument("--per-cause", type=int, default=1, metavar="N", help="trials of each cause")
    parser.add_argument(
        "--causes", nargs="+", choices=ORDER, default=CAUSES, metavar="NAME", help="flaws that are hidden"
    )
    args = parser.parse_args()

    with open_executor(args.executor, args.workers) as executor:
        results = run(args.quick, executor, args.per_cause, args.causes, None if args.quick else RESULTS)
    show(results)
    if not args.quick:
        save_results(RESULTS, results)
        write_sections(Path(__file__).parents[1], RESULTS.stem, sections(results))


if __name__ == "__main__":
    main()
