"""The surrogate: the log evidence of every stacking sequence as a smooth function of its ply sums."""

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

# Below the best by more than this, nats, a log evidence counts as this far below.
_MAX_DEPTH_NATS = 45.0
# Root mean square of the relative residuals of fits that are left out: they say nothing of the top.
_MAX_RMS_RESIDUAL = 0.2
# Root mean square of the scores from which on the nugget grows: such sequences need not be met well.
_POOR_RMS_SCORE = 10.0
# Fraction of the sequences near the top whose residuals are less than the unit where the noise is inferred.
_UNIT_QUANTILE = 0.1
# Least unit of relative residuals: below it a list without noise is as good as exact.
_MIN_UNIT = 1e-5
# Least length scales, in standard deviations, of the lamination parameters and of the further sums, whose
# whole range the cells of a piecewise-linear surrogate span.
_MIN_LENGTHS = (0.2, 5.0)


@dataclass(frozen=True, slots=True)
class Surrogate:
    """An approximate log evidence over features.

    process : gives the scores of the frequencies, residuals at the best fit in standard deviations of the
    noise, or of a small noise where it is inferred, and last the rest of the log evidence, which varies
    little (``piecewise_linear.log_evidence``); where not ``scored`` log Z, compressed far below the top.
    scored : whether frequencies are paired with modes, so that they have scores.
    freedom : of ``log_evidence``.
    top : largest log evidence of the training set.
    rms_error, largest_error : on fresh draws from the posterior, nats.
    """

    process: GaussianProcess
    scored: bool
    freedom: float
    top: float
    rms_error: float
    largest_error: float

    def values(self, features: Array) -> Array:
        """Log evidence at features (m, d), (m,)."""
        y = self.process.values(features)
        return log_evidence(y, self.freedom) if self.scored else _expanded(y[:, 0], self.top)

    def upper_bound(self, features: Array) -> Array:
        """Log evidence at features (m, d) two standard deviations up, (m,)."""
        y, sd = self.process.values(features), self.process.error(features)
        if not self.scored:
            return _expanded(y[:, 0] + 2.0 * sd[:, 0], self.top)
        z = np.maximum(np.abs(y[:, :-1]) - 2.0 * sd[:, :-1], 0.0)
        return log_evidence(np.column_stack((z, y[:, -1] + 2.0 * sd[:, -1])), self.freedom)

    def tangent(self, features: Array) -> tuple[Array, Array]:
        """Scores and rest at features (m, d), (m, n_z + 1), and their gradients (m, n_z + 1, d)."""
        y, slope = self.process.expansion(features)
        if self.scored:
            return y, slope
        return _expanded(y, self.top), slope * _expansion_slope(y, self.top)[:, :, None]


def _compressed(log_evidence: Array, top: float) -> Array:
    """Values near the top as they are, those far below compressed, smoothly."""
    return np.asarray(np.logaddexp(log_evidence, top - _MAX_DEPTH_NATS))


def _expanded(y: Array, top: float) -> Array:
    """The inverse of ``_compressed``."""
    least = top - _MAX_DEPTH_NATS
    above = np.maximum(y - least, 1e-3)
    return np.asarray(least + above + np.log1p(-np.exp(-above)))


def _expansion_slope(y: Array, top: float) -> Array:
    above = np.maximum(y - (top - _MAX_DEPTH_NATS), 1e-3)
    return np.asarray(1.0 / -np.expm1(-above))


def fit_surrogate(
    conditional: ConditionalPosterior,
    sums: PlySums,
    images: Array,
    data: Evaluated,
    rng: np.random.Generator,
    rms: float,
    largest: float,
    before: Surrogate | None,
) -> Surrogate:
    """The surrogate through evaluated sequences.

    images : (n_images, d) changes of sign of the features that change no frequency.
    before : a surrogate through fewer sequences.
    rms, largest : its error on fresh draws, nats.
    """
    like = None if before is None else before.process
    template, top = conditional.template, float(data.log_evidence.max())
    features = sums.features(data.sequences)
    min_lengths = np.where(np.arange(features.shape[1]) < 4, *_MIN_LENGTHS)
    if not template.measurement.complete:  # frequencies are not paired with modes
        y = _compressed(data.log_evidence, top)[:, None]
        process = fit_gaussian_process(features, y, rng, images, like, min_lengths)
        return Surrogate(process, False, np.inf, top, rms, largest)
    high = data.log_evidence > top - NEAR
    freedom = float(template.measurement.size) if template.noise_is_inferred else np.inf
    z = _scores(conditional, data, high)
    rms_residual = np.sqrt(np.mean(data.fits.residual**2, axis=1))
    kept = rms_residual <= max(_MAX_RMS_RESIDUAL, float(np.median(rms_residual)))
    # far down few points are sampled: Laplace's evidence is the better one there
    log_z = np.where(high, data.log_evidence, data.fits.log_evidence)
    rest = log_z - log_evidence(np.column_stack((z, np.zeros(len(z)))), freedom)
    y = np.column_stack((z, rest))[kept]
    nugget_factor = np.maximum(np.mean(z[kept] ** 2, axis=1) / _POOR_RMS_SCORE**2, 1.0)
    process = fit_gaussian_process(features[kept], y, rng, images, like, min_lengths, nugget_factor)
    return Surrogate(process, True, freedom, top, rms, largest)


def _scores(conditional: ConditionalPosterior, data: Evaluated, high: Array) -> Array:
    """Residuals at the best fits in standard deviations of the noise, (m, n_frequencies).

    Where the noise is inferred it differs from sequence to sequence, and is no smooth function of their
    features: the residuals of the best of the sequences with a ``high`` evidence are the unit.
    """
    template, residual = conditional.template, data.fits.residual
    if template.noise_is_inferred:
        rms = np.sqrt(np.mean(residual**2, axis=1))
        return np.asarray(residual / max(float(np.quantile(rms[high], _UNIT_QUANTILE)), _MIN_UNIT))
    measured = template.measurement.frequencies
    predicted = measured / (1.0 + residual)
    i = np.arange(len(measured))
    sigma = template.noise(data.fits.x, predicted)[:, i, i]
    return np.asarray((measured - predicted) / sigma)
