"""The probability of a given stacking sequence, listed or not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.conditional.bases import of_sequence
from cpam_bayes.stacking.conditional.importance import importance_evidence
from cpam_bayes.stacking.conditional.posterior import ConditionalFits, fit_conditionals
from cpam_bayes.stacking.records import StackingPosterior
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class GivenLayup:
    """A stacking sequence beside the posterior over all of them.

    angles_deg : (k,).
    index : of its class in ``StackingPosterior.top``, ``None`` where it is not listed.
    probability : of the single sequence.
    log_evidence, log_evidence_error : nats.
    k_hat : Pareto shape of the largest weights of its importance sampling.
    fits : of this sequence, one row.
    """

    angles_deg: Array
    index: int | None
    probability: float
    log_evidence: float
    log_evidence_error: float
    k_hat: float
    fits: ConditionalFits

    @property
    def rank(self) -> int | None:
        """Rank of its class, 1 for the most probable; ``None`` beyond the list."""
        return None if self.index is None else self.index + 1


@single_blas_thread
def given_layup(answer: StackingPosterior, angles_deg: Array, log2_points: int = 11) -> GivenLayup:
    """The evidence and probability of a stacking sequence (k,) on the grid.

    p = Z / (sum of all evidences). One that is not listed is optimised from the optima of those that are.

    Raises ``ValueError`` for an angle that is not on the grid.
    """
    angles = np.asarray(angles_deg, dtype=float)
    away = np.abs(angles[:, None] - answer.grid_deg)
    sequence = np.argmin(np.minimum(away, 180.0 - away), axis=1)
    on_grid = answer.grid_deg[sequence]
    n_angles = answer.conditional.n_angles
    if len(angles) != n_angles or np.any(np.abs((on_grid - angles + 90.0) % 180.0 - 90.0) > 1e-6):
        raise ValueError(
            f"sequence {'/'.join(f'{a:g}' for a in angles)}: accepted: {n_angles} angles on the "
            f"grid of {answer.specimen.angle_grid_deg:g} degrees"
        )
    listed = answer.components
    i = int(answer.classes_of(sequence[None])[0])
    if i >= 0:
        return GivenLayup(
            on_grid,
            i,
            float(answer.probability[i]),
            float(answer.log_evidence[i]),
            float(answer.log_evidence_error[i]),
            float(listed.conditionals.k_hat[i]),
            listed.fits[i : i + 1],
        )
    best = np.argsort(-listed.fits.log_evidence, kind="stable")[:4]
    starts = np.concatenate((listed.fits.x[best], answer.drawn.fits.x[:4]))
    fits = fit_conditionals(answer.conditional, on_grid[None], starts)
    posterior = of_sequence(answer.conditional, on_grid, answer.conditional.least_noise(fits.x))
    conditional = importance_evidence(posterior, on_grid[None], fits, log2_points)
    log_evidence = float(conditional.log_evidence[0])
    total = answer.log_evidence_total + float(np.log(answer.enumerated))
    probability = float(np.exp(log_evidence - total))
    error, k_hat = float(conditional.error[0]), float(conditional.k_hat[0])
    return GivenLayup(on_grid, None, probability, log_evidence, error, k_hat, fits)
