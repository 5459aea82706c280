"""Specimens that could be made of the material of a plate: layups, shapes, thicknesses, edges."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from cpam_bayes.errors import LayupError
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.layup import Layup, parse_layup

__all__ = ["Geometry", "geometries", "layups_of", "specimen_of"]

# Usual layups of n plies, each with the number that its pattern takes.
_PATTERNS: Final = (
    (1, "[0_{n}]"),
    (4, "[(0/90)_{n}]_s"),
    (4, "[(45/-45)_{n}]_s"),
    (8, "[(0/45/-45/90)_{n}]_s"),
)
_RATIOS: Final = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
_EDGES: Final = ("FFFF", "CFFF")
# Shapes closer than this, relative, are one.
_SAME: Final = 0.02


@dataclass(frozen=True, slots=True)
class Geometry:
    """A specimen but for the number of its modes; length, width, thickness : m."""

    length: float
    width: float
    thickness: float
    layup: Layup
    edges: str
    is_present: bool

    @property
    def ratio(self) -> float:
        """Length over width."""
        return self.length / self.width


def geometries(
    specimen: Specimen,
    *,
    layups: Sequence[str] | None = None,
    ratios: Sequence[float] | None = None,
    thicknesses_mm: Sequence[float] | None = None,
    edges: Sequence[str] | None = None,
) -> tuple[Geometry, ...]:
    """The plate as it is and all combinations of what may be varied; what is left out takes usual values.

    ratios : of length to width, at the area of the plate
    raises ValueError for a layup or edges that cannot be read
    """
    plate = specimen.plate
    present = Geometry(plate.length, plate.width, plate.thickness, plate.layup, plate.edges, True)
    shapes = _shapes(plate.length, plate.width, ratios)
    thick = [1e-3 * t for t in thicknesses_mm] if thicknesses_mm else [plate.thickness]
    held = [_edges(text) for text in edges] if edges else list(dict.fromkeys((plate.edges, *_EDGES)))
    found = [present]
    for layup in layups_of(specimen, layups):
        for thickness in thick:
            for length, width in shapes:
                found += [Geometry(length, width, thickness, layup, e, False) for e in held]
    distinct = {_key(g): g for g in reversed(found)}  # the present plate stays
    return tuple(distinct[key] for key in dict.fromkeys(map(_key, found)))


def specimen_of(specimen: Specimen, geometry: Geometry) -> Specimen:
    """The specimen made so; its mass follows the volume, known masses keep their place in proportion."""
    plate = specimen.plate
    along, across = geometry.length / plate.length, geometry.width / plate.width
    volume = along * across * geometry.thickness / plate.thickness
    made = replace(
        plate,
        length=geometry.length,
        width=geometry.width,
        thickness=geometry.thickness,
        mass=None if plate.mass is None else plate.mass * volume,
        layup=geometry.layup,
        edges=geometry.edges,
    )
    sensors = tuple(replace(s, x=s.x * along, y=s.y * across) for s in specimen.sensors)
    return replace(specimen, plate=made, sensors=sensors)


def layups_of(specimen: Specimen, layups: Sequence[str] | None) -> tuple[Layup, ...]:
    """The layups asked for, or the one of the plate and usual ones of as many plies."""
    present = specimen.plate.layup
    if present.kinds:
        if layups:
            raise ValueError(f"layups: received for {present.text}, accepted: for plates of equal plies")
        return (present,)
    if layups:
        return tuple(_layup(text) for text in layups)
    n = present.n_plies
    if specimen.material.isotropic:
        return (present,)
    usual = [
        parse_layup(re.sub(r"\((.*)\)_1\b", r"\1", pattern.format(n=n // plies)))
        for plies, pattern in _PATTERNS
        if n % plies == 0
    ]
    every = {tuple(layup.angles_deg): layup for layup in (*reversed(usual), present)}
    others = [layup for layup in usual if every[tuple(layup.angles_deg)] is layup]
    return (present, *others)


def _layup(text: str) -> Layup:
    try:
        layup = parse_layup(text)
    except LayupError as error:
        raise ValueError(f"layups: received {text!r}: {error}") from None
    if layup.n_unknown:
        raise ValueError(f'layups: received {text!r}, accepted: known angles, no "?"')
    return layup


def _edges(text: str) -> str:
    if not re.fullmatch("[FSC]{4}", text):
        raise ValueError(
            f"edges: received {text!r}, accepted: four letters F, S or C for x=0, y=0, x=length, y=width"
        )
    return text


def _shapes(length: float, width: float, ratios: Sequence[float] | None) -> list[tuple[float, float]]:
    """Lengths and widths of plates of one area, ascending by their ratio, the present one as it is."""
    present, side = length / width, math.sqrt(length * width)
    wanted = list(ratios) if ratios else [present, *_RATIOS]
    shapes = []
    for ratio in sorted(set(wanted)):
        near = abs(ratio / present - 1.0) < _SAME
        if near and ratio != present and not ratios:
            continue
        root = math.sqrt(ratio)
        shapes.append((length, width) if near else (side * root, side / root))
    return shapes


def _key(g: Geometry) -> tuple[object, ...]:
    return (g.length, g.width, g.thickness, tuple(g.layup.angles_deg), g.edges)
