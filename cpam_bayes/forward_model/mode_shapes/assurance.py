"""Modal assurance of measured with predicted shapes, and which measured mode is which by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.plate.mode_shapes.measured import MeasuredShapes

__all__ = ["AmbiguousShapesError", "Assignment", "ShapePairing", "modal_assurance", "pair_by_assurance"]

Array = NDArray[Any]

# Square of the error of a shape, relative to its size, that is usual: a MAC of 0.98 with its own mode.
_USUAL_ERROR: Final = 0.02
# Modal assurance below which a measured shape is rather no mode of the model.
_LEAST_ASSURANCE: Final = 0.3
# Assignments less probable than the best by this factor are left out, and at most so many are kept.
_NEGLIGIBLE, _MOST_KEPT = 1e-3, 64
# Assignments of one group of shapes that are looked at, and what those kept must have of the probability.
_MOST_TRIED, _LEAST_KEPT = 5000, 0.95
# A mode of which the measured directions hold less than this of its square does not show.
_VISIBLE: Final = 0.01
# A mode that is as probable as this is the one, as a label would say.
_FIXED: Final = 0.999


class AmbiguousShapesError(ValueError):
    """Shapes that do not tell modes apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """One way of giving measured shapes to modes.

    modes : (n,) mode of each shape, -1 for none
    log_probability : of it, among all that are kept
    """

    modes: Array
    log_probability: float


@dataclass(frozen=True, slots=True, eq=False)
class ShapePairing:
    """Which measured shape is which of k modes.

    assurance : (n, k) modal assurance
    candidates : (k,) the modes, at the reference constants
    directions : effective number of independent shapes that the nodes tell apart
    assignments : the most probable one first
    """

    assurance: Array
    candidates: tuple[Mode, ...]
    directions: float
    assignments: tuple[Assignment, ...]

    @property
    def modes(self) -> Array:
        """The most probable mode of each shape, -1 for none, (n,)."""
        return self.assignments[0].modes

    @property
    def probability(self) -> Array:
        """Probability of each mode for each shape, (n, k)."""
        p = np.zeros_like(self.assurance)
        for assignment in self.assignments:
            rows = np.flatnonzero(assignment.modes >= 0)
            p[rows, assignment.modes[rows]] += np.exp(assignment.log_probability)
        return p

    @property
    def fixed(self) -> Array:
        """Shapes whose mode is certain, as if it were labelled, (n,) bool."""
        return np.asarray(self.probability.max(axis=1) >= _FIXED)


def modal_assurance(measured: MeasuredShapes, predicted: Array) -> Array:
    """MAC_ij = |phi_i^H psi_j|^2 / (phi_i^H phi_i  psi_j^H psi_j), (n, k).

    Allemang, Sound and Vibration 37, 2003.
    Directions in which no measured mode moves were not measured and are left out. A mode that hardly moves
    in the others has 0 with every shape.

    predicted : (k, 3, n_nodes) u, v, w at the nodes
    """
    seen = measured.directions
    phi = measured.values[:, seen].reshape(len(measured.values), -1)
    psi = predicted[:, seen].reshape(len(predicted), -1)
    own = np.sum(psi**2, axis=1)
    shows = own > _VISIBLE * np.sum(predicted**2, axis=(1, 2))
    sizes = np.sum(np.abs(phi) ** 2, axis=1)[:, None] * np.where(shows, own, 1.0)
    return np.asarray(np.where(shows, np.abs(phi.conj() @ psi.T) ** 2 / sizes, 0.0))


