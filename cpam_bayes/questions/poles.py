"""The question `poles`: natural frequencies and damping from frequency responses or recorded hits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes import __version__
from cpam_bayes.answer import Notice
from cpam_bayes.command import Command, option, positive, whole
from cpam_bayes.errors import checked
from cpam_bayes.formatting import significant, with_spread
from cpam_bayes.plate.modal_analysis.fit import DEFAULT_ORDER, Pole, Taken, is_of_mains
from cpam_bayes.plate.modal_analysis.hits import (
    WINDOWS,
    FrequencyResponses,
    ModalTestError,
    Window,
    peaks_of,
    relative_power,
)
from cpam_bayes.plate.modal_analysis.peaks import (
    LEAST_ORDER,
    MOST_ORDER,
    ModalTest,
    hit_notices,
    modal_test,
)
from cpam_bayes.render.report import (
    COMPUTATION,
    Column,
    Report,
    Rows,
    Section,
    facts,
)
from cpam_bayes.render.spectrum import Mark, test_drawings
from cpam_bayes.result import Result, present
from cpam_bayes.running import SILENT, Watch, single_blas_thread

TABLE: Final = "modes.csv"
"""File name of the table of modes in `--out`."""
# Lines at and next to 0 Hz are drift.
_FIRST_PEAK: Final = 3
# A peak belongs to a mode within this many half widths.
_PEAK: Final = 3.0
# Modes closer than this many of their half widths together are reported; relative sd that is poor.
_CLOSE, _POOR = 2.0, 0.01
_MOST_HZ: Final = 1e6
_MOST_CHANNELS: Final = 256


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PolesResult(Result):
    """Poles of a modal test.

    Attributes
    ----------
    files : the files read
    test : responses, poles by model order, and range
    """

    command: ClassVar[str] = "poles"

    files: tuple[str, ...]
    test: ModalTest

    @property
    def modes(self) -> tuple[Pole, ...]:
        """The modes, ascending."""
        return self.test.modes

    @property
    def others(self) -> tuple[Pole, ...]:
        """Poles taken for something other than a mode, ascending."""
        return self.test.others

    @property
    def status(self) -> str:
        """Either "done", or "no modes"."""
        return "done" if self.modes else "no modes"

    @property
    def title(self) -> str:
        """Names of the files, three at most."""
        return " ".join(Path(name).name for name in self.files[:3]) + (" ..." if len(self.files) > 3 else "")

    @property
    def table(self) -> str:
        """The modes as CSV for `[measurement] table` of a plate file; a weight of 0 leaves a mode out."""
        rows = [
            f"{i},{mode.frequency:.6g},{mode.sd:.3g},{mode.damping:.4g},{_height(mode)},1"
            for i, mode in enumerate(self.modes, 1)
        ]
        return "\n".join(["mode,hz,sd,damping,height,weight", *rows, ""])

    def texts(self) -> Mapping[str, str]:
        """The table of modes, if there are any, by file name."""
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

    Poles of least-squares complex frequency-domain models over many orders (`stabilise`); stable ones
    are fitted again hit by hit, each in a band of its own (`fit_poles`), and those that recur and stand out
    are modes (`modes_of_hits`).

    Parameters
    ----------
    files : universal files with datasets 58, tables of frequency responses (hz and then re, im or magnitude,
        phase [deg] of each response), or .wav files of recorded hits or a folder of them; all are one test
    force, response : channels of .wav files, from 1; if left out, one of several channels that is a pulse is
        the force and the others are responses; without force each hit is a free decay
    window : of .wav files, "none" (left out) or "exponential", whose added damping is subtracted
    low_hz, high_hz : the range; left out, from 20 Hz or above the first lines, of hits up to where the force
        has fallen to a tenth, of free decays a quarter above the last line above the noise
    order : number of poles of the largest model, 10 to 200
    seed : recorded in the result; nothing is random

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
    if window is not None and window not in WINDOWS:
        raise ModalTestError(f"--window: received {window}, accepted: {' '.join(WINDOWS)}")
    names = tuple(str(name) for name in files)
    test = modal_test(
        names,
        force=force,
        response=response,
        window=window,
        low=low_hz,
        high=high_hz,
        order=order,
        announce=watch.announce,
    )
    modes = test.modes
    return PolesResult(
        seed=seed,
        notices=(*test.responses.notices, *_notices(test.responses, modes, test.low, test.high)),
        reached_goal=bool(modes),
        files=names,
        test=test,
    )


def _is_under(peak: float, mode: Pole, step: float) -> bool:
    return abs(peak - mode.frequency) < _PEAK * mode.damping * mode.frequency + 2.0 * step


def _below(responses: FrequencyResponses, size: NDArray[np.float64], low: float) -> Iterator[Notice]:
    """Notice of a peak below the range that is the largest of all; size : (n,) magnitude of the lines."""
    at = int(np.argmax(size[_FIRST_PEAK:])) + _FIRST_PEAK
    if responses.frequencies[at] < low:
        yield Notice("largest_below_range", facts={"frequency": float(responses.frequencies[at])})


def _notices(
    responses: FrequencyResponses, modes: Sequence[Pole], low: float, high: float
) -> Iterator[Notice]:
    size = np.sqrt(relative_power(responses.frf))
    inside = (responses.frequencies >= low) & (responses.frequencies <= high)
    peaks = peaks_of(responses.frequencies[inside], size[inside])
    left = tuple(float(f) for f in peaks if not any(_is_under(f, one, responses.step) for one in modes))
    yield from _below(responses, size, low)
    if not modes:
        yield Notice("no_poles", facts={"range": (low, high), "peaks": left})
        return
    if left:
        yield Notice("peaks_without_pole", facts={"peaks": left})
    close = tuple(
        (a.frequency, b.frequency)
        for a, b in pairwise(modes)
        if b.frequency - a.frequency < _CLOSE * (a.damping * a.frequency + b.damping * b.frequency)
    )
    if close:
        yield Notice("close_poles", facts={"pairs": close})
    yield from hit_notices(modes)
    poor = tuple(one.frequency for one in modes if one.sd > _POOR * one.frequency)
    if poor:
        yield Notice("poor_poles", facts={"frequencies": poor, "limit": _POOR})


_COLUMNS: Final = (
    Column("mode", None, lambda row: row[0], number=True),
    Column("Hz", None, lambda row: with_spread(row[1].frequency, row[1].sd)[0], number=True),
    Column("sd", None, lambda row: with_spread(row[1].frequency, row[1].sd)[1], number=True),
    Column("damping %", None, lambda row: _damping(row[1])[0], number=True),
    Column("sd", None, lambda row: _damping(row[1])[1], number=True),
    Column("loss factor", None, lambda row: significant(2.0 * row[1].damping, 3), number=True),
    Column("height", None, lambda row: _height(row[1]), number=True),
    Column("hits", None, lambda row: str(row[1].hits) if len(row[1].each) > 1 else "", number=True),
    Column(None, "hz", lambda row: row[1].frequency),
    Column(None, "sd", lambda row: row[1].sd),
    Column(None, "damping", lambda row: row[1].damping),
    Column(None, "damping_sd", lambda row: row[1].damping_sd),
    Column(None, "height", lambda row: row[1].height),
    Column(None, "peak_hz", lambda row: row[1].peak if np.isfinite(row[1].peak) else None),
    Column(None, "hits", lambda row: row[1].hits),
)
_OTHERS: Final = (
    Column("Hz", "hz", lambda one: one.frequency, lambda f: f"{f:.5g}", number=True),
    Column("height", "height", lambda one: one.height, lambda h: significant(h, 2), number=True),
    Column("hits", "hits", lambda one: one.hits, number=True),
    Column("classified as", "taken", lambda one: one.taken.value),
)


def _height(mode: Pole) -> str:
    return significant(mode.height, 2)


def _damping(mode: Pole) -> tuple[str, str]:
    return with_spread(100.0 * mode.damping, 100.0 * mode.damping_sd)


@present.register
def _present(result: PolesResult) -> Report:
    test, found = result.test, result.test.stabilisation
    modes = Rows("modes", _COLUMNS, tuple(enumerate(result.modes, 1)))
    others = Rows("others", _OTHERS, result.others)
    computed = (
        ("files", ", ".join(result.files)),
        ("read", test.responses.origin),
        ("lines", f"{test.responses.step:.6g} Hz apart"),
        ("range", f"{test.low:.6g} to {test.high:.6g} Hz"),
        ("orders", f"2 to {test.order} poles per octave, least-squares complex frequency domain"),
        (
            "poles",
            f"{len(found.orders)}, of which {int(found.stable.sum())} also occur at the order below",
        ),
        (
            "candidates",
            f"{len(found.candidates)} recur over many orders; {len(result.modes)} modes",
        ),
    )
    return Report(
        summary=result.screen(
            headline=_headline(result.modes),
            tables=(modes.table("Modes"),),
            lines=(
                f"From {test.responses.origin}; range {test.low:.5g} to {test.high:.5g} Hz, lines "
                f"{test.responses.step:.4g} Hz apart.",
                *((_contained(result.modes),) if result.modes else ()),
            ),
            next_step=_NEXT if result.modes else "",
        ),
        sections=(
            Section("Spectrum", figures=("spectrum",), folded=False),
            *((Section("Rejected poles", (others.table("Rejected poles"),)),) if result.others else ()),
            Section("Stability diagram", figures=("stability",)),
            Section(COMPUTATION, (facts("Computation", computed),)),
        ),
        document={
            "command": result.command,
            "version": __version__,
            "files": list(result.files),
            "read": test.responses.origin,
            "responses": len(test.responses.frf),
            "line_hz": test.responses.step,
            "range_hz": [test.low, test.high],
            "order": test.order,
            "modes": modes.records(),
            "others": others.records(),
            "seed": result.seed,
            "warnings": list(result.warnings),
        },
        drawings=test_drawings(result.test, result.title, _marks(result)),
        rows=(modes, others),
    )


def _contained(modes: Sequence[Pole]) -> str:
    """Sentence on the content of the standard deviations; a single hit has no scatter between hits."""
    of_hits = "the scatter from hit to hit"
    contained, missing = ("", f"{of_hits}, ") if len(modes[0].each) <= 1 else (f" and {of_hits}", "")
    return (
        f"The standard deviations contain noise{contained}. Not contained: {missing}suspension, temperature, "
        "hit position, and the mass of an accelerometer, which [[sensor]] states."
    )


_NEXT: Final = (
    f"--out DIR writes {TABLE} and the stability diagram; weight 0 leaves a mode out. In the plate file: "
    f'[measurement] table = "{TABLE}"'
)


def _headline(modes: Sequence[Pole]) -> str:
    if not modes:
        return "No modes found."
    if len(modes) == 1:
        return f"1 mode at {modes[0].frequency:.5g} Hz."
    return f"{len(modes)} modes from {modes[0].frequency:.5g} to {modes[-1].frequency:.5g} Hz."


def _marks(result: PolesResult) -> list[Mark]:
    """Label of each peak, including peaks without a pole."""
    poles = sorted((*result.modes, *result.others), key=lambda one: one.frequency)
    marks = [
        Mark(one.frequency, "" if one.taken is Taken.MODE else one.taken.value, one.taken is Taken.MODE)
        for one in poles
    ]
    step = result.test.responses.step
    for notice in result.notices:
        if notice.code == "peaks_without_pole":
            hum = {True: Taken.HUM.value, False: "no mode"}
            marks += [Mark(f, hum[is_of_mains(f, step)], False) for f in notice.facts["peaks"]]
    return marks


def _poles_in_range(*files: str, range_hz: Sequence[float] | None, **options: Any) -> PolesResult:
    """`poles` with the two ends of `--range`."""
    low, high = range_hz or (None, None)
    return poles(*files, low_hz=low, high_hz=high, **options)


_CHANNEL: Final = whole(1, _MOST_CHANNELS)
COMMAND: Final = Command(
    _poles_in_range,
    (
        option(
            "files",
            nargs="+",
            metavar="FILE",
            help="universal files with datasets 58, tables of responses, hits (.wav) or a folder of hits",
        ),
        option(
            "--force",
            type=_CHANNEL,
            metavar="N",
            help=".wav: channel of the force, from 1 (default: the one that is a pulse)",
        ),
        option(
            "--response",
            type=_CHANNEL,
            nargs="+",
            default=(),
            metavar="N",
            help=".wav: channels of the responses (default: all others)",
        ),
        option(
            "--window",
            choices=WINDOWS,
            help=".wav: window of the records (default: none); exponential: a decay to 1 %% at their "
            "ends, whose damping is subtracted",
        ),
        option(
            "--range",
            "range_hz",
            type=positive(_MOST_HZ, "frequency"),
            nargs=2,
            metavar=("LOW", "HIGH"),
            help="Hz (default: from 20 Hz or the first lines; for hits up to where the force has fallen to a "
            "tenth, for decays a quarter above the last line above noise)",
        ),
        option(
            "--order",
            type=whole(LEAST_ORDER, MOST_ORDER),
            default=DEFAULT_ORDER,
            metavar="N",
            help=f"poles of the largest model (default: {DEFAULT_ORDER})",
        ),
    ),
    out="write modes.csv, the stability diagram and the page to DIR",
)
