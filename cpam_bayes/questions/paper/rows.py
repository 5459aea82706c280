"""Printed values beside computed ones, the verdict on each, and the audit of the print.

Verdicts: a frequency agrees up to 0.5 % or half a unit of its last digit, an identified constant up to 1 %, a
mean of ten within two standard errors of the difference of two such means and 5 %; within the standard errors
alone the two cannot be told apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, Literal, get_args

import numpy as np

from cpam_bayes.formatting import listed, significant
from cpam_bayes.printed.tables import (
    PAPER,
    WITHOUT_NOISE,
    PrintedRow,
    PrintedTable,
    PrintedValue,
    last_digit,
    printed_table,
)

__all__ = [
    "AGREES",
    "BUILT_IN",
    "FOUR",
    "INPUT",
    "MISPRINTED",
    "NOT_REPRODUCIBLE",
    "TWO",
    "UNTOLD",
    "VERDICTS",
    "WITHIN",
    "Computed",
    "Cost",
    "MeansOfTen",
    "Misfit",
    "NoisyAngles",
    "Results",
    "Row",
    "SimulationError",
    "Verdict",
    "WellPosed",
    "constant_rows",
    "disagreements",
    "frequency_rows",
    "input_rows",
    "layup_rows",
    "means_of_ten",
    "noise_rows",
    "noisy_angles",
]

BUILT_IN, TWO, FOUR = "as built in", "two constants", "four constants"
"""Choices of unknowns: those of the built-in specimen, or two or four constants of an aluminium plate."""
Verdict = Literal["agrees", "within the posterior", "cannot be told apart", "not reproducible", "input"]
VERDICTS: Final[tuple[Verdict, ...]] = get_args(Verdict)
AGREES, WITHIN, UNTOLD, NOT_REPRODUCIBLE, INPUT = VERDICTS
Results = dict[str, Any]
"""Plain data of one finished computation."""
Computed = Mapping[tuple[str, str, str], Results]
"""Kind, specimen and case of a task -> its results."""

Judged = tuple[Verdict, str]
"""A verdict, and what is to be said about it."""

# A printed frequency agrees with a converged one up to this, %: what a mesh of 100 elements may be off.
_SOLVER_PERCENT: Final = 0.5
# An identified constant agrees with the best fit up to this, %.
_CONSTANT_PERCENT: Final = 1.0
# A difference beyond this is a misprint, %.
MISPRINTED: Final = 50.0
# Misfit of printed constants that is worth a name, %; ends of an interval this factor apart are far apart.
_FAR, _WIDE = 5.0, 1.5
# Means agree up to so many standard errors of their difference, if they are no further apart than this, %.
_STANDARD_ERRORS, _MEAN_PERCENT = 2.0, 5.0
# From this share of inversions on a bound their scatter says nothing of the noise.
_STUCK: Final = 0.5
_PRINTED_GROUPS: Final = 10


@dataclass(frozen=True, slots=True)
class Row:
    """One printed value beside the computed one.

    printed : as printed. ours : number, or angles in degrees from the outermost ply, or None for inputs.
    difference_percent : printed over ours, less one.
    q025, q975 : posterior interval of the quantity, where there is one.
    reason : why it is not reproducible, or what else explains the verdict; "" where there is nothing to say.
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


