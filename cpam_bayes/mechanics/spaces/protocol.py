"""What a discretisation must offer: quadrature over a region and its fields at points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from cpam_bayes.mechanics.problem import Derivative, Field, MatrixKind, Region

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Quadrature:
    """Points (n, 2) in reference coordinates and weights (n,) of one region."""

    region: Region
    points: Array
    weights: Array


class Space(Protocol):
    """Trial functions of the five fields on the reference square.

    Every local form is ``B_left.T @ diag(W) @ B_right`` with B from ``evaluate`` and W from
    ``quadrature``; an effect needs nothing else, so it is written once for every space.
    """

    def dimension(self, field: Field) -> int:
        """Number of trial functions of a field."""
        ...

    def quadrature(self, region: Region, matrix: MatrixKind = "stiffness") -> Quadrature:
        """Points and weights that integrate products of two trial functions over the region.

        A space that underintegrates its stiffness says so by ``matrix``.
        """
        ...

    def evaluate(self, field: Field, quadrature: Quadrature, derivative: Derivative) -> Any:
        """Trial functions at points, (n_points, dimension): dense or sparse."""
        ...
