"""Places that no frequency distinguishes: images under a symmetry of the plate, and two masses exchanged.

A posterior draw is replaced by its image nearest to the optimum: a mean over images would be a place where
nothing is.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.effects import Effect, PlateFacts
from cpam_bayes.plate.motions import ANGLE_MOTIONS, EXCHANGES, MOTIONS, Motion

Array = NDArray[np.float64]
Point = tuple[float, float]

# Relative difference of the sides up to which a plate counts as square.
_SQUARE = 2e-3


def images(facts: Sequence[PlateFacts]) -> tuple[Motion, ...]:
    """Motions that map the plate onto itself in each of its tests, the identity first."""
    every = MOTIONS[:1] if any(each.loaded for each in facts) else MOTIONS
    return tuple(motion for motion in every if all(_is_kept(each, motion) for each in facts))


def _is_kept(facts: PlateFacts, motion: Motion) -> bool:
    """Whether a motion preserves a plate: its sides, its edges, the angles of its plies."""
    if motion.kind in EXCHANGES and abs(facts.length / facts.width - 1.0) > _SQUARE:
        return False
    angles = np.asarray(facts.layup.angles_deg, float)
    turned = (ANGLE_MOTIONS[motion.kind](angles) - angles + 90.0) % 180.0 - 90.0
    return motion.keeps_edges(facts.edges) and (facts.isotropic or bool(np.all(np.abs(turned) < 1e-9)))


def _moved(places: Array, motion: Motion) -> Array:
    """Images under a motion of places (..., 2), 0 to 1."""
    return np.stack(motion.point(places[..., 0], places[..., 1]), axis=-1)


def images_of(place: Point, facts: Sequence[PlateFacts], apart: Point = (1e-6, 1e-6)) -> tuple[Point, ...]:
    """A place over the sides and its images, which no frequency distinguishes from it.

    apart : places that differ by less, in x and in y, are one
    """
    found: list[Array] = []
    for motion in images(facts):
        at = _moved(np.array(place), motion)
        if all(np.any(np.abs(at - other) > apart) for other in found):
            found.append(at)
    return tuple((float(x), float(y)) for x, y in found)


def laid_on(
    draws: Array, best: Array, effects: Sequence[Effect], columns: dict[str, int], facts: Sequence[PlateFacts]
) -> Array:
    """Draws (m, n) with every place at its image nearest to the optimum, two equal effects in its order.

    best : (n,) optimum. effects : of the hypothesis, some at a free place
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


def _nearest(places: Array, best: Array, every: Sequence[Motion]) -> tuple[Array, Array]:
    """Image of each place (m, 2) nearest to a point, and its squared distance, (m,)."""
    moved = np.array([_moved(places, motion) for motion in every])
    distance = np.sum((moved - best) ** 2, axis=-1)
    at = np.argmin(distance, axis=0)
    rows = np.arange(len(places))
    return moved[at, rows], distance[at, rows]
