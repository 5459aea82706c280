"""Do the intervals of the diagnosis hold with each smooth term of the model of error switched off?

python studies/31_smooth_terms.py [--quick] [--minutes M] [--development]

The theory's bias and scatter, the form errors of causes and the unexplained error beside them are all smooth
in ln f. If one were counted twice, intervals would be too wide; if one were idle, it could go. Sixty lists
drawn from priors, of the claims benchmark's kinds under a seed of their own, are answered four times: with
all terms, and without each. Their frequencies, from independent elements, carry the bias that bricks showed
on a similar plate.

`--development` draws other lists, prints each and saves nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np

from cpam_bayes.diagnosis import hypotheses
from cpam_bayes.diagnosis.evidence import scan
from cpam_bayes.forward_model import three_dimensions
from cpam_bayes.forward_model.build import forget_models
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.claims import fresh, scoring, sets
from validation.reporting import Results, case_by_case, cases_main, markdown_table, paragraph, with_error

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "terms": "by what is switched off: constants in their 95 % intervals, standard error by list, claims",
    "cases": "one a list: its score with all terms, and without each",
}

# Seeds of the lists that are reported, and of those for development.
REPORTED, DEVELOPMENT = 564914213, 3100
LISTS = 60
ALL = "nothing"
# A prior probability that no likelihood makes up for.
_NEVER = 1e-300


def _without_form(comparison: Any, hypothesis: Any, x: Any) -> Any:
    return comparison


# What is switched off -> module, its names and what they become.
TERMS: dict[str, Mapping[tuple[ModuleType, str], Any]] = {
    ALL: {},
    "form errors of causes": {(scan, "with_form_error"): _without_form},
    "the unexplained error": {(hypotheses, "P_OTHER"): _NEVER, (hypotheses, "_LEFTOVER"): _NEVER},
    "the theory's bias and scatter": {
        (three_dimensions, name): 0.0
        for name in ("_SHEAR", "_FREE_EDGES", "_CLAMPS", "_OF_SHEAR", "_OF_FREE_EDGES", "_OF_CLAMPS")
    },
}


@contextmanager
def switched_off(term: str) -> Iterator[None]:
    """Run without a term of the model of error; processes started meanwhile have all terms."""
    changes = [patch.object(module, name, value) for (module, name), value in TERMS[term].items()]
    # models contain the bias
    is_of_models = any(module is three_dimensions for module, _ in TERMS[term])
    for change in changes:
        change.start()
    try:
        if is_of_models:
            forget_models()
        yield
    finally:
        for change in changes:
            change.stop()
        if is_of_models:
            forget_models()


def names(seed: int) -> list[str]:
    """Names of lists drawn from priors, in random order."""
    return [n for n in sets.ordered(seed) if scoring.GROUPS[n.split("-")[0]] == scoring.HEADLINE][:LISTS]


def case(number: int, seed: int = REPORTED) -> Results:
    """A list and its scores."""
    entry = sets.made(seed, names(seed)[number])
    found = {}
    for term in TERMS:
        with switched_off(term):
            found[term] = fresh.judged(entry)
    return {"case": number, "id": entry["id"], "scores": found}


def results_of(cases: list[Results], quick: bool) -> Results:
    made = [c["scores"] for c in cases if "unreachable" not in c["scores"][ALL]]
    rows = [_row(term, [scores[term] for scores in made]) for term in TERMS]
    return {"quick": quick, "terms": rows, "cases": cases}


def _row(term: str, those: list[Results]) -> Results:
    held = scoring.coverage(those)
    return {
        "without": term,
        "lists": len(those),
        "constants": held["constants"],
        "share": held["share"],
        "standard_error": held["standard_error"],
        "right": sum(c["category"] == scoring.RIGHT for c in those),
        "wrong": sum(c["category"] == scoring.WRONG for c in those),
        "seconds": float(np.median([c["seconds"] for c in those])),
    }


def run(quick: bool, minutes: float = float("inf")) -> Results:
    """Results of all lists, those not yet saved being computed; quick: one list."""
    if quick:
        return results_of([case(0, DEVELOPMENT)], quick)
    return case_by_case(range(LISTS), case, lambda c: results_of(c, False), minutes=minutes, path=RESULTS)


HEAD = ("switched off", "constants in their 95 % intervals")


def _rows(results: Results) -> list[tuple[str, ...]]:
    return [(r["without"], with_error(r["share"], r["standard_error"])) for r in results["terms"]]


def sections(results: Results) -> dict[str, str]:
    """The coverage with each term off as a table of a page."""
    first = results["terms"][0]
    said = (
        f"{first['lists']} lists drawn from priors, {first['constants']} constants; standard errors by list."
    )
    return {"terms": f"{paragraph(said)}\n\n{markdown_table(HEAD, _rows(results))}"}


def show(results: Results) -> None:
    columns = (Heading(HEAD[0]), *(Heading(text, number=True) for text in HEAD[1:]))
    print(screen_text((Table("Terms", columns, tuple(_rows(results))),), sys.stdout))


def main() -> None:
    others = partial(
        case_by_case,
        range(LISTS),
        partial(case, seed=DEVELOPMENT),
        partial(results_of, quick=True),
    )
    cases_main(__doc__, run, show, RESULTS, others)


if __name__ == "__main__":
    main()
