"""What is wrong with the paper's plates, from the JSON document: in words, and as a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, Final

from cpam_bayes.effects import CATALOGUE
from cpam_bayes.formatting import listed, signed, significant
from cpam_bayes.questions.paper.drawings import OF_THE_PAPER
from cpam_bayes.questions.paper.rows import BUILT_IN, UNEXPLAINED_PERCENT, Record, is_unexplained
from cpam_bayes.render.report import Column, Rows

# One factor explains a list if scaling leaves less than this share of the misfit.
_ONE_FACTOR: Final = 1.0 / 3.0
# Relative difference up to which two thicknesses are alike.
_ALIKE: Final = 0.1
# Claims whose causes have a size; an undecided or unknown cause has none.
_SIZED: Final = ("named", "pair", "class")
_TWO_DIGITS: Final = partial(significant, digits=2)


def wrong_plates(document: Record) -> Iterator[str]:
    """Section on plates whose lists no constants near the data sheet explain."""
    far = filter(is_unexplained, document["simulation"])
    wrong = {e["specimen"]: e for e in sorted(far, key=itemgetter("specimen"))}
    if not wrong:
        return
    yield from (
        f"## What is wrong with {listed(tuple(wrong), 'and')}",
        "",
        "With constants near the data sheet the printed plate misses these measured frequencies by more "
        f"than {UNEXPLAINED_PERCENT:g} % (rms). Misfit is given with these constants, with those of the "
        "smallest F, eq. (7), within wide bounds (high modes weigh most), and with the cause that "
        "`cpam-bayes diagnose` finds.",
        "",
        *(f"- **{name}**: {_in_words(error, _least(document, name))}" for name, error in wrong.items()),
        "",
    )


def _least(document: Record, name: str) -> str:
    """Misfit and E1 at the smallest F for the printed plate; "" where Table 9 was not computed."""
    rms = [
        m["our_rms_percent"]
        for m in document["audit"]["misfits"]
        if (m["specimen"], m["case"]) == (name, BUILT_IN) and m["source"] in OF_THE_PAPER
    ]
    e1 = [
        row["ours"]
        for row in document["rows"]
        if (row["table"], row["specimen"], row["quantity"]) == (9, name, "E1_GPa") and row["ours"] is not None
    ]
    if not rms or not e1:
        return ""
    return f"{_TWO_DIGITS(rms[0])} % at the smallest F (E1 {significant(e1[0], 3)} GPa)"


def _in_words(error: Record, least: str) -> str:
    return " ".join(filter(None, (_factor(error), error["sentence"], _sizes(error), _left(error, least))))


def _factor(error: Record) -> str:
    """The common factor of all frequencies, and the thickness that gives it, if it explains nearly all."""
    ratio, left = error["frequency_ratio"], error["scaled_rms_percent"]
    times = significant(ratio, 3)
    said = f"Its frequencies are {times} times those of the printed plate, to {_TWO_DIGITS(left)} %"
    if left > _ONE_FACTOR * 100.0 * abs(math.log(ratio)):
        return f"{said}: no one factor explains them."
    thickness = ratio * error["thickness_mm"]
    others = {
        name: mm for name, mm in error["of_one_material_mm"].items() if abs(mm / thickness - 1.0) < _ALIKE
    }
    of_others = "; ".join(
        f"Table 2 gives {mm:g} mm to {listed([n for n, its in others.items() if its == mm], 'and')}, of "
        "the same material"
        for mm in dict.fromkeys(others.values())
    )
    return (
        f"{said}; a plate {times} times as thick would have them (about {thickness:.1f} mm, not "
        f"{error['thickness_mm']:g} mm{f'; {of_others}' if of_others else ''})."
    )


def _sizes(error: Record) -> str:
    """Sizes of the claimed causes, and of those beside them in the most probable set."""
    if error["claim"] not in _SIZED or not error["sizes"]:
        return ""
    own = {p.name for effect in CATALOGUE if effect.name in error["causes"] for p in effect.parameters}
    of = {name: _size(name, size) for name, size in error["sizes"].items()}
    between = " or " if error["claim"] == "class" else "; "
    claimed = between.join(text for name, text in of.items() if name in own)
    beside = "; ".join(text for name, text in of.items() if name not in own)
    return f"Size: {claimed}{f', together with {beside}' if beside else ''}."


def _size(name: str, size: Mapping[str, Any]) -> str:
    title = name.removesuffix("_deg").replace("_", " ")
    return f"{title} {signed(size['mean'], 1)} +- {_TWO_DIGITS(size['sd'])} {size['unit']}".rstrip()


def _left(error: Record, least: str) -> str:
    """Misfits side by side: of the printed plate, at the smallest F, and with the claimed cause."""
    parts = [f"Misfit: {_TWO_DIGITS(error['plain_rms_percent'])} %"]
    if least:
        parts.append(least)
    extended = error["extended_rms_percent"]
    if extended is not None:
        by = "an error of unknown form" if error["claim"] == "other" else "this"
        parts.append(f"{_TWO_DIGITS(extended)} % with {by}")
    return f"{', '.join(parts)}."


def _left_out(error: Record) -> str | None:
    if error["held_out"] is None:
        return None
    return f"{signed(error['held_out'], 0)} +- {error['held_out_se']:.0f}"


def claimed(error: Record) -> str:
    """The claim with the names of its causes."""
    causes = ", ".join(error["causes"])
    return f"{error['claim']}: {causes}" if causes else str(error["claim"])


_DIAGNOSED: Final = (
    Column("plate", "specimen", itemgetter("specimen")),
    Column("claim", None, claimed),
    Column("misfit %", "plain_rms_percent", itemgetter("plain_rms_percent"), _TWO_DIGITS, True),
    Column(
        "misfit % with cause", "extended_rms_percent", itemgetter("extended_rms_percent"), _TWO_DIGITS, True
    ),
    Column("log Bayes factor", "log_bayes_factor", itemgetter("log_bayes_factor"), "{:.0f}".format, True),
    Column("log score of frequencies left out", None, _left_out, number=True),
)


def diagnosed(simulation: Sequence[Record]) -> Rows:
    """The diagnosis of each plate, one row per plate."""
    each = {error["specimen"]: error for error in simulation}
    return Rows("diagnosed", _DIAGNOSED, tuple(each.values()))
