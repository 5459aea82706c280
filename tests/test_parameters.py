"""Priors and the one place where names become vectors."""

import math
import pickle

import numpy as np
import pytest

from cpam_bayes.parameters import (
    LogUniform,
    Mixture,
    Parameter,
    ParameterSet,
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


def _expectation(prior, function):
    """Composite Gauss quadrature over the support, or over 1e7 sd for a heavy tail."""
    wide = 1e7 if isinstance(prior, ScaledStudentT) else 40.0
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


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_densities_integrate_to_one(prior):
    # 1e-6: the density of a narrow slice of a wide normal is known to 1e-10 over its width
    assert _expectation(prior, np.ones_like) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_mean_and_sd_are_those_of_the_truncated_distribution(prior):
    mean, sd = prior.mean, prior.sd
    assert _expectation(prior, lambda x: (x - mean) / sd) == pytest.approx(0.0, abs=1e-6)
    # the second moment of a Student-t with 4 degrees of freedom lacks 1e-7 beyond 1e7 scales
    second = _expectation(prior, lambda x: ((x - mean) / sd) ** 2)
    assert second == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_samples_stay_inside_and_average_to_the_mean(prior):
    x = prior.sample(np.random.default_rng(1), 20_000)
    assert x.shape == (20_000,)
    assert np.all((x >= prior.lower) & (x <= prior.upper))
    # five standard errors of the mean
    assert x.mean() == pytest.approx(prior.mean, abs=5 * prior.sd / math.sqrt(x.size))


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_sampled_quantiles_are_those_of_the_density(prior):
    x = np.sort(prior.sample(np.random.default_rng(2), 20_000))
    middle = x[x.size // 2]
    below = _expectation(prior, lambda value: value <= middle)
    # five standard errors of a median's probability, and one panel at the step
    assert below == pytest.approx(0.5, abs=5 * 0.5 / math.sqrt(x.size) + 2e-3)


@pytest.mark.parametrize("prior", PRIORS, ids=str)
def test_density_is_minus_infinity_outside_and_at_nan(prior):
    outside = [x for x in (prior.lower - 1.0, prior.upper + 1.0) if math.isfinite(x)]
    values = prior.log_density(np.array([*outside, np.nan]))
    assert np.all(values == -INF)
    inside = prior.log_density(np.full((2, 3), prior.mean))
    assert inside.shape == (2, 3)
    assert np.all(np.isfinite(inside))


def test_student_t_density_matches_its_textbook_form():
    # t density with 4 degrees of freedom: 3 / (8 (1 + t^2/4)^(5/2))
    prior = ScaledStudentT(1.0, 4.0, -INF, INF)
    t = np.array([-3.0, 0.0, 0.7])
    assert np.exp(prior.log_density(t)) == pytest.approx(3 / 8 * (1 + t**2 / 4) ** -2.5, rel=1e-13)
    assert prior.sd == pytest.approx(math.sqrt(2.0), rel=1e-12)


MIXTURES = [p for p in PRIORS if isinstance(p, LogUniform | Mixture | TruncatedLogNormal)]


@pytest.mark.parametrize("prior", MIXTURES, ids=str)
def test_scores_of_a_mixture_and_back(prior):
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


@pytest.mark.parametrize("prior", MIXTURES, ids=str)
def test_a_mixture_is_known_by_its_text(prior):
    # texts of priors are in the keys of stored models
    assert eval(repr(prior)) == prior
    assert hash(eval(repr(prior))) == hash(prior)
    assert pickle.loads(pickle.dumps(prior)) == prior


def test_half_normal_has_its_textbook_moments():
    prior = TruncatedNormal(0.0, 1.0, 0.0, INF)
    assert prior.mean == pytest.approx(math.sqrt(2 / math.pi), rel=1e-13)
    assert prior.sd == pytest.approx(math.sqrt(1 - 2 / math.pi), rel=1e-13)


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


def test_bounds_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        SET.lower[0] = 0.0


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_vectors_and_names_round_trip(shape):
    x = np.random.default_rng(0).normal(size=(*shape, 2))
    mapping = SET.mapping(x)
    assert mapping["E1"].shape == shape
    assert np.array_equal(SET.vector(mapping), x)


def test_complex_vectors_keep_their_imaginary_part():
    x = np.array([1.0 + 1e-30j, 2.0])
    assert SET.mapping(x)["E1"].imag == 1e-30
    assert SET.vector(SET.mapping(x))[0].imag == 1e-30


def test_vector_broadcasts_and_leaves_other_names_aside():
    x = SET.vector({"nu12": 0.3, "E1": np.array([1.0, 2.0]), "other": 9.0})
    assert x.tolist() == [[1.0, 0.3], [2.0, 0.3]]


def test_union_shares_equal_parameters_and_keeps_order():
    both = SET.union(ParameterSet((MASS, NU12)))
    assert both.names == ("E1", "nu12", "mass")


@pytest.mark.parametrize(
    "other",
    [
        ParameterSet((Parameter("nu12", "", Uniform(0.1, 0.4)),)),
        ParameterSet((), (("nu12", 0.3),)),
    ],
)
def test_union_refuses_a_name_with_two_meanings(other):
    with pytest.raises(ValueError, match="defined twice"):
        SET.union(other)


def test_a_name_twice_in_one_set_is_refused():
    with pytest.raises(ValueError, match="more than once"):
        ParameterSet((E1, E1))


def test_fixed_parameters_leave_the_vector_and_stay_in_the_mapping():
    fixed = SET.fix(nu12=0.3)
    assert fixed.names == ("E1",)
    mapping = fixed.mapping(np.array([[5.0], [6.0]]))
    assert mapping["nu12"].tolist() == [0.3, 0.3]
    assert mapping["E1"].tolist() == [5.0, 6.0]


def test_without_drops_parameters():
    assert SET.without("E1").names == ("nu12",)
    assert "E1" not in SET.without("E1").mapping(np.array([0.3]))


@pytest.mark.parametrize(
    "act",
    [
        lambda: SET.fix(E2=1.0),
        lambda: SET.fix(E1=math.nan),
        lambda: SET.without("E2"),
        lambda: SET.vector({"E1": 1.0}),
        lambda: SET.mapping(np.zeros(3)),
        lambda: SET.log_prior(1.0),
    ],
)
def test_misuse_of_a_set_is_refused(act):
    with pytest.raises(ValueError, match=r"E2|E1"):
        act()


def test_log_prior_is_the_sum_of_the_densities():
    x = np.array([[1e11, 0.28], [1e11, 0.5]])
    expected = E1.prior.log_density(1e11) + NU12.prior.log_density(0.28)
    assert SET.log_prior(x).tolist() == [pytest.approx(float(expected)), -INF]


def test_samples_are_repeatable_and_inside_the_bounds():
    first = SET.sample(np.random.default_rng(7), 50)
    assert first.shape == (50, 2)
    assert np.array_equal(first, SET.sample(np.random.default_rng(7), 50))
    assert np.all((first >= SET.lower) & (first <= SET.upper))


def test_the_empty_set_is_a_set():
    empty = ParameterSet(())
    assert empty.size == 0
    assert empty.lower.shape == (0,)
    assert empty.log_prior(np.empty((4, 0))).tolist() == [0.0] * 4
    assert empty.sample(np.random.default_rng(0), 3).shape == (3, 0)
    assert empty.vector({}).shape == (0,)


def test_sets_travel_between_processes():
    both = SET.union(ParameterSet((MASS,))).fix(nu12=0.3)
    assert pickle.loads(pickle.dumps(both)) == both
