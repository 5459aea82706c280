"""Constants of given sequences: bounded least squares in stacks, against closed forms and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares, lsq_linear

from cpam_bayes.identification.conditional_misfit import fit_constants

RNG = np.random.default_rng(5)
SLOPES = RNG.normal(size=(7, 6, 3))  # one linear model a sequence
MEASURED = RNG.normal(size=6)
LOWER, UPPER = np.array([-0.3, -0.2, 0.0]), np.array([0.4, 0.5, 0.6])
STARTS = np.array([[0.0, 0.0, 0.1], [0.3, 0.4, 0.5]])
NUMBERS = np.arange(7.0)[:, None]


def everywhere(x: np.ndarray) -> np.ndarray:
    return np.ones(len(x), dtype=bool)


def linear(constants: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    slope = SLOPES[numbers[:, 0].astype(int)]
    return np.einsum("mij,mj->mi", slope, constants), slope


def curved(constants: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    f, slope = linear(constants, numbers)
    return f + 0.1 * f**2, slope * (1.0 + 0.2 * f)[..., None]


@pytest.mark.parametrize("weighted", [False, True])
def test_linear_problems_have_the_bounded_least_squares_solution(weighted: bool) -> None:
    weight = np.linspace(0.5, 3.0, 6) if weighted else None
    root = np.ones(6) if weight is None else np.sqrt(weight)
    found = fit_constants(linear, everywhere, NUMBERS, STARTS, MEASURED, LOWER, UPPER, weight=weight)
    assert found.settled.all()
    on_bound = 0
    for i, slope in enumerate(SLOPES):
        exact = lsq_linear(root[:, None] * slope, root * MEASURED, bounds=(LOWER, UPPER), tol=1e-14)
        # settled to 1e-9 of F, so to its root of the distance of the bounds
        assert_allclose(found.values[i], 2.0 * exact.cost, rtol=1e-8)
        assert_allclose(found.constants[i], exact.x, atol=1e-4)
        on_bound += int(np.any((found.constants[i] == LOWER) | (found.constants[i] == UPPER)))
    assert on_bound > 0, "some of the optima lie on a bound"


def test_curved_problems_reach_what_scipy_reaches() -> None:
    found = fit_constants(curved, everywhere, NUMBERS, STARTS, MEASURED, LOWER, UPPER)
    for i in range(len(SLOPES)):
        number = NUMBERS[i : i + 1]
        best = min(
            2.0
            * least_squares(
                lambda x, n=number: curved(x[None], n)[0][0] - MEASURED,
                start,
                bounds=(LOWER, UPPER),
                xtol=1e-12,
            ).cost
            for start in STARTS
        )
        assert found.values[i] <= best * (1.0 + 1e-7)


def test_steps_stay_where_the_constraints_hold() -> None:
    def below(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[:, 0] + x[:, 1] < 0.35)

    asked: list[np.ndarray] = []

    def watched(constants: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(constants)
        return linear(constants, numbers)

    found = fit_constants(watched, below, NUMBERS, STARTS[:1], MEASURED, LOWER, UPPER)
    assert all(below(x).all() for x in asked)
    assert all(np.all((x >= LOWER) & (x <= UPPER)) for x in asked)
    assert found.evaluations == sum(len(x) for x in asked)


def test_a_further_start_never_gives_a_higher_minimum() -> None:
    one, both = (
        fit_constants(curved, everywhere, NUMBERS, s, MEASURED, LOWER, UPPER) for s in (STARTS[:1], STARTS)
    )
    assert np.all(both.values <= one.values)


def test_a_stack_gives_what_its_problems_give_alone() -> None:
    whole = fit_constants(curved, everywhere, NUMBERS, STARTS, MEASURED, LOWER, UPPER)
    for i in range(len(SLOPES)):
        alone = fit_constants(curved, everywhere, NUMBERS[i : i + 1], STARTS, MEASURED, LOWER, UPPER)
        assert_allclose(alone.constants[0], whole.constants[i], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("start", [[0.0, 0.0, 0.7], [0.35, 0.3, 0.1]])
def test_a_start_outside_is_refused(start: list[float]) -> None:
    def below(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[:, 0] + x[:, 1] < 0.6)

    with pytest.raises(ValueError, match="starts of the constants"):
        fit_constants(linear, below, NUMBERS, np.array([start]), MEASURED, LOWER, UPPER)
