"""Rows of the tables: printed and computed values side by side, and the verdict on each."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from cpam_bayes.comparison.cases import BUILT_IN, FOUR, TWO
from cpam_bayes.comparison.records import AGREES, INPUT, NOT_REPRODUCIBLE, WITHIN, Row
from cpam_bayes.comparison.tasks import Results
from cpam_bayes.paper import PrintedRow, PrintedTable, PrintedValue
from cpam_bayes.paper.percentages import last_digit
from cpam_bayes.paper.tables import WITHOUT_NOISE

__all__ = ["constant_rows", "frequency_rows", "input_rows", "layup_rows", "noise_rows"]

Computed = Mapping[tuple[str, str, str], Results]
"""Kind, specimen and case of a task -> its results."""

# A printed frequency agrees with a converged one up to this, %: what a mesh of 100 elements may be off.
_SOLVER_PERCENT: Final = 0.5
# An identified constant agrees with the best fit up to this, %.
_CONSTANT_PERCENT: Final = 1.0
# Means agree up to so many standard errors of their difference.
_STANDARD_ERRORS: Final = 2.0
_PRINTED_GROUPS: Final = 10


def input_rows(table: PrintedTable) -> Iterator[Row]:
    """Tables 2 to 4, and rows elsewhere that are references or measurements."""
    for row in table.rows:
        if row.role in ("input", "measured"):
            for quantity, cell in row.values.items():
                yield _row(table, row, quantity, cell, None, INPUT)


def frequency_rows(table: PrintedTable, computed: Computed, calculix: Mapping[str, Any]) -> Iterator[Row]:
    """Tables 1 and 5: printed frequencies of a solver beside the Ritz method, elements and CalculiX."""
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
            verdict = _frequency_verdict(cell, solvers)
            yield _row(table, row, quantity, cell, solvers["ritz_hz"], verdict, details=solvers)


def _frequency_verdict(cell: PrintedValue, solvers: Mapping[str, float | None]) -> str:
    if cell.misprinted("value"):
        return f"{NOT_REPRODUCIBLE}: {cell.misprints[0].note}"
    ours = [v for v in solvers.values() if v is not None]
    off = 100.0 * (float(cell.text) / ours[0] - 1.0)
    if abs(off) <= max(_SOLVER_PERCENT, 50.0 * last_digit(cell.text) / ours[0]):
        return AGREES
    spread = 100.0 * (max(ours) / min(ours) - 1.0)
    together = f"{len(ours)} converged solvers agree to {spread:.2g} %" if len(ours) > 1 else "converged"
    return f"{NOT_REPRODUCIBLE}: {together} and the printed value is {off:+.1f} % off"


def constant_rows(table: PrintedTable, computed: Computed) -> Iterator[Row]:
    """Tables 6 to 9(a): identified constants beside the best fit and its posterior interval."""
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
            verdict = _constant_verdict(cell, ours, why)
            interval = (ours["q025"], ours["q975"])
            yield _row(
                table, row, quantity, cell, ours["value"], verdict, interval, {"posterior_mean": ours["mean"]}
            )


def _constant_verdict(cell: PrintedValue, ours: Mapping[str, Any], why: str) -> str:
    printed = float(cell.text)
    if abs(printed - ours["value"]) <= max(
        0.01 * _CONSTANT_PERCENT * abs(ours["value"]), last_digit(cell.text) / 2
    ):
        return AGREES
    if ours["q025"] <= printed <= ours["q975"]:
        return WITHIN
    return f"{NOT_REPRODUCIBLE}: outside the 95 % interval; {why}"


def layup_rows(table: PrintedTable, sequences: Mapping[str, Any]) -> Iterator[Row]:
    """Table 9(b): printed stacking sequences beside the posterior over all of them on the grid."""
    for row in table.rows:
        if row.part == "b":
            stored = sequences["cases"].get(row.specimen)
            if stored is not None:
                cell = row.values["angles_deg"]
                yield _layup_row(table, row, cell, stored)


def _layup_row(table: PrintedTable, row: PrintedRow, cell: PrintedValue, stored: Mapping[str, Any]) -> Row:
    printed = stored["printed"]
    inside = in_credible_set(
        printed["probability"], stored["credible_95_count"], stored["enumerated"], printed["rank"]
    )
    verdict = WITHIN
    if inside is not True:
        where = "outside the 95 % set" if inside is False else "at the edge of the 95 % set or outside it"
        below = printed["log_evidence_below_best"]
        verdict = (
            f"{NOT_REPRODUCIBLE}: {where} of {stored['credible_95_count']} sequences; the best is "
            f"{math.exp(below):.3g} times as probable"
        )
    details = {
        "probability": printed["probability"],
        "best_probability": stored["most_probable"]["probability"],
        "credible_95_count": float(stored["credible_95_count"]),
        "enumerated": float(stored["enumerated"]),
    }
    ours = tuple(stored["most_probable"]["angles_deg"])
    return _row(table, row, "angles_deg", cell, ours, verdict, details=details)


def in_credible_set(probability: float, count: int, enumerated: int, rank: int | None) -> bool | None:
    """Whether a sequence is in the set of the most probable ones with 95 %, None where that is not certain.

    One that is more probable than the mean of the set is in it, one less probable than the mean of
    all others is not.
    """
    if rank is not None and rank <= count // 2:
        return True
    if probability >= 0.95 / count:
        return True
    return False if probability < 0.05 / max(enumerated - count, 1) else None


def noise_rows(table: PrintedTable, computed: Computed, sequences: Mapping[str, Any]) -> Iterator[Row]:
    """Tables 10 to 14: printed means of ten beside the repetition and the posterior at that noise."""
    (specimen,) = {row.specimen for row in table.rows}
    results = computed.get(("noise", specimen, BUILT_IN))
    if results is None:
        return
    point = computed.get(("constants", specimen, TWO if specimen == "A2" else BUILT_IN))
    levels = dict(zip([r.source for r in table.rows[1:]], results["levels"], strict=True))
    for row in table.rows:
        for quantity, cell in row.values.items():
            if quantity == "angles_deg":
                yield _noisy_layup(table, row, cell, sequences["cases"].get(specimen))
            elif row.source == WITHOUT_NOISE:
                if point is not None:
                    yield _without_noise(table, row, quantity, cell, point["constants"][quantity])
            else:
                yield _noisy(table, row, quantity, cell, levels[row.source], results)


def _without_noise(
    table: PrintedTable, row: PrintedRow, quantity: str, cell: PrintedValue, ours: Mapping[str, Any]
) -> Row:
    why = "see the same constant in Table 9(a)" if table.number > 10 else "see the same constant in Table 8"
    verdict = _constant_verdict(cell, ours, why)
    return _row(table, row, quantity, cell, ours["value"], verdict, (ours["q025"], ours["q975"]))


def _noisy(
    table: PrintedTable,
    row: PrintedRow,
    quantity: str,
    cell: PrintedValue,
    level: Mapping[str, Any],
    results: Results,
) -> Row:
    ours = level["constants"][quantity]
    mean, groups = ours["repetition_mean"], results["groups"]
    error = ours["repetition_sd"] * math.sqrt(1.0 / groups + 1.0 / _PRINTED_GROUPS)
    free, printed = results["without_noise"][quantity], float(cell.text)
    away = abs(printed - mean) / error if error > 0.0 else math.inf
    if away <= _STANDARD_ERRORS:
        verdict = AGREES
    elif ours["q025"] <= printed <= ours["q975"]:
        verdict = WITHIN
    else:
        verdict = (
            f"{NOT_REPRODUCIBLE}: {away:.3g} standard errors of a difference of two means of {groups} "
            f"away, and outside the 95 % interval at that noise; without noise ours is {free:.4g} already"
        )
    details = {
        "repetition_sd": ours["repetition_sd"],
        "standard_errors": away if math.isfinite(away) else None,
        "printed_percent": float(cell.percent),
        "our_percent": 100.0 * (mean / free - 1.0),
        "posterior_mean": ours["posterior_mean"],
    }
    return _row(table, row, quantity, cell, mean, verdict, (ours["q025"], ours["q975"]), details)


def _noisy_layup(
    table: PrintedTable, row: PrintedRow, cell: PrintedValue, stored: Mapping[str, Any] | None
) -> Row:
    if row.source == WITHOUT_NOISE and stored is not None:
        return _layup_row(table, row, cell, stored)
    why = (
        "a mean of ten angles on a grid of 5 degrees is on that grid by chance only, and a sequence and its "
        "mirror image, which no frequency tells apart, average to zero"
    )
    return _row(table, row, "angles_deg", cell, None, f"{NOT_REPRODUCIBLE}: {why}")


def _row(
    table: PrintedTable,
    row: PrintedRow,
    quantity: str,
    cell: PrintedValue,
    ours: float | Sequence[float] | None,
    verdict: str,
    interval: tuple[float | None, float | None] = (None, None),
    details: Mapping[str, float | None] | None = None,
) -> Row:
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
        verdict=verdict,
        details=details or {},
    )
