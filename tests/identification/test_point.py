"""What else the data leave open beside noise: errors of sizes, and the priors of other constants."""

from __future__ import annotations

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.forward_model.known_errors import ScaleError
from cpam_bayes.identification.point import LEAST_WIDENING, reliances
from cpam_bayes.plate import parse_specimen
from cpam_bayes.questions.identify.pso import PointResult
from tests.plate_file import MEASURED, PLATE


def identified(tmp_path_factory: pytest.TempPathFactory, text: str) -> PointResult:
    path = tmp_path_factory.mktemp("plate") / "plate.toml"
    path.write_text(text, encoding="utf-8")
    return cb.identify(str(path), seed=1)


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> PointResult:
    return identified(tmp_path_factory, PLATE + MEASURED)


@pytest.fixture(scope="module")
def gauged(tmp_path_factory: pytest.TempPathFactory) -> PointResult:
    spread = "\n[plate.sd]\nthickness_mm = 0.06\n"
    return identified(tmp_path_factory, PLATE + spread + MEASURED)


def error_of(result: PointResult, name: str) -> ScaleError:
    (found,) = (e for e in result.estimate.scale_errors if e.name == name)
    return found


@pytest.mark.parametrize(
    ("name", "power"), [("thickness", -2.0), ("density", 1.0), ("frequency_scale", -2.0)]
)
def test_a_thin_plate_hides_thickness_density_and_frequency_scale_in_its_modulus(
    exact: PointResult, name: str, power: float
) -> None:
    # f^2 is proportional to E h^2 / rho; shear of a plate of 1/93 changes the power by less than 1 %
    found = error_of(exact, name)
    assert found.shift["E1"] == pytest.approx(power, rel=0.01)
    assert found.shift["nu12"] == pytest.approx(0.0, abs=0.02)
    assert found.visible < 0.02
    assert found.sd is None


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


def test_the_shape_of_a_plate_shows_in_its_frequencies(exact: PointResult) -> None:
    assert error_of(exact, "length").visible > 0.2


def test_the_interval_contains_the_stated_uncertainty_of_the_thickness(
    exact: PointResult, gauged: PointResult
) -> None:
    without, with_spread = (result.estimate.constants[0] for result in (exact, gauged))
    assert with_spread.value == pytest.approx(without.value, rel=1e-3)
    # 0.06 of 3 mm is 2 %, which moves E1 by 4 %
    added = (with_spread.sd**2 - without.sd**2) ** 0.5 / without.value
    assert added == pytest.approx(0.04, rel=0.02)
    assert with_spread.interval[0] < without.interval[0] < without.interval[1] < with_spread.interval[1]


NAMES = ("E1", "E2", "nu12")
PRIOR_SD = np.array([50.0, 1.0, 0.03])
# Frequencies of a cross-ply: they determine E1 + E2, and nothing of nu12.
SUM = np.array([[1.0, 1.0, 0.0]]) / 0.5


def posterior(prior_sd: np.ndarray) -> np.ndarray:
    return np.linalg.inv(SUM.T @ SUM + np.diag(prior_sd**-2.0))


def test_the_widening_is_that_of_the_posterior_with_a_prior_of_twice_the_width() -> None:
    now = posterior(PRIOR_SD)
    found = {(r.name, r.on): r.widening for r in reliances(NAMES, now, PRIOR_SD)}
    then = posterior(PRIOR_SD * np.array([1.0, 2.0, 1.0]))
    expected = np.sqrt(then[0, 0] / now[0, 0]) - 1.0
    assert expected > 0.5
    assert found == {("E1", "E2"): pytest.approx(expected, rel=1e-9)}


def test_a_constant_that_the_data_determine_feeds_no_other() -> None:
    both = np.diag([1.0, 0.01, 1e-6])
    both[0, 1] = both[1, 0] = 0.9 * np.sqrt(both[0, 0] * both[1, 1])
    assert reliances(NAMES, both, PRIOR_SD) == ()


def test_what_else_widens_an_interval_leaves_less_to_the_prior() -> None:
    now = posterior(PRIOR_SD)
    wide = np.sqrt(np.diag(now)) * 10.0
    assert reliances(NAMES, now, PRIOR_SD, wide) == ()
    ((alone,), (less,)) = (reliances(NAMES, now, PRIOR_SD, sd) for sd in (None, np.sqrt(np.diag(now)) * 1.5))
    assert LEAST_WIDENING <= less.widening < alone.widening


def test_a_covariance_that_is_not_known_says_nothing() -> None:
    assert reliances(NAMES, np.full((3, 3), np.nan), PRIOR_SD) == ()
