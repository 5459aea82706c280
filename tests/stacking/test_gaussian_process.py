"""The regression that learns a log evidence, against functions that are known."""

import numpy as np

from cpam_bayes.stacking.surrogate.gaussian_process import fit_gaussian_process


def known(x: np.ndarray) -> np.ndarray:
    return np.column_stack((np.sin(2.0 * x[:, 0]) + x[:, 1] ** 2, np.cos(x[:, 0]) * x[:, 1]))


def points(n: int) -> np.ndarray:
    return np.asarray(np.random.default_rng(3).uniform(-1.0, 1.0, (n, 2)))


def test_a_smooth_function_is_approximated_with_its_gradient() -> None:
    x, new = points(150), np.random.default_rng(4).uniform(-0.9, 0.9, (50, 2))
    found = fit_gaussian_process(x, known(x), np.random.default_rng(0))
    # the spread of the functions is about one, and 150 points lie a twentieth apart
    np.testing.assert_allclose(found.values(new), known(new), atol=2e-3)
    _, slope = found.expansion(new)
    np.testing.assert_allclose(slope[:, 0, 0], 2.0 * np.cos(2.0 * new[:, 0]), atol=0.03)
    np.testing.assert_allclose(slope[:, 1, 1], np.cos(new[:, 0]), atol=0.03)


def test_length_scales_are_estimated_again_when_the_points_have_grown_by_a_quarter() -> None:
    x = points(150)
    rng = np.random.default_rng(0)
    first = fit_gaussian_process(x[:100], known(x[:100]), rng)
    few = fit_gaussian_process(x[:124], known(x[:124]), rng, like=first)
    many = fit_gaussian_process(x[:126], known(x[:126]), rng, like=first)
    np.testing.assert_array_equal(few.lengths, first.lengths)
    assert few.training_size == 100
    assert many.training_size == 126
    assert not np.array_equal(many.lengths, first.lengths)
    # the new points count all the same
    np.testing.assert_allclose(few.values(x[100:124]), known(x[100:124]), atol=2e-3)


def test_values_that_are_doubted_do_not_spoil_those_that_are_to_be_met() -> None:
    x, rng = points(150), np.random.default_rng(0)
    rough = x[:, 0] > 0.0
    y = known(x) + np.where(rough, 0.3, 0.0)[:, None] * np.random.default_rng(5).normal(size=(150, 2))
    error = {}
    for name, doubt in (("trusted", None), ("doubted", np.where(rough, 1e5, 1.0))):
        found = fit_gaussian_process(x, y, rng, nugget_factor=doubt)
        smooth = x[:, 0] < -0.1
        error[name] = float(np.abs(found.values(x[smooth]) - known(x[smooth])).max())
    assert error["doubted"] < 5e-3 < 0.05 < error["trusted"]
