"""Slips that ruin an answer are found, and correct plates are left alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model import preconditions
from cpam_bayes.forward_model.preconditions import common_factor_slips, likely_cure, require_reachable
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.reader import builtin, parse_specimen
from cpam_bayes.questions.plates import plates
from cpam_bayes.render.notices import sentence_of
from tests.plates import with_plate

BUILTIN = [s.name for s in plates().specimens]


def scaled(specimen: Specimen, factor: float, **changes: object) -> Specimen:
    frequencies = {"frequencies": factor * specimen.measurement.frequencies}
    return replace(specimen, measurement=replace(specimen.measurement, **frequencies | changes))


@pytest.mark.parametrize("name", BUILTIN)
def test_every_specimen_of_the_paper_is_within_reach_with_its_angles_known_or_not(name: str) -> None:
    specimen = builtin(name)
    assert require_reachable(specimen) is specimen
    require_reachable(specimen.with_unknown_angles())
    assert preconditions.reference_slips(specimen) == ()
    first, *others = specimen.measurement.frequencies  # half of f_1: bounds include a quarter of E
    require_reachable(scaled(specimen, 1.0, frequencies=np.array([0.5 * first, *others])))


def test_a_list_that_may_lack_its_first_modes_is_given_the_benefit_of_the_doubt() -> None:
    far = scaled(builtin("A1"), 10.0, complete=False)
    assert require_reachable(far) is far
    for complete, factor in ((True, 10.0), (False, 1e-3)):
        with pytest.raises(PlateFileError):
            require_reachable(scaled(builtin("A1"), factor, complete=complete))


@pytest.mark.parametrize("weighed", [True, False])
@pytest.mark.parametrize(
    ("factor", "said"),
    [
        *((1e-3, "frequencies in kHz for Hz"), (1e3, "frequencies in mHz for Hz")),
        *((factor, "decimal commas that were lost") for factor in (10.0, 100.0)),
        (1.0 / 31.6, "a mass in kg for g"),
    ],
)
def test_slips_of_units_and_lost_commas_are_named(weighed: bool, factor: float, said: str) -> None:
    for constants in (0.9, 1.1):  # relative to their reference
        assert said in likely_cure(constants / factor, weighed=weighed)
    assert "check the units" in likely_cure(3.5, weighed=weighed)  # a ratio that no unit explains
    assert "likely slip" not in likely_cure(3.5, weighed=weighed)


@pytest.mark.parametrize(("name", "weighed"), [("A1", False), ("C1", False), ("C1", True)])
@pytest.mark.parametrize(("factor", "said"), [(0.1, "10 times too small"), (10.0, "10 times too large")])
def test_a_thickness_ten_times_off_is_among_the_likely_slips(name: str, weighed: bool, factor, said) -> None:
    plate = builtin(name).plate  # if weighed, the density scales with 1 / h, a frequency with h^1.5, not h
    of_weighed = {"mass": 0.344, "density": plate.density / factor} if weighed else {}
    with pytest.raises(PlateFileError, match=f"a thickness {said}"):
        require_reachable(with_plate(name, thickness=factor * plate.thickness, **of_weighed))


@pytest.mark.parametrize("name", ["A1", "C1"])
@pytest.mark.parametrize("low", [(3.1,), (3.1, 4.2)])
def test_frequencies_below_any_of_the_plate_are_refused_as_motion_on_its_support(name: str, low) -> None:
    listed = np.concatenate((low, builtin(name).measurement.frequencies))
    with_them = scaled(builtin(name), 1.0, frequencies=listed, labels=("",) * len(listed))
    many = "first frequency" if len(low) == 1 else f"first {len(low)} frequencies"
    with pytest.raises(PlateFileError, match=f"3.1.* Hz, where .*the {many} of .* rigid body on its support"):
        require_reachable(with_them)


def test_fewer_frequencies_than_unknowns_and_a_misfit_above_three_percent_are_slips() -> None:
    for right in (preconditions.count_slips(6, 4), preconditions.count_slips(4, 4)):
        assert right == preconditions.misfit_slips(0.029) == ()
    few, misfit = preconditions.count_slips(3, 4), preconditions.misfit_slips(0.031)
    assert len(few) == len(misfit) == 1
    assert preconditions.contradicts_list(misfit)
    assert not preconditions.contradicts_list(few)


@pytest.mark.parametrize(("apart", "found"), [(0.0, 1), (1e-3, 1), (0.02, 0)])
def test_nearly_equal_lists_are_one_measurement(apart: float, found: int) -> None:
    first = builtin("A1")
    slips = preconditions.equal_list_slips([first, replace(scaled(first, 1.0 + apart), name="A1 again")])
    assert [slip.facts["plates"] for slip in slips] == [("A1", "A1 again")] * found
    five = scaled(first, 1.0, frequencies=first.measurement.frequencies[:5], labels=("",) * 5)
    assert preconditions.equal_list_slips([first, five]) == ()


@pytest.mark.parametrize(("level", "found"), [(None, 0), (0.03, 0), (0.04, 1), (0.2, 1)])
@pytest.mark.parametrize("each", [False, True])
def test_a_stated_noise_that_no_tap_test_has_is_a_slip(level: float | None, found: int, each: bool) -> None:
    sd = level * builtin("A1").measurement.frequencies if each and level else None
    given = scaled(builtin("A1"), 1.0, relative_std=None if each else level, frequency_sd=sd)
    slips = preconditions.stated_slips(given)
    assert [slip.facts["noise"] for slip in slips] == [pytest.approx(level)] * found
    assert all(("source" in slip.facts) == each for slip in slips)


def panel(density: float) -> Specimen:
    """README's panel, gauged 3.1 +- 0.02 mm, with its data sheet's density too, known to 1 %."""
    text = (Path(__file__).parents[2] / "examples" / "panel.toml").read_text("utf-8")
    text = text.replace("mass_g = 340.7", f"density_kg_m3 = {density}\nmass_g = 340.7")
    return parse_specimen(text, "panel.toml")


def test_a_mass_and_a_density_that_are_not_those_of_the_thickness_are_a_slip() -> None:
    # 340.7 g, 310 x 228 mm and 1480 kg/m3 give 3.257 mm; sides are known to 0.1 %, the density to 1 %
    by_mass, sd = 3.2569, 3.2569 * np.sqrt(0.01**2 + 2 * 0.001**2 + (0.1 / 340.7) ** 2)
    apart = (by_mass - 3.1) / np.hypot(sd, 0.02)
    (slip,) = preconditions.stated_slips(panel(1480.0))
    assert slip.facts["apart"] == pytest.approx(apart, abs=0.005)
    assert slip.facts["by_mass"] == pytest.approx((1e-3 * by_mass, 1e-3 * sd), rel=2e-3)
    plate = panel(1480.0).plate
    weight = sd**2 / (sd**2 + 0.02**2)
    assert plate.thickness == pytest.approx(1e-3 * (weight * 3.1 + (1 - weight) * by_mass), rel=1e-4)
    assert plate.sd["thickness"] == pytest.approx(0.02e-3 * np.sqrt(weight) * apart, rel=2e-3)
    assert preconditions.stated_slips(panel(1555.0)) == ()
    assert panel(1555.0).plate.sd["thickness"] < 0.02e-3


def test_of_a_file_that_contradicts_itself_no_slip_of_units_is_guessed() -> None:
    wrong, right = panel(7750.0), panel(1555.0)  # five times the density implied by mass and thickness
    said = r"3.10 mm, where mass over density is 0.622 mm, .* gauge"
    with pytest.raises(PlateFileError, match=said) as told:
        require_reachable(wrong)
    assert "likely slip" not in str(told.value)
    with pytest.raises(PlateFileError, match="gauge and weigh the plate again"):  # nor a false first mode
        require_reachable(replace(wrong, plate=replace(wrong.plate, thickness=31e-3)))
    ratio = np.full(3, 0.16)
    assert preconditions.units_notices(ratio, wrong.plate) == ()
    assert [notice.code for notice in preconditions.units_notices(ratio, right.plate)] == ["units"]
    reference = {"E1": (0.5 * right.material.constants["E1"], 1e9)}
    assert [len(common_factor_slips(one, reference)) for one in (wrong, right)] == [0, 1]


def moduli_of_c1(factor: float, **changes: float) -> dict[str, tuple[float, float]]:
    constants = builtin("C1").material.constants
    factors = {name: changes.get(name, factor) for name in ("E1", "E2", "G12")}
    return {name: (f * constants[name], 0.01 * constants[name]) for name, f in factors.items()}


def test_moduli_with_one_factor_in_common_are_a_wrong_size_mass_or_scale() -> None:
    specimen = builtin("C1")  # thickness 3.2 mm, a density, [material.sd] of 10 %
    (slip,) = common_factor_slips(specimen, moduli_of_c1(0.5))
    assert slip.facts["ratio"] == pytest.approx(0.5)
    assert all(distance < 0.0 for _, distance in slip.facts["distances"])
    said = sentence_of(slip)  # f^2 ~ E h^2 / rho: half of E is h or f over the root of 2, or twice rho
    for part in ("2.26 mm instead of 3.2 mm", "a density 2.00 times", "0.707 times too high"):
        assert part in said
    assert "a mass left on the plate" in said
    (slip,) = common_factor_slips(with_plate("C1", mass=0.344), moduli_of_c1(2.0))
    said = sentence_of(slip)  # if weighed, f^2 ~ E h^3 / m, and nothing attached makes a plate stiffer
    assert "4.03 mm instead of 3.2 mm" in said
    assert "a mass 0.500 times" in said
    assert "left on the plate" not in said


def test_moduli_that_one_batch_may_have_and_references_of_unknown_spread_tell_nothing_of_a_scale() -> None:
    specimen = builtin("C1")
    for changes in ({"E2": 1.1}, {"E2": 1.5}, {"E1": 0.71, "E2": 0.71, "G12": 0.71}):
        assert common_factor_slips(specimen, moduli_of_c1(0.5, **changes)) == ()
    unknown = replace(specimen, material=replace(specimen.material, sd={}))
    assert common_factor_slips(unknown, moduli_of_c1(0.5)) == ()
    assert common_factor_slips(specimen, {"nu12": (0.05, 0.001)}) == ()
    (slip,) = common_factor_slips(specimen, {"E1": (60e9, 1e9)})
    assert [name for name, _ in slip.facts["distances"]] == ["E1"]
    (slip,) = common_factor_slips(specimen, moduli_of_c1(0.5, E2=0.3))  # different factors: no single size
    assert slip.facts["ratio"] is None
    assert "check thickness, density" in sentence_of(slip)
