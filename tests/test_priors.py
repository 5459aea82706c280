"""One contract of all priors: a normalised density, its moments, scores, figures and text; and their sets."""

import math
import pickle

import numpy as np
import pytest

from cpam_bayes.parameters import Parameter, ParameterSet
from cpam_bayes.priors import (
    LogUniform,
    Mixture,
    ScaledStudentT,
    TruncatedLogNormal,
    TruncatedNormal,
    Uniform,
)

INF = math.inf
PRIORS = [
    Uniform(-1.0, 3.0),
    Uniform(1e10, 2e11),
    TruncatedNormal(0.28, 0.03, 0.15, 0.4),
    TruncatedNormal(0.0, 1.0, -INF, INF),
    TruncatedNormal(1.0, 2.0, 0.0, INF),
    TruncatedNormal(0.0, 1.0, 6.0, 9.0),
    TruncatedNormal(0.0, 1.0, -INF, -5.0),
    TruncatedNormal(0.0, 1e6, 1.0, 2.0),
    TruncatedNormal(1.2, 0.06, 0.0, 1.5),
    ScaledStudentT(2.0, 4.0, -INF, INF),
    ScaledStudentT(0.02, 4.0, 0.0, INF),
    ScaledStudentT(1.0, 4.0, -1.0, 5.0),
    ScaledStudentT(1.0, 3.0, 8.0, 20.0),
    ScaledStudentT(1.0, 4.0, 0.1, 0.2),
    TruncatedLogNormal(0.002, 0.8, 1e-5, 0.02),
    LogUniform(0.03, 0.35),
    Mixture(ScaledStudentT(2.0, 4.0, -90.0, 90.0), Uniform(-90.0, 90.0), 0.1),
    Mixture(ScaledStudentT(0.02, 4.0, 0.0, 2.0), ScaledStudentT(0.2, 4.0, 0.0, 2.0), 0.1),
    Mixture(TruncatedNormal(0.0, 0.1, -0.6, 1.5), ScaledStudentT(0.2, 4.0, -0.6, 1.5), 0.3),
]
every_prior = pytest.mark.parametrize("prior", PRIORS, ids=str)


def _expectation(prior, function):
    """Composite Gauss quadrature over the support, or over 1e7 sd for a heavy tail."""
    wide = 1e7 if prior.kind == "Student-t" else 40.0
    centre, scale = prior.mean, prior.sd
    low, high = max(prior.lower, centre - wide * scale), min(prior.upper, centre + wide * scale)
    # panels in the inverse hyperbolic sine of the distance resolve tails of any length
    edges = np.linspace(*np.arcsinh((np.array([low, high]) - centre) / scale), 2001)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    half = 0.5 * np.diff(edges)[:, None]
    t = 0.5 * (edges[1:] + edges[:-1])[:, None] + half * nodes
    x = np.clip(centre + scale * np.sinh(t), prior.lower, prior.upper)
    density = np.exp(prior.log_density(x)) * scale * np.cosh(t)
    return float(np.sum(half * weights * density * function(x)))


@every_prior
def test_densities_integrate_to_one_with_the_moments_of_the_truncated_distribution(prior):
    # 1e-6: the density of a narrow slice of a wide normal is known to 1e-10 over its width
    assert _expectation(prior, np.ones_like) == pytest.approx(1.0, rel=1e-6)
    mean, sd = prior.mean, prior.sd
    assert _expectation(prior, lambda x: (x - mean) / sd) == pytest.approx(0.0, abs=1e-6)
    # the second moment of a Student-t with 4 degrees of freedom lacks 1e-7 beyond 1e7 scales
    second = _expectation(prior, lambda x: ((x - mean) / sd) ** 2)
    assert second == pytest.approx(1.0, rel=1e-4)


