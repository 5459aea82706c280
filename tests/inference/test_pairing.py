"""Pairing of incomplete lists, against enumeration of every pairing."""

from itertools import combinations

import numpy as np
import pytest

from cpam_bayes.inference.pairing import (
    PairingPrior,
    labelled_log_likelihood,
    most_probable_labelled_pairing,
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


@pytest.mark.parametrize(
    ("seed", "share"), [(seed, share) for share, n in ((0.0, 40), (0.5, 20)) for seed in range(n)]
)
def test_sum_and_maximum_over_pairings_equal_those_of_an_enumeration(seed: int, share: float) -> None:
    """Frequencies with labels, a share of all, keep their modes; the list is the second of a stack."""
    rng = np.random.default_rng(seed)
    n, k = rng.integers(1, 5), rng.integers(4, 7) if share else rng.integers(1, 6)
    labelled = rng.uniform(size=n) < share
    known = np.where(labelled, np.arange(n), -1)
    stack = 4.0 * rng.normal(size=(2, n, k)) - 3.0
    stack_in_range = rng.uniform(size=(2, k)) < 0.7
    log_density, in_range = stack[1], stack_in_range[1]
    false = rng.uniform(0.01, 1.0) if seed % 2 else tuple(rng.uniform(0.01, 30.0, n).tolist())
    prior = PairingPrior(rng.uniform(0.01, 0.5), false)
    own = np.flatnonzero(labelled)
    rows, columns = np.setdiff1d(np.arange(n), own), np.setdiff1d(np.arange(k), own)
    fixed = sum(np.log1p(-prior.missed) + log_density[i, i] for i in own)
    others = every_pairing(log_density[np.ix_(rows, columns)], in_range[columns], 7.0, prior.among(rows))
    values = np.array([value + fixed for value, _ in others])
    total = np.logaddexp.reduce(values)
    modes = np.tile(np.arange(n), (len(others), 1))
    modes[:, rows] = [np.where(mode >= 0, columns[mode], -1) for _, mode in others]
    found = labelled_log_likelihood(stack, stack_in_range, 7.0, known, prior)
    assert found[1] == pytest.approx(total, abs=1e-10)
    best = most_probable_labelled_pairing(log_density, in_range, 7.0, known, prior)
    np.testing.assert_array_equal(best.mode, modes[values.argmax()])
    assert best.log_probability == pytest.approx(values.max() - total, abs=1e-10)
    assert set(best.missed) == set(columns[in_range[columns]]) - set(best.mode)
    if not share:
        of_pair = np.zeros((n, k))
        for mode, probability in zip(modes, np.exp(values - total), strict=True):
            paired = np.flatnonzero(mode >= 0)
            of_pair[paired, mode[paired]] += probability
        each = pair_probabilities(stack, stack_in_range, 7.0, prior)[1]
        np.testing.assert_allclose(each, of_pair, atol=1e-12)
