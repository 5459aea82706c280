"""Pairing of incomplete lists, against enumeration of every pairing."""

from itertools import combinations

import numpy as np
import pytest

from cpam_bayes.inference.pairing import (
    PairingPrior,
    labelled_log_likelihood,
    monotone_log_likelihood,
    most_probable_labelled_pairing,
    most_probable_pairing,
    pair_probabilities,
)


def every_pairing(
    log_density: np.ndarray, in_range: np.ndarray, span: float, prior: PairingPrior
) -> list[tuple[float, np.ndarray]]:
    """Log likelihood and mode numbers of every pairing that keeps the order, one by one."""
    n, k = log_density.shape
    found = []
    for size in range(min(n, k) + 1):
        for rows in combinations(range(n), size):
            for columns in combinations(range(k), size):
                value = sum(
                    np.log1p(-prior.missed) + log_density[i, j] for i, j in zip(rows, columns, strict=True)
                )
                value += np.log(prior.missed) * sum(in_range[j] and j not in columns for j in range(k))
                value += np.sum(np.delete(prior.log_false(n, span), rows))
                mode = np.full(n, -1)
                mode[list(rows)] = columns
                found.append((value, mode))
    return found


@pytest.mark.parametrize("seed", range(40))
def test_sum_and_maximum_over_pairings_equal_those_of_an_enumeration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, k = rng.integers(1, 5), rng.integers(1, 6)
    log_density = 4.0 * rng.normal(size=(n, k)) - 3.0
    in_range = np.arange(k) < rng.integers(1, k + 1)
    false = rng.uniform(0.01, 1.0) if seed % 2 else tuple(rng.uniform(0.01, 30.0, n).tolist())
    prior = PairingPrior(rng.uniform(0.01, 0.5), false)
    expected = every_pairing(log_density, in_range, 7.0, prior)
    values = np.array([v for v, _ in expected])
    total = np.logaddexp.reduce(values)
    found = monotone_log_likelihood(log_density[None], in_range[None], 7.0, prior)[0]
    best = most_probable_pairing(log_density, in_range, 7.0, prior)
    assert found == pytest.approx(total, abs=1e-10)
    np.testing.assert_array_equal(best.mode, expected[int(values.argmax())][1])
    assert best.log_probability == pytest.approx(values.max() - total, abs=1e-10)
    assert set(best.missed) == set(np.flatnonzero(in_range)) - set(best.mode)
    of_pair = np.zeros((n, k))
    for value, mode in expected:
        rows = np.flatnonzero(mode >= 0)
        of_pair[rows, mode[rows]] += np.exp(value - total)
    each = pair_probabilities(log_density[None], in_range[None], 7.0, prior)[0]
    np.testing.assert_allclose(each, of_pair, atol=1e-12)


def test_a_stack_of_parameter_sets_gives_what_each_gives_alone() -> None:
    rng = np.random.default_rng(0)
    log_density = rng.normal(size=(5, 4, 6))
    in_range = rng.uniform(size=(5, 6)) < 0.7
    together = monotone_log_likelihood(log_density, in_range, 3.0, PairingPrior())
    alone = [
        monotone_log_likelihood(d[None], r[None], 3.0, PairingPrior())[0]
        for d, r in zip(log_density, in_range, strict=True)
    ]
    np.testing.assert_allclose(together, alone, rtol=1e-14)


@pytest.mark.parametrize("seed", range(20))
def test_labelled_frequencies_keep_their_modes_and_the_others_are_summed_over(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, k = rng.integers(1, 5), rng.integers(4, 7)
    labelled = rng.uniform(size=n) < 0.5
    log_density = 4.0 * rng.normal(size=(n, k)) - 3.0
    in_range = rng.uniform(size=k) < 0.7
    false = rng.uniform(0.01, 1.0) if seed % 2 else tuple(rng.uniform(0.01, 30.0, n).tolist())
    prior = PairingPrior(rng.uniform(0.01, 0.5), false)
    own = np.flatnonzero(labelled)
    known = np.where(labelled, np.arange(n), -1)
    rows, columns = np.setdiff1d(np.arange(n), own), np.setdiff1d(np.arange(k), own)
    fixed = sum(np.log1p(-prior.missed) + log_density[i, i] for i in own)
    expected = []
    for value, mode in every_pairing(
        log_density[np.ix_(rows, columns)], in_range[columns], 7.0, prior.among(rows)
    ):
        whole = np.arange(n)
        whole[rows] = np.where(mode >= 0, columns[mode], -1)
        expected.append((value + fixed, whole))
    values = np.array([v for v, _ in expected])
    total = np.logaddexp.reduce(values)
    found = labelled_log_likelihood(log_density[None], in_range[None], 7.0, known, prior)[0]
    best = most_probable_labelled_pairing(log_density, in_range, 7.0, known, prior)
    assert found == pytest.approx(total, abs=1e-10)
    np.testing.assert_array_equal(best.mode, expected[int(values.argmax())][1])
    assert best.log_probability == pytest.approx(values.max() - total, abs=1e-10)
    assert set(best.missed) == set(columns[in_range[columns]]) - set(best.mode)
