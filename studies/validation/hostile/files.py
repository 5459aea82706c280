"""Nonsensical plate files and layups, inputs spliced from others, and damage to stored files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, TypeVar

import numpy as np
from hypothesis import strategies as st

# Plate files

_PLATE: Final = """\
name = "panel 7"
specimen = "seven"
notes = ["cut from the edge"]

[plate]
length_mm = 260.0
width_mm = 250.0
thickness_mm = 3.2
density_kg_m3 = 1590.0
layup = "[(0/90)_8]_s"
edges = "CFSF"

[plate.sd]
thickness_mm = 0.02

[material]
name = "carbon"
isotropic = false
E1_GPa = 121.2
E2_GPa = 9.34
nu12 = 0.23
G12_GPa = 6.25

[material.sd]
E1_GPa = 12.0

[unknowns]
E1_GPa = [10.0, 200.0]
E2_GPa = [5.0, 40.0]
nu12 = { mean = 0.28, sd = 0.03, bounds = [0.15, 0.4] }
angle_grid_deg = 15.0

[environment]
air_density_kg_m3 = 1.2

[[sensor]]
mass_g = 1.2
x_mm = 250.0
y_mm = 240.0

[measurement]
frequencies_hz = [102, 311, 342, 342, 390, 612.5]
resolution_hz = 0.5
relative_std = 0.005
labels = ["(1,1)", "", "", "", "", ""]
"""
_LINES: Final = tuple(_PLATE.splitlines())

_NUMBERS: Final = st.one_of(
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from(
        ("nan", "-inf", "1e400", "1e-400", "-0.0", "0x10", "1_000", "9" * 400, "00", "1e", "260,0")
    ),
)
_WORDS: Final = st.one_of(
    st.text(max_size=30).map(lambda text: f'"{text}"'),
    st.sampled_from(
        ("true", "1979-05-27T07:32:00Z", "07:32:00", '""', "''", '"\\u001b[31m"', '"\\U0010FFFF"')
    ),
)
_VALUES: Final = st.recursive(
    st.one_of(_NUMBERS, _WORDS),
    lambda inner: st.one_of(
        st.lists(inner, max_size=8).map(lambda values: f"[{', '.join(values)}]"),
        st.lists(inner, max_size=3).map(
            lambda values: f"{{{', '.join(f'k{i} = {v}' for i, v in enumerate(values))}}}"
        ),
    ),
    max_leaves=8,
)


@st.composite
def plate_texts(draw: st.DrawFn) -> str:
    """Text of a plate file with one to four lines changed, or of no plate file at all."""
    lines = list(_LINES)
    for _ in range(draw(st.integers(1, 4))):
        if not lines:
            break
        place = draw(st.integers(0, len(lines) - 1))
        how = draw(
            st.sampled_from(("value", "value", "value", "drop", "repeat", "insert", "cut", "swap", "other"))
        )
        if how == "value" and "=" in lines[place]:
            lines[place] = f"{lines[place].split('=')[0]}= {draw(_VALUES)}"
        elif how == "drop":
            del lines[place]
        elif how == "repeat":
            lines.insert(draw(st.integers(0, len(lines))), lines[place])
        elif how == "insert":
            lines.insert(place, draw(st.text(max_size=40)))
        elif how == "cut":
            lines[place] = lines[place][: draw(st.integers(0, len(lines[place])))]
        elif how == "swap":
            other = draw(st.integers(0, len(lines) - 1))
            lines[place], lines[other] = lines[other], lines[place]
        elif how == "other":
            lines = draw(st.text(max_size=300)).splitlines()
    return "\n".join(lines)


LARGE_FILES: Final[Mapping[str, str]] = {
    "unknown keys": "".join(f"key{i} = 1\n" for i in range(17_000)),
    "unknown tables": "".join(f"[t{i}]\n" for i in range(24_000)),
    "unknown keys of [unknowns]": "[unknowns]\n" + "".join(f"k{i} = {{a=1}}\n" for i in range(14_000)),
    "empty [[sensor]]": "[[sensor]]\n" * 22_000,
    "keys of one [[sensor]]": "[[sensor]]\n" + "".join(f"key{i} = 1\n" for i in range(17_000)),
    "frequencies": "[measurement]\nfrequencies_hz = [" + "1, " * 80_000 + "]",
    "descending frequencies": "[measurement]\nfrequencies_hz = ["
    + ", ".join(str(50_000 - i) for i in range(35_000))
    + "]",
    "labels": "[measurement]\nlabels = [" + '"",' * 80_000 + "]",
    "bounds": "[unknowns]\nE1_GPa = [" + "1, " * 80_000 + "]",
    "dotted keys": "".join(f"a{i}.b.c.d = 1\n" for i in range(13_000)),
    "deep tables": "".join(f"[{'.'.join('a' * 90)}.t{i}]\n" for i in range(1_300)),
    "a long name": 'name = "' + "x" * 240_000 + '"',
    "a long layup": '[plate]\nlayup = "[' + "0/" * 120_000 + ']"',
    "a long line of escapes": 'a = "' + "\\u0041" * 40_000 + '"',
    "brackets": "a = " + "[" * 200_000,
}
"""Texts of the maximum size of a plate file, by their content."""


# Layups

_PLIES: Final = st.one_of(
    st.floats(-100, 100).map(lambda angle: f"{angle:g}"),
    st.integers(-90, 90).map(str),
    st.sampled_from(("?", "±45", "-+30", "+-0", "", "90.", ".5", "1e3", "٣")),
)
_COUNTS: Final = st.one_of(
    st.just(""), st.integers(0, 3000).map(lambda n: f"_{n}"), st.just("_"), st.just("2")
)


def _run(plies: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    item = st.tuples(plies, _COUNTS).map("".join)
    return st.lists(item, max_size=5).map("/".join)


_GROUPS: Final = st.recursive(
    _run(_PLIES), lambda inner: _run(inner.map(lambda run: f"({run})")), max_leaves=6
)
_ENDS: Final = st.sampled_from(("]", "]_s", "]s", "]_2s", "]_T", "]_99999999999s", "", "]]", "]_", "] x"))


def layups() -> st.SearchStrategy[str]:
    """Layups in the notation, most of them wrong somewhere, and texts of its characters."""
    return st.one_of(
        st.tuples(st.just("["), _GROUPS, _ENDS).map("".join),
        st.text(alphabet="[]()/_0123456789.?+-±∓sST ", max_size=60),
        st.text(max_size=40),
    )


# Inputs spliced from two others

Content = TypeVar("Content", str, bytes)


def crossed(one: Content, other: Content, rng: np.random.Generator) -> Content:
    """The first content with a piece of the second inserted, or with a piece dropped, repeated or moved.

    Pieces are whole lines in half of the cases. The result is at most twice as long as its longer parent.
    """
    by_lines = bool(rng.integers(2))
    start, stop = _piece(one, rng, by_lines)
    how = rng.integers(5)
    if how == 0:  # replace a piece by one of the other
        first, last = _piece(other, rng, by_lines)
        return one[:start] + other[first:last] + one[stop:]
    if how == 1:  # join the head of one to the tail of the other
        return one[:stop] + other[_piece(other, rng, by_lines)[0] :]
    if how == 2:
        return one[:start] + one[stop:]
    if how == 3:
        return one[:stop] + one[start:]
    place = _piece(one, rng, by_lines)[0]
    return one[:place] + one[start:stop] + one[place:]


def _piece(content: Content, rng: np.random.Generator, by_lines: bool) -> tuple[int, int]:
    """Start and end of a piece."""
    start, stop = sorted(rng.integers(len(content) + 1, size=2).tolist())
    if not by_lines:
        return start, min(stop, start + int(rng.integers(1, 40)))
    mark = "\n" if isinstance(content, str) else b"\n"  # type: ignore[redundant-expr]  # checked for each kind
    return content.rfind(mark, 0, start) + 1, content.find(mark, stop) + 1 or len(content)


# Damage to stored files


def _flipped(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    for place in rng.choice(len(content), size=rng.integers(1, 9), replace=False):
        changed[place] ^= int(rng.integers(1, 256))
    return bytes(changed)


def _truncated(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: rng.integers(len(content))]


def _in_directory(content: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(content)
    changed[rng.integers(content.index(b"PK\x01\x02"), len(content))] ^= int(rng.integers(1, 256))
    return bytes(changed)


def _moved(content: bytes, rng: np.random.Generator) -> bytes:
    start, stop, place = np.sort(rng.choice(len(content), size=3, replace=False))
    return content[:start] + content[stop:place] + content[start:stop] + content[place:]


def _longer(content: bytes, rng: np.random.Generator) -> bytes:
    return content + rng.bytes(int(rng.integers(1, 100)))


DAMAGES: Final[Mapping[str, Callable[[bytes, np.random.Generator], bytes]]] = {
    "bytes changed": _flipped,
    "truncated": _truncated,
    "zip directory changed": _in_directory,
    "a piece moved": _moved,
    "bytes appended": _longer,
}
"""Kinds of damage to the arrays of a stored file, by name."""