@dataclass(frozen=True, slots=True)
class Misfit:
    """A printed set of constants and ours against the same frequencies; forward solves only.

    objective : F of eq. (7), Hz^2. rms_percent : root mean square of the relative residuals.
    case : "as built in", "two constants" or "four constants".
    swarms_found : how many of the swarms ended within 0.1 % of the least F.
    swarms_converged : how many of them called themselves converged.
    on_bounds : constants of ours that sit on a bound.
    """

    table: int
    specimen: str
    case: str
    source: str
    objective: float
    rms_percent: float
    our_objective: float
    our_rms_percent: float
    swarms: int
    swarms_found: int
    swarms_converged: int
    on_bounds: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class WellPosed:
    """Hadamard's conditions for the constants of a plate from its measured frequencies, at the best optimum.

    Existence
        left_percent : root of the residual sum of squares over the degrees of freedom, of relative residuals;
        None where there are none. repeatability_percent : 97.5 % quantile of what a tap test repeats within.
    Uniqueness
        rank, condition : of the sensitivities d ln f / d ln x; condition is None where the rank is not full.
        optima : that the misfit does not tell apart, the best one among them. layups : stacking sequences in
        the 95 % set where angles are unknown too, None where that was not computed.
    Stability
        percent_per_percent : name -> sd of a constant, %, for 1 % of noise on each frequency, to first order
        and without bounds; None where the rank is not full.
    """

    table: int
    specimen: str
    case: str
    frequencies: int
    unknowns: int
    left_percent: float | None
    repeatability_percent: float
    rank: int
    condition: float | None
    optima: int
    layups: int | None
    percent_per_percent: Mapping[str, float | None]

    @property
    def exists(self) -> bool | None:
        """Whether what is left is within the repeatability of a tap test; None where nothing can be left."""
        return None if self.left_percent is None else self.left_percent <= self.repeatability_percent

    @property
    def is_unique(self) -> bool:
        """Whether the sensitivities have full rank and no other optimum, or layup, fits as well."""
        return self.rank == self.unknowns and self.optima == 1 and self.layups in (None, 1)


@dataclass(frozen=True, slots=True)
class SimulationError:
    """The error of the simulation of Table 5, or 1, on a plate, by the diagnosis of its measured list.

    printed_rms_percent : of the printed simulation, with the reference constants, against the measured list;
        None where none is printed
    plain_rms_percent, extended_rms_percent : of the plain model with its own constants, and extended by what
        is claimed; None where nothing is
    claim, causes, probability : of the diagnosis
    log_bayes_factor : of what is claimed against the plain model. held_out, held_out_se : log predictive
        density of frequencies left out, less the plain model's, and its standard error
    """

    table: int
    specimen: str
    printed_rms_percent: float | None
    plain_rms_percent: float
    claim: str
    causes: tuple[str, ...]
    probability: float
    extended_rms_percent: float | None
    log_bayes_factor: float | None
    held_out: float | None
    held_out_se: float | None


@dataclass(frozen=True, slots=True)
class Cost:
    """Forward solves of a plate's optimum, single swarms and posterior, and their wall time.

    calculix_seconds : of one run of CalculiX on that plate, None where none was timed.
    """

    specimen: str
    case: str
    forward_solves: int
    seconds: float
    calculix_seconds: float | None

    @property
    def calculix_hours(self) -> float | None:
        """The time of as many runs of CalculiX one after another."""
        return None if self.calculix_seconds is None else self.forward_solves * self.calculix_seconds / 3600.0


def input_rows(table: PrintedTable) -> Iterator[Row]:
    """Tables 2 to 4, and rows elsewhere that are references or measurements."""
    for row in table.rows:
        if row.role in ("input", "measured"):
            for quantity, cell in row.values.items():
                yield _row(table, row, quantity, cell, None, (INPUT, ""))


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
            verdict = _of_frequency(cell, solvers)
            yield _row(table, row, quantity, cell, solvers["ritz_hz"], verdict, details=solvers)


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
            verdict = _of_constant(cell, ours, why)
            interval = (ours["q025"], ours["q975"])
            yield _row(
                table, row, quantity, cell, ours["value"], verdict, interval, {"posterior_mean": ours["mean"]}
            )


def _of_constant(cell: PrintedValue, ours: Mapping[str, Any], why: str) -> Judged:
    printed = float(cell.text)
    apart = _apart_from_interval(ours)
    if abs(printed - ours["value"]) <= max(
        0.01 * _CONSTANT_PERCENT * abs(ours["value"]), last_digit(cell.text) / 2
    ):
        return AGREES, apart
    if ours["q025"] <= printed <= ours["q975"]:
        return WITHIN, apart
    return NOT_REPRODUCIBLE, "; ".join(filter(None, (f"outside the 95 % interval; {why}", apart)))


