"""Constraints on the elastic constants that cut a posterior, or that an optimum lies on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate.records import Hybrid, Material

__all__ = ["constraint_warnings", "cut_warnings", "cutting_constraints", "limiting_constraints"]

Array = NDArray[Any]

# A constraint cuts a posterior that has this fraction of its draws within so many of their standard
# deviations of it: of a normal density that is one with 5 % or more of it beyond.
_NEAR_SD, _LEAST_FRACTION = 0.1, 0.01
# An optimum lies on a constraint that a step of this fraction of a search interval breaks.
_STEP: Final = 1e-3
_BEYOND: Final = (
    '; if the ply need not be transversely isotropic about axis 1, say symmetry = "orthotropic" in [material]'
)


def cutting_constraints(margins: Array, constraints: Sequence[str]) -> tuple[str, ...]:
    """The constraints that draws crowd against.

    margins : (m, n_constraints) of equally probable draws, see `constraint_margins`; (n_constraints,) where
        no draw moves them
    constraints : what each is, n_constraints
    """
    margins = np.atleast_2d(margins)
    near = np.mean(margins < _NEAR_SD * margins.std(axis=0), axis=0)
    return _named(constraints, near >= _LEAST_FRACTION)


def limiting_constraints(material: Material | Hybrid, unknowns: ParameterSet, x: Array) -> tuple[str, ...]:
    """The constraints that a small step of one constant breaks; x : (n,), an optimum."""
    step = _STEP * np.diag(unknowns.upper - unknowns.lower)
    margins = np.atleast_2d(material.margins(unknowns.mapping(np.concatenate((x + step, x - step)))))
    return _named(material.constraints, np.any(margins <= 0.0, axis=0))


def _named(constraints: Sequence[str], chosen: Array) -> tuple[str, ...]:
    return tuple(text for text, is_chosen in zip(constraints, chosen, strict=True) if is_chosen)


def cut_warnings(material: Material | Hybrid, draws: Mapping[str, Array]) -> tuple[str, ...]:
    """A warning for each constraint that cuts a posterior; draws : name -> (m,), equally probable."""
    constraints = cutting_constraints(material.margins(draws), material.constraints)
    return constraint_warnings("the posterior is cut by the constraint", constraints)


def constraint_warnings(what: str, constraints: tuple[str, ...]) -> tuple[str, ...]:
    """A warning for each constraint; what : what it does, up to its name."""
    return tuple(
        f"{what} {text}: the frequencies ask for constants beyond it, which were not allowed"
        f"{_BEYOND if 'eq. (9)' in text else ''}"
        for text in constraints
    )
