"""Errors of size, mass and frequency scale shift the constants as the theory of thin plates says."""

from __future__ import annotations

import pytest

import cpam_bayes as cb
from cpam_bayes.identification.identify import PointResult
from cpam_bayes.identification.scale_errors import ScaleError
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


@pytest.mark.parametrize(("name", "power"), [("thickness", 2.0), ("density", -1.0), ("frequency_scale", 2.0)])
def test_a_thin_plate_hides_thickness_density_and_frequency_scale_in_its_modulus(
    exact: PointResult, name: str, power: float
) -> None:
    # f^2 is proportional to E h^2 / rho; shear of a plate of 1/93 changes the power by less than 1 %
    found = error_of(exact, name)
    assert found.shift["E1"] == pytest.approx(power, rel=0.01)
    assert found.shift["nu12"] == pytest.approx(0.0, abs=0.02)
    assert found.visible < 0.02
    assert found.sd is None


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
    assert without.interval is not None
    assert with_spread.interval is not None
    assert with_spread.interval[0] < without.interval[0] < without.interval[1] < with_spread.interval[1]


def test_the_summary_says_what_no_frequency_shows_and_what_the_intervals_contain(
    exact: PointResult, gauged: PointResult
) -> None:
    basis = " ".join(exact.in_words().basis)
    assert (
        "The intervals contain no error of thickness, length, width, density or the analyser's frequency "
        "scale, which count as exact." in basis
    )
    assert "the constants take them up: 1 % of thickness moves E1 by" in basis
    assert any("give [plate.sd] with thickness_mm" in step for step in exact.in_words().next_steps)
    basis = " ".join(gauged.in_words().basis)
    assert (
        "The intervals contain the uncertainty of thickness (+- 0.06 mm); they contain no error of length, "
        "width, density or the analyser's frequency scale, which count as exact." in basis
    )
    assert "1 % of thickness" not in basis
    assert "1 % of density" in basis