def _apart_from_interval(ours: Mapping[str, Any]) -> str:
    """Why a best fit lies outside the interval of the same constant; "" where it does not."""
    if ours["q025"] <= ours["value"] <= ours["q975"]:
        return ""
    if ours["bound"] is not None:
        return "ours sits on a bound, beyond the central 95 % of a posterior within the bounds"
    return (
        "ours lies outside its own interval: eq. (7) weighs residuals in Hz, high modes most, the posterior "
        "in per cent, and the list is not fitted within its noise"
    )


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
    """Tables 10 to 14: printed means of ten beside the repetition and the posterior at that noise.

    Where angles and constants were sought together, as the paper did, that repetition is the one compared.
    """
    (specimen,) = {row.specimen for row in table.rows}
    results = computed.get(("noise", specimen, BUILT_IN))
    if results is None:
        return
    point = computed.get(("constants", specimen, TWO if specimen == "A2" else BUILT_IN))
    together = computed.get(("angles", specimen, BUILT_IN))
    sources = [r.source for r in table.rows[1:]]
    levels = dict(zip(sources, results["levels"], strict=True))
    sought = {} if together is None else dict(zip(sources, together["levels"], strict=True))
    for row in table.rows:
        for quantity, cell in row.values.items():
            if quantity == "angles_deg":
                yield _noisy_layup(table, row, cell, sequences["cases"].get(specimen), sought.get(row.source))
            elif row.source == WITHOUT_NOISE:
                if point is not None:
                    yield _without_noise(table, row, quantity, cell, point["constants"][quantity])
            else:
                known = levels[row.source]["constants"][quantity]
                both = sought[row.source]["constants"][quantity] if sought else {}
                groups = results["groups"] if together is None else together["groups"]
                free = (results if together is None else together)["without_noise"][quantity]
                yield _noisy(table, row, quantity, cell, {**known, **both}, groups, free)


def _without_noise(
    table: PrintedTable, row: PrintedRow, quantity: str, cell: PrintedValue, ours: Mapping[str, Any]
) -> Row:
    why = "see the same constant in Table 9(a)" if table.number > 10 else "see the same constant in Table 8"
    verdict = _of_constant(cell, ours, why)
    return _row(table, row, quantity, cell, ours["value"], verdict, (ours["q025"], ours["q975"]))


def _noisy(
    table: PrintedTable,
    row: PrintedRow,
    quantity: str,
    cell: PrintedValue,
    ours: Mapping[str, float],
    groups: int,
    free: float,
) -> Row:
    """free : ours without noise, by the same search."""
    mean, printed = ours["repetition_mean"], float(cell.text)
    stuck = ours["on_bound"] >= _STUCK
    error = ours["repetition_sd"] * math.sqrt(1.0 / groups + 1.0 / _PRINTED_GROUPS)
    away = abs(printed - mean) / error if error > 0.0 else math.inf
    off = 100.0 * abs(printed / mean - 1.0)
    inside = ours["q025"] <= printed <= ours["q975"]
    verdict = _of_mean(away, off, inside, ours["on_bound"], groups, free)
    details = {
        "repetition_sd": ours["repetition_sd"],
        "on_bound": ours["on_bound"],
        "standard_errors": away if math.isfinite(away) and not stuck else None,
        "printed_percent": float(cell.percent),
        "our_percent": 100.0 * (mean / free - 1.0),
        "posterior_mean": ours["posterior_mean"],
    }
    return _row(table, row, quantity, cell, mean, verdict, (ours["q025"], ours["q975"]), details)


