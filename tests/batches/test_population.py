"""Mean and scatter of a batch: Gaussian integrals, a posterior on a grid, a simulated truth, refusals."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import cpam_bayes as cb
from cpam_bayes.answer import Verdict
from cpam_bayes.batches.limits import MarginalPosterior
from cpam_bayes.batches.plate_row import LocalLikelihood, PlateRow, RowConstant
from cpam_bayes.batches.population import batch_posterior, population_of
from tests.batches.plates import plate, with_noise


def likelihood(at: Any, information: Any, gradient: Any = None) -> LocalLikelihood:
    at, information = np.atleast_1d(at), np.atleast_2d(information)
    g = np.zeros(len(at)) if gradient is None else np.atleast_1d(gradient)
    names = ("E1", "E2", "nu12", "G12")[: len(at)]
    return LocalLikelihood(names, tuple(at), tuple(g), tuple(map(tuple, information)))


def row(number: int, local: LocalLikelihood, lower: float = 0.0, upper: float = 200.0) -> PlateRow:
    constants = tuple(
        RowConstant(name, v, 1.0, 0.0, 1.0, Verdict.DATA, MarginalPosterior(v, 1.0, lower, upper))
        for name, v in zip(local.names, local.at, strict=True)
    )
    return PlateRow(f"p{number}", f"p{number}", "done", "", "carbon", constants, local)


def test_the_likelihood_is_the_gaussian_of_both_scatters_together() -> None:
    """N(at; mu, T + F^-1) over the integral of exp(-1/2 d F d), and the same with a slope at the optimum."""
    rng = np.random.default_rng(2)
    a = rng.standard_normal((3, 3))
    f = a @ a.T + np.eye(3)
    at, g = np.array([5.0, 2.0, 1.0]), np.array([0.3, -0.2, 0.1])
    density = batch_posterior([likelihood(at, f, g)], [(0.0, 50.0)] * 3)
    for _ in range(5):
        mean, scatter = at * rng.uniform(0.8, 1.2, 3), rng.uniform(1e-4, 0.4, 3)
        x = np.concatenate((mean / density.scale, scatter))
        tau = scatter * density.scale
        peak = at + np.linalg.solve(f, g)
        expected = (
            multivariate_normal(mean, np.diag(tau**2) + np.linalg.inv(f)).logpdf(peak)
            + 1.5 * np.log(2.0 * np.pi)
            - 0.5 * np.linalg.slogdet(f)[1]
            + 0.5 * g @ np.linalg.solve(f, g)
        )
        assert density.log_likelihood(x[None])[0] == pytest.approx(expected, rel=1e-9)


def test_the_chains_have_the_posterior_that_a_grid_gives() -> None:
    rng = np.random.default_rng(5)
    own = 1.5
    values = 100.0 + 3.0 * rng.standard_normal(12) + own * rng.standard_normal(12)
    rows = [row(i, likelihood(v, own**-2.0)) for i, v in enumerate(values)]
    population = population_of(rows, seed=0)
    (found,) = population.constants
    density = batch_posterior([likelihood(v, own**-2.0) for v in values], [(0.0, 200.0)])
    mean = np.linspace(0.93, 1.07, 241)
    scatter = np.linspace(1e-4, 0.16, 321)
    x = np.stack(np.meshgrid(mean, scatter, indexing="ij"), axis=-1).reshape(-1, 2)
    log_p = density.log_prob(x)
    p = np.exp(log_p - log_p.max()).reshape(len(mean), len(scatter))
    p /= p.sum()
    for values_of, marginal, (m, sd, low, high) in (
        (mean * density.scale[0], p.sum(axis=1), found.mean),
        (scatter, p.sum(axis=0), found.scatter),
    ):
        expected = float(marginal @ values_of)
        spread = float(np.sqrt(marginal @ (values_of - expected) ** 2))
        # a thousand effective draws know a mean to 3 % of the spread, a quantile to some 6 %
        assert m == pytest.approx(expected, abs=0.12 * spread)
        assert sd == pytest.approx(spread, rel=0.12)
        cumulative = np.cumsum(marginal)
        for quantile, level in ((low, 0.025), (high, 0.975)):
            assert quantile == pytest.approx(np.interp(level, cumulative, values_of), abs=0.25 * spread)
    assert population.status == "converged"
    wide = np.hypot(found.mean[1], found.scatter[0] * 100.0)
    assert found.next_plate[1] == pytest.approx(wide, rel=0.15)


def test_a_simulated_batch_gives_back_its_mean_and_scatter() -> None:
    """Sixty plates with two constants that each list knows together better than alone."""
    rng = np.random.default_rng(9)
    mean, scatter = np.array([120.0, 9.0]), np.array([0.03, 0.05])
    covariance = np.array([[4.0, -0.5], [-0.5, 0.16]])
    rows = []
    for i in range(60):
        true = mean * (1.0 + scatter * rng.standard_normal(2))
        seen = rng.multivariate_normal(true, covariance)
        rows.append(row(i, likelihood(seen, np.linalg.inv(covariance))))
    population = population_of(rows, seed=0)
    for k, c in enumerate(population.constants):
        assert abs(c.mean[0] - mean[k]) < 3.0 * c.mean[1]
        assert c.mean[1] == pytest.approx(
            np.sqrt((scatter[k] * mean[k]) ** 2 + covariance[k, k]) / np.sqrt(60), rel=0.25
        )
        assert abs(c.scatter[0] - scatter[k]) < 3.0 * c.scatter[1]
        assert c.scatter[1] < 0.5 * c.scatter[0]


def test_plates_that_do_not_scatter_have_a_small_one_and_open_constants_the_prior() -> None:
    rng = np.random.default_rng(3)
    information = np.diag([1.0, 0.0])  # E1 to 1 of 100, nothing about the other
    rows = [row(i, likelihood([100.0 + rng.standard_normal(), 50.0], information)) for i in range(25)]
    e1, e2 = population_of(rows, seed=0).constants
    assert e1.scatter[3] < 0.015
    # half a Student-t of 5 % and four degrees of freedom has its median at 3.7 %, its mean at 5 %
    assert e2.scatter[0] == pytest.approx(0.049, abs=0.008)
    assert e2.mean[1] == pytest.approx(200.0 / np.sqrt(12.0), rel=0.1)


@pytest.mark.slow
def test_lists_of_simulated_plates_give_the_constants_of_their_material(run: Any) -> None:
    rng = np.random.default_rng(1)
    moduli = 70.0 * (1.0 + 0.03 * rng.standard_normal(8))
    plates = [with_noise(plate(f"p{i}", e1=e), rng) for i, e in enumerate(moduli)]
    result = cb.batch(*plates, hierarchical=True)
    assert result.population is not None
    e1 = result.population.constants[0]
    assert abs(e1.mean[0] / 1e9 - moduli.mean()) < 3.0 * e1.mean[1] / 1e9
    assert e1.scatter[2] < 0.03 < e1.scatter[3]
    again = cb.batch(*plates, hierarchical=True, executor="serial")
    assert again.population is not None
    np.testing.assert_array_equal(again.population.draws, result.population.draws)
    document = result.to_dict()["population"]["constants"]["E1_GPa"]
    assert document["mean"]["mean"] == pytest.approx(e1.mean[0] / 1e9)
    assert document["scatter_percent"]["mean"] == pytest.approx(100.0 * e1.scatter[0])
    assert "The material" in result.summary()


def test_a_batch_that_has_no_scatter_says_why_and_keeps_its_rows(run: Any) -> None:
    status, out, err = run("batch", "A1", "A1", "--hierarchical", "--quiet", "--executor", "serial")
    assert status == 1
    assert "2 plates have an answer, a scatter needs 3 or more" in err
    assert "A1" in out
    two = [row(i, likelihood(70.0, 1.0)) for i in range(3)]
    other = PlateRow("q", "q", "done", "", "glass", two[0].constants, two[0].likelihood)
    with pytest.raises(ValueError, match="several materials: carbon, glass"):
        population_of([*two, other], seed=0)
    with pytest.raises(ValueError, match="different unknown constants"):
        population_of([*two, row(4, likelihood([70.0, 0.3], np.eye(2)))], seed=0)
