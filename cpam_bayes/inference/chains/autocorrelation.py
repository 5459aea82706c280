"""Integrated autocorrelation times of the walkers of an ensemble."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# The window is so many times as long as the time itself.
_WINDOW = 5.0


def integrated_times(chain: Array) -> Array:
    """Autocorrelation time of every parameter, (steps, walkers, n) -> (n,) steps.

    tau = 1 + 2 sum_k rho(k) up to the first lag that is at least five times tau (Sokal, 1996), with the
    autocovariance averaged over the walkers (Goodman and Weare, 2010). Deviations are taken from the mean
    of the whole ensemble. From each walker's own mean, as in emcee's estimate, rho(k) would come out low by
    about tau / steps and tau by 2 window tau / steps: half of it is lost where a chain is ten times as
    long.

    nan where a walker does not move. Where no lag is long enough, the largest sum, which tau exceeds.
    """
    steps = len(chain)
    size = 1 << (2 * steps - 1).bit_length()  # zeros beyond the chain: no lag wraps round
    frequency = np.fft.rfft(chain - chain.mean(axis=(0, 1)), n=size, axis=0)
    covariance = np.fft.irfft(np.abs(frequency) ** 2, n=size, axis=0)[:steps].mean(axis=1)
    found = np.full(chain.shape[2], np.nan)
    for i in np.flatnonzero(np.all(np.ptp(chain, axis=0) > 0.0, axis=0)):
        sums = 2.0 * np.cumsum(covariance[:, i] / covariance[0, i]) - 1.0
        long_enough = np.arange(steps) >= _WINDOW * sums
        found[i] = sums[np.argmax(long_enough)] if long_enough.any() else sums.max()
    return found
