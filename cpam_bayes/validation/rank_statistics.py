"""Are ranks uniform? Bands, p-values and coverage for simulation-based calibration.

Where a posterior is right, the rank of the true value among independent draws from it is uniform
(Talts, Betancourt, Simpson, Vehtari and Gelman, 2018). Counts of uniform ranks, in bins or up to a
rank, are binomial at each place and dependent between places. What is simultaneous here, bands and
p-values, is therefore read off simulated uniform ranks, as by Säilynoja, Bürkner and Vehtari
(Statistics and Computing 32, 2022): the statistic is the least binomial tail probability over all
places.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

Array = NDArray[Any]

LEVELS = (0.5, 0.8, 0.95)
_SIMULATIONS = 4000


@dataclass(frozen=True, slots=True)
class Band:
    """Where counts of uniform ranks lie simultaneously, with a given probability, (k,) each."""

    lower: Array
    upper: Array


@dataclass(frozen=True, slots=True)
class Coverage:
    """Fraction of central intervals of probability ``level`` that hold the truth.

    standard_error : binomial, sqrt(level (1 - level) / n).
    """

    level: float
    share: float
    standard_error: float


@dataclass(frozen=True, slots=True)
class Uniformity:
    """How uniform the ranks of one parameter are.

    counts : (n_bins,) of the rank histogram.
    cumulative : (n_ranks,) ranks up to each one.
    chi_square_p, ecdf_p : p-values of the histogram and of the largest departure of the empirical
    distribution from its band.
    corrected_p : the smaller of the two after Holm's correction for all p-values of the same table of
    ranks.
    """

    counts: Array
    cumulative: Array
    chi_square_p: float
    ecdf_p: float
    corrected_p: float


@dataclass(frozen=True, slots=True)
class RankStatistics:
    """Uniformity of every parameter's ranks, with the bands that they share.

    histogram_band : of the counts in bins.
    ecdf_band : of the cumulative counts.
    """

    parameters: tuple[Uniformity, ...]
    histogram_band: Band
    ecdf_band: Band


def rank_statistics(
    ranks: Array,
    n_ranks: int,
    rng: np.random.Generator,
    *,
    n_bins: int = 20,
    probability: float = 0.95,
    simulations: int = _SIMULATIONS,
) -> RankStatistics:
    """Bands of uniform ranks and p-values against uniformity.

    ranks : (n, n_parameters) integers from 0 to n_ranks - 1.
    rng : of the simulated uniform ranks.

    Raises ``ValueError`` for ranks out of range or bins that do not divide them evenly.
    """
    ranks = np.asarray(ranks)
    if ranks.size == 0 or ranks.min() < 0 or ranks.max() >= n_ranks:
        raise ValueError(
            f"ranks: received {ranks.shape} of them, accepted: one or more in 0 to {n_ranks - 1}"
        )
    if n_ranks % n_bins:
        raise ValueError(f"bins: received {n_bins}, accepted: a divisor of {n_ranks}")
    n = len(ranks)
    counts = np.stack([np.bincount(column, minlength=n_ranks) for column in ranks.T])
    simulated = rng.multinomial(n, np.full(n_ranks, 1.0 / n_ranks), size=simulations)
    # the count up to the last rank is always n
    places = np.arange(1, n_ranks) / n_ranks
    cumulative = _Counts(n, places)
    binned = _Counts(n, np.full(n_bins, 1.0 / n_bins))
    simulated_ecdf = cumulative.least_tail(_up_to(simulated))
    simulated_histogram = binned.least_tail(_in_bins(simulated, n_bins))
    observed = cumulative.least_tail(_up_to(counts))
    ecdf_p = (1 + np.sum(simulated_ecdf[None, :] <= observed[:, None], axis=1)) / (simulations + 1)
    histogram = _in_bins(counts, n_bins)
    chi_square = np.sum((histogram - n / n_bins) ** 2, axis=1) / (n / n_bins)
    chi_square_p = chi2.sf(chi_square, n_bins - 1)
    corrected = holm(np.concatenate((chi_square_p, ecdf_p))).reshape(2, -1).min(axis=0)
    return RankStatistics(
        tuple(
            Uniformity(histogram[i], counts[i].cumsum(), float(c), float(e), float(p))
            for i, (c, e, p) in enumerate(zip(chi_square_p, ecdf_p, corrected, strict=True))
        ),
        histogram_band=binned.band(simulated_histogram, probability),
        ecdf_band=cumulative.band(simulated_ecdf, probability),
    )


def holm(p_values: Array) -> Array:
    """p-values (n,) corrected for their number by Holm's step-down method (1979), (n,)."""
    order = np.argsort(p_values, kind="stable")
    n = len(order)
    corrected = np.empty(n)
    corrected[order] = np.minimum(
        1.0, np.maximum.accumulate(np.asarray(p_values)[order] * np.arange(n, 0, -1))
    )
    return corrected


def coverage(below: Array, levels: tuple[float, ...] = LEVELS) -> tuple[Coverage, ...]:
    """Coverage of central intervals of one parameter.

    below : (n,) the fraction of each posterior below the truth; a central interval of probability p
    holds the truth if that fraction is within p / 2 of one half.
    """
    distance = np.abs(np.asarray(below) - 0.5)
    return tuple(
        Coverage(p, float(np.mean(distance <= 0.5 * p)), float(np.sqrt(p * (1 - p) / len(distance))))
        for p in levels
    )


def _up_to(counts: Array) -> Array:
    return np.asarray(np.cumsum(counts, axis=-1)[..., :-1])


def _in_bins(counts: Array, n_bins: int) -> Array:
    return np.asarray(counts.reshape(len(counts), n_bins, -1).sum(axis=-1))


class _Counts:
    """Binomial counts of n at k places, with their tail probabilities in a table."""

    def __init__(self, n: int, probability: Array) -> None:
        at = np.arange(n + 1)[:, None]
        self.up_to = np.asarray(binom.cdf(at, n, probability))
        self.from_on = np.asarray(binom.sf(at - 1, n, probability))
        self.places = np.arange(len(probability))

    def least_tail(self, counts: Array) -> Array:
        """Least tail probability over the places of counts (m, k), (m,)."""
        both = np.minimum(self.up_to[counts, self.places], self.from_on[counts, self.places])
        return np.asarray(both.min(axis=1))

    def band(self, simulated: Array, probability: float) -> Band:
        """Counts whose tails are as large as all of a fraction of simulated rows have them."""
        least = np.sort(simulated)[int((1.0 - probability) * len(simulated))]
        allowed = (self.up_to >= least) & (self.from_on >= least)
        return Band(allowed.argmax(axis=0), len(allowed) - 1 - allowed[::-1].argmax(axis=0))
