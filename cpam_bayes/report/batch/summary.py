"""`batch` in plain words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cpam_bayes.batches.batch import BatchResult
from cpam_bayes.batches.limits import Limit
from cpam_bayes.batches.plate_row import PlateRow
from cpam_bayes.batches.population import LEAST_PLATES
from cpam_bayes.diagnosis.claim import BESIDE
from cpam_bayes.formatting import fixed, listed, significant, with_spread
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed

SURE: Final = 0.95
"""Probability of meeting a limit from which a plate is said to, and 1 - it to fail."""
_SHOWN = 40


def summary(result: BatchResult) -> Summary:
    """How many plates are done, which meet their limits, which stand out."""
    some = result.rows if len(result.rows) <= _SHOWN else result.rows[:_SHOWN]
    title = "Plates" if some is result.rows else f"The first {_SHOWN} of {len(result.rows)} plates"
    return Summary(
        title=f"batch {result.title}",
        headline=_headline(result),
        tables=(
            _batch_table(result),
            _population_table(result),
            _limits_table(result),
            plates_table(result, some, title),
            _failed(result),
        ),
        basis=_basis(result),
        warnings=result.warnings,
        next_steps=_next_steps(result),
    )


def plates_table(result: BatchResult, rows: Sequence[PlateRow], title: str) -> Table:
    """A row a plate: constants with their standard deviations, limits, the claim."""
    heads = [f"{name}, {unit_of(name)}" if unit_of(name) else name for name in result.constants]
    columns = ["plate", *heads, *(f"#P({limit.text})" for limit in result.limits)]
    columns += ["what is wrong"] if result.diagnosis else []
    lines, flagged = [], []
    for i, row in enumerate(rows):
        line = [row.name, *(_constant(row, name) for name in result.constants)]
        line += [_probability(result.probability(row, limit)) for limit in result.limits]
        line += [_claim(row)] if result.diagnosis else []
        lines.append(tuple(line))
        if row.status == "failed" or any(_fails(result, row, limit) for limit in result.limits):
            flagged.append(i)
    return Table(title, headed(*columns), tuple(lines), frozenset(flagged))


def _constant(row: PlateRow, name: str) -> str:
    c = row.constant(name)
    if c is None:
        return "failed" if row.status == "failed" else ""
    value, sd = with_spread(to_user(name, c.value), to_user(name, c.sd))
    open_ = "" if c.verdict == "determined by the data" else " (open)"
    return f"{value} +- {sd}{open_}"


def _probability(p: float | None) -> str:
    if p is None:
        return ""
    return fixed(p, 3) if 0.001 <= p <= 0.999 else ("< 0.001" if p < 0.5 else "> 0.999")


def _claim(row: PlateRow) -> str:
    found = row.diagnosis
    if found is None:
        return ""
    if found.claim == "none":
        return f"nothing (P {found.probability:.2f})"
    causes = f": {', '.join(found.causes)}" if found.causes else ""
    beside = found.probability_beside
    more = f", with another one (P {beside:.2f})" if beside >= BESIDE * found.probability else ""
    return f"{found.claim}{causes} (P {found.probability:.2f}){more}"


def _fails(result: BatchResult, row: PlateRow, limit: Limit) -> bool:
    p = result.probability(row, limit)
    return p is not None and p < SURE


def _batch_table(result: BatchResult) -> Table:
    """Mean, scatter between plates and spread of a single plate of each constant."""
    columns = headed("", "#mean", "#sd of plates", "#sd of one plate", "unit", "determined in", "stand out")
    lines, flagged = [], []
    for k, name in enumerate(result.constants):
        found = [c for row in result.done if (c := row.constant(name)) is not None]
        values = np.array([to_user(name, c.value) for c in found])
        own = np.array([to_user(name, c.sd) for c in found])
        known = sum(c.verdict == "determined by the data" for c in found)
        scatter = float(values.std(ddof=1)) if len(values) > 1 else float("nan")
        outside = [row.name for row in result.outside(name)]
        flagged += [k] if outside else []
        lines.append(
            (
                name,
                significant(float(values.mean()), 4),
                significant(scatter, 2),
                significant(float(np.median(own)), 2),
                unit_of(name),
                f"{known} of {len(found)}",
                " ".join(outside),
            )
        )
    return Table("The batch", columns, tuple(lines), frozenset(flagged))


def _population_table(result: BatchResult) -> Table:
    """Mean constants of the material, their scatter, and where a further plate would lie."""
    columns = headed("", "#mean", "#sd", "unit", "scatter of plates, 95 %", "a further plate, 95 %")
    lines = []
    for c in () if result.population is None else result.population.constants:
        value, sd, *_ = (to_user(c.name, v) for v in c.mean)
        low, high = (
            with_spread(to_user(c.name, v), to_user(c.name, c.next_plate[1]))[0] for v in c.next_plate[2:]
        )
        scatter = " to ".join(significant(100.0 * v, 2) for v in c.scatter[2:])
        lines.append((c.name, *with_spread(value, sd), unit_of(c.name), f"{scatter} %", f"{low} to {high}"))
    return Table("The material: mean constants, and their scatter from plate to plate", columns, tuple(lines))


def _limits_table(result: BatchResult) -> Table:
    rows, flagged = [], []
    for k, limit in enumerate(result.limits):
        p = [v for row in result.done if (v := result.probability(row, limit)) is not None]
        sure, failing = sum(v >= SURE for v in p), sum(v <= 1.0 - SURE for v in p)
        flagged += [k] if sure < len(p) else []
        rows.append((limit.text, str(sure), str(len(p) - sure - failing), str(failing)))
    columns = headed("limit", f"#met, P >= {SURE:g}", "#open", f"#not met, P <= {1 - SURE:.2g}")
    return Table("Limits", columns, tuple(rows), frozenset(flagged))


def _failed(result: BatchResult) -> Table:
    rows = tuple((row.file, row.message) for row in result.failed)
    return Table("Plates without an answer", headed("file", "why"), rows, frozenset(range(len(rows))))


def _headline(result: BatchResult) -> str:
    n, done = len(result.rows), len(result.done)
    begun = f"{done} of {n} plates have an answer" if done < n else f"All {n} plates have an answer"
    said = [f"{begun}."]
    for limit in result.limits:
        p = [v for row in result.done if (v := result.probability(row, limit)) is not None]
        said.append(f"{sum(v >= SURE for v in p)} of {len(p)} meet {limit.text} with 95 % probability.")
    if result.diagnosis and result.done:
        clean = sum(row.diagnosis is not None and row.diagnosis.claim == "none" for row in result.done)
        said.append(f"Of {clean} the plate model explains the list.")
    standing = list(dict.fromkeys(row.name for name in result.constants for row in result.outside(name)))
    if standing:
        said.append(f"Beyond the control limits: {listed(standing[:10], 'and')}.")
    return " ".join(said)


def _basis(result: BatchResult) -> tuple[str, ...]:
    geometries = "one geometry" if result.models == 1 else f"{result.models} geometries"
    said = [
        "Each plate: swarms on relative residuals, and Laplace's approximation of the posterior about their "
        "answer; a constant marked (open) is not determined by the frequencies alone.",
        f"Models: {geometries}. A list is carried to the sizes of the first plate of its geometry by the "
        "powers of the sizes at the reference constants.",
    ]
    if result.population is not None:
        said.append(
            "Mean and scatter: a hierarchical model of Gaussian plates, sampled by emcee from the likelihood "
            "of each; the scatter has a prior of half a Student-t, 5 % wide."
        )
    if any(result.chart(name) for name in result.constants):
        said.append(
            "Control limits: median +- 3 sd, the sd from the median difference of neighbours in the list "
            "(1.047 times the median moving range), which a few bad plates do not widen."
        )
    return tuple(said)


def _next_steps(result: BatchResult) -> tuple[str, ...]:
    steps = []
    if result.failed:
        steps.append(
            "Correct the files that failed and run the batch again: with --store the others are kept."
        )
    open_ = [
        (row, limit)
        for limit in result.limits
        for row in result.done
        if 1.0 - SURE < (result.probability(row, limit) or 0.0) < SURE
    ]
    if open_:
        row, limit = open_[0]
        steps.append(
            f"Repeat the test of the plates whose limits are open, {row.name} for instance: {limit.text} is "
            "neither met nor missed with 95 % probability."
        )
    standing = any(result.outside(name) for name in result.constants)
    if standing and not result.diagnosis:
        steps.append("Ask what is wrong with the plates that stand out: cpam-bayes diagnose FILE.")
    one_material = len({row.material for row in result.done}) == 1
    if result.population is None and one_material and len(result.done) >= LEAST_PLATES:
        steps.append(
            "Get the mean constants of the material and their scatter from plate to plate: --hierarchical."
        )
    return tuple(steps)
