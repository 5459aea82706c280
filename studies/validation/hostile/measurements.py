"""Tables, universal files and recorded hits such as no instrument writes."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from hypothesis import strategies as st
from scipy.io import wavfile

# Tables of modes and of frequency responses

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
    """Text of a table of modes, wrong somewhere in most cases, or of no table at all."""
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
    """Text of a table of frequency responses with some cells changed, or of no table at all."""
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
"""Tables of responses of about a given size in bytes, by their content."""


# Universal files

_MARK: Final = "    -1"


def _numbers(values: Sequence[float], width: int = 13, digits: int = 5) -> str:
    return "".join(f"{value:{width}.{digits}E}" for value in values)


def _block(kind: str, *lines: str) -> list[str]:
    return [_MARK, kind, *lines, _MARK]


def _mode(
    number: int, analysis: int, kind: int, values: Sequence[float], shape: Sequence[float]
) -> list[str]:
    heads = ["shape", *["NONE"] * 4, f"{1:10d}{analysis:10d}{2:10d}{8:10d}{kind:10d}{3:10d}"]
    heads += [f"{2:10d}{4:10d}{1:10d}{number:10d}", _numbers(values)]
    lines = []
    for node, value in enumerate(shape, 1):
        row = [0.0, 0.0, 0.0, 0.0, value, 0.1] if kind == 5 else [0.0, 0.0, value]
        lines += [f"{node:10d}", _numbers(row)]
    return _block("    55", *heads, *lines)


_NODES: Final = [
    f"{node:10d}{0:10d}{0:10d}{8:10d}{_numbers((x, y, 0.0))}"
    for node, (x, y) in enumerate([(0.0, 0.0), (200.0, 0.0), (200.0, 100.0), (0.0, 100.0)], 1)
]
_UNITS: Final = (_numbers(values, 25, 16) for values in ((1e3, 1.0, 1.0), (273.15,)))
_MODES: Final = (
    *_block("   164", f"{1:10d}{'SI':>20s}{2:10d}", *_UNITS),
    *_block("    15", *_NODES),
    *_block("    82", f"{1:10d}{4:10d}{0:10d}", "NONE", f"{1:10d}{2:10d}{3:10d}{4:10d}"),
    *_mode(1, 2, 2, (101.5, 1.0, 0.002, 0.0), (1.0, -1.0, 1.0, -1.0)),
    *_mode(2, 3, 5, (-2.0, 1900.0, 1.0, 0.0, 0.0, 0.0), (1.0, 1.0, -1.0, -1.0)),
)  # fmt: skip


def _response(kind: str, form: int, n: int) -> list[str]:
    axis = f"{18:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {'NONE':<20s}"
    return [
        kind,
        *["NONE"] * 5,
        f"{4:5d}{1:10d}{0:5d}{0:10d} {'NONE':<10s}{1:10d}{3:4d} {'NONE':<10s}{1:10d}{3:4d}",
        f"{form:10d}{n:10d}{1:10d}{_numbers((0.0, 5.0, 0.0))}",
        *[axis] * 4,
    ]


_LINES: Final = 5.0 * np.arange(80)
_FRF: Final = _LINES**2 / (150.0**2 - _LINES**2 + 3j * _LINES)
_PAIRS: Final = np.stack((_FRF.real, _FRF.imag), axis=1).ravel()
_TEXT: Final = _response("    58", 5, len(_LINES)) + [_numbers(row) for row in _PAIRS.reshape(-1, 4).tolist()]
_RESPONSES: Final = (*[_MARK, *_TEXT, _MARK], *[_MARK, *_TEXT, _MARK])


def _binary(order: int, data: bytes) -> bytes:
    head = f"{'    58b'}{order:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    lines = "\n".join([_MARK, *_response(head, 5, len(_LINES)), ""])
    return lines.encode() + data + f"\n{_MARK}\n".encode()


_BINARY: Final = _binary(1, struct.pack(f"<{_PAIRS.size}f", *_PAIRS)) * 2

_FIELDS: Final = st.one_of(
    st.integers(-(10**10), 10**10).map(str),
    st.floats().map(lambda value: f"{value:.5E}"),
    st.sampled_from(("nan", "-inf", "1e400", "1E-400", "1.0D+02", "-1", "0", "", "****", "9" * 13, "٣")),
    st.text(max_size=8),
)  # fmt: skip


@st.composite
def _changed(draw: st.DrawFn, good: tuple[str, ...]) -> bytes:
    """A file with one to four lines changed, or no universal file at all."""
    lines = list(good)
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(lines) - 1))
        how = draw(
            st.sampled_from(("field", "field", "field", "wide", "drop", "repeat", "cut", "swap", "other"))
        )
        start = draw(st.integers(0, max(len(lines[place]) - 1, 0)))
        if how == "field":  # the columns after it stay in place
            width = draw(st.sampled_from((6, 10, 13, 20)))
            start -= start % width
            line = lines[place]
            lines[place] = line[:start] + draw(_FIELDS).rjust(width)[:width] + line[start + width :]
        elif how == "wide":
            lines[place] = lines[place][:start] + draw(_FIELDS) + lines[place][start:]
        elif how == "drop" and len(lines) > 1:
            del lines[place]
        elif how == "repeat":
            lines[place:place] = [lines[place]] * draw(st.integers(1, 3))
        elif how == "cut":
            lines[place] = lines[place][:start]
        elif how == "swap":
            other = draw(st.integers(0, len(lines) - 1))
            lines[place], lines[other] = lines[other], lines[place]
        elif how == "other":
            lines[place : place + draw(st.integers(1, 9))] = draw(st.text(max_size=60)).splitlines() or [""]
    end = draw(st.sampled_from(("\n", "\r\n", "\r")))
    return end.join([*lines, ""]).encode(errors="surrogatepass")


@st.composite
def _flipped(draw: st.DrawFn, good: bytes) -> bytes:
    """A binary file with some bytes changed, most of them in its headers, or truncated."""
    content = bytearray(good)
    for _ in range(draw(st.integers(1, 6))):
        most = draw(st.sampled_from((200, 1100, len(content))))
        content[draw(st.integers(0, most - 1))] = draw(st.integers(0, 255))
    return bytes(content[: draw(st.sampled_from((len(content), len(content), len(content) // 2)))])


def universal_modes_files() -> st.SearchStrategy[bytes]:
    """Universal files of nodes, units and modes on a plate of 200 by 100 mm, most of them wrong somewhere."""
    return st.one_of(_changed(_MODES), _changed(_MODES), st.binary(max_size=200))


def universal_response_files() -> st.SearchStrategy[bytes]:
    """Universal files of frequency responses, ASCII and binary, most of them wrong somewhere."""
    return st.one_of(_changed(_RESPONSES), _flipped(_BINARY))


def _filled(head: Sequence[str], line: str) -> Callable[[int], bytes]:
    def made(size: int) -> bytes:
        before = "\n".join([_MARK, *head, ""]).encode()
        return before + f"{line}\n".encode() * ((size - len(before) - 10) // (len(line) + 1)) + _MARK.encode()

    return made


def _repeated(lines: Sequence[str]) -> Callable[[int], bytes]:
    block = "\n".join([*lines, ""]).encode()
    return lambda size: block * (size // len(block))


LARGE_UNIVERSAL_FILES: Final[Mapping[str, Callable[[int], bytes]]] = {
    "marks": _repeated([_MARK]),
    "marks in lines": lambda size: _MARK.encode() * (size // len(_MARK)),
    "empty datasets": _repeated(_block("    55")),
    "datasets of units": _repeated(_MODES[:6]),
    "modes": _repeated(_MODES),
    "one mode": _filled(
        _mode(1, 2, 2, (101.5, 1.0, 0.0, 0.0), ())[1:-1], f"{7:10d}\n{_numbers((0.0, 0.0, 1.0))}"
    ),
    "nodes": _filled(["    15"], _NODES[0]),
    "one response": _filled(_TEXT[:12], _numbers((1.0,) * 6)),
    "a response of short lines": _filled(_TEXT[:12], _numbers((1.0,))),
    "responses": _repeated(_RESPONSES),
    "a binary response": lambda size: _binary(1, bytes(size - 2000)),
    "lines without an end": lambda size: (
        "\n".join([_MARK, *_TEXT[:12], ""]).encode() + b" 1.00000E+00" * (size // 13)
    ),
    "zeros": bytes,
}
"""Universal files of about a given size in bytes, by their content."""


# Recorded hits

_RATE: Final = 2000


def _good(kind: type[np.generic], scale: float) -> bytes:
    """Force and response of one hit, 0.3 s, as a .wav file."""
    t = np.arange(600) / _RATE
    signals = np.stack((np.exp(-2e6 * (t - 0.01) ** 2), np.exp(-20.0 * t) * np.sin(950.0 * t)), axis=1)
    file = io.BytesIO()
    wavfile.write(file, _RATE, (scale * signals).astype(kind))
    return file.getvalue()


_FILES: Final = (_good(np.int16, 3e4), _good(np.float32, 1.0), _good(np.int32, 2e9))
# Fields of the header and their formats: sizes, codec, channels, rate, bytes per second and frame, bits.
_HEAD_FIELDS: Final = tuple(
    (place, "<I" if place in (4, 16, 24, 28, 40) else "<H") for place in (4, 16, 20, 22, 24, 28, 32, 34, 40)
)


@st.composite
def recordings(draw: st.DrawFn) -> bytes:
    """Two-channel files with some header fields or samples changed, or no .wav file at all."""
    if draw(st.integers(0, 19)) == 0:
        return draw(st.binary(max_size=200))
    content = bytearray(draw(st.sampled_from(_FILES)))
    for _ in range(draw(st.integers(1, 3))):
        how = draw(st.sampled_from(("field", "field", "byte", "sample", "constant")))
        if how == "field":
            place, form = draw(st.sampled_from(_HEAD_FIELDS))
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
