"""Measured mode shapes at places of the plate, whatever unit and origin their file has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.plate.mode_shapes.universal import UniversalFileError, UniversalModes

__all__ = ["MeasuredShapes", "placed_shapes"]

Array = NDArray[Any]

# Units that a file without dataset 164 may have, m; the largest that fits the plate is taken.
_UNITS: Final = (1.0, 1e-3)
# How far beyond an edge a node may lie, and how much of the plate nodes must span, fractions of a side.
_BEYOND, _LEAST_SPAN = 0.02, 0.1
_MIN_NODES: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredShapes:
    """Shapes of measured modes, in the order of their frequencies.

    nodes : (n,) numbers
    points : (n, 2) x and y, m from the corner x = y = 0
    values : (n_modes, 3, n) displacements along x, y and z, of any scale, real or complex
    """

    nodes: Array
    points: Array
    values: Array

    def __post_init__(self) -> None:
        for name in ("nodes", "points", "values"):
            array = np.array(getattr(self, name))
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @property
    def directions(self) -> Array:
        """Directions in which some mode moves, (3,) bool; the others were not measured."""
        return np.asarray(np.any(self.values != 0.0, axis=(0, 2)))


def placed_shapes(modes: UniversalModes, length: float, width: float) -> tuple[MeasuredShapes, str]:
    """The shapes at the nodes that all modes have, on a plate of length by width, m; and how, in words.

    The unit is that of dataset 164, or else the larger one of m and mm with which the nodes lie on the
    plate. The origin is the corner x = y = 0, or the middle of the plate. Raises ``UniversalFileError``
    where the nodes cannot be placed so.
    """
    numbers = [one.nodes for one in modes.modes]
    nodes = np.array(sorted(set.intersection(*(set(n.tolist()) for n in numbers))), dtype=int)
    unplaced = [str(node) for node in nodes if int(node) not in modes.places]
    if unplaced:
        listed = " ".join(unplaced[:6])
        raise UniversalFileError(f"no coordinates of the nodes {listed}, accepted: dataset 15 or 2411 of all")
    if len(nodes) < _MIN_NODES:
        raise UniversalFileError(
            f"{len(nodes)} nodes that all modes have, accepted: {_MIN_NODES} or more, best along all edges"
        )
    places = np.stack([modes.places[int(node)] for node in nodes])
    points, words = _on_plate(places, modes.unit, np.array([length, width]))
    values = np.stack([one.values[:, _columns(one.nodes, nodes)] for one in modes.modes])
    if not np.all(np.any(values != 0.0, axis=(1, 2))):
        raise UniversalFileError("a mode that moves at no node, accepted: a shape of every mode")
    return MeasuredShapes(nodes, points, values), f"{len(nodes)} nodes in {words}"


def _columns(numbers: Array, wanted: Array) -> Array:
    order = np.argsort(numbers, kind="stable")
    return np.asarray(order[np.searchsorted(numbers[order], wanted)])


def _on_plate(places: Array, unit: float | None, sides: Array) -> tuple[Array, str]:
    """Points (n, 2), m from the corner, of places (n, 3); and unit and origin in words."""
    for one in _UNITS if unit is None else (unit,):
        scaled = one * places
        if np.ptp(scaled[:, 2]) > _LEAST_SPAN * sides.max():
            continue
        for origin, shift in (("the corner", 0.0 * sides), ("the middle", 0.5 * sides)):
            points = scaled[:, :2] + shift
            inside = np.all((points >= -_BEYOND * sides) & (points <= (1.0 + _BEYOND) * sides))
            if inside and np.any(np.ptp(points, axis=0) > _LEAST_SPAN * sides):
                stated = "" if unit is not None else ", by the size of the plate"
                return np.clip(points, 0.0, sides), f"{_unit_name(one)}{stated}, from {origin}"
    raise UniversalFileError(_off_plate(places, unit, sides))


def _off_plate(places: Array, unit: float | None, sides: Array) -> str:
    spans = " ".join(
        f"{axis} {low:.4g} to {high:.4g}"
        for axis, low, high in zip("xyz", places.min(axis=0), places.max(axis=0), strict=True)
    )
    of = "without a dataset 164" if unit is None else f"in {_unit_name(unit)} by dataset 164"
    return (
        f"nodes that do not lie on the plate, received {spans}, {of}, accepted: the plane z = 0 with x "
        f"from 0 to {1e3 * sides[0]:g} mm and y from 0 to {1e3 * sides[1]:g} mm, or as much about the middle"
    )


def _unit_name(unit: float) -> str:
    names: Sequence[tuple[float, str]] = (
        (1.0, "m"),
        (1e-3, "mm"),
        (1e-2, "cm"),
        (0.0254, "in"),
        (0.3048, "ft"),
    )
    return next((name for size, name in names if abs(unit / size - 1.0) < 1e-3), f"units of {unit:g} m")
