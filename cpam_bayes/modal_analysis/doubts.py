"""What makes recorded hits and responses useless, or doubtful."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import significant
from cpam_bayes.modal_analysis.records import ModalTestError

__all__ = [
    "hum_remarks",
    "last_line_of_modes",
    "peaks_of",
    "relative_power",
    "require_force_of_a_hit",
    "require_unclipped",
]

Array = NDArray[Any]

# A clipped channel holds its largest value for so many samples: once at full scale, else at several places.
_HELD, _PLACES = 3, 3
# A force that passes this fraction of its peak later than so many s, for so many s in all, is no hit's.
_RINGS, _AFTER, _FOR = 0.2, 0.02, 0.01
_BLOCK: Final = 0.002
# Mains frequencies, Hz; the end of a record, as a fraction, and the least part of its power, and of the
# largest value, that a steady tone has there.
_MAINS: Final = (50.0, 60.0)
_TAIL, _OF_POWER, _OF_PEAK = 0.25, 0.5, 0.03
_LEAST_TAIL: Final = 0.2
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
        raise ModalTestError(
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


def hum_remarks(rate: float, channels: Array) -> tuple[str, ...]:
    """A steady tone of the mains or its double at the end of a record (channels, n), where modes are gone."""
    tail = channels[:, int((1.0 - _TAIL) * channels.shape[1]) :]
    n = tail.shape[1]
    if n < _LEAST_TAIL * rate:
        return ()
    tail = tail - tail.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(tail * np.hanning(n), axis=1)) ** 2
    frequencies = np.fft.rfftfreq(n, 1.0 / rate)
    peak = np.abs(channels - np.median(channels, axis=1, keepdims=True)).max(axis=1)
    loud = np.sqrt(np.mean(tail**2, axis=1)) > _OF_PEAK * peak
    for mains in _MAINS:
        near = (
            np.min(np.abs(frequencies[:, None] - mains * np.array([1.0, 2.0])), axis=1) < 2.5 * rate / n + 0.5
        )
        part = power[:, near].sum(axis=1) / np.maximum(power.sum(axis=1), np.finfo(float).tiny)
        hums = loud & (part > _OF_POWER)
        if hums.any():
            size = float(np.max(np.sqrt(2.0 * part[hums] * np.mean(tail[hums] ** 2, axis=1)) / peak[hums]))
            return (
                f"the record ends in a steady tone of the mains, {mains:g} or {2 * mains:g} Hz, of "
                f"{significant(100.0 * size, 2)} % of its largest value: hits and weak modes drown in it; "
                "earth the sensor, keep cables away from mains, or use a battery",
            )
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
