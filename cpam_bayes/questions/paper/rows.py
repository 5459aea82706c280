"""Printed values beside computed ones, the verdict on each, and the audit of the print.

A frequency agrees within 0.5 % or half a unit of its last digit, an identified constant within 1 %.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, get_args

from cpam_bayes.formatting import listed, significant
from cpam_bayes.printed.tables import (
    PAPER,
    PrintedRow,
    PrintedTable,
    PrintedValue,
    last_digit,
    printed_table,
)

CONSTRAINT: Final = "E1 = E2"
"""In place of a bound: the constraint E1 > E2 of eq. (9) is active."""
BUILT_IN, TWO, FOUR = "as built in", "two constants", "four constants"
"""Choices of unknowns: those of the built-in specimen, or two or four constants of an aluminium plate."""
Verdict = Literal[
    "agrees",
    "within the posterior",
    "cannot be told apart",
    "not determined",
    "not reproducible",
    "not computed",
    "input",
]
VERDICTS: Final[tuple[Verdict, ...]] = get_args(Verdict)
AGREES, WITHIN, UNTOLD, UNDETERMINED, NOT_REPRODUCIBLE, NOT_COMPUTED, INPUT = VERDICTS
Results = dict[str, Any]
"""Plain data of one finished computation."""
Record = Mapping[str, Any]
"""A row of the JSON document, whose keys `cpam_bayes.documents` declares."""
Computed = Mapping[tuple[str, str, str], Results]
"""Kind, specimen and case of a task -> its results."""

Judged = tuple[Verdict, str]
"""A verdict and its reason."""

# A printed frequency agrees with a converged one within this, %: the error of a mesh of 100 elements.
_SOLVER_PERCENT: Final = 0.5
# An identified constant agrees with the best fit within this, %.
_CONSTANT_PERCENT: Final = 1.0
# A larger difference, %, is a misprint.
MISPRINTED: Final = 50.0
# Misfit of printed constants above which a plate is named, %; ratio of interval ends that counts as wide.
_FAR, _WIDE = 5.0, 1.5
# Misfit with constants near the data sheet, %, above which a list is not that of the printed plate.
UNEXPLAINED_PERCENT: Final = 5.0
# An interval wider than this share of the bounds is uninformative: that of a uniform prior spans 95 %.
_UNDETERMINED: Final = 0.8


@dataclass(frozen=True, slots=True)
class Row:
    """One printed value beside the computed one.

    printed : as printed. ours : number, or angles in degrees from the outermost ply, or None for inputs.
    difference_percent : printed / ours - 1.
    q025, q975 : posterior interval of the quantity, where there is one.
    reason : why it is not reproducible, or another reason of the verdict; "" for none.
    details : further computed numbers by name, such as the other solvers.
    """

    table: int
    part: str
    specimen: str
    source: str
    quantity: str
    printed: str
    ours: float | tuple[float, ...] | None
    difference_percent: float | None
    q025: float | None
    q975: float | None
    verdict: Verdict
    reason: str = ""
    details: Mapping[str, float | None] = field(default_factory=dict)


def input_rows(table: PrintedTable) -> Iterator[Row]:
    """Rows of Tables 2 to 4, and rows elsewhere that are references or measurements."""
    for row in table.rows:
        if row.role in ("input", "measured"):
            for quantity, cell in row.values.items():
                yield row_of(table, row, quantity, cell, None, (INPUT, ""))


def frequency_rows(table: PrintedTable, computed: Computed, calculix: Mapping[str, Any]) -> Iterator[Row]:
    """Rows of Tables 1 and 5: printed frequencies beside the Ritz method, elements and CalculiX."""
    for row in table.rows:
        results = computed.get(("forward", row.specimen, BUILT_IN))
        if row.role != "computed" or results is None:
            continue
        bricks = calculix["frequencies_hz"].get(row.specimen)
        for i, (quantity, cell) in enumerate(row.values.items()):
            solvers = {
                "ritz_hz": results["ritz_hz"][i],
                "fem_hz": None if results["fem_hz"] is None else results["fem_hz"][i],
                "calculix_hz": None if bricks is None else bricks[i],
            }
            verdict = _of_frequency(cell, solvers)
            yield row_of(table, row, quantity, cell, solvers["ritz_hz"], verdict, details=solvers)


def _of_frequency(cell: PrintedValue, solvers: Mapping[str, float | None]) -> Judged:
    if cell.misprinted("value"):
        return NOT_REPRODUCIBLE, cell.misprints[0].note
    ours = [v for v in solvers.values() if v is not None]
    off = 100.0 * (float(cell.text) / ours[0] - 1.0)
    if abs(off) <= max(_SOLVER_PERCENT, 50.0 * last_digit(cell.text) / ours[0]):
        return AGREES, ""
    spread = 100.0 * (max(ours) / min(ours) - 1.0)
    together = f"{len(ours)} converged solvers agree to {spread:.2g} %" if len(ours) > 1 else "converged"
    return NOT_REPRODUCIBLE, f"{together} and the printed value is {off:+.1f} % off"


def constant_rows(table: PrintedTable, computed: Computed) -> Iterator[Row]:
    """Rows of Tables 6 to 9(a): identified constants beside the best fit and its posterior interval."""
    for row in table.rows:
        if row.role != "identified" or "E1_GPa" not in row.values:
            continue
        case = BUILT_IN if table.number == 9 else FOUR if "E2_GPa" in row.values else TWO
        results = computed.get(("constants", row.specimen, case))
        if results is None:
            continue
        misfit = next(m for m in results["printed"] if m["source"] == row.source)
        why = (
            f"with the printed constants the rms misfit is {misfit['rms_percent']:.3g} %, "
            f"with ours {results['rms_percent']:.3g} %"
        )
        for quantity, cell in row.values.items():
            ours = results["constants"].get(quantity)
            if ours is None:
                continue
            yield identified_row(table, row, quantity, cell, ours, why)


def identified_row(
    table: PrintedTable,
    row: PrintedRow,
    quantity: str,
    cell: PrintedValue,
    ours: Mapping[str, Any],
    why: str,
) -> Row:
    """A printed constant beside the best fit; why : the reason where it is not reproducible."""
    details = {"posterior_mean": ours["mean"], "on_bound": float(ours["bound"] is not None)}
    interval = (ours["q025"], ours["q975"])
    return row_of(table, row, quantity, cell, ours["value"], _of_constant(cell, ours, why), interval, details)


def _of_constant(cell: PrintedValue, ours: Mapping[str, Any], why: str) -> Judged:
    printed = float(cell.text)
    apart = _apart_from_interval(ours)
    half = last_digit(cell.text) / 2
    if abs(printed - ours["value"]) <= max(0.01 * _CONSTANT_PERCENT * abs(ours["value"]), half):
        return AGREES, apart
    if ours["q025"] - half <= printed <= ours["q975"] + half:
        return WITHIN, apart
    return NOT_REPRODUCIBLE, "; ".join(filter(None, (f"outside the 95 % interval; {why}", apart)))


def _apart_from_interval(ours: Mapping[str, Any]) -> str:
    """Why a best fit lies outside its own posterior interval; "" where it does not."""
    if ours["q025"] <= ours["value"] <= ours["q975"]:
        return ""
    if ours["bound"] == CONSTRAINT:
        return (
            "ours sits on the constraint E1 > E2 of eq. (9), beyond the central 95 % of a posterior within it"
        )
    if ours["bound"] is not None:
        return "ours sits on a bound, beyond the central 95 % of a posterior within the bounds"
    return (
        "ours lies outside its own interval: eq. (7) weighs residuals in Hz, high modes most, the posterior "
        "in per cent, and the list is not fitted within its noise"
    )


def layup_rows(table: PrintedTable, sequences: Mapping[str, Any]) -> Iterator[Row]:
    """Rows of Table 9(b): printed stacking sequences beside the posterior over all of them on the grid."""
    for row in table.rows:
        if row.part == "b":
            stored = sequences["cases"].get(row.specimen)
            if stored is not None:
                cell = row.values["angles_deg"]
                yield layup_row(table, row, cell, stored)


def layup_row(table: PrintedTable, row: PrintedRow, cell: PrintedValue, stored: Mapping[str, Any]) -> Row:
    """A printed stacking sequence beside the most probable one of the posterior."""
    printed = stored["printed"]
    inside = in_credible_set(
        printed["probability"], stored["credible_95_count"], stored["enumerated"], printed["rank"]
    )
    verdict: Judged = (WITHIN, "")
    if inside is not True:
        where = "outside the 95 % set" if inside is False else "at the edge of the 95 % set or outside it"
        below = printed["log_evidence_below_best"]
        verdict = (
            NOT_REPRODUCIBLE,
            f"{where} of {stored['credible_95_count']} sequences; the best is {math.exp(below):.3g} times as "
            "probable",
        )
    details = {
        "probability": printed["probability"],
        "best_probability": stored["most_probable"]["probability"],
        "credible_95_count": float(stored["credible_95_count"]),
        "enumerated": float(stored["enumerated"]),
    }
    ours = tuple(stored["most_probable"]["angles_deg"])
    return row_of(table, row, "angles_deg", cell, ours, verdict, details=details)


def in_credible_set(probability: float, count: int, enumerated: int, rank: int | None) -> bool | None:
    """Whether a sequence is in the 95 % credible set, None where that is not certain.

    One more probable than the mean of the set is in it, one less probable than the mean of all others is not.
    """
    if rank is not None and rank <= count // 2:
        return True
    if probability >= 0.95 / count:
        return True
    return False if probability < 0.05 / max(enumerated - count, 1) else None


def row_of(
    table: PrintedTable,
    row: PrintedRow,
    quantity: str,
    cell: PrintedValue,
    ours: float | Sequence[float] | None,
    judged: Judged,
    interval: tuple[float | None, float | None] = (None, None),
    details: Mapping[str, float | None] | None = None,
) -> Row:
    """A printed cell beside ours, a number or angles, with its verdict."""
    number = cell.number
    single = ours if isinstance(ours, float) else None
    return Row(
        table=table.number,
        part=row.part,
        specimen=row.specimen,
        source=row.source,
        quantity=quantity,
        printed=cell.text,
        ours=single if ours is None or single is not None else tuple(ours),  # type: ignore[arg-type]
        difference_percent=None if number is None or not single else 100.0 * (number / single - 1.0),
        q025=interval[0],
        q975=interval[1],
        verdict=judged[0],
        reason=judged[1],
        details=details or {},
    )


def is_unexplained(error: Record) -> bool:
    """Whether a list is not that of the printed plate: its rms misfit exceeds `UNEXPLAINED_PERCENT`."""
    return bool(error["plain_rms_percent"] > UNEXPLAINED_PERCENT)


def disagreements(
    rows: Sequence[Row], misfits: Sequence[Record], simulation: Sequence[Record]
) -> tuple[str, ...]:
    """The most important disagreements as sentences, for the tables that were computed."""
    # misfits of Table 9 are computed for Tables 11 to 14 as well
    own = [m for m in misfits if m["table"] == 9] if any(row.table == 9 for row in rows) else []
    other = {error["specimen"] for error in simulation if is_unexplained(error)}
    return tuple(filter(None, (_frequencies_off(rows), _own_misfit(own), _undetermined(rows, other))))


def _frequencies_off(rows: Sequence[Row]) -> str:
    """Sentence on the plate of Table 5 whose printed frequencies are farthest from the converged ones."""
    off: dict[str, list[tuple[Row, float]]] = {}
    for row in rows:
        difference = row.difference_percent
        if row.table == 5 and difference is not None and abs(difference) < MISPRINTED:
            off.setdefault(row.specimen, []).append((row, difference))
    if not off:
        return ""
    name = max(off, key=lambda n: sum(abs(d) for _, d in off[n]) / len(off[n]))
    furthest, differences = zip(*off[name], strict=True)
    measured = printed_table(4).row(name, "modal test").values
    beside = [100.0 * (float(r.printed) / float(measured[r.quantity].text) - 1.0) for r in furthest]
    unread = [r.quantity.partition("_")[0] for r in rows if r.table == 5 and r.specimen == name]
    unread = [q for q in unread if q not in {r.quantity.partition("_")[0] for r in furthest}]
    but = f" (without the misprinted {listed(unread, 'and')})" if unread else ""
    solvers = [[v for v in row.details.values() if v is not None] for row in furthest]
    apart = max(100.0 * (max(v) / min(v) - 1.0) for v in solvers)
    return (
        f"Table 5, {name}: the ABAQUS frequencies are {min(differences):+.1f} to {max(differences):+.1f} % "
        f"off those of {len(solvers[0])} converged solvers ({apart:.2g} % apart at most) for the printed "
        f"plate. They are within {max(abs(b) for b in beside):.1f} % of the measured list of Table 4{but}, "
        "which the printed plate does not give."
    )


def _own_misfit(misfits: Sequence[Record]) -> str:
    """Sentence on specimens whose printed constants miss their own frequencies; misfits : of Table 9."""
    identified = [m for m in misfits if m["source"] == PAPER]
    if not identified:
        return ""
    worst = max(identified, key=lambda m: float(m["rms_percent"]))
    far = sorted(m["specimen"] for m in identified if m["rms_percent"] > _FAR)
    ten = sum(m["objective"] > 10.0 * m["our_objective"] for m in identified)
    above = f"above {_FAR:g} % for {', '.join(far)}" if far else f"below {_FAR:g} % for all"
    return (
        f"Table 9(a): the printed constants miss their plates' own frequencies, rms {above}; worst "
        f"{worst['specimen']}, {worst['rms_percent']:.3g} %, where the best fit within the bounds leaves "
        f"{worst['our_rms_percent']:.3g} %. Their F, eq. (7), is more than ten times the smallest for "
        f"{ten} of {len(identified)} plates."
    )


def share_of_bounds(row: Row, bounds: Mapping[str, tuple[float, float]]) -> Row:
    """A row with the share of the bounds that its interval spans in its details."""
    assert row.q025 is not None
    assert row.q975 is not None
    low, high = bounds[row.quantity]
    return replace(row, details={**row.details, "share_of_bounds": (row.q975 - row.q025) / (high - low)})


def not_determined(rows: Sequence[Row]) -> str:
    """Sentence on constants within the posterior that could hardly have lain outside it; "" for none."""
    within = [r for r in rows if r.verdict == WITHIN and r.details.get("share_of_bounds") is not None]
    wide = [r for r in within if (r.details["share_of_bounds"] or 0.0) > _UNDETERMINED]
    if not wide:
        return ""
    each = Counter(r.quantity for r in wide)
    of = Counter(r.quantity for r in within)
    counts = ", ".join(f"{name.partition('_')[0]} {n} of {of[name]}" for name, n in each.most_common())
    return (
        f"Of {len(within)} constants within the posterior {len(wide)} say nothing: their 95 % interval spans "
        f"more than {100.0 * _UNDETERMINED:.0f} % of the bounds ({counts}), so that hardly a printed value "
        "could lie outside."
    )


def by_others(source: str) -> bool:
    """Whether a printed value is quoted from another work."""
    return "[" in source


def _undetermined(rows: Sequence[Row], other: Collection[str]) -> str:
    """Sentence on printed digits that the frequencies do not determine: constants and stacking sequences.

    other : plates whose lists are not those of the printed plates.
    """
    identified = [r for r in rows if r.table == 9 and r.part == "a" and r.source == PAPER]
    wide = [r for r in identified if r.q025 and r.q975 and r.q975 > _WIDE * r.q025]
    layups = [r for r in rows if r.table == 9 and r.part == "b"]
    if not identified or not layups:
        return ""
    widest = max(identified, key=lambda r: (r.q975 or 0.0) / (r.q025 or 1.0))
    counts = sorted(int(r.details["credible_95_count"] or 0) for r in layups)
    outside = [r.specimen for r in layups if r.verdict != WITHIN]
    but = [name for name in outside if name in other]
    of_others = f"; the lists of {listed(but, 'and')} are not those of the printed plates" if but else ""
    return (
        f"Table 9: the frequencies determine less than is printed. {len(wide)} of {len(identified)} printed "
        f"constants have a 95 % interval whose ends are a factor of {_WIDE:g} or more apart; "
        f"{widest.quantity} of {widest.specimen}, printed {widest.printed}, has "
        f"{significant(widest.q025 or 0.0, 3)} to {significant(widest.q975 or 0.0, 3)}. The 95 % sets hold "
        f"{counts[0]} to {counts[-1]} stacking sequences; the printed ones of "
        f"{listed(outside, 'and') or 'no plate'} are outside or at the edge{of_others}."
    )
