"""`report` as a user sees it: one page with all answers about a plate, and the files of its parts."""

import json
from dataclasses import replace
from functools import partial

import pytest

import cpam_bayes as cb
from cpam_bayes.plate.stored_posterior import read_posterior
from cpam_bayes.questions import report as combined
from cpam_bayes.questions.identify import answered
from cpam_bayes.questions.sequence import stacking_result
from tests.answers import answered as computed
from tests.stacking.cases import TRUE, answer, mixture, specimen

MAX_BYTES = 5_000_000
pytestmark = pytest.mark.slow


def test_a_quick_report_is_one_page_with_the_files_of_its_parts(run, plate_file, few_causes, tmp_path):
    out = tmp_path / "out"
    status, shown, _ = run("report", plate_file(), "--quick", "--json", "--quiet", "--out", out)
    document = json.loads(shown)
    assert (status, document["command"], document["quick"], document["stacking"]) == (0, "report", True, None)
    identified = document["identification"]
    assert identified["backend"] == "pso"
    for name, part in {"identify": identified, "diagnose": document["diagnosis"]}.items():
        assert json.loads((out / f"{name}.json").read_text("utf-8")) == part
    page = (out / "report.html").read_text("utf-8")
    assert len(page.encode()) <= MAX_BYTES
    drawn = {path.stem for path in (out / "figures").glob("*.png")}
    assert {"plate", "identify_residuals", "identify_modes", "diagnose_causes"} <= drawn
    assert (page.count("<h1>"), page.count("<img ")) == (1, len(drawn))
    constants = read_posterior(out / "posterior.nc").constants
    assert constants == tuple(name.removesuffix("_GPa") for name in identified["constants"])


def test_the_answer_is_the_diagnosis_and_the_frequencies_alone_are_folded():
    result = computed("report")
    report, diagnosis = result.report(), result.diagnosis.report().summary
    alone = set(result.identification.report().summary.tables)
    assert (report.summary.headline, report.summary.tables) == (diagnosis.headline, diagnosis.tables)
    assert not alone & {t for s in report.sections if not s.folded for t in s.tables}
    (folded,) = (s for s in report.sections if alone <= set(s.tables))
    assert folded.folded
    assert next(figure for section in report.sections for figure in section.figures) == "plate"
    assert len(set(result.warnings)) == len(result.warnings)


def test_the_answer_of_all_frequencies_stands_beside_that_of_those_that_were_used(plate_file, few_causes):
    plate = cb.read_plate(plate_file())
    used = plate.measurement.without({plate.measurement.size - 1})
    result, everything = cb.report(replace(plate, measurement=used), quick=True), cb.identify(plate)
    section = next(s for s in result.report().sections if s.title == "Frequencies left out by hand")
    assert not section.folded
    both = [of.report().summary.tables[0].rows for of in (everything, result.identification)]
    assert [table.rows for table in section.tables[1:]] == both
    assert result.to_dict()["all_rows"]["constants"] == everything.to_dict()["constants"]


@pytest.mark.weekly
def test_unknown_angles_are_weighed_and_the_most_probable_ones_diagnosed(few_causes, monkeypatch, tmp_path):
    found = stacking_result(answer(), mixture(), None, 0, 5)
    monkeypatch.setattr(combined, "sequence", lambda *args, **kwargs: found)
    monkeypatch.setattr(combined, "answered", partial(answered, steps=20))
    report = cb.report(specimen())
    assert report.stacking is found
    (known,) = report.diagnosis.plates
    layup, own = known.plate.layup, found.answer
    assert (layup.n_unknown, layup.angles_deg[:2].tolist()) == (0, own.top[0].tolist())
    assert sorted(map(abs, layup.angles_deg[:2])) == sorted(map(abs, TRUE))
    said = any(notice.code == "one_layup_taken" for notice in report.notices)
    assert said == (float(own.probability[0] * own.multiplicity[0]) < 0.95)
    assert not report.reached_goal, "20 steps are too few"
    report.save(tmp_path)
    placed = {figure for section in report.report().sections for figure in section.figures}
    assert {"sequence_angles", "identify_posterior", "diagnose_causes"} <= placed
    assert (tmp_path / "posterior.nc").exists()
    assert {"E1_GPa", "E2_GPa", "nu12", "G12_GPa"} <= set(report.to_arviz().posterior.data_vars)
