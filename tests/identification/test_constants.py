"""Constants by swarms, and their uncertainty from errors of sizes, noise and priors, in every method."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.answer import Verdict
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.known_errors import FREQUENCY_SCALE, tolerant
from cpam_bayes.forward_model.model import NO_PARAMETERS, converged_model, reference_vector, size_parameters
from cpam_bayes.forward_model.reduced import basis_error
from cpam_bayes.identification import search as searching
from cpam_bayes.identification.point import LEAST_WIDENING, reliances
from cpam_bayes.identification.search import Optimum, search, start_of
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.posterior import gauss_newton_covariance, plate_posterior
from cpam_bayes.inference.sampling import _narrowed as narrowed
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import builtin, parse_specimen, read_specimen
from cpam_bayes.priors import TruncatedNormal
from cpam_bayes.questions.identify.emcee import sample
from tests.plate_file import MEASURED, PLATE

NOISE = 0.002
QUICK = SwarmSettings(particles=20, iterations=40)


def reference_frequencies(specimen, n):
    return converged_model(specimen, NO_PARAMETERS, n).predict(np.empty((1, 0))).frequencies[0]


def known(name, sd, weighed=False):
    """A specimen with frequencies of its reference constants, relative sd of sizes, its mass if weighed."""
    specimen = read_specimen(name)
    f, plate = reference_frequencies(specimen, specimen.measurement.size), specimen.plate
    data = replace(specimen.measurement, frequencies=f, relative_std=NOISE, resolution=0.0)
    if weighed:
        plate = replace(plate, mass=plate.density * plate.area * plate.thickness)
    absolute = {size: share * float(getattr(plate, size)) for size, share in sd.items()}
    exact = replace(specimen, plate=plate, measurement=data).with_exact_sizes()
    return replace(exact, plate=replace(exact.plate, sd={**exact.plate.sd, **absolute}))


def linear_sd(specimen):
    parameters, n = specimen.unknowns.union(size_parameters(specimen)), specimen.measurement.size
    x = reference_vector(specimen, parameters)
    posterior = plate_posterior(reduced_model(specimen, parameters, n), specimen.measurement, np.zeros(n))
    sd = np.sqrt(np.diag(gauss_newton_covariance(posterior, x)))
    return dict(zip(parameters.names, sd / x, strict=True))


@pytest.mark.parametrize("weighed", [False, True])
def test_the_model_at_another_size_is_the_model_of_that_plate(weighed):
    shares = {"length": 0.01, "width": 0.01, "thickness": 0.02, ("mass" if weighed else "density"): 0.02}
    specimen = known("A1", shares, weighed)
    parameters = size_parameters(specimen)
    assert parameters.names == tuple(shares)
    model, x = reduced_model(specimen, parameters, 6), parameters.sample(np.random.default_rng(0), 3)
    assert basis_error(model, x).max() < 1e-4
    for one, found in zip(x, model.predict(x).frequencies, strict=True):
        sizes = dict(zip(parameters.names, one, strict=True))
        if weighed:
            sizes["density"] = sizes.pop("mass") / (sizes["length"] * sizes["width"] * sizes["thickness"])
        there = replace(specimen, plate=replace(specimen.plate, **sizes, mass=None, sd={}))
        np.testing.assert_allclose(found, reference_frequencies(there, 6), rtol=2e-4)  # each to 1e-4


def test_priors_of_sizes_are_normal_and_stay_positive():
    plate = known("A1", {"thickness": 0.01, "density": 0.5})
    thickness, density = (p.prior for p in size_parameters(plate).parameters)
    h, rho = plate.plate.thickness, plate.plate.density
    assert thickness == TruncatedNormal(h, 0.01 * h, 0.95 * h, 1.05 * h)
    assert type(density) is TruncatedNormal
    assert (density.lower, density.upper) == (rho / 4, pytest.approx(3.5 * rho))
    # an exact size is no parameter
    assert size_parameters(known("A1", {"thickness": 0.01, "density": 0.0})).names == ("thickness",)


@pytest.mark.parametrize("complete", [True, False])
def test_the_start_has_the_sizes_after_the_constants_and_every_start_is_possible(complete):
    specimen = known("A1", {"thickness": 0.01, "width": 0.001})
    specimen = replace(specimen, measurement=replace(specimen.measurement, complete=complete))
    begun, stated = start_of(specimen, 0, swarm_settings=QUICK), specimen.plate
    assert begun.posterior.parameters.names == ("E1", "nu12", "width", "thickness")
    assert begun.bests.shape == (20, 4)
    if complete:  # the paper's swarm takes sizes as printed
        assert np.all(begun.bests[:, 2:] == [stated.width, stated.thickness])
    assert np.isfinite(begun.posterior.log_prob(begun.bests)).sum() > 10


@pytest.mark.slow
@pytest.mark.weekly
def test_sampled_moduli_of_c1_widen_as_to_first_order():
    specimen = known("C1", {"thickness": 0.01})
    bounds_alone = replace(specimen, material=replace(specimen.material, known=False))
    found = sample(bounds_alone, seed=0, settings=EnsembleSettings(effective=1500.0))
    exact, expected = linear_sd(known("C1", {})), linear_sd(specimen)
    for name, constant in found.constants.items():
        # 1500 effective draws give an sd to 1.8 %, four standard errors
        assert constant.sd / constant.value == pytest.approx(expected[name], rel=0.075)
    for name in ("E1", "E2", "G12"):
        assert expected[name] == pytest.approx(np.hypot(exact[name], 0.02), rel=0.02)


def own_list(plate, **stated):
    """[measurement] with the model's own frequencies, repeatable to 0.2 %, and further entries."""
    f = cb.forward(parse_specimen(plate, "x"), n_modes=8).frequencies.tolist()
    given = "".join(f"{key} = {value}\n" for key, value in ({"relative_std": NOISE} | stated).items())
    return f"\n[measurement]\nfrequencies_hz = {f}\n{given}"


