"""Autocorrelation times against autoregressive chains, whose time is known."""

from __future__ import annotations

import numpy as np
import pytest
from emcee.autocorr import integrated_time

from cpam_bayes.inference.chains.autocorrelation import integrated_times


def autoregressive(factor: float, steps: int, walkers: int, seed: int) -> np.ndarray:
    """x_(k+1) = factor x_k + noise, from its stationary density, (steps, walkers, 1)."""
    rng = np.random.default_rng(seed)
    x = np.empty((steps, walkers, 1))
    x[0] = rng.standard_normal((walkers, 1))
    for k in range(1, steps):
        x[k] = factor * x[k - 1] + np.sqrt(1.0 - factor**2) * rng.standard_normal((walkers, 1))
    return x


@pytest.mark.parametrize("time", [1.0, 3.0, 6.0, 30.0])
def test_the_time_of_an_autoregressive_chain_is_found(time: float) -> None:
    factor = (time - 1.0) / (time + 1.0)
    steps, walkers = int(50 * time), 100
    found = [integrated_times(autoregressive(factor, steps, walkers, seed))[0] for seed in range(8)]
    # Sokal's error of one is sqrt(20 tau / draws); the window and the lags' zeros leave some per cent
    error = np.sqrt(20.0 / (50 * walkers * len(found)))
    assert np.mean(found) == pytest.approx(time, rel=4.0 * error + 0.06)


def test_a_chain_of_eight_times_is_long_enough_where_means_of_single_walkers_lose_half() -> None:
    chains = [autoregressive(5.0 / 7.0, 50, 100, seed) for seed in range(8)]  # a time of 6 steps
    assert np.mean([integrated_times(c)[0] for c in chains]) == pytest.approx(6.0, rel=0.2)
    assert np.mean([integrated_time(c, tol=0, quiet=True)[0] for c in chains]) < 3.6


def test_every_parameter_has_its_own_time() -> None:
    fast, slow = autoregressive(0.0, 400, 50, 0), autoregressive(0.9, 400, 50, 1)
    found = integrated_times(np.concatenate((slow, fast), axis=2))
    assert found[0] == pytest.approx(19.0, rel=0.3)  # three of Sokal's errors
    assert found[1] == pytest.approx(1.0, rel=0.1)


def test_no_lag_wraps_round() -> None:
    """A step in the middle of a chain correlates its ends with nothing."""
    chain = np.repeat([0.0, 1.0], 64)[:, None, None] + np.zeros((128, 2, 1))
    chain[:, 1] += 1.0
    # about the mean 1, walkers at -1, 0 and 0, 1: sum over lags of the 64 - k pairs of each half
    lags = np.arange(128)
    expected = 2.0 * np.cumsum(np.maximum(64 - lags, 0) / 64.0) - 1.0
    assert integrated_times(chain)[0] == pytest.approx(expected.max())


def test_a_walker_that_does_not_move_leaves_the_time_unknown() -> None:
    chain = autoregressive(0.5, 200, 20, 0)
    chain[:, 3] = 0.7
    other = autoregressive(0.5, 200, 20, 1)
    found = integrated_times(np.concatenate((chain, other), axis=2))
    assert np.isnan(found[0])
    assert np.isfinite(found[1])
