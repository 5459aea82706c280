"""The one place where names become vectors."""

import math
import pickle

import numpy as np
import pytest

from cpam_bayes.parameters import (
    Parameter,
    ParameterSet,
    ScaledStudentT,
    TruncatedNormal,
    Uniform,
)

INF = math.inf
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


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_vectors_and_names_round_trip(shape):
    x = np.random.default_rng(0).normal(size=(*shape, 2)) + 1e-30j
    mapping = SET.mapping(x)
    assert mapping["E1"].shape == shape
    assert np.array_equal(SET.vector(mapping), x)
    broadcast = SET.vector({"nu12": 0.3, "E1": np.array([1.0, 2.0]), "other": 9.0})
    assert broadcast.tolist() == [[1.0, 0.3], [2.0, 0.3]]


def test_union_shares_equal_parameters_and_keeps_order():
    both = SET.union(ParameterSet((MASS, NU12)))
    assert both.names == ("E1", "nu12", "mass")


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
