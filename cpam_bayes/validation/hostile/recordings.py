"""Recorded hits that no recorder writes."""

from __future__ import annotations

import io
import struct
from typing import Final

import numpy as np
from hypothesis import strategies as st
from scipy.io import wavfile

__all__ = ["recordings"]

_RATE: Final = 2000


def _good(kind: type[np.generic], scale: float) -> bytes:
    """Force and response of one hit, 0.3 s."""
    t = np.arange(600) / _RATE
    signals = np.stack((np.exp(-2e6 * (t - 0.01) ** 2), np.exp(-20.0 * t) * np.sin(950.0 * t)), axis=1)
    file = io.BytesIO()
    wavfile.write(file, _RATE, (scale * signals).astype(kind))
    return file.getvalue()


_FILES: Final = (_good(np.int16, 3e4), _good(np.float32, 1.0), _good(np.int32, 2e9))
# Fields of the head and their formats: sizes, codec, channels, rate, bytes a second and a frame, bits.
_FIELDS: Final = tuple(
    (place, "<I" if place in (4, 16, 24, 28, 40) else "<H") for place in (4, 16, 20, 22, 24, 28, 32, 34, 40)
)


@st.composite
def recordings(draw: st.DrawFn) -> bytes:
    """Files of two channels with fields of their heads or some samples changed, or no .wav file at all."""
    if draw(st.integers(0, 19)) == 0:
        return draw(st.binary(max_size=200))
    content = bytearray(draw(st.sampled_from(_FILES)))
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(("field", "field", "byte", "sample", "constant")))
        if how == "field":
            place, form = draw(st.sampled_from(_FIELDS))
            bits = 8 * struct.calcsize(form)
            value = draw(st.one_of(st.integers(0, 9), st.integers(0, 2**bits - 1)))
            struct.pack_into(form, content, place, value)
        elif how == "byte":
            content[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
        elif how == "sample":
            sample = draw(st.sampled_from((np.nan, np.inf, -np.inf, 3e38, 0.0)))
            struct.pack_into("<f", content, draw(st.integers(44, len(content) - 4)), sample)
        else:
            start = draw(st.integers(44, len(content) - 1))
            content[start:] = bytes(len(content) - start)
    return bytes(content[: draw(st.one_of(st.just(len(content)), st.integers(0, len(content))))])
