"""Layups one step from the stated one: a ply missing, or two neighbours exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from cpam_bayes.effects.effect import Effect, PlateFacts, with_state
from cpam_bayes.mechanics.problem import Array, PlateState, Problem, Values
from cpam_bayes.plate.laminate import (
    CURVATURE,
    MEMBRANE,
    LaminateGeometry,
    PlyStack,
    angle_functions,
    equal_plies,
    laminate_geometry,
)
from cpam_bayes.plate.layup import Layup, PlyKind

# Most neighbours of a long layup that are weighed: those whose bending stiffness differs most.
MOST = 24
# Difference of lamination parameters of unit plies below which two are equal.
_SAME = 1e-6


@dataclass(frozen=True, slots=True)
class Step:
    """One step from the stated layup.

    missing, exchanged : numbers from 0, bottom first, of plies that are missing, and that have changed places
        with the next one
    """

    missing: tuple[int, ...] = ()
    exchanged: tuple[int, ...] = ()

    @property
    def text(self) -> str:
        """Text of the step, which counts plies from 1."""
        if self.missing:
            numbers = " and ".join(str(i + 1) for i in self.missing)
            return f"{'ply' if len(self.missing) == 1 else 'plies'} {numbers} missing"
        return f"plies {', '.join(f'{i + 1} and {i + 2}' for i in self.exchanged)} exchanged"

    def order(self, n_plies: int) -> list[int]:
        """Numbers in the stated layup of the plies that remain, bottom to top."""
        order = list(range(n_plies))
        for i in self.exchanged:
            order[i], order[i + 1] = i + 1, i
        return [i for i in order if i not in self.missing]


def neighbours(layup: Layup, most: int = MOST) -> tuple[Step, ...]:
    """Steps from a known layup to layups with another bending stiffness, each of these once.

    Layups with the same A and D, and the same B up to its sign, are one. The farthest come first, ``most`` at
    most: those whose bending stiffness differs most from the stated one, by lamination parameters of unit
    plies |d - d_0| + 3/4 |b -+ b_0| (|b| + |b_0|).
    """
    plies, functions, steps = _stated(layup), _functions(layup), list(_steps(layup))
    stated = _Parameters.of(plies, functions)
    orders = (step.order(layup.n_plies) for step in steps)
    found = [_Parameters.of(plies.reordered(order), functions[order]) for order in orders]
    # rounded, so that the first of two equal layups stays
    farthest = sorted(range(len(steps)), key=lambda i: -round(found[i].distance(stated), 9))
    kept: list[int] = []
    for i in farthest:
        is_known = found[i].bends_like(stated) or any(found[i].is_like(found[j]) for j in kept)
        if not is_known and len(kept) < most:
            kept.append(i)
    return tuple(steps[i] for i in kept)


def _steps(layup: Layup) -> Iterator[Step]:
    """All steps; of a run of equal plies only the first is removed, and only its ends are exchanged."""
    n, plies = layup.n_plies, _plies(layup)
    ends = [i for i, (a, b) in enumerate(pairwise(plies)) if a != b]
    for i in (0, *(end + 1 for end in ends)):
        yield Step(missing=(i,))
        if layup.is_symmetric and i < n - 1 - i:
            yield Step(missing=(i, n - 1 - i))
    for i in ends:
        yield Step(exchanged=(i,))
        if layup.is_symmetric and i + 1 < n - 2 - i:
            yield Step(exchanged=(i, n - 2 - i))


def _plies(layup: Layup) -> list[tuple[float, PlyKind | None]]:
    kinds = layup.kinds or (None,) * layup.n_plies
    return list(zip(layup.angles_deg.tolist(), kinds, strict=True))


@dataclass(frozen=True, slots=True)
class _Parameters:
    """Lamination parameters of a layup for A, B and D, each of the size of its angle functions."""

    a: Array
    b: Array
    d: Array

    @classmethod
    def of(cls, plies: PlyStack, functions: Array) -> _Parameters:
        """Lamination parameters, (k,) each, of plies with angle functions (n_plies, k)."""
        z = plies.interfaces
        return cls(np.diff(z) @ functions, 2.0 * np.diff(z**2) @ functions, 4.0 * np.diff(z**3) @ functions)

    def _apart(self, other: _Parameters) -> float:
        """Distance of B from that of the other layup or of the other turned over, the smaller one."""
        return float(min(np.abs(self.b - other.b).max(), np.abs(self.b + other.b).max()))

    def bends_like(self, other: _Parameters) -> bool:
        return bool(np.abs(self.d - other.d).max() < _SAME) and self._apart(other) < _SAME

    def is_like(self, other: _Parameters) -> bool:
        return self.bends_like(other) and bool(np.abs(self.a - other.a).max() < _SAME)

    def distance(self, other: _Parameters) -> float:
        """Distance in bending stiffness, less the part lost to stretching: B^T A^-1 B is quadratic in B."""
        size = float(np.linalg.norm(self.b) + np.linalg.norm(other.b))
        return float(np.linalg.norm(self.d - other.d)) + 0.75 * self._apart(other) * size


def _stated(layup: Layup) -> PlyStack:
    return layup.plies or equal_plies(layup.n_plies)


def _functions(layup: Layup) -> Array:
    """Angle functions (n_plies, 5 n_materials) of the stated plies, separate columns for each material."""
    plies = _stated(layup)
    is_of = plies.material[:, None] == np.arange(len(plies.names))
    apart = is_of[:, :, None] * angle_functions(layup.angles_deg)[:, None, :]
    return np.asarray(apart.reshape(layup.n_plies, -1))


def _on_plate(facts: PlateFacts) -> tuple[Effect, ...]:
    """One form for each neighbour of the stated layup."""
    return tuple(
        replace(LAYUP, change=partial(_laid_up, step), variant=step.text) for step in neighbours(facts.layup)
    )


def _laid_up(step: Step, problem: Problem, facts: PlateFacts) -> Problem:
    """Problem with the plies after a step, which fill h; without functions for coupling, reduced bending."""
    layup = facts.layup
    order = step.order(layup.n_plies)
    plies = _stated(layup).reordered(order)
    geometry = laminate_geometry(layup.angles_deg[order], plies=plies)
    changed = partial(_of_layup, geometry, plies if layup.kinds else None, layup.is_symmetric)
    return with_state(problem, changed)


def _of_layup(
    geometry: LaminateGeometry, plies: PlyStack | None, uncouples: bool, state: PlateState, values: Values
) -> PlateState:
    del values
    changes = (*state.changes, uncoupled) if uncouples and not geometry.symmetric else state.changes
    return replace(state, layup=geometry, symmetric=geometry.symmetric, plies=plies, changes=changes)


def uncoupled(stiffness: Array) -> Array:
    """The stiffness with the reduced bending stiffness D - B A^-1 B in place of B and D, (..., 8, 8).

    It is that of a plate whose midplane is free of forces (Ashton and Whitney, Theory of Laminated
    Plates, section 7.3).
    """
    b = stiffness[..., MEMBRANE, CURVATURE]
    found = stiffness.copy()
    found[..., CURVATURE, CURVATURE] -= np.swapaxes(b, -1, -2) @ np.linalg.solve(
        stiffness[..., MEMBRANE, MEMBRANE], b
    )
    found[..., MEMBRANE, CURVATURE] = found[..., CURVATURE, MEMBRANE] = 0.0
    return found


def _is_mixed(facts: PlateFacts) -> bool:
    """Whether plies are known and not all alike."""
    return not facts.isotropic and not facts.layup.n_unknown and len(set(_plies(facts.layup))) > 1


LAYUP = Effect(
    name="layup",
    title="laid up otherwise",
    family="layup",
    belongs_to="plate",
    parameters=(),
    note="a ply missing or two neighbours exchanged, on one half or on both; h stays, and bending that "
    "couples with stretching has D - B A^-1 B",
    check="Count the plies of an offcut under the microscope, and compare their order with the layup sheet.",
    on_plate=_on_plate,
    applies_to=_is_mixed,
)
