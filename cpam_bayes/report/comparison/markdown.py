"""The comparison as a page of the documentation, written from its JSON document alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cpam_bayes.formatting import signed, significant

__all__ = ["page"]

_ROWS = ("specimen", "by", "quantity", "printed", "ours", "difference %", "95 % interval", "verdict")


def page(document: Mapping[str, Any]) -> str:
    """The page docs/comparison.md of the document of `cpam-bayes paper --json`."""
    return "\n".join(_lines(document)).rstrip() + "\n"


def _lines(document: Mapping[str, Any]) -> Iterator[str]:
    yield "# The paper's tables, reproduced and audited"
    yield ""
    yield (
        "This page is written by `python studies/19_paper.py` from `studies/results/19_paper.json`, the "
        f"document of `cpam-bayes paper --json` (version {document['version']}, seed {document['seed']}); a "
        "test holds the two together. Tables are those of Masoumi and Ghasemi Ghalebahman (2017)."
    )
    yield ""
    yield "## The most important disagreements"
    yield ""
    yield from (f"{i}. {text}" for i, text in enumerate(document["disagreements"], 1))
    yield ""
    yield from _verdicts(document)
    yield from _audit(document)
    yield from _well_posed(document["hadamard"])
    yield from _simulation(document["simulation"])
    yield from _solvers(document["rows"])
    for table in document["tables"]:
        rows = [r for r in document["rows"] if r["table"] == table["table"] and r["verdict"] != "input"]
        if rows:
            yield f"## Table {table['table']}: {table['title']}"
            yield ""
            yield from _table(_ROWS, [_cells(row) for row in rows])
    yield from _computed(document)


def _verdicts(document: Mapping[str, Any]) -> Iterator[str]:
    yield "## Verdicts"
    yield ""
    yield (
        "A frequency agrees up to 0.5 % or half a unit of its last digit, an identified constant up to 1 %, "
        "a mean of ten up to two standard errors of the difference of two such means. *Within the "
        "posterior*: in the 95 % interval, or the 95 % set of stacking sequences. *Input*: printed data that "
        "are computed from, or references."
    )
    yield ""
    kinds = list(document["tables"][0]["verdicts"])
    rows = [
        [str(t["table"]), t["title"], *(str(t["verdicts"][kind] or "") for kind in kinds)]
        for t in document["tables"]
    ]
    yield from _table(["table", "title", *kinds], rows)


def _audit(document: Mapping[str, Any]) -> Iterator[str]:
    audit = document["audit"]
    percentages = audit["percentages"]
    agreements = [p["agreement"] for p in percentages]
    yield "## Audit of the print"
    yield ""
    yield (
        f"Of {len(agreements)} printed percentages {agreements.count('follows')} follow from the digits of "
        "their rows, "
        f"{agreements.count('before rounding')} can follow from values before rounding, and "
        f"{agreements.count('does not follow')} cannot:"
    )
    yield ""
    wrong = [p for p in percentages if p["agreement"] == "does not follow"]
    yield from _table(
        ("table", "specimen", "by", "quantity", "printed %", "recomputed %", "possible %"),
        [
            [
                *(str(p["table"]), p["specimen"], p["source"], p["quantity"]),
                *(f"{p['printed_percent']:g}", f"{p['recomputed_percent']:.1f}"),
                " to ".join(f"{v:.1f}" for v in p["possible_percent"]),
            ]
            for p in wrong
        ],
    )
    yield from (f"- {note}" for note in audit["misprints"])
    yield ""
    if audit["means_of_ten"]:
        yield "## What means of ten can show"
        yield ""
        yield audit["means_of_ten"]
        yield ""
    yield "## Printed constants against their own frequencies"
    yield ""
    yield (
        "F is eq. (7), in Hz², of the plate with the printed constants and layup, by forward solves only; "
        "beside it the least F that the swarms found within the bounds of eq. (8), and how many of them "
        "found it."
    )
    yield ""
    yield from _table(
        (
            "table",
            "specimen",
            "constants",
            "by",
            "F",
            "least F",
            "rms %",
            "rms % at the least F",
            "swarms that found it",
            "swarms converged",
            "on a bound",
        ),
        [
            [
                *(str(m["table"]), m["specimen"], m["case"], m["source"]),
                *(significant(m["objective"]), significant(m["our_objective"])),
                *(significant(m["rms_percent"], 3), significant(m["our_rms_percent"], 3)),
                f"{m['swarms_found']} of {m['swarms']}",
                str(m["swarms_converged"]),
                " ".join(m["on_bounds"]),
            ]
            for m in audit["misfits"]
        ],
    )


def _well_posed(conditions: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if not conditions:
        return
    yield "## Hadamard's conditions"
    yield ""
    yield (
        "A problem is well posed where a solution exists, is the only one, and moves little when the data "
        "do. *Existence*: what the best constants leave, the root of the residual sum of squares over the "
        f"degrees of freedom, against the {conditions[0]['repeatability_percent']:.2g} % that 97.5 % of tap "
        "tests repeat within. *Uniqueness*: rank and condition number of the sensitivities d ln f / d ln x "
        "there, the optima whose misfits the noise does not tell apart, and the stacking sequences of "
        "the 95 % set where the angles are unknown too. *Stability*: standard deviation of a constant in % "
        "for 1 % of noise on each frequency, to first order and without bounds."
    )
    yield ""
    exist = [c for c in conditions if c["exists"]]
    unique = [c for c in conditions if c["unique"]]
    yield (
        f"A solution exists in this sense for {len(exist)} of {len(conditions)} choices of plate and unknowns"
        f"{_named(exist)}, and is the only one for {len(unique)}{_named(unique)}."
    )
    yield ""
    names = list(dict.fromkeys(name for c in conditions for name in c["percent_per_percent"]))
    yield from _table(
        (
            *("table", "specimen", "unknowns of", "left %", "exists", "rank", "condition number", "optima"),
            *("stacking sequences", *(f"{name.partition('_')[0]}, % per %" for name in names)),
        ),
        [
            [
                *(str(c["table"]), c["specimen"], f"{c['unknowns']} of {c['frequencies']} frequencies"),
                "" if c["left_percent"] is None else significant(c["left_percent"], 2),
                {True: "yes", False: "no", None: ""}[c["exists"]],
                f"{c['rank']} of {c['unknowns']}",
                "" if c["condition"] is None else significant(c["condition"], 2),
                str(c["optima"]),
                "" if c["layups"] is None else str(c["layups"]),
                *(_amplified(c["percent_per_percent"], name) for name in names),
            ]
            for c in conditions
        ],
    )


def _amplified(percent: Mapping[str, float | None], name: str) -> str:
    if name not in percent:
        return ""
    value = percent[name]
    return "not determined" if value is None else significant(value, 2)


def _named(conditions: Sequence[Mapping[str, Any]]) -> str:
    """The plates in brackets."""
    named = dict.fromkeys(f"{c['specimen']} with {c['unknowns']} unknowns" for c in conditions)
    return f" ({'; '.join(named)})" if named else ""


def _simulation(errors: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if not errors:
        return
    yield "## The paper's simulation, diagnosed"
    yield ""
    yield (
        "Printed: ABAQUS with the reference constants against the measured list. Plain: this package's model "
        "with the constants that the list and the bounds make probable. Extended: by what the diagnosis "
        "claims. The gain is the log Bayes factor of the claim, and the log predictive density of "
        "frequencies left out, in nats above the plain model."
    )
    yield ""
    yield from _table(
        (
            *("table", "plate", "printed rms %", "plain rms %", "claim", "probability", "extended rms %"),
            *("log Bayes factor", "left-out frequencies"),
        ),
        [
            [
                *(
                    str(e["table"]),
                    e["specimen"],
                    "" if e["printed_rms_percent"] is None else significant(e["printed_rms_percent"], 3),
                ),
                significant(e["plain_rms_percent"], 3),
                f"{e['claim']}: {', '.join(e['causes'])}" if e["causes"] else e["claim"],
                f"{e['probability']:.2f}",
                "" if e["extended_rms_percent"] is None else significant(e["extended_rms_percent"], 3),
                "" if e["log_bayes_factor"] is None else signed(e["log_bayes_factor"], 1),
                "" if e["held_out"] is None else f"{signed(e['held_out'], 1)} +- {e['held_out_se']:.1f}",
            ]
            for e in errors
        ],
    )


def _costs(costs: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    if not costs:
        return
    yield (
        "Forward solves of the optimum, the single swarms and the posterior of a plate, with their wall "
        "time, and what as many runs of CalculiX with 20-node bricks would take one after another, at the "
        "seconds of one run:"
    )
    yield ""
    yield from _table(
        ("plate", "constants", "forward solves", "seconds", "seconds of one CalculiX run", "CalculiX hours"),
        [
            [
                *(c["specimen"], c["case"], str(c["forward_solves"]), f"{c['seconds']:.1f}"),
                "" if c["calculix_seconds"] is None else f"{c['calculix_seconds']:.1f}",
                "" if c["calculix_hours"] is None else f"{c['calculix_hours']:.0f}",
            ]
            for c in costs
        ],
    )


def _solvers(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    compared = [r for r in rows if r["table"] in (1, 5) and r["source"] == "ABAQUS"]
    if not compared:
        return
    yield "## ABAQUS beside three converged solvers"
    yield ""
    yield (
        "The package's Ritz method and finite elements are first-order shear deformation theory; CalculiX "
        "has 20-node bricks. Frequencies in Hz."
    )
    yield ""
    names = ("ritz_hz", "fem_hz", "calculix_hz")
    yield from _table(
        ("table", "plate", "mode", "ABAQUS, printed", "Ritz", "elements", "CalculiX", "printed less Ritz %"),
        [
            [
                *(str(r["table"]), r["specimen"], r["quantity"][1:].partition("_")[0], r["printed_text"]),
                *("" if r["details"][n] is None else significant(r["details"][n], 6) for n in names),
                signed(r["difference_percent"], 1),
            ]
            for r in compared
        ],
    )


def _cells(row: Mapping[str, Any]) -> list[str]:
    ours, q025, q975 = row["ours"], row["q025"], row["q975"]
    if isinstance(ours, list):
        shown = f"[{', '.join(f'{angle:g}' for angle in ours)}]"
    else:
        shown = "" if ours is None else significant(ours, 5 if row["quantity"].endswith("_hz") else 4)
    interval = "" if q025 is None or q975 is None else f"{significant(q025)} to {significant(q975)}"
    off = row["difference_percent"]
    return [
        *(row["specimen"], row["source"], row["quantity"], row["printed_text"], shown),
        *("" if off is None else signed(off, 1), interval, row["verdict"]),
    ]


def _computed(document: Mapping[str, Any]) -> Iterator[str]:
    yield "## Computations"
    yield ""
    rows = [
        [task, str(r["version"]), str(r["date"]), f"{r['seconds']:.0f}"]
        for task, r in document["computed"].items()
    ]
    yield from _table(("what", "version", "date", "seconds"), rows)
    yield from _costs(document["costs"])
    yield from (f"- Warning: {text}" for text in document["warnings"])


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(headings)} |"
    yield f"|{'---|' * len(headings)}"
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
    yield ""
