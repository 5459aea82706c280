"""Are the marginal likelihoods of the diagnosis those of nested sampling?

python studies/24_nested_evidence.py [--quick] [--cases N] [--minutes M]

The lists are drawn from the models themselves (`validation/evidence_lists.py`). Evidences from the importance
sampler, for hypotheses near the best, are compared with static nested sampling (dynesty, the extra `audit`),
which shares only the density with it. A run continues from the saved cases; --minutes ends it early.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.diagnosis.cases import hypotheses_of
from cpam_bayes.diagnosis.evidence.marginal import Tested
from cpam_bayes.diagnosis.hypotheses import NONE
from validation.evidence_lists import listed, weighed
from validation.nested import nested_of_density
from validation.reporting import case_by_case, paragraph, write_sections

Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "live_points": "of every run of nested sampling",
    "summary": "hypotheses compared, and how far both ways differ",
    "cases": "one each: plate, modes, noise, what is hidden, both log evidences and their errors",
}

CASES, QUICK_CASES = 60, 1
LIVE_POINTS, QUICK_LIVE_POINTS = 200, 30
# Hypotheses this far below the best are not compared; allowed difference beyond the errors of both.
NEAR_NATS, AGREED_NATS = 8.0, 0.1


def weighed_list(number: int) -> tuple[Results, list[Tested]]:
    """Weigh none, the hidden cause and one other for a list, as the diagnosis does."""
    rng, of_list, case, hidden = listed(number)
    singles = [h for h, _ in hypotheses_of([case])]
    others = [h for h in singles if h.cause not in (NONE, hidden.cause)]
    chosen = [singles[0], *([hidden] if hidden.cause != NONE else []), others[int(rng.integers(len(others)))]]
    return of_list, weighed(case, chosen)


def run_case(number: int, *, quick: bool) -> Results:
    """Compare both methods on one list, for its hypotheses near the best."""
    what, tested = weighed_list(number)
    best = max(t.marginal.log_evidence for t in tested)
    rows, begin = [], time.process_time()
    for i, t in enumerate(tested):
        if t.marginal.log_evidence < best - NEAR_NATS or not t.marginal.is_sampled:
            continue
        log_evidence, error = nested_of_density(
            t.marginal.comparison,
            np.random.default_rng([number, i, 24]),
            live_points=QUICK_LIVE_POINTS if quick else LIVE_POINTS,
        )
        rows.append(
            {
                "cause": t.hypothesis.cause,
                "variant": t.hypothesis.variant,
                "importance": round(t.marginal.log_evidence, 4),
                "importance_error": round(t.marginal.error, 4),
                "nested": round(log_evidence, 4),
                "nested_error": round(error, 4),
            }
        )
    return {**what, "seconds": round(time.process_time() - begin, 1), "hypotheses": rows}


def summary(cases: list[Results]) -> Results:
    """Differences of the two methods, in nats and in standard errors of both."""
    rows = [row for case in cases for row in case["hypotheses"]]
    difference = np.array([row["importance"] - row["nested"] for row in rows])
    error = np.array([np.hypot(row["importance_error"], row["nested_error"]) for row in rows])
    z = difference / error
    return {
        "cases": len(cases),
        "compared": len(rows),
        "agreed": int(np.sum(np.abs(difference) <= AGREED_NATS + 2.0 * error)),
        "mean_difference": round(float(difference.mean()), 3) if rows else None,
        "largest_difference": round(float(np.abs(difference).max()), 3) if rows else None,
        "error_of_mean": round(float(np.sqrt(np.sum(error**2)) / len(rows)), 3) if rows else None,
        "mean_error": round(float(error.mean()), 3) if rows else None,
        "rms_over_error": round(float(np.sqrt(np.mean(z**2))), 2) if rows else None,
    }


def run(quick: bool, cases: int = CASES, minutes: float = np.inf, path: Path | None = None) -> Results:
    """Results of the cases saved at a path and of the missing ones, saved one by one."""
    numbers = range(QUICK_CASES if quick else cases)
    return case_by_case(
        numbers,
        partial(run_case, quick=quick),
        partial(as_results, quick=quick),
        minutes=minutes,
        path=path,
    )


def as_results(rows: list[Results], *, quick: bool) -> Results:
    """Results of the cases, in the form that is saved."""
    points = QUICK_LIVE_POINTS if quick else LIVE_POINTS
    return {"quick": quick, "live_points": points, "summary": summary(rows), "cases": rows}


def sections(results: Results) -> dict[str, str]:
    """Section of docs/theory.md on evidences."""
    of = summary(results["cases"])
    return {
        "agreement": paragraph(
            f"{of['agreed']} of {of['compared']} evidences, of hypotheses near the best on {of['cases']} "
            f"simulated lists, agree with nested sampling ({results['live_points']} live points) to "
            f"{AGREED_NATS:g} nats plus two standard errors of the difference; mean difference "
            f"{of['mean_difference']:+.3f} ± {of['error_of_mean']:.3f}, largest "
            f"{of['largest_difference']:.2f} nats."
        )
    }


def main() -> None:
    """Run the cases that are not saved yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one list with few live points, not saved")
    parser.add_argument("--cases", type=int, default=CASES, help="lists in all")
    parser.add_argument("--minutes", type=float, default=np.inf, help="no further list is begun after these")
    options = parser.parse_args()
    found = run(options.quick, options.cases, options.minutes, None if options.quick else RESULTS)
    print(found["summary"])
    if not options.quick:
        write_sections(Path(__file__).parents[1], RESULTS.stem, sections(found))


if __name__ == "__main__":
    main()
