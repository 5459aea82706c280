"""Where to hold and hit a plate, from its mode shapes: places, rows, drawing and sentence.

Supports of small stiffness k raise the square of a mode's angular frequency by k times the sum of its squared
mass-normalised deflections there (Rayleigh, Theory of Sound, section 88). They are placed where the largest
shift of any mode is smallest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.formatting import significant
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.edges import conditions
from cpam_bayes.render.figures import BEFORE, PREDICTED
from cpam_bayes.render.plate import plate_figure
from cpam_bayes.render.report import Caption, Column, Drawing, Rows, Section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Point = tuple[float, float]
"""A place, x and y, mm."""
_Node = tuple[int, int]

_NAME: Final = "handling"
_TITLE: Final = "Where to hold and where to hit"
# Least distance from the edges, as a fraction of the side; a mode below this fraction of its largest
# deflection is weak.
_MARGIN, _WEAK = 0.04, 0.1
# Least distance between the places of the hit and of the sensor, in fractions of the sides.
_APART: Final = 0.3


@dataclass(frozen=True, slots=True)
class Handled:
    """One bending mode at the places.

    number : from 1; frequency : Hz
    across, lines : the two lines x or y = ..., mm, that would disturb it least if alone; "" for a held plate
    at_pads, at_hit, at_sensor : the largest deflection there, as a fraction of the mode's largest
    """

    number: int
    frequency: float
    across: str
    lines: Point
    at_pads: float
    at_hit: float
    at_sensor: float


@dataclass(frozen=True, slots=True)
class Handling:
    """Places for all modes together.

    pads : four soft supports; none for a plate with a held edge
    hits : the hit, and a second one where a mode is weak at the first; sensor : where to measure
    """

    modes: tuple[Handled, ...]
    pads: tuple[Point, ...]
    hits: tuple[Point, ...]
    sensor: Point

    @property
    def sentence(self) -> str:
        """All places in one sentence."""
        (x, y), *_ = self.pads or ((0.0, 0.0),)
        on = f"Hold it on four soft pads, {x:.0f} mm from each end along x and {y:.0f} mm along y; hit"
        hits = " and then ".join(f"({x:.0f}, {y:.0f})" for x, y in self.hits)
        x, y = self.sensor
        return f"{on if self.pads else 'Hit'} it near {hits} mm and measure near ({x:.0f}, {y:.0f}) mm."

    @property
    def keys(self) -> dict[str, Any]:
        """Keys of a document."""
        return {
            "pads_mm": [list(p) for p in self.pads],
            "hits_mm": [list(p) for p in self.hits],
            "sensor_mm": list(self.sensor),
            "modes": handling_rows(self).records(),
        }


def handling_of(specimen: Specimen, modes: Sequence[Mode], shapes: Sequence[Any]) -> Handling | None:
    """The places for the bending modes of a rectangular plate; None where there are none.

    shapes : of each mode, with w on a regular grid of the plate, (n, n), x first
    """
    wanted = [i for i, mode in enumerate(modes) if mode.in_plane_fraction < 0.5]
    if not wanted or specimen.plate.mesh is not None:
        return None
    sides = 1e3 * np.array((specimen.plate.length, specimen.plate.width))
    w = np.abs(np.array([shapes[i].w for i in wanted]))
    w /= w.max(axis=(1, 2), keepdims=True)
    f = np.array([modes[i].frequency for i in wanted])
    along = np.linspace(0.0, 1.0, w.shape[1])
    inner = (along >= _MARGIN) & (along <= 1.0 - _MARGIN)
    allowed = inner[:, None] & inner
    hits = [_best(w.min(axis=0), allowed)]
    weak = w[:, *hits[0]] < _WEAK
    if weak.any():
        hits.append(_best(w[weak].min(axis=0), allowed))
    away = np.hypot((along - along[hits[0][0]])[:, None], along - along[hits[0][1]])
    sensor = _best(w.min(axis=0), allowed & (away >= _APART))
    # over the squared frequency: relative shifts up to a common factor
    square = w**2 / np.mean(w**2, axis=(1, 2), keepdims=True)
    is_free = all(edge.is_free for edge in conditions(specimen.plate.edges))
    pads = _pads(square / f[:, None, None] ** 2, allowed) if is_free else []
    lines = [_lines(one, along, inner) if is_free else ("", 0.0) for one in square]

    def place(node: _Node) -> Point:
        x, y = sides * along[list(node)]
        return float(x), float(y)

    def motion(i: int, nodes: Sequence[_Node]) -> float:
        return max((float(w[i, *node]) for node in nodes), default=0.0)

    handled = []
    for i, (number, (across, p)) in enumerate(zip(wanted, lines, strict=True)):
        side = float(sides["xy".index(across or "x")])
        at = motion(i, pads), motion(i, hits), motion(i, [sensor])
        handled.append(Handled(number + 1, float(f[i]), across, (p * side, (1.0 - p) * side), *at))
    return Handling(tuple(handled), tuple(map(place, pads)), tuple(map(place, hits)), place(sensor))


def _best(value: NDArray[Any], allowed: NDArray[Any]) -> _Node:
    """The node of the largest value, the first of equal ones."""
    i, j = np.unravel_index(int(np.argmax(np.where(allowed, value.round(9), -np.inf))), value.shape)
    return int(i), int(j)


def _pads(shift: NDArray[Any], allowed: NDArray[Any]) -> list[_Node]:
    """Four mirror-image nodes where the largest summed shift of any mode, shifts (modes, n, n), is least."""
    four = shift + shift[:, ::-1] + shift[:, :, ::-1] + shift[:, ::-1, ::-1]
    last = len(allowed) - 1
    quarter = np.zeros_like(allowed)
    quarter[: last // 2, : last // 2] = allowed[: last // 2, : last // 2]
    i, j = _best(-four.max(axis=0) / four.max(), quarter)
    return [(i, j), (last - i, j), (last - i, last - j), (i, last - j)]


def _lines(square: NDArray[Any], along: NDArray[Any], inner: NDArray[Any]) -> tuple[str, float]:
    """Direction across which two mirrored lines disturb a mode least, and the position of the first."""
    found = []
    for across, mean in zip("xy", (square.mean(axis=1), square.mean(axis=0)), strict=True):
        both = np.where(inner, mean + mean[::-1], np.inf)[: (len(along) + 1) // 2]
        at = int(np.argmin(both))
        found.append((float(both[at]), across, float(along[at])))
    _, across, p = min(found)
    return across, p


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f}"


def _held_on(mode: Handled) -> str | None:
    a, b = (f"{p:.0f}" for p in mode.lines)
    return f"{mode.across} = {a}" + (f" and {b}" if a != b else "") if mode.across else None


_COLUMNS: Final = (
    Column("mode", "mode", lambda m: m.number, number=True),
    Column("Hz", "frequency_hz", lambda m: m.frequency, lambda f: significant(f, 4), number=True),
    Column("lines for this mode alone, mm", None, _held_on),
    Column(
        "moves at the pads %", "at_pads", lambda m: m.at_pads if m.across else None, _percent, number=True
    ),
    Column("at the hit %", "at_hit", lambda m: m.at_hit, _percent, number=True),
    Column("at the sensor %", "at_sensor", lambda m: m.at_sensor, _percent, number=True),
    Column(None, "lines_mm", lambda m: list(m.lines) if m.across else None),
    Column(None, "lines_across", lambda m: m.across or None),
)


def handling_rows(handling: Handling) -> Rows:
    """Deflection of each mode at the places."""
    return Rows(_NAME, _COLUMNS, handling.modes, flagged=lambda m: m.at_hit < _WEAK)


def handling_section(handling: Handling | None) -> tuple[Section, ...]:
    """Section with drawing and rows; empty without places."""
    if handling is None:
        return ()
    return (Section(_TITLE, (handling_rows(handling).table(_TITLE),), (_NAME,), folded=False),)


def handling_drawing(specimen: Specimen, handling: Handling | None) -> tuple[Drawing, ...]:
    """The plate with the places marked."""
    if handling is None:
        return ()
    pads = "Blue rings: soft pads, where their largest frequency shift is least. "
    text = (
        f"{pads if handling.pads else ''}Cross: hit here. Ring with a point: measure here. "
        "The table gives the deflection of each mode there, as a share of its largest."
    )
    return (
        Drawing(
            _NAME,
            partial(plate_figure, [specimen], lambda axes, _: _draw(axes, handling)),
            Caption(text, handling.sentence),
        ),
    )


def _draw(axes: Axes, handling: Handling) -> None:
    style: dict[str, Any] = {"linestyle": "none", "zorder": 4, "clip_on": False}
    for places, marker, colour, size in (
        (handling.pads, "o", BEFORE, 11),
        (handling.hits, "x", PREDICTED, 10),
        ([handling.sensor], "o", PREDICTED, 9),
        ([handling.sensor], ".", PREDICTED, 5),
    ):
        if places:
            x, y = zip(*places, strict=True)
            axes.plot(x, y, marker, markersize=size, mec=colour, mew=1.8, mfc="none", **style)
