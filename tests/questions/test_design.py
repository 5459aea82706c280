"""Expected information of a list: closed forms, known physics, the swarm's own spread, refusals."""

import numpy as np
import pytest
from scipy.optimize import brentq

import cpam_bayes as cb
from cpam_bayes.answer import Verdict
from cpam_bayes.effects import scale_of
from cpam_bayes.effects.edges import CLAMP_ROTATION
from cpam_bayes.identification import specimen_design as designs
from cpam_bayes.identification.point import linearised_covariance
from cpam_bayes.identification.specimen_design import Test, expected_information, response_of
from tests.plate_file import described

EXACT = dict.fromkeys(("length_mm", "width_mm", "thickness_mm", "density_kg_m3"), 0.0)
LAMINA = {"E1_GPa": 121.0, "E2_GPa": 9.3, "nu12": 0.28, "G12_GPa": 6.0}
BOUNDS = {"E1_GPa": [80, 160], "E2_GPa": [5, 14], "nu12": [0.15, 0.45], "G12_GPa": [3, 9]}
CARBON = described((200.0, 200.0, 1.0), 1590.0, LAMINA, layup="[0_8]", unknowns=BOUNDS)
METAL = {"isotropic": True, "E1_GPa": 69.0, "nu12": 0.33, "known": False}
OPEN = {"E1_GPa": [60.0, 80.0], "nu12": [0.25, 0.4]}
SUPPORTED = described((300.0, 200.0, 0.8), 2700.0, METAL, edges="SSSS", unknowns=OPEN)
for of_plate in (CARBON, SUPPORTED):
    of_plate["plate"]["sd"] = EXACT
NOT_EXACT = {key: value for key, value in CARBON["plate"].items() if key != "sd"}


def test_a_supported_plate_gives_the_information_of_its_closed_form():
    """All its modes scale with E / (1 - nu^2): n of them are one number known n^(1/2) times better."""
    n, std, e, nu = 5, 0.004, 69.0, 0.33
    result = cb.design(SUPPORTED, layups=["[0]"], ratios=[1.5], edges=["SSSS"], modes=[n], relative_std=std)
    (candidate,) = result.candidates
    prior = np.array([20.0, 0.15]) / np.sqrt(12.0)
    slope = np.array([0.5 / e, nu / (1.0 - nu**2)])  # d log f
    precision = n / std**2 * np.outer(slope, slope) + np.diag(prior**-2.0)
    expected = 0.5 * np.log(1.0 + n / std**2 * np.sum((slope * prior) ** 2))
    # shear and rotary inertia of a plate of 1/250 change the slopes by less than 0.1 %
    assert candidate.information == pytest.approx(expected, rel=2e-3)
    sd = np.sqrt(np.diagonal(np.linalg.inv(precision)))
    np.testing.assert_allclose(candidate.expected.sd * [1e-9, 1.0], sd, rtol=2e-3)
    assert result.verdicts(candidate)["nu12"] is Verdict.PRIOR


def test_information_is_of_a_normal_posterior_with_the_standard_deviations_of_the_swarm():
    specimen = cb.read_plate(CARBON)  # information about some constants, the others integrated out
    prior = np.array([p.prior.sd for p in specimen.unknowns.parameters])
    response, test = response_of(cb.read_plate({**CARBON, "plate": NOT_EXACT}), 8), Test(0.002, 0.0)
    every = expected_information(response, 8, test, prior, np.ones(4, bool))
    alone = [expected_information(response, 8, test, prior, np.arange(4) == k) for k in range(4)]
    np.testing.assert_allclose([a.information for a in alone], every.each, rtol=1e-12)
    np.testing.assert_allclose(every.sd, prior * np.exp(-every.each), rtol=1e-12)
    f, s, common = response.frequencies, response.slopes[:, :4], response.slopes[:, 4:]
    assert common.shape[1] > 1
    covariance = np.diag(f**2 * (0.002**2 + response.error**2)) + common @ common.T
    log_det = np.linalg.slogdet(s.T @ np.linalg.solve(covariance, s) + np.eye(4))[1]
    assert every.information == pytest.approx(0.5 * log_det, rel=1e-9)
    response = response_of(specimen, 8)  # the standard deviations are those of the swarm for a list that fits
    found = expected_information(response, 8, Test(0.003, 0.0), prior, np.ones(4, bool)).sd
    listed = {"frequencies_hz": response.frequencies.tolist(), "relative_std": 0.003}
    measurement = cb.read_plate({**CARBON, "measurement": listed}).measurement
    swarm = linearised_covariance(response.slopes[:, :4] / prior, prior, measurement, 0.003, "relative")
    np.testing.assert_allclose(found, np.sqrt(np.diag(swarm)), rtol=2e-3)  # the solver's error is in one


