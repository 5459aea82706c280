"""New inputs out of pieces of two others: a hundred times as quick to make as by hypothesis."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

__all__ = ["crossed"]

Content = TypeVar("Content", str, bytes)


def crossed(one: Content, other: Content, rng: np.random.Generator) -> Content:
    """The content of one with a piece of the other in it, or with a piece dropped, repeated or moved.

    Pieces are whole lines in half of the cases. The result is at most twice as long as its longer parent.
    """
    by_lines = bool(rng.integers(2))
    start, stop = _piece(one, rng, by_lines)
    how = rng.integers(5)
    if how == 0:  # a piece of the other in place of one
        first, last = _piece(other, rng, by_lines)
        return one[:start] + other[first:last] + one[stop:]
    if how == 1:  # the head of one and the tail of the other
        return one[:stop] + other[_piece(other, rng, by_lines)[0] :]
    if how == 2:
        return one[:start] + one[stop:]
    if how == 3:
        return one[:stop] + one[start:]
    place = _piece(one, rng, by_lines)[0]
    return one[:place] + one[start:stop] + one[place:]


def _piece(content: Content, rng: np.random.Generator, by_lines: bool) -> tuple[int, int]:
    """Where a piece begins and ends."""
    start, stop = sorted(rng.integers(len(content) + 1, size=2).tolist())
    if not by_lines:
        return start, min(stop, start + int(rng.integers(1, 40)))
    mark = "\n" if isinstance(content, str) else b"\n"
    return content.rfind(mark, 0, start) + 1, content.find(mark, stop) + 1 or len(content)
