"""Plane motions that map a rectangle or square onto itself, acting on its edges, points and ply angles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from numpy.typing import NDArray

Array = NDArray[Any]

# Change of the ply angles by the motions of each kind, in degrees. Each is its own inverse, modulo 180.
ANGLE_MOTIONS: Final[dict[str, Callable[[Array], Array]]] = {
    "": lambda t: t,
    "mirror image": lambda t: -t,
    "quarter turn": lambda t: t + 90.0,
    "diagonal mirror image": lambda t: 90.0 - t,
}
# Kinds that exchange the sides: for squares only.
EXCHANGES: Final = ("quarter turn", "diagonal mirror image")


class Motion(NamedTuple):
    """A motion of the plate onto itself.

    kind : key of ``ANGLE_MOTIONS``
    edges : where each edge (x0, y0, x1, y1) comes from
    point : image of a point (x / length, y / width), or of arrays
    """

    kind: str
    edges: tuple[int, int, int, int]
    point: Callable[[Any, Any], tuple[Any, Any]]

    def keeps_edges(self, edges: str) -> bool:
        """Whether every edge maps onto one with the same condition."""
        return all(edges[old] == new for old, new in zip(self.edges, edges, strict=True))


MOTIONS: Final = (
    Motion("", (0, 1, 2, 3), lambda x, y: (x, y)),
    Motion("mirror image", (0, 3, 2, 1), lambda x, y: (x, 1.0 - y)),
    Motion("mirror image", (2, 1, 0, 3), lambda x, y: (1.0 - x, y)),
    # half a turn
    Motion("", (2, 3, 0, 1), lambda x, y: (1.0 - x, 1.0 - y)),
    Motion("quarter turn", (3, 0, 1, 2), lambda x, y: (1.0 - y, x)),
    Motion("quarter turn", (1, 2, 3, 0), lambda x, y: (y, 1.0 - x)),
    Motion("diagonal mirror image", (1, 0, 3, 2), lambda x, y: (y, x)),
    Motion("diagonal mirror image", (3, 2, 1, 0), lambda x, y: (1.0 - y, 1.0 - x)),
)
