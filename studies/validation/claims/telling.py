"""Text of the pages on the scores of claims, in Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from validation.claims import scoring
from validation.claims.scoring import (
    ABOVE,
    CLASS_SIZE,
    GROUPS,
    LIMIT_CHANCE,
    MISSED,
    RIGHT,
    STRONG,
    WRONG,
)
from validation.reporting import listed, markdown_table, paragraph

Record = dict[str, Any]

# Number of names of a wrong claim that the short text gives.
_NAMED = 2


def section(
    total: int,
    scores: Record,
    engines: Sequence[Record],
    beside: Sequence[str] = (),
    seal: Record | None = None,
) -> str:
    """Section on a set: figures beside the predictions, other methods, claims, wrong claims.

    engines : from `scoring.by_engine`. beside : the lines of `compared`
    """
    n = scores["lists"]
    lines = [f"All {n} lists answered." if n == total else f"{n} of {total} lists answered, in random order."]
    predictions = {} if seal is None else seal["predictions"]
    if seal is not None:
        lines += [f"Sealed at commit {seal['code']}, seed {seal['seed']} drawn on {seal['drawn']}."]
    rows = [_figure(row, predictions.get(row["what"])) for row in scores["figures"] if row["number"]]
    lines += ["", markdown_table(("", "predicted", "reached", "95 % interval", "of", "outcome"), rows)]
    lines += ["", _coverage_table(scores["coverage"])]
    lines += ["", *answered_by(engines), "", _class_size(scores["by_kind"])]
    # lists like those that misled earlier versions were drawn anew in study 30
    unknown = [row for row in scores["by_pattern"] if row["of"] == GROUPS["beyond"]]
    if unknown:
        lines += ["", pattern_table("outside the catalogue", unknown)]
    lines += beside
    if scores["wrong"]:
        lines += ["", "Wrong claims:", "", _wrong_claims(scores["wrong"])]
    return "\n".join([*lines, ""])


def _figure(row: Record, predicted: Sequence[float] | None) -> tuple[str, ...]:
    low, high = row["interval"]
    of_limits = row["what"] == ABOVE
    between = LIMIT_CHANCE if of_limits else predicted
    said, outcome = "-", "-"
    if between is not None:
        least, most = between
        reaches = low <= most and least <= high
        said = f"{least:g} to {most:g}"
        outcome = "met" if least <= row["value"] <= most else f"missed{'; its interval reaches it' * reaches}"
        outcome += "; stated by the answers, not sealed" * of_limits
    ends = f"{low:.3f} to {high:.3f}"
    return row["what"], said, f"{row['value']:.3f}", ends, f"{row['number']} {row['unit']}", outcome


def answered_by(engines: Sequence[Record]) -> list[str]:
    """Lines on the states of the code that answered, and the scores of each."""
    lines = []
    if len(engines) > 1:
        said = (
            f"The code was changed after answers had been seen: {len(engines)} versions answered, each list "
            "once. Above: all together; here: each version."
        )
        lines += [paragraph(said), ""]
    head = (
        *("answered by commit", "on", "lists", "with changed files"),
        *(scoring.COVERED, "95 % interval", "wrong claims"),
    )
    return [*lines, markdown_table(head, map(_engine, engines))]


def _engine(engine: Record) -> tuple[str, ...]:
    held, wrong = (scoring.figure_of(engine, what) for what in (scoring.COVERED, scoring.WRONG_CLAIMS))
    share = "-", "-"
    if held["number"]:
        low, high = held["interval"]
        share = f"{held['value']:.3f} of {held['number']}", f"{low:.3f} to {high:.3f}"
    lists, dirty = str(engine["lists"]), str(engine["dirty"])
    return engine["commit"], engine["date"], lists, dirty, *share, str(_count(wrong))


def compared(beside: Record, tuned: Record, names: Mapping[str, str]) -> list[str]:
    """Lines on other methods beside the diagnosis, on the lists that all answered.

    beside : number of lists, figures and confusion by engine. tuned : the rate and the thresholds.
    """
    wrong, of = tuned["rate"]
    said = (
        f"Simple methods on the {beside['lists']} lists that all answered. They are given the true constants "
        "and signatures from the truths' own elements, which favours them. Each claims above a threshold, "
        "the lowest at which its rate of wrong claims on development lists is at most that of the diagnosis "
        f"({wrong} of {of})."
    )
    head = ("", "threshold", "development: right, wrong, lists", "right", "wrong")
    rows = [_method(engine, scores, tuned, names) for engine, scores in beside["engines"].items()]
    table = markdown_table((*head, "right, signal to noise from 8"), rows)
    return ["", paragraph(said), "", table, "", paragraph(_unequal(beside))]


def _unequal(beside: Record) -> str:
    """Sentence saying that the methods do not claim wrongly as often as the diagnosis."""
    engines = beside["engines"]
    ours, *others = (scoring.number_of(scores, WRONG) for scores in engines.values())
    between = f"{min(others)} to {max(others)}" if min(others) < max(others) else str(min(others))
    return f"On these lists the rates differ: {ours} wrong claims by the diagnosis, {between} by the others."


def _method(engine: str, scores: Record, tuned: Record, names: Mapping[str, str]) -> tuple[str, ...]:
    chosen = tuned["methods"].get(engine)
    least, counts = "-", "-"
    if chosen is not None:
        least = "abstains" if chosen["threshold"] is None else f"{chosen['threshold']:.4g}"
        counts = ", ".join(str(chosen[key]) for key in (RIGHT, WRONG, "lists"))
    strong = scoring.figure_of(scores, STRONG)
    right, wrong = (str(scoring.number_of(scores, category)) for category in (RIGHT, WRONG))
    return names.get(engine, engine), least, counts, right, wrong, f"{_count(strong)} of {strong['number']}"


def in_short(total: int, scores: Record, seal: Record, states: int = 1) -> str:
    """A list of two items: results on elements and bricks, and the commonest ways to be misled.

    states : number of states of the code that answered
    """
    n = int(scores["lists"])
    answered = str(n) if n == total else f"{n} of {total}"
    (least, most), (_, allowed) = (
        [100.0 * end for end in seal["predictions"][what]] for what in (scoring.COVERED, scoring.WRONG_CLAIMS)
    )
    too_sure, wrong = (scoring.figure_of(scores, what) for what in (scoring.TOO_SURE, scoring.WRONG_CLAIMS))
    low, high = too_sure["interval"]
    by = f", by {states} versions" if states > 1 else ""
    said = (
        f"**Blind test** ([{answered} simulated lists](docs/hidden_effects.md){by}): 95 % intervals contain "
        f"{_share(scores, scoring.COVERED)} constants of lists from priors ({least:.0f} to {most:.0f} % "
        f"predicted), {_share(scores, scoring.COVERED_OF_BRICKS)} of bricks; {_count(wrong)} of "
        f"{too_sure['number']} claims are wrong, {100.0 * wrong['value']:.0f} % of the lists (at most "
        f"{allowed:.0f} % predicted). Stated probabilities are {too_sure['value']:.2f} ({low:.2f} to "
        f"{high:.2f}) too high."
    )
    ways = "; ".join(_way(row, scores["wrong"]) for row in scores["misled"][:3])
    return "\n".join(paragraph(point, "- ") for point in (said, f"**Failures**: {ways}."))


def _share(scores: Record, what: str) -> str:
    row = scoring.figure_of(scores, what)
    return f"{100.0 * (row['value'] or 0.0):.0f} % of {row['number']}"


def _way(row: Record, wrong: Sequence[Record]) -> str:
    counted = f"{row['number']} of {row['of']}"
    if row["way"] != scoring.MISSED:
        kinds = Counter((tuple(w["causes"]), tuple(w["claimed"])) for w in wrong)
        (kind, _), *others = kinds.most_common()
        return f"{row['way']} ({counted}{', e.g.' if others else ':'} {_called(*kind)})"
    if not row["from"]:
        return (
            f"errors hidden by noise or constants (signal to noise below {row['below']:g}: {counted} missed)"
        )
    if row["below"]:
        return f"weak errors ({row['from']:g} to {row['below']:g}: {counted} missed)"
    return f"clear errors (from {row['from']:g}: {counted} missed)"


def _called(hidden: Sequence[str], claimed: Sequence[str]) -> str:
    named = _code(claimed)
    called = " or ".join((*named[:_NAMED], *("others" for _ in named[_NAMED : _NAMED + 1])))
    return f"{listed(_code(hidden)) or 'nothing'} called {called}"


def _coverage_table(coverage: Mapping[str, Record]) -> str:
    """Table of the fractions of constants in their 95 % intervals, by kind of list and by constant."""
    kinds = {name: row for name, row in coverage.items() if row["constants"]}
    names = sorted({name for row in kinds.values() for name in row["by_constant"]})
    rows = [
        (
            name,
            str(row["constants"]),
            f"{row['share']:.3f} +- {row['standard_error']:.3f}",
            *(f"{row['by_constant'][n]:.3f}" if n in row["by_constant"] else "-" for n in names),
        )
        for name, row in kinds.items()
    ]
    return markdown_table(("lists", "constants", "in their 95 % intervals", *names), rows)


def _code(names: Sequence[str]) -> list[str]:
    return [f"`{name}`" for name in names]


def _wrong_claims(wrong: Sequence[Record]) -> str:
    return markdown_table(
        ("list", "hidden", "claimed", "probability"),
        [
            (
                w["id"],
                ", ".join(w["causes"]) or "nothing",
                f"{w['claim']}: {', '.join(w['claimed'])}",
                f"{w['probability']:.3f}",
            )
            for w in wrong
        ],
    )


def _class_size(rows: Sequence[Record]) -> str:
    """Sentence on how many causes a claim that is right names."""
    right = [(row[RIGHT], row[CLASS_SIZE]) for row in rows if row[RIGHT]]
    number = sum(n for n, _ in right)
    mean = sum(n * size for n, size in right) / max(number, 1)
    return f"The {number} claims that are right name {mean:.1f} causes on average."


def pattern_table(what: str, rows: Sequence[Record]) -> str:
    """Table of claims by pattern: right (unknown errors included), open, missed, wrong; constants covered."""
    return markdown_table(
        (what, "right/open/missed/wrong", "constants held"),
        [
            (
                r["what"],
                f"{r[RIGHT]}/{r['lists'] - r[RIGHT] - r[MISSED] - r[WRONG]}/{r[MISSED]}/{r[WRONG]}",
                f"{r['inside']}/{r['constants']}",
            )
            for r in rows
        ],
    )


def _count(row: Record) -> int:
    return round(float(row["number"] * (row["value"] or 0.0)))
