"""Constants that minimise F of eq. (7) for given sequences, many sequences at once.

A sequence is fixed and only the constants are sought: a bounded least-squares problem in four or five
unknowns. All problems of a stack take their damped Gauss-Newton steps together (``maximise``), so that
the model is called once an iteration.

Where two modes cross, sorted frequencies have a kink and steps shrink before the minimum is reached.
Three starts are enough on C1: against fourteen, one of thirty sequences was left 2e-5 of F too high.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.optimise import maximise

Array = NDArray[Any]

# (m, n_constants), (m, k) degrees -> frequencies (m, n_modes), their derivatives (m, n_modes, n_constants).
SequenceModel = Callable[[Array, Array], tuple[Array, Array]]
Feasible = Callable[[Array], NDArray[np.bool_]]


@dataclass(frozen=True, slots=True)
class ConditionalFit:
    """The best constants of m sequences.

    constants : (m, n_constants) SI. values : (m,) F at them. evaluations : parameter sets sent to the
    model, each with derivatives. settled : (m,) bool, no step lowers F by more than the tolerance.
    """

    constants: Array
    values: Array
    evaluations: int
    settled: NDArray[np.bool_]


def fit_constants(
    model: SequenceModel,
    feasible: Feasible,
    angles_deg: Array,
    starts: Array,
    measured: Array,
    lower: Array,
    upper: Array,
    *,
    weight: Array | None = None,
    iterations: int = 40,
    tolerance: float = 1e-9,
) -> ConditionalFit:
    """The constants in a box that minimise F = sum w_i (f_i - measured_i)^2, one set for each sequence.

    Each sequence starts from every row of ``starts``, and the lowest F is kept: F has several minima
    where modes cross. A step that leaves the constraints (9) is not taken.

    angles_deg : (m, k), one row a sequence. starts : (s, n_constants), feasible. measured : (n_modes,)
    Hz. lower, upper : (n_constants,). weight : (n_modes,), by default 1. tolerance : relative decrease
    of F under which a problem is settled.

    Raises ``ValueError`` if a start is not feasible or lies outside the box.
    """
    m, s = len(angles_deg), len(starts)
    if not (np.all(starts >= lower) and np.all(starts <= upper) and np.all(feasible(starts))):
        raise ValueError(
            f"starts of the constants: received {starts.tolist()}, accepted: sets within the bounds "
            "that meet eq. (9)"
        )
    root = np.ones_like(measured) if weight is None else np.sqrt(weight)
    angles = np.repeat(angles_deg, s, axis=0)
    width = upper - lower
    n = len(width)
    evaluations = 0

    def target(z: Array, rows: Array) -> Expansion:
        """-log F in the unit box, whose gains are relative decreases of F, with Gauss-Newton curvature."""
        nonlocal evaluations
        x = lower + width * z
        inside = np.flatnonzero(feasible(x))
        expansion = Expansion(np.full(len(z), -np.inf), np.zeros((len(z), n)), np.zeros((len(z), n, n)))
        if len(inside):
            frequencies, jacobian = model(x[inside], angles[rows[inside]])
            evaluations += len(inside)
            r, j = root * (frequencies - measured), root[:, None] * jacobian * width
            f = np.maximum(np.sum(r**2, axis=1), 1e-300)
            expansion.value[inside] = -np.log(f)
            expansion.gradient[inside] = -2.0 * np.einsum("mij,mi->mj", j, r) / f[:, None]
            expansion.curvature[inside] = 2.0 * np.swapaxes(j, 1, 2) @ j / f[:, None, None]
        return expansion

    start = np.tile((starts - lower) / width, (m, 1))
    bounds = np.zeros(n), np.ones(n)
    maxima = maximise(target, start, *bounds, most_steps=iterations, promised=tolerance)
    f = np.exp(-maxima.expansion.value)
    best = f.reshape(m, s).argmin(axis=1) + s * np.arange(m)
    settled = maxima.converged | (maxima.steps < iterations)
    return ConditionalFit(lower + width * maxima.u[best], f[best], evaluations, settled[best])
