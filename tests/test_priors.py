"""One contract of all priors: a normalised density, its moments, scores, figures and text; and their sets."""

import math
import pickle

import numpy as np
import pytest

from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.priors import LogUniform, Mixture, ScaledStudentT, TruncatedLogNormal, TruncatedNormal

INF = math.inf
PRIORS = [
    *(Uniform(-1.0, 3.0), Uniform(1e10, 2e11)),
    *(TruncatedNormal(0.28, 0.03, 0.15, 0.4), TruncatedNormal(0.0, 1.0, -INF, INF)),
    *(TruncatedNormal(1.0, 2.0, 0.0, INF), TruncatedNormal(0.0, 1.0, 6.0, 9.0)),
    *(TruncatedNormal(0.0, 1.0, -INF, -5.0), TruncatedNormal(0.0, 1e6, 1.0, 2.0)),
    TruncatedNormal(1.2, 0.06, 0.0, 1.5),
    *(ScaledStudentT(2.0, 4.0, -INF, INF), ScaledStudentT(0.02, 4.0, 0.0, INF)),
    *(ScaledStudentT(1.0, 4.0, -1.0, 5.0), ScaledStudentT(1.0, 3.0, 8.0, 20.0)),
    ScaledStudentT(1.0, 4.0, 0.1, 0.2),
    TruncatedLogNormal(0.002, 0.8, 1e-5, 0.02),
    LogUniform(0.03, 0.35),
    Mixture(ScaledStudentT(2.0, 4.0, -90.0, 90.0), Uniform(-90.0, 90.0), 0.1),
    Mixture(ScaledStudentT(0.02, 4.0, 0.0, 2.0), ScaledStudentT(0.2, 4.0, 0.0, 2.0), 0.1),
    Mixture(TruncatedNormal(0.0, 0.1, -0.6, 1.5), ScaledStudentT(0.2, 4.0, -0.6, 1.5), 0.3),
]
every_prior = pytest.mark.parametrize("prior", PRIORS, ids=str)
# Scores of the other kinds are as accurate as scipy's distribution functions: tests of normal scores.
SMOOTH = [p for p in PRIORS if p.kind in ("log-uniform", "mixture", "truncated log-normal")]
IMPOSSIBLE = [
    *((Uniform, bounds) for bounds in ((1.0, 1.0), (2.0, 1.0), (0.0, INF), (math.nan, 1.0))),
    *((TruncatedNormal, (0.0, sd, -1.0, 1.0)) for sd in (0.0, -1.0)),
    *((TruncatedNormal, (math.nan, 1.0, -1.0, 1.0)), (TruncatedNormal, (0.0, 1.0, 1.0, -1.0))),
    (TruncatedNormal, (0.0, 1.0, 50.0, 60.0)),
    *((ScaledStudentT, (1.0, 2.0, -1.0, 1.0)), (ScaledStudentT, (0.0, 4.0, -1.0, 1.0))),
    *((ScaledStudentT, (1.0, 4.0, 1.0, 1.0)), (TruncatedLogNormal, (0.002, 0.8, 0.0, 0.02))),
    *((LogUniform, (0.0, 0.35)), (Mixture, (Uniform(0.0, 1.0), Uniform(0.0, 2.0), 0.1))),
    (Mixture, (ScaledStudentT(1.0, 4.0, 0.0, INF), ScaledStudentT(2.0, 4.0, 0.0, INF), 0.1)),
    (Mixture, (Uniform(0.0, 1.0), Uniform(0.0, 1.0), 0.0)),
]
STUDENT, FLAT = ScaledStudentT(0.5, 4.0, 0.0, 8.0), Uniform(0.0, 8.0)
E1 = Parameter("E1", "Pa", Uniform(1e10, 2e11))
NU12 = Parameter("nu12", "", TruncatedNormal(0.28, 0.03, 0.15, 0.4))
MASS = Parameter("mass", "kg", ScaledStudentT(1e-3, 4.0, 0.0, INF), null=0.0)
SET = ParameterSet((E1, NU12))
MISUSE = [
    (lambda: SET.union(ParameterSet((Parameter("nu12", "", Uniform(0.1, 0.4)),))), "defined twice"),
    (lambda: SET.union(ParameterSet((), (("nu12", 0.3),))), "defined twice"),
    (lambda: ParameterSet((E1, E1)), "more than once"),
    *((lambda: SET.fix(E2=1.0), "E2"), (lambda: SET.fix(E1=math.nan), "E1")),
    *((lambda: SET.without("E2"), "E2"), (lambda: SET.vector({"E1": 1.0}), "E1")),
    *((lambda: SET.mapping(np.zeros(3)), "E1"), (lambda: SET.log_prior(1.0), "E1")),
]


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
def test_densities_integrate_to_one_inside_alone_with_the_moments_of_the_truncated_distribution(prior):
    outside = [x for x in (prior.lower - 1.0, prior.upper + 1.0) if math.isfinite(x)]
    assert np.all(prior.log_density(np.array([*outside, np.nan])) == -INF)
    assert np.isfinite(prior.log_density(np.full((2, 3), prior.mean))).tolist() == [[True] * 3] * 2
    # 1e-6: the density of a narrow slice of a wide normal is accurate to 1e-10 over its width
    assert _expectation(prior, np.ones_like) == pytest.approx(1.0, rel=1e-6)
    mean, sd = prior.mean, prior.sd
    assert _expectation(prior, lambda x: (x - mean) / sd) == pytest.approx(0.0, abs=1e-6)
    # the second moment of a Student-t with 4 degrees of freedom lacks 1e-7 beyond 1e7 scales
    assert _expectation(prior, lambda x: ((x - mean) / sd) ** 2) == pytest.approx(1.0, rel=1e-4)


