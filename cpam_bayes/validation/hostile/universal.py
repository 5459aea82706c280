"""Universal files that no analyser writes."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from hypothesis import strategies as st

__all__ = ["LARGE_UNIVERSAL_FILES", "universal_modes_files", "universal_response_files"]

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
        if how == "field":  # the columns after it stay where they are
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
    """A binary file with some bytes changed, most of them in its heads, or cut off."""
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
"""Universal files of about a size, bytes, by what they are full of."""
