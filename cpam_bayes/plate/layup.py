"""The notation of layups: "[(0/90)_8]_s", "[45/-45/0_2]_2s", "[(?/?/?/?)_4]_s", "[(c0/g45)_4]_s".

Plies may also be separated by commas or spaces, the same in a whole layup; angles may have a degree sign.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cpam_bayes.errors import LayupError
from cpam_bayes.plate.laminate import PlyStack

MAX_PLIES: Final = 2000
_MAX_CHARACTERS: Final = 10_000
_MAX_DEPTH: Final = 20

_SPACE = re.compile(r"\s*")
_DEGREES = re.compile("[\N{DEGREE SIGN}\N{MASCULINE ORDINAL INDICATOR}\N{RING ABOVE}]|deg(?![a-z])")
_BETWEEN: Final = ("/", ",", ";")
_ANGLE = re.compile(r"[0-9]+(?:\.[0-9]*)?|\.[0-9]+")
_SIGN = re.compile("\N{PLUS-MINUS SIGN}|\N{MINUS-OR-PLUS SIGN}|\\+-|-\\+|\\+|-|\N{MINUS SIGN}|")
_COUNT = re.compile(r"[0-9]+")
_NAME = re.compile(r"[A-Za-z]+")
_PAIRS: Final = {
    "\N{PLUS-MINUS SIGN}": (1.0, -1.0),
    "+-": (1.0, -1.0),
    "\N{MINUS-OR-PLUS SIGN}": (-1.0, 1.0),
    "-+": (-1.0, 1.0),
}
_MINUS: Final = ("-", "\N{MINUS SIGN}")

# A run of plies: (angle, -1, name) is known, (nan, k, name) is the k-th unknown, counted from 0; the name is
# "" where all plies are alike.
_Plies = list[tuple[float, int, str]]


@dataclass(frozen=True, slots=True)
class PlyKind:
    """A ply that a layup refers to by name.

    material : of a hybrid, "" where all plies are of one material
    thickness : m
    density : kg/m3, None where the density of the plate is uniform
    """

    name: str
    material: str
    thickness: float
    density: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Layup:
    """The ply angles of a laminate, bottom to top, degrees from the x axis.

    text : as written
    angles_deg : (n_plies,) in (-90, 90], nan where unknown
    unknown_index : (n_plies,) index of a ply's unknown, -1 where known
    kinds : n_plies, the kind of each ply; empty where all are alike
    """

    text: str
    angles_deg: NDArray[np.float64]
    unknown_index: NDArray[np.int64]
    kinds: tuple[PlyKind, ...] = ()

    def __post_init__(self) -> None:
        angles = np.array(self.angles_deg, dtype=np.float64)
        index = np.array(self.unknown_index, dtype=np.int64)
        for array in (angles, index):
            array.flags.writeable = False
        object.__setattr__(self, "angles_deg", angles)
        object.__setattr__(self, "unknown_index", index)

    @property
    def n_plies(self) -> int:
        """Number of plies."""
        return int(self.angles_deg.size)

    @property
    def n_unknown(self) -> int:
        """Number of different unknown angles."""
        return int(self.unknown_index.max(initial=-1)) + 1

    @property
    def unknown_names(self) -> tuple[str, ...]:
        """angle_1, angle_2, ... counted from the bottom by first appearance."""
        return tuple(f"angle_{i + 1}" for i in range(self.n_unknown))

    @property
    def is_symmetric(self) -> bool:
        """Whether the upper half mirrors the lower whatever the unknown angles are."""
        known = np.array_equal(self.angles_deg, self.angles_deg[::-1], equal_nan=True)
        known = known and self.kinds == self.kinds[::-1]
        return known and np.array_equal(self.unknown_index, self.unknown_index[::-1])

    @property
    def plies(self) -> PlyStack | None:
        """Positions and materials of the plies, scaled to fill the thickness; None where all are alike."""
        if not self.kinds:
            return None
        thickness = np.array([kind.thickness for kind in self.kinds])
        names = tuple(dict.fromkeys(kind.material for kind in self.kinds))
        density = np.array([1.0 if kind.density is None else kind.density for kind in self.kinds])
        return PlyStack(
            interfaces=np.concatenate(([0.0], np.cumsum(thickness))) / thickness.sum() - 0.5,
            material=np.array([names.index(kind.material) for kind in self.kinds]),
            density=density * thickness.sum() / (density @ thickness),
            names=names,
        )

    def angles(self, unknown_deg: ArrayLike) -> NDArray[Any]:
        """Angles of every ply, (..., n_unknown) -> (..., n_plies), degrees; complex input is accepted.

        raises ValueError when the last axis is not n_unknown long
        """
        unknown = np.asarray(unknown_deg)
        if unknown.ndim == 0 or unknown.shape[-1] != self.n_unknown:
            raise ValueError(
                f"unknown angles of {self.text}: received shape {unknown.shape}, "
                f"accepted: (..., {self.n_unknown})"
            )
        known = self.angles_deg.astype(np.result_type(unknown, float))
        full = np.broadcast_to(known, (*unknown.shape[:-1], self.n_plies)).copy()
        open_plies = self.unknown_index >= 0
        full[..., open_plies] = unknown[..., self.unknown_index[open_plies]]
        return full

    def with_angles(self, unknown_deg: ArrayLike) -> Layup:
        """The layup with its unknown angles set to (n_unknown,) degrees.

        raises ValueError for another shape or an angle outside [-90, 90]
        """
        angles = self.angles(unknown_deg)
        if angles.ndim != 1:
            raise ValueError(
                f"unknown angles of {self.text}: received shape {np.shape(unknown_deg)}, "
                f"accepted: ({self.n_unknown},)"
            )
        return from_angles(angles.tolist(), self.kinds)


def parse_layup(text: str, kinds: Mapping[str, PlyKind] = MappingProxyType({})) -> Layup:
    """Read a layup, bottom to top.

    Plies are separated by "/"; "_n" repeats a ply or a group; after the last bracket "_s" mirrors,
    "_T" does not, "_2s" repeats and then mirrors; "±45" is 45/-45. A "?" is an unknown angle: one
    unknown for each "?" written, however often its group is repeated.

    kinds : plies by name; the layup then has a name before each angle, as in "[c0/g45]"; a name without an
        angle is at 0

    raises LayupError for anything else, angles outside [-90, 90] and more than MAX_PLIES plies
    """
    return _Reader(text, kinds).layup()


def from_angles(angles_deg: Sequence[float], kinds: tuple[PlyKind, ...] = ()) -> Layup:
    """The layup of known angles, bottom to top, (n_plies,) degrees; kinds : as in `Layup`.

    raises ValueError for no plies, too many, or an angle outside [-90, 90]
    """
    if not 1 <= len(angles_deg) <= MAX_PLIES:
        raise ValueError(f"plies: received {len(angles_deg)}, accepted: 1 to {MAX_PLIES}")
    for angle in angles_deg:
        if not -90.0 <= angle <= 90.0:
            raise ValueError(f"ply angle: received {angle}, accepted: -90 to 90 degrees")
    angles = [_normalised(float(angle)) for angle in angles_deg]
    named = "/".join(_format_ply(a, 1, kind.name) for a, kind in zip(angles, kinds, strict=False))
    text = f"[{named}]" if kinds else format_angles(angles)
    return Layup(text, np.array(angles), np.full(len(angles), -1), kinds)


def format_angles(angles_deg: Sequence[float]) -> str:
    """Known angles in the shortest usual notation, which `parse_layup` reads back exactly.

    raises ValueError for no plies
    """
    angles = [_normalised(float(angle)) for angle in angles_deg]
    n = len(angles)
    if n == 0:
        raise ValueError("plies: received none, accepted: 1 or more")
    if n % 2 == 0 and angles == angles[::-1] and len(set(angles)) > 1:
        return f"[{_format_run(angles[: n // 2])}]_s"
    return f"[{_format_run(angles)}]"


def _format_run(angles: list[float]) -> str:
    n = len(angles)
    period = next(p for p in range(1, n + 1) if n % p == 0 and angles[:p] * (n // p) == angles)
    runs: list[tuple[float, int]] = []
    for angle in angles[:period]:
        if runs and runs[-1][0] == angle:
            runs[-1] = (angle, runs[-1][1] + 1)
        else:
            runs.append((angle, 1))
    if period == 1:
        return _format_ply(angles[0], n)
    unit = "/".join(_format_ply(angle, count) for angle, count in runs)
    return unit if period == n else f"({unit})_{n // period}"


def _format_ply(angle: float, count: int, name: str = "") -> str:
    number = name + np.format_float_positional(angle, trim="-")
    return number if count == 1 else f"{number}_{count}"


def _normalised(angle: float) -> float:
    """The angle, with 90 for -90 and 0 for -0."""
    return 90.0 if angle == -90.0 else angle + 0.0


class _Reader:
    """A recursive-descent parser of one layup; every count is checked before a list grows by it."""

    def __init__(self, text: str, kinds: Mapping[str, PlyKind]) -> None:
        self.text = text
        self.kinds = kinds
        self.at = 0
        self.unknowns = 0
        self.between = ""
        if len(text) > _MAX_CHARACTERS:
            self.fail(
                f"layup of {len(text)} characters, accepted: up to {_MAX_CHARACTERS}",
                _MAX_CHARACTERS,
            )

    def layup(self) -> Layup:
        if not self.take("["):
            self.fail('a layup begins with "["')
        plies = self.group("]", depth=1)
        plies = self.ending(plies)
        if self.peek():
            self.fail('nothing may follow but "_s", "_T", "_n" or "_ns"')
        angles, index, names = zip(*plies, strict=True)
        kinds = tuple(self.kinds[name] for name in names) if self.kinds else ()
        return Layup(self.text, np.array(angles), np.array(index), kinds)

    def group(self, closing: str, depth: int) -> _Plies:
        if depth > _MAX_DEPTH:
            self.fail(f"groups nested too deeply, accepted: {_MAX_DEPTH} levels", self.at - 1)
        opened = self.at - 1
        plies: _Plies = []
        while True:
            start = self.at
            item = self.item(depth)
            if len(plies) + len(item) > MAX_PLIES:
                self.too_many(len(plies) + len(item), start)
            plies += item
            if self.take(closing):
                return plies
            if not self.peek():
                self.fail(f'"{self.text[opened]}" is never closed by "{closing}"', opened)
            self.separator(closing)

    def separator(self, closing: str) -> None:
        """Read the separator between plies, the same in the whole layup."""
        mark = self.peek()
        if mark not in _BETWEEN:
            if not self.text[self.at - 1].isspace() or mark in ("]", ")", "}", "_"):
                self.fail(f'expected "/" or "{closing}"')
            mark = " "
        if self.between not in ("", mark):
            self.fail(f'"{self.between}" and "{mark}" between plies, accepted: one of them; 22.5 has a point')
        self.between = mark
        self.at += mark != " "

    def item(self, depth: int) -> _Plies:
        if self.take("("):
            plies = self.group(")", depth + 1)
            return self.repeated(plies, optional_mark=True)
        name = self.name()
        if self.take("?"):
            self.unknowns += 1
            return self.repeated([(float("nan"), self.unknowns - 1, name)], optional_mark=False)
        return self.repeated(self.angle(name), optional_mark=False)

    def name(self) -> str:
        """The name before an angle, "" where plies have none."""
        self.peek()
        start = self.at
        name = self.match(_NAME)
        if name and not self.kinds:
            self.fail(
                f'ply "{name}", accepted: angles alone, or tables [[ply]] with the names of plies', start
            )
        if self.kinds and name not in self.kinds:
            self.fail(
                f'ply "{name}", accepted: an angle after the name of a [[ply]]: {" ".join(self.kinds)}', start
            )
        return name

    def angle(self, name: str) -> _Plies:
        if name and self.peek() in ("/", "]", ")", "_"):
            return [(0.0, -1, name)]
        self.peek()
        start = self.at
        sign = self.match(_SIGN)
        self.peek()
        digits = self.match(_ANGLE)
        if not digits:
            self.fail('expected a ply: an angle in degrees, "?" or a group in "( )"', start)
        value = float(digits)
        if value > 90.0:
            self.fail(f"angle {sign}{digits[:20]}, accepted: -90 to 90 degrees", start)
        self.match(_DEGREES)
        signs = _PAIRS.get(sign, (-1.0,) if sign in _MINUS else (1.0,))
        return [(_normalised(s * value), -1, name) for s in signs]

    def repeated(self, plies: _Plies, optional_mark: bool) -> _Plies:
        marked = self.take("_")
        if not marked and not (optional_mark and self.peek().isdigit()):
            return plies
        return self.times(plies)

    def ending(self, plies: _Plies) -> _Plies:
        marked = self.take("_")
        braced = marked and self.take("{")
        start = self.at
        counted = self.peek() in tuple("0123456789")
        if counted:
            plies = self.times(plies)
        letter = self.peek()
        if letter in ("s", "S"):
            self.at += 1
            if 2 * len(plies) > MAX_PLIES:
                self.too_many(2 * len(plies), start)
            plies = plies + plies[::-1]
        elif letter in ("T", "t"):
            self.at += 1
        elif marked and not counted:
            self.fail('expected "s", "T" or a number after "_"')
        if braced and not self.take("}"):
            self.fail('"{" is never closed by "}"', start - 1)
        return plies

    def times(self, plies: _Plies) -> _Plies:
        self.peek()
        start = self.at
        digits = self.match(_COUNT)
        count = digits.lstrip("0")
        if not count:
            self.fail("expected a number of repetitions, 1 or more", start)
        if len(count) > 9:
            self.too_many(None, start)
        if len(plies) * int(count) > MAX_PLIES:
            self.too_many(len(plies) * int(count), start)
        return plies * int(count)

    def too_many(self, plies: int | None, position: int) -> NoReturn:
        number = "over 1000000000" if plies is None else str(plies)
        self.fail(f"a layup of {number} plies, accepted: up to {MAX_PLIES}", position)

    def match(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self.text, self.at)
        if match is None:
            return ""
        self.at = match.end()
        return match.group()

    def peek(self) -> str:
        self.match(_SPACE)
        return self.text[self.at : self.at + 1]

    def take(self, character: str) -> bool:
        if self.peek() != character:
            return False
        self.at += 1
        return True

    def fail(self, what: str, position: int | None = None) -> NoReturn:
        raise LayupError(self.text, self.at if position is None else position, what)
