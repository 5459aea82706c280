"""Importance sampling of many sequences at once, against densities whose integral is known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cpam_bayes.stacking.conditional import importance as sequence_importance
from cpam_bayes.stacking.conditional.importance import Conditionals, importance_evidence
from cpam_bayes.stacking.conditional.posterior import SequenceFits

N = 3
LOG_Z = np.array([0.0, -7.0, 3.0])


def skewed(z: np.ndarray) -> np.ndarray:
    """A normalised density (..., 3) with two tails: standard normals bent along the first coordinate."""
    bent = z[..., 1] - 0.5 * (z[..., 0] ** 2 - 1.0)
    squared = z[..., 0] ** 2 + bent**2 + (z[..., 2] - 2.0) ** 2 / 4.0
    return np.asarray(-0.5 * squared - 1.5 * np.log(2.0 * np.pi) - np.log(2.0))


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sequences whose density is known; how many points each call asked for in all."""
    asked: list[int] = []

    def log_density(own: Any, angles_deg: np.ndarray, z: np.ndarray) -> np.ndarray:
        asked.append(len(angles_deg) * z.shape[1])
        return skewed(z) + LOG_Z[angles_deg[:, 0].astype(int)][:, None]

    monkeypatch.setattr(sequence_importance, "_log_density", log_density)
    return asked


# a posterior whose model is so small that no sequence gets a basis of its own
SMALL = SimpleNamespace(fast=SimpleNamespace(operator=SimpleNamespace(blocks=[SimpleNamespace(size=1)])))
OWN: Any = SimpleNamespace(axes=SimpleNamespace(to_x=lambda z: z), model=SMALL)


def fits(centre: float, sd: float) -> SequenceFits:
    """Optima of three sequences at ``centre``, with a standard deviation; one of two counts."""
    m = len(LOG_Z)
    optima = np.full((m, 2, N), centre)
    weight = np.tile([1.0, 0.0], (m, 1))
    curvature = np.broadcast_to(np.eye(N) / sd**2, (m, 2, N, N))
    return SequenceFits(LOG_Z, optima[:, 0], np.zeros((m, 1)), optima, weight, curvature)


ANGLES = np.arange(3.0)[:, None]


def test_the_evidence_of_a_known_density_is_found_within_its_error(calls: list[int]) -> None:
    found = importance_evidence(OWN, ANGLES, fits(0.0, 1.0), 13)
    assert np.all(np.abs(found.log_evidence - LOG_Z) <= 4.0 * found.error)
    assert found.error.max() < 0.03
    # mean and sd of the third coordinate, a normal about 2 with sd 2
    np.testing.assert_allclose(found.mean[:, 2], 2.0, atol=0.1)
    np.testing.assert_allclose(found.sd[:, 2], 2.0, rtol=0.05)
    assert sum(calls) == 3 * 2**13


def test_a_proposal_that_lies_badly_is_refitted(calls: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    refitted = importance_evidence(OWN, ANGLES, fits(0.5, 0.6), 12)
    monkeypatch.setattr(sequence_importance, "_ADAPTED", 99)
    monkeypatch.setattr(sequence_importance, "_CAREFUL", 99)
    left = importance_evidence(OWN, ANGLES, fits(0.5, 0.6), 12)
    assert np.all(refitted.error < 0.7 * left.error)
    assert np.all(np.abs(refitted.log_evidence - LOG_Z) <= 4.0 * refitted.error)


def test_what_stays_unsure_is_sampled_with_more_and_more_points(
    calls: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def sampled(unsure: float, points: int) -> Conditionals:
        monkeypatch.setattr(sequence_importance, "_UNSURE", unsure)
        calls.clear()
        found = importance_evidence(OWN, ANGLES, fits(0.0, 1.0), 9)
        assert sum(calls) == 3 * points
        return found

    first = sampled(10.0, 2**9)
    sampled(0.75 * first.error.min(), 2**9 + 2**11)  # four times as many points halve the error
    found = sampled(0.0, 2**9 + 2**11 + 2**13)
    assert found.error.max() < 0.03
