"""Every sequence on a grid, enumerated by a surrogate, against a loop over all; its regression."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from cpam_bayes.plate import angle_grid
from cpam_bayes.plate.laminate import laminate_geometry
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking.listing import Enumeration, combined, enumerate_prefixes, prefixes_to_visit
from cpam_bayes.stacking.records import StackingSettings
from cpam_bayes.stacking.search import PilotEnumeration
from cpam_bayes.stacking.surrogate import fit_gaussian_process, log_evidence, piecewise_linear_surrogate
from cpam_bayes.stacking.symmetry import all_sequences, ply_sums


def wave(x: np.ndarray) -> np.ndarray:
    return np.column_stack((np.sin(x[:, 0]) * np.cos(2 * x[:, 1]), x[:, 0] + x[:, 1] ** 2))


def test_a_mirrored_process_is_even_and_needs_half_the_plane() -> None:
    rng, signs = np.random.default_rng(0), np.array([1.0, -1.0])
    x, new = rng.uniform(0, 1, (120, 2)), rng.uniform(0.05, 0.95, (40, 2))
    found = fit_gaussian_process(x, wave(x), rng, np.array([np.ones(2), signs]))
    np.testing.assert_allclose(found.values(new * signs), found.values(new), atol=1e-12)
    np.testing.assert_allclose(found.values(new * signs), wave(new), atol=5e-3)
    slope = found.expansion(new)[1]
    np.testing.assert_allclose(found.expansion(new * signs)[1], slope * signs, atol=1e-9)


GRID = angle_grid(20.0)
# a right angle is a multiple of this grid's step
GRID18 = angle_grid(18.0)
LAYUP = parse_layup("[?/?/?/?]_s")
CENTRE = np.array([0.3, 0.0, -0.1, 0.0])
SCALE = np.array([0.15, 0.2, 0.25, 0.3])


def tangent(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A Gaussian valley over v, even in the sines, with a slope in the first further sum."""
    y = np.column_stack(((x[:, :4] - CENTRE) / SCALE, 2.0 * x[:, 4]))
    slope = np.zeros((*y.shape, x.shape[1]))
    slope[:, np.arange(4), np.arange(4)] = 1.0 / SCALE
    slope[:, 4, 4] = 2.0
    return y, slope


def surface(x: np.ndarray, freedom: float = np.inf) -> np.ndarray:
    return log_evidence(tangent(x)[0], freedom)


SUMS = ply_sums(LAYUP, GRID)
EVERY = all_sequences(len(GRID), 4)
FEATURES = SUMS.features(EVERY)
FLOOR = -12.0


@cache
def surrogate(floor: float, freedom: float = np.inf, halvings: int = 2):
    of = {"slack": 0.6, "freedom": freedom}
    return piecewise_linear_surrogate(tangent, SUMS.rest_bound, 0.0, -floor, halvings, **of)


# Index of the negative of each grid angle.
NEGATION = np.array([int(np.flatnonzero(np.isclose((a + GRID) % 180.0, 0.0))[0]) for a in GRID])


def enumerator(mirrored: bool = True, threshold: float = np.inf) -> Enumeration:
    return Enumeration(surrogate(FLOOR), SUMS, 0.0, NEGATION if mirrored else None, threshold)


def listed_by(own: Enumeration):
    return enumerate_prefixes(own, prefixes_to_visit(own))


def test_noise_that_is_inferred_is_marginalised_over() -> None:
    # residuals far above their unit: integrated over d sigma / sigma, n of them give |z|^-n up to a factor
    z = np.array([[0.5, -1.0, 2.0, 0.1, 0.0], [5.0, -10.0, 20.0, 1.0, 0.0]])
    n, sigma = 4, np.geomspace(1e-3, 1e4, 20001)
    density = -0.5 * np.sum(z[:, :-1] ** 2, axis=1)[:, None] / sigma**2 - n * np.log(sigma)
    marginal = np.log(np.trapezoid(np.exp(density), np.log(sigma)))
    found = log_evidence(1e3 * z, 4.0)
    assert found[1] - found[0] == pytest.approx(marginal[1] - marginal[0], abs=1e-4)
    np.testing.assert_allclose(log_evidence(z[:1], 1e9), log_evidence(z[:1], np.inf), rtol=1e-8)


def test_the_first_sums_are_the_bending_lamination_parameters_of_symmetric_layups_alone() -> None:
    geometry = laminate_geometry(LAYUP.angles(GRID[EVERY]), symmetric=True)
    w0, cos2, cos4, sin2, sin4 = geometry.flexural.T
    expected = np.stack((cos2, sin2, cos4, sin4), axis=1) / w0[:, None]
    np.testing.assert_allclose(FEATURES[:, :4], expected, atol=1e-12)
    with pytest.raises(ValueError, match="symmetric layup"):
        ply_sums(parse_layup("[?/?/?/?]"), GRID)


def test_images_have_the_sums_with_the_signs_of_their_motion() -> None:
    own, sequences = ply_sums(LAYUP, GRID18), np.random.default_rng(2).integers(len(GRID18), size=(30, 4))
    motions = {"mirror image": -GRID18, "quarter turn": GRID18 + 90.0, "diagonal mirror image": 90.0 - GRID18}
    for motion, turned in motions.items():
        place = np.array([int(np.argmin(np.abs((GRID18 - a + 90.0) % 180.0 - 90.0))) for a in turned])
        expected = own.features(sequences) * own.signs(motion)
        np.testing.assert_allclose(own.features(place[sequences]), expected, atol=1e-12, err_msg=motion)


