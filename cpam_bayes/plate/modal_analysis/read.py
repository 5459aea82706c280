"""Frequency responses of a modal test: from files of analysers, or from recorded hits.

Universal files with datasets 58, tables of responses, and .wav files, whose hits are averaged. What cannot be
the record of a hit, such as a clipped channel, is refused; what makes responses doubtful is a remark.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from cpam_bayes.answer import Notice, each_once
from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.instruments import UniversalFileError, decode, read_delimited, read_sets
from cpam_bayes.plate.text import read_regular_file

__all__ = [
    "MAINS",
    "WINDOWS",
    "FrequencyResponses",
    "ModalTestError",
    "Recording",
    "Window",
    "hum_notices",
    "last_line_of_modes",
    "of_folder",
    "peaks_of",
    "read_responses",
    "relative_power",
    "require_force_of_a_hit",
    "require_unclipped",
    "responses_of_hits",
]

Array = NDArray[Any]


class ModalTestError(ValueError):
    """A test that cannot be read or analysed."""


class ClippedError(ModalTestError):
    """A record that holds its largest value."""


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponses:
    """Frequency responses at equal steps of frequency.

    frequencies : (n,) Hz
    frf : (n_responses, n) complex, response over force, or the spectrum of a free decay
    added_decay : rad/s that a window adds to the decay of every mode
    correlation : of the noise of a line with that of the next one, by the window
    origin : the format and what was read, in words
    notices : what makes them doubtful
    hit : (n_responses,) the number of the hit of each, from 0; empty where all are of one
    """

    frequencies: Array
    frf: Array
    added_decay: float
    correlation: float
    origin: str
    notices: tuple[Notice, ...] = ()
    hit: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ("frequencies", "frf"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def step(self) -> float:
        """Between two lines, Hz."""
        return float(self.frequencies[1] - self.frequencies[0])

    @property
    def each_hit(self) -> tuple[FrequencyResponses, ...]:
        """Those of each hit."""
        numbers = np.array(self.hit)
        if len(set(self.hit)) < 2:
            return (self,)
        return tuple(replace(self, frf=self.frf[numbers == k], hit=()) for k in sorted(set(self.hit)))


# A clipped channel holds its largest value for so many samples: once at full scale, else at several places.
_HELD, _PLACES = 3, 3
# A force that passes this fraction of its peak later than so many s, for so many s in all, is no hit's.
_RINGS, _AFTER, _FOR = 0.2, 0.02, 0.01
_BLOCK: Final = 0.002
# A force has its power in so many times fewer samples than the responses.
_SHORTER: Final = 5.0
# A second stroke is this many times the loudest of so many blocks before it, and this part of the first.
_JUMP, _BLOCKS_APART, _OF_STROKE = 3.0, 5, 0.1
# The end of a record, as a fraction, and the least part of its power, and of the
# largest value, that a steady tone has there.
MAINS: Final = (50.0, 60.0)
"""Frequencies of the mains, Hz."""
_TAIL, _OF_POWER, _OF_PEAK = 0.25, 0.5, 0.03
_LEAST_TAIL: Final = 0.2
_MULTIPLES: Final = np.arange(1.0, 6.0)
# Lines of modes stand above the noise, the median, and above this part of the largest one, in power.
_ABOVE_NOISE, _ABOVE_LEAST = 100.0, 1e-5
# A peak is the largest line within this fraction of its frequency and so many lines, above the median of a
# neighbourhood four times as wide, and above this part of the largest one.
_ALONE, _ALONE_LINES, _ABOVE_MEDIAN, _OF_LARGEST = 0.02, 5, 5.0, 0.03


def require_unclipped(name: str, channel: int, samples: Array) -> None:
    """Raise ``ModalTestError`` for a channel (n,), as it was stored, with flat tops."""
    integer = np.issubdtype(samples.dtype, np.integer)
    full = float(np.iinfo(samples.dtype).max) if integer else 1.0
    if samples.dtype == np.uint8:  # 8 bits have no sign
        samples, full = samples.astype(float) - 128.0, 127.0
    held = 0
    for extreme in (samples.max(), samples.min()):
        lengths = _runs(samples == extreme)
        flat = lengths[lengths >= _HELD]
        at_full_scale = abs(float(extreme)) >= (1.0 - 1e-4) * full and (integer or abs(extreme) == full)
        if len(flat) >= (1 if at_full_scale else _PLACES) and extreme:
            held += int(flat.sum())
    if held:
        raise ClippedError(
            f"{name}: channel {channel} is clipped: {held} samples hold its largest or smallest value, which "
            "makes modes that are none, accepted: records that stay below full scale; lower the gain and hit "
            "again"
        )


def _runs(wanted: Array) -> Array:
    """Lengths of the runs of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], wanted, [False])).astype(np.int8)))
    return np.asarray(edges[1::2] - edges[::2])


