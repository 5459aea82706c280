"""Frequency responses of recorded hits.

Each hit is cut out of its record; without a force, a double hit begins at its last stroke. Records that
cannot be of a hit, such as a clipped channel, are refused; doubts about responses are notices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from cpam_bayes.answer import Notice, each_once

Array = NDArray[Any]


class ModalTestError(ValueError):
    """A test that cannot be read or analysed."""


class ClippedError(ModalTestError):
    """A clipped record."""


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponses:
    """Frequency responses at equal steps of frequency.

    frequencies : (n,) Hz
    frf : (n_responses, n) complex, response over force, or the spectrum of a free decay
    added_decay : rad/s that a window adds to the decay of every mode
    origin : the format and what was read, in words
    notices : what makes them doubtful
    hit : (n_responses,) number of the hit of each, from 0; empty where all are of one
    struck_twice : (n_hits,) of recorded hits, whether the hammer touched the plate twice
    force_noise : (n_responses, n) variance of frf due to noise of the force, over |frf|^2; None for none
    """

    frequencies: Array
    frf: Array
    added_decay: float
    origin: str
    notices: tuple[Notice, ...] = ()
    hit: tuple[int, ...] = ()
    struck_twice: tuple[bool, ...] = ()
    force_noise: Array | None = None

    def __post_init__(self) -> None:
        for name in ("frequencies", "frf"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def step(self) -> float:
        """Frequency step between lines, Hz."""
        return float(self.frequencies[1] - self.frequencies[0])

    @property
    def each_hit(self) -> tuple[FrequencyResponses, ...]:
        """The responses of each hit."""
        numbers = np.array(self.hit)
        if len(set(self.hit)) < 2:
            return (self,)
        noise = self.force_noise
        return tuple(
            replace(
                self,
                frf=self.frf[numbers == k],
                hit=(),
                force_noise=None if noise is None else noise[numbers == k],
            )
            for k in sorted(set(self.hit))
        )


# A clipped channel holds its largest value for this many samples: once at full scale, else at these places.
_HELD, _PLACES = 3, 3
# A force above this fraction of its peak later than this, s, and for this long in all, s, is not a hit's.
_RINGS, _AFTER, _FOR = 0.2, 0.02, 0.01
_BLOCK: Final = 0.002
# The power of a force is in this many times fewer samples than that of the responses.
_SHORTER: Final = 5.0
# A further stroke is this many times the loudest of this many blocks before it, and this fraction of the
# loudest of all; samples of a block, at least.
_JUMP, _BLOCKS_APART, _OF_STROKE, _LEAST_BLOCK = 3.0, 5, 0.1, 8
# Order of the linear prediction, and the least fraction of noise in a signal.
_PREDICTED_FROM, _ROUNDING = 40, 1e-9
MAINS: Final = (50.0, 60.0)
"""Frequencies of the mains, Hz."""
# The tail of a record, as a fraction, and the least fraction of its power, and of the largest value, that a
# steady tone has there.
_TAIL, _OF_POWER, _OF_PEAK = 0.25, 0.5, 0.03
_LEAST_TAIL: Final = 0.2
_MULTIPLES: Final = np.arange(1.0, 6.0)
# Tolerance of the mains frequency, Hz, and steps within it; end of a tail that shows whether a tone is
# steady, s; fraction of its power that hum has before a hit, where this much of that is recorded, s.
_OF_MAINS, _STEPS, _TOLD_BY, _STOOD, _SOONER = 0.2, 9, 1.0, 0.25, 0.01
# Lines of modes are above this multiple of the noise, the median, and this fraction of the largest, in power.
_ABOVE_NOISE, _ABOVE_LEAST = 100.0, 1e-5
# A peak is the largest line within this fraction of its frequency, or this many lines, above this multiple of
# the median of a neighbourhood four times as wide, and above this fraction of the largest one.
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
    """Notice of mains hum, a steady tone in the tail of a record (channels, n), where modes have decayed.

    A mode near a multiple of the mains that still rings there, as after a late second stroke, decays, has a
    frequency of its own and was silent before the hit.
    """
    tail = channels[:, int((1.0 - _TAIL) * channels.shape[1]) :]
    n = tail.shape[1]
    if n < _LEAST_TAIL * rate:
        return ()
    tail = tail - tail.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(tail * np.hanning(n), axis=1)) ** 2
    frequencies = np.fft.rfftfreq(n, 1.0 / rate)
    centred = np.abs(channels - np.median(channels, axis=1, keepdims=True))
    peak = centred.max(axis=1)
    loud = np.sqrt(np.mean(tail**2, axis=1)) > _OF_PEAK * peak
    for mains in MAINS:
        near = np.min(np.abs(frequencies[:, None] - mains * _MULTIPLES), axis=1) < 2.5 * rate / n + 0.5
        part = power[:, near].sum(axis=1) / np.maximum(power.sum(axis=1), np.finfo(float).tiny)
        tone = part * np.mean(tail**2, axis=1)
        hums = np.array(
            [
                of_mains and _is_steady(end, rate, mains, share) and _was_there(before, rate, its)
                for of_mains, end, share, before, its in zip(
                    loud & (part > _OF_POWER), tail, part, centred, tone, strict=True
                )
            ]
        )
        if hums.any():
            size = float(np.max(np.sqrt(2.0 * tone[hums]) / peak[hums]))
            return (Notice("hum", facts={"mains": mains, "size": size}),)
    return ()


def _is_steady(tail: Array, rate: float, mains: float, part: float) -> bool:
    """Whether tones of the first half of a tail (n,) continue in its second half.

    They are at multiples of the mains frequency that fits the tail best; part : fraction of the power of the
    tail near these multiples, half of which they must predict
    """
    end = tail[-int(_TOLD_BY * rate) :]
    multiples = _MULTIPLES[_MULTIPLES * (mains + _OF_MAINS) < 0.5 * rate]
    t, half = np.arange(len(end)) / rate, len(end) // 2

    def left(base: float, known: int) -> Array:
        """Residuals of all samples from tones fitted to the first ``known``."""
        angles = 2.0 * np.pi * base * multiples * t[:, None]
        tones = np.hstack((np.cos(angles), np.sin(angles)))
        return np.asarray(end - tones @ np.linalg.lstsq(tones[:known], end[:known], rcond=None)[0])

    bases = mains + np.linspace(-_OF_MAINS, _OF_MAINS, _STEPS)
    base = min(bases, key=lambda one: float(np.sum(left(one, len(end)) ** 2)))
    missed = np.sum(left(base, half)[half:] ** 2) / np.sum(end[half:] ** 2)
    return bool(1.0 - missed > 0.5 * part)


def _was_there(size: Array, rate: float, power: float) -> bool:
    """Whether |samples| (n,) before the hit have a fraction of a tone's power; True where there are none."""
    onset = int(np.argmax(size > _ONSET * size.max()))
    before = size[: max(onset - int(_BEFORE * rate), 0)]
    return len(before) < _SOONER * rate or bool(np.mean(before**2) > _STOOD * power)


