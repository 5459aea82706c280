"""Places that no frequency tells apart: of a plate that is its own image, and of two masses each other's.

A draw of the posterior is told by the image of it that lies nearest to the optimum: a mean over images would
be a place where nothing is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.effects import Effect, PlateFacts

Array = NDArray[np.float64]
Point = tuple[float, float]

# Relative difference of the sides up to which a plate counts as square.
_SQUARE = 2e-3


@dataclass(frozen=True, slots=True)
class Image:
    """A map of places over the sides: x and y exchanged or not, then each mirrored or not."""

    exchanged: bool = False
    flipped: tuple[bool, bool] = (False, False)

    def of(self, places: Array) -> Array:
        """The images of places (..., 2), 0 to 1."""
        moved = places[..., ::-1] if self.exchanged else places
        return np.where(self.flipped, 1.0 - moved, moved)

    def keeps(self, facts: PlateFacts) -> bool:
        """Whether a plate looks the same afterwards: its sides, its edges, the angles of its plies."""
        x0, y0, x1, y1 = tuple(facts.edges)
        if self.exchanged:
            if abs(facts.length / facts.width - 1.0) > _SQUARE:
                return False
            x0, y0, x1, y1 = y0, x0, y1, x1
        if self.flipped[0]:
            x0, x1 = x1, x0
        if self.flipped[1]:
            y0, y1 = y1, y0
        return f"{x0}{y0}{x1}{y1}" == facts.edges and self._keeps_plies(facts)

    def _keeps_plies(self, facts: PlateFacts) -> bool:
        if facts.isotropic:
            return True
        angles = np.asarray(facts.layup.angles_deg, float)
        moved = 90.0 - angles if self.exchanged else angles
        moved = -moved if self.flipped[0] != self.flipped[1] else moved
        return bool(np.all(np.abs((moved - angles + 90.0) % 180.0 - 90.0) < 1e-9))


_EVERY = tuple(Image(exchanged, (x, y)) for exchanged, x, y in product((False, True), repeat=3))


def images(facts: Sequence[PlateFacts]) -> tuple[Image, ...]:
    """The maps after which a plate looks the same in each of its tests, the identity first."""
    every = _EVERY[:1] if any(each.loaded for each in facts) else _EVERY
    return tuple(image for image in every if all(map(image.keeps, facts)))


def images_of(place: Point, facts: Sequence[PlateFacts], apart: Point = (1e-6, 1e-6)) -> tuple[Point, ...]:
    """A place over the sides and those that no frequency tells from it.

    apart : places that differ by less, in x and in y, are one
    """
    found: list[Array] = []
    for image in images(facts):
        at = image.of(np.array(place))
        if all(np.any(np.abs(at - other) > apart) for other in found):
            found.append(at)
    return tuple((float(x), float(y)) for x, y in found)


def laid_on(
    draws: Array, best: Array, effects: Sequence[Effect], columns: dict[str, int], facts: Sequence[PlateFacts]
) -> Array:
    """Draws (m, n) with every place at its image nearest to the optimum, and two alike in its order.

    best : (n,) the optimum. effects : those of which some may be anywhere
    columns : of their parameters, by name
    """
    laid, every = draws.copy(), images(facts)
    anywhere = [e for e in effects if e.is_anywhere]
    of = [[columns[p.name] for p in e.parameters] for e in anywhere]
    places = [[columns[p.name] for p in e.coordinates[:2]] for e in anywhere]
    for (i, first), (j, second) in product(enumerate(anywhere), repeat=2):
        if second.repeats is None or second.repeats.name != first.name:
            continue
        own = [_nearest(laid[:, places[k]], best[places[k]], every)[1] for k in (i, j)]
        across = [_nearest(laid[:, places[k]], best[places[m]], every)[1] for k, m in ((i, j), (j, i))]
        other = np.flatnonzero(across[0] + across[1] < own[0] + own[1])
        rows = other[:, None]
        laid[rows, of[i] + of[j]] = laid[rows, of[j] + of[i]]
    for at in places:
        laid[:, at] = _nearest(laid[:, at], best[at], every)[0]
    return laid


def _nearest(places: Array, best: Array, every: Sequence[Image]) -> tuple[Array, Array]:
    """Of each place (m, 2) the image nearest to a point, and its distance from there squared, (m,)."""
    moved = np.array([image.of(places) for image in every])
    distance = np.sum((moved - best) ** 2, axis=-1)
    at = np.argmin(distance, axis=0)
    rows = np.arange(len(places))
    return moved[at, rows], distance[at, rows]
