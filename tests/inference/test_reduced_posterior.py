"""Posteriors on the reduced model against the full solver: means, by importance weights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from cpam_bayes.forward_model.model import PlateModel, reference_vector
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS, ReducedModel, ReductionSettings
from cpam_bayes.forward_model.reduction import reduce
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.inference.chains.ensemble import EnsembleSettings
from cpam_bayes.inference.chains.sampling import sample_posterior
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.inference.swarm.pso import SwarmSettings
from cpam_bayes.plate import Measurement, Specimen, read_specimen

# Both models are compared on the same draws, so these need not be many.
BRIEF = EnsembleSettings(
    walkers=24, round_steps=400, r_hat=1.1, effective=300.0, most_steps=2000, lengths=10.0
)
N_DRAWS = 800
# Lists this repeatable are the best that a laboratory gets; noise makes errors of a model count less.
REPEATABLE = {"C1": 0.002, "D1": 0.005}


@dataclass(frozen=True, slots=True)
class Comparison:
    """Shift of the means in posterior standard deviations, (n,), and share of draws that count."""

    shift: np.ndarray
    effective_share: float


def compared(model: ReducedModel, measurement: Measurement) -> Comparison:
    """Means of draws from the posterior on a reduced model, weighted to that on the full solver."""
    error = np.hypot(model.full.error, DEFAULT_SETTINGS.tolerance)
    own = plate_posterior(model, measurement, error)
    swarm = SwarmSettings(particles=20, iterations=60)
    found = sample_posterior(own, 0, settings=BRIEF, swarm_settings=swarm).draws
    draws = found[np.linspace(0, len(found) - 1, N_DRAWS).astype(int)]
    log_weight = plate_posterior(model.full, measurement, error).log_prob(draws) - own.log_prob(draws)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    shift = (weight @ draws - draws.mean(axis=0)) / draws.std(axis=0)
    return Comparison(shift, float(1.0 / np.sum(weight**2) / N_DRAWS))


@cache
def plate(name: str) -> tuple[Specimen, ReducedModel]:
    specimen = read_specimen(name)
    assert specimen.measurement is not None
    return specimen, reduced_model(specimen, specimen.unknowns, specimen.measurement.size)


def repeatable_list(specimen: Specimen, full: PlateModel) -> Measurement:
    """What the full solver gives at the reference constants, scattered by a given noise."""
    assert specimen.measurement is not None
    s = REPEATABLE[specimen.name]
    f = full.predict(reference_vector(specimen, full.parameters)).frequencies[0]
    listed = f * (1.0 + s * np.random.default_rng(3).standard_normal(len(f)))
    return replace(specimen.measurement, frequencies=listed, relative_std=s, resolution=0.0)


def check_means(name: str, measurement: Measurement) -> None:
    found = compared(plate(name)[1], measurement)
    assert found.effective_share > 0.9, "the weights are even: draws on the reduced model are as good"
    assert np.abs(found.shift).max() <= 0.05


@pytest.mark.slow
def test_reduced_model_changes_no_mean_on_the_printed_list() -> None:
    specimen, _ = plate("C1")
    assert specimen.measurement is not None
    check_means("C1", specimen.measurement)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["C1", "D1"])
def test_reduced_model_changes_no_mean_on_a_repeatable_list(name: str) -> None:
    specimen, model = plate(name)
    check_means(name, repeatable_list(specimen, model.full))


@pytest.mark.slow
def test_a_coarse_reduction_is_seen_in_the_means() -> None:
    specimen, model = plate("C1")
    settings = ReductionSettings(tolerance=1e-2, training=20, checks=20, rounds=1)
    coarse = reduce(model.full, np.random.default_rng(0), settings)
    found = compared(coarse, repeatable_list(specimen, model.full))
    assert np.abs(found.shift).max() > 0.05
