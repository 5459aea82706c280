"""Nested sampling as a second opinion, and the pool that asks for values in stacks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from cpam_bayes.inference.proposal import AdaptationSettings
from cpam_bayes.inference.sampling import EvidenceSettings, importance_evidence
from tests.toy_models import independent, two_peaks
from validation.nested import Lockstep, nested_evidence


def test_values_are_asked_for_in_stacks_and_answers_go_to_their_tasks() -> None:
    sizes = []

    def batched(points: np.ndarray) -> np.ndarray:
        sizes.append(len(points))
        return np.sum(points**2, axis=1)

    pool = Lockstep(batched, 4)

    def walk(start: int) -> list[float]:
        """As many values as the start says: tasks end at different times."""
        return [pool.value(np.array([float(start), float(i)])) for i in range(start)]

    found = pool.map(walk, range(6))
    assert found == [[float(s**2 + i**2) for i in range(s)] for s in range(6)]
    # tasks 0 to 3 go together, then 4 and 5: stacks as long as tasks are left
    assert sizes == [3, 2, 1, 2, 2, 2, 2, 1]
    assert pool.value(np.array([3.0])) == 9.0


def test_a_task_that_fails_fails_the_whole_and_hangs_nothing() -> None:
    pool = Lockstep(lambda points: points[:, 0], 3)

    def task(i: int) -> float:
        if i == 1:
            raise ValueError("no likelihood here")
        return pool.value(np.array([float(i)]))

    with pytest.raises(ValueError, match="no likelihood here"):
        pool.map(task, range(3))
    assert pool.map(task, [4, 5]) == [4.0, 5.0]


def test_a_likelihood_that_fails_fails_the_whole_and_hangs_nothing() -> None:
    def broken(points: np.ndarray) -> np.ndarray:
        raise FloatingPointError("no value")

    pool = Lockstep(broken, 3)
    with pytest.raises(FloatingPointError, match="no value"):
        pool.map(lambda i: pool.value(np.array([float(i)])), range(3))


@pytest.mark.slow
def test_nested_sampling_finds_the_closed_form_of_a_cut_gaussian() -> None:
    pytest.importorskip("dynesty")
    found = nested_evidence(independent((-1.0, 5.0)), 0, runs=3, live_points=60)
    exact = norm.logsf(1.0) + np.log(norm.cdf(5) - norm.cdf(-5)) + 2 * np.log(0.1)
    assert found.standard_error < 0.25
    assert found.log_evidence == pytest.approx(exact, abs=3.0 * found.standard_error)
    ratio = norm.pdf(1.0) / norm.sf(1.0)
    mean, sd = 0.1 * (ratio - 1.0), 0.1 * np.sqrt(1.0 + ratio - ratio**2)
    assert 0.0 < found.mean_error[0] < 0.15 * sd
    # three runs: their scatter, where it is the larger, is a t of two degrees of freedom
    assert found.mean[0] == pytest.approx(mean, abs=5.0 * found.mean_error[0])
    assert found.sd[0] == pytest.approx(sd, abs=5.0 * found.sd_error[0])


@pytest.mark.slow
def test_nested_and_importance_sampling_agree_on_two_peaks() -> None:
    pytest.importorskip("dynesty")
    own = two_peaks()
    nested = nested_evidence(own, 1, runs=3, live_points=80)
    sampled = importance_evidence(
        own,
        np.empty((0, 2)),
        1,
        settings=EvidenceSettings(draws=6000, adaptation=AdaptationSettings(draws=1000)),
    )
    error = np.hypot(nested.standard_error, sampled.standard_error)
    assert nested.log_evidence == pytest.approx(sampled.log_evidence, abs=3.0 * error)
    # the shares of two equal peaks drift in nested sampling, their common shape does not
    root_mean_square = [np.hypot(found.mean[0], found.sd[0]) for found in (nested, sampled)]
    assert root_mean_square[0] == pytest.approx(root_mean_square[1], rel=0.02)