@every_prior
def test_samples_stay_inside_and_have_the_mean_and_median_of_the_density(prior):
    x = np.sort(prior.sample(np.random.default_rng(1), 20_000))
    assert (x.shape, np.all((x >= prior.lower) & (x <= prior.upper))) == ((20_000,), True)
    # five standard errors of the mean
    assert x.mean() == pytest.approx(prior.mean, abs=5 * prior.sd / math.sqrt(x.size))
    below = _expectation(prior, lambda value: value <= x[x.size // 2])
    assert below == pytest.approx(0.5, abs=5 * 0.5 / math.sqrt(x.size) + 2e-3)  # and one panel at the step


def test_student_t_and_half_normal_match_their_textbook_forms():
    # t density with 4 degrees of freedom: 3 / (8 (1 + t^2/4)^(5/2))
    prior = ScaledStudentT(1.0, 4.0, -INF, INF)
    t = np.array([-3.0, 0.0, 0.7])
    assert np.exp(prior.log_density(t)) == pytest.approx(3 / 8 * (1 + t**2 / 4) ** -2.5, rel=1e-13)
    assert prior.sd == pytest.approx(math.sqrt(2.0), rel=1e-12)
    half = TruncatedNormal(0.0, 1.0, 0.0, INF)
    moments = (math.sqrt(2 / math.pi), math.sqrt(1 - 2 / math.pi))
    assert (half.mean, half.sd) == pytest.approx(moments, rel=1e-13)


@pytest.mark.parametrize("prior", SMOOTH, ids=str)
def test_scores_and_back(prior):
    z = np.linspace(-5.0, 5.0, 4001)
    x = prior.from_normal(z)
    assert np.all(np.diff(x) > 0.0)
    np.testing.assert_allclose(prior.to_normal(x), z, rtol=0, atol=1e-9)
    # the slope agrees with the distribution functions, and the ends are the bounds
    slope = (prior.from_normal(z + 1e-4) - prior.from_normal(z - 1e-4)) / 2e-4
    expected = np.exp(-0.5 * z**2 - prior.log_density(x)) / math.sqrt(2 * math.pi)
    np.testing.assert_allclose(slope, expected, rtol=1e-5)
    assert prior.from_normal([-INF, INF]) == pytest.approx([prior.lower, prior.upper], rel=1e-12, abs=1e-15)
    assert (np.isnan(prior.from_normal(np.nan)), prior.from_normal(0.3).shape) == (True, ())


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_normal_prior_reaches_to_its_bounds_thirty_standard_deviations_away(mirror):
    """With bounds that far out the score is the distance from the centre in standard deviations."""
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
    # scipy's quantiles of Student's t are accurate to 3e-8
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
    # the keys of stored models contain texts of priors
    assert eval(repr(prior), {"inf": INF, **globals()}) == prior
    again = pickle.loads(pickle.dumps(prior))
    assert (again, hash(again)) == (prior, hash(prior))
    plain, milli = prior.describe(), prior.describe(lambda value: 1e3 * value)
    for name in ("mean", "sd", "lower", "upper", "kind"):
        assert getattr(plain, name) == getattr(prior, name)
    assert (plain.centre is None) == prior.is_range
    assert milli.scale == 1e3 * plain.scale > 0.0
    assert (milli.kind, milli.upper) == (prior.kind, 1e3 * prior.upper)


def test_a_rescaled_prior_keeps_its_bounds():
    for prior, expected in (
        (STUDENT, ScaledStudentT(1.5, 4.0, 0.0, 8.0)),
        (TruncatedNormal(1.0, 0.5, 0.0, 2.0), TruncatedNormal(1.0, 1.5, 0.0, 2.0)),
        (TruncatedLogNormal(0.002, 0.8, 1e-5, 0.02), TruncatedLogNormal(0.006, 0.8, 1e-5, 0.02)),
        (Mixture(STUDENT, FLAT, 0.1), Mixture(STUDENT.rescaled(3.0), FLAT, 0.1)),
        *((FLAT, FLAT), (LogUniform(0.1, 1.0), LogUniform(0.1, 1.0))),
    ):
        assert prior.rescaled(3.0) == expected


@pytest.mark.parametrize(("kind", "numbers"), IMPOSSIBLE)
def test_impossible_priors_are_refused(kind, numbers):
    with pytest.raises(ValueError, match="accepted"):
        kind(*numbers)


def test_names_and_bounds_follow_the_order_of_the_set_and_fixed_ones_stay_in_the_mapping_alone():
    assert (SET.names, SET.size) == (("E1", "nu12"), 2)
    assert "E1" in SET
    assert "E2" not in SET
    assert (SET.lower.tolist(), SET.upper.tolist()) == ([1e10, 0.15], [2e11, 0.4])
    assert SET["nu12"] is NU12
    with pytest.raises(KeyError, match="E2"):
        SET["E2"]
    with pytest.raises(ValueError, match="read-only"):
        SET.lower[0] = 0.0
    both = SET.union(ParameterSet((MASS, NU12)))
    assert both.names == ("E1", "nu12", "mass")
    assert pickle.loads(pickle.dumps(both.fix(nu12=0.3))) == both.fix(nu12=0.3)
    fixed = SET.fix(nu12=0.3)
    assert fixed.names == ("E1",)
    mapping = fixed.mapping(np.array([[5.0], [6.0]]))
    assert (mapping["nu12"].tolist(), mapping["E1"].tolist()) == ([0.3, 0.3], [5.0, 6.0])
    assert SET.without("E1").names == tuple(SET.without("E1").mapping(np.array([0.3]))) == ("nu12",)


def test_vectors_and_names_round_trip():
    for shape in ((), (5,), (2, 3)):
        x = np.random.default_rng(0).normal(size=(*shape, 2)) + 1e-30j
        assert SET.mapping(x)["E1"].shape == shape
        assert np.array_equal(SET.vector(SET.mapping(x)), x)
    broadcast = SET.vector({"nu12": 0.3, "E1": np.array([1.0, 2.0]), "other": 9.0})
    assert broadcast.tolist() == [[1.0, 0.3], [2.0, 0.3]]


@pytest.mark.parametrize(("make", "said"), MISUSE)
def test_misuse_of_a_set_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def test_densities_are_summed_and_samples_repeatable_inside_the_bounds():
    x = np.array([[1e11, 0.28], [1e11, 0.5]])
    expected = E1.prior.log_density(1e11) + NU12.prior.log_density(0.28)
    assert SET.log_prior(x).tolist() == [pytest.approx(float(expected)), -INF]
    first, again = (SET.sample(np.random.default_rng(7), 50) for _ in range(2))
    assert (first.shape, np.array_equal(first, again)) == ((50, 2), True)
    assert np.all((first >= SET.lower) & (first <= SET.upper))
    empty = ParameterSet(())
    assert (empty.size, empty.lower.shape, empty.vector({}).shape) == (0, (0,), (0,))
    assert empty.log_prior(np.empty((4, 0))).tolist() == [0.0] * 4
    assert empty.sample(np.random.default_rng(0), 3).shape == (3, 0)