def relative_power(frf: Array) -> Array:
    """Power of the lines, relative to the mean of each response, averaged over the responses (m, n), (n,)."""
    power = np.abs(frf) ** 2
    mean = np.maximum(np.mean(power, axis=1, keepdims=True), np.finfo(float).tiny)
    return np.asarray(np.mean(power / mean, axis=0))


def last_line_of_modes(power: Array) -> int:
    """Index of the last line above the noise, of the last of all where none is; power : (n,)."""
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
"""Windows of a record: none, or a decay to 1 % at its end, which is subtracted from the damping."""
_END: Final = 0.01
# The signal passes this fraction of its largest value, for the first time in this many s; the hit begins
# this many s before.
_ONSET, _APART, _BEFORE = 0.3, 0.25, 0.002
# Hits shorter than this fraction of the usual length are left out.
_LONG_ENOUGH: Final = 0.5
# The range of a test ends where the spectrum of the force has fallen to this fraction of its largest value.
_FORCE_LEFT: Final = 0.1
# Spectra of decays end at this multiple of their last line above the noise.
_OUTSIDE: Final = 1.25
_LEAST_LINES: Final = 50
# Least lines of a range that is found from the responses: above twice the poles of the default order.
_LEAST_FOUND: Final = 150
_MOST_HITS: Final = 1000
# Standard deviation of Gaussian noise over the median of its absolute values.
_SD_OF_MEDIAN: Final = 1.4826
# A force lasts while it is above this fraction of its largest value.
_OF_PULSE: Final = 0.1
# This many lines from 0 Hz are drift; noise lasts longer than this, s, unlike the pulse of a force, whose
# spectrum is as flat.
_DRIFT_LINES, _LASTING = 5, 0.05
# A tone beyond the range with this share of a response's power is not of a plate, which has many modes.
_RINGING: Final = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Signals of one file.

    rate : samples a second
    force : (n,) or None where it was not recorded
    responses : (n_responses, n)
    numbers : of the channels in the file, from 1, the force first
    name : of the file
    """

    rate: float
    force: Array | None
    responses: Array
    numbers: tuple[int, ...]
    name: str


class _Hit(NamedTuple):
    """A hit: channels (1 + n_responses, n), or (n_responses, n) without force; whether double.

    start : in its file, s. usual : median length of the hits from one clear onset to the next, weighted by
    length, samples
    """

    channels: Array
    is_double: bool
    file: str
    start: float
    usual: int


def responses_of_hits(
    recordings: Sequence[Recording], window: Window, high: float | None
) -> FrequencyResponses:
    """Responses over force of every hit, H = conj(F) X / |F|^2; without force, spectra of decays.

    Each hit begins where its force, or its largest response, rises. All hits are cut to the length of the
    shortest, after those of less than half the usual length are left out.
    Spectra end at ``high``, Hz, or where the force has fallen to a tenth, or a quarter above the last line of
    a decay that stands above its noise.

    Raises ``ModalTestError`` where there is no hit, hits are too short, or the force is not of a hit.
    """
    cut = [hit for one in recordings for hit in _hits(one)]
    if not cut:
        raise ModalTestError("no hit, accepted: a record in which force or response rises above its noise")
    rate, least = recordings[0].rate, _LONG_ENOUGH * np.median([hit.usual for hit in cut])
    every = [hit for hit in cut if hit.channels.shape[1] >= least]
    hits, twice = [hit.channels for hit in every], tuple(hit.is_double for hit in every)
    n = min(len(hit[0]) for hit in hits)
    decay = -np.log(_END) * rate / n if window == "exponential" else 0.0
    weight = np.exp(-decay * np.arange(n) / rate)
    has_force = recordings[0].force is not None
    spectra = np.stack([np.fft.rfft(hit[:, :n] * weight, axis=1) for hit in hits])  # hits, channels, lines
    frequencies = np.fft.rfftfreq(n, 1.0 / rate)
    notices = (*_hums(recordings), *_too_short(cut, rate, least))
    if any(twice):
        numbers = tuple(number for number, is_double in enumerate(twice, 1) if is_double)
        notices += (Notice("double_hits", facts={"hits": numbers, "of": len(hits)}),)
    if has_force:
        require_force_of_a_hit(hits, rate, _BEFORE)
        force, response = spectra[:, :1], spectra[:, 1:]
        power = np.sum(np.abs(force) ** 2, axis=0)
        each = np.maximum(np.abs(force) ** 2, np.finfo(float).tiny)
        frf = (force.conj() * response / each).reshape(-1, len(frequencies))
        force_noise = np.repeat(_force_noise(hits, force[:, 0], n), response.shape[1], axis=0)
        fallen = np.flatnonzero(power[0] < _FORCE_LEFT**2 * power[0].max())
        fallen = fallen[fallen > np.argmax(power[0])]  # an AC coupling leaves little at 0 Hz
        end = int(fallen[0]) if high is None and len(fallen) else len(frequencies)
    else:
        frf = spectra.reshape(-1, len(frequencies))
        force_noise = np.zeros(frf.shape)
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
    notices += _ringing(recordings[0], hits, float(frequencies[end - 1]))
    many = "1 hit" if len(hits) == 1 else f"{len(hits)} hits"
    return FrequencyResponses(
        frequencies[:end],
        frf[:, :end],
        decay,
        f"{many} of {n / rate:.3g} s, {_channels(recordings[0], hits[0])}; window: {window}",
        notices,
        tuple(np.repeat(np.arange(len(hits)), recordings[0].responses.shape[0]).tolist()),
        twice,
        force_noise[:, :end],
    )


def _force_noise(hits: Sequence[Array], force: Array, n: int) -> Array:
    """Relative variance of each hit's force due to noise, (n_hits, n_lines); force : its spectra.

    The median of a force is that of its noise, as the hammer touches the plate only briefly.
    """
    sd = _SD_OF_MEDIAN * np.array([np.median(np.abs(hit[0, :n])) for hit in hits])
    return np.asarray(n * sd[:, None] ** 2 / np.maximum(np.abs(force) ** 2, np.finfo(float).tiny))


def _channels(recording: Recording, hit: Array) -> str:
    """Description of the channels of a file."""
    n = len(recording.responses)
    said = "1 response" if n == 1 else f"{n} responses"
    if recording.force is None:
        numbers = ", ".join(map(str, recording.numbers))
        return f"{said} alone: free decays (channel{'' if n == 1 else 's'} {numbers})"
    size = np.abs(hit[0])
    pulse = 1e3 * float(np.sum(size > _OF_PULSE * size.max())) / recording.rate
    return f"{said} over force (channel {recording.numbers[0]}, a pulse of {pulse:.2g} ms)"


def without_silent(recordings: Sequence[Recording]) -> tuple[list[Recording], tuple[Notice, ...]]:
    """Recordings of the same channels without the responses that have no line above the noise.

    All responses are kept where none of them has such a line.
    """
    silent = np.all([_are_silent(one.responses, one.rate) for one in recordings], axis=0)
    if not silent.any():
        return list(recordings), ()
    first = recordings[0]
    n_forces = len(first.numbers) - len(first.responses)
    numbers = np.array(first.numbers[n_forces:])
    notice = Notice("silent_channels", facts={"channels": tuple(numbers[silent].tolist())})
    if silent.all():
        return list(recordings), (notice,)
    left = (*first.numbers[:n_forces], *numbers[~silent].tolist())
    return [replace(one, responses=one.responses[~silent], numbers=left) for one in recordings], (notice,)


def _ringing(recording: Recording, hits: Sequence[Array], end: float) -> tuple[Notice, ...]:
    """Notice of a ringing sensor: a response with nearly all power in one narrow tone beyond the range.

    hits : of all recordings; end : of the range, Hz
    """
    n_forces = len(recording.numbers) - len(recording.responses)
    for row, number in enumerate(recording.numbers[n_forces:], n_forces):
        power = np.mean([np.abs(np.fft.rfft(hit[row], len(hits[0][row]))) ** 2 for hit in hits], axis=0)
        f = np.fft.rfftfreq(len(hits[0][row]), 1.0 / recording.rate)
        at = f[int(np.argmax(power))]
        share = float(power[np.abs(f - at) < _ALONE * at].sum() / max(power.sum(), np.finfo(float).tiny))
        if at > end and share > _RINGING:
            return (
                Notice("ringing_sensor", facts={"channel": number, "frequency": float(at), "share": share}),
            )
    return ()


def _hums(recordings: Sequence[Recording]) -> tuple[Notice, ...]:
    return each_once(notice for one in recordings for notice in hum_notices(one.rate, one.responses))


def _too_short(cut: Sequence[_Hit], rate: float, least: float) -> tuple[Notice, ...]:
    """Notice of the hits left out, of fewer samples than ``least``: file, start and length, s."""
    short = [
        (hit.file, hit.start, hit.channels.shape[1] / rate) for hit in cut if hit.channels.shape[1] < least
    ]
    return (Notice("short_hits", facts={"short": tuple(sorted(short))}),) if short else ()


def _hits(recording: Recording) -> list[_Hit]:
    """The channels from each hit to the next; without force, those of a double hit from its last stroke on.

    Between two strokes the plate decays freely, whatever rang before, so that without a force each stroke is
    a hit of its own, unless the second follows soon and has the longer decay.
    """
    force, responses = recording.force, recording.responses
    channels = responses if force is None else np.vstack((force, responses))
    channels = channels - np.median(channels, axis=1, keepdims=True)
    trigger = np.abs(channels if force is None else channels[:1]).max(axis=0)
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
    hits = []
    for start, end in zip(starts, ends, strict=True):
        hit = channels[:, start:end] - np.median(channels[:, start:end], axis=1, keepdims=True)
        strokes = _further_strokes(hit if force is None else hit[:1], recording.rate)
        if force is not None:
            hits.append(_Hit(hit, bool(strokes), recording.name, start / recording.rate, hit.shape[1]))
            continue
        parts = [(0, False)]  # where decays begin, and whether of a double hit
        for stroke, following in pairwise((*strokes, hit.shape[1])):
            is_double = stroke - parts[-1][0] < min(_APART * recording.rate, following - stroke)
            parts[-1 if is_double else len(parts) :] = [(stroke, is_double)]
        bounds = [*(begin for begin, _ in parts), hit.shape[1]]
        lengths = np.sort(np.diff(bounds))
        usual = int(lengths[np.searchsorted(np.cumsum(lengths), 0.5 * lengths.sum())])
        hits += [
            _Hit(hit[:, begin:until], is_double, recording.name, float(start + begin) / recording.rate, usual)
            for (begin, is_double), until in zip(parts, bounds[1:], strict=True)
        ]
    return hits


def _further_strokes(hit: Array, rate: float) -> list[int]:
    """The samples of further strokes within a hit (channels, n), ascending.

    A free decay can be predicted from earlier samples, a stroke cannot: it is a block of 2 ms in which the
    errors of linear prediction are far above those of the 10 ms before it.
    """
    size = max(int(_BLOCK * rate), _LEAST_BLOCK)
    errors = np.abs([_prediction_errors(channel) for channel in hit]).max(axis=0)
    blocks = errors[: len(errors) // size * size].reshape(-1, size)
    rms = np.sqrt(np.mean(blocks**2, axis=1))
    first = int(np.argmax(rms > _OF_STROKE * rms.max(initial=0.0))) if len(rms) else 0
    return [
        k * size
        for k in range(first + _BLOCKS_APART + 1, len(rms))
        if rms[k] > max(_OF_STROKE * rms.max(), _JUMP * rms[k - _BLOCKS_APART : k].max())
    ]


def _prediction_errors(signal: Array) -> Array:
    """Errors of the best linear prediction of a signal from its earlier samples, (n,) each."""
    n, order = len(signal), min(_PREDICTED_FROM, len(signal) // 4)
    power = np.abs(np.fft.rfft(signal, 2 * n)) ** 2
    correlation = np.fft.irfft(power)[: order + 1]
    if not correlation[0] > 0.0:
        return np.zeros(n)
    correlation[0] *= 1.0 + _ROUNDING
    weights = solve_toeplitz(correlation[:-1], correlation[1:])
    return np.asarray(lfilter(np.append(1.0, -weights), np.ones(1), signal))


def told_channels(channels: Array, rate: float, force: int | None) -> tuple[int | None, tuple[int, ...]]:
    """Channels of the force and of the responses; by default a single channel with a pulse is the force."""
    if force is None and len(channels) > 1:
        lasts = np.where(_are_silent(channels, rate), np.inf, _lasting(channels))
        shortest, second = np.argsort(lasts)[:2]
        if _SHORTER * lasts[shortest] < lasts[second] < np.inf:
            force = int(shortest) + 1
    return force, tuple(k for k in range(1, len(channels) + 1) if k != force)


def _lasting(channels: Array) -> Array:
    """Effective number of samples that hold a channel's power, (n_channels,), 0 for a constant."""
    power = (channels - np.median(channels, axis=1, keepdims=True).astype(float)) ** 2
    return np.asarray(np.sum(power, axis=1) ** 2 / np.maximum(np.sum(power**2, axis=1), np.finfo(float).tiny))


def _are_silent(channels: Array, rate: float) -> Array:
    """True for channels that are constant, or are not pulses and have no line above noise, (n_channels,)."""
    lasts = _lasting(channels)
    power = np.abs(np.fft.rfft(channels, axis=1)[:, _DRIFT_LINES:]) ** 2
    noise = np.median(power, axis=1, keepdims=True) if power.size else power  # a record of a few samples
    stands = np.any(power > _ABOVE_NOISE * noise, axis=1)
    return np.asarray((lasts == 0.0) | (~stands & (lasts > _LASTING * rate)))
