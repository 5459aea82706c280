"""Queries of a posterior over stacking sequences: each angle, the fit of the first one, a given one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.identification.point import bound_of
from cpam_bayes.plate.laminate import equal_plies
from cpam_bayes.plate.layup import Layup
from cpam_bayes.running import single_blas_thread
from cpam_bayes.stacking.conditional import ConditionalFits, fit_conditionals, importance_evidence
from cpam_bayes.stacking.evaluation import of_sequence
from cpam_bayes.stacking.records import StackingPosterior

Array = NDArray[Any]

# Entropies that differ by less, bits, are equal.
_EQUAL_BITS = 0.05


@dataclass(frozen=True, slots=True)
class AngleInformation:
    """How well each unknown angle is determined, and its weight in bending.

    entropy_bits : (k,) of the angles' marginals.
    most_bits : entropy of a uniform marginal.
    bending_fraction : (k,) fraction of the laminate's second moment.
    outer_first : (k,) the unknowns in descending order of that.
    outer_better : whether each angle is determined at least as well as the next one further in, and the first
    better than the last; differences below 0.05 bits count as none.
    """

    entropy_bits: Array
    most_bits: float
    bending_fraction: Array
    outer_first: Array
    outer_better: bool


def entropies(marginals: Array) -> Array:
    """Entropy (k,), nats, of probabilities (k, n): -sum p log p."""
    return np.asarray(-np.sum(marginals * np.log(np.where(marginals > 0, marginals, 1.0)), axis=1))


def bending_fractions(layup: Layup) -> Array:
    """Fraction (k,) of each unknown angle's plies in the second moment of the thickness.

    A ply from z_i to z_(i+1) has (z_(i+1)^3 - z_i^3) / 3 of h^3 / 12, its weight in D.
    """
    plies = layup.plies or equal_plies(layup.n_plies)
    fraction = np.diff((2.0 * plies.interfaces) ** 3) / 2.0
    return np.array([fraction[layup.unknown_index == k].sum() for k in range(layup.n_unknown)])


def angle_information(layup: Layup, marginals: Array) -> AngleInformation:
    """Entropies of the angles' marginals (k, n_grid) and the angles' weight in bending."""
    bits = entropies(marginals) / np.log(2.0)
    fraction = bending_fractions(layup)
    order = np.argsort(-fraction, kind="stable")
    inwards = bits[order]
    return AngleInformation(
        entropy_bits=bits,
        most_bits=float(np.log2(marginals.shape[1])),
        bending_fraction=fraction,
        outer_first=order,
        outer_better=bool(
            np.all(np.diff(inwards) >= -_EQUAL_BITS) and inwards[-1] - inwards[0] > _EQUAL_BITS
        ),
    )


@dataclass(frozen=True, slots=True)
class BestFit:
    """The most probable stacking sequence at its best constants, compared with the measured frequencies.

    constants : SI, by name, with the other parameters.
    mode : (n,) of each frequency, -1 where it is paired with none.
    predicted : (n,) Hz; nan where a frequency of a list that may lack modes is paired with none, by the
    most probable pairing.
    residual : (n,) predicted / measured - 1.
    missed : (k,) Hz, modes in the range of the list that it lacks.
    p_value : probability of a sum of squared residuals at least as large by the stated noise alone,
    chi-square with the number of paired frequencies minus that of constants, at least one, as degrees of
    freedom; ``None`` where the noise is inferred or no frequency is paired.
    noise : relative, root mean square of the stated noise, or posterior mean where it is inferred.
    bounds : constants at a bound, and which, "lower" or "upper".
    """

    constants: Mapping[str, float]
    mode: Array
    predicted: Array
    residual: Array
    missed: Array
    p_value: float | None
    noise: float
    bounds: tuple[tuple[str, str], ...]


def best_fit(answer: StackingPosterior) -> BestFit:
    """Fit of the first listed stacking sequence."""
    template, first = answer.conditional.template, answer.components[:1]
    x, n = first.fits.x, answer.conditional.n_constants
    p = template.parameters
    ends = [bound_of(*row) for row in zip(x[0, :n], p.lower[:n], p.upper[:n], strict=True)]
    bounds = [(name, end) for name, end in zip(p.names, ends, strict=False) if end is not None]
    posterior = answer.conditional.at(answer.top[:1])
    measured, frequencies = template.measurement.frequencies, posterior.predict(x)[0]
    pairing = posterior.most_probable_pairing(x[0])
    paired = pairing.mode >= 0
    predicted = np.where(paired, frequencies[pairing.mode], np.nan)
    p_value = None
    if template.noise_is_inferred:
        noise = float(first.conditionals.mean[0, -1])
    else:
        noise = float(np.sqrt(np.mean(answer.conditional.relative_noise(x) ** 2)))
        i = np.flatnonzero(paired)
        sigma = template.noise(x, frequencies[None])[0, i, pairing.mode[i]]
        if len(i):
            p_value = float(chi2.sf(np.sum(((measured - predicted)[i] / sigma) ** 2), max(len(i) - n, 1)))
    residual = predicted / measured - 1.0
    constants = dict(zip(p.names[:n], x[0, :n].tolist(), strict=True))
    missed = frequencies[pairing.missed]
    return BestFit(constants, pairing.mode, predicted, residual, missed, p_value, noise, tuple(bounds))


@dataclass(frozen=True, slots=True)
class GivenLayup:
    """A given stacking sequence in the posterior over all of them.

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
        """Rank of its class, 1 for the most probable; ``None`` if unlisted."""
        return None if self.index is None else self.index + 1


@single_blas_thread
def given_layup(answer: StackingPosterior, angles_deg: Array, log2_points: int = 11) -> GivenLayup:
    """Evidence and probability of a stacking sequence (k,) on the grid.

    p = Z / (sum of all evidences). An unlisted one is optimised from the optima of the listed ones.

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