def _of_mean(away: float, off: float, inside: bool, on_bound: float, groups: int, free: float) -> Judged:
    """Verdict on a printed mean; away : standard errors, off : per cent from ours."""
    stuck = on_bound >= _STUCK
    bound = f"{100.0 * on_bound:.0f} % of ours sit on a bound, so that they have no standard error"
    if not stuck and away <= _STANDARD_ERRORS:
        if off <= _MEAN_PERCENT:
            return AGREES, ""
        return UNTOLD, f"{off:.0f} % apart, which is {away:.1f} standard errors"
    if inside:
        return WITHIN, bound if stuck else ""
    if stuck and off <= _MEAN_PERCENT:
        return UNTOLD, bound
    distance = bound if stuck else f"{away:.3g} standard errors of a difference of two means of {groups} away"
    return NOT_REPRODUCIBLE, f"{distance}, and outside the 95 % interval; without noise ours is {free:.4g}"


def _noisy_layup(
    table: PrintedTable,
    row: PrintedRow,
    cell: PrintedValue,
    stored: Mapping[str, Any] | None,
    sought: Mapping[str, Any] | None,
) -> Row:
    if row.source == WITHOUT_NOISE and stored is not None:
        return _layup_row(table, row, cell, stored)
    if sought is None:
        why = "searches of angles and constants together were left out"
        return _row(table, row, "angles_deg", cell, None, (NOT_REPRODUCIBLE, why))
    found = NoisyAngles.of(table.number, row.source, cell.angles_deg, sought)
    return _row(table, row, "angles_deg", cell, found.means_deg, found.verdict, details=found.details)


@dataclass(frozen=True, slots=True)
class NoisyAngles:
    """Angles that inversions of perturbed lists ended at, beside a printed mean of ten.

    source : of the printed row, its level
    printed, means_deg : mean angle of each unknown ply, the outermost first; ours on the mirror image that is
        nearer the printed one
    spread_deg : circular standard deviation of each angle, which repeats after 180 degrees; 61 for ten
        angles without any preference
    found : inversions that ended at the printed sequence, or at its mirror image
    distinct : sequences among their ends, mirror images counted once
    """

    table: int
    source: str
    printed: tuple[int, ...]
    means_deg: tuple[float, ...]
    spread_deg: tuple[float, ...]
    found: int
    distinct: int
    groups: int

    @classmethod
    def of(cls, table: int, source: str, printed: Sequence[int], level: Mapping[str, Any]) -> NoisyAngles:
        """From the angles of the inversions at a level."""
        goal = np.array(printed, dtype=float)
        ends = np.array(level["angles_deg"], dtype=float)
        # a plate seen from behind has all angles with the other sign and the same frequencies
        ends = np.array([min(end, _wrapped(-end), key=lambda a: _away(a, goal)) for end in ends])
        away = _wrapped(ends - goal)
        mean = _wrapped(goal + away.mean(axis=0))
        length = np.abs(np.exp(2j * np.radians(ends)).mean(axis=0))
        # of n directions without preference the mean length is about 1 / sqrt(n)
        spread = 0.5 * np.degrees(np.sqrt(-2.0 * np.log(np.clip(length, 1.0 / len(ends), 1.0))))
        return cls(
            table=table,
            source=source,
            printed=tuple(int(a) for a in printed),
            means_deg=tuple(float(m) for m in mean),
            spread_deg=tuple(float(d) for d in spread),
            found=int(np.sum(np.all(away == 0.0, axis=1))),
            distinct=len(np.unique(ends, axis=0)),
            groups=len(ends),
        )

    @property
    def verdict(self) -> Judged:
        """Agrees where each mean is nearest to the printed angle on the grid, and told apart by its error."""
        away = np.abs(_wrapped(np.subtract(self.means_deg, self.printed)))
        error = np.array(self.spread_deg) * math.sqrt(1.0 / self.groups + 1.0 / _PRINTED_GROUPS)
        said = (
            f"{self.found} of {self.groups} inversions end there, the others at {self.distinct} sequences; "
            f"spread by ply {', '.join(f'{d:.0f}' for d in self.spread_deg)} degrees"
        )
        if np.all(away <= _GRID_DEG / 2.0):
            return AGREES, said
        return (UNTOLD if np.all(away <= _STANDARD_ERRORS * error) else NOT_REPRODUCIBLE), said

    @property
    def details(self) -> dict[str, float | None]:
        """For the row."""
        spread = {f"spread_{i}_deg": d for i, d in enumerate(self.spread_deg, 1)}
        return {"found": float(self.found), "distinct": float(self.distinct), **spread}


