"""Constants that minimise F of eq. (7) for given sequences, many sequences at once.

A sequence is fixed and only the constants are sought: a bounded least-squares problem in four or five
unknowns. It is solved by a damped Gauss-Newton method (D. W. Marquardt, J. SIAM 11, 1963, 431-441)
with constants that press on a bound held there. All problems of a stack take their steps together, so
that the model is called once an iteration.

Where two modes cross, sorted frequencies have a kink and steps shrink before the minimum is reached.
Three starts are enough on C1: against fourteen, one of thirty sequences was left 2e-5 of F too high.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# (m, n_constants), (m, k) degrees -> frequencies (m, n_modes), their derivatives (m, n_modes, n_constants).
SequenceModel = Callable[[Array, Array], tuple[Array, Array]]
Feasible = Callable[[Array], NDArray[np.bool_]]

_DAMPING: Final = 1e-3
_GROWTH: Final = 8.0
_SHRINK: Final = 5.0
_LARGEST_DAMPING: Final = 1e8


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
    z = np.tile((starts - lower) / width, (m, 1))  # unit box

    def residuals(at: Array, rows: Array) -> tuple[Array, Array, Array]:
        frequencies, jacobian = model(lower + width * at, angles[rows])
        r = root * (frequencies - measured)
        return r, root[:, None] * jacobian * width, np.sum(r**2, axis=1)

    rows = np.arange(m * s)
    r, j, f = residuals(z, rows)
    evaluations = len(rows)
    damping = np.full(m * s, _DAMPING)
    settled = np.zeros(m * s, dtype=bool)
    for _ in range(iterations):
        rows = rows[~settled[rows]]
        if not rows.size:
            break
        step = _bounded_step(r[rows], j[rows], z[rows], damping[rows])
        trial = np.clip(z[rows] + step, 0.0, 1.0)
        still = np.max(np.abs(trial - z[rows]), axis=1) < 1e-12
        allowed = ~still & np.asarray(feasible(lower + width * trial))
        better = np.zeros(len(rows), dtype=bool)
        gain = np.zeros(len(rows))
        if allowed.any():
            tried = rows[allowed]
            new_r, new_j, new_f = residuals(trial[allowed], tried)
            evaluations += len(tried)
            gain[allowed] = f[tried] - new_f
            better[allowed] = new_f < f[tried]
            taken = better[allowed]
            won = tried[taken]
            z[won], r[won], j[won] = trial[allowed][taken], new_r[taken], new_j[taken]
            f[won] = new_f[taken]
        damping[rows] *= np.where(better, 1.0 / _SHRINK, _GROWTH)
        small = better & (gain <= tolerance * (f[rows] + gain))
        settled[rows] = still | small | (damping[rows] > _LARGEST_DAMPING)
    best = f.reshape(m, s).argmin(axis=1) + s * np.arange(m)
    return ConditionalFit(lower + width * z[best], f[best], evaluations, settled[best])


def _bounded_step(r: Array, j: Array, z: Array, damping: Array) -> Array:
    """Damped Gauss-Newton steps in the unit box, components that press on a bound held, (m, n)."""
    gradient = np.einsum("mij,mi->mj", j, r)
    held = ((z <= 0.0) & (gradient > 0.0)) | ((z >= 1.0) & (gradient < 0.0))
    normal = np.einsum("mij,mik->mjk", j, j)
    n = z.shape[1]
    eye = np.eye(n)
    scale = np.einsum("mii->mi", normal)
    # a floor under the scale, for constants that do not enter at all
    scale = np.maximum(scale, 1e-12 * scale.max(axis=1, keepdims=True) + 1e-300)
    normal = normal + (damping[:, None] * scale)[:, :, None] * eye
    free = ~held
    normal = np.where(free[:, :, None] & free[:, None, :], normal, eye * scale[:, :, None])
    rhs = np.where(free, -gradient, 0.0)
    return np.asarray(np.linalg.solve(normal, rhs[..., None])[..., 0])
