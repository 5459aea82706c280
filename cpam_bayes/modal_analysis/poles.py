"""Natural frequencies and damping from frequency responses or recorded hits: the question `poles`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.arguments import checked
from cpam_bayes.modal_analysis.doubts import peaks_of, relative_power
from cpam_bayes.modal_analysis.fit import Pole, fit_poles
from cpam_bayes.modal_analysis.read import read_responses
from cpam_bayes.modal_analysis.records import FrequencyResponses, ModalTestError
from cpam_bayes.modal_analysis.signals import WINDOWS, Window
from cpam_bayes.modal_analysis.stabilisation import DEFAULT_ORDER, Stabilisation, stabilise
from cpam_bayes.result import SILENT, Result, Watch
from cpam_bayes.threads import single_blas_thread

__all__ = ["PolesResult", "poles"]

TABLE: Final = "modes.csv"
"""The table of modes among the files of `--out`."""
# Orders that can be asked for.
_LEAST_ORDER, _MOST_ORDER = 10, 200
# Responses times lines: as many take some seconds and less than 1 GiB.
_MOST_VALUES: Final = 2_000_000
# Where the range begins, unless given: lines, and a fraction of its end.
_FIRST_LINE, _FIRST_FRACTION = 10, 0.02
# Lines at 0 Hz and beside it are drift.
_FIRST_PEAK: Final = 3
# A peak belongs to a mode within so many half widths; so many others are named.
_PEAK, _MOST_SAID = 3.0, 10
# Modes closer than this many of their half widths together are told of, and a poor standard deviation.
_CLOSE, _POOR = 2.0, 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PolesResult(Result):
    """Poles of a test.

    Attributes
    ----------
    files : that were read
    responses : what was read
    stabilisation : poles by model order
    modes : ascending
    low, high : Hz, the range
    order : number of poles of the largest model
    """

    question: ClassVar[str] = "poles"
    command: ClassVar[str] = "poles"

    files: tuple[str, ...]
    responses: FrequencyResponses
    stabilisation: Stabilisation
    modes: tuple[Pole, ...]
    low: float
    high: float
    order: int

    @property
    def status(self) -> str:
        """Whether there are modes."""
        return "done" if self.modes else "no modes"

    @property
    def title(self) -> str:
        """The files."""
        return " ".join(Path(name).name for name in self.files[:3]) + (" ..." if len(self.files) > 3 else "")

    @property
    def table(self) -> str:
        """The modes as `[measurement] table` of a plate file reads them; a weight of 0 leaves a mode out."""
        rows = [
            f"{i},{mode.frequency:.6g},{mode.sd:.3g},{mode.damping:.4g},1"
            for i, mode in enumerate(self.modes, 1)
        ]
        return "\n".join(["mode,hz,sd,damping,weight", *rows, ""])

    def texts(self) -> Mapping[str, str]:
        """The table of modes."""
        return {TABLE: self.table} if self.modes else {}


@checked
@single_blas_thread
def poles(
    *files: str | Path,
    force: int | None = None,
    response: Sequence[int] = (),
    window: Window | None = None,
    low_hz: float | None = None,
    high_hz: float | None = None,
    order: int = DEFAULT_ORDER,
    seed: int = 0,
    watch: Watch = SILENT,
) -> PolesResult:
    """Natural frequencies and damping ratios with standard deviations, as a table of modes.

    Poles by the least-squares complex frequency-domain estimator of sdypy-EMA over many orders; those that
    stay are fitted again, in a band about each, for their standard deviations (`fit_poles`).

    Parameters
    ----------
    files : universal files with datasets 58, tables of frequency responses (hz and then re, im or magnitude,
        phase [deg] of each response), or .wav files of recorded hits; several are one test
    force, response : channels of .wav files, from 1; without force each hit is a free decay
    window : of .wav files, "none" or "exponential", whose damping is taken off again
    low_hz, high_hz : the range; left out, all but the first lines, of hits up to where the force has fallen
        to a tenth, of decays without a force a quarter above the last line that stands above noise
    order : number of poles of the largest model, 10 to 200
    seed : of the result's record; nothing is drawn at random

    Raises
    ------
    ValueError
        If a file cannot be read, or an argument is out of range.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> import numpy as np
    >>> from tempfile import TemporaryDirectory
    >>> f = np.arange(1.0, 200.0)
    >>> h = 1.0 / (100.0**2 - f**2 + 2j * 0.01 * 100.0 * f)  # 100 Hz, 1 % of critical damping
    >>> h = h + 1e-6 * np.random.default_rng(0).standard_normal((2, len(f))).T @ [1.0, 1j]
    >>> with TemporaryDirectory() as directory:
    ...     rows = np.stack((f, h.real, h.imag), axis=1)
    ...     np.savetxt(f"{directory}/tap.csv", rows, delimiter=",", header="hz,re,im", comments="")
    ...     result = cb.poles(f"{directory}/tap.csv", order=20)
    >>> [(round(mode.frequency, 1), round(mode.damping, 3)) for mode in result.modes]
    [(100.0, 0.01)]
    """
    if not files:
        raise ModalTestError("no file, accepted: one or more")
    if not _LEAST_ORDER <= order <= _MOST_ORDER:
        raise ModalTestError(f"--order: received {order}, accepted: {_LEAST_ORDER} to {_MOST_ORDER}")
    if window is not None and window not in WINDOWS:
        raise ModalTestError(f"--window: received {window}, accepted: {' '.join(WINDOWS)}")
    names = tuple(str(name) for name in files)
    responses = read_responses(names, force=force, response=response, window=window, high=high_hz)
    last = float(responses.frequencies[-1])
    high = last if high_hz is None else min(high_hz, last)
    low = max(_FIRST_LINE * responses.step, _FIRST_FRACTION * high) if low_hz is None else low_hz
    if not 0.0 <= low < high:
        raise ModalTestError(f"--range: received {low:g} to {high:g} Hz, accepted: within 0 to {last:g} Hz")
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
    watch.announce(f"poles: {len(responses.frf)} responses, {lines} lines, up to {order} poles")
    found = stabilise(responses, low, high, order)
    modes = tuple(one for one in fit_poles(responses, found.candidates) if low <= one.frequency <= high)
    return PolesResult(
        seed=seed,
        warnings=(*responses.remarks, *_warnings(responses, modes, low, high)),
        reached_goal=bool(modes),
        files=names,
        responses=responses,
        stabilisation=found,
        modes=modes,
        low=low,
        high=high,
        order=order,
    )


def _is_under(peak: float, mode: Pole, step: float) -> bool:
    """Whether a peak is that of a mode."""
    return abs(peak - mode.frequency) < _PEAK * mode.damping * mode.frequency + 2.0 * step


def _below(responses: FrequencyResponses, size: NDArray[np.float64], low: float) -> tuple[str, ...]:
    """A peak below the range that is the largest of all; size : of the lines, (n,)."""
    at = int(np.argmax(size[_FIRST_PEAK:])) + _FIRST_PEAK
    if not responses.frequencies[at] < low:
        return ()
    return (
        f"the responses are largest at {responses.frequencies[at]:.4g} Hz, below the range, where no modes "
        "are looked for: a mode, the plate on its support, or hum; --range widens it",
    )


def _warnings(
    responses: FrequencyResponses, modes: Sequence[Pole], low: float, high: float
) -> tuple[str, ...]:
    size = np.sqrt(relative_power(responses.frf))
    inside = (responses.frequencies >= low) & (responses.frequencies <= high)
    peaks = peaks_of(responses.frequencies[inside], size[inside])
    left = [f"{f:.5g}" for f in peaks if not any(_is_under(f, one, responses.step) for one in modes)]
    below = _below(responses, size, low)
    if not modes:
        seen = f"peak at {', '.join(left[:_MOST_SAID])} Hz" if left else "have no clear peak"
        return (
            *below,
            f"no pole stays over the orders from {low:.4g} to {high:.4g} Hz, where the responses {seen}: "
            "widen the range, raise --order, or look at the responses",
        )
    problems = [*below]
    if left:
        problems.append(
            f"peaks of the responses without a mode of the table: {', '.join(left[:_MOST_SAID])} Hz; modes "
            "that were not found with this --order and range, or steady tones such as mains hum: look at the "
            "stability diagram, and try another --order"
        )
    close = [
        f"{a.frequency:.5g} and {b.frequency:.5g} Hz"
        for a, b in pairwise(modes)
        if b.frequency - a.frequency < _CLOSE * (a.damping * a.frequency + b.damping * b.frequency)
    ]
    if close:
        problems.append(
            f"modes closer than their peaks are wide: {', '.join(close)}; two of one mode may come from hits "
            "that differ, so keep both only where another response shows them"
        )
    poor = [f"{one.frequency:.5g} Hz" for one in modes if one.sd > _POOR * one.frequency]
    if poor:
        problems.append(f"a standard deviation above 1 %: {', '.join(poor)}")
    return tuple(problems)
