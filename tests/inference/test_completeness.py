"""Pairings of lists against enumeration; lists that seem to lack a mode; profile likelihoods."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import Prediction, reference_vector
from cpam_bayes.inference import completeness, pairing
from cpam_bayes.inference.completeness import DROP_95, AlternativePairing, Profile, TranscriptionError
from cpam_bayes.inference.laplace import POLISHED, find_optima
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement, read_specimen
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement
from tests.toy_models import parameters


def every_pairing(log_density, in_range, span: float, prior) -> list[tuple[float, np.ndarray]]:
    """Log likelihood and mode numbers of every order-preserving pairing, one by one."""
    n, k = log_density.shape
    found = []
    for size in range(min(n, k) + 1):
        for rows in combinations(range(n), size):
            for columns in combinations(range(k), size):
                value = size * np.log1p(-prior.missed) + log_density[list(rows), list(columns)].sum()
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
    """Labelled frequencies, a share of all, keep their modes; the list is the second of a stack."""
    rng = np.random.default_rng(seed)
    n, k = rng.integers(1, 5), rng.integers(4, 7) if share else rng.integers(1, 6)
    labelled = rng.uniform(size=n) < share
    known = np.where(labelled, np.arange(n), -1)
    stack = 4.0 * rng.normal(size=(2, n, k)) - 3.0
    stack_in_range = rng.uniform(size=(2, k)) < 0.7
    log_density, in_range = stack[1], stack_in_range[1]
    false = rng.uniform(0.01, 1.0) if seed % 2 else tuple(rng.uniform(0.01, 30.0, n).tolist())
    prior = pairing.PairingPrior(rng.uniform(0.01, 0.5), false)
    own = np.flatnonzero(labelled)
    rows, columns = np.setdiff1d(np.arange(n), own), np.setdiff1d(np.arange(k), own)
    fixed = sum(np.log1p(-prior.missed) + log_density[i, i] for i in own)
    others = every_pairing(log_density[np.ix_(rows, columns)], in_range[columns], 7.0, prior.among(rows))
    values = np.array([value + fixed for value, _ in others])
    total, modes = np.logaddexp.reduce(values), np.tile(np.arange(n), (len(others), 1))
    modes[:, rows] = [np.where(mode >= 0, columns[mode], -1) for _, mode in others]
    found = pairing.labelled_log_likelihood(stack, stack_in_range, 7.0, known, prior)
    assert found[1] == pytest.approx(total, abs=1e-10)
    best = pairing.most_probable_labelled_pairing(log_density, in_range, 7.0, known, prior)
    np.testing.assert_array_equal(best.mode, modes[values.argmax()])
    assert best.log_probability == pytest.approx(values.max() - total, abs=1e-10)
    assert set(best.missed) == set(columns[in_range[columns]]) - set(best.mode)
    if not share:
        of_pair = np.zeros((n, k))
        for mode, probability in zip(modes, np.exp(values - total), strict=True):
            paired = np.flatnonzero(mode >= 0)
            of_pair[paired, mode[paired]] += probability
        each = pairing.pair_probabilities(stack, stack_in_range, 7.0, prior)[1]
        np.testing.assert_allclose(each, of_pair, atol=1e-12)


LINEAR = MEAN_HZ + SLOPE_HZ @ np.array([0.4, -0.3])


def best(posterior: Posterior) -> np.ndarray:
    nowhere = np.empty((0, posterior.parameters.size))
    return posterior.scores.to_x(find_optima(posterior, nowhere, settings=POLISHED).z[0])


def doubt_of_linear(listed: np.ndarray, labelled: bool = False) -> AlternativePairing | None:
    data = Measurement(listed, 0.0, 0.005, None, ("",) * len(listed), complete=True)
    posterior = plate_posterior(LinearModel(), data, np.zeros(4))
    own = replace(posterior, labelled=np.full(len(listed), labelled))
    return completeness.alternative_pairing(own, best(posterior), np.zeros((1, 2)))


def test_a_missing_mode_and_a_frequency_that_is_none_are_named_and_nothing_else_is_in_question() -> None:
    for missing in (0, 1, 2):
        found = doubt_of_linear(np.delete(LINEAR, missing))
        assert (found.missed, found.spurious) == (missing, None)
        assert found.log_odds > 100.0
        # the slip's optimum is the truth; flat priors pull scores by a hundredth of the sd of 0.1
        np.testing.assert_allclose(found.x, [0.4, -0.3], atol=2e-3)
    for extra in (150.0, 250.0):
        listed = np.sort(np.append(LINEAR[:3], extra))
        found = doubt_of_linear(listed)
        assert (found.missed, listed[found.spurious]) == (None, extra)
    assert [doubt_of_linear(listed) for listed in (LINEAR[:3], LINEAR)] == [None, None]
    assert doubt_of_linear(np.delete(LINEAR, 1), labelled=True) is None


@cache
def case(name: str) -> SimpleNamespace:
    """A plate, a model with one mode more than its list, and frequencies of its reference constants."""
    specimen = read_specimen(name)
    model = reduced_model(specimen, specimen.unknowns, specimen.measurement.size + 1)
    f = model.predict(reference_vector(specimen, model.parameters)).frequencies[0]
    return SimpleNamespace(specimen=specimen, model=model, frequencies=f)


def examined(own: SimpleNamespace, f: np.ndarray, relative_std: float | None) -> TranscriptionError | None:
    data = Measurement(np.sort(np.round(f)), 1.0, relative_std, None, ("",) * len(f), complete=True)
    posterior = plate_posterior(own.model, data, np.full(own.model.n_modes, 1e-4))
    return completeness.transcription_error(own.specimen, posterior, own.model, best(posterior))


def noisy(own: SimpleNamespace, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(own.frequencies * (1.0 + 0.005 * rng.standard_normal(own.model.n_modes)))


@pytest.mark.parametrize("relative_std", [0.005, None])
@pytest.mark.parametrize("missing", [0, 2, 4])
def test_the_mode_that_a_plate_list_lacks_is_named_and_a_false_peak_too(missing, relative_std) -> None:
    aluminium = case("A1")
    f = noisy(aluminium, np.random.default_rng(missing))
    found = examined(aluminium, np.delete(f, missing), relative_std)
    modes = aluminium.model.full.modes(np.array([69e9, 0.33]))
    assert found.missed.label == modes[missing].label
    assert found.missed.frequency == pytest.approx(modes[missing].frequency, rel=0.03)  # noise of 0.5 %
    if not missing:
        assert examined(aluminium, np.append(f[:6], 400.0), relative_std).spurious == 400.0


def false_warnings(own: SimpleNamespace, n: int) -> int:
    rng = np.random.default_rng(1)
    lists = [noisy(own, rng)[:-1] for _ in range(n)]
    return sum(examined(own, f, (0.005, None)[i % 2]) is not None for i, f in enumerate(lists))


@pytest.mark.slow
@pytest.mark.weekly
def test_of_fifty_noisy_complete_lists_at_most_one_is_put_in_doubt() -> None:
    assert false_warnings(case("A1"), 50) <= 1


@pytest.mark.slow
def test_four_constants_and_six_frequencies_are_enough_to_miss_a_mode() -> None:
    own = case("C1")
    assert false_warnings(own, 6) == 0
    f = noisy(own, np.random.default_rng(0))
    assert examined(own, np.delete(f, 1), 0.005).missed.label == "(0,2)"


def profiles(posterior: Posterior, names: tuple[str, ...] = ("a", "b"), n: int = 21) -> tuple[Profile, ...]:
    """Profiles started from draws spread over the support, like those of a poor chain."""
    draws = posterior.parameters.sample(np.random.default_rng(5), 4000)
    height = posterior.log_prob(draws)
    kept = height > height.max() - 8.0
    return completeness.profile_likelihoods(posterior, names, draws[kept], height[kept], n)


# The prior of the profiled parameter does not enter.
INFORMED = parameters(a=TruncatedNormal(-1.0, 0.02, -2.0, 2.0), b=Uniform(-2.0, 2.0))


@pytest.mark.parametrize("is_even", [True, False], ids=["even", "prior"])
def test_profiles_of_a_linear_model_are_parabolas(is_even: bool) -> None:
    data = measurement(0.01)
    model, names = (LinearModel(), ("a", "b")) if is_even else (LinearModel(INFORMED), ("a",))
    mean, covariance = exact_gaussian(data)
    for k, found in enumerate(profiles(plate_posterior(model, data, np.zeros(4)), names)):
        sd = float(np.sqrt(covariance[k, k]))
        expected = 0.5 * ((found.values - mean[k]) / sd) ** 2  # optimisations end at a gain of 1e-7 nats
        np.testing.assert_allclose(found.drop, expected, rtol=1e-6, atol=2e-6)
        if not is_even:  # its draws lie elsewhere
            continue
        assert found.best == pytest.approx(mean[k], abs=1e-3 * sd)
        ends = mean[k] + np.array([-1.0, 1.0]) * np.sqrt(2.0 * DROP_95) * sd  # linear in the root of the drop
        np.testing.assert_allclose((found.lower, found.upper), ends, atol=2e-3 * sd)
        assert (found.lower_open, found.upper_open) == (False, False)


def test_where_bounds_hold_the_profile_is_that_of_a_search_and_its_interval_open() -> None:
    posterior = plate_posterior(LinearModel(), measurement(0.3), np.zeros(4))  # limited by the bounds of b
    (found,) = profiles(posterior, ("a",))
    b, asked = np.linspace(-2.0, 2.0, 4001), (*found.values, found.best)
    *best, at_best = (posterior.log_likelihood(np.column_stack((0 * b + a, b))).max() for a in asked)
    np.testing.assert_allclose(found.drop, at_best - np.array(best), atol=2e-4)  # the grids miss 1e-4 nats
    assert np.all(found.drop >= 0.0)
    # an interval that reaches a bound is open there
    (found,) = profiles(plate_posterior(LinearModel(), measurement(3.0), np.zeros(4)), ("b",))
    assert (found.lower_open, found.upper_open, found.lower, found.upper) == (True, True, -2.0, 2.0)
    assert np.all(found.drop < DROP_95)


def test_inferred_noise_is_maximised_over_with_its_prior() -> None:
    posterior = plate_posterior(LinearModel(), measurement(None), np.zeros(4))
    (found,) = profiles(posterior, ("a",), n=7)
    f, s, height = posterior.measurement.frequencies, np.geomspace(1e-4, 0.1, 20_001), []
    for a in (*found.values, found.best):
        residual, slope = (f - MEAN_HZ - SLOPE_HZ[:, 0] * a) / f, SLOPE_HZ[:, 1] / f  # weights are 1 / f^2
        b = float(slope @ residual / (slope @ slope))
        x = np.column_stack((np.full_like(s, a), np.full_like(s, b), s))
        of_noise = -0.5 * posterior.scores.to_z(x)[:, 2] ** 2  # the prior over the noise's score
        height.append(float((posterior.log_likelihood(x) + of_noise).max()))
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
    exact = 0.5 * (found.values**2 - mean[0]) ** 2 / covariance[0, 0]
    np.testing.assert_allclose(found.drop, exact, atol=2e-6)
    assert found.parts == 2
    end = float(np.sqrt(mean[0] + np.sqrt(2.0 * DROP_95 * covariance[0, 0])))
    assert (-found.lower, found.upper) == pytest.approx((end, end), abs=1e-3)  # curved by a^2 on the grid