@cache
def from_file(spread=""):
    """First-order result about the optimum of eq. (7), from the file's statements alone."""
    return cb.identify(parse_specimen(PLATE + spread + MEASURED, "x"), seed=1, residuals="absolute")


def error_of(result, name):
    (found,) = (e for e in result.estimate.scale_errors if e.name == name)
    return found


@pytest.mark.parametrize(
    ("name", "power"), [("thickness", -2.0), ("density", 1.0), ("frequency_scale", -2.0)]
)
def test_a_thin_plate_hides_thickness_density_and_frequency_scale_in_its_modulus(name, power):
    found = error_of(from_file(), name)  # f^2 ~ E h^2 / rho; shear of 1/93 changes the power by less than 1 %
    assert found.shift["E1"] == pytest.approx(power, rel=0.01)
    assert found.shift["nu12"] == pytest.approx(0.0, abs=0.02)
    assert found.visible < 0.02
    assert found.sd is None
    assert error_of(from_file(), "length").visible > 0.2  # the shape of a plate shows in its frequencies


@pytest.mark.parametrize(("name", "stated"), [("length", 300.0), ("thickness", 3.0)])
def test_a_weighed_plate_of_another_size_has_the_constants_that_were_foretold(name, stated):
    weighed = PLATE.replace("density_kg_m3 = 2700.0", "mass_g = 680.4")
    larger = weighed.replace(f"{name}_mm = {stated}", f"{name}_mm = {1.002 * stated}")
    listed = own_list(weighed)
    before, after = (
        cb.identify(parse_specimen(text + listed, "x"), seed=1, residuals="relative")
        for text in (weighed, larger)
    )
    moved = np.log(after.constants["E1"].value / before.constants["E1"].value) / 0.002
    assert error_of(before, name).shift["E1"] == pytest.approx(moved, rel=0.02)  # with the prior of nu12
    for size, power in (("thickness", -3.0), ("mass", 1.0)):  # with the mass instead, f^2 ~ E h^3 / m
        assert error_of(before, size).shift["E1"] == pytest.approx(power, rel=0.01)


