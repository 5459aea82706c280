"""From recorded hits to frequency responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.modal_analysis.doubts import (
    hum_remarks,
    last_line_of_modes,
    relative_power,
    require_force_of_a_hit,
)
from cpam_bayes.modal_analysis.records import FrequencyResponses, ModalTestError

__all__ = ["WINDOWS", "Recording", "Window", "responses_of_hits"]

Array = NDArray[Any]
Window = Literal["none", "exponential"]

WINDOWS: Final[tuple[Window, ...]] = ("none", "exponential")
"""What records are multiplied by: nothing, or a decay to 1 % at their ends, which is taken off again."""
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
    """Responses over force of all hits, H_1 = sum conj(F) X / sum |F|^2; without it, spectra of decays.

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
    has_force, remarks = recordings[0].force is not None, _hums(recordings)
    if has_force:
        require_force_of_a_hit(hits, rate, _BEFORE)
        force, response = spectra[:, :1], spectra[:, 1:]
        power = np.sum(np.abs(force) ** 2, axis=0)
        frf = np.sum(force.conj() * response, axis=0) / np.maximum(power, np.finfo(float).tiny)
        fallen = np.flatnonzero(power[0] < _FORCE_LEFT**2 * power[0].max())
        end = int(fallen[0]) if high is None and len(fallen) else len(frequencies)
    else:
        frf = spectra.reshape(-1, len(frequencies))
        last = last_line_of_modes(relative_power(frf))
        if high is not None and frequencies[last] > high:
            remarks += (
                f"responses stand above their noise up to {frequencies[last]:.4g} Hz, beyond the range: "
                "modes there are not looked for",
            )
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
        remarks,
    )


def _hums(recordings: Sequence[Recording]) -> tuple[str, ...]:
    said = (remark for one in recordings for remark in hum_remarks(one.rate, one.responses))
    return tuple(dict.fromkeys(said))


def _hits(recording: Recording) -> list[Array]:
    """The channels (1 + n_responses, n), or (n_responses, n) without force, from each hit to the next."""
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
    return [
        channels[:, start:end] - np.median(channels[:, start:end], axis=1, keepdims=True)
        for start, end in zip(starts, ends, strict=True)
    ]
