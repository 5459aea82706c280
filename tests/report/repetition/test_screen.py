"""A noise study made of known numbers, shown."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.paper import perturbation_table
from cpam_bayes.parameters import ParameterSet, TruncatedNormal
from cpam_bayes.repetition.agreement import Comparison
from cpam_bayes.repetition.sensitivity import SensitivityResult
from cpam_bayes.repetition.study import Cell, Repetition, Sensitivity
from cpam_bayes.repetition.tasks import PosteriorSummary
from cpam_bayes.repetition.warnings import printed_table, sensitivity_warnings
from cpam_bayes.report.documents import json_text
from cpam_bayes.report.figures import save_figures
from cpam_bayes.report.repetition.figures import sensitivity_figures
from cpam_bayes.report.repetition.words import beside_paper, difference_sentences

# Means of two inversions, E1 in Pa and nu12: 71 GPa with an sd of 1.4142, 0.30 with 0.02828.
CONSTANTS = np.array([[70e9, 0.28], [72e9, 0.32]])
AGREE = Comparison(1e9, 0.5, 1.4, True, True, ())


def cell(level, reading, comparisons=(AGREE, AGREE)):
    repetition = Repetition(
        constants=CONSTANTS,
        on_bound=np.array([[False, True], [False, False]]),
        lists=np.ones((2, 6)),
        reordered=0.5,
        redrawn=0,
        converged=2,
        restarted=1,
        missed=0,
        solves=100,
    )
    posterior = PosteriorSummary(
        mean=np.array([70e9, 0.31]),
        sd=np.array([1e9, 0.02]),
        q025=np.array([68e9, 0.27]),
        q975=np.array([72e9, 0.35]),
        skewness=np.array([0.1, -0.7]),
        contraction=np.array([0.02, 0.6]),
        next_to_bound=np.array([0.0, 0.12]),
        peaks=np.array([1, 1]),
        best=np.array([69e9, 0.3]),
        linearised_sd=np.array([1e9, 0.02]),
        swarm_sd=np.array([1.5e9, 0.02]),
        effective=1200.0,
        converged=True,
    )
    return Cell(level, reading, np.full(6, 3.0), repetition, posterior, comparisons)


@pytest.fixture
def study(identification):
    constants = tuple(
        replace(c, value=value) for c, value in zip(identification.constants, (69.0e9, 0.33), strict=True)
    )
    without_noise = replace(identification, constants=constants, rms=0.001)
    cells = tuple(cell(level, reading) for level in (0.01, 0.05) for reading in ("relative", "rms"))
    return Sensitivity(
        specimen=identification.specimen,
        source="model",
        without_noise=without_noise,
        starts=10,
        found_again=5,
        cells=cells,
        groups=2,
        seconds=12.0,
    )


@pytest.fixture
def aluminium(study):
    """The study as if it were of A2, which Table 10 is about."""
    return replace(study, specimen=replace(study.specimen, name="A2", source="built-in A2"))


def result(study, table=None, seed=0):
    return SensitivityResult(seed=seed, specimen=study.specimen, study=study, table=table)


def with_cell(study, one):
    return replace(study, cells=(one,))


def test_the_document_has_the_keys_of_the_contract_in_the_units_of_the_names(study):
    document = json.loads(json_text(result(study, seed=3).to_dict()))
    assert [level["level_percent"] for level in document["levels"]] == [1.0, 5.0]
    for level in document["levels"]:
        assert set(level["readings"]) == {"relative", "rms"}
        assert level["constants"] == level["readings"]["relative"]["constants"]
        own = level["constants"]["E1_GPa"]
        assert own["repetition_mean"] == pytest.approx(71.0)
        assert own["repetition_sd"] == pytest.approx(2**0.5)
        assert own["posterior_mean"] == pytest.approx(70.0)
        assert own["posterior_sd"] == pytest.approx(1.0)
        assert own["paper_percent_error"] is None
        assert own["percent_error"] == pytest.approx(100 * (71 / 69 - 1))
        assert own["percent_standard_error"] == pytest.approx(100 / 69)
        assert own["repetitions"] == pytest.approx([70.0, 72.0])
        assert level["constants"]["nu12"]["share_on_bound"] == 0.5
    assert (document["groups"], document["list"], document["paper"]) == (2, "model", None)
    assert document["without_noise"]["constants"]["nu12"]["value"] == 0.33


def test_the_paper_stands_beside_its_own_specimen_only(study, aluminium):
    table = perturbation_table("A2")
    assert printed_table(aluminium, table) is table
    assert printed_table(study, table) is None
    other = replace(aluminium, specimen=replace(aluminium.specimen, source="A2.toml"))
    assert printed_table(other, table) is None
    assert printed_table(aluminium, None) is None


def test_printed_percentages_are_measured_in_standard_errors_of_a_mean_of_ten(aluminium):
    document = result(aluminium, perturbation_table("A2")).to_dict()
    own = document["levels"][1]["constants"]["E1_GPa"]
    assert own["paper_percent_error"] == -3.1
    error = 100 * (2**0.5 / 10**0.5) / 69  # of ten, though there are two groups here
    assert own["paper_in_standard_errors"] == pytest.approx(-3.1 / error)
    assert document["paper"] == {"table": 10, "angles_deg": [], "contradictions": []}
    # E1: -1.7 and -3.1 over 0.648 %; nu12: 2.3 and 7.2 over 100 * 0.0283 / sqrt(10) / 0.33 = 2.71 %
    rms = ((1.7**2 + 3.1**2) / 0.6481**2 / 4 + (2.3**2 + 7.2**2) / 2.7104**2 / 4) ** 0.5
    said = " ".join(beside_paper(aluminium, perturbation_table("A2")))
    assert (
        "relative: 1 of 4 printed percentages are smaller than the standard error that a mean of ten" in said
    )
    assert f"in these units their rms is {rms:.1f}" in said


def test_a_level_that_the_paper_lacks_has_no_column_of_it(aluminium):
    table = perturbation_table("A2")
    screen = result(with_cell(aluminium, cell(0.02, "rms")), table).tables()
    assert not any(column.heading == "paper %" for t in screen for column in t.columns)
    text = result(with_cell(aluminium, cell(0.05, "rms")), table).summary(verbose=True)
    assert "paper %" in text
    assert "-3.10" in text
    assert "+7.20" in text


def test_a_contradiction_in_print_is_said(study):
    table = perturbation_table("D1")
    d1 = replace(study, specimen=replace(study.specimen, name="D1", source="built-in D1"))
    found = beside_paper(d1, table)
    assert found[-1] == (
        "E2_GPa at 10 %: the printed 7.41 % does not follow from its row, whose amounts allow 4.9 to 6.0 %."
    )
    assert any("sought the ply angles too" in sentence for sentence in found)
    (own,) = result(d1, table).to_dict()["paper"]["contradictions"]
    assert (own["constant"], own["printed_percent"]) == ("E2_GPa", 7.41)


def test_agreement_is_said_in_one_sentence(study):
    assert difference_sentences(study) == (
        "Nowhere: all means and standard deviations agree within chance (1 % tests).",
    )


@pytest.mark.parametrize(
    ("cause", "said"),
    [
        ("missed", "the swarms of 0 of 2 lists missed the minimum of eq. (7)"),
        ("bounds", "1 of 2 inversions end on a bound, where 12 % of the posterior lies"),
        ("open", "the posterior's sd is 60 % of its prior's"),
        ("optima", "fall into separate groups"),
        ("skewed", "the posterior is skewed (-0.7)"),
        ("reordered", "in 50 % of the noisy lists modes have changed places"),
        ("weights", "widens the scatter 1.0 times to first order"),
        ("misfit", "settle at different constants, 1.5 sd apart"),
        ("stopped", "the swarm stops 1.5 sd short of the optimum"),
        ("unexplained", "no measured cause explains it"),
    ],
)
def test_every_cause_is_told_with_its_number(study, cause, said):
    differs = Comparison(0.02, -4.0, 2.5, False, False, (cause,))
    found = difference_sentences(with_cell(study, cell(0.05, "rms", (AGREE, differs))))
    assert len(found) == 1
    assert found[0].startswith(
        "5 % rms, nu12: means 4.0 standard errors apart and sd 2.5 times the posterior's"
    )
    assert said in found[0]


def test_rows_that_differ_are_flagged_and_say_so(study):
    differs = Comparison(0.02, -4.0, 2.5, False, True, ("bounds", "skewed"))
    screen = result(with_cell(study, cell(0.05, "relative", (AGREE, differs)))).tables()
    (table,) = (t for t in screen if t.title.startswith("Noise 5 %"))
    assert table.flagged == {1}
    assert table.rows[0][-1] == "agree"
    assert table.rows[1][-1] == "differ: bounds, skewed"


def test_a_list_that_the_model_misses_by_more_than_the_noise_is_a_warning(study):
    missed = replace(study, source="measured", without_noise=replace(study.without_noise, rms=0.02))
    (warning,) = sensitivity_warnings(missed)
    assert warning.startswith(
        "without any added noise the plate model misses this list by 2.0 % (rms), more than"
    )
    assert "1 %" in warning
    assert sensitivity_warnings(replace(study, source="measured")) == ()


def test_constants_that_the_swarm_does_not_find_again_are_a_warning(study):
    constants = tuple(replace(c, value=1.1 * c.value) for c in study.without_noise.constants)
    lost = replace(study, without_noise=replace(study.without_noise, constants=constants))
    assert "the swarm did not quite find E1, nu12 again" in sensitivity_warnings(lost)[0]
    assert sensitivity_warnings(study) == ()


def test_budgets_and_frequencies_drawn_again_are_warnings(study):
    one = study.cells[0]
    short = replace(one.posterior, converged=False, effective=12.0)
    repeated = replace(one.repetition, converged=1, redrawn=3, missed=2)
    found = sensitivity_warnings(with_cell(study, replace(one, posterior=short, repetition=repeated)))
    assert "on 2 of 2 lists no swarm came down to the value that the constants found without" in found[0]
    assert "used their budget before they converged, with 12 effective samples" in found[1]
    assert "1 of 2 swarms used their budget" in found[2]
    assert "3 noisy frequencies were not positive" in found[3]


def test_a_search_that_finds_the_best_constants_less_than_every_other_time_is_a_warning(study):
    (warning,) = sensitivity_warnings(replace(study, found_again=4))
    assert "only 4 of 10 swarms found the best constants" in warning
    assert sensitivity_warnings(replace(study, found_again=5)) == ()


def test_what_the_file_gives_and_the_study_leaves_aside_is_a_warning(study):
    own = study.specimen
    unknowns = ParameterSet(
        tuple(replace(p, prior=TruncatedNormal(0.33, 0.02, 0.15, 0.4)) for p in own.unknowns.parameters)
    )
    labelled = replace(own.measurement, labels=("(1,1)", "", "", "", "", ""))
    plate = replace(own.plate, sd={"thickness": 1e-5})
    given = replace(own, unknowns=unknowns, measurement=labelled, plate=plate)
    found = sensitivity_warnings(replace(study, source="measured", specimen=given))
    assert found[0] == "[plate.sd] is not used here: thickness_mm are taken as exact"
    assert "labels and shapes are not used here" in found[1]
    assert "mean and sd of E1, nu12 in [unknowns] enter the posterior alone" in found[2]


def test_pictures_are_the_same_every_time(aluminium, tmp_path):
    document = result(aluminium, perturbation_table("A2")).to_dict()
    written = []
    for name in ("first", "again"):
        (tmp_path / name).mkdir()
        save_figures(sensitivity_figures(document), tmp_path / name)
        written.append({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()})
    assert written[0] == written[1]
    assert set(written[0]) == {"sensitivity.png", "sensitivity.svg"}