def test_more_modes_and_less_noise_never_say_less():
    response, every = response_of(cb.read_plate(CARBON), 12), np.ones(4, bool)
    noisy, quiet = (
        [
            expected_information(response, n, Test(std, 0.5), np.ones(4), every).information
            for n in (2, 5, 9, 12)
        ]
        for std in (0.01, 0.003)
    )
    assert (noisy, quiet) == (sorted(noisy), sorted(quiet))
    assert all(less < more for less, more in zip(noisy, quiet, strict=True))


def test_nu12_shows_most_where_the_bending_modes_along_and_across_the_fibres_meet():
    """Length / width = (E1 / E2)^(1/4), here 1.90: the Poisson plate of Sol (1986)."""
    only = {"layups": ["[0_8]"], "edges": ["FFFF"], "modes": [5], "relative_std": 0.002}
    candidates = cb.design(CARBON, constants=["nu12"], ratios=[1.0, 1.4, 1.9, 2.6, 3.6], **only).candidates
    assert candidates[0].geometry.ratio == pytest.approx((121.0 / 9.3) ** 0.25, rel=0.02)
    assert candidates[0].information > 3.0 * candidates[-1].information


def test_a_thickness_that_is_not_known_well_takes_its_share_and_so_does_a_clamp_that_gives():
    uncertain = {**CARBON, "plate": {**CARBON["plate"], "sd": {**EXACT, "thickness_mm": 0.02}}}
    only = {"layups": ["[0_8]"], "ratios": [1.0], "edges": ["FFFF"], "modes": [8], "relative_std": 0.001}
    ((exact,), (blurred,)) = (cb.design(plate, **only).candidates for plate in (CARBON, uncertain))
    expected = np.hypot(0.04, exact.expected.sd[0] / 121e9)  # E1 ~ h^2, and h is known to 2 %
    assert blurred.expected.sd[0] / 121e9 == pytest.approx(expected, rel=0.1)
    assert blurred.information < exact.information
    several = cb.design(CARBON, **only | {"edges": ["FFFF", "CFFF"], "modes": [10], "relative_std": 0.002})
    assert next(c.geometry for c in several.candidates if c.geometry.ratio == 1.0).edges == "FFFF"


def test_a_clamp_is_taken_to_give_as_much_as_a_beam_on_a_spring():
    """1 + cos b cosh b = c b (sin b cosh b - cos b sinh b), E I / (c a) at the root; here D / (c a)."""
    cantilever = {**SUPPORTED["plate"], "length_mm": 400.0, "width_mm": 12.0, "edges": "CFFF"}
    response = response_of(cb.read_plate({**SUPPORTED, "plate": cantilever}), 1)

    def residual(b, c):
        spring = np.sin(b) * np.cosh(b) - np.cos(b) * np.sinh(b)
        return float(1.0 + np.cos(b) * np.cosh(b) - c * b * spring)

    c = scale_of(CLAMP_ROTATION.parameters[0]) * (1.0 - 0.33**2)
    held, clamped = (brentq(residual, 1.5, 2.0, args=(each,)) for each in (c, 0.0))
    expected = 2.0 * np.log(held / clamped)
    shifts = response.slopes[0, 2:] / response.frequencies[0]
    assert np.abs(shifts - expected).min() < 0.03 * abs(expected)


def test_specimens_have_one_area_and_their_mass_follows_the_volume():
    plate = {key: value for key, value in NOT_EXACT.items() if key != "density_kg_m3"} | {"mass_g": 60.0}
    sensor = [{"mass_g": 1.0, "x_mm": 50.0, "y_mm": 150.0}]
    specimen = cb.read_plate({**CARBON, "plate": plate, "sensor": sensor})
    found = designs.geometries(specimen, ratios=[0.5, 2.0], thicknesses_mm=[1.0, 2.0], edges=["FFFF"])
    assert sum(g.is_present for g in found) == 1
    for g in found:
        made = designs.specimen_of(specimen, g)
        assert made.plate.area == pytest.approx(0.04)
        assert made.plate.mass == pytest.approx(0.06 * g.thickness / 1e-3)
        assert made.plate.density == pytest.approx(specimen.plate.density)
        (sensor,) = made.sensors
        assert (sensor.x / g.length, sensor.y / g.width) == pytest.approx((0.25, 0.75))
    texts = {g.layup.text for g in found}
    assert texts == {"[0_8]", "[(0/90)_2]_s", "[(45/-45)_2]_s", "[0/45/-45/90]_s"}


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_answer():
    only = {"ratios": [1.0, 1.5], "edges": ["CFFF"], "modes": [4, 6]}
    here, there = cb.design("A1", **only), cb.design("A1", **only, executor="processes", workers=2)
    assert {**here.to_dict(), "seconds": 0} == {**there.to_dict(), "seconds": 0}
    # the plate as it is appears among the candidates with its number of modes
    (present,) = (candidate for candidate in here.to_dict()["candidates"] if candidate["is_present"])
    assert (present["length_mm"], present["edges"], present["modes"]) == (300.0, "FFFF", 6)
