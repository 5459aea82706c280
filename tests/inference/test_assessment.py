"""Assessment of a posterior: what determines it, what shifts it, and whether it fits its data."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from cpam_bayes.inference import assessment
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import Material, Measurement
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement
from tests.toy_models import parameters

X = np.array([0.4, -0.3])
PRIOR_SD = 4.0 / np.sqrt(12.0)
ONE_TO_ONE = Pairing(np.arange(4), np.empty(0, dtype=int), 0.0)


def test_combinations_have_prior_over_noise_along_the_axes_of_the_covariance_and_its_spreads() -> None:
    data = measurement(0.01)
    found = assessment.combinations(plate_posterior(LinearModel(), data, np.zeros(4)), X, ONE_TO_ONE)
    _, covariance = exact_gaussian(data)
    expected = PRIOR_SD / np.sqrt(np.linalg.eigvalsh(covariance))
    spurious = Measurement(np.insert(data.frequencies, 2, 250.0), 0.0, 0.01, None, ("",) * 5, complete=False)
    pairing = Pairing(np.array([0, 1, -1, 2, 3]), np.empty(0, dtype=int), 0.0)
    also = assessment.combinations(plate_posterior(LinearModel(), spurious, np.zeros(4)), X, pairing)
    for each in (found, also):
        np.testing.assert_allclose([c.singular_value for c in each], np.sort(expected)[::-1], rtol=1e-10)
    for c in found:
        slope = c.exponents / X  # d ln(product) / dx
        assert c.noise_sd == pytest.approx(float(np.sqrt(slope @ covariance @ slope)), rel=1e-10)
        assert c.prior_sd == pytest.approx(float(PRIOR_SD * np.linalg.norm(slope)), rel=1e-10)
        assert c.exponents[np.abs(c.exponents).argmax()] == 1.0
    # fewer frequencies than unknowns leave one to the prior: frequency 3 of the model depends on 15 a + 15 b
    data = replace(data, frequencies=data.frequencies[2:3], labels=("",))
    pairing = Pairing(np.array([2]), np.empty(0, dtype=int), 0.0)
    found = assessment.combinations(plate_posterior(LinearModel(), data, np.zeros(4)), X, pairing)
    assert len(found) == 2
    assert found[1].singular_value < 1e-10
    assert found[1].noise_sd == np.inf
    assert found[1].contraction < 1e-15
    np.testing.assert_allclose(found[0].exponents * PRIOR_SD / X, found[0].exponents[0] / X[0] * PRIOR_SD)


N = 20_000
NOTHING = np.zeros(N)


def cumulative_js_distance(p: np.ndarray, q: np.ndarray, x: np.ndarray) -> float:
    """Square root of the cumulative Jensen-Shannon divergence of two distribution functions on a grid."""

    def half(p: np.ndarray, q: np.ndarray) -> float:
        integrand = p * np.log2(p / (0.5 * (p + q))) + 0.5 / np.log(2.0) * (q - p)
        return float(np.trapezoid(integrand, x))

    return np.sqrt((half(p, q) + half(q, p)) / float(np.trapezoid(p + q, x)))


def test_sensitivity_to_the_likelihood_is_the_derivative_of_the_distance_of_each_parameter() -> None:
    draws = np.random.default_rng(1).standard_normal((N, 2))  # N(0, 1) to the power a is N(0, 1 / a)
    found, unseen = assessment.power_scaling(("a", "b"), draws, NOTHING, NOTHING, -0.5 * draws[:, 0] ** 2)
    x = np.linspace(draws[:, 0].min(), draws[:, 0].max(), 20_001)
    distances = [cumulative_js_distance(norm.cdf(x), norm.cdf(x * np.sqrt(a)), x) for a in (1 / 1.01, 1.01)]
    expected = sum(distances) / (2.0 * np.log2(1.01))
    assert found.likelihood == pytest.approx(expected, rel=0.1)  # the relevant tails are those of 20000 draws
    assert (found.prior, found.noise_prior, found.diagnosis) == (0.0, 0.0, "likelihood has a say")
    assert unseen.diagnosis == "likelihood is weak"
    x = np.random.default_rng(1).normal(4.0, np.sqrt(0.5), size=N)  # N(0, 1) times N(8, 1)
    (far,) = assessment.power_scaling(("a",), x[:, None], -0.5 * x**2, NOTHING, -0.5 * (x - 8.0) ** 2)
    assert far.diagnosis == "prior and data disagree"
    assert far.prior == pytest.approx(far.likelihood, rel=0.1)  # by symmetry


def test_diagnoses_follow_the_published_threshold() -> None:
    for prior, noise, likelihood, expected in (
        (0.0, 0.0, 0.2, "likelihood has a say"),
        (0.0, 0.06, 0.2, "likelihood and noise prior have a say"),
        (0.06, 0.06, 0.2, "prior and data disagree"),
        (0.06, 0.06, 0.01, "prior is strong, likelihood weak"),
        (0.0, 0.06, 0.01, "likelihood is weak"),
    ):
        assert assessment.PowerScaling("a", prior, noise, likelihood).diagnosis == expected


def test_moving_a_bound_of_an_even_posterior_moves_its_mean_by_half_as_much() -> None:
    own, rng = parameters(a=Uniform(0.0, 1.0), b=TruncatedNormal(0, 1, -5, 5)), np.random.default_rng(3)
    draws = np.column_stack((rng.uniform(0.0, 1.0, N), rng.standard_normal(N)))
    lower, upper = assessment.moved_bounds(own, draws)  # b's prior is no interval
    for moved, sign in ((lower, 1.0), (upper, -1.0)):  # the mean shifts by 0.05, with sd 12^-1/2
        assert moved.name == "a"
        assert moved.cut == pytest.approx(0.1, abs=0.01)
        assert moved.shift[0] == pytest.approx(sign * 0.05 * np.sqrt(12.0), abs=0.03)
        assert moved.shift[1] == pytest.approx(0.0, abs=0.03)
    lower, upper = assessment.moved_bounds(own, draws * [0.05, 1.0])  # beyond all draws it says nothing
    np.testing.assert_array_equal([lower.cut, lower.shift[0], upper.shift[0]], [1.0, np.nan, 0.0])


CARBON = {"E1": 121e9, "E2": 9.3e9, "nu12": 0.3, "G12": 6e9}
N_DRAWS, NU = 4000, "nu12 < 0.5"


def cut_normal(beyond: float) -> np.ndarray:
    """Draws of a normal density truncated at 0, below which a fraction ``beyond`` of it would lie."""
    mean = -norm.ppf(beyond)
    return truncnorm.rvs(-mean, np.inf, loc=mean, size=N_DRAWS, random_state=np.random.default_rng(0))


WIDE_RATIO = np.random.default_rng(1).lognormal(2.5, 0.7, size=N_DRAWS) + 2.0  # sd as large as the mean


@pytest.mark.parametrize(
    ("symmetry", "draws", "said"),
    [
        *(
            ("transversely_isotropic", {"nu12": 0.5 - 0.02 * cut_normal(beyond)}, said)
            for beyond, said in ((0.9, NU), (0.5, NU), (0.3, NU), (0.1, NU), (0.01, None), (1e-3, None))
        ),
        ("transversely_isotropic", {"E1": 9.3e9 + 1e9 * cut_normal(0.3)}, "E1 > E2, fourth of eq. (9)"),
        ("orthotropic", {"nu12": 0.5 - 0.02 * cut_normal(0.3)}, None),
        ("orthotropic", {"E1": 9.3e9 + 1e9 * cut_normal(0.3)}, None),
        ("orthotropic", {"nu12": (121 / 9.3) ** 0.5 - 0.1 * cut_normal(0.3)}, "|nu12| < sqrt(E1/E2)"),
        ("isotropic", {"nu12": 0.5 - 0.02 * cut_normal(0.3)}, "-1 < nu12 < 0.5"),
        ("transversely_isotropic", {"E1": 9.3e9 * WIDE_RATIO}, None),
        ("transversely_isotropic", {"G12": 6e9 + 1e8 * cut_normal(0.5)}, None),
        ("orthotropic", {"G12": 6e9 + 1e8 * cut_normal(0.5)}, None),
    ],
)
def test_the_constraint_is_named_beyond_which_a_part_of_the_density_would_lie(symmetry, draws, said) -> None:
    constants = {k: CARBON[k] for k in ("E1", "nu12")} if symmetry == "isotropic" else CARBON
    notices = assessment.cut_notices(Material(symmetry, constants, {}, None), draws)
    found = [notice.facts["constraint"] for notice in notices]
    assert [said in constraint.text for constraint in found] == [True] * (said is not None)
    assert all(constraint.symmetry == symmetry for constraint in found)


@pytest.mark.parametrize(
    ("symmetry", "optimum", "limits"),
    [
        ("transversely_isotropic", {"E1": 121e9, "nu12": 0.4999}, True),
        *(
            ("transversely_isotropic", {"E1": 121e9, "nu12": nu}, False) for nu in (0.4, 0.2)
        ),  # one on a bound
        *((symmetry, {"G12": 6e9}, False) for symmetry in ("transversely_isotropic", "orthotropic")),
    ],
)
def test_an_optimum_on_a_constraint_is_found(symmetry, optimum, limits) -> None:
    bounds = {"E1": Uniform(50e9, 200e9), "nu12": Uniform(0.2, 0.6), "G12": Uniform(1e9, 9e9)}
    unknowns, x = parameters(**{name: bounds[name] for name in optimum}), np.array(list(optimum.values()))
    found = assessment.limiting_constraints(Material(symmetry, CARBON, {}, None), unknowns, x)
    assert bool(found) == limits


def refitted() -> tuple[np.ndarray, np.ndarray]:
    """Residual and predictive sd of each frequency from a least-squares fit to the other three."""
    f, residual, sd = measurement(0.01).frequencies, np.empty(4), np.empty(4)
    for i in range(4):
        kept = np.delete(np.arange(4), i)
        slope, own = SLOPE_HZ[kept], 0.01 * f[kept]
        covariance = np.linalg.inv(slope.T @ (slope / own[:, None] ** 2))
        x = covariance @ slope.T @ ((f - MEAN_HZ)[kept] / own**2)
        residual[i] = f[i] - MEAN_HZ[i] - SLOPE_HZ[i] @ x
        sd[i] = np.sqrt(SLOPE_HZ[i] @ covariance @ SLOPE_HZ[i] + (0.01 * f[i]) ** 2)
    return residual, sd


def exact_draws(n: int) -> tuple[Posterior, np.ndarray, np.ndarray]:
    data = measurement(0.01)
    draws = np.random.default_rng(2).multivariate_normal(*exact_gaussian(data), size=n)
    posterior = plate_posterior(LinearModel(), data, np.zeros(4))
    return posterior, draws, posterior.predict(draws)


def test_closed_form_is_the_refit_of_a_linear_model_from_draws_within_sampling_error() -> None:
    posterior, draws, predicted = exact_draws(40_000)
    data, (mean, covariance) = posterior.measurement, exact_gaussian(posterior.measurement)
    expected, sd = refitted()
    variance, sigma = np.einsum("ij,jk,ik->i", SLOPE_HZ, covariance, SLOPE_HZ), 0.01 * data.frequencies
    residual = data.frequencies - MEAN_HZ - SLOPE_HZ @ mean
    exact = assessment.cavity(residual, variance / sigma**2, sigma**2, "optimum")
    np.testing.assert_allclose(exact.residual, expected, rtol=1e-10)
    np.testing.assert_allclose(exact.sd, sd, rtol=1e-10)
    assert exact.leverage.sum() == pytest.approx(2.0, rel=1e-12)  # trace: the number of parameters
    found = assessment.leave_one_out(posterior, draws, predicted, ONE_TO_ONE, draws[0])
    # leverages, at most 0.7 here, are accurate to sqrt(2 / 40000) = 0.7 %: 1 - h to 1.6 %, times three
    np.testing.assert_allclose(found.residual, expected, rtol=0.05, atol=0.02 * sd.min())
    np.testing.assert_allclose(found.sd, sd, rtol=0.025)
    pairing = Pairing(np.array([0, -1, 2, 3]), np.array([1]), 0.0)  # frequencies without modes are kept
    three = assessment.leave_one_out(posterior, draws, predicted, pairing, draws[0])
    np.testing.assert_array_equal(three.residual, found.residual[[0, 2, 3]])


def test_heavy_tails_count_less_and_predict_wider() -> None:
    posterior, draws, predicted = exact_draws(2000)
    data, error = posterior.measurement, np.zeros(4)
    of = [plate_posterior(LinearModel(), data, error, degrees_of_freedom=nu) for nu in (np.inf, 1e7, 4.0)]
    from_draws = draws, predicted, ONE_TO_ONE, draws[0]
    gaussian, nearly, student = (assessment.leave_one_out(own, *from_draws) for own in of)
    np.testing.assert_allclose(nearly.sd, gaussian.sd, rtol=1e-5)
    np.testing.assert_allclose(student.leverage, 5 / 7 * gaussian.leverage, rtol=1e-12)  # (nu + 1) / (nu + 3)
    own = (0.01 * data.frequencies) ** 2  # variance without the datum, plus nu / (nu - 2) = 2 scale^2
    without = 7 / 5 * own * student.leverage / (1 - student.leverage)
    np.testing.assert_allclose(student.sd**2, without + 2.0 * own, rtol=1e-12)


def test_of_two_optima_the_best_one_is_linearised() -> None:
    posterior, draws, _ = exact_draws(2000)
    mean, covariance = exact_gaussian(posterior.measurement)
    twice = np.concatenate((draws, draws + 1.0))
    found = assessment.leave_one_out(posterior, twice, posterior.predict(twice), ONE_TO_ONE, mean)
    assert found.basis == "optimum"
    f = posterior.measurement.frequencies  # prior: a Gaussian of variance 4^2 / 12 about the optimum
    sigma, residual = 0.01 * f, f - MEAN_HZ - SLOPE_HZ @ mean
    with_prior = np.linalg.inv(np.linalg.inv(covariance) + 12 / 16 * np.eye(2))
    leverage = np.einsum("ij,jk,ik->i", SLOPE_HZ, with_prior, SLOPE_HZ) / sigma**2
    np.testing.assert_allclose(found.leverage, leverage, rtol=1e-10)
    np.testing.assert_allclose(found.residual, residual / (1 - leverage), rtol=1e-10)
    np.testing.assert_allclose(found.sd, sigma / np.sqrt(1 - leverage), rtol=1e-10)


def test_importance_sampling_has_the_closed_form_or_says_that_one_frequency_holds_everything() -> None:
    rng = np.random.default_rng(4)  # eight data of sd 1 about one mean: every leverage is 1 / 8
    y, theta = rng.standard_normal(8), rng.normal(0.0, np.sqrt(1 / 8), size=(4000, 1))
    theta += y.mean()
    found = assessment.importance_leave_one_out(-0.5 * (y - theta) ** 2 - 0.5 * np.log(2.0 * np.pi))
    assert found.reliable
    assert found.k_hat.shape == (8,)
    exact = assessment.cavity(y - y.mean(), np.full(8, 1 / 8), np.ones(8), "optimum")
    assert found.log_score == pytest.approx(exact.log_score, abs=0.03)  # 4000 draws, 0.4 % of each density
    a = np.random.default_rng(0).normal(0.0, 1.0, size=4000)  # only frequency 1 depends on a
    log_density = np.column_stack((-0.5 * a**2 * 0.995, -0.5 * (0.05 * a) ** 2))
    found = assessment.importance_leave_one_out(log_density)
    assert not found.reliable
    assert found.k_hat[0] > 0.7 > found.k_hat[1]
