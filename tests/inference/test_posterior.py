"""Posteriors of plates: noise, priors, pairing, on full and reduced models."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.special import softmax
from scipy.stats import norm, t

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import Prediction, plate_problem, reference_constants, reference_vector
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.posterior import NOISE, NOISE_PRIOR, SolverError, noise_model, plate_posterior
from cpam_bayes.inference.sampling import sample_posterior
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parameters import ParameterSet, Uniform
from cpam_bayes.plate import Measurement, read_specimen
from cpam_bayes.plate.laminate import CONSTANTS, through_thickness_poisson
from tests.linear_model import LinearModel, measurement

ERROR = np.array([1e-3, 2e-3, 1e-3, 3e-3])
LISTED = measurement(None).frequencies
OWN = np.array([0.1, 0.2, 0.3, 0.4])
RMS = np.sqrt(np.mean(LISTED**2))
# By the file's noise statement: the list, the scale, its amplitude if inferred, and its sd, Hz.
KINDS: dict[str, tuple[Measurement, str, float | None, np.ndarray]] = {
    "stated": (measurement(0.01, 2.0), "relative", None, 0.01 * LISTED),
    "one by one": (replace(measurement(0.01, 2.0), frequency_sd=OWN), "relative", None, OWN),
    "inferred": (measurement(None, 2.0), "relative", 0.004, 0.004 * LISTED),
    "inferred in Hz": (measurement(None, 2.0), "absolute", 1.3, np.full(4, 1.3)),
}


@pytest.mark.parametrize("nu", [np.inf, 4.0])
@pytest.mark.parametrize(("data", "likelihood", "amplitude", "sd"), KINDS.values(), ids=KINDS)
def test_log_probability_is_that_of_noise_rounding_solver_and_priors(data, likelihood, amplitude, sd, nu):
    model = LinearModel()
    posterior = plate_posterior(model, data, ERROR, likelihood=likelihood, degrees_of_freedom=nu)
    x = np.array([[0.3, -0.2], [-0.1, 0.7]])
    f = model.predict(x).frequencies
    sigma = np.sqrt(sd**2 + 4 / 12 + (ERROR * f) ** 2)
    density = norm.logpdf(LISTED, f, sigma) if np.isinf(nu) else t.logpdf(LISTED, nu, f, sigma)
    expected = density.sum(axis=1) - 2 * np.log(4.0)
    if amplitude is not None:
        # the prior of an amplitude in Hz is the relative one at the root mean square frequency
        size, name, unit = (RMS, "absolute_sd", "Hz") if likelihood == "absolute" else (1.0, NOISE, "")
        noise = posterior.parameters.parameters[-1]
        assert (noise.name, noise.unit) == (name, unit)
        expected += NOISE_PRIOR.log_density(amplitude / size) - np.log(size)
        x = np.column_stack((x, [amplitude] * 2))
    assert posterior.parameters.size == x.shape[1]
    np.testing.assert_allclose(posterior.log_prob(x), expected, rtol=1e-12)


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
    x = np.array([[0.3, -0.2]])  # no false peaks, every mode in place, each present with p = 0.7
    full = plate_posterior(LinearModel(), data, np.zeros(4)).log_likelihood(x)[0]
    assert posterior.log_likelihood(x)[0] == pytest.approx(full + 4 * np.log(0.7), abs=1e-6)


@dataclass(frozen=True)
class Broken(LinearModel):
    """A model whose second mode is not finite if b exceeds 1."""

    value: float = np.nan

    def predict(self, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
        f = super().predict(x).frequencies.copy()
        f[x[:, 1] > 1.0, 1] = self.value
        return Prediction(f, None)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("complete", [True, False])
def test_what_is_no_number_is_an_error_with_its_parameters(value: float, complete: bool) -> None:
    data = replace(measurement(None), complete=complete)
    posterior = plate_posterior(Broken(value=value), data, np.zeros(4))
    assert np.isfinite(posterior.log_prob(np.array([0.5, 0.5, 0.01]))[0])
    with pytest.raises(SolverError, match=f"returned {value} Hz for mode 2 at a = 0.5, b = 1.5; check"):
        posterior.log_prob(np.array([[0.5, 0.5, 0.01], [0.5, 1.5, 0.01]]))
    assert issubclass(SolverError, ValueError)
    unsure = plate_posterior(LinearModel(), measurement(relative_std=0.01), np.full(4, np.nan))
    with pytest.raises(SolverError, match=r"log probability is not a number at a = 0\.5, b = 0\.25"):
        unsure.log_prob(np.array([0.5, 0.25]))


@pytest.mark.parametrize("name", ["A1", "D1"])
def test_every_set_that_is_allowed_has_a_positive_definite_stiffness(name: str) -> None:
    """Between far too wide bounds; laminate stiffness, and compliance of the ply in three dimensions."""
    specimen, wide = read_specimen(name), {"nu12": Uniform(-1.5, 1.5)}
    unknowns = specimen.unknowns.parameters
    parameters = tuple(replace(p, prior=wide.get(p.name, Uniform(1e8, 2e11))) for p in unknowns)
    problem = plate_problem(specimen, ParameterSet(parameters))
    x = problem.parameters.sample(np.random.default_rng(0), 4000)
    inside = problem.admissible(problem.parameters.mapping(x))
    assert 0.02 < inside.mean() < 0.98
    stiffness = problem.state(problem.parameters.mapping(x[inside])).stiffness()
    scale = np.sqrt(np.einsum("...ii->...i", stiffness))  # a diagonal of ones: SI entries differ by 1e9
    scaled = stiffness / scale[..., :, None] / scale[..., None, :]
    assert np.linalg.eigvalsh(scaled).min() > 0.0
    # the scaled compliance of a transversely isotropic ply in three dimensions
    given = {k: v for k, v in reference_constants(specimen).items() if k in specimen.material.constants}
    constants = specimen.material.complete(given | dict(problem.parameters.mapping(x)))
    e1, e2, nu12 = (np.broadcast_to(constants[k], len(x)) for k in CONSTANTS[:3])
    nu23 = nu12 if specimen.material.isotropic else through_thickness_poisson(e1, e2, nu12)
    matrix = np.tile(np.eye(3), (len(x), 1, 1))
    for i, j, off in ((0, 1, nu12 * np.sqrt(e2 / e1)), (0, 2, nu12 * np.sqrt(e2 / e1)), (1, 2, nu23)):
        matrix[:, i, j] = matrix[:, j, i] = -off
    least = np.linalg.eigvalsh(matrix)[:, 0]
    assert least[inside].min() > 0.0
    assert (least <= 0.0).sum() > 100


NONE = np.zeros(4)


def test_noise_that_is_stated_twice_or_has_no_variance_is_refused() -> None:
    for kind, name in (("stated", "relative_std"), ("one by one", "frequency_sd_hz")):
        with pytest.raises(ValueError, match=f"measurement.{name}.*leave {name} out"):
            noise_model(KINDS[kind][0], NONE, likelihood="absolute")
    for nu in (2.0, 0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="degrees of freedom of the noise"):
            noise_model(measurement(0.01), NONE, degrees_of_freedom=nu)


def test_replicates_are_drawn_from_the_density_and_an_amplitude_is_suggested_by_the_residuals() -> None:
    for nu, edge in ((np.inf, norm.ppf(0.9)), (4.0, t.ppf(0.9, 4))):
        model = noise_model(measurement(0.01), NONE, degrees_of_freedom=nu)
        beyond = np.mean(model.sample(np.random.default_rng(0), (100, 100)) > edge)
        assert beyond == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / 10_000))  # four standard errors
    residuals, data = np.array([1.0, -2.0, 2.0, -1.0]), measurement(None)
    assert noise_model(data, NONE, "absolute").suggested(residuals) == pytest.approx(np.sqrt(2.5))
    relative, expected = noise_model(data, NONE), np.sqrt(np.mean((residuals / LISTED) ** 2))
    assert relative.suggested(residuals) == pytest.approx(expected)
    assert relative.suggested(np.zeros(4)) == 2 * NOISE_PRIOR.lower
    assert relative.suggested(1e6 * residuals) == 0.5 * NOISE_PRIOR.upper


@pytest.mark.slow
def test_the_reduced_model_changes_no_mean() -> None:
    """Draws on the reduced model, reweighted to the posterior on the full solver."""
    specimen = read_specimen("C1")
    model = reduced_model(specimen, specimen.unknowns, specimen.measurement.size)
    # a list as repeatable as a laboratory's best: with noise, errors of a model matter less
    f = model.full.predict(reference_vector(specimen, specimen.unknowns)).frequencies[0]
    f = f * (1.0 + 0.002 * np.random.default_rng(3).standard_normal(len(f)))
    listed = replace(specimen.measurement, frequencies=f, relative_std=0.002, resolution=0.0)
    error = np.hypot(model.full.error, model.tolerance)
    own = plate_posterior(model, listed, error)
    # both models are compared on the same draws, so few are enough
    brief = EnsembleSettings(walkers=24, round_steps=400, r_hat=1.1, effective=300.0, lengths=10.0)
    found = sample_posterior(own, 0, settings=brief, swarm_settings=SwarmSettings(20, 60)).draws
    draws = found[np.linspace(0, len(found) - 1, 800).astype(int)]
    weight = softmax(plate_posterior(model.full, listed, error).log_prob(draws) - own.log_prob(draws))
    shift = (weight @ draws - draws.mean(axis=0)) / draws.std(axis=0)
    assert 1.0 / np.sum(weight**2) > 0.9 * len(draws), "draws on the reduced model are as good"
    assert np.abs(shift).max() <= 0.05
