"""Posteriors of plates: noise, priors, pairing, on full and reduced models."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import norm, t

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import (
    Prediction,
    plate_problem,
    reference_constants,
    reference_vector,
)
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.posterior import (
    NOISE,
    NOISE_PRIOR,
    Likelihood,
    SolverError,
    noise_model,
    plate_posterior,
)
from cpam_bayes.inference.sampling import sample_posterior
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Measurement, Specimen, read_specimen
from cpam_bayes.plate.laminate import CONSTANTS, through_thickness_poisson
from tests.linear_model import LinearModel, measurement


def test_gaussian_log_probability_is_the_sum_of_its_parts() -> None:
    model = LinearModel()
    data = measurement(relative_std=0.01, resolution=1.0)
    error = np.array([1e-3, 2e-3, 1e-3, 3e-3])
    posterior = plate_posterior(model, data, error)
    x = np.array([0.3, -0.2])
    f = model.predict(x[None]).frequencies[0]
    sigma = np.sqrt((0.01 * data.frequencies) ** 2 + 1 / 12 + (error * f) ** 2)
    expected = norm.logpdf(data.frequencies, f, sigma).sum() - 2 * np.log(4.0)
    assert posterior.log_prob(x)[0] == pytest.approx(expected, abs=1e-12)


def test_noise_that_the_file_leaves_out_is_a_parameter_with_a_prior() -> None:
    posterior = plate_posterior(LinearModel(), measurement(relative_std=None), np.zeros(4))
    assert posterior.parameters.names == ("a", "b", NOISE)
    x = np.array([[0.1, 0.2, 0.02]])
    f = LinearModel().predict(x[:, :2]).frequencies[0]
    listed = posterior.measurement.frequencies
    expected = norm.logpdf(listed, f, 0.02 * listed).sum()
    expected += NOISE_PRIOR.log_density(0.02) - 2 * np.log(4.0)
    assert posterior.log_prob(x)[0] == pytest.approx(float(expected), abs=1e-12)


def test_outside_the_support_the_model_is_not_asked_and_the_density_is_zero() -> None:
    @dataclass(frozen=True)
    class Watched(LinearModel):
        def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
            assert np.all(np.abs(x) <= 2.0)
            assert np.all(self.admissible(x))
            return super().predict(x, jacobian=jacobian)

        def admissible(self, x: np.ndarray) -> np.ndarray:
            return np.asarray(x.sum(axis=-1) < 2.5)

    posterior = plate_posterior(Watched(), measurement(relative_std=0.01), np.zeros(4))
    found = posterior.log_prob(np.array([[0.0, 0.0], [9.0, 0.0], [1.9, 1.9], [np.nan, 0.0]]))
    assert np.isfinite(found[0])
    np.testing.assert_array_equal(found[1:], -np.inf)


def test_probabilities_of_missed_modes_and_false_peaks_are_the_files() -> None:
    data = measurement(relative_std=0.01)
    gaps = replace(data, complete=False, missed_probability=0.3, false_peaks=0.0)
    posterior = plate_posterior(LinearModel(), gaps, np.zeros(4))
    assert (posterior.pairing.missed, posterior.pairing.spurious) == (0.3, 0.0)
    # no false peaks, every mode in its place: each is there with the probability 0.7
    x = np.array([[0.3, -0.2]])
    full = plate_posterior(LinearModel(), data, np.zeros(4)).log_likelihood(x)[0]
    assert posterior.log_likelihood(x)[0] == pytest.approx(full + 4 * np.log(0.7), abs=1e-6)


def test_a_complete_list_without_its_third_mode_is_far_less_probable_than_an_incomplete_one() -> None:
    model = LinearModel()
    truth = model.predict(np.zeros((1, 2))).frequencies[0]
    kept = np.delete(truth, 2)
    gaps = Measurement(kept, 0.0, 0.005, None, ("",) * 3, complete=False)
    full = Measurement(kept, 0.0, 0.005, None, ("",) * 3, complete=True)
    error = np.zeros(4)
    x = np.zeros((1, 2))
    assert plate_posterior(model, gaps, error).log_likelihood(x) > -20.0
    assert plate_posterior(model, full, error).log_likelihood(x) < -1000.0


@dataclass(frozen=True)
class Broken(LinearModel):
    """A model that gives no number for its second mode where b is above 1."""

    value: float = np.nan

    def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
        f = super().predict(x).frequencies.copy()
        f[x[:, 1] > 1.0, 1] = self.value
        return Prediction(f, None)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("complete", [True, False])
def test_a_frequency_that_is_no_number_is_an_error_with_its_parameters(value: float, complete: bool) -> None:
    data = measurement(relative_std=None)
    data = Measurement(data.frequencies, 0.0, None, None, data.labels, complete)
    posterior = plate_posterior(Broken(value=value), data, np.zeros(4))
    assert np.isfinite(posterior.log_prob(np.array([0.5, 0.5, 0.01]))[0])
    with pytest.raises(
        SolverError, match=rf"returned {value} Hz for mode 2 at a = 0.5, b = 1.5; check"
    ) as caught:
        posterior.log_prob(np.array([[0.5, 0.5, 0.01], [0.5, 1.5, 0.01]]))
    assert isinstance(caught.value, ValueError)


def test_a_log_probability_that_is_no_number_is_an_error_with_its_parameters() -> None:
    posterior = plate_posterior(LinearModel(), measurement(relative_std=0.01), np.full(4, np.nan))
    with pytest.raises(SolverError, match=r"log probability is not a number at a = 0\.5, b = 0\.25"):
        posterior.log_prob(np.array([0.5, 0.25]))


@dataclass(frozen=True)
class Unasked:
    """A plate whose priors and constraints are looked at and whose frequencies are not."""

    problem: Problem

    @property
    def parameters(self) -> ParameterSet:
        return self.problem.parameters

    def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
        raise AssertionError("its frequencies are not to be looked at")

    def admissible(self, x: np.ndarray) -> np.ndarray:
        return self.problem.admissible(self.parameters.mapping(x))


def wide(name: str) -> Unasked:
    """The plate of a built-in specimen with unknowns between bounds that are far too wide."""
    specimen = read_specimen(name)
    bounds = {"nu12": Uniform(-1.5, 1.5)}
    unknowns = specimen.unknowns.parameters
    parameters = tuple(replace(p, prior=bounds.get(p.name, Uniform(1e8, 2e11))) for p in unknowns)
    return Unasked(plate_problem(specimen, ParameterSet(parameters)))


@pytest.mark.parametrize("name", ["A1", "D1"])
def test_every_set_in_the_support_has_a_positive_definite_stiffness_and_the_others_no_probability(
    name: str,
) -> None:
    specimen, plate = read_specimen(name), wide(name)
    data = measurement(relative_std=0.01)
    posterior = plate_posterior(plate, data, np.zeros(4))
    x = plate.parameters.sample(np.random.default_rng(0), 4000)
    inside = np.isfinite(posterior.log_prior(x))
    assert 0.02 < inside.mean() < 0.98
    stiffness = plate.problem.state(plate.parameters.mapping(x[inside])).stiffness()
    # to a diagonal of ones: the entries in SI differ by 1e9
    scale = np.sqrt(np.einsum("...ii->...i", stiffness))
    scaled = stiffness / scale[..., :, None] / scale[..., None, :]
    assert np.linalg.eigvalsh(scaled).min() > 0.0
    least = least_eigenvalue_of_the_ply(specimen, plate, x)
    assert least[inside].min() > 0.0
    assert np.all(np.isneginf(posterior.log_prob(x[least <= 0.0])))
    assert (least <= 0.0).sum() > 100


def least_eigenvalue_of_the_ply(specimen: Specimen, plate: Unasked, x: np.ndarray) -> np.ndarray:
    """Of the scaled compliance of a transversely isotropic ply in three dimensions, (m,)."""
    values = plate.parameters.mapping(x)
    given = {k: v for k, v in reference_constants(specimen).items() if k in specimen.material.constants}
    constants = specimen.material.complete(given | values)
    e1, e2, nu12 = (np.broadcast_to(constants[k], len(x)) for k in CONSTANTS[:3])
    nu23 = nu12 if specimen.material.isotropic else through_thickness_poisson(e1, e2, nu12)
    off = -nu12 * np.sqrt(e2 / e1)
    matrix = np.empty((len(x), 3, 3))
    matrix[:, [0, 1, 2], [0, 1, 2]] = 1.0
    matrix[:, 0, 1] = matrix[:, 1, 0] = matrix[:, 0, 2] = matrix[:, 2, 0] = off
    matrix[:, 1, 2] = matrix[:, 2, 1] = -nu23
    return np.linalg.eigvalsh(matrix)[:, 0]


NONE = np.zeros(4)
X = np.array([[0.3, -0.2]])


def log_likelihood(likelihood: Likelihood, nu: float, amplitude: float) -> float:
    posterior = plate_posterior(
        LinearModel(), measurement(None), NONE, likelihood=likelihood, degrees_of_freedom=nu
    )
    return float(posterior.log_likelihood(np.column_stack((X, [amplitude])))[0])


@pytest.mark.parametrize("nu", [np.inf, 4.0])
@pytest.mark.parametrize(("likelihood", "amplitude"), [("relative", 0.004), ("absolute", 1.3)])
def test_every_scale_has_every_shape(likelihood: Likelihood, amplitude: float, nu: float) -> None:
    listed = measurement(None).frequencies
    f = LinearModel().predict(X).frequencies[0]
    sd = amplitude * (listed if likelihood == "relative" else 1.0)
    expected = norm.logpdf(listed, f, sd) if np.isinf(nu) else t.logpdf(listed, nu, f, sd)
    assert log_likelihood(likelihood, nu, amplitude) == pytest.approx(expected.sum(), abs=1e-12)


def test_absolute_noise_of_known_size_is_half_of_f_of_eq_7_over_its_variance() -> None:
    posterior = plate_posterior(LinearModel(), measurement(None), NONE, likelihood="absolute")
    x = np.array([[0.3, -0.2, 2.0], [1.0, 0.4, 2.0]])
    misfit = np.sum(
        (LinearModel().predict(x[:, :2]).frequencies - measurement(None).frequencies) ** 2, axis=1
    )
    difference = np.diff(posterior.log_likelihood(x))[0]
    assert difference == pytest.approx(-np.diff(misfit)[0] / (2 * 2.0**2), rel=1e-12)


def test_rounding_and_the_solver_add_to_both_scales() -> None:
    data, error = measurement(None, resolution=2.0), np.array([0.0, 1e-3, 2e-3, 0.0])
    predicted = np.array([[100.0, 210.0, 290.0, 400.0]])
    for likelihood, own in (("relative", 0.01 * data.frequencies), ("absolute", np.full(4, 0.01))):
        found = noise_model(data, error, likelihood).sd(np.array([0.01]), predicted)[0]  # type: ignore[arg-type]
        expected = np.sqrt(own[:, None] ** 2 + 4.0 / 12 + (error * predicted[0])[None, :] ** 2)
        np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_priors_of_both_amplitudes_are_one_at_the_root_mean_square_frequency() -> None:
    data = measurement(None)
    relative, absolute = (noise_model(data, NONE, scale).parameter for scale in ("relative", "absolute"))
    assert isinstance(relative, Parameter)
    assert isinstance(absolute, Parameter)
    assert (relative.name, relative.prior) == ("relative_std", NOISE_PRIOR)
    assert (absolute.name, absolute.unit) == ("absolute_sd", "Hz")
    rms = np.sqrt(np.mean(data.frequencies**2))
    s = np.array([1e-4, 0.01, 0.1])
    np.testing.assert_allclose(
        absolute.prior.log_density(s * rms) + np.log(rms), relative.prior.log_density(s), rtol=1e-12
    )


def test_standard_deviations_of_the_file_overrule_its_relative_one() -> None:
    sd = np.array([0.1, 0.2, 0.3, 0.4])
    data = replace(measurement(0.01), frequency_sd=sd)
    model = noise_model(data, NONE)
    assert model.parameter is None
    found = model.sd(np.array([model.amplitude]), np.ones((1, 4)))[0]
    np.testing.assert_allclose(found, np.tile(sd[:, None], 4), rtol=1e-15)


@pytest.mark.parametrize("key", ["relative_std", "frequency_sd_hz"])
def test_a_repeatability_of_the_file_and_the_absolute_likelihood_exclude_each_other(key: str) -> None:
    data = measurement(0.01)
    if key == "frequency_sd_hz":
        data = replace(data, frequency_sd=np.ones(4))
    with pytest.raises(ValueError, match=f"measurement.{key}.*leave {key} out"):
        noise_model(data, NONE, "absolute")


@pytest.mark.parametrize("nu", [2.0, 0.0, -1.0, np.nan])
def test_noise_without_a_variance_is_refused(nu: float) -> None:
    with pytest.raises(ValueError, match="degrees of freedom of the noise"):
        noise_model(measurement(0.01), NONE, degrees_of_freedom=nu)


@pytest.mark.parametrize(("nu", "edge"), [(np.inf, norm.ppf(0.9)), (4.0, t.ppf(0.9, 4))])
def test_replicates_are_drawn_from_the_density(nu: float, edge: float) -> None:
    model = noise_model(measurement(0.01), NONE, degrees_of_freedom=nu)
    beyond = np.mean(model.sample(np.random.default_rng(0), (100, 100)) > edge)
    # four binomial standard errors of 10000 draws
    assert beyond == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 10_000))


def test_the_suggested_amplitude_is_that_of_the_residuals_within_the_prior() -> None:
    residuals = np.array([1.0, -2.0, 2.0, -1.0])
    data = measurement(None)
    assert noise_model(data, NONE, "absolute").suggested(residuals) == pytest.approx(np.sqrt(2.5))
    relative = noise_model(data, NONE)
    assert relative.suggested(residuals) == pytest.approx(
        np.sqrt(np.mean((residuals / data.frequencies) ** 2))
    )
    assert relative.suggested(np.zeros(4)) == 2 * NOISE_PRIOR.lower
    assert relative.suggested(1e6 * residuals) == 0.5 * NOISE_PRIOR.upper


@pytest.mark.slow
def test_the_reduced_model_changes_no_mean() -> None:
    """Draws on the reduced model, weighted to the posterior on the full solver."""
    specimen = read_specimen("C1")
    model = reduced_model(specimen, specimen.unknowns, specimen.measurement.size)
    # a list as repeatable as the best of a laboratory: noise makes errors of a model count less
    f = model.full.predict(reference_vector(specimen, specimen.unknowns)).frequencies[0]
    f = f * (1.0 + 0.002 * np.random.default_rng(3).standard_normal(len(f)))
    listed = replace(specimen.measurement, frequencies=f, relative_std=0.002, resolution=0.0)
    error = np.hypot(model.full.error, model.tolerance)
    own = plate_posterior(model, listed, error)
    # both models are compared on the same draws, so these need not be many
    brief = EnsembleSettings(walkers=24, round_steps=400, r_hat=1.1, effective=300.0, lengths=10.0)
    found = sample_posterior(own, 0, settings=brief, swarm_settings=SwarmSettings(20, 60)).draws
    draws = found[np.linspace(0, len(found) - 1, 800).astype(int)]
    log_weight = plate_posterior(model.full, listed, error).log_prob(draws) - own.log_prob(draws)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    shift = (weight @ draws - draws.mean(axis=0)) / draws.std(axis=0)
    assert 1.0 / np.sum(weight**2) > 0.9 * len(draws), "draws on the reduced model are as good"
    assert np.abs(shift).max() <= 0.05
