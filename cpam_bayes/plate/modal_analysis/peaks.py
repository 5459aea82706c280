"""Peaks of a modal test: the poles within a range, as candidates for the modes of a plate model.

The height of a candidate gives its probability of being a mode. `[measurement]` of a plate file names
recordings, or a table of peaks that other software found.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Notice
from cpam_bayes.plate.modal_analysis.fit import (
    DEFAULT_ORDER,
    STANDS_OUT,
    Pole,
    Stabilisation,
    Taken,
    fit_poles,
    modes_of_hits,
    stabilise,
    with_others,
)
from cpam_bayes.plate.modal_analysis.hits import FrequencyResponses, ModalTestError, Window
from cpam_bayes.plate.modal_analysis.read import of_folder, read_responses
from cpam_bayes.plate.modes_of_hits import heads_named, located
from cpam_bayes.plate.modes_table import HEIGHT, Hit, TableProblem, is_texts, once, read_sheets
from cpam_bayes.plate.schema import MAX_FREQUENCIES
from cpam_bayes.plate.text import Data, Problem, numbers, read_named_file, table
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

LEAST_ORDER: Final = 10
MOST_ORDER: Final = 200
"""The largest order that can be requested; the smallest is ``LEAST_ORDER``."""
# Most responses times lines: they take some seconds and less than 1 GiB.
_MOST_VALUES: Final = 2_000_000
# The range begins, unless given, at this line or the lower of a fraction of its end and a frequency.
_FIRST_LINE, _FIRST_FRACTION, _FIRST_HZ = 10, 0.02, 20.0
# Modes that scatter by more than this fraction from hit to hit drift.
_DRIFTING: Final = 0.005
# Of at least this many hits, one is unlike the others where its shift is above this multiple of the usual one
# and this fraction; it may be of another plate where it has at most this fraction of the modes.
_LEAST_HITS, _UNLIKE, _LEAST_SHIFT, _FEW = 3, 8.0, 0.002, 0.6
# No height makes it certain that a peak is a mode, or that it is none.
_LEAST_PROBABILITY: Final = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ModalTest:
    """The poles of a test within a range.

    responses : as read
    stabilisation : poles by model order
    poles : ascending, each with its kind
    low, high : Hz, the range
    order : number of poles of the largest model
    """

    responses: FrequencyResponses
    stabilisation: Stabilisation
    poles: tuple[Pole, ...]
    low: float
    high: float
    order: int

    @property
    def modes(self) -> tuple[Pole, ...]:
        """The poles that were taken for modes."""
        return tuple(one for one in self.poles if one.taken is Taken.MODE)

    @property
    def others(self) -> tuple[Pole, ...]:
        """The poles that were taken for something else."""
        return tuple(one for one in self.poles if one.taken is not Taken.MODE)

    @property
    def notices(self) -> tuple[Notice, ...]:
        """Notices about the files and the hits."""
        return (*self.responses.notices, *hit_notices(self.modes))


def hit_notices(modes: Sequence[Pole]) -> Iterator[Notice]:
    """Notices of modes that drift from hit to hit, hits with few of the modes, and shifted hits."""
    drifting = tuple(one.frequency for one in modes if one.scatter > _DRIFTING * one.frequency)
    if drifting:
        yield Notice("drifting_modes", facts={"frequencies": drifting, "limit": _DRIFTING})
    if not modes or len(modes[0].each) < _LEAST_HITS:
        return
    f = np.array([one.each for one in modes])
    shares_few = np.isfinite(f).mean(axis=0) <= _FEW
    if shares_few.any():
        hits = tuple(int(k) + 1 for k in np.flatnonzero(shares_few))
        yield Notice("hits_apart", facts={"hits": hits, "of": f.shape[1]})
    alike = np.flatnonzero(~shares_few)
    if len(alike) < _LEAST_HITS:
        return
    f = f[:, alike]
    f = f[np.isfinite(f).any(axis=1)]
    shift = np.nanmedian(f / np.nanmedian(f, axis=1, keepdims=True) - 1.0, axis=0)
    usual = float(np.median(np.abs(shift - np.median(shift))))
    far = np.abs(shift - np.median(shift)) > max(_UNLIKE * usual, _LEAST_SHIFT)
    for k in np.flatnonzero(far):
        yield Notice("unlike_hit", facts={"hit": int(alike[k]) + 1, "shift": float(shift[k])})


@single_blas_thread
def modal_test(
    files: Sequence[str],
    *,
    force: int | None = None,
    response: Sequence[int] = (),
    window: Window | None = None,
    low: float | None = None,
    high: float | None = None,
    order: int = DEFAULT_ORDER,
    announce: Callable[[str], None] = lambda text: None,
) -> ModalTest:
    """The poles of the files of one test; arguments as for `poles`, low and high in Hz.

    Raises ``ModalTestError`` for files that cannot be read, and for arguments out of range.
    """
    if not LEAST_ORDER <= order <= MOST_ORDER:
        raise ModalTestError(f"--order: received {order}, accepted: {LEAST_ORDER} to {MOST_ORDER}")
    responses = read_responses(files, force=force, response=response, window=window, high=high)
    last = float(responses.frequencies[-1])
    high = last if high is None else min(high, last)
    if low is None:
        low = max(_FIRST_LINE * responses.step, min(_FIRST_FRACTION * high, _FIRST_HZ))
    if low >= 0.0:
        low = max(low, float(responses.frequencies[0]))  # responses may begin above it
    if not 0.0 <= low < high:
        order_of_ends = "; the lower end comes first" if low > high else ""
        raise ModalTestError(
            f"--range: received {low:g} to {high:g} Hz, accepted: within 0 to {last:g} Hz{order_of_ends}"
        )
    lines = int(np.sum((responses.frequencies >= low) & (responses.frequencies <= high)))
    if lines < 2 * order:
        raise ModalTestError(
            f"{lines} lines from {low:g} to {high:g} Hz, accepted: {2 * order} or more for --order {order}"
        )
    if len(responses.frf) * lines > _MOST_VALUES:
        raise ModalTestError(
            f"{len(responses.frf)} responses of {lines} lines from {low:g} to {high:g} Hz, accepted: "
            f"{_MOST_VALUES} values at most: a narrower --range, shorter records or fewer responses"
        )
    announce(f"poles: {len(responses.frf)} responses, {lines} lines, up to {order} poles")
    found = stabilise(responses, low, high, order)
    each = []
    for hit in responses.each_hit:
        own = () if hit is responses else stabilise(hit, low, high, order).candidates
        each.append(fit_poles(hit, with_others(np.array(own, dtype=complex), found.candidates)))
    every = modes_of_hits(each, responses.step, responses.struck_twice)
    poles = tuple(one for one in every if low <= one.frequency <= high)
    return ModalTest(responses, found, poles, low, high, order)


def mode_probability(height: Array, recurring: Array) -> Array:
    """Prior probability that peaks are modes, before a plate model is compared, (n,).

    The odds are the height over `STANDS_OUT` times the fraction of the hits that show the peak; the
    probability is clipped to between 0.02 and 0.98.

    height : (n,) of a peak over the rest of the response
    recurring : (n,) fraction of the hits that show it
    """
    odds = np.asarray(height) / STANDS_OUT * np.asarray(recurring)
    return np.asarray(np.clip(odds / (1.0 + odds), _LEAST_PROBABILITY, 1.0 - _LEAST_PROBABILITY))


def false_peaks(probability: Array) -> Array:
    """Expected number of false peaks like each of n, (n,), for the price of a false one in a pairing.

    The range holds sum q modes; at this density, a peak that matches no better than any other is a mode with
    its own probability q: (sum q) (1 - q) / q.
    """
    return np.asarray(probability.sum() * (1.0 - probability) / probability)


def candidates_of(data: Data, directory: Path | None) -> tuple[dict[str, Any], list[Problem]]:
    """Fields of a `Measurement` from the recordings or peaks that a plate file names, and their problems.

    Hum is no candidate. Where the file states `relative_std`, the standard deviation of a candidate combines
    those of the test and the repeatability; otherwise the scatter about the plate model is inferred.

    directory : base of relative paths
    """
    measurement = table(data, "measurement")
    if "recordings" in measurement:
        return _of_recordings(measurement, directory)
    return _of_table(measurement, directory)


def _of_recordings(measurement: Data, directory: Path | None) -> tuple[dict[str, Any], list[Problem]]:
    key = ("measurement", "recordings")
    names, between = measurement["recordings"], numbers(measurement, "range_hz")
    if not is_texts(names) or not names or not all(names):
        return {}, []  # a wrong type, which the schema tells
    low, high = between if between is not None and len(between) == 2 else (None, None)
    files = tuple(str((directory or Path()) / name) for name in names)
    try:
        each = [Path(path).absolute() for name in files for path in of_folder(name)]
        read = [(str(path), path.stat()) for path in each if path.is_file()]
        stamps = tuple((path, stat.st_mtime_ns, stat.st_size) for path, stat in read)
        test = _unchanged(files, low, high, stamps)
    except (ValueError, OSError) as error:
        return {}, [Problem(key, str(error).replace("--range", "range_hz"))]
    poles = [pole for pole in test.poles if pole.taken is not Taken.HUM]
    if not poles:
        return {}, [Problem(key, f"no peak from {test.low:g} to {test.high:g} Hz, accepted: one or more")]
    n_hits = len(test.responses.each_hit)
    candidates = _Candidates(
        np.array([pole.frequency for pole in poles]),
        np.array([pole.sd for pole in poles]),
        np.array([pole.damping for pole in poles]),
        mode_probability(
            np.array([pole.height for pole in poles]), np.array([pole.hits / n_hits for pole in poles])
        ),
    )
    fields = candidates.fields(measurement, f"{', '.join(names)}: {test.responses.origin}", key)
    return fields[0] | {"test": test}, fields[1]


@lru_cache(maxsize=4)
def _unchanged(
    files: tuple[str, ...], low: float | None, high: float | None, stamps: tuple[tuple[str, int, int], ...]
) -> ModalTest:
    """The test of files, read once while they are unchanged; stamps : path, time and size of each."""
    del stamps
    return modal_test(files, low=low, high=high)


@dataclass(frozen=True, slots=True, eq=False)
class _Candidates:
    """Candidate peaks, ascending: frequency and sd in Hz (nan where not known), damping, probability."""

    frequency: Array
    sd: Array
    damping: Array
    probability: Array

    def fields(
        self, measurement: Data, origin: str, key: tuple[str, ...]
    ) -> tuple[dict[str, Any], list[Problem]]:
        """Fields of a `Measurement`; more peaks than a plate file may list are refused."""
        n = len(self.frequency)
        if n > MAX_FREQUENCIES:
            what = f"{n} peaks, accepted: up to {MAX_FREQUENCIES}"
            return {}, [Problem(key, f"{what}; state range_hz, or leave out the lowest peaks")]
        relative = measurement.get("relative_std")
        stated = isinstance(relative, float) and np.all(np.isfinite(self.sd))
        sd = np.hypot(self.sd, float(relative or 0.0) * self.frequency) if stated else None
        return {
            "frequencies": self.frequency,
            "frequency_sd": sd,
            "labels": ("",) * n,
            "complete": False,
            "false_peaks": false_peaks(self.probability),
            "mode_probability": self.probability,
            "damping": None if np.all(np.isnan(self.damping)) else self.damping,
            "origin": origin,
        }, []


def _of_peaks(rows: Sequence[Hit], unit: str) -> Iterator[TableProblem]:
    """Missing values, peaks in two rows, and heights in an unknown unit; unit : of the heights."""
    if not any(row.hz for row in rows):
        yield TableProblem(0, "", "no peak, accepted: hz and height in each row; sd if known")
    if unit not in ("", "-", "1"):
        yield TableProblem(0, "height", f"unknown unit {unit}, accepted: {HEIGHT}")
    lines: dict[float, int] = {}
    for row in rows:
        if row.hz is None:
            if row.height is not None:
                yield TableProblem(row.line, "hz", "no frequency, accepted: one in each row", "hz")
        elif row.height is None:
            yield TableProblem(row.line, "height", f"no height, accepted: {HEIGHT}", "height")
        elif lines.setdefault(row.hz, row.line) != row.line:
            what = f"received {row.hz:g} Hz as in line {lines[row.hz]}, accepted: each peak once"
            yield TableProblem(row.line, "hz", what, "twice")


def _of_table(measurement: Data, directory: Path | None) -> tuple[dict[str, Any], list[Problem]]:
    key, name = ("measurement", "peaks"), measurement.get("peaks")
    if not isinstance(name, str) or not name:
        return {}, []
    content, unread = read_named_file(key, name, directory, "a table of peaks")
    if content is None:
        return {}, unread
    found, problems, _ = read_sheets(content, heads_named(measurement))
    rows = [] if found is None else [row for row in found.hits if row.weight > 0.0]
    problems = problems if found is None else tuple(_of_peaks(rows, found.units.get("height", "")))
    if problems:
        return {}, [located(key, name, problem) for problem in once(problems)]
    rows = sorted((row for row in rows if row.hz), key=lambda row: row.hz or 0.0)
    columns = (
        np.array([np.nan if value is None else value for value in values], dtype=float)
        for values in zip(*((row.hz, row.sd, row.damping, row.height) for row in rows), strict=True)
    )
    f, sd, damping, height = columns
    probability = mode_probability(height, np.ones(len(f)))
    return _Candidates(f, sd, damping, probability).fields(measurement, f"{name}: peaks", key)
