"""Every sequence on a grid, enumerated by a surrogate, against a loop over all; its regression."""

from dataclasses import replace
from functools import cache
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from cpam_bayes.plate import angle_grid
from cpam_bayes.plate.laminate import laminate_geometry
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking.listing import Enumeration, combined, enumerate_prefixes, prefixes_to_visit
from cpam_bayes.stacking.records import StackingSettings
from cpam_bayes.stacking.search import PilotEnumeration
from cpam_bayes.stacking.surrogate import (
    PiecewiseLinearSurrogate,
    fit_gaussian_process,
    log_evidence,
    piecewise_linear_surrogate,
)
from cpam_bayes.stacking.symmetry import PlySums, ply_sums


def wave(x: np.ndarray) -> np.ndarray:
    return np.column_stack((np.sin(x[:, 0]) * np.cos(2 * x[:, 1]), x[:, 0] + x[:, 1] ** 2))


def test_a_mirrored_process_is_even_and_needs_half_the_plane() -> None:
    rng = np.random.default_rng(0)
    x, new = rng.uniform(0, 1, (120, 2)), rng.uniform(0.05, 0.95, (40, 2))
    signs = np.array([1.0, -1.0])
    found = fit_gaussian_process(x, wave(x), rng, np.array([np.ones(2), signs]))
    np.testing.assert_allclose(found.values(new * signs), found.values(new), atol=1e-12)
    np.testing.assert_allclose(found.values(new * signs), wave(new), atol=5e-3)
    slope = found.expansion(new)[1]
    np.testing.assert_allclose(found.expansion(new * signs)[1], slope * signs, atol=1e-9)


GRID = angle_grid(20.0)
# of this grid a right angle is a multiple
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


