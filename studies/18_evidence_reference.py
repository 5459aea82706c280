"""Are the marginal likelihoods of the diagnosis those of a slow and independent reference?

python studies/18_evidence_reference.py [--quick] [--cases N] [--minutes M]

Lists are drawn from the Ritz models themselves: it is the integral that is tested. Each has a cause of the
catalogue or none, with a size from its prior or at signal to noise 4 to 100. None, the true hypothesis and
two others chosen at random are weighed as the diagnosis does and by the reference of
studies/validation/evidence_reference.py. Runs go on from the saved cases, --minutes ends one early.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.diagnosis.cases import hypotheses_of
from cpam_bayes.diagnosis.hypotheses import NONE
from validation.evidence_lists import listed, weighed
from validation.evidence_reference import ReferenceSettings, reference_evidence
from validation.reporting import case_by_case

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "summary": "hypotheses compared near the best and far from it, and how far both ways differ",
    "cases": "one each: plate, modes, noise, what is hidden, hypotheses with both log evidences",
}

CASES, QUICK_CASES = 200, 2
# A hypothesis this far below the best is hopeless: the quick way may only be too low there.
NEAR_NATS = 8.0
AGREED_NATS = 0.3
# This far below the best the reference goes about the joint optima only.
HOPELESS_NATS = 30.0
# The grid and the draws of the reference here, and in the small version.
SETTINGS = ReferenceSettings(draws=768, nodes=61, log2_points=(11, 14))
QUICK = ReferenceSettings(draws=512, nodes=41, log2_points=(11, 13))


def run_case(number: int, *, quick: bool) -> Results:
    """One list, weighed both ways."""
    rng, of_list, case, hidden = listed(number)
    singles = [h for h, _ in hypotheses_of([case])]
    others = [h for h in singles if h.cause not in (NONE, hidden.cause)]
    causes = sorted({h.cause for h in others})
    chosen = [singles[0]] + ([hidden] if hidden.cause != NONE else [])
    for cause in rng.choice(causes, size=2, replace=False):
        variants = [h for h in others if h.cause == cause]
        chosen.append(variants[int(rng.integers(len(variants)))])
    begin = time.process_time()
    tested = weighed(case, chosen)
    fast = time.process_time() - begin
    rows, begin, best = [], time.process_time(), -np.inf
    settings = QUICK if quick else SETTINGS
    for t in tested:
        marginal, least = t.marginal, best - HOPELESS_NATS
        slow = reference_evidence(marginal.comparison, marginal.sizes, number, settings, hopeless=least)
        best = max(best, slow.log_evidence)
        rows.append(
            {
                "cause": t.hypothesis.cause,
                "variant": t.hypothesis.variant,
                "fast": round(marginal.log_evidence, 4),
                "slow": round(slow.log_evidence, 4),
                "slow_error": round(slow.error, 4),
                "slow_k_hat": round(min(slow.k_hat, 99.0), 2),
                "optima": slow.optima,
                "log_prior": round(float(np.log(t.hypothesis.prior)), 3),
                "sampled": marginal.is_sampled,
            }
        )
    return {
        **of_list,
        "seconds_fast": round(fast, 2),
        "seconds_slow": round(time.process_time() - begin, 2),
        "hypotheses": rows,
    }


def summary(cases: list[Results]) -> Results:
    """How far both ways differ, over hypotheses near the best and over the others."""
    near, far, doubtful, revived = [], [], 0, 0
    for case in cases:
        best = max(row["slow"] for row in case["hypotheses"])
        best_fast = max(row["fast"] for row in case["hypotheses"])
        for row in case["hypotheses"]:
            difference = row["fast"] - row["slow"]
            if row["slow_error"] > 0.1 or row["slow_k_hat"] > 0.7:
                doubtful += 1
            elif row["slow"] > best - NEAR_NATS:
                near.append(difference)
            else:
                far.append(difference)
                revived += row["fast"] > best_fast - NEAR_NATS
    q = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0)
    return {
        "cases": len(cases),
        "near": len(near),
        "near_agreed": int(np.sum(np.abs(near) <= AGREED_NATS)),
        "near_quantiles": np.round(np.quantile(near, q), 3).tolist() if near else [],
        "far": len(far),
        "far_not_too_high": int(np.sum(np.array(far) <= AGREED_NATS)),
        "far_no_longer_hopeless": int(revived),
        "reference_doubtful": doubtful,
    }


def run(quick: bool, cases: int = CASES, minutes: float = np.inf, path: Path | None = None) -> Results:
    """The cases that are saved at a path and those that are not, saved one by one."""
    numbers = range(QUICK_CASES if quick else cases)
    return case_by_case(
        numbers,
        partial(run_case, quick=quick),
        partial(as_results, quick=quick),
        minutes=minutes,
        path=path,
        say=_say,
    )


def as_results(rows: list[Results], *, quick: bool) -> Results:
    """What is saved of cases by their numbers."""
    return {"quick": quick, "summary": summary(rows), "cases": rows}


def _say(c: Results) -> None:
    print(c["case"], c["plate"], c["modes"], c["hidden"], c["meant"], c["seconds_fast"], c["seconds_slow"])
    for row in c["hypotheses"]:
        text = f"{row['fast']:10.2f} {row['slow']:10.2f} +- {row['slow_error']:.2f}"
        print(f"   {row['fast'] - row['slow']:8.2f} {text} {row['cause']} {row['variant']}", flush=True)


def main() -> None:
    """Run the cases that are not saved yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--quick", action="store_true", help="two lists against a smaller reference, not saved"
    )
    parser.add_argument("--cases", type=int, default=CASES, help="lists in all")
    parser.add_argument("--minutes", type=float, default=np.inf, help="no further list is begun after these")
    options = parser.parse_args()
    found = run(options.quick, options.cases, options.minutes, None if options.quick else RESULTS)
    print(found["summary"])


if __name__ == "__main__":
    main()