@every_prior
def test_samples_stay_inside_and_have_the_mean_and_median_of_the_density(prior):
    x = np.sort(prior.sample(np.random.default_rng(1), 20_000))
    assert x.shape == (20_000,)
    assert np.all((x >= prior.lower) & (x <= prior.upper))
    # five standard errors of the mean
    assert x.mean() == pytest.approx(prior.mean, abs=5 * prior.sd / math.sqrt(x.size))
    middle = x[x.size // 2]
    below = _expectation(prior, lambda value: value <= middle)
    # five standard errors of a median's probability, and one panel at the step
    assert below == pytest.approx(0.5, abs=5 * 0.5 / math.sqrt(x.size) + 2e-3)


@every_prior
def test_density_is_minus_infinity_outside_and_at_nan(prior):
    outside = [x for x in (prior.lower - 1.0, prior.upper + 1.0) if math.isfinite(x)]
    values = prior.log_density(np.array([*outside, np.nan]))
    assert np.all(values == -INF)
    inside = prior.log_density(np.full((2, 3), prior.mean))
    assert inside.shape == (2, 3)
    assert np.all(np.isfinite(inside))


def test_student_t_and_half_normal_match_their_textbook_forms():
    # t density with 4 degrees of freedom: 3 / (8 (1 + t^2/4)^(5/2))
    prior = ScaledStudentT(1.0, 4.0, -INF, INF)
    t = np.array([-3.0, 0.0, 0.7])
    assert np.exp(prior.log_density(t)) == pytest.approx(3 / 8 * (1 + t**2 / 4) ** -2.5, rel=1e-13)
    assert prior.sd == pytest.approx(math.sqrt(2.0), rel=1e-12)
    half = TruncatedNormal(0.0, 1.0, 0.0, INF)
    assert half.mean == pytest.approx(math.sqrt(2 / math.pi), rel=1e-13)
    assert half.sd == pytest.approx(math.sqrt(1 - 2 / math.pi), rel=1e-13)


# Scores of the other kinds are good to what scipy's distribution functions are: tests of normal scores.
SMOOTH = [p for p in PRIORS if p.kind in ("log-uniform", "mixture", "truncated log-normal")]


@pytest.mark.parametrize("prior", SMOOTH, ids=str)
def test_scores_and_back(prior):
    z = np.linspace(-5.0, 5.0, 4001)
    x = prior.from_normal(z)
    assert np.all(np.diff(x) > 0.0)
    np.testing.assert_allclose(prior.to_normal(x), z, rtol=0, atol=1e-9)
    # the slope is that of the distribution functions, and ends are the bounds
    h = 1e-4
    slope = (prior.from_normal(z + h) - prior.from_normal(z - h)) / (2 * h)
    expected = np.exp(-0.5 * z**2 - prior.log_density(x)) / math.sqrt(2 * math.pi)
    np.testing.assert_allclose(slope, expected, rtol=1e-5)
    assert prior.from_normal([-INF, INF]) == pytest.approx([prior.lower, prior.upper], rel=1e-12, abs=1e-15)
    assert np.isnan(prior.from_normal(np.nan))
    assert prior.from_normal(0.3).shape == ()


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_normal_prior_reaches_to_its_bounds_thirty_standard_deviations_away(mirror):
    """Between bounds that far out the score is the distance from the centre in standard deviations."""
    ends = sorted((mirror * (5.0 - 34.0 * 0.25), mirror * (5.0 + 36.0 * 0.25)))
    prior = TruncatedNormal(mirror * 5.0, 0.25, *ends)
    z = np.linspace(-30.0, 30.0, 61)
    np.testing.assert_allclose(prior.from_normal(z), mirror * 5.0 + 0.25 * z, atol=1e-12)
    np.testing.assert_allclose(prior.to_normal(mirror * 5.0 + 0.25 * z), z, atol=1e-10)
    assert prior.reach > 36.0
    logarithmic = TruncatedLogNormal(1.0, 0.1, np.exp(-3.2), np.exp(3.2))
    np.testing.assert_allclose(logarithmic.to_normal(np.exp(0.1 * z)), z, atol=1e-10)
    assert logarithmic.reach == prior.reach


@every_prior
def test_quantiles_are_inverse_and_parts_make_the_density_whose_fractions_sum_to_one(prior):
    p = np.linspace(0.01, 0.99, 15)
    x = prior.ppf(p)
    # scipy's quantiles of Student's t are good to 3e-8
    np.testing.assert_allclose(prior.cdf(x), p, atol=3e-8)
    assert prior.cdf([prior.lower, prior.upper]).tolist() == [0.0, 1.0]
    together = sum(fraction * np.exp(part.log_density(x)) for fraction, part in prior.parts)
    np.testing.assert_allclose(together, np.exp(prior.log_density(x)), rtol=1e-12)
    assert sum(fraction for fraction, _ in prior.parts) == 1.0
    wider = prior.stretched(2.0)
    assert type(wider) is type(prior)
    assert (wider.lower, wider.upper) == (2.0 * prior.lower, 2.0 * prior.upper)
    np.testing.assert_allclose(wider.log_density(2.0 * x), prior.log_density(x) - math.log(2.0), atol=1e-9)
    assert wider.typical == pytest.approx(2.0 * prior.typical)


@every_prior
def test_a_prior_is_known_by_its_text_and_described_in_the_unit_asked_for(prior):
    # texts of priors are in the keys of stored models
    assert eval(repr(prior), {"inf": INF, **globals()}) == prior
    assert pickle.loads(pickle.dumps(prior)) == prior
    assert hash(pickle.loads(pickle.dumps(prior))) == hash(prior)
    plain, milli = prior.describe(), prior.describe(lambda value: 1e3 * value)
    for name in ("mean", "sd", "lower", "upper", "kind"):
        assert getattr(plain, name) == getattr(prior, name)
    assert milli.kind == prior.kind
    assert (plain.centre is None) == prior.is_range
    assert milli.scale == 1e3 * plain.scale > 0.0
    assert milli.upper == 1e3 * prior.upper


STUDENT = ScaledStudentT(0.5, 4.0, 0.0, 8.0)
FLAT = Uniform(0.0, 8.0)


@pytest.mark.parametrize(
    ("prior", "expected"),
    [
        (STUDENT, ScaledStudentT(1.5, 4.0, 0.0, 8.0)),
        (TruncatedNormal(1.0, 0.5, 0.0, 2.0), TruncatedNormal(1.0, 1.5, 0.0, 2.0)),
        (TruncatedLogNormal(0.002, 0.8, 1e-5, 0.02), TruncatedLogNormal(0.006, 0.8, 1e-5, 0.02)),
        (Mixture(STUDENT, FLAT, 0.1), Mixture(STUDENT.rescaled(3.0), FLAT, 0.1)),
        (FLAT, FLAT),
        (LogUniform(0.1, 1.0), LogUniform(0.1, 1.0)),
    ],
)
def test_a_rescaled_prior_keeps_its_bounds(prior, expected):
    assert prior.rescaled(3.0) == expected


@pytest.mark.parametrize(
    "make",
    [
        lambda: Uniform(1.0, 1.0),
        lambda: Uniform(2.0, 1.0),
        lambda: Uniform(0.0, INF),
        lambda: Uniform(math.nan, 1.0),
        lambda: TruncatedNormal(0.0, 0.0, -1.0, 1.0),
        lambda: TruncatedNormal(0.0, -1.0, -1.0, 1.0),
        lambda: TruncatedNormal(math.nan, 1.0, -1.0, 1.0),
        lambda: TruncatedNormal(0.0, 1.0, 1.0, -1.0),
        lambda: TruncatedNormal(0.0, 1.0, 50.0, 60.0),
        lambda: ScaledStudentT(1.0, 2.0, -1.0, 1.0),
        lambda: ScaledStudentT(0.0, 4.0, -1.0, 1.0),
        lambda: ScaledStudentT(1.0, 4.0, 1.0, 1.0),
        lambda: TruncatedLogNormal(0.002, 0.8, 0.0, 0.02),
        lambda: LogUniform(0.0, 0.35),
        lambda: Mixture(Uniform(0.0, 1.0), Uniform(0.0, 2.0), 0.1),
        lambda: Mixture(ScaledStudentT(1.0, 4.0, 0.0, INF), ScaledStudentT(2.0, 4.0, 0.0, INF), 0.1),
        lambda: Mixture(Uniform(0.0, 1.0), Uniform(0.0, 1.0), 0.0),
    ],
)
def test_impossible_priors_are_refused(make):
    with pytest.raises(ValueError, match="accepted"):
        make()


E1 = Parameter("E1", "Pa", Uniform(1e10, 2e11))
NU12 = Parameter("nu12", "", TruncatedNormal(0.28, 0.03, 0.15, 0.4))
MASS = Parameter("mass", "kg", ScaledStudentT(1e-3, 4.0, 0.0, INF), null=0.0)
SET = ParameterSet((E1, NU12))


def test_names_bounds_and_lookup_follow_the_order_of_the_set():
    assert SET.names == ("E1", "nu12")
    assert SET.size == 2
    assert SET.lower.tolist() == [1e10, 0.15]
    assert SET.upper.tolist() == [2e11, 0.4]
    assert SET["nu12"] is NU12
    assert "E1" in SET
    assert "E2" not in SET
    with pytest.raises(KeyError, match="E2"):
        SET["E2"]
    with pytest.raises(ValueError, match="read-only"):
        SET.lower[0] = 0.0
    both = SET.union(ParameterSet((MASS, NU12)))
    assert both.names == ("E1", "nu12", "mass")
    fixed = both.fix(nu12=0.3)
    assert pickle.loads(pickle.dumps(fixed)) == fixed


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_vectors_and_names_round_trip(shape):
    x = np.random.default_rng(0).normal(size=(*shape, 2)) + 1e-30j
    mapping = SET.mapping(x)
    assert mapping["E1"].shape == shape
    assert np.array_equal(SET.vector(mapping), x)
    broadcast = SET.vector({"nu12": 0.3, "E1": np.array([1.0, 2.0]), "other": 9.0})
    assert broadcast.tolist() == [[1.0, 0.3], [2.0, 0.3]]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: SET.union(ParameterSet((Parameter("nu12", "", Uniform(0.1, 0.4)),))), "defined twice"),
        (lambda: SET.union(ParameterSet((), (("nu12", 0.3),))), "defined twice"),
        (lambda: ParameterSet((E1, E1)), "more than once"),
        (lambda: SET.fix(E2=1.0), "E2"),
        (lambda: SET.fix(E1=math.nan), "E1"),
        (lambda: SET.without("E2"), "E2"),
        (lambda: SET.vector({"E1": 1.0}), "E1"),
        (lambda: SET.mapping(np.zeros(3)), "E1"),
        (lambda: SET.log_prior(1.0), "E1"),
    ],
)
def test_misuse_of_a_set_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_fixed_parameters_leave_the_vector_and_stay_in_the_mapping_and_others_are_dropped():
    fixed = SET.fix(nu12=0.3)
    assert fixed.names == ("E1",)
    mapping = fixed.mapping(np.array([[5.0], [6.0]]))
    assert mapping["nu12"].tolist() == [0.3, 0.3]
    assert mapping["E1"].tolist() == [5.0, 6.0]
    assert SET.without("E1").names == ("nu12",)
    assert "E1" not in SET.without("E1").mapping(np.array([0.3]))


def test_densities_are_summed_and_samples_repeatable_inside_the_bounds():
    x = np.array([[1e11, 0.28], [1e11, 0.5]])
    expected = E1.prior.log_density(1e11) + NU12.prior.log_density(0.28)
    assert SET.log_prior(x).tolist() == [pytest.approx(float(expected)), -INF]
    first = SET.sample(np.random.default_rng(7), 50)
    assert first.shape == (50, 2)
    assert np.array_equal(first, SET.sample(np.random.default_rng(7), 50))
    assert np.all((first >= SET.lower) & (first <= SET.upper))
    empty = ParameterSet(())
    assert empty.size == 0
    assert empty.lower.shape == (0,)
    assert empty.log_prior(np.empty((4, 0))).tolist() == [0.0] * 4
    assert empty.sample(np.random.default_rng(0), 3).shape == (3, 0)
    assert empty.vector({}).shape == (0,)
