"""Sizes with standard deviations: parameters with priors whose uncertainty reaches the constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import NO_PARAMETERS, converged_model, reference_vector, size_parameters
from cpam_bayes.forward_model.reduced import basis_error
from cpam_bayes.identification.search import start_of
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.laplace import gauss_newton_covariance
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.priors import TruncatedNormal
from cpam_bayes.questions.identify.emcee import sample

NOISE = 0.002
QUICK = SwarmSettings(particles=20, iterations=40)
# How E, G scale with each size at given frequencies of a thin plate: f^2 ~ E h^2 / (rho L^4), and with
# the mass instead of the density f^2 ~ E h^3 L W / (m L^4); one size alone changes a ratio of sides too.
POWER = {("density", False): 1.0, ("thickness", False): -2.0, ("mass", True): 1.0, ("thickness", True): -3.0}


def known(name: str, sd: Mapping[str, float], weighed: bool = False) -> Specimen:
    """A specimen with the frequencies of its reference constants, repeatable to 0.2 %, and sd of sizes.

    sd : relative, by name. weighed : the plate's mass is given instead of its density.
    """
    specimen = read_specimen(name)
    n = specimen.measurement.size
    f = converged_model(specimen, NO_PARAMETERS, n).predict(np.empty((1, 0))).frequencies[0]
    data = replace(specimen.measurement, frequencies=f, relative_std=NOISE, resolution=0.0)
    plate = specimen.plate
    if weighed:
        plate = replace(plate, mass=plate.density * plate.area * plate.thickness)
    absolute = {size: share * float(getattr(plate, size)) for size, share in sd.items()}
    return replace(specimen, plate=replace(plate, sd=absolute), measurement=data)


def linear_sd(specimen: Specimen) -> dict[str, float]:
    """Relative standard deviations at the reference values, to first order."""
    parameters = specimen.unknowns.union(size_parameters(specimen))
    n = specimen.measurement.size
    model = reduced_model(specimen, parameters, n)
    x = reference_vector(specimen, parameters)
    posterior = plate_posterior(model, specimen.measurement, np.zeros(n))
    sd = np.sqrt(np.diag(gauss_newton_covariance(posterior, x)))
    return dict(zip(parameters.names, sd / x, strict=True))


@pytest.mark.parametrize(("size", "weighed"), POWER)
def test_the_spread_of_a_size_is_carried_to_the_modulus_by_the_scaling_of_thin_plates(
    size: str, weighed: bool
) -> None:
    without = linear_sd(known("A1", {}, weighed))
    found = linear_sd(known("A1", {size: 0.01}, weighed))
    expected = np.hypot(without["E1"], POWER[size, weighed] * 0.01)
    # the prior of E1 hardly counts; shear deformation and rotary inertia change the power by 1 %
    assert found["E1"] == pytest.approx(expected, rel=0.01)
    assert found["nu12"] == pytest.approx(without["nu12"], rel=0.01)
    assert found[size] == pytest.approx(0.01, rel=0.01)


def test_a_size_that_is_known_exactly_changes_no_spread() -> None:
    without, found = linear_sd(known("A1", {})), linear_sd(known("A1", {"thickness": 1e-6, "length": 1e-6}))
    for name, sd in without.items():
        assert found[name] == pytest.approx(sd, rel=1e-3)


@pytest.mark.parametrize("weighed", [False, True])
def test_the_model_at_another_size_is_the_model_of_that_plate(weighed: bool) -> None:
    shares = {"length": 0.01, "width": 0.01, "thickness": 0.02, ("mass" if weighed else "density"): 0.02}
    specimen = known("A1", shares, weighed)
    parameters = size_parameters(specimen)
    assert parameters.names == tuple(shares)
    model = reduced_model(specimen, parameters, 6)
    rng = np.random.default_rng(0)
    x = parameters.sample(rng, 3)
    assert basis_error(model, x).max() < 1e-4
    for one, found in zip(x, model.predict(x).frequencies, strict=True):
        sizes = dict(zip(parameters.names, one, strict=True))
        if weighed:
            mass = sizes.pop("mass")
            sizes["density"] = mass / (sizes["length"] * sizes["width"] * sizes["thickness"])
        there = replace(specimen, plate=replace(specimen.plate, **sizes, mass=None, sd={}))
        expected = converged_model(there, NO_PARAMETERS, 6).predict(np.empty((1, 0))).frequencies[0]
        # two spaces, each converged to 1e-4
        np.testing.assert_allclose(found, expected, rtol=2e-4)


def test_priors_of_sizes_are_normal_and_stay_positive() -> None:
    plate = known("A1", {"thickness": 0.01, "density": 0.5})
    thickness, density = (p.prior for p in size_parameters(plate).parameters)
    h, rho = plate.plate.thickness, plate.plate.density
    assert thickness == TruncatedNormal(h, 0.01 * h, 0.95 * h, 1.05 * h)
    assert isinstance(density, TruncatedNormal)
    assert (density.lower, density.upper) == (rho / 4, pytest.approx(3.5 * rho))


@pytest.mark.parametrize("complete", [True, False])
def test_the_start_has_the_sizes_after_the_constants_and_every_start_is_possible(complete: bool) -> None:
    specimen = known("A1", {"thickness": 0.01, "width": 0.001})
    assert specimen.measurement is not None
    specimen = replace(specimen, measurement=replace(specimen.measurement, complete=complete))
    begun = start_of(specimen, 0, swarm_settings=QUICK)
    assert begun.posterior.parameters.names == ("E1", "nu12", "width", "thickness")
    assert begun.bests.shape == (20, 4)
    if complete:  # the paper's swarm takes sizes as they are printed
        np.testing.assert_array_equal(
            begun.bests[:, 2:], np.tile([specimen.plate.width, specimen.plate.thickness], (20, 1))
        )
    assert np.isfinite(begun.posterior.log_prob(begun.bests)).sum() > 10


@pytest.mark.slow
def test_sampled_moduli_of_c1_widen_as_to_first_order() -> None:
    specimen = known("C1", {"thickness": 0.01})
    found = sample(specimen, seed=0, settings=EnsembleSettings(effective=1500.0))
    exact, expected = linear_sd(known("C1", {})), linear_sd(specimen)
    for name, constant in found.constants.items():
        # 1500 effective draws give an sd to 1.8 %, four standard errors
        assert constant.sd / constant.value == pytest.approx(expected[name], rel=0.075)
    for name in ("E1", "E2", "G12"):
        assert expected[name] == pytest.approx(np.hypot(exact[name], 0.02), rel=0.02)


def test_a_size_that_is_exact_is_no_parameter() -> None:
    plate = known("A1", {"thickness": 0.01, "density": 0.0})
    assert size_parameters(plate).names == ("thickness",)
