"""What an effect does to the frequencies at the plain model's optimum, over the sizes of its prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.optima import SIZE_RANGE, size_points, spread_scores
from cpam_bayes.parameters import Parameter

Array = NDArray[Any]

# Nodes of one size between the ends of the grid, sizes evenly spread over the prior that join them, and the
# scattered nodes, log2, of several sizes.
_NODES, _EVEN, _LOG2_SCATTERED = 19, 9, 7


@dataclass(frozen=True, slots=True)
class ShiftTable:
    """Shifts of the log frequencies of the lists at nodes of an effect's sizes.

    scores : (k, d) of the size and further coordinates
    log_prior : (k,) log prior weights of the nodes, normalised
    shift : (k, n_f)
    """

    scores: Array
    log_prior: Array
    shift: Array


def size_nodes(comparison: Comparison, sizes: tuple[int, ...]) -> tuple[Array, Array]:
    """Nodes (k, d) of an effect's sizes in normal scores and the logs (k,) of their prior weights."""
    if len(sizes) == 1:
        even = size_points(comparison, sizes[0], _EVEN)
        score = np.concatenate((np.linspace(-SIZE_RANGE, SIZE_RANGE, _NODES), even))
        score = np.unique(np.round(score, 6))
        log_weight = np.log(np.gradient(score)) - 0.5 * score**2
        return score[:, None], log_weight - logsumexp(log_weight)
    scores = spread_scores(len(sizes), _LOG2_SCATTERED, 0)
    log_weight = -0.5 * scores[:, 0] ** 2
    return scores, log_weight - logsumexp(log_weight)


def shift_table(
    comparison: Comparison, effect: Sequence[Parameter], sizes: tuple[int, ...], about: Marginal
) -> ShiftTable:
    """Shifts by an effect at the optimum of another hypothesis.

    What that hypothesis lacks is at its prior median.

    Nodes at which the plate buckles or the constraints (9) are broken are left out, if need be all.

    comparison : with the effect
    effect, sizes : the d parameters of the effect, and their columns
    about : the other hypothesis
    """
    medians = comparison.scores.to_x(np.zeros((1, comparison.parameters.size)))[0]
    x = comparison.carried(about.comparison, about.best, medians)
    x = np.clip(x, comparison.parameters.lower, comparison.parameters.upper)
    null = [0.0 if p.null is None else p.null for p in effect]
    scores, log_prior = size_nodes(comparison, sizes)
    z = np.repeat(comparison.scores.to_z(x[None]), len(scores), axis=0)
    z[:, list(sizes)] = scores
    at = comparison.scores.to_x(z)
    at[:, _others(len(x), sizes)] = x[_others(len(x), sizes)]
    plain = x.copy()
    plain[list(sizes)] = null
    f, _ = comparison.predict(plain[None])
    inside, shifted, _ = comparison.predict_inside(at)
    log_prior = log_prior[inside]
    if not len(inside):
        return ShiftTable(scores[:0], log_prior, shifted)
    return ShiftTable(scores[inside], log_prior - logsumexp(log_prior), np.log(shifted / f))


def _others(n: int, sizes: tuple[int, ...]) -> Array:
    return np.delete(np.arange(n), sizes)
