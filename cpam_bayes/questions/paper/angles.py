"""Ply angles of Tables 11 to 14: printed means of ten inversions beside ours and beside uniform angles.

Inversions that end at random scatter too, and each layup is compared by the image nearest the printed angles,
of all images with the same frequencies. So every number stands beside that of uniformly drawn angles,
compared by the same code.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import listed
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.plate import angle_grid, builtin
from cpam_bayes.plate.motions import ANGLE_MOTIONS
from cpam_bayes.questions.paper.rows import (
    AGREES,
    NOT_REPRODUCIBLE,
    UNDETERMINED,
    UNTOLD,
    Judged,
    Row,
)
from cpam_bayes.stacking.notices import UNEXPLAINED
from cpam_bayes.stacking.symmetry import plane_motions

PRINTED_GROUPS: Final = 10
"""Perturbed lists behind each printed mean."""
STANDARD_ERRORS: Final = 2.0
"""Means agree within this many standard errors of their difference."""

# The paper's grid of angles, degrees.
_GRID_DEG: Final = 5.0
# Draws of ten uniform angles per ply, and the probability under these up to which a result is not chance.
_DRAWS: Final = 2000
_CHANCE: Final = 0.05
# One-sided 95 % quantile of the standard normal distribution.
_BEYOND_CHANCE: Final = 1.645


def motions_of(specimen: str) -> tuple[str, ...]:
    """Motions of a plate that keep its frequencies but change its angles, "" (none) first."""
    return plane_motions(builtin(specimen, sequence=True))


@dataclass(frozen=True, slots=True, eq=False)
class Ends:
    """Angles at which inversions ended, relative to the printed ones, on the image nearest to these.

    away_deg : (..., groups, plies), above -90 up to 90 degrees
    """

    away_deg: Array

    @classmethod
    def of(cls, angles_deg: Array, printed: Sequence[int], motions: Sequence[str]) -> Ends:
        """Ends from angles (..., groups, plies); the nearest image has the least sum of differences."""
        images = np.stack([_wrapped(ANGLE_MOTIONS[kind](angles_deg) - np.array(printed)) for kind in motions])
        nearest = np.abs(images).sum(axis=-1).argmin(axis=0)
        return cls(np.take_along_axis(images, nearest[None, ..., None], axis=0)[0])

    @property
    def mean_deg(self) -> Array:
        """Mean of each ply, relative to the printed angle, (..., plies)."""
        return np.asarray(self.away_deg.mean(axis=-2))

    @property
    def distance_deg(self) -> Array:
        """Mean absolute difference from the printed angles over inversions and plies, (...,)."""
        return np.asarray(np.abs(self.away_deg).mean(axis=(-2, -1)))

    @property
    def is_within_error(self) -> NDArray[np.bool_]:
        """Whether the means of all plies lie within `STANDARD_ERRORS` of the printed ones, (...,)."""
        groups = self.away_deg.shape[-2]
        error = self.spread_deg * math.sqrt(1.0 / groups + 1.0 / PRINTED_GROUPS)
        return np.asarray(np.all(np.abs(self.mean_deg) <= STANDARD_ERRORS * error, axis=-1))

    @property
    def spread_deg(self) -> Array:
        """Circular standard deviation of each ply, period 180 degrees, (..., plies)."""
        length = np.abs(np.exp(2j * np.radians(self.away_deg)).mean(axis=-2))
        # angles that cancel have no finite spread: the resultant length is taken as 1 / n at least
        least = 1.0 / self.away_deg.shape[-2]
        return np.asarray(0.5 * np.degrees(np.sqrt(-2.0 * np.log(np.clip(length, least, 1.0)))))


@cache
def no_preference(
    printed: tuple[int, ...], motions: tuple[str, ...], groups: int, stream: tuple[int, int]
) -> Ends:
    """Ends under no preference, (draws, groups, plies): angles uniform on the paper's grid, seeded.

    stream : table and level, which seed independent draws
    """
    rng = np.random.default_rng(stream)
    drawn = rng.choice(angle_grid(_GRID_DEG), (_DRAWS, groups, len(printed)))
    return Ends.of(drawn, printed, motions)


@dataclass(frozen=True, slots=True)
class NoisyAngles:
    """Angles at which inversions of perturbed lists ended, beside a printed mean of ten.

    printed, means_deg : mean angle of each unknown ply, the outermost first; ours on the images nearest the
        printed ones
    spread_deg : circular standard deviation of each angle
    within_error : whether every mean is within the standard errors of the printed one
    found : inversions that ended at the printed sequence or an image of it
    distinct : sequences among the ends, images counted once
    chance_near, chance_close : share of uniform angles at least as near the printed ones as ours, and at
        least as close together
    chance_within : share of uniform angles that show a preference and lie within the standard errors
    chance_spread_deg : spread of uniform angles by ply
    chance_more_deg, chance_more_sd_deg : spread of the innermost ply minus that of the outermost, for uniform
        angles, and its sd
    """

    printed: tuple[int, ...]
    means_deg: tuple[float, ...]
    spread_deg: tuple[float, ...]
    within_error: bool
    found: int
    distinct: int
    groups: int
    chance_near: float
    chance_close: float
    chance_within: float
    chance_spread_deg: tuple[float, ...]
    chance_more_deg: float
    chance_more_sd_deg: float

    @classmethod
    def of(
        cls, table: int, printed: Sequence[int], level: Mapping[str, Any], motions: tuple[str, ...]
    ) -> NoisyAngles:
        """From the stored inversions of one level of noise."""
        goal = tuple(int(angle) for angle in printed)
        ends = Ends.of(np.array(level["angles_deg"], dtype=float), goal, motions)
        away = ends.away_deg
        uniform = no_preference(goal, motions, len(away), (table, round(level["level_percent"])))
        spread, distance = uniform.spread_deg, uniform.distance_deg
        together = spread.mean(axis=-1)
        prefer = (distance <= np.quantile(distance, _CHANCE)) | (together <= np.quantile(together, _CHANCE))
        more = spread[:, -1] - spread[:, 0]
        return cls(
            printed=goal,
            means_deg=tuple(float(m) for m in _wrapped(np.array(goal) + ends.mean_deg)),
            spread_deg=tuple(float(d) for d in ends.spread_deg),
            within_error=bool(ends.is_within_error),
            found=int(np.sum(np.all(away == 0.0, axis=1))),
            distinct=len(np.unique(away, axis=0)),
            groups=len(away),
            chance_near=float(np.mean(distance <= ends.distance_deg)),
            chance_close=float(np.mean(together <= ends.spread_deg.mean())),
            chance_within=float(np.mean(prefer & uniform.is_within_error)),
            chance_spread_deg=tuple(float(d) for d in spread.mean(axis=0)),
            chance_more_deg=float(more.mean()),
            chance_more_sd_deg=float(more.std()),
        )

    @property
    def verdict(self) -> Judged:
        """Verdict on the printed mean angles.

        Undetermined where the ends are neither nearer the printed angles nor closer together than uniform
        angles; agrees where each mean rounds to the printed angle on the grid; else judged by the standard
        error.
        """
        said = (
            f"{self.found} of {self.groups} inversions end there, at {self.distinct} sequences in all; of "
            f"uniform angles {100.0 * self.chance_near:.2g} % are as near the print, "
            f"{100.0 * self.chance_close:.2g} % as close together"
        )
        if min(self.chance_near, self.chance_close) > _CHANCE:
            return UNDETERMINED, said
        if np.all(np.abs(_wrapped(np.subtract(self.means_deg, self.printed))) <= _GRID_DEG / 2.0):
            return AGREES, said
        return (UNTOLD if self.within_error else NOT_REPRODUCIBLE), said

    @property
    def details(self) -> dict[str, float | None]:
        """Numbers for the details of the row."""
        spread = {f"spread_{i}_deg": d for i, d in enumerate(self.spread_deg, 1)}
        of_chance = {f"chance_spread_{i}_deg": d for i, d in enumerate(self.chance_spread_deg, 1)}
        return {
            "found": float(self.found),
            "distinct": float(self.distinct),
            **spread,
            "chance_near": self.chance_near,
            "chance_close": self.chance_close,
            "chance_within": self.chance_within,
            "on_grid": float(all(angle % _GRID_DEG == 0.0 for angle in self.printed)),
            **of_chance,
            "chance_more_deg": self.chance_more_deg,
            "chance_more_sd_deg": self.chance_more_sd_deg,
        }


def free_ends(
    printed: Sequence[int], stored: Mapping[str, Any], motions: tuple[str, ...]
) -> dict[str, float | None]:
    """Details of the row without noise: swarms on the measured list, those at the print, spread by ply."""
    ends = Ends.of(np.array(stored["angles_deg"], dtype=float), printed, motions)
    return {
        "swarms": float(len(ends.away_deg)),
        "swarms_found": float(np.sum(np.all(ends.away_deg == 0.0, axis=1))),
        **{f"free_spread_{i}_deg": float(d) for i, d in enumerate(ends.spread_deg, 1)},
    }


def told(weighed: Mapping[str, Any]) -> dict[str, float]:
    """Information of a perturbed list about the angles: probabilities, bits by ply from the outermost."""
    kept = ("true_probability", "printed_probability", "most_bits", "credible_95_count", "p_value")
    bits = {f"bits_{i}": b for i, b in enumerate(weighed["bits"], 1)}
    return {**{key: float(weighed[key]) for key in kept}, **bits}


def noisy_angles(rows: Sequence[Row]) -> tuple[str, ...]:
    """Sentences on what the mean angles of Tables 11 to 14 can show; empty where none was computed."""
    of_angles = [row for row in rows if "spread_1_deg" in row.details]
    if not of_angles:
        return ()
    found = sum(int(row.details["found"] or 0) for row in of_angles)
    on_grid = sum(row.details["on_grid"] == 1.0 for row in of_angles)
    within = sum(row.verdict in (AGREES, UNTOLD) for row in of_angles)
    by_chance = sum(row.details["chance_within"] or 0.0 for row in of_angles)
    undetermined = [row for row in of_angles if row.verdict == UNDETERMINED]
    printed_found = (
        "Angles and constants were searched together, as in the paper, by one fuzzy swarm on each of ten "
        f"lists per level: {found} of {PRINTED_GROUPS * len(of_angles)} inversions end at the printed angles "
        "or an image with the same frequencies."
    )
    means = (
        f"The printed means agree with ours or cannot be told apart at {within} of {len(of_angles)} levels; "
        f"uniform angles would agree at {by_chance:.1f} of {len(of_angles)}. At {len(undetermined)} levels "
        f"more than {100.0 * _CHANCE:.0f} % of {_DRAWS} draws of uniform angles are as near the print and as "
        f"close together as our inversions. At {on_grid} all printed means are multiples of {_GRID_DEG:g} "
        "degrees; by chance, one such mean in ten is."
    )
    scatter = " ".join(filter(None, (_scatter(of_angles), _without_noise(rows))))
    return tuple(
        filter(None, (printed_found, means, scatter, _weighed_angles(rows), _inner_plies(of_angles)))
    )


def _scatter(rows: Sequence[Row]) -> str:
    outer, inner = _outer_and_inner(rows, "spread_")
    uniform_outer, uniform_inner = _outer_and_inner(rows, "chance_spread_")
    more, uniform, sd = _inner_scatters_more(rows)
    return (
        f"The outermost unknown angle scatters by {outer:.0f} degrees, the innermost by {inner:.0f} "
        f"(difference {more:.1f}); uniform angles, on the image nearest the print, by {uniform_outer:.0f} "
        f"and {uniform_inner:.0f} (difference {uniform:.1f} +- {sd:.1f})."
    )


def _without_noise(rows: Sequence[Row]) -> str:
    """Sentence on the scatter of swarms on the measured lists; "" where none were run."""
    free = [row for row in rows if "free_spread_1_deg" in row.details]
    if not free:
        return ""
    outer, inner = _outer_and_inner(free, "free_spread_")
    swarms, found = (int(sum(row.details[key] or 0.0 for row in free)) for key in ("swarms", "swarms_found"))
    noisy = _outer_and_inner([row for row in rows if "spread_1_deg" in row.details], "spread_")
    own = all(2.0 * alone**2 > noise**2 for alone, noise in zip((outer, inner), noisy, strict=True))
    whose = "; most of the scatter is the swarm's own" if own else ""
    return (
        f"Without noise {swarms} swarms on the measured lists ({found} end at the print) scatter by "
        f"{outer:.0f} and {inner:.0f}{whose}."
    )


def _inner_scatters_more(rows: Sequence[Row]) -> tuple[float, float, float]:
    """Mean spread of the innermost minus the outermost ply: ours, of uniform angles, and its sd there."""
    outer, inner = _outer_and_inner(rows, "spread_")
    uniform = float(np.mean([row.details["chance_more_deg"] for row in rows]))
    sd = math.sqrt(sum((row.details["chance_more_sd_deg"] or 0.0) ** 2 for row in rows)) / len(rows)
    return inner - outer, uniform, sd


def _outer_and_inner(rows: Sequence[Row], key: str) -> tuple[float, float]:
    """Mean over the rows of a detail, for the outermost and for the innermost unknown ply."""
    plies = [[v or 0.0 for k, v in row.details.items() if k.startswith(key)] for row in rows]
    outer, inner = (float(np.mean([of_row[i] for of_row in plies])) for i in (0, -1))
    return outer, inner


def _weighed_angles(rows: Sequence[Row]) -> str:
    """Sentence on the information of one list per level about the angles; "" where no layups were weighed."""
    weighed, odd = _weighed(rows)
    if not weighed:
        return odd.strip()
    outer, inner = _outer_and_inner(weighed, "bits_")
    true = max(row.details["true_probability"] or 0.0 for row in weighed)
    return (
        f"The first list of each level, over all layups, gives {outer:.2f} bits on the outermost angle and "
        f"{inner:.2f} on the innermost, of {weighed[0].details['most_bits']:.2f} "
        f"({len(weighed)} lists; less on the innermost in {_less_of_the_innermost(weighed)}). The plate's "
        f"stated layup has a probability of {true:.2g} at most.{odd}"
    )


def _weighed(rows: Sequence[Row]) -> tuple[list[Row], str]:
    """Rows whose list some layup explains, and a sentence on those that none explains at their noise.

    The information of the latter is about another plate.
    """
    weighed = [row for row in rows if "bits_1" in row.details]
    odd = [row for row in weighed if (row.details["p_value"] or 0.0) < UNEXPLAINED]
    which = [f"{row.specimen} at {row.source} (p = {row.details['p_value']:.1g})" for row in odd]
    said = f" Left out: no layup explains the list of {listed(which, 'and')}." if odd else ""
    return [row for row in weighed if row not in odd], said


def _less_of_the_innermost(weighed: Sequence[Row]) -> int:
    pairs = (_outer_and_inner([row], "bits_") for row in weighed)
    return sum(inner < outer for outer, inner in pairs)


def _inner_plies(rows: Sequence[Row]) -> str:
    """Sentence on whether inner plies are more sensitive to noise, by bits and by scatter."""
    more, uniform, sd = _inner_scatters_more(rows)
    weighed, _ = _weighed(rows)
    by_bits = bool(weighed) and _chance_of(_less_of_the_innermost(weighed), len(weighed)) <= _CHANCE
    shown = _SHOWN[by_bits, more > uniform + _BEYOND_CHANCE * sd]
    is_few = bool(weighed) and _chance_of(len(weighed), len(weighed)) > _CHANCE
    few = "; so few lists cannot show it by their bits" if is_few else ""
    return (
        "The paper's claim that inner plies are more sensitive to noise than outer ones is supported "
        f"{shown}{few}."
    )


def _chance_of(less: int, of: int) -> float:
    """One-sided p-value of the sign test: so many lists or more, where either outcome is as likely."""
    return sum(math.comb(of, k) for k in range(less, of + 1)) / 2.0**of


# (fewer bits of the innermost angle, more scatter of it), each beyond chance -> words.
_SHOWN: Final = {
    (True, True): "by the bits and by the scatter of the inversions",
    (True, False): "by the bits, not by the scatter of the inversions",
    (False, True): "by the scatter of the inversions, not by the bits",
    (False, False): "neither by the bits nor by the scatter of the inversions",
}


def _wrapped(angles_deg: Any) -> Any:
    """Angles modulo 180 degrees, above -90 up to 90."""
    return 90.0 - np.mod(90.0 - angles_deg, 180.0)
