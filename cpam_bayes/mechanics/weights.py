"""Weights of forms on the reference square: products of one function of xi and one of eta.

A product keeps the tensor structure of a Ritz space, and the parities of its factors say which
symmetries of the plate it leaves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

Array = NDArray[Any]


class Profile(Protocol):
    """A function of one reference coordinate, with its parity about the middle: 1, -1, or 0 for none."""

    @property
    def parity(self) -> int:
        """1 even, -1 odd, 0 neither."""
        ...

    @property
    def breaks(self) -> tuple[float, ...]:
        """Points between which a quadrature is smooth enough, none for what varies slowly."""
        ...

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        ...


@dataclass(frozen=True, slots=True)
class Polynomial:
    """A polynomial in s = 2 t - 1, lowest power first."""

    coefficients: tuple[float, ...]

    @property
    def parity(self) -> int:
        """1 if only even powers occur, -1 if only odd ones, 0 otherwise."""
        powers = {k % 2 for k, c in enumerate(self.coefficients) if c != 0.0}
        return {frozenset({0}): 1, frozenset({1}): -1, frozenset(): 1}.get(frozenset(powers), 0)

    @property
    def breaks(self) -> tuple[float, ...]:
        """None."""
        return ()

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return np.asarray(polynomial.polyval(2.0 * t - 1.0, np.array(self.coefficients)))

    def derivative(self, order: int = 1) -> Polynomial:
        """The derivative with respect to s."""
        return Polynomial(tuple(polynomial.polyder(np.array(self.coefficients), order).tolist()))


@dataclass(frozen=True, slots=True)
class _Local:
    """A weight about a centre."""

    centre: float
    width: float

    @property
    def parity(self) -> int:
        """1 about the middle, 0 elsewhere."""
        return 1 if self.centre == 0.5 else 0


@dataclass(frozen=True, slots=True)
class Bell(_Local):
    """exp(-((t - centre) / width)^2 / 2)."""

    @property
    def breaks(self) -> tuple[float, ...]:
        """Panels of two widths, out to where it has vanished."""
        return tuple(self.centre + k * self.width for k in (-8, -4, -2, 0, 2, 4, 8))

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return np.asarray(np.exp(-0.5 * ((t - self.centre) / self.width) ** 2))


@dataclass(frozen=True, slots=True)
class Box(_Local):
    """1 within a width of the centre, 0 elsewhere."""

    @property
    def breaks(self) -> tuple[float, ...]:
        """Its ends."""
        return self.centre - self.width, self.centre + self.width

    def __call__(self, t: Array) -> Array:
        """Values at points (n,) of [0, 1], (n,)."""
        return np.asarray(np.where(np.abs(t - self.centre) <= self.width, 1.0, 0.0))


ONE = Polynomial((1.0,))
LINE = Polynomial((0.0, 1.0))


def power(k: int) -> Polynomial:
    """s to the power k."""
    return Polynomial((0.0,) * k + (1.0,))


@dataclass(frozen=True, slots=True)
class Product:
    """x(xi) times y(eta)."""

    x: Profile
    y: Profile

    def __call__(self, points: Array) -> Array:
        """Values at reference points (n, 2), (n,)."""
        return self.x(points[:, 0]) * self.y(points[:, 1])
