"""One prior for all verbs: the bounds of [unknowns] times the knowledge of the references."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.answer import Constant, Verdict
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.forward_model.model import ASSUMED_SD, assumed_spreads, constant_parameters, with_references
from cpam_bayes.parameters import TruncatedLogNormal, TruncatedNormal, Uniform
from cpam_bayes.plate import parse_specimen
from cpam_bayes.questions.identify.slips import pushed
from cpam_bayes.render.sentences import determined_text, references_said
from tests.diagnosed import diagnosed
from tests.plate_file import MEASURED, PLATE, SHEET, SHEET_SD, described

PANEL = str(Path(__file__).parents[2] / "examples" / "panel.toml")
# the constants of the panel's list
TRUTH = {"E1": 136.5e9, "E2": 8.8e9, "nu12": 0.32, "G12": 4.62e9}
SD = "\n[material.sd]\nE1_GPa = 2.0\n"


def plate(text=PLATE):
    return parse_specimen(text + MEASURED, "plate.toml")


@pytest.fixture(scope="module")
def point():
    return cb.identify(PANEL, seed=0)


@pytest.mark.slow
def test_identify_sample_and_diagnose_answer_alike_and_right_on_the_panel_of_the_readme(point):
    """Means and sds of n draws are accurate to 1 / sqrt(n) and 1 / sqrt(2 n) sd; three times for two answers.
    `identify` and emcee give at least 600 effective draws, the diagnosis as many as its weights."""
    sampled = cb.sample(PANEL, seed=0)
    diagnosis = diagnosed([plate_case(cb.read_plate(PANEL))], ["frequency_scale"], gain=False)
    error = (1.0 / 600.0 + 1.0 / diagnosis.weighed.none.marginal.effective_size) ** 0.5
    assert error < 0.07
    for name in TRUTH:
        answers = [(c.constants[name].value, c.constants[name].sd) for c in (point, sampled)]
        values, spreads = np.array([*answers, diagnosis.baseline.constants[name][:2]]).T
        assert np.ptp(values) < 3.0 * error * spreads.min(), name
        assert np.ptp(spreads) < 3.0 * error / 2.0**0.5 * spreads.min(), name
    for constants in (point.constants, sampled.constants, {c.name: c for c in point.estimate.alone}):
        for name, true in TRUTH.items():
            low, high = constants[name].interval
            assert low < true < high


def test_the_frequencies_alone_leave_open_what_the_data_sheet_decides(point):
    (alone,) = (c for c in point.estimate.alone if c.name == "nu12")
    found = point.constants["nu12"]
    assert alone.sd > 2.0 * found.sd
    assert type(alone.prior) is Uniform
    assert determined_text(found) == "not determined: the data sheet decides"
    for distance, said in ((1.9, "the data sheet decides"), (2.1, "far from the data sheet")):
        moved = replace(found, value=found.reference - distance * found.prior.sd)
        assert determined_text(moved) == f"not determined: {said}"
    assert "the data sheet." in point.summary()
    assert "from the frequencies alone" in point.summary(verbose=True)
    assert point.to_dict()["frequencies_alone"]["nu12"]["sd"] == pytest.approx(alone.sd)


def bounds(name):
    prior = plate().unknowns[name].prior
    return prior.lower, prior.upper


def test_a_reference_is_normal_as_stated_or_known_to_a_quarter_and_orthotropic_to_four_tenths():
    e1, nu12 = (p.prior for p in constant_parameters(plate(PLATE + SD)).parameters)
    assert e1 == TruncatedNormal(69e9, 2e9, *bounds("E1"))
    assert isinstance(nu12, TruncatedLogNormal)
    cut = constant_parameters(plate(PLATE + SD), 4.0)["E1"].prior
    assert (cut.lower, cut.upper) == (61e9, 77e9)
    assert ASSUMED_SD == {"isotropic": 0.25, "transversely_isotropic": 0.25, "orthotropic": 0.4}
    specimen = with_references(plate())
    assert specimen.unknowns["E1"].prior == TruncatedLogNormal(69e9, 0.25, *bounds("E1"))
    assert assumed_spreads(specimen) == {"E1": 0.25, "nu12": 0.25}
    said = {
        PLATE: "the data sheet (25 % assumed)",
        PLATE + SD: "the data sheet (25 % assumed for nu12)",
        f"{PLATE}{SD}nu12 = 0.01\n": "the data sheet",
    }
    for text, source in said.items():
        once = with_references(plate(text))
        assert references_said(once) == (source,)
        assert with_references(once).unknowns == once.unknowns, "a prior is made once"


@pytest.mark.parametrize(
    "changed",
    [
        PLATE.replace("[material]\n", "[material]\nknown = false\n") + SD,
        PLATE.replace("E1_GPa = 69.0", "E1_GPa = 950.0").replace("nu12 = 0.33\n", "nu12 = -0.1\n"),
    ],
    ids=["not known", "outside its bounds"],
)
def test_bounds_alone_count_where_nothing_is_known_of_a_reference(changed):
    specimen = plate(changed)
    assert constant_parameters(specimen) == specimen.unknowns
    assert references_said(with_references(specimen)) == ()


def test_a_normal_prior_of_unknowns_stays():
    low, high = bounds("E1")
    normal = f"{{ mean = 70.0, sd = 1.0, bounds = [{low / 1e9}, {high / 1e9}] }}"
    text = PLATE.replace(f"E1_GPa = [{low / 1e9}, {high / 1e9}]", f"E1_GPa = {normal}") + SD
    assert constant_parameters(plate(text))["E1"].prior == TruncatedNormal(70e9, 1e9, low, high)


def test_a_prior_that_counts_is_called_by_where_it_is_from():
    c = Constant("E1", 70e9, 1e9, (68e9, 72e9), TruncatedNormal(69e9, 2e9, 10e9, 200e9), 69e9, Verdict.BOTH)
    assert determined_text(c) == "partly, with the data sheet's 69 +- 2 GPa"
    assert determined_text(replace(c, reference=71e9)) == "partly, with prior 69 +- 2 GPa"
    assert determined_text(replace(c, verdict=Verdict.PRIOR, reference=71e9)) == "not determined"


def of_another_material(**changes):
    truth = {"E1_GPa": 55.0, "E2_GPa": 9.4, "nu12": 0.3, "G12_GPa": 4.7}
    sheet = {**SHEET, **changes}
    bounds = {"E1_GPa": [30.0, 200.0], "E2_GPa": [3.0, 20.0], "nu12": [0.1, 0.49], "G12_GPa": [1.5, 10]}
    plate = described((310.0, 228.0, 3.1), 1600.0, truth, layup="[0_8]", unknowns=bounds)
    del plate["plate"]["density_kg_m3"]  # it was weighed
    plate["plate"]["mass_g"] = 340.7
    noise = 1.0 + 0.002 * np.random.default_rng(0).standard_normal(10)
    listed = np.round(cb.forward(plate, 10).frequencies * noise, 2).tolist()
    measured = {"frequencies_hz": listed, "relative_std": 0.002}
    return {**plate, "material": {**sheet, "sd": {**SHEET_SD}}, "measurement": measured}


@pytest.mark.slow
def test_a_data_sheet_of_another_material_cuts_no_interval_and_is_named():
    """It is eight standard deviations away: there too the density of `identify` is that of emcee."""
    file = of_another_material()
    found, sampled = cb.identify(file, seed=0), cb.sample(file, seed=0)
    for name in ("E1", "E2", "G12"):
        a, b = found.constants[name], sampled.constants[name]
        assert abs(a.value - b.value) < 0.5 * b.sd, name
        assert a.sd == pytest.approx(b.sd, rel=0.25), name
    low, high = found.constants["E1"].interval
    assert 50e9 < low < high < 62e9
    for answer in (found, sampled):
        (notice,) = (n for n in answer.notices if n.code == "far_reference")
        assert [name for name, _ in notice.facts["distances"]] == ["E1"]
        assert -10.0 < notice.facts["distances"][0][1] < -7.0
        assert "E1 lies" in answer.summary()


@pytest.mark.slow
def test_where_the_prior_leaves_a_misfit_nothing_is_determined():
    """A data sheet known to 0.4 % keeps E1 away from the list."""
    file = of_another_material(E1_GPa=60.0)
    file["plate"]["sd"] = {"length_mm": 0.0, "width_mm": 0.0, "thickness_mm": 0.0, "mass_g": 0.0}
    free = cb.identify(file, seed=0)  # a spread large enough explains the list
    assert free.constants["E1"].is_determined
    assert not {"misfit_over_noise", "far_reference"} & {n.code for n in free.notices}
    file["material"]["sd"]["E1_GPa"] = 0.2
    held = cb.identify(file, seed=0)
    assert {"misfit_over_noise", "far_reference"} <= {n.code for n in held.notices}
    assert not any(c.is_determined for c in held.constants.values())


@pytest.mark.parametrize("ask", [cb.identify, pytest.param(cb.sample, marks=pytest.mark.slow)])
def test_a_bound_that_excludes_the_constant_is_said_first_and_widening_it_is_the_next_step(ask):
    """E1 is 70.8 GPa. The thickness stretches, so that the misfit is as small as the noise."""
    listed = [102.2, 110.2, 235.8, 263.5, 295.6, 351.9, 439.8, 508.4, 623.7, 703.1]
    tables = {"measurement": {"frequencies_hz": listed, "resolution_hz": 0.1, "relative_std": 0.001}}
    tables["unknowns"] = {"E1_GPa": [40.0, 62.0], "nu12": [0.2, 0.45]}
    sheet = {"isotropic": True, "E1_GPa": 60.0, "nu12": 0.33}
    answer = ask(described((310.0, 205.0, 2.0), 2700.0, sheet, **tables), seed=0)
    (notice,) = (n for n in answer.notices if n.code == "at_bound")
    assert notice.facts["bounds"] == (("E1", "upper", 62e9),)
    screen = answer.summary()
    assert screen.index("E1 lies at its upper bound, 62 GPa") < screen.index("frequencies determine")
    assert "not determined: at its upper bound" in screen
    assert "Next: widen the bounds of E1 in [unknowns], and ask again." in screen
    assert not any(line.endswith("  determined") for line in screen.splitlines())
    wide = replace(answer.constants["E1"], prior=Uniform(10e9, 1e13), bound="lower")
    assert pushed(wide).bound is None, "a hundredth of these bounds is more than E1"
