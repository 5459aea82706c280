"""What do sister plates and further tests of one plate add to a diagnosis?

python studies/13_several_plates.py [--quick] [--workers N | --executor SPEC] [--per-cause N]

A cause is hidden in C1, as large as a signal-to-noise ratio of 8 asks of its list alone, which has six
frequencies with 0.2 % of noise. The list is diagnosed alone, with one and with two sister plates that nothing
is wrong with and whose constants scatter by 2 %, with the same plate clamped on one edge, and with the same
plate carrying a known mass near a corner. Truths are finite elements, the diagnosis has Ritz models
(cpam_bayes/validation/diagnosis/joint_trials.py).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.commands.options import add_executor_options
from cpam_bayes.parallel import open_executor
from cpam_bayes.parallel import run as share_out
from cpam_bayes.report.tables import Column, Table, screen_text
from cpam_bayes.validation.diagnosis.joint_trials import TESTS, laboratory, run_joint_trial
from cpam_bayes.validation.diagnosis.trials import Trial
from cpam_bayes.validation.diagnosis.truths import variants_of_cause
from cpam_bayes.validation.pages import markdown_table, write_sections
from cpam_bayes.validation.study_results import save_results

Results = dict[str, Any]
Notify = Callable[[str], None]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "plate": "plate, frequencies in a list, noise, resolution in Hz and signal to noise",
    "setups": "one each: trials, shares that were right, mean probabilities, claims, spread of the constants",
    "by_cause": "mean probability of the hidden cause in every setup",
    "trials": "the records",
}

SEED = 0
PLATE, LISTED, NOISE, RESOLUTION_HZ, RATIO = "C1", 6, 0.002, 0.1, 8.0
PER_CAUSE = 4
# Slips of the list are in one list alone, and another material is no flaw of one plate.
LEFT_OUT = ("none", "other", "mode_identity", "outlier", "material")
QUICK_CAUSE = "warp"


def run(
    quick: bool,
    executor: Executor | None = None,
    per_cause: int = PER_CAUSE,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Results:
    """All causes that reach the ratio; quick: one trial of one cause, with sisters only."""
    own = laboratory(PLATE, LISTED, noise=NOISE, resolution=RESOLUTION_HZ, tests=() if quick else TESTS)
    names = dict.fromkeys(h.cause for h in own.alone.singles if h.cause not in LEFT_OUT)
    causes = [QUICK_CAUSE] if quick else [c for c in names if variants_of_cause(own.alone, c)]
    trials = [
        Trial("one", (c,), RATIO, i, seed=SEED) for i in range(1 if quick else per_cause) for c in causes
    ]
    done = [0]

    def count(index: int, record: Results) -> None:
        del index, record
        done[0] += 1
        progress(done[0], len(trials))

    found = share_out(run_joint_trial, own, trials, executor, batch_size=1, on_result=count)
    records = [r for r in found if r["reached"]]
    return {
        "quick": quick,
        "plate": [PLATE, LISTED, NOISE, RESOLUTION_HZ, RATIO],
        "setups": [_summary(setup, records) for setup in own.setups],
        "by_cause": [
            {
                "cause": c,
                "trials": len(of),
                **{s: float(np.mean([r["setups"][s]["cause_probability"] for r in of])) for s in own.setups},
            }
            for c in causes
            for of in [[r for r in records if r["causes"] == [c]]]
            if of
        ],
        "trials": records,
    }


def _summary(setup: str, records: list[Results]) -> Results:
    own = [r["setups"][setup] for r in records]
    ratios = [
        np.log(np.array(a["relative_sd"]) / r["setups"]["alone"]["relative_sd"])
        for a, r in zip(own, records, strict=True)
    ]
    claims = [a for a in own if a["claim"] in ("named", "class", "pair")]
    return {
        "setup": setup,
        "trials": len(own),
        "leads": _share(own, "leads"),
        "leads_class": _share(own, "leads_class"),
        "cause_probability": _share(own, "cause_probability"),
        "class_probability": _share(own, "class_probability"),
        "claimed": len(claims) / len(own),
        "named": sum(a["claim"] == "named" for a in own) / len(own),
        "wrong_claims": sum(not a["claim_is_right"] for a in claims),
        "constants_spread": float(np.exp(np.mean(ratios))),
        "processor_seconds": _share(own, "processor_seconds"),
    }


def _share(answers: list[Results], key: str) -> float:
    return float(np.mean([a[key] for a in answers]))


def show(results: Results) -> None:
    """Print the results as tables."""
    titles = (
        "measured",
        "trials",
        "cause leads",
        "P(cause)",
        "named",
        "claimed",
        "wrong",
        "sd over alone",
        "s",
    )
    rows = tuple(
        (
            r["setup"],
            str(r["trials"]),
            f"{r['leads']:.2f}",
            f"{r['cause_probability']:.2f}",
            f"{r['named']:.2f}",
            f"{r['claimed']:.2f}",
            str(r["wrong_claims"]),
            f"{r['constants_spread']:.2f}",
            f"{r['processor_seconds']:.1f}",
        )
        for r in results["setups"]
    )
    first = Table("What else is measured", tuple(Column(t, i > 0) for i, t in enumerate(titles)), rows)
    setups = [r["setup"] for r in results["setups"]]
    heads = (Column("hidden"), Column("trials", True), *(Column(s, True) for s in setups))
    lines = tuple(
        (r["cause"], str(r["trials"]), *(f"{r[s]:.2f}" for s in setups)) for r in results["by_cause"]
    )
    print(screen_text((first, Table("Probability of the hidden cause", heads, lines)), sys.stdout))


def sections(results: Results) -> dict[str, str]:
    """The table of docs/hidden_effects.md: what further plates and tests add."""
    head = (
        "measured",
        "trials",
        "true cause leads",
        "its probability, mean",
        "named",
        "claimed",
        "wrong claims",
    )
    rows = (
        (
            s["setup"],
            str(s["trials"]),
            f"{s['leads']:.2f}",
            f"{s['cause_probability']:.2f}",
            f"{s['named']:.2f}",
            f"{s['claimed']:.2f}",
            str(s["wrong_claims"]),
            f"{s['constants_spread']:.2f}",
            f"{s['processor_seconds']:.1f}",
        )
        for s in results["setups"]
    )
    return {"setups": markdown_table((*head, "spread of the constants", "processor s"), rows)}


def main() -> None:
    """Run the study, print its tables and save the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the small version; nothing is saved")
    add_executor_options(parser)
    parser.add_argument("--per-cause", type=int, default=PER_CAUSE, metavar="N", help="trials of each cause")
    args = parser.parse_args()

    def tell(done: int, total: int) -> None:
        print(f"\r{done} of {total} trials", end="\n" if done == total else "", file=sys.stderr, flush=True)

    with open_executor(args.executor, args.workers) as executor:
        results = run(args.quick, executor, args.per_cause, tell)
    show(results)
    if not args.quick:
        save_results(RESULTS, results)
        write_sections(Path(__file__).parents[1], RESULTS.stem, sections(results))


if __name__ == "__main__":
    main()
