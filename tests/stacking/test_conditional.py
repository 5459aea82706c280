"""Many sequences at once: importance sampling against known integrals."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from cpam_bayes.stacking.conditional import (
    ConditionalFits,
    Conditionals,
    RefinementSettings,
    importance_evidence,
)

N = 3
LOG_Z = np.array([0.0, -7.0, 3.0])


def skewed(z: np.ndarray) -> np.ndarray:
    """A normalised density (..., 3) with two tails: standard normals bent along the first coordinate."""
    bent = z[..., 1] - 0.5 * (z[..., 0] ** 2 - 1.0)
    squared = z[..., 0] ** 2 + bent**2 + (z[..., 2] - 2.0) ** 2 / 4.0
    return np.asarray(-0.5 * squared - 1.5 * np.log(2.0 * np.pi) - np.log(2.0))


class Known:
    """A posterior of three sequences whose density is known; how many points were asked for in all."""

    axes: Any = SimpleNamespace(
        to_x=lambda z: z,
        lower=np.full(N, -np.inf),
        upper=np.full(N, np.inf),
        log_prior=lambda z: np.zeros(len(z)),
    )
    template: Any = SimpleNamespace(log_prior=lambda x: np.zeros(len(x)))
    # so small that no sequence gets a basis of its own
    model: Any = SimpleNamespace(
        fast=SimpleNamespace(operator=SimpleNamespace(blocks=[SimpleNamespace(size=1)]))
    )

    def __init__(self) -> None:
        self.points = 0

    def at(self, angles_deg: np.ndarray, rows: np.ndarray) -> Any:
        def log_likelihood(x: np.ndarray) -> np.ndarray:
            self.points += len(x)
            return skewed(x) + LOG_Z[angles_deg[rows, 0].astype(int)]

        return SimpleNamespace(log_likelihood=log_likelihood)


def fits(centre: float, sd: float) -> ConditionalFits:
    """Optima of three sequences at ``centre``, with a standard deviation; one of two counts."""
    m = len(LOG_Z)
    optima = np.full((m, 2, N), centre)
    weight = np.tile([1.0, 0.0], (m, 1))
    curvature = np.broadcast_to(np.eye(N) / sd**2, (m, 2, N, N))
    return ConditionalFits(LOG_Z, optima[:, 0], np.zeros((m, 1)), optima, weight, curvature)


ANGLES = np.arange(3.0)[:, None]


def test_the_evidence_of_a_known_density_is_found_within_its_error() -> None:
    own: Any = Known()
    found = importance_evidence(own, ANGLES, fits(0.0, 1.0), 13)
    assert np.all(np.abs(found.log_evidence - LOG_Z) <= 4.0 * found.error)
    assert found.error.max() < 0.03
    # mean and sd of the third coordinate, a normal about 2 with sd 2
    np.testing.assert_allclose(found.mean[:, 2], 2.0, atol=0.1)
    np.testing.assert_allclose(found.sd[:, 2], 2.0, rtol=0.05)
    assert own.points == 3 * 2**13


def test_a_proposal_that_lies_badly_is_refitted() -> None:
    own: Any = Known()
    refitted = importance_evidence(own, ANGLES, fits(0.5, 0.6), 12)
    as_it_was = RefinementSettings(refitted_from=99, resampled_from=99)
    left = importance_evidence(own, ANGLES, fits(0.5, 0.6), 12, settings=as_it_was)
    assert np.all(refitted.error < 0.7 * left.error)
    assert np.all(np.abs(refitted.log_evidence - LOG_Z) <= 4.0 * refitted.error)


def test_what_stays_unsure_is_sampled_with_more_and_more_points() -> None:
    def sampled(unsure: float, points: int) -> Conditionals:
        own: Any = Known()
        settings = RefinementSettings(unsure=unsure)
        found = importance_evidence(own, ANGLES, fits(0.0, 1.0), 9, settings=settings)
        assert own.points == 3 * points
        return found

    first = sampled(10.0, 2**9)
    sampled(0.75 * first.error.min(), 2**9 + 2**11)  # four times as many points halve the error
    found = sampled(0.0, 2**9 + 2**11 + 2**13)
    assert found.error.max() < 0.03
