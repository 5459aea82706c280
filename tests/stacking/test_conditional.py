"""A given sequence: importance sampling against known integrals, bases and starts, queries."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import entropy

from cpam_bayes.forward_model.model import training_sets
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking import posterior as stacking_mixture
from cpam_bayes.stacking.conditional import ConditionalFits, RefinementSettings, importance_evidence
from cpam_bayes.stacking.evaluation import of_sequence, scan_library, scanned_starts
from cpam_bayes.stacking.posterior import MixtureSettings, sample_mixture
from cpam_bayes.stacking.queries import angle_information, bending_fractions, given_layup
from tests.stacking.cases import TRUE, answer, mixture, shortened

N = 3
LOG_Z = np.array([0.0, -7.0, 3.0])


def skewed(z: np.ndarray) -> np.ndarray:
    """Log of a normalised density (..., 3) with two tails: normals bent along the first coordinate."""
    bent = z[..., 1] - 0.5 * (z[..., 0] ** 2 - 1.0)
    squared = z[..., 0] ** 2 + bent**2 + (z[..., 2] - 2.0) ** 2 / 4.0
    return np.asarray(-0.5 * squared - 1.5 * np.log(2.0 * np.pi) - np.log(2.0))


class Known:
    """A posterior of three sequences with known densities, which counts the points evaluated."""

    template: Any = SimpleNamespace(log_prior=lambda x: np.zeros(len(x)))
    axes: Any = SimpleNamespace(to_x=lambda z: z, lower=[-np.inf] * N, upper=[np.inf] * N, **vars(template))
    operator = SimpleNamespace(blocks=[SimpleNamespace(size=1)])  # too small for a basis of its own
    model: Any = SimpleNamespace(fast=SimpleNamespace(operator=operator))
    points = 0

    def at(self, angles_deg: np.ndarray, rows: np.ndarray) -> Any:
        def log_likelihood(x: np.ndarray) -> np.ndarray:
            self.points += len(x)
            return skewed(x) + LOG_Z[angles_deg[rows, 0].astype(int)]

        return SimpleNamespace(log_likelihood=log_likelihood)


def fits(centre: float, sd: float) -> ConditionalFits:
    """Optima of three sequences at ``centre``, with a standard deviation; one of two has all the weight."""
    m = len(LOG_Z)
    optima, weight = np.full((m, 2, N), centre), np.tile([1.0, 0.0], (m, 1))
    curvature = np.broadcast_to(np.eye(N) / sd**2, (m, 2, N, N))
    return ConditionalFits(LOG_Z, optima[:, 0], np.zeros((m, 1)), optima, weight, curvature)


NUMBERS = np.arange(3.0)[:, None]


def test_the_evidence_of_a_known_density_is_found_within_its_error_from_more_points_while_unsure() -> None:
    own: Any = Known()
    found = importance_evidence(own, NUMBERS, fits(0.0, 1.0), 13)
    assert np.all(np.abs(found.log_evidence - LOG_Z) <= 4.0 * found.error)
    assert found.error.max() < 0.03
    np.testing.assert_allclose(found.mean[:, 2], 2.0, atol=0.1)  # third coordinate: normal about 2, sd 2
    np.testing.assert_allclose(found.sd[:, 2], 2.0, rtol=0.05)
    assert own.points == 3 * 2**13

    # sequences that remain unsure get more and more points
    def error_of(unsure: float, points: int) -> np.ndarray:
        own, settings = Known(), RefinementSettings(unsure=unsure)
        found = importance_evidence(own, NUMBERS, fits(0.0, 1.0), 9, settings=settings)
        assert own.points == 3 * points
        return found.error

    first = error_of(10.0, 2**9)
    error_of(0.75 * first.min(), 2**9 + 2**11)  # four times as many points halve the error
    assert error_of(0.0, 2**9 + 2**11 + 2**13).max() < 0.03


def test_a_proposal_that_lies_badly_is_refitted() -> None:
    own: Any = Known()
    refitted = importance_evidence(own, NUMBERS, fits(0.5, 0.6), 12)
    as_it_was = RefinementSettings(refitted_from=99, resampled_from=99)
    left = importance_evidence(own, NUMBERS, fits(0.5, 0.6), 12, settings=as_it_was)
    assert np.all(refitted.error < 0.7 * left.error)
    assert np.all(np.abs(refitted.log_evidence - LOG_Z) <= 4.0 * refitted.error)


ANGLES = np.array([TRUE, (60.0, 0.0)])


@pytest.mark.parametrize(("noise", "error"), [(0.1, 2e-4), (0.005, 1e-4), (0.001, 2e-5), (1e-5, 2e-5)])
def test_a_basis_for_one_sequence_is_good_for_all_constants(noise: float, error: float) -> None:
    whole = answer().conditional
    small = of_sequence(whole, ANGLES[0], noise)
    sets = training_sets(whole.model.full.operator.problem, 300, np.random.default_rng(1))
    sets[:, : whole.n_angles] = TRUE
    sizes = [max(block.size for block in c.model.fast.operator.blocks) for c in (whole, small)]
    assert sizes[1] < (0.5 if noise > 1e-3 else 1.0) * sizes[0]
    off = small.model.predict(sets).frequencies / whole.model.predict(sets).frequencies - 1.0
    assert off.min() > -1e-9, "projection makes no frequency lower"
    assert np.quantile(off, 0.97) < error
    assert off.max() < 3e-4, "in a corner of the box that no set came near"


@pytest.mark.slow
def test_moments_by_emcee_on_the_basis_of_a_sequence_are_those_on_the_whole_one(monkeypatch) -> None:
    small = mixture().components[0]
    monkeypatch.setattr(stacking_mixture, "of_sequence", lambda conditional, angles, noise: conditional)
    whole = sample_mixture(answer(), 0, settings=MixtureSettings(least=2.0)).components[0]
    # a fiftieth of the noise of a frequency is negligible beside the sampling errors
    for a, b in ((small.chains, whole.chains), (small.importance, whole.importance)):
        assert np.abs((a.mean - b.mean) / np.hypot(a.mean_error, b.mean_error)).max() < 4.0
    error = np.hypot(small.log_evidence_error, whole.log_evidence_error)
    assert abs(small.log_evidence - whole.log_evidence) < 4.0 * error


def test_starts_are_within_the_bounds_ordered_by_misfit_and_scaled_to_the_list() -> None:
    own = answer().conditional
    library = scan_library(own, 40, np.random.default_rng(0))
    assert library.shape == (40, own.n_constants)
    assert np.all(np.isfinite(own.template.log_prior(own.nominal(library))))
    starts, misfits = scanned_starts(own, ANGLES, library, 5)
    assert starts.shape == (2, 5, own.parameters.size)
    assert np.all((starts >= own.parameters.lower) & (starts <= own.parameters.upper))
    measured = own.template.measurement.frequencies
    for angles, row, told in zip(ANGLES, starts, misfits, strict=True):
        found = own.at(np.repeat(angles[None], len(row), axis=0)).predict(row)[:, : len(measured)]
        misfit = np.sqrt(np.mean(np.log(measured / found) ** 2, axis=1))
        np.testing.assert_allclose(misfit, told, rtol=1e-3)  # with bias the factor is only approximate
        assert np.all(np.diff(misfit) >= -1e-12)
    n = own.n_constants  # a member is used with the factor on its stiffnesses that suits the list
    truth = answer().components.fits.x[0, :n]
    moduli = [name[0] in "EG" for name in own.template.model.parameters.names[:n]]
    scaled = np.where(moduli, 0.9 * truth, truth)
    start = scanned_starts(own, answer().top[:1], scaled[None], 1)[0][0, 0, :n]
    # the factor on all stiffnesses restores the optimum, up to its mean residual, 2 % of a stiffness
    np.testing.assert_allclose(start, truth, rtol=0.02)


def test_plies_weigh_in_bending_as_their_second_moments() -> None:
    # two plies on either side of the middle: 1 - (1/2)^3 outside, (1/2)^3 inside
    np.testing.assert_allclose(bending_fractions(parse_layup("[?/?]_s")), [7 / 8, 1 / 8], rtol=1e-12)
    # a known ply in the middle of three: 1 - (2/3)^3 and (1/3)^3
    np.testing.assert_allclose(bending_fractions(parse_layup("[?/0/?]_s")), [19 / 27, 1 / 27], rtol=1e-12)


@pytest.mark.parametrize("certain", [(1.0, 0.6), (0.9, 0.6), (0.6, 0.9), (0.9, 0.9)])
def test_outer_angles_are_better_only_if_less_of_them_is_open(certain: tuple[float, float]) -> None:
    p = np.array([[c, 1.0 - c] for c in certain])
    found = angle_information(parse_layup("[?/?]_s"), p)
    np.testing.assert_allclose(found.entropy_bits, entropy(p, base=2, axis=1))
    assert (found.outer_better, found.most_bits) == (certain[0] > certain[1], 1.0)
    np.testing.assert_array_equal(found.outer_first, [0, 1])


def test_a_sequence_of_the_grid_has_the_probability_of_its_class_and_one_not_listed_is_computed() -> None:
    own = answer()
    found = given_layup(own, np.array(TRUE))  # the list has its mirror image
    np.testing.assert_array_equal(given_layup(own, np.array([-90.0, 30.0])).angles_deg, [90.0, 30.0])
    for angles in ((10.0, 0.0), (0.0, 30.0, 60.0)):
        with pytest.raises(ValueError, match="accepted: 2 angles on the grid of 30 degrees"):
            given_layup(own, np.array(angles))
    first = (1, own.probability[0], own.log_evidence[0])
    assert (found.rank, found.probability, found.log_evidence) == first
    found = given_layup(shortened(2), own.top[2])  # one that is not listed is computed
    assert found.rank is None
    # the errors of two estimates of one integral, plus one point in a thousand
    tolerance = 4.0 * np.hypot(found.log_evidence_error, own.log_evidence_error[2]) + 0.01
    assert found.log_evidence == pytest.approx(own.log_evidence[2], abs=tolerance)
    assert np.log(found.probability) == pytest.approx(np.log(own.probability[2]), abs=tolerance)
