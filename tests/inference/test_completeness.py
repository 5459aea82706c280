"""Pairings of lists, against enumeration; lists that seem to lack a mode; profile likelihoods."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import pytest

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import Prediction, reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.completeness import (
    DROP_95,
    AlternativePairing,
    Profile,
    TranscriptionError,
    alternative_pairing,
    profile_likelihoods,
    transcription_error,
)
from cpam_bayes.inference.laplace import POLISHED, find_optima
from cpam_bayes.inference.pairing import (
    PairingPrior,
    labelled_log_likelihood,
    most_probable_labelled_pairing,
    pair_probabilities,
)
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement, Specimen, read_specimen
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement
from tests.toy_models import parameters


def every_pairing(
    log_density: np.ndarray, in_range: np.ndarray, span: float, prior: PairingPrior
) -> list[tuple[float, np.ndarray]]:
    """Log likelihood and mode numbers of every pairing that keeps the order, one by one."""
    n, k = log_density.shape
    found = []
    for size in range(min(n, k) + 1):
        for rows in combinations(range(n), size):
            for columns in combinations(range(k), size):
                value = sum(
                    np.log1p(-prior.missed) + log_density[i, j] for i, j in zip(rows, columns, strict=True)
                )
                value += np.log(prior.missed) * sum(in_range[j] and j not in columns for j in range(k))
                value += np.sum(np.delete(prior.log_false(n, span), rows))
                mode = np.full(n, -1)
                mode[list(rows)] = columns
                found.append((value, mode))
    return found


@pytest.mark.parametrize(
    ("seed", "share"), [(seed, share) for share, n in ((0.0, 40), (0.5, 20)) for seed in range(n)]
)
def test_sum_and_maximum_over_pairings_equal_those_of_an_enumeration(seed: int, share: float) -> None:
    """Frequencies with labels, a share of all, keep their modes; the list is the second of a stack."""
    rng = np.random.default_rng(seed)
    n, k = rng.integers(1, 5), rng.integers(4, 7) if share else rng.integers(1, 6)
    labelled = rng.uniform(size=n) < share
    known = np.where(labelled, np.arange(n), -1)
    stack = 4.0 * rng.normal(size=(2, n, k)) - 3.0
    stack_in_range = rng.uniform(size=(2, k)) < 0.7
    log_density, in_range = stack[1], stack_in_range[1]
    false = rng.uniform(0.01, 1.0) if seed % 2 else tuple(rng.uniform(0.01, 30.0, n).tolist())
    prior = PairingPrior(rng.uniform(0.01, 0.5), false)
    own = np.flatnonzero(labelled)
    rows, columns = np.setdiff1d(np.arange(n), own), np.setdiff1d(np.arange(k), own)
    fixed = sum(np.log1p(-prior.missed) + log_density[i, i] for i in own)
    others = every_pairing(log_density[np.ix_(rows, columns)], in_range[columns], 7.0, prior.among(rows))
    values = np.array([value + fixed for value, _ in others])
    total = np.logaddexp.reduce(values)
    modes = np.tile(np.arange(n), (len(others), 1))
    modes[:, rows] = [np.where(mode >= 0, columns[mode], -1) for _, mode in others]
    found = labelled_log_likelihood(stack, stack_in_range, 7.0, known, prior)
    assert found[1] == pytest.approx(total, abs=1e-10)
    best = most_probable_labelled_pairing(log_density, in_range, 7.0, known, prior)
    np.testing.assert_array_equal(best.mode, modes[values.argmax()])
    assert best.log_probability == pytest.approx(values.max() - total, abs=1e-10)
    assert set(best.missed) == set(columns[in_range[columns]]) - set(best.mode)
    if not share:
        of_pair = np.zeros((n, k))
        for mode, probability in zip(modes, np.exp(values - total), strict=True):
            paired = np.flatnonzero(mode >= 0)
            of_pair[paired, mode[paired]] += probability
        each = pair_probabilities(stack, stack_in_range, 7.0, prior)[1]
        np.testing.assert_allclose(each, of_pair, atol=1e-12)


LINEAR = LinearModel().predict(np.array([[0.4, -0.3]])).frequencies[0]


def best(posterior: Posterior) -> np.ndarray:
    """The most probable parameters over their scores."""
    nowhere = np.empty((0, posterior.parameters.size))
    return posterior.scores.to_x(find_optima(posterior, nowhere, settings=POLISHED).z[0])


def doubt_of_linear(listed: np.ndarray, labels: tuple[str, ...] | None = None) -> AlternativePairing | None:
    data = Measurement(listed, 0.0, 0.005, None, labels or ("",) * len(listed), complete=True)
    posterior = plate_posterior(LinearModel(), replace(data, labels=("",) * len(listed)), np.zeros(4))
    marked = np.array([bool(label) for label in data.labels])
    return alternative_pairing(replace(posterior, labelled=marked), best(posterior), np.zeros((1, 2)))


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_mode_that_is_not_in_the_list_is_named(missing: int) -> None:
    found = doubt_of_linear(np.delete(LINEAR, missing))
    assert (found.missed, found.spurious) == (missing, None)
    assert found.log_odds > 100.0
    # three exact frequencies and two constants: the slip's optimum is the truth, but for the even priors,
    # which over scores draw it to their middle by a hundredth of its standard deviation of 0.1
    np.testing.assert_allclose(found.x, [0.4, -0.3], atol=2e-3)


def test_a_frequency_that_is_no_mode_is_named_and_no_other_nor_labelled_ones_are_in_question() -> None:
    for extra in (150.0, 250.0):
        listed = np.sort(np.append(LINEAR[:3], extra))
        found = doubt_of_linear(listed)
        assert found.missed is None
        assert listed[found.spurious] == extra
    assert doubt_of_linear(LINEAR[:3]) is None
    assert doubt_of_linear(LINEAR) is None
    assert doubt_of_linear(np.delete(LINEAR, 1), ("(1,1)", "(2,0)", "(0,2)")) is None


@dataclass(frozen=True)
class Case:
    """A plate, a model of one mode more than its list has, and frequencies of its reference constants."""

    specimen: Specimen
    model: ReducedModel
    frequencies: np.ndarray


def case(name: str) -> Case:
    specimen = read_specimen(name)
    model = reduced_model(specimen, specimen.unknowns, specimen.measurement.size + 1)
    return Case(specimen, model, model.predict(reference_vector(specimen, model.parameters)).frequencies[0])


@pytest.fixture(scope="module")
def aluminium() -> Case:
    return case("A1")


def examined(own: Case, frequencies: np.ndarray, relative_std: float | None) -> TranscriptionError | None:
    data = Measurement(
        np.sort(np.round(frequencies)), 1.0, relative_std, None, ("",) * len(frequencies), True
    )
    posterior = plate_posterior(own.model, data, np.full(own.model.n_modes, 1e-4))
    return transcription_error(own.specimen, posterior, own.model, best(posterior))


def noisy(own: Case, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(own.frequencies * (1.0 + 0.005 * rng.standard_normal(own.model.n_modes)))


@pytest.mark.parametrize("relative_std", [0.005, None])
@pytest.mark.parametrize("missing", [0, 2, 4])
def test_the_mode_that_a_plate_list_lacks_is_named_by_its_label_and_a_false_peak_too(
    aluminium: Case, missing: int, relative_std: float | None
) -> None:
    f = noisy(aluminium, np.random.default_rng(missing))
    found = examined(aluminium, np.delete(f, missing), relative_std)
    modes = aluminium.model.full.modes(np.array([69e9, 0.33]))
    assert found.missed.label == modes[missing].label
    # noise of 0.5 % in six frequencies leaves the missed one to about that
    assert found.missed.frequency == pytest.approx(modes[missing].frequency, rel=0.03)
    if not missing:
        assert examined(aluminium, np.append(f[:6], 400.0), relative_std).spurious == 400.0


def false_warnings(own: Case, n: int) -> int:
    rng = np.random.default_rng(1)
    n_listed = own.model.n_modes - 1
    lists = [noisy(own, rng)[:n_listed] for _ in range(n)]
    return sum(examined(own, f, (0.005, None)[i % 2]) is not None for i, f in enumerate(lists))


@pytest.mark.slow
@pytest.mark.weekly
def test_of_fifty_noisy_complete_lists_at_most_one_is_put_in_doubt(aluminium: Case) -> None:
    assert false_warnings(aluminium, 50) <= 1


@pytest.mark.slow
def test_four_constants_and_six_frequencies_are_enough_to_miss_a_mode() -> None:
    own = case("C1")
    assert false_warnings(own, 6) == 0
    f = noisy(own, np.random.default_rng(0))
    found = examined(own, np.delete(f, 1), 0.005)
    assert found.missed.label == "(0,2)"


def profiles(posterior: Posterior, names: tuple[str, ...] = ("a", "b"), n: int = 21) -> tuple[Profile, ...]:
    """Profiles that start from draws spread over the support, as of a poor chain."""
    draws = posterior.parameters.sample(np.random.default_rng(5), 4000)
    height = posterior.log_prob(draws)
    kept = height > height.max() - 8.0
    return profile_likelihoods(posterior, names, draws[kept], height[kept], n)


# The prior of the parameter that is profiled does not enter.
INFORMED = parameters(a=TruncatedNormal(-1.0, 0.02, -2.0, 2.0), b=Uniform(-2.0, 2.0))


@pytest.mark.parametrize(
    ("model", "names"), [(LinearModel(), ("a", "b")), (LinearModel(INFORMED), ("a",))], ids=["even", "prior"]
)
def test_profiles_of_a_linear_model_are_parabolas(model: LinearModel, names: tuple[str, ...]) -> None:
    data = measurement(0.01)
    mean, covariance = exact_gaussian(data)
    for k, found in enumerate(profiles(plate_posterior(model, data, np.zeros(4)), names)):
        expected = 0.5 * (found.values - mean[k]) ** 2 / covariance[k, k]
        # an optimisation ends when steps promise less than 1e-7 nats
        np.testing.assert_allclose(found.drop, expected, rtol=1e-6, atol=2e-6)
        sd = float(np.sqrt(covariance[k, k]))
        if model.parameters is INFORMED:  # its draws lie elsewhere
            continue
        assert found.best == pytest.approx(mean[k], abs=1e-3 * sd)
        # linear in the root of the drop, which a parabola's is
        ends = mean[k] + np.array([-1.0, 1.0]) * np.sqrt(2.0 * DROP_95) * sd
        np.testing.assert_allclose((found.lower, found.upper), ends, atol=2e-3 * sd)
        assert (found.lower_open, found.upper_open) == (False, False)


def test_where_bounds_hold_the_profile_is_that_of_a_search_and_its_interval_open() -> None:
    # at 30 % noise the bounds of b at -2 and 2 are reached from both ends of a
    posterior = plate_posterior(LinearModel(), measurement(0.3), np.zeros(4))
    (found,) = profiles(posterior, ("a",))
    b = np.linspace(-2.0, 2.0, 4001)
    best = [posterior.log_likelihood(np.column_stack((np.full_like(b, a), b))).max() for a in found.values]
    at_best = posterior.log_likelihood(np.column_stack((np.full_like(b, found.best), b))).max()
    # the grids of the search miss a maximum by at most 1e-4 nats
    np.testing.assert_allclose(found.drop, at_best - np.array(best), atol=2e-4)
    assert np.all(found.drop >= 0.0)
    # an interval that reaches a bound is open there
    (found,) = profiles(plate_posterior(LinearModel(), measurement(3.0), np.zeros(4)), ("b",))
    assert found.lower_open
    assert found.upper_open
    assert (found.lower, found.upper) == (-2.0, 2.0)
    assert np.all(found.drop < DROP_95)


def test_inferred_noise_is_maximised_over_with_its_prior() -> None:
    posterior = plate_posterior(LinearModel(), measurement(None), np.zeros(4))
    (found,) = profiles(posterior, ("a",), n=7)
    f = posterior.measurement.frequencies
    height = []
    for a in (*found.values, found.best):
        # relative noise weighs by 1 / f^2 whatever its amplitude, so b is found first
        residual, slope = (f - MEAN_HZ - SLOPE_HZ[:, 0] * a) / f, SLOPE_HZ[:, 1] / f
        b = float(slope @ residual / (slope @ slope))
        s = np.geomspace(1e-4, 0.1, 20_001)
        x = np.column_stack((np.full_like(s, a), np.full_like(s, b), s))
        # with even priors of a and b, and that of the noise over its score
        of_noise = -0.5 * posterior.scores.to_z(x)[:, 2] ** 2
        height.append(float((posterior.log_likelihood(x) + of_noise).max()))
    # an optimisation ends when steps promise less than 1e-7 nats
    np.testing.assert_allclose(found.drop, height[-1] - np.array(height[:-1]), atol=2e-6)


def test_a_region_in_two_parts_is_spanned_and_counted() -> None:
    @dataclass(frozen=True)
    class Even(LinearModel):
        def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
            x = np.atleast_2d(x)
            slope = np.repeat(SLOPE_HZ[None], len(x), axis=0)
            slope[:, :, 0] *= 2.0 * x[:, :1]
            square = np.column_stack((x[:, 0] ** 2, x[:, 1]))
            return Prediction(MEAN_HZ + square @ SLOPE_HZ.T, slope if jacobian else None)

    data = measurement(0.01)
    mean, covariance = exact_gaussian(data)
    (found,) = profiles(plate_posterior(Even(), data, np.zeros(4)), ("a",), n=201)
    np.testing.assert_allclose(
        found.drop, 0.5 * (found.values**2 - mean[0]) ** 2 / covariance[0, 0], atol=2e-6
    )
    assert found.parts == 2
    end = float(np.sqrt(mean[0] + np.sqrt(2.0 * DROP_95 * covariance[0, 0])))
    # the root of the drop is bent by a^2 between grid points 0.01 apart
    assert (-found.lower, found.upper) == pytest.approx((end, end), abs=1e-3)
