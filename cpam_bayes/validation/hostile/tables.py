"""Tables of modes and of frequency responses that no instrument writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from hypothesis import strategies as st

__all__ = ["LARGE_TABLES", "mode_tables", "response_tables"]


_HEADS: Final = (
    "mode", "label", "Frequency (Hz)", "frequency [kHz]", "hz", "hit", "sd", "damping (%)", "zeta", "weight"
)  # fmt: skip
_CELLS: Final = st.one_of(
    st.floats(1.0, 5000.0).map(lambda hz: f"{hz:.2f}"),
    st.floats(1.0, 5000.0).map(lambda hz: f"{hz:.2f}".replace(".", ",")),
    st.integers(0, 12).map(str),
    st.sampled_from(("", "(1,1)", "bending 2", "n/a", "-", "1e400", "nan", "-3", "0", "1.234,5", '"a', "٣")),
    st.text(max_size=12),
)  # fmt: skip
_SEPARATORS: Final = st.sampled_from((",", ";", "\t", "|", " ", ", "))


@st.composite
def mode_tables(draw: st.DrawFn) -> str:
    """The text of a table of modes, most of them wrong somewhere, or of no table at all."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.text(max_size=300))
    separator = draw(_SEPARATORS)
    heads = draw(st.lists(st.sampled_from(_HEADS), min_size=1, max_size=6, unique=draw(st.booleans())))
    n = len(heads)
    lines = draw(st.lists(st.text(max_size=20).filter(str.isprintable), max_size=2))
    lines.append(separator.join(heads))
    for _ in range(draw(st.integers(0, 8))):
        cells = draw(st.lists(_CELLS, min_size=max(n - draw(st.integers(0, 1)), 0), max_size=n + 1))
        lines.append(separator.join(cells))
    return draw(st.sampled_from(("\n", "\r\n", "\r"))).join(lines)


_RESPONSE_HEADS: Final = (
    "hz", "Frequency (Hz)", "frequency [kHz]", "re", "im", "real 1", "imag 1", "magnitude [dB]", "abs",
    "phase [deg]", "phase [rad]", "coherence", "",
)  # fmt: skip
_GOOD_HEADS: Final = (("hz", "re", "im"), ("freq", "mag", "phase [deg]"), ("hz", "mag_dB", "phase rad"))
_VALUES: Final = st.one_of(
    st.floats().map(repr),
    st.sampled_from(("", "0", "nan", "-inf", "1e308", "1e-320", "1,5", "-", "٣", "1_0", '"', "0x1")),
    st.text(max_size=8),
)


@st.composite
def response_tables(draw: st.DrawFn) -> str:
    """The text of a table of frequency responses with some cells changed, or of no table at all."""
    if draw(st.integers(0, 19)) == 0:
        return draw(st.text(max_size=300))
    separator = draw(_SEPARATORS)
    heads = list(draw(st.sampled_from(_GOOD_HEADS)))
    if draw(st.integers(0, 3)) == 0:
        heads = draw(st.lists(st.sampled_from(_RESPONSE_HEADS), min_size=1, max_size=7))
    step = draw(st.one_of(*[st.just(5.0)] * 3, st.floats()))
    rows = []
    for i in range(draw(st.sampled_from((0, 2, 60, 60, 60)))):
        peak = 1.0 / (1.0 + (i - 30.0) ** 2)
        rows.append([f"{step * i!r}", *[f"{peak:.6g}"] * (len(heads) - 1)])
    for _ in range(draw(st.integers(0, 3)) if rows else 0):
        row = rows[draw(st.integers(0, len(rows) - 1))]
        row[draw(st.integers(0, len(row) - 1))] = draw(_VALUES)
    return "\n".join(separator.join(cells) for cells in (heads, *rows))


LARGE_TABLES: Final[Mapping[str, Callable[[int], bytes]]] = {
    "empty lines": lambda size: b"\n" * size,
    "empty lines below heads": lambda size: b"hz,re,im" + b"\r" * size,
    "cells": lambda size: b"," * size,
    "columns": lambda size: b"re," * (size // 3),
    "lines of heads": lambda size: b"re,im\n" * (size // 6),
    "quotes": lambda size: b'hz,re,im\n"' + b'""' * (size // 2),
    "rows": lambda size: b"hz,re,im\n" + b"".join(b"%d,%d.00,0\n" % (i, i % 9) for i in range(size // 15)),
    "rows of long cells": lambda size: b"hz,re,im\n" + (b"1" * 5000 + b",1,1\n") * (size // 5005),
}
"""Tables of responses of about a size, bytes, by what they are full of."""
