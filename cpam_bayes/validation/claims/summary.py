"""The figures of the claims benchmark, and the section of the documentation that is made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from cpam_bayes.validation.claims.scoring import (
    CATEGORIES,
    CLAIMS,
    NONE,
    RIGHT,
    WRONG,
    Record,
    Scored,
    confusion,
    coverage,
    reliability,
    shares,
)

# Signal to noise from which a cause should be found.
_STRONG = 8.0
_CLEAN = ("clean", "coincident", "incomplete, clean")


def summary(records: Sequence[Scored], oracle: Mapping[str, Scored]) -> Record:
    """Everything that is said of one engine's answers to one set.

    oracle : its scored answers by list, as far as they are known.
    """
    return {
        "lists": len(records),
        "plates": sorted({r["plate"] for r in records}),
        "by_kind": confusion(records, row_of),
        "by_ratio": confusion([r for r in records if r["kind"] == "one"], ratio_of),
        "by_noise": confusion(records, lambda r: "noise stated" if r["stated"] else "noise left out"),
        "by_cause": confusion(
            [r for r in records if r["kind"] in ("one", "prior", "row")], lambda r: " + ".join(r["causes"])
        ),
        "figures": figures(records, oracle),
        "reliability": {
            "claims": reliability(records, (*CLAIMS, "other")),
            "claims and none": reliability(records, (*CLAIMS, "other", "none")),
        },
        "coverage": {
            "all": coverage(records),
            "claimed": coverage([r for r in records if r["category"] in (RIGHT, WRONG)]),
            "clean": coverage([r for r in records if r["kind"] in _CLEAN]),
            "plain model": coverage(records, "inside_plain"),
        },
        "wrong": [
            {k: r.get(k) for k in ("id", "plate", "causes", "claim", "claimed", "probability")}
            for r in records
            if r["category"] == WRONG
        ],
    }


def figures(records: Sequence[Scored], oracle: Mapping[str, Scored]) -> list[Record]:
    """The figures that were asked for: what, asked, reached, its standard error, number of lists."""
    rows = []
    for title, stated in (("noise stated", True), ("noise left out", False)):
        known = [
            r
            for r in records
            if r["stated"] == stated
            and r["causes"]
            and r["kind"] != "smooth"
            and _strength(r) >= _STRONG
            and oracle.get(r["id"], {}).get("category") == RIGHT
        ]
        rows.append(_row(f"claimed and right where the oracle claims, {title}", ">= 0.95", known, _is(RIGHT)))
    every = [r for r in records if r["causes"] and r["kind"] != "smooth" and _strength(r) >= _STRONG]
    rows.append(_row("claimed and right, all with signal to noise 8 and above", "-", every, _is(RIGHT)))
    with_oracle = [r for r in every if r["id"] in oracle]
    outcomes = [oracle[r["id"]]["category"] == RIGHT for r in with_oracle]
    rows.append(_of("  the oracle on the same lists", "-", outcomes))
    rows.append(_row("wrong claims, all lists", "<= 0.01", records, _is(WRONG)))
    smooth = [r for r in records if r["kind"] == "smooth"]
    rows.append(_row("wrong claims, smooth discrepancy", "<= 0.02", smooth, _is(WRONG)))
    clean = [r for r in records if not r["causes"]]
    rows.append(_row("false claims, nothing hidden", "<= 0.01", clean, _is(WRONG)))
    silent = [r for r in records if r["category"] == NONE]
    rows.append(
        _row("none with what could have been seen", "1", silent, lambda r: r["told_what_could_be_seen"])
    )
    calibration = reliability(records, (*CLAIMS, "other"))
    rows.append(
        _value(
            "expected calibration error of claims",
            "<= 0.03",
            calibration["error"],
            None,
            calibration["lists"],
        )
    )
    every_interval = coverage(records)
    rows.append(
        _value(
            "coverage of 95 % intervals, claimed or not",
            "0.93 to 0.97",
            every_interval["share"],
            every_interval["standard_error"],
            every_interval["constants"],
        )
    )
    return rows


def row_of(r: Scored) -> str:
    """The row of known failures, or the kind, that a list belongs to, by its name."""
    name = str(r["id"])
    return name.rsplit("-", 1)[0] if r.get("set") == "rows" else str(r["kind"])


def ratio_of(r: Scored) -> str:
    """The signal to noise of a list as text that sorts."""
    return "-" if r["ratio"] is None else f"{r['ratio']:3.0f}"


def section(
    title: str, total: int, scores: Record, others: Mapping[str, Record], names: Mapping[str, str]
) -> str:
    """Markdown of a set: figures, the confusion of claims beside other engines and methods, wrong claims."""
    plates = ", ".join(scores["plates"])
    answered = f"{scores['lists']} of {total} lists answered, of {plates}, at random within a plate."
    lines = [
        f"### {title}",
        "",
        answered,
        "",
        "| | asked | reached (standard error) | lists |",
        "|---|---|---|---|",
    ]
    for row in scores["figures"]:
        lines.append(f"| {row['what']} | {row['asked']} | {_shown(row)} | {row['lists']} |")
    lines += ["", _confusion_table("hidden", scores["by_kind"]), ""]
    if any(r["what"] != "-" for r in scores["by_ratio"]):
        lines += [
            "Single causes by signal to noise:",
            "",
            _confusion_table("signal to noise", scores["by_ratio"]),
            "",
        ]
    if others:
        lines += ["On the same lists:", "", _side_by_side(scores, others, names), ""]
    cover = scores["coverage"]
    lines += [
        "Coverage of 95 % intervals: "
        + "; ".join(
            f"{k} {_number(c['share'])} of {c['constants']}" for k, c in cover.items() if c["constants"]
        )
        + ".",
        "",
    ]
    if scores["wrong"]:
        lines += ["Wrong claims:", "", "| list | hidden | claimed | probability |", "|---|---|---|---|"]
        lines += [
            f"| {w['id']} | {', '.join(w['causes']) or 'nothing'} "
            f"| {w['claim']}: {', '.join(w['claimed'])} | {w['probability']:.3f} |"
            for w in scores["wrong"]
        ]
        lines.append("")
    return "\n".join(lines)


def _confusion_table(what: str, rows: Sequence[Record]) -> str:
    shown = [c for c in CATEGORIES if any(r[c] for r in rows)]
    head = [what, "lists", *shown, "mean class size"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for r in rows:
        cells = [r["what"], r["lists"], *(r[c] for c in shown), r["mean class size"] or "-"]
        lines.append("| " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines)


def _side_by_side(scores: Record, others: Mapping[str, Record], names: Mapping[str, str]) -> str:
    head = ["method", "lists", *CATEGORIES]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name, of_method in {"": scores, **others}.items():
        total = [sum(r[c] for r in of_method["by_kind"]) for c in CATEGORIES]
        said = names.get(name, name) or "this diagnosis"
        lines.append("| " + " | ".join(str(c) for c in (said, of_method["lists"], *total)) + " |")
    return "\n".join(lines)


def _strength(r: Scored) -> float:
    """Signal to noise of a list; what is no shift, a mode missed or another material, counts as strong."""
    value = r["signal_to_noise"]
    return float("inf") if value is None else float(value) * 1.001


def _is(category: str) -> Callable[[Scored], bool]:
    return lambda r: bool(r["category"] == category)


def _row(what: str, asked: str, records: Sequence[Scored], test: Callable[[Scored], bool]) -> Record:
    return _of(what, asked, [test(r) for r in records])


def _of(what: str, asked: str, outcomes: Sequence[bool]) -> Record:
    return _value(what, asked, *shares(outcomes), len(outcomes))


def _value(what: str, asked: str, value: float | None, error: float | None, n: int) -> Record:
    return {"what": what, "asked": asked, "value": value, "standard_error": error, "lists": n}


def _shown(row: Record) -> str:
    error = row["standard_error"]
    return _number(row["value"]) + (f" ({error:.3f})" if error is not None else "")


def _number(value: Any) -> str:
    return "-" if value is None else f"{value:.3f}"