def test_the_interval_contains_the_stated_uncertainty_of_the_thickness():
    texts = ("", "\n[plate.sd]\nthickness_mm = 0.06\n")
    without, with_spread = (from_file(text).estimate.constants[0] for text in texts)
    assert with_spread.value == pytest.approx(without.value, rel=1e-3)
    # 0.06 of 3 mm is 2 %, which shifts E1 by 4 %
    assert ((with_spread.sd**2 - without.sd**2) ** 0.5 / without.value) == pytest.approx(0.04, rel=0.02)
    assert with_spread.interval[0] < without.interval[0] < without.interval[1] < with_spread.interval[1]


NAMES = ("E1", "E2", "nu12")
PRIOR_SD = np.array([50.0, 1.0, 0.03])
SUM = np.array([[1.0, 1.0, 0.0]]) / 0.5  # cross-ply frequencies: E1 + E2, and nothing about nu12


def with_priors(prior_sd):
    return np.linalg.inv(SUM.T @ SUM + np.diag(prior_sd**-2.0))


def test_the_widening_is_that_of_the_posterior_with_a_prior_of_twice_the_width():
    now = with_priors(PRIOR_SD)
    found = {(r.name, r.on): r.widening for r in reliances(NAMES, now, PRIOR_SD)}
    expected = np.sqrt(with_priors(PRIOR_SD * np.array([1.0, 2.0, 1.0]))[0, 0] / now[0, 0]) - 1.0
    assert expected > 0.5
    assert found == {("E1", "E2"): pytest.approx(expected, rel=1e-9)}


def test_nothing_feeds_on_a_constant_that_data_determine_or_a_covariance_that_is_unknown():
    both = np.diag([1.0, 0.01, 1e-6])
    both[0, 1] = both[1, 0] = 0.9 * np.sqrt(both[0, 0] * both[1, 1])
    assert reliances(NAMES, both, PRIOR_SD) == ()
    assert reliances(NAMES, np.full((3, 3), np.nan), PRIOR_SD) == ()


def test_what_else_widens_an_interval_leaves_less_to_the_prior():
    now = with_priors(PRIOR_SD)
    sd = np.sqrt(np.diag(now))
    assert reliances(NAMES, now, PRIOR_SD, 10.0 * sd) == ()
    ((alone,), (less,)) = (reliances(NAMES, now, PRIOR_SD, given) for given in (None, 1.5 * sd))
    assert LEAST_WIDENING <= less.widening < alone.widening


EXACT = "length_mm = 0\nwidth_mm = 0\ndensity_kg_m3 = 0\n"  # everything but the thickness is exact
ONE = PLATE.replace("nu12 = [0.15, 0.4]\n", "")


def identified(plate, thickness, listed):
    """Result with the thickness known to this many mm and all else exactly, or everything as usual."""
    sd = "" if thickness is None else f"\n[plate.sd]\nthickness_mm = {thickness}\n{EXACT}"
    return cb.identify(parse_specimen(f"{plate}{sd}{listed}", "x"), seed=1)


@pytest.mark.slow
def test_one_modulus_is_known_as_well_as_noise_and_thickness_let_it_be():
    exact, scaled = (own_list(ONE, frequency_scale_sd=sd) for sd in (0.0, 0.004))
    only_noise = identified(ONE, 0.0, exact)
    others = identified(ONE, 0.03, exact), identified(ONE, 0.0, scaled)
    found, thick, scale = (result.constants["E1"] for result in (only_noise, *others))
    assert found.value == pytest.approx(69e9, rel=3e-4)  # f^2 ~ E: f to 0.07 %, E to 0.14 %
    assert found.sd / found.value == pytest.approx(2 * NOISE / 8**0.5, rel=0.08)
    # 1 % of thickness is 2 % of E, and 0.4 % of the scale 0.8 %
    assert thick.sd / thick.value == pytest.approx(np.hypot(0.02, 2 * NOISE / 8**0.5), rel=0.05)
    assert scale.sd / scale.value == pytest.approx(np.hypot(0.008, 2 * NOISE / 8**0.5), rel=0.05)
    for c in (found, thick, scale):
        assert (c.interval[1] - c.interval[0]) / c.sd == pytest.approx(2 * 1.96, rel=0.05)
    usual = identified(ONE, None, own_list(ONE)).constants["E1"]  # E ~ rho / h^2: 1 % of density, thickness
    assert usual.sd / usual.value == pytest.approx(np.sqrt(0.02**2 + 0.01**2), rel=0.05)
    assert "intervals contain noise and the data sheet (25 % assumed)." in only_noise.summary()


