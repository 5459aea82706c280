"""Damage to stored files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

__all__ = ["DAMAGES"]


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
"""What may happen to the arrays of a stored file, by name."""
