"""The log evidence of every sequence as a smooth function of its ply sums, learned where the mass is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.evidence_table import log_evidence
from cpam_bayes.inference.ply_sums import PlySums
from cpam_bayes.inference.sequence_bases import NEAR
from cpam_bayes.inference.sequence_evaluation import Evaluated
from cpam_bayes.inference.sequence_evidence import SequencePosterior
from cpam_bayes.inference.smooth_map import SmoothMap, fit_map

Array = NDArray[Any]

# Below the best by more than this, nats, a value counts as this far below.
_DEPTH = 45.0
# Fits farther off than this, standard deviations of the noise, are left out: they say nothing of the top.
_FAR = 60.0
# Least length scales of the lamination parameters and of the further sums, whose reach the cells of a table
# span, in standard deviations.
_LEAST_LENGTHS = (0.2, 5.0)


@dataclass(frozen=True, slots=True)
class Surface:
    """A learned log evidence: the map, the top of its data, and its error on fresh posterior draws, nats.

    scored : the map gives the residuals z of the frequencies at the best fit, in standard deviations of the
    noise, and last what is left of the log evidence, which varies little: log Z = rest - |z|^2 / 2.
    Otherwise it gives log Z, pressed together far below the top.
    """

    smooth: SmoothMap
    scored: bool
    top: float
    rms_error: float
    largest_error: float

    def values(self, features: Array) -> Array:
        """Log evidence at features (m, d), (m,)."""
        y = self.smooth.values(features)
        return log_evidence(y) if self.scored else _expanded(y[:, 0], self.top)

    def optimistic(self, features: Array) -> Array:
        """The most that the log evidence may well be at features (m, d), (m,): two standard deviations up."""
        y, error = self.smooth.values(features), self.smooth.error(features)
        if not self.scored:
            return _expanded(y[:, 0] + 2.0 * error[:, 0], self.top)
        z = np.maximum(np.abs(y[:, :-1]) - 2.0 * error[:, :-1], 0.0)
        return log_evidence(np.column_stack((z, y[:, -1] + 2.0 * error[:, -1])))

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


def fit_surface(
    own: SequencePosterior,
    sums: PlySums,
    images: Array,
    data: Evaluated,
    rng: np.random.Generator,
    rms: float,
    worst: float,
    before: Surface | None,
) -> Surface:
    """The surface through evaluated sequences.

    images : (n_images, d) changes of sign of the features that change no frequency. rms, worst : error of
    ``before``, a surface through fewer sequences, on fresh draws, nats.
    """
    like = None if before is None else before.smooth
    top = float(data.log_evidence.max())
    features = sums.features(data.sequences)
    least = np.where(np.arange(features.shape[1]) < 4, *_LEAST_LENGTHS)
    scored = own.template.measurement.complete
    if not scored:  # frequencies have no mode of their own
        y = _compressed(data.log_evidence, top)[:, None]
        return Surface(fit_map(features, y, rng, images, like, least), False, top, rms, worst)
    z = _scores(own, data)
    size = np.sum(z**2, axis=1)
    kept = size <= max(_FAR**2, float(np.median(size)))
    # far down few points are sampled: Laplace's evidence is the better one there
    near = data.log_evidence > top - NEAR
    log_z = np.where(near, data.log_evidence, data.fits.log_evidence)
    y = np.column_stack((z, log_z + 0.5 * size))[kept]
    return Surface(fit_map(features[kept], y, rng, images, like, least), True, top, rms, worst)


def _scores(own: SequencePosterior, data: Evaluated) -> Array:
    """Residuals at the best fits in standard deviations of the noise there, (m, n_frequencies)."""
    measured = own.template.measurement.frequencies
    predicted = measured / (1.0 + data.fits.residual)
    i = np.arange(len(measured))
    sigma = own.template.noise(data.fits.x, predicted)[:, i, i]
    return np.asarray((measured - predicted) / sigma)
