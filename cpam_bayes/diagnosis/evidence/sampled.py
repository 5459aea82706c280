"""Marginal likelihoods by importance sampling about their Laplace approximations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import LOG2_POINTS, WIDER, Marginal
from cpam_bayes.inference.importance import Weighted, staged_importance
from cpam_bayes.inference.student_mixture import Mixture, shrunk_moments, sobol_points
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Where the error is large, or the proposal a scattered one, it is refitted in stages.
_LARGE_ERROR, _STAGES, _MORE_STAGES = 0.1, (0.25, 0.25, 0.5), (0.1, 0.1, 0.2, 0.2, 0.4)
# Samples of a scattered proposal, in turn: log2 of the points, stages, and the error that is enough.
_SCATTERED_SAMPLES = ((10, _STAGES, _LARGE_ERROR), (11, _STAGES, 0.25), (12, _MORE_STAGES, np.inf))
# Models are projected once more, on modes at so many points of the proposal, log2, so that this fraction of
# their frequencies has a relative error below the tolerance.
_LOG2_TRAINING, _TOLERANCE, _FRACTION = 6, 2e-5, 0.95
# Points of most weight at which the log densities of both are compared, and how far they may be apart.
_COMPARED, _ALIKE_NATS = 16, 0.05


@single_blas_thread
def sampled_marginal(marginal: Marginal, log2_points: int = LOG2_POINTS) -> Marginal:
    """A marginal likelihood by importance sampling about its Laplace approximation.

    log2_points : of the sample about optima; four times as many where its error is large
    """
    comparison = marginal.comparison
    near = about_optima(marginal)
    sample = _sample(marginal, near, log2_points)
    if near is not comparison and not _are_alike(near, comparison, sample):
        sample = _sample(marginal, comparison, log2_points)
    if not np.isfinite(sample.log_evidence[0]):
        return marginal
    with np.errstate(divide="ignore"):
        log_weight = np.log(sample.weight[0])
    return replace(
        marginal,
        log_evidence=float(sample.log_evidence[0]),
        error=float(sample.standard_error[0]),
        effective_size=float(sample.effective_size[0]),
        k_hat=float(sample.k_hat[0]),
        draws=comparison.scores.to_x(sample.points[0]),
        log_weight=log_weight,
    )


def about_optima(marginal: Marginal) -> Comparison:
    """The comparison with models that are enough where the mixture about its optima proposes points."""
    points = sobol_points(marginal.proposal, _LOG2_TRAINING)[0]
    return marginal.comparison.about(points, _TOLERANCE, _FRACTION)


def _sample(marginal: Marginal, comparison: Comparison, log2_points: int) -> Weighted:
    def log_density(z: Array) -> Array:
        return comparison.log_density(z[0])[None]

    about_optima = ((log2_points, (1.0,), _LARGE_ERROR), (log2_points + 2, _STAGES, np.inf))
    for log2, stages, enough in _SCATTERED_SAMPLES if marginal.is_scattered else about_optima:
        sample = staged_importance(log_density, marginal.proposal, log2, stages, _refitted)
        if sample.standard_error[0] < enough:
            break
    return sample


def _are_alike(near: Comparison, comparison: Comparison, sample: Weighted) -> bool:
    """Whether two comparisons have the same log density at the points of most weight."""
    z = sample.points[0][np.argsort(-sample.weight[0], kind="stable")[:_COMPARED]]
    return bool(np.abs(near.log_density(z) - comparison.log_density(z)).max() < _ALIKE_NATS)


def _refitted(mixture: Mixture, points: Array, log_weight: Array) -> Mixture:
    return shrunk_moments(mixture, points, log_weight, least=1e-3, wider=WIDER, prior_points=4.0)