def require_force_of_a_hit(hits: Sequence[Array], rate: float, before: float) -> None:
    """Raise ``ModalTestError`` where the force of most hits, (channels, n) with the force first, rings.

    before : s of a hit that lie before its onset
    """
    if 2 * sum(_rings(np.abs(hit[0]), rate, before) for hit in hits) <= len(hits):
        return
    raise ModalTestError(
        "--force: received a channel that rings long after the hit, accepted: the channel of the hammer, a "
        "pulse of some ms; is it the channel of a response? then exchange --force and --response"
    )


def _rings(force: Array, rate: float, before: float) -> bool:
    late = force[int((before + _AFTER) * rate) :]
    size = max(int(_BLOCK * rate), 1)
    blocks = late[: len(late) // size * size].reshape(-1, size).max(axis=1, initial=0.0)
    return bool(np.sum(blocks > _RINGS * force.max()) * _BLOCK > _FOR)


def hum_notices(rate: float, channels: Array) -> tuple[Notice, ...]:
    """A steady tone of the mains or a multiple at the end of a record (channels, n), where modes are gone."""
    tail = channels[:, int((1.0 - _TAIL) * channels.shape[1]) :]
    n = tail.shape[1]
    if n < _LEAST_TAIL * rate:
        return ()
    tail = tail - tail.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(tail * np.hanning(n), axis=1)) ** 2
    frequencies = np.fft.rfftfreq(n, 1.0 / rate)
    peak = np.abs(channels - np.median(channels, axis=1, keepdims=True)).max(axis=1)
    loud = np.sqrt(np.mean(tail**2, axis=1)) > _OF_PEAK * peak
    for mains in MAINS:
        near = np.min(np.abs(frequencies[:, None] - mains * _MULTIPLES), axis=1) < 2.5 * rate / n + 0.5
        part = power[:, near].sum(axis=1) / np.maximum(power.sum(axis=1), np.finfo(float).tiny)
        hums = loud & (part > _OF_POWER)
        if hums.any():
            size = float(np.max(np.sqrt(2.0 * part[hums] * np.mean(tail[hums] ** 2, axis=1)) / peak[hums]))
            return (Notice("hum", facts={"mains": mains, "size": size}),)
    return ()


