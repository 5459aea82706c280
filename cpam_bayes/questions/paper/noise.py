"""Tables 10 to 14: printed means of ten inversions of noisy lists beside ours, and what such means can show.

Verdicts: a mean of ten agrees within two standard errors of the difference of two such means and 5 %; within
the standard errors alone the two cannot be told apart. Where half of the ten or more sit on a bound there is
no standard error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from cpam_bayes.printed.tables import WITHOUT_NOISE, PrintedRow, PrintedTable, PrintedValue
from cpam_bayes.questions.paper.rows import (
    AGREES,
    BUILT_IN,
    NOT_COMPUTED,
    NOT_REPRODUCIBLE,
    TWO,
    UNTOLD,
    WITHIN,
    Computed,
    Judged,
    Row,
    identified_row,
    layup_row,
    row_of,
)

# Means agree up to so many standard errors of their difference, if they are no further apart than this, %.
_STANDARD_ERRORS, _MEAN_PERCENT = 2.0, 5.0
# From this share of inversions on a bound their scatter says nothing of the noise.
_STUCK: Final = 0.5
_PRINTED_GROUPS: Final = 10


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
    levels = _by_source(table, results)
    sought = _by_source(table, together)
    weighed = _by_source(table, computed.get(("layups", specimen, BUILT_IN)))
    for row in table.rows:
        for quantity, cell in row.values.items():
            if quantity == "angles_deg":
                stored, level = sequences["cases"].get(specimen), weighed.get(row.source)
                yield _noisy_layup(table, row, cell, stored, sought.get(row.source), level)
            elif row.source == WITHOUT_NOISE:
                if point is not None:
                    why = f"see the same constant in {'Table 8' if specimen == 'A2' else 'Table 9(a)'}"
                    yield identified_row(table, row, quantity, cell, point["constants"][quantity], why)
            else:
                known = levels[row.source]["constants"][quantity]
                both = sought[row.source]["constants"][quantity] if sought else {}
                over_all = weighed[row.source]["constants"][quantity] if weighed else {}
                groups = results["groups"] if together is None else together["groups"]
                free = (results if together is None else together)["without_noise"][quantity]
                ours = {**known, **both, **{f"layups_{key}": v for key, v in over_all.items()}}
                yield _noisy(table, row, quantity, cell, ours, groups, free, together is not None)


def _by_source(table: PrintedTable, results: Mapping[str, Any] | None) -> dict[str, Any]:
    """What was computed at each level, by the source of the printed row; nothing where nothing was."""
    sources = (row.source for row in table.rows[1:])
    return {} if results is None else dict(zip(sources, results["levels"], strict=True))


def _noisy(
    table: PrintedTable,
    row: PrintedRow,
    quantity: str,
    cell: PrintedValue,
    ours: Mapping[str, float],
    groups: int,
    free: float,
    layup_is_sought: bool,
) -> Row:
    """free : ours without noise, by the same search."""
    mean, printed = ours["repetition_mean"], float(cell.text)
    stuck = ours["on_bound"] >= _STUCK
    error = ours["repetition_sd"] * math.sqrt(1.0 / groups + 1.0 / _PRINTED_GROUPS)
    away = abs(printed - mean) / error if error > 0.0 else math.inf
    off = 100.0 * abs(printed / mean - 1.0)
    inside = ours["q025"] <= printed <= ours["q975"]
    verdict, reason = _of_mean(away, off, inside, ours["on_bound"], groups, free)
    apart = "" if ours["q025"] <= mean <= ours["q975"] else _mean_apart(ours, layup_is_sought)
    judged = (verdict, "; ".join(filter(None, (reason, apart))))
    details = {
        "repetition_sd": ours["repetition_sd"],
        "on_bound": ours["on_bound"],
        "standard_errors": away if math.isfinite(away) and not stuck else None,
        "printed_percent": float(cell.percent),
        "our_percent": 100.0 * (mean / free - 1.0),
        "posterior_mean": ours["posterior_mean"],
        **{key: value for key, value in ours.items() if key.startswith("layups_")},
    }
    return row_of(table, row, quantity, cell, mean, judged, (ours["q025"], ours["q975"]), details)


def _mean_apart(ours: Mapping[str, float], layup_is_sought: bool) -> str:
    """Why a mean of inversions lies outside the posterior interval."""
    searched = (", angles sought too", ", for the known layup") if layup_is_sought else ("", "")
    return (
        "ours lies outside its own interval: it is a mean of inversions of noisy lists (sd "
        f"{ours['repetition_sd']:.3g}, {100.0 * ours['on_bound']:.0f} % on a bound{searched[0]}), the "
        f"interval is of the list without noise added{searched[1]}"
    )


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
    weighed: Mapping[str, Any] | None,
) -> Row:
    if row.source == WITHOUT_NOISE and stored is not None:
        return layup_row(table, row, cell, stored)
    if sought is None:
        why = "the searches of angles and constants together were left out"
        return row_of(table, row, "angles_deg", cell, None, (NOT_COMPUTED, why))
    found = NoisyAngles.of(cell.angles_deg, sought)
    details = {**found.details, **({} if weighed is None else _told(weighed))}
    return row_of(table, row, "angles_deg", cell, found.means_deg, found.verdict, details=details)


def _told(weighed: Mapping[str, Any]) -> dict[str, float]:
    """What one list at a level tells of the angles: probabilities, and bits of each, the outermost first."""
    kept = ("true_probability", "printed_probability", "most_bits", "credible_95_count")
    bits = {f"bits_{i}": b for i, b in enumerate(weighed["bits"], 1)}
    return {**{key: float(weighed[key]) for key in kept}, **bits}


@dataclass(frozen=True, slots=True)
class NoisyAngles:
    """Angles that inversions of perturbed lists ended at, beside a printed mean of ten.

    printed, means_deg : mean angle of each unknown ply, the outermost first; ours on the mirror image that is
        nearer the printed one
    spread_deg : circular standard deviation of each angle, which repeats after 180 degrees; 61 for ten
        angles without any preference
    found : inversions that ended at the printed sequence, or at its mirror image
    distinct : sequences among their ends, mirror images counted once
    """

    printed: tuple[int, ...]
    means_deg: tuple[float, ...]
    spread_deg: tuple[float, ...]
    found: int
    distinct: int
    groups: int

    @classmethod
    def of(cls, printed: Sequence[int], level: Mapping[str, Any]) -> NoisyAngles:
        """From the angles of the inversions at a level."""
        goal = np.array(printed, dtype=float)
        ends = np.array(level["angles_deg"], dtype=float)
        # a plate seen from behind has all angles with the other sign and the same frequencies
        ends = np.array(
            [min(end, _wrapped(-end), key=lambda a: np.sum(np.abs(_wrapped(a - goal)))) for end in ends]
        )
        away = _wrapped(ends - goal)
        mean = _wrapped(goal + away.mean(axis=0))
        length = np.abs(np.exp(2j * np.radians(ends)).mean(axis=0))
        # of n directions without preference the mean length is about 1 / sqrt(n)
        spread = 0.5 * np.degrees(np.sqrt(-2.0 * np.log(np.clip(length, 1.0 / len(ends), 1.0))))
        return cls(
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


def noisy_angles(rows: Sequence[Row]) -> str:
    """The worth of the means of angles of Tables 11 to 14, in words; "" where none was computed."""
    of_angles = [row for row in rows if "spread_1_deg" in row.details]
    if not of_angles:
        return ""
    outer, inner = _outer_and_inner(of_angles, "spread_")
    found = sum(int(row.details["found"] or 0) for row in of_angles)
    said = (
        "Angles and constants sought together by one fuzzy swarm, as the paper did, on ten perturbed lists "
        f"a level: {found} of {10 * len(of_angles)} inversions end at the printed angles or their mirror "
        "image. "
        f"The angle of the outermost unknown ply scatters by {outer:.0f} degrees, that of the innermost by "
        f"{inner:.0f}, on average over {len(of_angles)} levels (61 is no preference at all). "
        "All printed means are multiples of 5 degrees, which a mean of ten angles on that grid is by chance "
        "only."
    )
    return " ".join(filter(None, (said, _weighed_angles(rows, inner > outer))))


def _outer_and_inner(rows: Sequence[Row], key: str) -> tuple[float, float]:
    """Means over the rows of a number of the outermost and of the innermost unknown ply."""
    plies = [[v or 0.0 for k, v in row.details.items() if k.startswith(key)] for row in rows]
    outer, inner = (float(np.mean([of_row[i] for of_row in plies])) for i in (0, -1))
    return outer, inner


def _weighed_angles(rows: Sequence[Row], inner_scatters: bool) -> str:
    """What one list a level tells of the angles when all layups are weighed; "" where none were.

    inner_scatters : whether the innermost angle scatters more over perturbed lists than the outermost
    """
    weighed = [row for row in rows if "bits_1" in row.details]
    if not weighed:
        return ""
    outer, inner = _outer_and_inner(weighed, "bits_")
    less = sum(
        of_inner < of_outer for of_outer, of_inner in (_outer_and_inner([r], "bits_") for r in weighed)
    )
    true = max(row.details["true_probability"] or 0.0 for row in weighed)
    of_constants = [row for row in rows if "layups_q025" in row.details]
    inside = sum(_is_inside(row) for row in of_constants)
    return (
        f"All layups weighed by the first list of each level, its noise stated: it tells {outer:.2f} bits of "
        f"the outermost angle and {inner:.2f} of the innermost, of {weighed[0].details['most_bits']:.2f} "
        f"({len(weighed)} lists; less of the innermost in {less}). That inner plies are more sensitive to "
        f"noise than outer ones, as the paper says, {_HOLDS[inner < outer, inner_scatters]}. The true layup "
        f"has a probability of {true:.2g} at most; {inside} of {len(of_constants)} printed constants lie "
        "within the 95 % intervals over all layups."
    )


# By whether less is told of the innermost angle, and whether it scatters more.
_HOLDS: Final = {
    (True, True): "holds by the bits and by the scatter of the inversions",
    (True, False): "holds by the bits, not by the scatter of the inversions",
    (False, True): "holds by the scatter of the inversions, not by the bits",
    (False, False): "holds neither by the bits nor by the scatter of the inversions",
}


def _is_inside(row: Row) -> bool:
    low, high = row.details["layups_q025"], row.details["layups_q975"]
    return low is not None and high is not None and low <= float(row.printed) <= high


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
        "modes, times a standard normal number (by Box-Muller in the paper), added to the measured "
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