def test_a_constant_of_which_the_list_says_little_keeps_what_was_known_of_it():
    known = PLATE.replace("nu12 = 0.33\n", "nu12 = 0.33\n\n[material.sd]\nnu12 = 0.003\n", 1)
    found = identified(known, 0.0, own_list(known, relative_std=0.02)).constants["nu12"]
    assert (found.value, found.sd) == (pytest.approx(0.33, abs=0.002), pytest.approx(0.003, rel=0.1))


@pytest.mark.parametrize("thinner", [0.85, 0.6])
def test_a_fit_allows_for_a_thickness_of_which_little_is_known(thinner):
    found = identified(ONE, 0.75, own_list(ONE.replace("_mm = 3.0", f"_mm = {3.0 * thinner}")))
    assert found.estimate.rms < NOISE
    assert found.estimate.misfit == 1.0
    low, high = found.constants["E1"].interval
    assert low < 69e9 < high


EXAMPLE = (Path(__file__).parents[2] / "examples" / "panel.toml").read_text(encoding="utf-8")
TEXT = re.sub(r"\[plate\.sd\].*?(?=\[material\])", "", EXAMPLE, flags=re.DOTALL)
PANEL = parse_specimen(TEXT, "panel")
ONE_ANGLE = TEXT.replace('"[0_8]"', '"[?]"').replace("[unknowns]", "[unknowns]\nangle_grid_deg = 90.0")


@pytest.mark.slow
@pytest.mark.weekly
def test_identify_sample_sequence_and_diagnose_print_the_same_constants():
    answers = {verb.__name__: verb(PANEL, seed=3) for verb in (cb.sample, cb.diagnose)}
    answers["sequence"] = cb.sequence(parse_specimen(ONE_ANGLE, "panel"), seed=3)
    first = cb.identify(PANEL, seed=3).to_dict()["constants"]
    assert first["E1_GPa"]["sd"] > 0.02 * first["E1_GPa"]["value"]  # includes the thickness, known to 1 %
    for verb, answer in answers.items():
        for name, constant in answer.to_dict()["constants"].items():
            value, sd = first[name]["value"], first[name]["sd"]
            # 400 effective draws give a mean to 0.05 sd and an sd to 4 %; diagnose allows for causes too
            assert constant["mean"] == pytest.approx(value, abs=0.2 * sd), (verb, name)
            assert constant["sd"] == pytest.approx(sd, rel=0.12), (verb, name)


def tolerant_panel(n):
    values = reference_vector(PANEL, PANEL.unknowns)
    constants = dict(zip(PANEL.unknowns.names, values.tolist(), strict=True))
    own = tolerant(PANEL, reduced_model(PANEL, PANEL.unknowns, n), constants, np.arange(n))
    return own, np.array([*values, *(p.prior.mean for p in own.tolerances.parameters)])


def test_a_tolerant_model_predicts_the_plate_of_other_sizes():
    own, values = tolerant_panel(10)
    x = values[None]
    assert own.tolerances.names == ("thickness", "length", "width", "mass", FREQUENCY_SCALE)
    np.testing.assert_array_equal(own.predict(x).frequencies, own.model.predict(x[:, :4]).frequencies)
    factors = {"thickness": 1.01, "length": 0.998, "width": 1.002, "mass": 1.004}
    there = {name: getattr(PANEL.plate, name) * factor for name, factor in factors.items()}
    volume = there["thickness"] * there["length"] * there["width"]
    other = replace(PANEL, plate=replace(PANEL.plate, **there, density=there["mass"] / volume))
    expected = converged_model(other, other.unknowns, 10).predict(x[:, :4]).frequencies
    x[0, 4:] *= [*factors.values(), 1.0005]
    assert expected[0, 7] / expected[0, 6] < 1.005  # two modes that have changed places
    # changes of up to 2 %: second order, and the error of two solvers
    np.testing.assert_allclose(own.predict(x).frequencies, 1.0005 * expected, rtol=2e-4)


