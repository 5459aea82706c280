"""One frequency per mode from rows of hits, with the scatter of a hit, and errors of the rows."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from cpam_bayes.plate.modes_table import (
    ASTRAY,
    COLUMNS,
    Hit,
    ModesTable,
    TableProblem,
    is_texts,
    once,
    read_sheets,
)
from cpam_bayes.plate.schema import MAX_FREQUENCIES
from cpam_bayes.plate.text import Data, Problem, number, read_named_file, table

Array = NDArray[Any]

# Probability below the upper end of an interval of 95 %.
_UPPER: Final = 0.975
# A mode this far below one with a lower number is misread: no numbering of modes goes so far astray.
_MISNUMBERED: Final = 10.0
# This many equally spaced frequencies are the lines of a spectrum.
_LINES_OF_SPECTRUM: Final = 8
# Damping above this is more than a composite plate has, 0.0005 to 0.03.
_MUCH_DAMPING: Final = 0.05


@dataclass(frozen=True, slots=True)
class TableModes:
    """The modes of a table, ascending.

    frequencies : (n,) Hz, means over hits
    sd : (n,) Hz of a single hit; None where unknown
    labels : "" where there is none
    damping : (n,) ratios, nan where there is none; None where no mode has one
    hits : (n,) number of hits that show the mode
    left_out : names of the modes without a row of positive weight
    unused : headings of the columns that are not read
    remarks : possible slips, a sentence each
    """

    frequencies: Array
    sd: Array | None
    labels: tuple[str, ...]
    damping: Array | None
    hits: Array
    left_out: tuple[str, ...]
    unused: tuple[str, ...]
    remarks: tuple[str, ...]

    def fields(self, name: str) -> dict[str, Any]:
        """The fields of a `Measurement` that the table gives; name : of the table, as in the plate file."""
        return {
            "frequencies": self.frequencies,
            "frequency_sd": self.sd,
            "labels": self.labels,
            "damping": self.damping,
            "origin": f"{name}: {self.origin}",
            "remarks": tuple(f"{name}: {remark}" for remark in self.remarks),
        }

    @property
    def origin(self) -> str:
        """The origin of the frequencies, in words."""
        fewest, most = int(self.hits.min()), int(self.hits.max())
        span = f"{most}" if fewest == most else f"{fewest} to {most}"
        said = ["one hit a mode" if most == 1 else f"means of {span} hits a mode"]
        if self.left_out:
            said.append(f"left out: {', '.join(self.left_out)}")
        if self.unused:
            said.append(f"columns not used: {', '.join(self.unused)}")
        return "; ".join(said)


@dataclass(frozen=True, slots=True)
class _Mode:
    """A mode with its rows; variance : of a single hit, nan for one; freedom : degrees of freedom of it."""

    name: str
    label: str
    rows: tuple[Hit, ...]
    mean: float
    variance: float
    freedom: float
    stated: float


def small_sample_factor(freedom: float) -> float:
    """Factor that enlarges a standard deviation from few hits, t_{0.975}(freedom) / 1.96.

    A normal density so enlarged has the 95 % interval of Student's t, which is that of a further hit when the
    standard deviation itself is estimated (Gelman et al., Bayesian Data Analysis, section 3.2).
    """
    return float(t.ppf(_UPPER, freedom) / norm.ppf(_UPPER))


def modes_of(
    table: ModesTable, *, complete: bool, least: float = 0.0
) -> tuple[TableModes | None, tuple[TableProblem, ...]]:
    """One frequency per mode with the scatter of its hits, or all errors.

    The scatter is that of a single hit, as errors common to all hits do not show in it, enlarged by
    `small_sample_factor`; a mode with one hit takes the pooled relative scatter of all others. It is at least
    the rounding of the table, the root mean square of stated standard deviations, and ``least``.

    complete : whether gaps between modes are refused
    least : lower limit of a standard deviation, as a fraction of the frequency
    """
    groups, problems = _grouped(table)
    problems += [problem for name, rows in groups for problem in _astray(table, name, rows)]
    modes = [_mode(name, rows) for name, rows in groups]
    used = sorted((mode for mode in modes if mode.rows), key=lambda mode: mode.mean)
    if not problems and not used:
        problems.append(TableProblem(0, "", "no frequency, or no weight above 0, accepted: at least one"))
    problems = problems or list(_implausible(used, table.step))
    if problems:
        return None, once(problems)
    if len(used) > MAX_FREQUENCIES:
        what = f"too many modes, received {len(used)}, accepted: up to {MAX_FREQUENCIES}"
        return None, (TableProblem(0, "", what),)
    gaps = _gaps(table, groups, used) if complete else []
    if gaps:
        return None, tuple(gaps)
    sd = _scatter(used, table.step)
    if sd is not None:
        sd = np.maximum(sd, least * np.array([mode.mean for mode in used]))
    if sd is not None and not np.all(np.isfinite(sd)):
        lines = [mode.rows[0].line for mode, one in zip(used, sd, strict=True) if not np.isfinite(one)]
        what = "missing, accepted: one for each mode, as others have one"
        return None, tuple(TableProblem(line, "sd", what) for line in lines)
    damping = np.array([_mean_damping(mode.rows) for mode in used])
    return TableModes(
        frequencies=np.array([mode.mean for mode in used]),
        sd=sd,
        labels=tuple(mode.label for mode in used),
        damping=None if np.all(np.isnan(damping)) else damping,
        hits=np.array([len(mode.rows) for mode in used]),
        left_out=tuple(mode.name for mode in modes if not mode.rows),
        unused=table.unused,
        remarks=(*_rounded(used, least), *_damped(damping, table.units.get("damping", ""))),
    ), ()


def _implausible(used: Sequence[_Mode], step: float) -> Iterator[TableProblem]:
    """Modes far below one with a lower number, and equally spaced frequencies."""
    numbered = sorted((mode for mode in used if mode.name.isdecimal()), key=lambda mode: int(mode.name))
    for low, high in itertools.pairwise(numbered):
        if high.mean * _MISNUMBERED < low.mean:
            what = (
                f"mode {high.name}: received {high.mean:g} Hz below the {low.mean:g} Hz of mode {low.name}, "
                "accepted: modes numbered from the lowest on; are these decimal commas or marks of thousands?"
            )
            yield TableProblem(high.rows[0].line, "hz", what, "misnumbered")
    steps = np.diff([mode.mean for mode in used])
    if len(used) >= _LINES_OF_SPECTRUM and np.ptp(steps) <= 1e-6 * used[-1].mean and steps[0] > 2.0 * step:
        what = f"the lines of a spectrum, received {len(used)} frequencies at steps of {steps[0]:.6g} Hz"
        yield TableProblem(
            0, "hz", f"{what}, accepted: natural frequencies, as `cpam-bayes poles FILE` finds"
        )


def _astray(table: ModesTable, name: str, every: Sequence[Hit]) -> list[TableProblem]:
    """The hit furthest from the others of its mode, where it is too far to belong to it."""
    rows = [row for row in every if row.hz is not None and row.weight > 0.0]
    f = np.array([row.hz for row in rows])
    if len(rows) < 2:
        return []
    away = np.abs(np.log(f / np.median(f)))
    if away.max() <= np.log(ASTRAY):
        return []
    at = int(np.argmax(away))
    called = f"mode {name}" if "mode" in table.columns else name
    hit = f", hit {rows[at].hit}" if rows[at].hit else ""
    others = ", ".join(f"{value:g}" for value in np.delete(f, at)[:5])
    what = (
        f"{called}{hit}: received {f[at]:g} Hz beside {others} Hz, accepted: hits of one mode, which agree "
        "to 20 %; correct it, or leave it out by a weight of 0"
    )
    return [TableProblem(rows[at].line, "hz", what, "astray")]


def _rounded(modes: Sequence[_Mode], least: float) -> tuple[str, ...]:
    """A remark where repeats are equal to the last digit and nothing else tells the scatter."""
    repeated = [mode for mode in modes if mode.freedom > 0.0]
    is_stated = least > 0.0 or any(np.isfinite(mode.stated) for mode in modes)
    if is_stated or not repeated or any(mode.variance > 0.0 for mode in repeated):
        return ()
    return (
        "the hits of each mode are equal to the last digit, so that they show the rounding alone and no "
        "scatter; state relative_std in [measurement], 0.002 for a usual tap test, or write more digits",
    )


def _damped(damping: Array, unit: str) -> tuple[str, ...]:
    """A remark on more damping than plates have: most likely per cent read as ratios."""
    most = float(np.max(damping, initial=0.0, where=np.isfinite(damping)))
    if most <= _MUCH_DAMPING:
        return ()
    read = f"{100.0 * most:g} % of critical damping"
    if unit != "%":
        read = f"{most:g} is read as a ratio, {read}"
    cure = "; if per cent is meant, the head is damping [%]" if unit in ("", "1", "-") else ""
    return (f"damping up to {read}, where composite plates have 0.05 to 3 %{cure}",)


def _grouped(table: ModesTable) -> tuple[list[tuple[str, tuple[Hit, ...]]], list[TableProblem]]:
    """Rows by mode, or by label where there are no modes, and their errors."""
    by = "mode" if "mode" in table.columns else "label" if "label" in table.columns else ""
    groups: dict[str, list[Hit]] = {}
    seen: set[tuple[str, object]] = set()
    labels_of: dict[str, set[str]] = {}
    problems = []
    counted = all(row.mode.rstrip(".").isdecimal() for row in table.hits if row.mode and row.hz is not None)
    above = ""
    for row in table.hits:
        key = str(getattr(row, by)) if by else ""
        if by == "mode" and counted and key and row.hz is None and not any(map(str.isdecimal, key)):
            continue  # a line of text below
        # merged cells: the hits below belong to the mode above
        key = key or (above if row.hit else "")
        above = key
        if not key and ((by == "mode" and row.hz is not None) or (by and "hit" in table.columns)):
            problems.append(
                TableProblem(row.line, by, f"missing, accepted: the {by} that was hit", "missing")
            )
            continue
        if (
            row.hit
            and not any(map(str.isdecimal, row.hit))
            and any(other.hit.isdecimal() for other in table.hits)
        ):
            what = f"not a hit, received {row.hit} beside numbers, accepted: numbers, or a text for each"
            problems.append(TableProblem(row.line, "hit", what, "hit"))
        name = key or f"line {row.line}"
        if row.hit and (name, row.hit) in seen:
            problems.append(
                TableProblem(row.line, "hit", f"hit {row.hit} of {by} {key} a second time, accepted: once")
            )
        seen.add((name, row.hit))
        labels = labels_of.setdefault(name, set())
        labels |= {row.label} - {""}
        if len(labels) > 1:
            problems.append(
                TableProblem(row.line, "label", f"{by} {key} has the labels {' and '.join(sorted(labels))}")
            )
        groups.setdefault(name, []).append(row)
    return [(key, tuple(rows)) for key, rows in groups.items()], problems


def _mode(name: str, every: Sequence[Hit]) -> _Mode:
    """Weighted mean and variance of a single hit, with as many degrees of freedom as the weights leave."""
    rows = tuple(row for row in every if row.hz is not None and row.weight > 0.0)
    label = next((row.label for row in every if row.label), "")
    if not rows:
        return _Mode(name, label, (), np.nan, np.nan, 0.0, np.nan)
    f, w = np.array([row.hz for row in rows]), np.array([row.weight for row in rows])
    mean = float(np.average(f, weights=w))
    count = float(w.sum() ** 2 / np.sum(w**2))
    freedom = count - 1.0 if len(rows) > 1 else 0.0
    variance = float(np.average((f - mean) ** 2, weights=w) * count / freedom) if freedom > 0.0 else np.nan
    stated = [row.sd for row in rows if row.sd is not None]
    rms = float(np.sqrt(np.mean(np.square(stated)))) if stated else np.nan
    return _Mode(name, label, rows, mean, variance, freedom, rms)


def _scatter(modes: Sequence[_Mode], step: float) -> Array | None:
    """Standard deviation of a single hit, Hz, nan where unknown; None where all are."""
    freedom = np.array([mode.freedom for mode in modes])
    mean, variance, stated = (
        np.array([getattr(mode, name) for mode in modes]) for name in ("mean", "variance", "stated")
    )
    repeated = freedom > 0.0
    sd = np.full(len(modes), np.nan)
    for i in np.flatnonzero(repeated):
        sd[i] = np.sqrt(variance[i]) * small_sample_factor(freedom[i])
    if repeated.any():
        whole = float(freedom[repeated].sum())
        relative = np.sqrt(np.sum((freedom * variance / mean**2)[repeated]) / whole)
        alone = ~repeated & np.isnan(stated)
        sd[alone] = relative * mean[alone] * small_sample_factor(whole)
        sd = np.where(np.isnan(sd), np.nan, np.maximum(sd, step / np.sqrt(12.0)))
    sd = np.fmax(sd, stated)
    return None if np.all(np.isnan(sd)) else sd


def _gaps(
    table: ModesTable, groups: Sequence[tuple[str, tuple[Hit, ...]]], used: Sequence[_Mode]
) -> list[TableProblem]:
    """Modes missing below the last one used, which a complete list must have."""
    cure = "accepted: complete = false in [measurement], as the list then lacks a mode"
    highest, seen = used[-1].mean, {mode.name for mode in used}
    problems = []
    for name, rows in groups:
        known = [row.hz for row in rows if row.hz is not None]
        is_last = name.isdecimal() and all(mode.isdecimal() and int(mode) < int(name) for mode in seen)
        if name not in seen and (float(np.mean(known)) < highest if known else not is_last):
            called = f"mode {name}" if "mode" in table.columns else name
            problems.append(TableProblem(rows[0].line, "hz", f"{called} is left out, {cure}"))
    if "mode" in table.columns and all(name.isdecimal() for name, _ in groups):
        numbers = sorted(int(name) for name, _ in groups)
        absent = sorted(set(range(numbers[0], numbers[-1])) - set(numbers))
        if absent:
            listed = ", ".join(map(str, absent[:10]))
            problems.append(TableProblem(0, "mode", f"the numbers lack {listed}, {cure}"))
    return problems


def _mean_damping(rows: Sequence[Hit]) -> float:
    given = [(row.damping, row.weight) for row in rows if row.damping is not None]
    if not given:
        return float("nan")
    ratio, weight = np.array(given).T
    return float(np.average(ratio, weights=weight))


_KEY = ("measurement", "table")


def table_of(data: Data, directory: Path | None) -> tuple[TableModes | None, list[Problem]]:
    """The modes of the table that a plate file names, and its problems, by line and column.

    directory : base of relative paths
    """
    measurement = table(data, "measurement")
    name = measurement.get("table")
    if not isinstance(name, str) or not name:
        return None, []
    content, unread = read_named_file(_KEY, name, directory, "a table of modes")
    if content is None:
        return None, unread
    rows, problems, others = read_sheets(content, heads_named(measurement))
    modes: TableModes | None = None
    if rows is not None:
        least = max(number(measurement, "relative_std") or 0.0, 0.0)
        modes, problems = modes_of(rows, complete=measurement.get("complete") is not False, least=least)
    if modes is not None and others:
        said = f"tables of modes stand in {' and '.join(others)} too, which are not read"
        modes = replace(modes, remarks=(*modes.remarks, said))
    return modes, [located(_KEY, name, problem) for problem in problems]


def heads_named(measurement: Data) -> dict[str, list[str]]:
    """The headings of each column of a table, as named in [measurement.columns]."""
    return {
        column: [heads] if isinstance(heads, str) else heads
        for column, heads in table(measurement, "columns").items()
        if column in COLUMNS and (isinstance(heads, str) or is_texts(heads))
    }


def located(key: tuple[str, ...], name: str, problem: TableProblem) -> Problem:
    """The problem of a table that a plate file names under a key."""
    return Problem(key, f"{Path(name).name} {problem}", choices=problem.choices)