def everything(sums: PlySums, freedom: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    sequences = np.array(list(product(range(len(GRID)), repeat=4)))
    return sequences, surface(sums.features(sequences), freedom)


FLOOR = -12.0


@cache
def surrogate(floor: float, freedom: float = np.inf, halvings: int = 2) -> PiecewiseLinearSurrogate:
    bound = ply_sums(LAYUP, GRID).rest_bound
    return piecewise_linear_surrogate(tangent, bound, 0.0, -floor, halvings, slack=0.6, freedom=freedom)


# For each angle of the grid, the place of its negative.
NEGATION = np.array([int(np.flatnonzero(np.isclose((a + GRID) % 180.0, 0.0))[0]) for a in GRID])


def enumerator(sums: PlySums, mirrored: bool = True, threshold: float = np.inf) -> Enumeration:
    return Enumeration(surrogate(FLOOR), sums, 0.0, NEGATION if mirrored else None, threshold)


@pytest.fixture(scope="module")
def sums() -> PlySums:
    return ply_sums(LAYUP, GRID)


def test_noise_that_is_inferred_is_marginalised_over() -> None:
    # residuals far above their unit: integrated over d sigma / sigma, n of them give |z|^-n up to a factor
    z = np.array([[0.5, -1.0, 2.0, 0.1, 0.0], [5.0, -10.0, 20.0, 1.0, 0.0]])
    n = 4
    sigma = np.geomspace(1e-3, 1e4, 20001)
    density = -0.5 * np.sum(z[:, :-1] ** 2, axis=1)[:, None] / sigma**2 - n * np.log(sigma)
    marginal = np.log(np.trapezoid(np.exp(density), np.log(sigma)))
    found = log_evidence(1e3 * z, 4.0)
    assert found[1] - found[0] == pytest.approx(marginal[1] - marginal[0], abs=1e-4)
    np.testing.assert_allclose(log_evidence(z[:1], 1e9), log_evidence(z[:1], np.inf), rtol=1e-8)


def test_the_first_sums_are_the_bending_lamination_parameters(sums: PlySums) -> None:
    sequences = np.random.default_rng(0).integers(len(GRID), size=(30, 4))
    geometry = laminate_geometry(LAYUP.angles(GRID[sequences]), symmetric=True)
    w0, cos2, cos4, sin2, sin4 = geometry.flexural.T
    expected = np.stack((cos2, sin2, cos4, sin4), axis=1) / w0[:, None]
    np.testing.assert_allclose(sums.features(sequences)[:, :4], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("motion", "turned"),
    [("mirror image", -GRID18), ("quarter turn", GRID18 + 90.0), ("diagonal mirror image", 90.0 - GRID18)],
)
def test_images_have_the_sums_with_the_signs_of_their_motion(motion: str, turned: np.ndarray) -> None:
    own = ply_sums(LAYUP, GRID18)
    place = np.array([int(np.argmin(np.abs((GRID18 - a + 90.0) % 180.0 - 90.0))) for a in turned])
    sequences = np.random.default_rng(2).integers(len(GRID18), size=(30, 4))
    np.testing.assert_allclose(
        own.features(place[sequences]), own.features(sequences) * own.signs(motion), atol=1e-12
    )


def test_unsymmetric_layups_are_refused() -> None:
    with pytest.raises(ValueError, match="symmetric layup"):
        ply_sums(parse_layup("[?/?/?/?]"), GRID)


@pytest.mark.parametrize("mirrored", [True, False])
def test_sums_over_all_sequences_are_those_of_a_loop(sums: PlySums, mirrored: bool) -> None:
    sequences, value = everything(sums)
    own = enumerator(sums, mirrored)
    piece = enumerate_prefixes(own, prefixes_to_visit(own))
    inside = own.table.lookup(sums.features(sequences)[:, :4]) >= 0
    assert piece.kept == inside.sum()
    assert piece.kept + piece.left_out == len(sequences) == 9**4
    weight = np.exp(value) * inside
    # scores are linear for this surface; its values are kept in single precision
    assert piece.mass.sum() == pytest.approx(weight.sum(), rel=1e-5)
    assert piece.weight.sum() == pytest.approx(weight.sum(), rel=1e-5)
    kept = weight[inside]
    assert piece.entropy == pytest.approx(np.sum(kept * value[inside]), rel=1e-5)
    marginal = np.stack([np.bincount(sequences[:, j], weight, minlength=9) for j in (1, 2, 3)])
    found = piece.inner
    if mirrored:
        found = 0.5 * (found + found[:, NEGATION])
    np.testing.assert_allclose(found, marginal, rtol=1e-5, atol=1e-5 * weight.sum())
    assert not len(piece.listed)


@pytest.mark.parametrize(
    ("freedom", "floor", "halvings"), [(np.inf, FLOOR, 2), (np.inf, -6.0, 1), (6.0, -3.0, 1)]
)
def test_what_is_left_out_lies_below_the_floor(
    sums: PlySums, freedom: float, floor: float, halvings: int
) -> None:
    sequences, value = everything(sums, freedom)
    table = surrogate(floor, freedom, halvings)
    outside = table.lookup(sums.features(sequences)[:, :4]) < 0
    assert outside.any()
    assert value[outside].max() < floor


@pytest.mark.parametrize("mirrored", [True, False])
def test_the_list_holds_all_above_the_threshold_and_the_sums_all_below(sums: PlySums, mirrored: bool) -> None:
    sequences, value = everything(sums)
    own = enumerator(sums, mirrored, threshold=-2.0)
    piece = combined([enumerate_prefixes(own, p) for p in np.array_split(prefixes_to_visit(own), 3)])
    high = value >= -2.0
    assert piece.times.sum() == high.sum()
    np.testing.assert_allclose(piece.log_evidence, surface(sums.features(piece.listed)), atol=1e-4)
    inside = own.table.lookup(sums.features(sequences)[:, :4]) >= 0
    assert piece.mass.sum() == pytest.approx(np.exp(value[inside & ~high]).sum(), rel=1e-5)
    assert piece.kept == inside.sum()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_share_of_the_sequences_stands_for_all_but_those_that_are_listed(sums: PlySums, seed: int) -> None:
    whole = enumerator(sums, threshold=-0.5)
    mixed = np.random.default_rng(seed).permutation(len(GRID) ** whole.n_inner)
    own = replace(whole, share=3, mixed=mixed)
    every, some = (enumerate_prefixes(of, prefixes_to_visit(of)) for of in (whole, own))
    assert 0 < len(every.listed) < 400
    np.testing.assert_array_equal(some.listed, every.listed)
    # 9^4 sequences, of which a third is looked at: 2 % is four standard errors of that sum
    assert some.mass.sum() == pytest.approx(every.mass.sum(), rel=0.02)
    assert some.kept == pytest.approx(every.kept, rel=0.02)
    np.testing.assert_allclose(some.inner / some.mass.sum(), every.inner / every.mass.sum(), atol=0.02)


def pilot_of(sums: PlySums, best: int, fitted: int) -> tuple[PilotEnumeration, SimpleNamespace]:
    """All sequences but the best ones, which are 0.2 nats above, are alike.

    fitted : at most, one by one
    """
    value = np.full(len(GRID) ** 4, -0.5)
    value[:best] = -0.3
    every = Enumeration(None, sums, 0.0, None, np.inf, value.reshape(len(GRID), -1))
    pilot = PilotEnumeration(every, enumerate_prefixes(every, prefixes_to_visit(every)), 1.0)
    plate = SimpleNamespace(source="flat.toml")
    settings = StackingSettings(max_fitted=fitted)
    return pilot, SimpleNamespace(settings=settings, specimen=plate, n_sequences=len(value))


def test_where_a_bin_holds_more_than_a_short_list_it_is_listed_all_the_same(sums: PlySums) -> None:
    # as where the list tells little: the longest list holds too little of the mass to be worth it
    pilot, problem = pilot_of(sums, 1000, fitted=1500)
    listing = pilot.listing(problem)
    assert len(enumerate_prefixes(listing, prefixes_to_visit(listing)).listed) == 1000


def test_frequencies_that_tell_nothing_of_the_angles_are_refused(sums: PlySums) -> None:
    pilot, problem = pilot_of(sums, 0, fitted=100)
    with pytest.raises(ValueError, match=r"flat\.toml: .* about 6561 of 6561 are as probable as the best"):
        pilot.listing(problem)


def test_values_on_cells_are_those_of_their_tangents(sums: PlySums) -> None:
    # steep as with a noise of 1e-4, where a tangent continued to zero is far from its cell
    steep = 300.0

    def steeper(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y, slope = tangent(x)
        return np.column_stack((steep * y[:, :4], y[:, 4])), slope * np.array([steep] * 4 + [1.0])[:, None]

    table = piecewise_linear_surrogate(
        steeper, sums.rest_bound, 0.0, 1e6, halvings=1, slack=0.6, freedom=np.inf
    )
    x = sums.features(np.random.default_rng(3).integers(len(GRID), size=(400, 4)))
    x = x[table.lookup(x[:, :4]) >= 0]
    found = table.values(table.lookup(x[:, :4]), np.column_stack((np.ones(len(x)), x)).astype(np.float32))
    exact = log_evidence(steeper(x)[0], np.inf)
    assert len(x) > 50
    # single precision of scores of some hundreds
    np.testing.assert_allclose(found, exact, rtol=3e-6, atol=1e-4)