# The paper's grid of angles, degrees.
_GRID_DEG: Final = 5.0


def _wrapped(angles_deg: Any) -> Any:
    """Within -90 (excluded) to 90 degrees: a fibre has no head."""
    return 90.0 - np.mod(90.0 - angles_deg, 180.0)


def _away(angles_deg: Any, goal: Any) -> float:
    return float(np.sum(np.abs(_wrapped(angles_deg - goal))))


def noisy_angles(rows: Iterable[Row]) -> str:
    """The worth of the means of angles of Tables 11 to 14, in words; "" where none was computed."""
    of_angles = [row for row in rows if "spread_1_deg" in row.details]
    if not of_angles:
        return ""
    spreads = [[v or 0.0 for k, v in row.details.items() if k.startswith("spread_")] for row in of_angles]
    outer, inner = (float(np.mean([s[i] for s in spreads])) for i in (0, -1))
    found = sum(int(row.details["found"] or 0) for row in of_angles)
    return (
        "Angles and constants sought together by one fuzzy swarm, as the paper did, on ten perturbed lists "
        f"a level: {found} of {10 * len(of_angles)} inversions end at the printed angles or their mirror "
        "image. "
        f"The angle of the outermost unknown ply scatters by {outer:.0f} degrees, that of the innermost by "
        f"{inner:.0f}, on average over {len(of_angles)} levels (61 is no preference at all). "
        "All printed means are multiples of 5 degrees, which a mean of ten angles on that grid is by chance "
        "only."
    )


def _row(
    table: PrintedTable,
    row: PrintedRow,
    quantity: str,
    cell: PrintedValue,
    ours: float | Sequence[float] | None,
    judged: Judged,
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
        verdict=judged[0],
        reason=judged[1],
        details=details or {},
    )


@dataclass(frozen=True, slots=True)
class MeansOfTen:
    """The information in the printed means of ten inversions of Tables 10 to 14.

    changes, hidden : printed changes, and those below one standard error of such a mean as repeated here
    constants : series over the levels; printed_grow, ours_grow : of which the change keeps its sign and grows
    """

    changes: int
    hidden: int
    constants: int
    printed_grow: int
    ours_grow: int

    @classmethod
    def of(cls, rows: Iterable[Row]) -> MeansOfTen | None:
        """From the rows, None where none of these tables was computed."""
        series: dict[tuple[int, str], list[Row]] = {}
        for row in rows:
            if "printed_percent" in row.details:
                series.setdefault((row.table, row.quantity), []).append(row)
        noisy = [row for one in series.values() for row in one]
        if not noisy:
            return None
        below = (abs(r.details["printed_percent"] or 0.0) < _standard_error_percent(r) for r in noisy)
        printed, ours = (
            sum(_grows([row.details[key] or 0.0 for row in one]) for one in series.values())
            for key in ("printed_percent", "our_percent")
        )
        return cls(len(noisy), sum(below), len(series), printed, ours)


def means_of_ten(rows: Iterable[Row]) -> str:
    """The information in the printed means of ten inversions, in words; "" where none was computed."""
    found = MeansOfTen.of(rows)
    if found is None:
        return ""
    return (
        "Noise by eq. (12): a level times the root mean square frequency, one standard deviation for all "
        "modes, times a standard normal number (the paper takes Box and Muller's), added to the measured "
        f"list. {found.hidden} of {found.changes} printed changes are smaller than one standard error of a "
        "mean of ten inversions as repeated here: such a mean cannot show them. The printed change keeps its "
        "sign "
        f"and grows from 1 to 5 to 10 % for {found.printed_grow} of {found.constants} constants; ours, with "
        f"independent noise at each level, for {found.ours_grow}. A mean shows the bias of the inversion; "
        "the spread of the constants is the posterior interval."
    )


