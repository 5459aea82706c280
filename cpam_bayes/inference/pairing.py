"""Pairings of measured frequencies with modes of the model.

A complete list is paired one to one. Otherwise every pairing that keeps the order is possible, each missed
mode and each spurious peak with a prior probability, and the likelihood is the sum over all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cpam_bayes.inference.student_mixture import log_sum_exp
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.plate import Measurement

# Log prior of a false peak where there are none: finite, so that zero times it is zero.
_IMPOSSIBLE: Final = -1e300


@dataclass(frozen=True, slots=True)
class PairingPrior:
    """Prior of the pairings of an incomplete list.

    missed : probability that a mode in the measured range is not in the list.
    spurious : expected number of listed frequencies that belong to no mode, evenly spread over the range; one
    for each frequency where they are candidates, for false ones of its kind.
    """

    missed: float = 0.1
    spurious: float | tuple[float, ...] = 0.1

    @staticmethod
    def of(measurement: Measurement) -> PairingPrior:
        """Pairing prior of a measurement."""
        false = measurement.false_peaks
        return PairingPrior(
            measurement.missed_probability, false if isinstance(false, float) else tuple(false.tolist())
        )

    def among(self, rows: Array) -> PairingPrior:
        """Pairing prior of some of the frequencies (m,)."""
        if isinstance(self.spurious, float):
            return self
        return replace(self, spurious=tuple(self.spurious[i] for i in rows))

    def log_false(self, n: int, span: float) -> Array:
        """Log prior (n,) of each of n frequencies as a false peak; span : of the measured range, Hz."""
        number = np.broadcast_to(np.asarray(self.spurious, dtype=float), n)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(number / span))


@dataclass(frozen=True, slots=True)
class Pairing:
    """The most probable pairing of one parameter set.

    mode : (n,) the model mode of each measured frequency, -1 for a spurious one.
    missed : model modes in the measured range that the list lacks.
    log_probability : of this pairing among all pairings.
    """

    mode: Array
    missed: Array
    log_probability: float


def monotone_log_likelihood(
    log_density: Array, in_range: Array, measured_range: float, prior: PairingPrior
) -> Array:
    """Log (m,) of the sum over all order-keeping pairings of n measured frequencies with k modes.

    A pairing has the likelihood product over pairs of (1 - p) exp(log_density_ij), times p for every
    mode in range without a partner, times lambda / range for every frequency without one. Skipped
    rows and columns between two pairs are counted once, by two nested recursions.

    log_density : (m, n, k), log density of frequency i if it is mode j.
    in_range : (m, k) bool, modes that a complete list would contain; those beyond it have no factor when
    missed.
    """
    table = _Prices(log_density, in_range, measured_range, prior)
    if not table.n:
        return np.asarray(table.nothing)
    forward = table.sums()[0]
    value = np.logaddexp(table.nothing, log_sum_exp(forward + table.tail(), axis=(1, 2)))
    return np.where(value > 0.1 * _IMPOSSIBLE, value, -np.inf)


def pair_probabilities(
    log_density: Array, in_range: Array, measured_range: float, prior: PairingPrior
) -> Array:
    """Probability (m, n, k) that a frequency is a mode, over all order-keeping pairings.

    The remainder to 1 along k is that of a false peak. Arguments as of `monotone_log_likelihood`.
    """
    table = _Prices(log_density, in_range, measured_range, prior)
    mirrored = replace(
        prior, spurious=prior.spurious if isinstance(prior.spurious, float) else prior.spurious[::-1]
    )
    back = _Prices(log_density[:, ::-1, ::-1], in_range[:, ::-1], measured_range, mirrored)
    every = monotone_log_likelihood(log_density, in_range, measured_range, prior)
    through = table.sums()[0] + back.sums()[0][:, ::-1, ::-1] - table.pair
    return np.asarray(np.exp(through - every[:, None, None]))


def most_probable_pairing(
    log_density: Array, in_range: Array, measured_range: float, prior: PairingPrior
) -> Pairing:
    """The pairing with the largest likelihood for one parameter set (log_density (n, k))."""
    if not len(log_density):
        return Pairing(np.empty(0, dtype=int), np.flatnonzero(in_range), 0.0)
    table = _Prices(log_density[None], in_range[None], measured_range, prior)
    best, came_from = table.sums(maximise=True)
    total = (best + table.tail())[0]
    mode = np.full(len(log_density), -1)
    everything = monotone_log_likelihood(log_density[None], in_range[None], measured_range, prior)[0]
    value = float(table.nothing[0])
    if total.max() > value:
        value = float(total.max())
        i, j = divmod(int(total.argmax()), total.shape[1])
        while i >= 0:
            mode[i] = j
            i, j = came_from[i, j]
    missed = np.setdiff1d(np.flatnonzero(in_range), mode)
    return Pairing(mode, missed, value - float(everything))


def labelled_log_likelihood(
    log_density: Array, in_range: Array, measured_range: float, known: Array, prior: PairingPrior
) -> Array:
    """Log (m,) of the sum over all pairings that keep the known modes.

    The other frequencies are paired with the other modes as in ``monotone_log_likelihood``, whatever the
    order of the known ones.

    known : (n,) mode of each frequency, -1 where it is not known
    """
    if np.all(known < 0):
        return monotone_log_likelihood(log_density, in_range, measured_range, prior)
    fixed = np.flatnonzero(known >= 0)
    rows, columns = _others(log_density, known)
    others = monotone_log_likelihood(
        log_density[:, rows][:, :, columns], in_range[:, columns], measured_range, prior.among(rows)
    )
    return np.asarray(others + np.sum(np.log1p(-prior.missed) + log_density[:, fixed, known[fixed]], axis=1))


def most_probable_labelled_pairing(
    log_density: Array, in_range: Array, measured_range: float, known: Array, prior: PairingPrior
) -> Pairing:
    """The most probable pairing of one parameter set that respects known modes (log_density (n, k))."""
    rows, columns = _others(log_density, known)
    others = most_probable_pairing(
        log_density[rows][:, columns], in_range[columns], measured_range, prior.among(rows)
    )
    mode = np.array(known)
    mode[rows] = np.where(others.mode >= 0, columns[others.mode], -1)
    return Pairing(mode, columns[others.missed], others.log_probability)


def _others(log_density: Array, known: Array) -> tuple[Array, Array]:
    """Frequencies without a known mode, and modes that no frequency is known to have."""
    return np.flatnonzero(known < 0), np.setdiff1d(np.arange(log_density.shape[-1]), known)


class _Prices:
    """Log factors of pairs and skips of m tables."""

    def __init__(self, log_density: Array, in_range: Array, span: float, prior: PairingPrior) -> None:
        self.m, self.n, self.k = log_density.shape
        self.pair = np.log1p(-prior.missed) + log_density
        self.miss = np.where(in_range, np.log(prior.missed), 0.0)
        self.extra = np.maximum(prior.log_false(self.n, span), _IMPOSSIBLE)
        self.nothing = self.extra.sum() + self.miss.sum(axis=1)

    def sums(self, *, maximise: bool = False) -> tuple[Array, dict[tuple[int, int], tuple[int, int]]]:
        """Log sum (or maximum) (m, n, k) over all pairings that end with the pair (i, j).

        When maximising also the pair before each, (-1, -1) where it is the first; m is 1 then.
        """
        join = np.maximum if maximise else np.logaddexp
        before = np.concatenate((np.zeros((self.m, 1)), np.cumsum(self.miss, axis=1)), axis=1)[:, :-1]
        ends = np.empty((self.m, self.n, self.k))
        came_from: dict[tuple[int, int], tuple[int, int]] = {}
        # reach[:, j]: sum or best of all pairings within the rows above that end left of column j, carried
        # to this row and column with the factors of the rows and columns in between
        reach = np.full((self.m, self.k), -np.inf)
        source: list[tuple[int, int]] = [(-1, -1)] * self.k
        for i in range(self.n):
            first = self.extra[:i].sum() + before
            ends[:, i] = self.pair[:, i] + join(reach, first)
            if maximise:
                for j in range(self.k):
                    came_from[i, j] = source[j] if reach[0, j] > first[0, j] else (-1, -1)
            # pairs of this row, minus the log factors of the columns up to theirs, which the sum adds again
            carried = ends[:, i] - before - self.miss
            best = join.accumulate(carried, axis=1)
            along = np.concatenate((np.full((self.m, 1), -np.inf), before[:, 1:] + best[:, :-1]), axis=1)
            down = reach + self.extra[i]
            if maximise:
                is_new = carried[0] > np.append(-np.inf, best[0, :-1])
                last = np.maximum.accumulate(np.where(is_new, np.arange(self.k), -1))
                for j in np.flatnonzero(along[0] > down[0]).tolist():
                    source[j] = (i, int(last[j - 1]))
            reach = join(along, down)
        return ends, came_from

    def tail(self) -> Array:
        """Log factor (m, n, k) of the rows and columns after the pair (i, j)."""
        after = self.miss.sum(axis=1, keepdims=True) - np.cumsum(self.miss, axis=1)
        below = np.append(np.cumsum(self.extra[:0:-1])[::-1], 0.0)
        return np.asarray(after[:, None, :] + below[None, :, None])
