"""What errors of sizes, noise and priors leave open of the constants, by each way of identifying them."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.known_errors import FREQUENCY_SCALE, ScaleError, TolerantModel, tolerant
from cpam_bayes.forward_model.model import (
    NO_PARAMETERS,
    converged_model,
    reference_constants,
    reference_vector,
    size_parameters,
)
from cpam_bayes.forward_model.reduced import basis_error
from cpam_bayes.identification.point import LEAST_WIDENING, reliances
from cpam_bayes.identification.search import start_of
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.posterior import Posterior, gauss_newton_covariance, plate_posterior
from cpam_bayes.inference.sampling import _narrowed as narrowed
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import Specimen, parse_specimen, read_specimen
from cpam_bayes.priors import TruncatedNormal
from cpam_bayes.questions.identify.emcee import sample
from cpam_bayes.questions.identify.pso import PointResult
from tests.plate_file import MEASURED, PLATE

NOISE = 0.002
QUICK = SwarmSettings(particles=20, iterations=40)


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
    exact = replace(specimen, plate=plate, measurement=data).with_exact_sizes()
    return replace(exact, plate=replace(exact.plate, sd={**exact.plate.sd, **absolute}))


def linear_sd(specimen: Specimen) -> dict[str, float]:
    """Relative standard deviations at the reference values, to first order."""
    parameters = specimen.unknowns.union(size_parameters(specimen))
    n = specimen.measurement.size
    model = reduced_model(specimen, parameters, n)
    x = reference_vector(specimen, parameters)
    posterior = plate_posterior(model, specimen.measurement, np.zeros(n))
    sd = np.sqrt(np.diag(gauss_newton_covariance(posterior, x)))
    return dict(zip(parameters.names, sd / x, strict=True))


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
    # one that is exact is no parameter
    assert size_parameters(known("A1", {"thickness": 0.01, "density": 0.0})).names == ("thickness",)


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
@pytest.mark.weekly
def test_sampled_moduli_of_c1_widen_as_to_first_order() -> None:
    specimen = known("C1", {"thickness": 0.01})
    bounds_alone = replace(specimen, material=replace(specimen.material, known=False))
    found = sample(bounds_alone, seed=0, settings=EnsembleSettings(effective=1500.0))
    exact, expected = linear_sd(known("C1", {})), linear_sd(specimen)
    for name, constant in found.constants.items():
        # 1500 effective draws give an sd to 1.8 %, four standard errors
        assert constant.sd / constant.value == pytest.approx(expected[name], rel=0.075)
    for name in ("E1", "E2", "G12"):
        assert expected[name] == pytest.approx(np.hypot(exact[name], 0.02), rel=0.02)


def from_file(spread: str = "") -> PointResult:
    """To first order, about the optimum of eq. (7), with what the file states alone."""
    return cb.identify(parse_specimen(PLATE + spread + MEASURED, "x"), seed=1, residuals="absolute")


@pytest.fixture(scope="module")
def without_spread() -> PointResult:
    return from_file()


def error_of(result: PointResult, name: str) -> ScaleError:
    (found,) = (e for e in result.estimate.scale_errors if e.name == name)
    return found


@pytest.mark.parametrize(
    ("name", "power"), [("thickness", -2.0), ("density", 1.0), ("frequency_scale", -2.0)]
)
def test_a_thin_plate_hides_thickness_density_and_frequency_scale_in_its_modulus(
    without_spread: PointResult, name: str, power: float
) -> None:
    # f^2 is proportional to E h^2 / rho; shear of a plate of 1/93 changes the power by less than 1 %
    found = error_of(without_spread, name)
    assert found.shift["E1"] == pytest.approx(power, rel=0.01)
    assert found.shift["nu12"] == pytest.approx(0.0, abs=0.02)
    assert found.visible < 0.02
    assert found.sd is None
    # the shape of a plate shows in its frequencies
    assert error_of(without_spread, "length").visible > 0.2


@pytest.mark.parametrize(
    ("name", "stated", "larger"), [("length", "300.0", "300.6"), ("thickness", "3.0", "3.006")]
)
def test_identified_again_with_another_size_a_weighed_plate_has_the_constants_that_were_foretold(
    name: str, stated: str, larger: str
) -> None:
    weighed = PLATE.replace("density_kg_m3 = 2700.0", "mass_g = 680.4")
    f = cb.forward(parse_specimen(weighed, "x"), n_modes=8).frequencies.tolist()
    listed = f"\n[measurement]\nfrequencies_hz = {f}\nrelative_std = 0.002\n"
    plates = (weighed, weighed.replace(f"{name}_mm = {stated}", f"{name}_mm = {larger}"))
    before, after = (
        cb.identify(parse_specimen(text + listed, "x"), seed=1, residuals="relative") for text in plates
    )
    moved = np.log(after.constants["E1"].value / before.constants["E1"].value) / 0.002
    # the powers take what is known of nu12 before the list, which a fit of residuals does not
    assert error_of(before, name).shift["E1"] == pytest.approx(moved, rel=0.02)
    # with the mass instead of the density f^2 goes with E h^3 / m
    for size, power in (("thickness", -3.0), ("mass", 1.0)):
        assert error_of(before, size).shift["E1"] == pytest.approx(power, rel=0.01)


def test_the_interval_contains_the_stated_uncertainty_of_the_thickness(without_spread: PointResult) -> None:
    gauged = from_file("\n[plate.sd]\nthickness_mm = 0.06\n")
    without, with_spread = (result.estimate.constants[0] for result in (without_spread, gauged))
    assert with_spread.value == pytest.approx(without.value, rel=1e-3)
    # 0.06 of 3 mm is 2 %, which moves E1 by 4 %
    added = (with_spread.sd**2 - without.sd**2) ** 0.5 / without.value
    assert added == pytest.approx(0.04, rel=0.02)
    assert with_spread.interval[0] < without.interval[0] < without.interval[1] < with_spread.interval[1]


NAMES = ("E1", "E2", "nu12")
PRIOR_SD = np.array([50.0, 1.0, 0.03])
# Frequencies of a cross-ply: they determine E1 + E2, and nothing of nu12.
SUM = np.array([[1.0, 1.0, 0.0]]) / 0.5


def with_priors(prior_sd: np.ndarray) -> np.ndarray:
    return np.linalg.inv(SUM.T @ SUM + np.diag(prior_sd**-2.0))


def test_the_widening_is_that_of_the_posterior_with_a_prior_of_twice_the_width() -> None:
    now = with_priors(PRIOR_SD)
    found = {(r.name, r.on): r.widening for r in reliances(NAMES, now, PRIOR_SD)}
    then = with_priors(PRIOR_SD * np.array([1.0, 2.0, 1.0]))
    expected = np.sqrt(then[0, 0] / now[0, 0]) - 1.0
    assert expected > 0.5
    assert found == {("E1", "E2"): pytest.approx(expected, rel=1e-9)}


def test_nothing_feeds_on_a_constant_that_data_determine_or_a_covariance_that_is_unknown() -> None:
    both = np.diag([1.0, 0.01, 1e-6])
    both[0, 1] = both[1, 0] = 0.9 * np.sqrt(both[0, 0] * both[1, 1])
    assert reliances(NAMES, both, PRIOR_SD) == ()
    assert reliances(NAMES, np.full((3, 3), np.nan), PRIOR_SD) == ()


def test_what_else_widens_an_interval_leaves_less_to_the_prior() -> None:
    now = with_priors(PRIOR_SD)
    sd = np.sqrt(np.diag(now))
    assert reliances(NAMES, now, PRIOR_SD, 10.0 * sd) == ()
    ((alone,), (less,)) = (reliances(NAMES, now, PRIOR_SD, given) for given in (None, 1.5 * sd))
    assert LEAST_WIDENING <= less.widening < alone.widening


# All is exact but the thickness.
EXACT = "length_mm = 0\nwidth_mm = 0\ndensity_kg_m3 = 0\n"
ONE = PLATE.replace("nu12 = [0.15, 0.4]\n", "")


def identified(plate: str, thickness: float | None, **stated: float) -> PointResult:
    """A list by the model itself, of a plate whose thickness is known to so many mm, or all as usual."""
    f = cb.forward(parse_specimen(plate, "x"), n_modes=8).frequencies.tolist()
    sd = "" if thickness is None else f"\n[plate.sd]\nthickness_mm = {thickness}\n{EXACT}"
    given = "".join(f"{key} = {value}\n" for key, value in stated.items())
    text = f"{plate}{sd}\n[measurement]\nfrequencies_hz = {f}\n{given}"
    return cb.identify(parse_specimen(text, "x"), seed=1)


@pytest.mark.slow
def test_one_modulus_is_known_as_well_as_noise_and_thickness_let_it_be() -> None:
    found = identified(ONE, 0.0, relative_std=NOISE, frequency_scale_sd=0.0).constants["E1"]
    thick = identified(ONE, 0.03, relative_std=NOISE, frequency_scale_sd=0.0).constants["E1"]
    scale = identified(ONE, 0.0, relative_std=NOISE, frequency_scale_sd=0.004).constants["E1"]
    # f^2 goes with E: of eight frequencies with 0.2 % of noise the mean is known to 0.07 %, E to 0.14 %
    assert found.value == pytest.approx(69e9, rel=3e-4)
    assert found.sd / found.value == pytest.approx(2 * NOISE / 8**0.5, rel=0.08)
    # 1 % of thickness is 2 % of E, and 0.4 % of the scale 0.8 %
    assert thick.sd / thick.value == pytest.approx(np.hypot(0.02, 2 * NOISE / 8**0.5), rel=0.05)
    assert scale.sd / scale.value == pytest.approx(np.hypot(0.008, 2 * NOISE / 8**0.5), rel=0.05)
    for c in (found, thick, scale):
        assert c.interval is not None
        assert (c.interval[1] - c.interval[0]) / c.sd == pytest.approx(2 * 1.96, rel=0.05)
    # left out: E goes with rho / h^2 and sides to the fourth, 1 % of density and thickness, 0.1 % of sides
    usual = identified(ONE, None, relative_std=NOISE).constants["E1"]
    assert usual.sd / usual.value == pytest.approx(np.sqrt(0.02**2 + 0.01**2), rel=0.05)


def test_a_constant_of_which_the_list_says_little_keeps_what_was_known_of_it() -> None:
    known = PLATE.replace("nu12 = 0.33\n", "nu12 = 0.33\n\n[material.sd]\nnu12 = 0.003\n", 1)
    found = identified(known, 0.0, relative_std=0.02).constants["nu12"]
    assert found.value == pytest.approx(0.33, abs=0.002)
    assert found.sd == pytest.approx(0.003, rel=0.1)


@pytest.mark.parametrize("thinner", [0.85, 0.6])
def test_a_fit_allows_for_a_thickness_of_which_little_is_known(thinner: float) -> None:
    stated = parse_specimen(ONE, "x")
    other = replace(stated.plate, thickness=thinner * stated.plate.thickness)
    f = cb.forward(replace(stated, plate=other), n_modes=8).frequencies.tolist()
    sd = f"\n[plate.sd]\nthickness_mm = {250.0 * stated.plate.thickness}\n{EXACT}"
    text = f"{ONE}{sd}\n[measurement]\nfrequencies_hz = {f}\nrelative_std = {NOISE}\n"
    found = cb.identify(parse_specimen(text, "x"), seed=1)
    assert found.estimate.rms < NOISE
    assert found.estimate.misfit == 1.0
    interval = found.constants["E1"].interval
    assert interval is not None
    assert interval[0] < 69e9 < interval[1]


EXAMPLE = (Path(__file__).parents[2] / "examples" / "panel.toml").read_text(encoding="utf-8")
PANEL = re.sub(r"\[plate\.sd\].*?(?=\[material\])", "", EXAMPLE, flags=re.DOTALL)
ONE_ANGLE = PANEL.replace('"[0_8]"', '"[?]"').replace("[unknowns]", "[unknowns]\nangle_grid_deg = 90.0")


@pytest.fixture(scope="module")
def panel() -> Specimen:
    return parse_specimen(PANEL, "panel")


@pytest.mark.slow
def test_identify_sample_sequence_and_diagnose_print_the_same_constants(panel: Specimen) -> None:
    answers = {
        "identify": cb.identify(panel, seed=3),
        "sample": cb.sample(panel, seed=3),
        "sequence": cb.sequence(parse_specimen(ONE_ANGLE, "panel"), seed=3),
        "diagnose": cb.diagnose(panel, seed=3),
    }
    first = answers.pop("identify").to_dict()["constants"]
    assert first["E1_GPa"]["sd"] > 0.02 * first["E1_GPa"]["value"]  # the thickness, known to 1 %, is in it
    for verb, answer in answers.items():
        for name, constant in answer.to_dict()["constants"].items():
            value, sd = first[name]["value"], first[name]["sd"]
            # 400 effective draws give a mean to 0.05 sd and an sd to 4 %; diagnose allows for causes too
            assert constant["mean"] == pytest.approx(value, abs=0.2 * sd), (verb, name)
            assert constant["sd"] == pytest.approx(sd, rel=0.12), (verb, name)


@pytest.mark.slow
def test_the_intervals_are_those_of_exact_sizes_where_the_file_says_so(panel: Specimen) -> None:
    open_, exact = cb.identify(panel), cb.identify(panel.with_exact_sizes())
    assert exact.estimate.constants[0].sd < 0.3 * open_.estimate.constants[0].sd
    assert "The intervals contain noise and the data sheet." in exact.summary()


def tolerant_panel(panel: Specimen, n: int) -> tuple[TolerantModel, np.ndarray]:
    """Its model of n modes with the numbers that are left open, and the values of all parameters."""
    constants = {name: float(reference_constants(panel)[name]) for name in panel.unknowns.names}
    own = tolerant(panel, reduced_model(panel, panel.unknowns, n), constants, np.arange(n))
    assert isinstance(own, TolerantModel)
    return own, np.array([*constants.values(), *(p.prior.mean for p in own.tolerances.parameters)])


def test_a_tolerant_model_predicts_the_plate_of_other_sizes(panel: Specimen) -> None:
    own, values = tolerant_panel(panel, 10)
    x = values[None]
    assert own.tolerances.names == ("thickness", "length", "width", "mass", FREQUENCY_SCALE)
    np.testing.assert_array_equal(own.predict(x).frequencies, own.model.predict(x[:, :4]).frequencies)
    factors = {"thickness": 1.01, "length": 0.998, "width": 1.002, "mass": 1.004}
    there = {name: getattr(panel.plate, name) * factor for name, factor in factors.items()}
    volume = there["thickness"] * there["length"] * there["width"]
    other = replace(panel, plate=replace(panel.plate, **there, density=there["mass"] / volume))
    expected = converged_model(other, other.unknowns, 10).predict(x[:, :4]).frequencies
    x[0, 4:] *= [*factors.values(), 1.0005]
    assert expected[0, 7] / expected[0, 6] < 1.005  # two modes that have changed places
    # of changes up to 2 %, the second order and the error of two solvers
    np.testing.assert_allclose(own.predict(x).frequencies, 1.0005 * expected, rtol=2e-4)


def test_derivatives_of_a_tolerant_model_are_those_of_its_predictions(panel: Specimen) -> None:
    own, values = tolerant_panel(panel, 4)
    x = values[None] * np.where(np.arange(len(values)) < 4, 1.0, 1.003)
    slopes = own.predict(x, jacobian=True).jacobian[0]
    for k, value in enumerate(x[0]):
        step = np.zeros_like(x)
        step[0, k] = 1e-3 * value  # a tenth of it drowns in the rounding of eigenvalues
        up, down = (own.predict(x + s * step).frequencies[0] for s in (1.0, -1.0))
        np.testing.assert_allclose(
            slopes[:, k], (up - down) / (2.0 * step[0, k]), rtol=1e-3, atol=1e-6 / value
        )


def test_a_narrowed_posterior_has_a_smaller_basis_that_errs_less_than_a_part_of_the_noise(
    panel: Specimen,
) -> None:
    assert panel.measurement is not None
    n = panel.measurement.size
    own, middle = tolerant_panel(panel, n)
    whole, exact = (
        plate_posterior(own, replace(panel.measurement, relative_std=sd, frequency_sd=None), np.zeros(n))
        for sd in (0.02, 1e-4)
    )
    x = middle * (1.0 + 0.002 * np.random.default_rng(0).uniform(-1.0, 1.0, (200, len(middle))))

    def sizes(posterior: Posterior) -> int:
        assert isinstance(posterior.model, TolerantModel)
        return sum(block.size for block in posterior.model.model.fast.operator.blocks)

    narrow = narrowed(whole, x)
    assert sizes(narrow) < sizes(whole)
    # the list is rank by rank: two modes that change places err no more than each alone
    assert np.abs(narrow.predict(x) / whole.predict(x) - 1.0).max() < 0.05 * 0.02
    assert narrowed(exact, x) is exact, "its own basis is no better"