def relative_power(frf: Array) -> Array:
    """Mean power of the lines over the responses (m, n), each over the mean of its own, (n,)."""
    power = np.abs(frf) ** 2
    mean = np.maximum(np.mean(power, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.asarray(np.mean(power / mean, axis=0))


def last_line_of_modes(power: Array) -> int:
    """The last line that stands above the noise; all, where none does; power : (n,)."""
    above = power > max(_ABOVE_NOISE * float(np.median(power)), _ABOVE_LEAST * float(power.max()))
    return int(np.flatnonzero(above)[-1]) if above.any() else len(power) - 1


def peaks_of(frequencies: Array, size: Array) -> Array:
    """The frequencies of the peaks of a spectrum, (n_peaks,) Hz; frequencies, size : (n,)."""
    step = float(frequencies[1] - frequencies[0])
    highest = (size[1:-1] >= size[:-2]) & (size[1:-1] > size[2:]) & (size[1:-1] > _OF_LARGEST * size.max())
    peaks = []
    for i in np.flatnonzero(highest) + 1:
        near = max(int(_ALONE * frequencies[i] / step), _ALONE_LINES)
        window, wider = (size[max(i - k, 0) : i + k + 1] for k in (near, 4 * near))
        if size[i] == window.max() and size[i] > _ABOVE_MEDIAN * np.median(wider):
            peaks.append(float(frequencies[i]))
    return np.array(peaks)


Window = Literal["none", "exponential"]

WINDOWS: Final[tuple[Window, ...]] = ("none", "exponential")
"""Windows of a record: none, or a decay to 1 % at its end, which is taken off again."""
_END: Final = 0.01
# A hit begins where the signal passes this fraction of its largest value, for the first time in so many s.
_ONSET, _APART, _BEFORE = 0.3, 0.25, 0.002
# The range of a test ends where the spectrum of the force has fallen to this fraction of its largest value.
_FORCE_LEFT: Final = 0.1
# Spectra of decays end this much above their last line that stands above noise.
_OUTSIDE: Final = 1.25
_LEAST_LINES: Final = 50
# A range that is found from the responses has these lines at least: twice the poles of the default order.
_LEAST_FOUND: Final = 150
_MOST_HITS: Final = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Signals of one file.

    rate : samples a second
    force : (n,) or None where it was not recorded
    responses : (n_responses, n)
    """

    rate: float
    force: Array | None
    responses: Array


def responses_of_hits(
    recordings: Sequence[Recording], window: Window, high: float | None
) -> FrequencyResponses:
    """Responses over force of every hit, H = conj(F) X / |F|^2; without it, spectra of decays.

    Each hit begins where its force, or its largest response, rises. All hits have the length of the shortest.
    Spectra end at ``high``, Hz, or where the force has fallen to a tenth, or a quarter above the last line of
    a decay that stands above its noise.

    Raises ``ModalTestError`` where there is no hit, hits are too short, or the force is no hit's.
    """
    hits = [hit for one in recordings for hit in _hits(one)]
    if not hits:
        raise ModalTestError("no hit, accepted: a record in which force or response rises above its noise")
    rate, n = recordings[0].rate, min(len(hit[0]) for hit in hits)
    decay = -np.log(_END) * rate / n if window == "exponential" else 0.0
    weight = np.exp(-decay * np.arange(n) / rate)
    spectra = np.stack([np.fft.rfft(hit[:, :n] * weight, axis=1) for hit in hits])  # hits, channels, lines
    frequencies = np.fft.rfftfreq(n, 1.0 / rate)
    has_force, notices = recordings[0].force is not None, _hums(recordings)
    twice = sum(_struck_twice(one) for one in recordings)
    if twice:
        notices += (Notice("double_hits", facts={"files": twice, "of": len(recordings)}),)
    if has_force:
        require_force_of_a_hit(hits, rate, _BEFORE)
        force, response = spectra[:, :1], spectra[:, 1:]
        power = np.sum(np.abs(force) ** 2, axis=0)
        each = np.maximum(np.abs(force) ** 2, np.finfo(float).tiny)
        frf = (force.conj() * response / each).reshape(-1, len(frequencies))
        fallen = np.flatnonzero(power[0] < _FORCE_LEFT**2 * power[0].max())
        end = int(fallen[0]) if high is None and len(fallen) else len(frequencies)
    else:
        frf = spectra.reshape(-1, len(frequencies))
        last = last_line_of_modes(relative_power(frf))
        if high is not None and frequencies[last] > high:
            notices += (Notice("modes_beyond_range", facts={"frequency": float(frequencies[last])}),)
        end = min(max(int(_OUTSIDE * last) + 1, _LEAST_FOUND), len(frequencies))
    if high is not None:
        end = int(np.searchsorted(frequencies, high, side="right"))
    if end < _LEAST_LINES:
        raise ModalTestError(
            f"{end} lines of {rate / n:.3g} Hz, accepted: {_LEAST_LINES} or more: longer records, or a "
            "higher end of the range"
        )
    many = "1 hit" if len(hits) == 1 else f"{len(hits)} hits"
    over = "over force" if has_force else "alone: free decays"
    return FrequencyResponses(
        frequencies[:end],
        frf[:, :end],
        decay,
        1.0 / (1.0 + (np.pi * rate / (decay * n)) ** 2) if decay else 0.0,
        f"{many} of {n / rate:.3g} s, {recordings[0].responses.shape[0]} response {over}; window: {window}",
        notices,
        tuple(np.repeat(np.arange(len(hits)), recordings[0].responses.shape[0]).tolist()),
    )


def _struck_twice(recording: Recording) -> bool:
    """Whether the hammer touched the plate twice in a hit."""
    if recording.force is None:
        hits = _hits(recording, whole=True)
        return any(_second_stroke(hit, recording.rate) > 0 for hit in hits)
    return any(_second_stroke(hit[:1], recording.rate) > 0 for hit in _hits(recording))


def _hums(recordings: Sequence[Recording]) -> tuple[Notice, ...]:
    return each_once(notice for one in recordings for notice in hum_notices(one.rate, one.responses))


def _hits(recording: Recording, whole: bool = False) -> list[Array]:
    """The channels (1 + n_responses, n), or (n_responses, n) without force, from each hit to the next.

    whole : with both strokes of a double hit where there is no force
    """
    force, responses = recording.force, recording.responses
    trigger = np.abs(responses).max(axis=0) if force is None else np.abs(force - np.median(force))
    channels = responses if force is None else np.vstack((force, responses))
    if not trigger.max() > 0.0:
        return []
    above = np.flatnonzero(trigger > _ONSET * trigger.max())
    first = above[np.append(True, np.diff(above) > _APART * recording.rate)]
    if len(first) > _MOST_HITS:
        raise ModalTestError(
            f"{len(first)} hits, accepted: {_MOST_HITS} at most: records that rest between hits"
        )
    starts = np.maximum(first - int(_BEFORE * recording.rate), 0)
    ends = np.append(starts[1:], channels.shape[1])
    hits = [
        channels[:, start:end] - np.median(channels[:, start:end], axis=1, keepdims=True)
        for start, end in zip(starts, ends, strict=True)
    ]
    if force is None and not whole:  # what rings after the last of several strokes is a free decay
        hits = [hit[:, _second_stroke(hit, recording.rate) :] for hit in hits]
    return hits


def _second_stroke(hit: Array, rate: float) -> int:
    """The sample of a second stroke within a hit (channels, n), 0 where there is none.

    High frequencies, by differences, decay from a stroke on: a block of 2 ms far above the 10 ms before it.
    """
    size = max(int(_BLOCK * rate), 2)
    steps = np.abs(np.diff(hit, n=2, axis=1)).max(axis=0)
    blocks = steps[: len(steps) // size * size].reshape(-1, size)
    rms = np.sqrt(np.mean(blocks**2, axis=1))
    first = int(np.argmax(rms > _OF_STROKE * rms.max(initial=0.0))) if len(rms) else 0
    for k in range(len(rms) - 1, first + _BLOCKS_APART, -1):
        before = rms[k - _BLOCKS_APART : k].max()
        if rms[k] > _OF_STROKE * rms.max() and rms[k] > _JUMP * before:
            return k * size
    return 0


# A file of this size takes some seconds and less than 1 GiB.
_MOST_BYTES: Final = 50_000_000
_MOST_LINES, _MOST_COLUMNS = 200_000, 2_000
_MOST_SAMPLES: Final = 25_000_000
_UNIVERSAL, _TABLES, _WAVES = (".unv", ".uff", ".unf"), (".csv", ".txt", ".tsv", ".dat"), (".wav",)
_ACCEPTED: Final = (
    "frequency responses (a universal file with datasets 58, .unv or .uff; a table, .csv or .txt) or "
    "recorded hits (.wav)"
)
# Of a dataset 58: the type of a frequency response function.
_FRF: Final = 4
_HEAD = re.compile(r"^(hz|khz|frequency|freq|f|re|real|im|imag|imaginary|mag|magnitude|abs|phase)\b")
_EVEN: Final = 1e-3
# The largest value of a response or a record: what is beyond leaves the range of squares and their sums.
_LEAST_SIZE, _MOST_SIZE = 1e-60, 1e60
_LEAST_HZ, _MOST_HZ = 1e-3, 1e9


def read_responses(
    files: Sequence[str],
    *,
    force: int | None,
    response: Sequence[int],
    window: Window | None,
    high: float | None,
) -> FrequencyResponses:
    """The frequency responses of files of one format; a folder is all recordings in it.

    force, response : channels of a .wav file, from 1; without them a channel that is a pulse is the force
    window : what records are multiplied by, nothing unless given
    high : Hz, end of the range of recorded hits

    Raises ``ModalTestError`` for what cannot be read, with the file.
    """
    files = [path for name in files for path in of_folder(name)]
    endings = {Path(name).suffix.casefold() for name in files}
    if endings <= set(_WAVES):
        recordings, notices = _recordings(files, force, response)
        if len({one.rate for one in recordings}) > 1:
            raise ModalTestError("files of several sampling rates, accepted: one")
        if len({(one.force is None, len(one.responses)) for one in recordings}) > 1:
            raise ModalTestError("files of different channels, accepted: the same in all; say --response")
        found = responses_of_hits(recordings, window or "none", high)
        return replace(found, notices=(*notices, *found.notices))
    if force is not None or response or window is not None:
        raise ModalTestError("--force, --response and --window: accepted: with .wav files only")
    of_files = [_universal(n) if Path(n).suffix.casefold() in _UNIVERSAL else _table(n) for n in files]
    first = of_files[0]
    if any(not np.array_equal(one.frequencies, first.frequencies) for one in of_files):
        raise ModalTestError("files with different lines of frequency, accepted: the same in all")
    origins = list(dict.fromkeys(one.origin for one in of_files))
    frf = np.vstack([one.frf for one in of_files])
    return FrequencyResponses(first.frequencies, frf, 0.0, 0.0, "; ".join(origins))


def of_folder(name: str) -> list[str]:
    """The recordings of a folder in the order of their names, or the file itself."""
    if not Path(name).is_dir():
        return [name]
    found = sorted(str(path) for path in Path(name).iterdir() if path.suffix.casefold() in _WAVES)
    if not found:
        raise ModalTestError(f"{name}: no recordings in this folder, accepted: .wav files")
    return found


def _recordings(
    files: Sequence[str], force: int | None, response: Sequence[int]
) -> tuple[list[Recording], tuple[Notice, ...]]:
    """Files that are not clipped, with the names of those that are; ``ClippedError`` where all are."""
    recordings, clipped = [], []
    for name in files:
        try:
            recordings.append(_recording(name, force, response))
        except ClippedError as error:
            clipped.append((Path(name).name, error))
    if not recordings:
        raise clipped[0][1]
    names = tuple(name for name, _ in clipped)
    return recordings, (Notice("clipped_files", facts={"files": names}),) if names else ()


def _content(name: str) -> bytes:
    if Path(name).suffix.casefold() not in (*_UNIVERSAL, *_TABLES, *_WAVES):
        raise ModalTestError(f"{name}: unknown ending, accepted: {_ACCEPTED}")
    try:
        return read_regular_file(name, name, _ACCEPTED, _MOST_BYTES)
    except FileNotFoundError:
        raise ModalTestError(f"{name}: no such file, accepted: {_ACCEPTED}") from None
    except PlateFileError as error:
        raise ModalTestError(str(error)) from None


def _universal(name: str) -> FrequencyResponses:
    """The frequency responses of datasets 58, ASCII or binary."""
    try:
        sets = read_sets(_content(name), (58,))
    except UniversalFileError as error:
        raise ModalTestError(f"{name}: {error}") from None
    frf = [one for one in sets if one.get("func_type") == _FRF and np.iscomplexobj(one["data"])]
    if not frf:
        raise ModalTestError(f"{name}: no frequency response functions, accepted: datasets 58 of type 4")
    x = np.asarray(frf[0]["x"], dtype=float)
    if any(not np.array_equal(one["x"], x) for one in frf):
        raise ModalTestError(f"{name}: datasets 58 with different lines, accepted: the same in all")
    if any(len(one["data"]) != len(x) for one in frf):
        raise ModalTestError(f"{name}: a dataset 58 that ends within a line, accepted: whole files")
    return _checked(name, x, np.stack([one["data"] for one in frf]), f"dataset 58, {len(frf)} responses")


def _table(name: str) -> FrequencyResponses:
    """A frequency in each row, and a pair of columns a response: re and im, or magnitude and phase."""
    text = decode(_content(name))
    n_lines = text.count("\n") + text.count("\r")
    if n_lines > 2 * _MOST_LINES:  # two characters may end a line
        raise ModalTestError(f"{name}: received {n_lines} lines, accepted: {_MOST_LINES} at most")

    def is_header(heads: Sequence[str]) -> bool:
        return len(heads) <= _MOST_COLUMNS and len(_columns(heads)) > 2

    found = read_delimited(text, is_header)
    columns = [] if found is None else _columns(found.heads)
    kinds = [kind for kind, _, _ in columns]
    if found is None or kinds[0] != "f" or len(kinds) % 2 == 0 or set(kinds[1::2]) - {"re", "mag"}:
        raise ModalTestError(
            f"{name}: no table of responses, accepted: a line of heads with hz and then re and im, or "
            "magnitude and phase [deg], of each response"
        )
    rows = []
    for row in found.rows:
        try:
            cells = [row.cells[i] for _, _, i in columns]
            rows.append([float(c if found.separator == "," else c.replace(",", ".")) for c in cells])
        except (ValueError, IndexError):
            raise ModalTestError(f"{name}:{row.line}: not a row of {len(columns)} numbers") from None
    if not rows:
        raise ModalTestError(f"{name}: no rows below the heads, accepted: a row for each line of frequency")
    values = np.array(rows).T
    frf = []
    for k in range(1, len(columns), 2):
        (kind, unit, _), (_, angle, _) = columns[k], columns[k + 1]
        first, second = values[k], values[k + 1]
        if kind == "mag":
            _require_units(name, unit, angle, first, second)
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                size = 10.0 ** (first / 20.0) if "db" in unit else first
                turn = second if "rad" in angle else np.radians(second)
                first, second = size * np.cos(turn), size * np.sin(turn)
        response = first.astype(complex)
        response.imag = second
        frf.append(response)
    scale = 1e3 if "khz" in columns[0][1] else 1.0
    return _checked(name, scale * values[0], np.array(frf), f"table, {len(frf)} responses")


def _require_units(name: str, unit: str, angle: str, magnitude: Array, phase: Array) -> None:
    """Raise ``ModalTestError`` where magnitude or phase cannot be in the unit that their heads say."""
    if "db" not in unit and np.any(magnitude < 0.0):
        raise ModalTestError(
            f"{name}: magnitudes below 0, down to {np.nanmin(magnitude):g}, accepted: 0 or above; of values "
            "in dB the head says [dB]"
        )
    most = np.nanmax(np.abs(phase), initial=0.0)
    if "deg" not in angle and "rad" not in angle and most <= 2.0 * np.pi:
        raise ModalTestError(
            f"{name}: phases up to {most:.3g} of no unit, accepted: phase [rad], or phase [deg]"
        )


def _columns(heads: Sequence[str]) -> list[tuple[str, str, int]]:
    """Kind, whole head and place of the columns that are read."""
    short = {
        "hz": "f",
        "khz": "f",
        "frequency": "f",
        "freq": "f",
        "real": "re",
        "imag": "im",
        "imaginary": "im",
    }
    short |= {"magnitude": "mag", "abs": "mag"}
    found = []
    for i, head in enumerate(heads):
        match = _HEAD.match(re.sub(r"[_\d]", " ", head.casefold()).strip())
        if match:
            found.append((short.get(match[1], match[1]), head.casefold(), i))
    return found


def _checked(name: str, frequencies: Array, frf: Array, origin: str) -> FrequencyResponses:
    highest = np.max(np.abs(frequencies), initial=0.0)
    if not _LEAST_HZ <= highest <= _MOST_HZ:
        raise ModalTestError(
            f"{name}: lines of frequency up to {highest:g} Hz, accepted: {_LEAST_HZ:g} to {_MOST_HZ:g} Hz"
        )
    steps = np.diff(frequencies)
    even = len(steps) > 0 and np.all(steps > 0.0) and np.ptp(steps) <= _EVEN * steps.mean() * len(steps)
    if not even or frequencies[0] < 0.0:
        raise ModalTestError(f"{name}: lines that do not ascend by equal steps, accepted: equal steps in Hz")
    missing = np.flatnonzero(~np.all(np.isfinite(frf), axis=0))
    if missing.any():  # analysers write no number at 0 Hz
        raise ModalTestError(
            f"{name}: no number at {frequencies[missing[-1]]:g} Hz, accepted: one at each line"
        )
    frf = np.where(np.isfinite(frf), frf, 0.0)
    for number, size in enumerate(np.max(np.abs(frf), axis=1), 1):
        if not _LEAST_SIZE < size < _MOST_SIZE:
            what = f"whose largest value is {size:.3g}" if size else "that is zero at all lines"
            raise ModalTestError(
                f"{name}: response {number} {what}, accepted: {_LEAST_SIZE:g} to {_MOST_SIZE:g}"
            )
    return FrequencyResponses(frequencies, frf, 0.0, 0.0, origin)


def _told(channels: Array, force: int | None) -> tuple[int | None, tuple[int, ...]]:
    """The channels of the force and of the responses: one channel that lasts a pulse is the force."""
    if force is None and len(channels) > 1:
        power = (channels - np.median(channels, axis=1, keepdims=True).astype(float)) ** 2
        samples = np.sum(power, axis=1) ** 2 / np.maximum(np.sum(power**2, axis=1), np.finfo(float).tiny)
        shortest, second = np.argsort(samples)[:2]
        if 0.0 < _SHORTER * samples[shortest] < samples[second]:  # 0 of a channel without a signal
            force = int(shortest) + 1
    return force, tuple(k for k in range(1, len(channels) + 1) if k != force)


def _recording(name: str, force: int | None, response: Sequence[int]) -> Recording:
    content = _content(name)
    try:
        # scipy warns of what it passes over, and of a length that a recorder never filled in
        with warnings.catch_warnings(action="ignore"):
            rate, samples = wavfile.read(io.BytesIO(content))
    except Exception as error:  # noqa: BLE001 - scipy raises what comes, of a head with zeros for instance
        raise ModalTestError(f"{name}: not a .wav file that can be read: {error}") from None
    channels = np.atleast_2d(samples.T)
    if not channels.size or not rate > 0:
        raise ModalTestError(f"{name}: {channels.size} samples, {rate} a second, accepted: above 0")
    if not response:
        force, response = _told(channels, force)
    wanted = (*(() if force is None else (force,)), *response)
    for channel in wanted:
        if not 1 <= channel <= len(channels):
            raise ModalTestError(f"{name}: no channel {channel}, accepted: 1 to {len(channels)}")
    if len(wanted) * channels.shape[1] > _MOST_SAMPLES:
        raise ModalTestError(
            f"{name}: received {len(wanted)} channels of {channels.shape[1]} samples, accepted: "
            f"{_MOST_SAMPLES} samples at most; several files are one test"
        )
    if force is not None and force in response:
        raise ModalTestError(
            f"--force and --response: received {force} for both, accepted: different channels"
        )
    with np.errstate(invalid="ignore"):  # of floats that are no numbers
        signals = channels[[channel - 1 for channel in wanted]].astype(float)
    if not np.all(np.abs(signals) < _MOST_SIZE):
        raise ModalTestError(f"{name}: samples that are no numbers, accepted: numbers up to {_MOST_SIZE:g}")
    for channel in wanted:
        require_unclipped(name, channel, channels[channel - 1])
    if force is None:
        return Recording(float(rate), None, signals)
    return Recording(float(rate), signals[0], signals[1:])
