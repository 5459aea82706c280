"""The log evidence of every sequence as a smooth function of its ply sums, learned where the mass is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.conditional.bases import NEAR
from cpam_bayes.stacking.conditional.evaluation import Evaluated
from cpam_bayes.stacking.conditional.posterior import ConditionalPosterior
from cpam_bayes.stacking.features import PlySums
from cpam_bayes.stacking.surrogate.gaussian_process import GaussianProcess, fit_gaussian_process
from cpam_bayes.stacking.surrogate.piecewise_linear import log_evidence

Array = NDArray[Any]

# Below the best by more than this, nats, a value counts as this far below.
_DEPTH = 45.0
# Root mean square of the relative residuals of fits that are left out: they say nothing of the top.
_FAR = 0.2
# Root mean square of the scores from which on they need not be met well: what is so bad stays bad.
_BAD = 10.0
# Share of the sequences near the top whose residuals are less than the unit where the noise is inferred.
_BEST = 0.1
# The least unit of residuals: below it a list without noise is as good as exact.
_LEAST_UNIT = 1e-5
# Least length scales of the lamination parameters and of the further sums, whose reach the cells of a table
# span, in standard deviations.
_LEAST_LENGTHS = (0.2, 5.0)


@dataclass(frozen=True, slots=True)
class Surrogate:
    """A learned log evidence: the map, the top of its data, and its error on fresh posterior draws, nats.

    scored : the map gives the scores of the frequencies at the best fit, residuals in standard deviations of
    the noise, or of a small noise where it is inferred, and last what is left of the log evidence, which
    varies little (``evidence_table.log_evidence``, with ``freedom``). Otherwise it gives log Z, pressed
    together far below the top.
    """

    smooth: GaussianProcess
    scored: bool
    freedom: float
    top: float
    rms_error: float
    largest_error: float

    def values(self, features: Array) -> Array:
        """Log evidence at features (m, d), (m,)."""
        y = self.smooth.values(features)
        return log_evidence(y, self.freedom) if self.scored else _expanded(y[:, 0], self.top)

    def optimistic(self, features: Array) -> Array:
        """The most that the log evidence may well be at features (m, d), (m,): two standard deviations up."""
        y, error = self.smooth.values(features), self.smooth.error(features)
        if not self.scored:
            return _expanded(y[:, 0] + 2.0 * error[:, 0], self.top)
        z = np.maximum(np.abs(y[:, :-1]) - 2.0 * error[:, :-1], 0.0)
        return log_evidence(np.column_stack((z, y[:, -1] + 2.0 * error[:, -1])), self.freedom)

    def tangent(self, features: Array) -> tuple[Array, Array]:
        """Scores and rest at features (m, d), (m, n_z + 1), and their gradients (m, n_z + 1, d)."""
        y, slope = self.smooth.expansion(features)
        if self.scored:
            return y, slope
        return _expanded(y, self.top), slope * _expansion_slope(y, self.top)[:, :, None]


def _compressed(log_evidence: Array, top: float) -> Array:
    """Values near the top as they are, those far below pressed together, smoothly."""
    return np.asarray(np.logaddexp(log_evidence, top - _DEPTH))


def _expanded(y: Array, top: float) -> Array:
    floor = top - _DEPTH
    above = np.maximum(y - floor, 1e-3)
    return np.asarray(floor + above + np.log1p(-np.exp(-above)))


def _expansion_slope(y: Array, top: float) -> Array:
    above = np.maximum(y - (top - _DEPTH), 1e-3)
    return np.asarray(1.0 / -np.expm1(-above))


def fit_surrogate(
    own: ConditionalPosterior,
    sums: PlySums,
    images: Array,
    data: Evaluated,
    rng: np.random.Generator,
    rms: float,
    worst: float,
    before: Surrogate | None,
) -> Surrogate:
    """The surrogate through evaluated sequences.

    images : (n_images, d) changes of sign of the features that change no frequency. rms, worst : error of
    ``before``, a surrogate through fewer sequences, on fresh draws, nats.
    """
    like = None if before is None else before.smooth
    top = float(data.log_evidence.max())
    features = sums.features(data.sequences)
    least = np.where(np.arange(features.shape[1]) < 4, *_LEAST_LENGTHS)
    scored = own.template.measurement.complete
    if not scored:  # frequencies have no mode of their own
        y = _compressed(data.log_evidence, top)[:, None]
        return Surrogate(
            fit_gaussian_process(features, y, rng, images, like, least), False, np.inf, top, rms, worst
        )
    near = data.log_evidence > top - NEAR
    freedom = float(own.template.measurement.size) if own.template.noise_is_inferred else np.inf
    z = _scores(own, data, near)
    away = np.sqrt(np.mean(data.fits.residual**2, axis=1))
    kept = away <= max(_FAR, float(np.median(away)))
    # far down few points are sampled: Laplace's evidence is the better one there
    log_z = np.where(near, data.log_evidence, data.fits.log_evidence)
    rest = log_z - log_evidence(np.column_stack((z, np.zeros(len(z)))), freedom)
    y = np.column_stack((z, rest))[kept]
    doubt = np.maximum(np.mean(z[kept] ** 2, axis=1) / _BAD**2, 1.0)
    smooth = fit_gaussian_process(features[kept], y, rng, images, like, least, doubt)
    return Surrogate(smooth, True, freedom, top, rms, worst)


def _scores(own: ConditionalPosterior, data: Evaluated, near: Array) -> Array:
    """Residuals at the best fits in standard deviations of the noise, (m, n_frequencies).

    Where the noise is inferred it differs from sequence to sequence, and what a sequence shows of it is no
    smooth function: the residuals of the best ones of those near the top are the unit.
    """
    if own.template.noise_is_inferred:
        rms = np.sqrt(np.mean(data.fits.residual**2, axis=1))
        return np.asarray(data.fits.residual / max(float(np.quantile(rms[near], _BEST)), _LEAST_UNIT))
    measured = own.template.measurement.frequencies
    predicted = measured / (1.0 + data.fits.residual)
    i = np.arange(len(measured))
    sigma = own.template.noise(data.fits.x, predicted)[:, i, i]
    return np.asarray((measured - predicted) / sigma)
