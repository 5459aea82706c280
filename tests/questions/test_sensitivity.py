"""`sensitivity`: a study with known numbers, its display, and the command for users and scripts."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parameters import ParameterSet, TruncatedNormal
from cpam_bayes.plate import builtin
from cpam_bayes.printed.noise_study import Cell, Repetition, Sensitivity, own_table, sensitivity_notices
from cpam_bayes.printed.repetition import Comparison, PosteriorSummary
from cpam_bayes.printed.tables import perturbation_table
from cpam_bayes.questions import sensitivity
from cpam_bayes.questions.sensitivity import SensitivityResult
from cpam_bayes.render.noise_study import ComparedRow, beside_paper, difference_sentences
from cpam_bayes.render.report import json_text
from tests.answers import CHAINS, answered
from tests.plate_file import MEASURED

# Results of two inversions, E1 in Pa and nu12: mean 71 GPa with an sd of 1.4142, 0.30 with 0.02828.
CONSTANTS = np.array([[70e9, 0.28], [72e9, 0.32]])
AGREE = Comparison(1e9, 0.5, 1.4, True, True, ())


def cell(level, reading, comparisons=(AGREE, AGREE)):
    on_bound = np.array([[False, True], [False, False]])
    counts = {"redrawn": 0, "converged": 2, "restarted": 1, "missed": 0, "solves": 100}
    repetition = Repetition(CONSTANTS, on_bound, lists=np.ones((2, 6)), reordered=0.5, **counts)
    values = {"mean": (70e9, 0.31), "sd": (1e9, 0.02), "q025": (68e9, 0.27), "q975": (72e9, 0.35)}
    values |= {"skewness": (0.1, -0.7), "contraction": (0.02, 0.6), "next_to_bound": (0.0, 0.12)}
    values |= {"peaks": (1, 1), "best": (69e9, 0.3), "linearised_sd": (1e9, 0.02), "swarm_sd": (1.5e9, 0.02)}
    of_each = {key: np.array(value) for key, value in values.items()}
    posterior = PosteriorSummary(**of_each, effective=1200.0, converged=True)
    return Cell(level, reading, np.full(6, 3.0), repetition, posterior, comparisons)


@pytest.fixture
def study():
    own = replace(answered("identify").estimate, specimen=builtin("A1"))  # bounds alone
    constants = zip(own.constants, (69.0e9, 0.33), strict=True)
    without_noise = replace(own, constants=tuple(replace(c, value=v) for c, v in constants), rms=0.001)
    cells = tuple(cell(level, reading) for level in (0.01, 0.05) for reading in ("relative", "rms"))
    return Sensitivity(own.specimen, "model", without_noise, 10, 5, cells, groups=2, seconds=12.0)


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
        assert (own["repetition_mean"], own["repetition_sd"]) == pytest.approx((71.0, 2**0.5))
        keys = ("posterior_mean", "posterior_sd", "linearised_posterior_sd")
        assert [own[key] for key in keys] == pytest.approx([70.0, 1.0, 1.0])
        errors = (own["percent_error"], own["percent_standard_error"])
        assert errors == pytest.approx((100 * (71 / 69 - 1), 100 / 69))
        assert own["paper_percent_error"] is None
        assert own["repetitions"] == pytest.approx([70.0, 72.0])
        assert level["constants"]["nu12"]["share_on_bound"] == 0.5
    assert (document["groups"], document["list"], document["paper"]) == (2, "model", None)
    assert document["without_noise"]["constants"]["nu12"]["value"] == 0.33


def test_the_paper_stands_beside_its_own_specimen_in_standard_errors_of_a_mean_of_ten(study):
    aluminium = replace(study, specimen=replace(study.specimen, name="A2", source="built-in A2"))
    table = own_table(aluminium.specimen)
    assert table is perturbation_table("A2")
    assert own_table(study.specimen) is own_table(replace(aluminium.specimen, source="A2.toml")) is None
    document = result(aluminium, table).to_dict()
    own = document["levels"][1]["constants"]["E1_GPa"]
    assert own["paper_percent_error"] == -3.1
    error = 100 * (2**0.5 / 10**0.5) / 69  # for ten, though there are two groups here
    assert own["paper_in_standard_errors"] == pytest.approx(-3.1 / error)
    assert document["paper"] == {"table": 10, "angles_deg": [], "contradictions": []}
    # E1: -1.7 and -3.1 over 0.648 %; nu12: 2.3 and 7.2 over 100 * 0.0283 / sqrt(10) / 0.33 = 2.71 %
    rms = ((1.7**2 + 3.1**2) / 0.6481**2 / 4 + (2.3**2 + 7.2**2) / 2.7104**2 / 4) ** 0.5
    said = " ".join(beside_paper(aluminium, table))
    smaller = "1 of 4 printed percentages are smaller than the standard error that a mean of ten"
    assert f"relative: {smaller}" in said
    assert f"in these units their rms is {rms:.1f}" in said
    for level, printed in ((0.02, ()), (0.05, ("-3.10", "+7.20"))):  # the paper lacks the first level
        shown = tables(result(with_cell(aluminium, cell(level, "rms")), table))
        (noise,) = (t for title, t in shown.items() if title.startswith("Noise"))
        at = [i for i, heading in enumerate(noise.headings) if heading == "paper %"]
        assert tuple(row[i] for i in at for row in noise.rows) == printed
    table = perturbation_table("D1")  # a contradiction in the print is reported
    d1 = replace(study, specimen=replace(study.specimen, name="D1", source="built-in D1"))
    found = beside_paper(d1, table)
    assert found[-1] == (
        "E2_GPa at 10 %: the printed 7.41 % does not follow from its row, whose amounts allow 4.9 to 6.0 %."
    )
    assert any("sought the ply angles too" in sentence for sentence in found)
    (own,) = result(d1, table).to_dict()["paper"]["contradictions"]
    assert (own["constant"], own["printed_percent"]) == ("E2_GPa", 7.41)


def tables(result):
    return {t.title: t for section in result.report().sections for t in section.tables}


def rows_of(study):
    return [ComparedRow(study, cell, i, None) for cell in study.cells for i in range(2)]


def test_the_first_screen_has_a_row_for_each_level_and_reading_and_flags_those_that_differ(study):
    summary = result(study).report().summary
    (table,) = summary.tables
    readings = ("of each frequency", "of the rms frequency")
    assert [row[:2] for row in table.rows] == [(level, of) for level in ("1 %", "5 %") for of in readings]
    # relative to 69 GPa: inversions 1.414, posterior 1; relative to 0.33: 0.02828 and 0.02
    assert [row[2:] for row in table.rows] == [("2.0 / 1.4", "8.6 / 6.1")] * 4
    assert "nu12 a standard deviation of 6.1 %" in summary.headline
    assert "8 of 8" in summary.lines[0]
    assert difference_sentences(rows_of(study)) == ()
    frame = result(study).to_dataframe()
    assert (len(frame), frame["repetition_mean"][0]) == (8, pytest.approx(71.0))
    differs = Comparison(0.02, -4.0, 2.5, False, True, ("bounds", "skewed"))
    flagged = result(with_cell(study, cell(0.05, "relative", (AGREE, differs))))
    (first,) = flagged.report().summary.tables
    assert (first.flagged, first.rows[0][-1]) == ({0}, "nu12")
    (table,) = (t for title, t in tables(flagged).items() if title.startswith("Noise 5 %"))
    assert table.flagged == {1}
    assert [row[-1] for row in table.rows] == ["agree", "differ: bounds, skewed"]


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
        ("misfit", "settle at constants 1.5 sd apart"),
        ("stopped", "the swarm stops 1.5 sd short of the optimum"),
        ("unexplained", "no measured cause explains it"),
    ],
)
def test_every_cause_is_told_with_its_number(study, cause, said):
    differs = Comparison(0.02, -4.0, 2.5, False, False, (cause,))
    (found,) = difference_sentences(rows_of(with_cell(study, cell(0.05, "rms", (AGREE, differs)))))
    begins = "5 % rms, nu12: means 4.0 standard errors apart and sd 2.5 times the posterior's"
    assert found.startswith(begins)
    assert said in found


def misfit(study):
    return replace(study, source="measured", without_noise=replace(study.without_noise, rms=0.02))


def lost(study):
    constants = tuple(replace(c, value=1.1 * c.value) for c in study.without_noise.constants)
    return replace(study, without_noise=replace(study.without_noise, constants=constants))


def cut_short(study):
    one = study.cells[0]
    short = replace(one.posterior, converged=False, effective=12.0)
    repeated = replace(one.repetition, converged=1, redrawn=3, missed=2)
    return with_cell(study, replace(one, posterior=short, repetition=repeated))


def with_more_in_its_file(study):
    own, prior = study.specimen, TruncatedNormal(0.33, 0.02, 0.15, 0.4)
    unknowns = ParameterSet(tuple(replace(p, prior=prior) for p in own.unknowns.parameters))
    labelled = replace(own.measurement, labels=("(1,1)", "", "", "", "", ""))
    gauged = replace(own.plate, sd={"thickness": 1e-5})
    given = replace(own, unknowns=unknowns, measurement=labelled, plate=gauged)
    return replace(study, source="measured", specimen=given)


AT = {"level": 0.01, "reading": "relative", "noise_sd": 3.0}
CUT_SHORT = {
    "inversions_missed": {**AT, "count": 2, "of": 2},
    "noise_chains": {**AT, "ess_bulk": 12.0},
    "noise_swarms": {**AT, "count": 1, "of": 2},
    "noise_redrawn": {**AT, "count": 3},
}
MORE = {"sizes_exact": {"names": ("thickness",)}, "labels_not_used": {}}
MORE |= {"prior_not_inverted": {"names": ("E1", "nu12")}}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda study: study, {}),
        (misfit, {"misfit_beside_noise": {"misfit": 0.02, "level": 0.01}}),
        (lambda study: replace(study, source="measured"), {}),
        (lost, {"constants_not_found_again": {"names": ("E1", "nu12")}}),
        (lambda study: replace(study, found_again=4), {"swarms_in_worse_optima": {"found": 4, "of": 10}}),
        (cut_short, CUT_SHORT),
        (with_more_in_its_file, MORE),
    ],
)
def test_what_a_study_cannot_be_trusted_for_is_a_warning(study, change, said):
    assert {notice.code: notice.facts for notice in sensitivity_notices(change(study))} == said


FEW = ("--groups", "3", "--executor", "serial", "--quiet")


@pytest.fixture
def hurried(monkeypatch):
    full = sensitivity.noise_study

    def shorten(**short):
        monkeypatch.setattr(sensitivity, "noise_study", lambda *args, **kw: full(*args, **kw | short))

    return shorten


@pytest.mark.slow
def test_a_plate_without_a_measurement_gets_the_answer_of_the_contract(run, plate_file, hurried):
    hurried(chains=replace(CHAINS, effective=200.0, most_steps=1500))
    asked = ("--levels", "1", "--modes", "6", "--json")
    status, out, err = run("sensitivity", plate_file((MEASURED, "")), *asked, *FEW)
    document = json.loads(out)
    assert (status, err, len(document["frequencies_hz"])) == (0, "", 6)
    (level,) = document["levels"]
    assert (level["level_percent"], level["reading"]) == (1.0, "relative")
    for reading in ("relative", "rms"):
        for name, truth in (("E1_GPa", 69.0), ("nu12", 0.33)):
            own = level["readings"][reading]["constants"][name]
            # three inversions at 1 %: within a few standard errors of a mean of three
            spread = max(own["repetition_sd"], own["posterior_sd"]) / np.sqrt(3)
            assert abs(own["repetition_mean"] - truth) < 5 * spread
            assert abs(own["posterior_mean"] - truth) < own["posterior_sd"]
            assert own["posterior_sd"] == pytest.approx(own["linearised_posterior_sd"], rel=0.25)


@pytest.mark.slow
def test_the_command_says_what_noise_was_added_to_and_gives_the_same_for_the_same_seed(
    run, plate_file, hurried
):
    chains = EnsembleSettings(walkers=12, round_steps=40, most_steps=40)
    hurried(chains=chains, swarm_settings=SwarmSettings(particles=10, iterations=30))
    asked = ("--reading", "rms", *FEW, "--levels", "5")
    of_list = ("sensitivity", plate_file(), *asked, "--json", "--list")
    measured, model = (json.loads(run(*of_list, of)[1]) for of in ("measured", "model"))
    assert (measured["list"], model["list"]) == ("measured", "model")
    assert measured["frequencies_hz"] == [114, 167, 218, 289, 300, 497] != model["frequencies_hz"]
    assert len(model["frequencies_hz"]) == 6
    argv = ("sensitivity", plate_file((MEASURED, "")), *asked, "--modes", "5")
    status, out, err = run(*argv, "--verbose")
    assert status == 1
    assert "did not converge within their budget" in err
    assert re.search(r"Noise 5 % of the rms frequency \(rms\), [\d.]+ Hz for all modes", out)
    assert "what the plate model gives at the reference constants" in out
    seeds = (("--seed", "3"), ("--levels", "5", "5.0", "--seed", "3"), ("--seed", "4"))  # levels are unique
    first, again, other = (json.loads(run(*argv, *more, "--json")[1]) for more in seeds)
    assert len(first["frequencies_hz"]) == 5
    assert [level["level_percent"] for level in first["levels"]] == [5.0]
    assert first == again | {"seconds": first["seconds"]}
    assert first["levels"] != other["levels"]