def _standard_error_percent(row: Row) -> float:
    """Standard error of a mean of ten in percent of our mean."""
    mean = row.ours if isinstance(row.ours, float) else math.nan
    return 100.0 * (row.details["repetition_sd"] or 0.0) / math.sqrt(_PRINTED_GROUPS) / abs(mean)


def _grows(changes: Sequence[float]) -> bool:
    same_sign = all(change * changes[0] > 0.0 for change in changes)
    return same_sign and all(abs(a) < abs(b) for a, b in pairwise(changes))


def disagreements(rows: Sequence[Row], misfits: Sequence[Misfit]) -> tuple[str, ...]:
    """The most important disagreements in words, as far as their tables were computed."""
    # misfits of Table 9 are computed for Tables 11 to 14 as well
    own = [m for m in misfits if m.table == 9] if any(row.table == 9 for row in rows) else []
    return tuple(filter(None, (_frequencies_off(rows), _own_misfit(own), _undetermined(rows))))


def _frequencies_off(rows: Sequence[Row]) -> str:
    """The plate of Table 5 whose printed frequencies are furthest from the converged ones."""
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
    solvers = [[v for v in row.details.values() if v is not None] for row in furthest]
    apart = max(100.0 * (max(v) / min(v) - 1.0) for v in solvers)
    return (
        f"Table 5, {name}: the ABAQUS frequencies are {min(differences):+.1f} to {max(differences):+.1f} % "
        f"off those of {len(solvers[0])} converged solvers ({apart:.2g} % apart at most) for the printed "
        f"plate. They are within {max(abs(b) for b in beside):.1f} % of the measured list of Table 4, which "
        "the printed plate does not give."
    )


def _own_misfit(misfits: Sequence[Misfit]) -> str:
    """The specimens whose printed constants miss their own frequencies; misfits : of Table 9."""
    identified = [m for m in misfits if m.source == PAPER]
    if not identified:
        return ""
    worst = max(identified, key=lambda m: m.rms_percent)
    far = sorted(m.specimen for m in identified if m.rms_percent > _FAR)
    ten = sum(m.objective > 10.0 * m.our_objective for m in identified)
    above = f"above {_FAR:g} % for {', '.join(far)}" if far else f"below {_FAR:g} % for all"
    return (
        f"Table 9(a): the printed constants miss their plates' own frequencies, rms {above}; worst "
        f"{worst.specimen}, {worst.rms_percent:.3g} %, where the best fit within the bounds leaves "
        f"{worst.our_rms_percent:.3g} %. Their F, eq. (7), is more than ten times the least one for {ten} of "
        f"{len(identified)} plates."
    )


def _undetermined(rows: Sequence[Row]) -> str:
    """Printed digits that the frequencies do not determine: constants and stacking sequences."""
    identified = [r for r in rows if r.table == 9 and r.part == "a" and r.source == PAPER]
    wide = [r for r in identified if r.q025 and r.q975 and r.q975 > _WIDE * r.q025]
    layups = [r for r in rows if r.table == 9 and r.part == "b"]
    if not identified or not layups:
        return ""
    widest = max(identified, key=lambda r: (r.q975 or 0.0) / (r.q025 or 1.0))
    counts = sorted(int(r.details["credible_95_count"] or 0) for r in layups)
    outside = [r.specimen for r in layups if r.verdict != WITHIN]
    return (
        f"Table 9: the frequencies determine less than is printed. {len(wide)} of {len(identified)} printed "
        f"constants have a 95 % interval whose ends are a factor of {_WIDE:g} or more apart; "
        f"{widest.quantity} of {widest.specimen}, printed {widest.printed}, has "
        f"{significant(widest.q025 or 0.0, 3)} to {significant(widest.q975 or 0.0, 3)}. The 95 % sets hold "
        f"{counts[0]} to {counts[-1]} stacking sequences; the printed ones of "
        f"{listed(outside, 'and') or 'no plate'} are outside or at the edge."
    )
