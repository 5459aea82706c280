"""Several lists in one identification: shared and individual parameters, and refusals."""

import pytest

import cpam_bayes as cb
from cpam_bayes.questions.identify import COMMAND
from tests.batches.plates import written
from tests.plate_file import described

MATERIAL = {"isotropic": True, "E1_GPa": 69.0, "nu12": 0.33, "name": "aluminium"}


def plate(name, specimen, edges="FFFF", stretch=1.0):
    unknowns = {"E1_GPa": [10.0, 200.0], "nu12": [0.15, 0.4]}
    table = described((300.0, 280.0, 3.0), 2700.0, MATERIAL, edges=edges, unknowns=unknowns)
    table |= {"name": name, "specimen": specimen}
    listed = (stretch * cb.forward(table, n_modes=6).frequencies).round(2).tolist()
    table["measurement"] = {"frequencies_hz": listed, "resolution_hz": 0.01, "relative_std": 0.002}
    return table


def wrong_edges():
    table = plate("clamped", "P", "CFFF")
    table["plate"]["edges"] = "FFFF"
    return table


@pytest.mark.slow
def test_two_tests_of_a_plate_give_its_constants_with_smaller_intervals_and_two_plates_smaller_ones():
    tests = cb.identify(plate("free", "P"), plate("clamped", "P", "CFFF"), seed=0)
    free = cb.identify(plate("free", "P"), seed=0, residuals="whitened").constants
    for name, truth in (("E1", 69e9), ("nu12", 0.33)):
        assert tests.constants[name].value == pytest.approx(truth, abs=0.3 * tests.constants[name].sd)
        assert tests.constants[name].sd < 1.02 * free[name].sd  # sampling gives an sd to 2 %
    assert tests.constants["nu12"].sd < 0.95 * free["nu12"].sd
    # E1 is as exact as the thickness: a second test repeats its error, a second plate has its own
    sisters = cb.identify(plate("free", "P"), plate("clamped", "Q", "CFFF"), seed=0, scatter=1e-4)
    assert sisters.constants["E1"].sd < 0.85 * tests.constants["E1"].sd
    document = tests.to_dict()
    assert (document["tests"], document["specimens"], len(document["frequencies"])) == (2, 1, 12)
    assert [p["plate"] for p in document["plates"]] == ["free", "clamped"]
    assert set(document["constants"]) == {"E1_GPa", "nu12"}


@pytest.mark.slow
def test_a_list_that_contradicts_the_other_is_named_and_widened():
    joint = cb.identify(plate("free", "P"), plate("clamped", "P", "CFFF", stretch=1.04), seed=0)
    assert "list_over_noise" in [notice.code for notice in joint.notices]


@pytest.mark.slow
def test_the_slip_of_one_list_is_named_with_its_corrected_file(tmp_path):
    files = [written(tmp_path / f"{p['name']}.toml", p) for p in (plate("free", "P"), wrong_edges())]
    for file in files:
        file.write_text(f'specimen = "P"\n{file.read_text(encoding="utf-8")}', encoding="utf-8")
    joint = cb.identify(*files, seed=0)
    assert [[slip.kind for slip in slips] for slips in joint.explained_by] == [[], ["clamped"]]
    (said,) = joint.slips
    assert said.startswith("clamped: the misfit is")
    assert "With the plate clamped at x = 0, not free (CFFF)" in said
    ((name, text),) = joint.texts().items()
    assert name == "corrected_2.toml"
    assert 'edges = "CFFF"' in text
    next_step = "correct the plate file of clamped, as in corrected_2.toml in the directory of --out."
    assert joint.report().summary.next_step == next_step
    assert [len(p["explained_by"]) for p in joint.to_dict()["plates"]] == [0, 1]


def test_a_noise_that_is_high_for_a_tap_test_is_named_with_its_list():
    scattered = plate("scattered", "Q")
    f = scattered["measurement"]["frequencies_hz"]
    scattered["measurement"]["frequencies_hz"] = [x * (1.02, 0.98)[i % 2] for i, x in enumerate(f)]
    del scattered["measurement"]["relative_std"]
    joint = cb.identify(plate("free", "P"), scattered, seed=0)
    (said,) = [notice for notice in joint.notices if notice.code == "high_noise"]
    assert said.facts["plate"] == "scattered"


@pytest.mark.slow
def test_a_file_that_contradicts_itself_is_named_before_anything_else():
    heavy = plate("heavy", "Q")
    heavy["plate"]["mass_g"] = 748.0  # instead of 680
    joint = cb.identify(plate("free", "P"), heavy, seed=0)
    first = joint.notices[0]
    assert (first.code, first.facts["plate"]) == ("thicknesses_apart", "heavy")
    assert joint.slips[0].startswith("Thickness, mass and density of heavy disagree")
    assert joint.report().summary.next_step.startswith("gauge and weigh the plate again")


@pytest.mark.slow
def test_a_list_of_unknown_noise_that_no_plate_of_its_file_has_is_named():
    wrong = wrong_edges()
    del wrong["measurement"]["relative_std"]
    joint = cb.identify(plate("free", "P"), wrong, seed=0)
    assert [len(slips) for slips in joint.explained_by] == [0, 1]
    (said,) = joint.slips
    assert said.startswith("The plate model does not describe the frequencies of clamped: its best fit is")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"unknowns": {"E1_GPa": [10.0, 200.0]}}, "the same .unknowns."),
        ({"material": {**MATERIAL, "name": "steel"}}, "of one material"),
        ({"name": "free"}, "one list counts once"),
    ],
)
def test_plates_that_share_no_constants_and_several_for_emcee_are_refused(change, said):
    first = plate("free", "P")
    with pytest.raises(ValueError, match=said):
        cb.identify(first, first | {"name": "other"} | change)
    with pytest.raises(ValueError, match="received 2 plates, accepted: one"):
        COMMAND.verb("A1", "A2", backend="emcee")
