"""What the diagnosis says of plates of bricks with one thing wrong, or nothing.

python studies/17_worked_cases.py [--quick] [--only [CASE ...]] [--measure [CASE ...]]

The cases are those of `validation/brick_cases.py`: plates that are not built in, with constants a few per
cent off their files', a flaw in geometry, masses or supports of three-dimensional bricks, and 0.2 % of
noise. Their plate files are in `studies/data/bricks` with their truths beside them; --measure makes them anew
with CalculiX, all or those named, in about a minute each. Every file is then diagnosed as it is.

An answer is `right` if it names the cause alone, or none if nothing is wrong; `right as a class` if the cause
is among several that it calls indistinguishable; `other`, `undecided`; `calm` if it says none though
something is wrong; and otherwise `wrong`.

Cases that are saved are not diagnosed again unless they are named with --only, which alone runs none. The
page docs/hidden_effects.md is written from the saved results.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import cpam_bayes as cb
from cpam_bayes.effects import CATALOGUE
from validation.brick_cases import (
    CASES,
    BrickCase,
    listed_frequencies,
    plate_file,
    true_frequencies,
    truth_of,
)
from validation.reporting import save_results, saved_results, with_saved, write_sections

Results = dict[str, Any]

HERE = Path(__file__).parent
RESULTS = HERE / "results" / f"{Path(__file__).stem}.json"
BRICKS = HERE / "data" / "bricks"
TRUTHS = BRICKS / "truths.json"

KEYS = {
    "quick": "whether this is the small version",
    "cases": "one plate: its truth, the answer, the causes by probability, constants and residuals",
}

NAMED = {effect.name for effect in CATALOGUE}
# Names that mean the same as the cause.
SAME = {"soft_clamp": {"clamp_rotation", "clamp_translation"}}
# A size counts as inside within this number of its standard deviations: 95 % of a normal.
HELD = 1.96
SHOWN_CAUSES = 6
_QUICK = "clean_clamped"
_QUICK_CATALOGUE = tuple(effect for effect in CATALOGUE if effect.change is effect.on_plate is None)


def verdict(cause: str, claim: str, causes: Iterable[str]) -> str:
    """Verdict on an answer, given the truth, in the words of this study."""
    claimed = set(causes)
    if claim == "none":
        return "right" if cause == "none" else "calm"
    if claim == "undecided":
        return "undecided"
    if claim == "other":
        return "wrong" if cause == "none" else "right" if cause not in NAMED else "other"
    if claim == "pair":
        return "right" if claimed == SAME.get(cause) else "wrong"
    if cause not in claimed:
        return "wrong"
    return "right" if len(claimed) == 1 else "right as a class"


def row_of(truth: Mapping[str, Any], document: Mapping[str, Any]) -> Results:
    """Results row with the parts of a plate's answer that are kept.

    truth : of `truths.json`
    document : the JSON document of `diagnose`
    """
    extended = document["extended"]
    constants = document["averaged"]
    before, after = (None if fit is None else _residuals(fit) for fit in (document["baseline"], extended))
    return {
        "case": truth["case"],
        "truth": {"cause": truth["cause"], "size": truth["size"]},
        "claim": document["claim"],
        "causes": list(document["causes"]),
        "probability": document["probability"],
        "verdict": verdict(truth["cause"], document["claim"], document["causes"]),
        "sentence": document["sentence"],
        "hypotheses": [_hypothesis(h) for h in _shown(document["hypotheses"], truth["cause"])],
        "constants": [
            {
                "name": name,
                "truth": value,
                "mean": found["mean"],
                "q025": found["q025"],
                "q975": found["q975"],
                "covered": found["q025"] <= value <= found["q975"],
            }
            for name, value, found in ((k, v, constants[k]) for k, v in truth["constants"].items())
        ],
        "rms_percent_before": document["baseline"]["rms_as_stated_percent"],
        "rms_percent_after": None if extended is None else extended["rms_as_stated_percent"],
        "residuals_percent_before": before,
        "residuals_percent_after": after,
        "seconds": document["seconds"],
    }


def _shown(hypotheses: list[dict[str, Any]], cause: str) -> list[dict[str, Any]]:
    """The most probable causes, and the true one."""
    first = hypotheses[:SHOWN_CAUSES]
    return first + [h for h in hypotheses[SHOWN_CAUSES:] if h["cause"] == cause]


def _hypothesis(h: Mapping[str, Any]) -> Results:
    kept = ("cause", "probability", "log_bayes_factor", "parameters")
    return {key: h[key] for key in kept}


def _residuals(fit: Mapping[str, Any]) -> list[float | None]:
    return [f["residual_percent"] for f in fit["frequencies"]]


def run(
    quick: bool, only: Iterable[str] | None = None, done: Callable[[Results], None] = lambda row: None
) -> Results:
    """Diagnoses of the named cases, or all; quick: one, with only causes that need no further plate model.

    done : called with the row of each case as soon as it is there.
    """
    truths = json.loads(TRUTHS.read_text(encoding="utf-8"))
    rows = []
    for name in [_QUICK] if quick else list(CASES if only is None else only):
        catalogue = _QUICK_CATALOGUE if quick else CATALOGUE
        document = cb.diagnose(BRICKS / f"{name}.toml", next_test="never", catalogue=catalogue).to_dict()
        rows.append(row_of(truths[name], document))
        done(rows[-1])
    return {"quick": quick, "cases": rows}


def measure(names: Iterable[str]) -> None:
    """Solve the bricks of cases and write their plate files and truths."""
    BRICKS.mkdir(parents=True, exist_ok=True)
    truths = json.loads(TRUTHS.read_text(encoding="utf-8")) if TRUTHS.exists() else {}
    for name in names:
        case = CASES[name]
        f = true_frequencies(case, case.n_modes)
        (BRICKS / f"{name}.toml").write_text(plate_file(case, listed_frequencies(case, f)), encoding="utf-8")
        truths[name] = truth_of(case, f)
        ordered = {key: truths[key] for key in CASES if key in truths}
        TRUTHS.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
        print(name, ", ".join(f"{v:.1f}" for v in f), "Hz", flush=True)


def sections(results: Results) -> dict[str, str]:
    """Section of docs/hidden_effects.md on the cases."""
    rows = results["cases"]
    words = [row["verdict"] for row in rows]
    counts = ", ".join(f"{word} {words.count(word)}" for word in dict.fromkeys(sorted(words)))
    covered = [c["covered"] for row in rows for c in row["constants"]]
    summary = (
        f"{len(rows)} plates: {counts}. {sum(covered)} of {len(covered)} true constants lie in their 95 % "
        f"intervals{_missed(rows)}. {_sizes(rows)}"
    )
    return {"cases": "\n".join([summary, "", _TABLE, *map(_line, rows)])}


def _line(row: Results) -> str:
    size = row["truth"]["size"] if row["truth"]["cause"] != "none" else "nothing"
    cells = (row["case"], size, row["sentence"], row["verdict"])
    return f"| {' | '.join(cells)} |"


def _sizes(rows: Iterable[Results]) -> str:
    """Sentence on how many sizes of the true causes lie in their intervals, and which do not."""
    said, sizes = list[str](), 0
    for row in rows:
        found = {h["cause"]: h["parameters"] for h in row["hypotheses"]}[row["truth"]["cause"]]
        for name, truth in true_sizes(CASES[row["case"]]).items():
            mean, sd, sizes = found[name]["mean"], found[name]["sd"], sizes + 1
            if abs(mean - truth) > HELD * sd:
                said.append(f"{row['case']}, true {truth:.3g}: {mean:.3g} +- {sd:.2g}")
    missed = f" (not {'; '.join(said)})" if said else ""
    return f"So do {sizes - len(said)} of {sizes} sizes of the true causes{missed}."


def true_sizes(case: BrickCase) -> dict[str, float]:
    """Sizes of a true cause by parameter, in the unit of the answer, if the truth has one."""
    flaws, area = case.flaws, math.prod(case.sides[:2])
    notch = 0.0 if flaws.notch is None else 1e6 * flaws.notch.along_x * flaws.notch.along_y
    sizes = {
        "sensor_mass": 1e3 * sum(mass.mass for mass in flaws.masses),
        "misorientation_deg": flaws.turned_deg,
        "taper_x": 100.0 * flaws.taper[0],
        # root mean square of both, as in the catalogue
        "sag": 1e3 * math.hypot(*flaws.sag) / math.sqrt(2.0),
        "missing_area": 100.0 * notch / area,
    }
    return {name: size for name, size in sizes.items() if size}


def _missed(rows: Iterable[Results]) -> str:
    """The true constants outside their intervals, in parentheses."""
    said = [
        f"{row['case']} {c['name']} {c['truth']:.4g}, {c['q025']:.4g} to {c['q975']:.4g}"
        for row in rows
        for c in row["constants"]
        if not c["covered"]
    ]
    return f" (not {'; '.join(said)})" if said else ""


_TABLE = """| case | what is wrong | answer | verdict |
|---|---|---|---|"""


def main(arguments: list[str] | None = None) -> int:
    """Measure if asked, diagnose the cases that are not saved, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="*", metavar="CASE", choices=tuple(CASES))
    parser.add_argument("--measure", nargs="*", metavar="CASE", choices=tuple(CASES))
    options = parser.parse_args(arguments)
    if options.measure is not None:
        measure(options.measure or CASES)
        return 0
    if options.quick:
        print_rows(run(True))
        return 0
    saved = {row["case"] for row in saved_results(RESULTS).get("cases", [])}
    for name in [n for n in CASES if n not in saved] if options.only is None else options.only:
        found = run(False, [name])
        print_rows(found)
        save_results(RESULTS, with_saved(found, RESULTS, list(CASES)))
    write_sections(HERE.parent, RESULTS.stem, sections(saved_results(RESULTS)))
    return 0


def print_rows(results: Results) -> None:
    """Print one line per case."""
    for row in results["cases"]:
        causes = ", ".join(row["causes"]) or "-"
        print(
            f"{row['case']}: {row['truth']['cause']}; {row['claim']} ({causes}) {row['probability']:.3f}: "
            f"{row['verdict']}, {row['seconds']:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