@pytest.mark.parametrize("mirrored", [True, False])
def test_sums_over_all_sequences_are_those_of_a_loop(mirrored: bool) -> None:
    own, value = enumerator(mirrored), surface(FEATURES)
    piece = listed_by(own)
    inside = own.table.lookup(FEATURES[:, :4]) >= 0
    assert piece.kept == inside.sum()
    assert piece.kept + piece.left_out == len(EVERY) == 9**4
    weight = np.exp(value) * inside
    assert piece.mass.sum() == pytest.approx(weight.sum(), rel=1e-5)  # linear scores, single precision
    assert piece.weight.sum() == pytest.approx(weight.sum(), rel=1e-5)
    assert piece.entropy == pytest.approx(np.sum(weight * value), rel=1e-5)
    marginal = np.stack([np.bincount(EVERY[:, j], weight, minlength=9) for j in (1, 2, 3)])
    found = 0.5 * (piece.inner + piece.inner[:, NEGATION]) if mirrored else piece.inner
    np.testing.assert_allclose(found, marginal, rtol=1e-5, atol=1e-5 * weight.sum())
    assert not len(piece.listed)


def test_what_is_left_out_lies_below_the_floor() -> None:
    for freedom, floor, halvings in ((np.inf, FLOOR, 2), (np.inf, -6.0, 1), (6.0, -3.0, 1)):
        outside = surrogate(floor, freedom, halvings).lookup(FEATURES[:, :4]) < 0
        assert outside.any()
        assert surface(FEATURES, freedom)[outside].max() < floor


@pytest.mark.parametrize("mirrored", [True, False])
def test_the_list_holds_all_above_the_threshold_and_the_sums_all_below(mirrored: bool) -> None:
    own, value = enumerator(mirrored, threshold=-2.0), surface(FEATURES)
    piece = combined([enumerate_prefixes(own, p) for p in np.array_split(prefixes_to_visit(own), 3)])
    high = value >= -2.0
    assert piece.times.sum() == high.sum()
    np.testing.assert_allclose(piece.log_evidence, surface(SUMS.features(piece.listed)), atol=1e-4)
    inside = own.table.lookup(FEATURES[:, :4]) >= 0
    assert piece.mass.sum() == pytest.approx(np.exp(value[inside & ~high]).sum(), rel=1e-5)
    assert piece.kept == inside.sum()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_share_of_the_sequences_stands_for_all_but_those_that_are_listed(seed: int) -> None:
    whole = enumerator(threshold=-0.5)
    mixed = np.random.default_rng(seed).permutation(len(GRID) ** whole.n_inner)
    every, some = listed_by(whole), listed_by(replace(whole, share=3, mixed=mixed))
    assert 0 < len(every.listed) < 400
    np.testing.assert_array_equal(some.listed, every.listed)
    assert some.mass.sum() == pytest.approx(every.mass.sum(), rel=0.02)  # 2 % is four standard errors
    assert some.kept == pytest.approx(every.kept, rel=0.02)
    np.testing.assert_allclose(some.inner / some.mass.sum(), every.inner / every.mass.sum(), atol=0.02)


def listing_of(best: int, fitted: int) -> Enumeration:
    """Listing of equal sequences, except for the best ones 0.2 nats above; fitted : the most one by one."""
    value = np.where(np.arange(len(EVERY)) < best, -0.3, -0.5)
    every = Enumeration(None, SUMS, 0.0, None, np.inf, value.reshape(len(GRID), -1))
    plate, settings = SimpleNamespace(source="flat.toml"), StackingSettings(max_fitted=fitted)
    problem = SimpleNamespace(settings=settings, specimen=plate, n_sequences=len(value))
    return PilotEnumeration(every, listed_by(every), 1.0).listing(problem)


def test_a_bin_of_more_than_a_short_list_is_listed_and_sequences_that_are_all_alike_are_refused() -> None:
    # as for an uninformative list: the longest listing holds too little of the mass to be worth it
    assert len(listed_by(listing_of(1000, fitted=1500)).listed) == 1000
    with pytest.raises(ValueError, match=r"flat\.toml: .* about 6561 of 6561 are as probable as the best"):
        listing_of(0, fitted=100)


def test_values_on_cells_are_those_of_their_tangents() -> None:
    steep = 300.0  # steep as for a noise of 1e-4, where a tangent extended to zero is far from its cell

    def steeper(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y, slope = tangent(x)
        return np.column_stack((steep * y[:, :4], y[:, 4])), slope * np.array([steep] * 4 + [1.0])[:, None]

    of = {"halvings": 1, "slack": 0.6, "freedom": np.inf}
    table = piecewise_linear_surrogate(steeper, SUMS.rest_bound, 0.0, 1e6, **of)
    x = FEATURES[np.random.default_rng(3).integers(len(FEATURES), size=400)]
    x = x[table.lookup(x[:, :4]) >= 0]
    found = table.values(table.lookup(x[:, :4]), np.column_stack((np.ones(len(x)), x)).astype(np.float32))
    exact = log_evidence(steeper(x)[0], np.inf)
    assert len(x) > 50
    np.testing.assert_allclose(found, exact, rtol=3e-6, atol=1e-4)  # single precision of large scores