def test_derivatives_of_a_tolerant_model_are_those_of_its_predictions():
    own, values = tolerant_panel(4)
    x = values * np.where(np.arange(len(values)) < 4, 1.0, 1.003)
    slopes = own.predict(x[None], jacobian=True).jacobian[0] * x
    step = 1e-3 * np.diag(x)  # a tenth of it would drown in rounding of eigenvalues
    up, down = (own.predict(x + s * step).frequencies for s in (1.0, -1.0))
    np.testing.assert_allclose(slopes, (up - down).T / 2e-3, rtol=1e-3, atol=1e-6)


def test_a_narrowed_posterior_has_a_smaller_basis_that_errs_less_than_a_part_of_the_noise():
    n = PANEL.measurement.size
    own, middle = tolerant_panel(n)
    lists = (replace(PANEL.measurement, relative_std=sd, frequency_sd=None) for sd in (0.02, 1e-4))
    whole, exact = (plate_posterior(own, listed, np.zeros(n)) for listed in lists)
    x = middle * (1.0 + 0.002 * np.random.default_rng(0).uniform(-1.0, 1.0, (200, len(middle))))

    def sizes(posterior):
        return sum(block.size for block in posterior.model.model.fast.operator.blocks)

    narrow = narrowed(whole, x)
    assert sizes(narrow) < sizes(whole)
    assert np.abs(narrow.predict(x) / whole.predict(x) - 1.0).max() < 0.05 * 0.02  # paired by rank
    assert narrowed(exact, x) is exact, "its own basis is no better"


BEST_B1, WRONG_B1 = 13.062, 883.1  # F, Hz^2, and E1, GPa, of B1's best optimum and of a single swarm's


@pytest.mark.slow
@pytest.mark.parametrize(("several", "value"), [({"swarms": 1}, WRONG_B1), ({}, BEST_B1)])
def test_a_single_swarm_may_agree_on_a_wrong_optimum_and_several_do_not(several, value):
    found = cb.identify("B1", seed=1, residuals="absolute", **several)
    assert (found.status, found.estimate.swarm.value) == ("converged", pytest.approx(value, rel=1e-3))
    assert several or found.estimate.optima[0].swarms >= 2


def test_the_single_swarm_is_the_first_of_several_and_is_not_polished():
    one = search(builtin("A1"), 3, swarms=1)
    np.testing.assert_array_equal(one.optima[0].x, one.swarm.best)
    several = search(builtin("A1"), 3, swarms=12)
    np.testing.assert_array_equal(several.swarm.personal_bests, one.swarm.personal_bests)
    assert several.optima[0].value <= one.swarm.value
    with pytest.raises(ValueError, match="swarms: received 0, accepted: 1 or more"):
        cb.identify("A1", swarms=0)


def test_an_optimum_has_no_slope_where_no_bound_holds_it():
    found, (measurement, unknowns) = search(builtin("C1"), 0, swarms=12), searching.required(builtin("C1"))
    best, f = found.optima[0], measurement.frequencies

    def value(x):
        return searching.misfit(found.model.predict(x).frequencies[:, : len(f)], f, "absolute")[0]

    step = 1e-4 * (unknowns.upper - unknowns.lower)
    free = (best.x > unknowns.lower + step) & (best.x < unknowns.upper - step)
    assert free.any()
    for along in np.diag(step)[free]:
        around = value(best.x + along), value(best.x - along)
        assert min(around) >= best.value * (1.0 - 1e-9)
        assert abs(around[0] - around[1]) < 0.05 * (sum(around) - 2.0 * best.value)  # a central difference


def test_a_budget_of_swarms_that_agree_on_nothing_is_said(monkeypatch):
    alone = (Optimum(builtin("A1").unknowns.lower, 1.0, 1),)
    monkeypatch.setattr(searching, "_distinct", lambda *args: alone)
    found = search(builtin("A1"), 0, swarms=4)
    assert (found.swarms, found.swarm.status) == (4, "budget")
    assert "there may be a better one" in found.swarm.message


