"""Tables 10 to 14: printed means of ten inversions of noisy lists beside ours, and what such means can show.

A mean of ten agrees within two standard errors of the difference of two such means and 5 %, if that standard
error is 5 % or less; within the standard errors alone the two cannot be told apart. Where half or more of the
ten are on a bound there is no standard error, and without a posterior interval either nothing is determined.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

from cpam_bayes.formatting import listed
from cpam_bayes.printed.tables import (
    WITHOUT_NOISE,
    PrintedRow,
    PrintedTable,
    PrintedValue,
    last_digit,
)
from cpam_bayes.questions.paper.angles import (
    PRINTED_GROUPS,
    STANDARD_ERRORS,
    NoisyAngles,
    free_ends,
    motions_of,
    told,
)
from cpam_bayes.questions.paper.rows import (
    AGREES,
    BUILT_IN,
    NOT_COMPUTED,
    NOT_REPRODUCIBLE,
    TWO,
    UNDETERMINED,
    UNTOLD,
    WITHIN,
    Computed,
    Judged,
    Row,
    identified_row,
    layup_row,
    row_of,
)

# Means agree up to this difference, %, if its standard error is no larger: else they would by chance.
_MEAN_PERCENT: Final = 5.0
# With at least this share of inversions on a bound their scatter says nothing about the noise.
_STUCK: Final = 0.5


@dataclass(frozen=True, slots=True)
class Repetition:
    """Our repetition, compared with the printed mean of a constant at a level of noise.

    mean, sd, on_bound : over the inversions; on_bound : share on a bound; groups : number of inversions
    interval : mean, 2.5 % and 97.5 % quantile of the posterior for the same unknowns; None where not computed
    over_layups : whether angles were searched too and the interval is over all layups
    free, known_mean : value without noise, and mean at this level, for the known layup
    """

    mean: float
    sd: float
    on_bound: float
    groups: int
    interval: tuple[float, float, float] | None
    over_layups: bool
    free: float
    known_mean: float

    @classmethod
    def of(
        cls,
        known: Mapping[str, Any],
        free: float,
        known_groups: int,
        sought: Mapping[str, Any] | None,
        sought_groups: int,
        over_all: Mapping[str, float] | None,
    ) -> Repetition:
        """From results for the known layup, for searched angles, and over all layups."""
        ours = known if sought is None else sought
        of_posterior = known if sought is None else over_all
        mean = "posterior_mean" if sought is None else "mean"
        keys = (mean, "q025", "q975")
        return cls(
            mean=ours["repetition_mean"],
            sd=ours["repetition_sd"],
            on_bound=ours["on_bound"],
            groups=known_groups if sought is None else sought_groups,
            interval=None if of_posterior is None else tuple(float(of_posterior[k]) for k in keys),  # type: ignore[arg-type]
            over_layups=sought is not None,
            free=free,
            known_mean=known["repetition_mean"],
        )

    @property
    def is_stuck(self) -> bool:
        """Whether so many inversions are on a bound that there is no standard error."""
        return self.on_bound >= _STUCK

    @property
    def error(self) -> float:
        """Standard error of the difference of the printed mean of ten and this one."""
        return self.sd * math.sqrt(1.0 / self.groups + 1.0 / PRINTED_GROUPS)

    def standard_errors(self, printed: float) -> float:
        """Distance from a printed mean of ten, in standard errors of the difference."""
        return abs(printed - self.mean) / self.error if self.error > 0.0 else math.inf

    def holds(self, printed: float, rounding: float) -> bool | None:
        """Whether the interval holds a printed value, up to its rounding; None without an interval."""
        if self.interval is None:
            return None
        _, low, high = self.interval
        return low - rounding <= printed <= high + rounding


def noise_rows(
    table: PrintedTable, computed: Computed, sequences: Mapping[str, Any], swarms: Mapping[str, Any]
) -> Iterator[Row]:
    """Rows of Tables 10 to 14: printed means of ten beside the repetition and the posterior at that noise.

    Where angles and constants were searched together, as in the paper, that repetition is compared.

    sequences, swarms : "cases", by specimen: the posterior over all layups of the measured list, and the
        angles at which swarms on it end
    """
    (specimen,) = {row.specimen for row in table.rows}
    results = computed.get(("noise", specimen, BUILT_IN))
    if results is None:
        return
    point = computed.get(("constants", specimen, TWO if specimen == "A2" else BUILT_IN))
    together = computed.get(("angles", specimen, BUILT_IN))
    levels = _by_source(table, results)
    sought = _by_source(table, together)
    weighed = _by_source(table, computed.get(("layups", specimen, BUILT_IN)))
    for row in table.rows:
        for quantity, cell in row.values.items():
            if quantity == "angles_deg":
                if row.source == WITHOUT_NOISE:
                    ends = swarms["cases"].get(specimen)
                    yield from _free_layup(table, row, cell, sequences["cases"].get(specimen), ends)
                else:
                    level = sought.get(row.source)
                    yield _noisy_layup(table, row, cell, level, weighed.get(row.source))
            elif row.source == WITHOUT_NOISE:
                if point is not None:
                    why = f"see the same constant in {'Table 8' if specimen == 'A2' else 'Table 9(a)'}"
                    yield identified_row(table, row, quantity, cell, point["constants"][quantity], why)
            else:
                known = levels[row.source]["constants"][quantity]
                both, over_all = (
                    of[row.source]["constants"][quantity] if of else None for of in (sought, weighed)
                )
                ours = Repetition.of(
                    known,
                    results["without_noise"][quantity],
                    results["groups"],
                    both,
                    0 if together is None else together["groups"],
                    over_all,
                )
                yield _noisy(table, row, quantity, cell, ours)


def _by_source(table: PrintedTable, results: Mapping[str, Any] | None) -> dict[str, Any]:
    """Results of each level by the source of the printed row; empty without results."""
    sources = (row.source for row in table.rows[1:])
    return {} if results is None else dict(zip(sources, results["levels"], strict=True))


def _noisy(table: PrintedTable, row: PrintedRow, quantity: str, cell: PrintedValue, ours: Repetition) -> Row:
    printed = float(cell.text)
    away = ours.standard_errors(printed)
    verdict, reason = _of_mean(printed, ours, ours.holds(printed, last_digit(cell.text) / 2.0))
    judged = (verdict, "; ".join(filter(None, (reason, _mean_apart(ours)))))
    mean, low, high = (None, None, None) if ours.interval is None else ours.interval
    details = {
        "repetition_sd": ours.sd,
        "on_bound": ours.on_bound,
        "standard_errors": away if math.isfinite(away) and not ours.is_stuck else None,
        "printed_percent": float(cell.percent),
        "our_percent": 100.0 * (ours.known_mean / ours.free - 1.0),
        "posterior_mean": mean,
        "over_layups": float(ours.over_layups),
    }
    return row_of(table, row, quantity, cell, ours.mean, judged, (low, high), details)


def _mean_apart(ours: Repetition) -> str:
    """Why a mean of inversions lies outside the posterior interval; "" where it does not."""
    if ours.interval is None or ours.interval[1] <= ours.mean <= ours.interval[2]:
        return ""
    interval = "one such list, over all layups" if ours.over_layups else "the list without noise added"
    return (
        f"ours lies outside its own interval: it is a mean of inversions of noisy lists (sd {ours.sd:.3g}, "
        f"{100.0 * ours.on_bound:.0f} % on a bound), the interval is of {interval}"
    )


def _of_mean(printed: float, ours: Repetition, inside: bool | None) -> Judged:
    """Verdict on a printed mean; inside : whether it is in the interval, None without one."""
    away, off = ours.standard_errors(printed), 100.0 * abs(printed / ours.mean - 1.0)
    bound = f"{100.0 * ours.on_bound:.0f} % of ours sit on a bound, so that they have no standard error"
    outside = "outside the 95 % interval" if inside is False else ""
    if not ours.is_stuck and away <= STANDARD_ERRORS:
        error = 100.0 * ours.error / abs(ours.mean)
        if off <= _MEAN_PERCENT and error <= _MEAN_PERCENT:
            return AGREES, outside
        apart = f"{off:.0f} % apart, with a standard error of {error:.0f} %"
        return UNTOLD, "; ".join(filter(None, (apart, outside)))
    if inside:
        return WITHIN, bound if ours.is_stuck else ""
    if ours.is_stuck and inside is None:
        return UNDETERMINED, f"{bound}, and no posterior over all layups was computed"
    if ours.is_stuck and off <= _MEAN_PERCENT:
        return UNTOLD, f"{bound}; {outside}"
    distance = f"{away:.3g} standard errors of a difference of two means of {ours.groups} away"
    layup = " for the known layup" if ours.over_layups else ""
    said = (bound if ours.is_stuck else distance, outside, f"without noise ours is {ours.free:.4g}{layup}")
    return NOT_REPRODUCIBLE, "; ".join(filter(None, said))


def _free_layup(
    table: PrintedTable,
    row: PrintedRow,
    cell: PrintedValue,
    stored: Mapping[str, Any] | None,
    ends: Mapping[str, Any] | None,
) -> Iterator[Row]:
    """The printed sequence without noise, if its posterior is stored; ends : of swarms on that list."""
    if stored is not None:
        judged = layup_row(table, row, cell, stored)
        swarms = {} if ends is None else free_ends(cell.angles_deg, ends, motions_of(row.specimen))
        yield replace(judged, details={**judged.details, **swarms})


def _noisy_layup(
    table: PrintedTable,
    row: PrintedRow,
    cell: PrintedValue,
    sought: Mapping[str, Any] | None,
    weighed: Mapping[str, Any] | None,
) -> Row:
    if sought is None:
        why = "the searches of angles and constants together were left out"
        return row_of(table, row, "angles_deg", cell, None, (NOT_COMPUTED, why))
    found = NoisyAngles.of(table.number, cell.angles_deg, sought, motions_of(row.specimen))
    details = {**found.details, **({} if weighed is None else told(weighed))}
    return row_of(table, row, "angles_deg", cell, found.means_deg, found.verdict, details=details)


@dataclass(frozen=True, slots=True)
class MeansOfTen:
    """Information in the printed means of ten inversions of Tables 10 to 14.

    changes : number printed; stuck : those with half or more of our inversions on a bound; hidden : of the
        others, those below one standard error of such a mean as repeated here
    constants : series over the levels; printed_grow, ours_grow : those whose change keeps its sign and
        grows, ours for the known layup
    """

    changes: int
    stuck: int
    hidden: int
    constants: int
    printed_grow: int
    ours_grow: int

    @classmethod
    def of(cls, rows: Iterable[Row]) -> MeansOfTen | None:
        """From the rows; None where none of these tables was computed."""
        series: dict[tuple[int, str], list[Row]] = {}
        for row in _means(rows):
            series.setdefault((row.table, row.quantity), []).append(row)
        noisy = [row for one in series.values() for row in one]
        if not noisy:
            return None
        free = [row for row in noisy if (row.details["on_bound"] or 0.0) < _STUCK]
        below = (abs(r.details["printed_percent"] or 0.0) < _standard_error_percent(r) for r in free)
        printed, ours = (
            sum(_grows([row.details[key] or 0.0 for row in one]) for one in series.values())
            for key in ("printed_percent", "our_percent")
        )
        return cls(len(noisy), len(noisy) - len(free), sum(below), len(series), printed, ours)


def _means(rows: Iterable[Row]) -> Iterator[Row]:
    """Rows of printed means of a constant over ten inversions."""
    return (row for row in rows if "printed_percent" in row.details)


def means_of_ten(rows: Iterable[Row]) -> str:
    """Sentences on the printed means of ten inversions; "" where none was computed."""
    rows = tuple(rows)
    found = MeansOfTen.of(rows)
    if found is None:
        return ""
    said = (
        "Eq. (12), whose printed b has the unit of 1/frequency, can only mean: a level of the root mean "
        "square frequency, the same for all modes, times a standard normal number (by Box-Muller in the "
        "paper). "
        f"Of {found.changes} printed changes {found.stuck} have no standard error: half or more of our ten "
        f"inversions sit on a bound. {found.hidden} of the other {found.changes - found.stuck} are smaller "
        "than the standard error of a mean of ten. The printed change keeps its sign and grows from 1 to 5 "
        f"to 10 % for {found.printed_grow} of {found.constants} constants; ours, with known layup, for "
        f"{found.ours_grow}. A mean shows the bias of the inversion; the spread is the posterior interval."
    )
    return " ".join(filter(None, (said, _over_layups(rows))))


def _over_layups(rows: Iterable[Row]) -> str:
    """Sentences on the intervals beside constants that were searched with angles; "" where none were."""
    sought = [row for row in _means(rows) if row.details["over_layups"]]
    beside = [row for row in sought if row.q025 is not None]
    without = tuple(dict.fromkeys(row.specimen for row in sought if row.q025 is None))
    said = []
    if beside:
        names = tuple(dict.fromkeys(row.specimen for row in beside))
        inside = sum(_is_inside(row) for row in beside)
        said.append(
            f"The intervals of {listed(names, 'and')} are over all layups, each of one list at that noise; "
            f"{inside} of {len(beside)} printed means lie within."
        )
    if without:
        said.append(
            f"For {listed(without, 'and')} no interval over all layups was computed: only means are compared."
        )
    return " ".join(said)


def _is_inside(row: Row) -> bool:
    printed, half = float(row.printed), last_digit(row.printed) / 2.0
    assert row.q025 is not None
    assert row.q975 is not None
    return row.q025 - half <= printed <= row.q975 + half


def _standard_error_percent(row: Row) -> float:
    """Standard error of a mean of ten in percent of our mean."""
    mean = row.ours if isinstance(row.ours, float) else math.nan
    return 100.0 * (row.details["repetition_sd"] or 0.0) / math.sqrt(PRINTED_GROUPS) / abs(mean)


def _grows(changes: Sequence[float]) -> bool:
    same_sign = all(change * changes[0] > 0.0 for change in changes)
    return same_sign and all(abs(a) < abs(b) for a, b in pairwise(changes))