def pair_by_assurance(
    measured: MeasuredShapes, predicted: Array, candidates: tuple[Mode, ...]
) -> ShapePairing:
    """The probabilities of all one-to-one pairings of measured shapes with modes, by their assurance.

    A measured shape is its mode's times a factor plus an error in each of d directions, of one unknown size
    that is usually sqrt(0.02) of the shape: a Student-t, with
    p(shape i | mode j) ~ (0.02 + 1 - MAC_ij)^(-d/2). d is one less than the effective number of shapes that
    the nodes tell apart, (sum s^2)^2 / sum s^4 of the singular values s of the predicted shapes: errors of
    a model or of a test are smooth over a plate, so that further nodes add little. A shape whose assurance
    is below 0.3 with all modes is none of them.

    predicted : (k, 3, n_nodes) u, v, w of the candidates at the nodes
    Raises ``AmbiguousShapesError`` where no few pairings hold the probability.
    """
    assurance = modal_assurance(measured, predicted)
    directions = _directions(predicted[:, measured.directions].reshape(len(predicted), -1))
    power = -0.5 * max(directions - 1.0, 0.0)
    log_weight = power * np.log(_USUAL_ERROR + np.maximum(1.0 - assurance, 0.0))
    none = power * np.log(_USUAL_ERROR + 1.0 - _LEAST_ASSURANCE)
    modes = _most_probable(log_weight, none)
    rows = np.flatnonzero(modes >= 0)
    candidate = assurance >= _LEAST_ASSURANCE
    kept, lost = [(0.0, modes)], 0.0
    for group in _groups(candidate[rows] & _near(log_weight[rows], modes[rows])):
        found = _assignments(log_weight[rows[group]], candidate[rows[group]], modes[rows[group]])
        kept, dropped = _combined(kept, found, rows[group])
        lost += dropped
    if lost > -np.log(_LEAST_KEPT):
        raise AmbiguousShapesError(
            f"the shapes at {len(measured.nodes)} nodes do not tell the modes apart, accepted: shapes at "
            "more nodes, best along all edges, or a list of frequencies_hz without them"
        )
    values = np.array([value for value, _ in kept])
    values -= logsumexp(values)
    order = np.argsort(-values, kind="stable")
    assignments = tuple(Assignment(kept[i][1], float(values[i])) for i in order)
    return ShapePairing(assurance, candidates, directions, assignments)


def _directions(shapes: Array) -> float:
    sizes = np.linalg.norm(shapes, axis=1)
    s = np.linalg.svd(shapes[sizes > 0.0] / sizes[sizes > 0.0, None], compute_uv=False) ** 2
    return float(np.sum(s) ** 2 / np.sum(s**2))


def _most_probable(log_weight: Array, none: float) -> Array:
    """The best one-to-one pairing, (n,), -1 where a shape is rather no mode."""
    n, k = log_weight.shape
    _, column = scipy.optimize.linear_sum_assignment(
        np.hstack((log_weight, np.full((n, n), none))), maximize=True
    )
    return np.where(column < k, column, -1)


def _near(log_weight: Array, modes: Array) -> Array:
    """Modes that a shape could be: no less probable than its most probable one by the negligible factor."""
    best = log_weight[np.arange(len(modes)), modes]
    return np.asarray(log_weight >= best[:, None] + np.log(_NEGLIGIBLE))


def _groups(candidate: Array) -> list[Array]:
    """Rows that share candidates, those with one candidate of their own left out."""
    touching = (candidate.astype(int) @ candidate.T.astype(int)) > 0
    groups, seen = [], np.zeros(len(candidate), dtype=bool)
    for i in range(len(candidate)):
        if seen[i]:
            continue
        group = np.zeros_like(seen)
        grown = touching[i]
        while (grown != group).any():
            group = grown
            grown = touching[group].any(axis=0)
        seen |= group
        if candidate[group].sum() > 1:
            groups.append(np.flatnonzero(group))
    return groups


def _assignments(log_weight: Array, candidate: Array, modes: Array) -> list[tuple[float, Array]]:
    """One-to-one pairings of a group with their log weights over that of ``modes``, the best ones."""
    n = len(modes)
    relative = np.where(candidate, log_weight - log_weight[np.arange(n), modes][:, None], -np.inf)
    top = relative.max(axis=1)
    rest = np.append(np.cumsum(top[::-1])[::-1], 0.0)  # the most that the rows from i on can add
    found: list[tuple[float, Array]] = []
    tried = 0

    def extend(i: int, value: float, taken: list[int]) -> None:
        nonlocal tried
        tried += 1
        if tried > _MOST_TRIED:
            raise AmbiguousShapesError(
                f"{n} shapes cannot be told apart by modal assurance, accepted: shapes at more nodes, or a "
                "list of frequencies_hz without them"
            )
        if i == n:
            found.append((value, np.array(taken)))
            return
        for j in np.flatnonzero(value + relative[i] + rest[i + 1] >= np.log(_NEGLIGIBLE)):
            if j not in taken:
                extend(i + 1, value + float(relative[i, j]), [*taken, int(j)])

    extend(0, 0.0, [])
    return found


def _combined(
    kept: Sequence[tuple[float, Array]], found: Sequence[tuple[float, Array]], rows: Array
) -> tuple[list[tuple[float, Array]], float]:
    """The best pairs of assignments of other rows and of these, and the log weight that is lost."""
    both = []
    for value, modes in kept:
        for added, of_rows in found:
            changed = modes.copy()
            changed[rows] = of_rows
            both.append((value + added, changed))
    both.sort(key=lambda one: -one[0])
    cut = [one for one in both[:_MOST_KEPT] if one[0] >= both[0][0] + np.log(_NEGLIGIBLE)]
    whole, left = (float(logsumexp([value for value, _ in some])) for some in (both, cut))
    return cut, whole - left