def test_constants_that_differ_between_optima_are_not_determined():
    result = cb.identify("B2", seed=0, residuals="absolute")
    (e1,) = (c for c in result.estimate.constants if c.name == "E1")
    assert len(result.optima) > 1
    assert e1.value / 1e9 == pytest.approx(53.2, rel=0.01)  # 53 GPa and 110 GPa have almost the same misfit
    assert any(v / 1e9 == pytest.approx(109.9, rel=0.01) for v in e1.elsewhere)
    assert e1.verdict is not Verdict.DATA
    document = result.to_dict()
    assert [o["found_by"] for o in document["optima"]] == [o.swarms for o, _ in result.optima]
    assert [o["objective"] for o in document["optima"]] == sorted(o["objective"] for o in document["optima"])
    assert document["optima"][0]["rms_percent"] == pytest.approx(document["rms_percent"], rel=1e-3)
    assert "optima" in result.figures()


@pytest.mark.slow
def test_constants_of_a_model_that_misfits_the_stated_noise_are_not_determined():
    """C1's printed frequencies leave 1.3 % whatever the constants."""
    c1 = builtin("C1")
    believed = replace(c1, measurement=replace(c1.measurement, relative_std=0.001))
    result, inferred = (cb.identify(specimen) for specimen in (believed, c1))
    point = result.estimate
    assert point.rms > 8 * 0.001
    assert {c.verdict for c in point.constants} <= {Verdict.MISFIT, Verdict.PRIOR}
    assert point.constants[0].verdict is Verdict.MISFIT
    assert "determine none of the constants" in result.summary()
    for stated, from_misfit in zip(point.constants, inferred.estimate.constants, strict=True):
        assert 0.5 < stated.sd / from_misfit.sd < 2.0


@pytest.mark.parametrize(("centre", "models"), [(None, 2), (builtin("A1").unknowns.upper, 1)])
def test_a_plate_model_is_converged_anew_where_that_helps_and_no_centre_is_given(monkeypatch, centre, models):
    said = []
    monkeypatch.setattr(searching, "discretisation_error", lambda full, x: np.full(full.n_modes, 1e-2))
    found = search(builtin("A1"), 0, swarms=12, centre=centre, notify=said.append)
    assert sum("converging the plate model there" in text for text in said) == models - 1
    if centre is not None:
        np.testing.assert_array_equal(found.centre, centre)


SETTINGS = EnsembleSettings(walkers=24, round_steps=500, effective=500.0)


@pytest.mark.slow
def test_of_exact_data_the_posterior_is_that_of_the_jacobian_about_the_truth_and_predicts_them():
    plate = known("A1", {})
    sampled = sample(plate, seed=0, settings=SETTINGS)
    assert sampled.result.status == "converged"
    constants = sampled.constants.values()
    for constant in constants:
        assert abs(constant.value - constant.reference) < 0.5 * constant.sd  # centred but for skewness
        assert constant.interval[0] < constant.reference < constant.interval[1]
        assert constant.verdict is Verdict.DATA
    truth = np.array([[c.reference for c in constants]])
    prediction = converged_model(plate, plate.unknowns, 6).predict(truth, jacobian=True)
    weighted = prediction.jacobian[0] / (NOISE * prediction.frequencies[0])[:, None]
    expected = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    np.testing.assert_allclose([c.sd for c in constants], expected, rtol=0.12)  # sampling 3 %, linearity 2 %
    # chi2_2 for the data (two constants), chi2_6 for a replicate list (six frequencies): P(chi2_6 > chi2_2) =
    # 1 - E[exp(-G)] = 1 - (1/2)^3, G = chi2_6 / 2 a Gamma(3) variable; 500 effective draws give it to 0.015
    assert sampled.p_value == pytest.approx(0.875, abs=0.05)


@pytest.mark.slow
def test_a_wrong_model_has_a_low_predictive_p_value():
    plate = known("A1", {})
    f = plate.measurement.frequencies * np.array([1.0, 1.02, 0.98, 1.02, 0.98, 1.02])
    wrong = replace(plate, measurement=replace(plate.measurement, frequencies=np.sort(f)))
    assert sample(wrong, seed=0, settings=SETTINGS).p_value < 0.01
