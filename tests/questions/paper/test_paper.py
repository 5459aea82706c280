"""The question `paper`: its computations, storage, display and pages."""

import codecs
import csv
import importlib.util
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.plate import builtin
from cpam_bayes.printed.tables import NUMBERS
from cpam_bayes.questions import paper as module
from cpam_bayes.questions.paper import compared, tasks_of
from cpam_bayes.questions.paper.present import page, row_table
from cpam_bayes.questions.paper.rows import AGREES, FOUR, INPUT, NOT_COMPUTED, NOT_REPRODUCIBLE, TWO, VERDICTS
from cpam_bayes.questions.paper.work import case_specimen, frequency_scale, printed_rows, well_posed, write
from cpam_bayes.render.report import csv_text
from cpam_bayes.running import SILENT, TimeIsUpError, time_limit
from tests.answers import table_7
from tests.plate_file import described
from tests.plates import with_plate

PROJECT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def aluminium():
    return table_7()


def test_the_first_screen_holds_the_rows_of_the_table_and_misfits_and_figures_are_beside_them(aluminium):
    for result in (aluminium[0], cb.paper(3, quick=True)):
        (table,) = result.report().summary.tables
        rows = [row for row in result.rows if row.verdict != INPUT] or result.rows
        assert len(table.rows) == len(rows)
        disputed = [i for i, row in enumerate(rows) if row.verdict == NOT_REPRODUCIBLE]
        assert disputed == sorted(table.flagged)
    document = aluminium[0].to_dict()
    assert len(document["rows"]) == 6
    misfits = document["audit"]["misfits"]
    assert [m["source"] for m in misfits] == ["Hwang and Chang [8]", "CPAM"]
    assert all(m["objective"] >= m["our_objective"] for m in misfits)
    assert document["tables"][0]["percentages"]["does not follow"] == 1
    (row,) = (r for r in document["rows"] if r["quantity"] == "E1_GPa" and r["source"] == "CPAM")
    assert row["printed"] == 72.6
    assert row["q025"] < row["q975"]
    json.dumps(document, allow_nan=False)
    assert (list(aluminium[0].figures()), cb.paper(2).figures()) == (["differences", "misfits"], {})


@pytest.fixture
def nothing_computed(monkeypatch):
    def refuse(*args, **options):
        raise AssertionError("computed")

    monkeypatch.setattr(module, "run", refuse)


@pytest.mark.usefixtures("nothing_computed")
def test_what_is_finished_is_not_computed_again_and_what_the_rest_takes_is_said_at_once(aluminium, tmp_path):
    result, store = aluminium
    for everything in (False, True):
        assert cb.paper(7, quick=True, store=store, everything=everything).rows == result.rows
    with pytest.raises(AssertionError, match="computed"):
        cb.paper(7, quick=True, store=store, seed=1)
    for options, first in (  # the packaged Table 9 took 5 min 7 s
        ({"seed": 1}, "10 computations, about 6 min on one core; finished ones are kept"),
        ({"quick": True}, "10 computations, about 50 s on one core; finished ones are kept"),
        ({"everything": True}, "posteriors over stacking sequences: about 2 h 10 min on one core"),
    ):
        said: list[str] = []
        watch = SimpleNamespace(announce=said.append, promise=said.append, stage=SILENT.stage)
        with pytest.raises(AssertionError, match="computed"):
            cb.paper(9, store=tmp_path, watch=watch, **options)
        assert said[0] == first
        assert len(said) == 1 or "everything" in options


def test_when_time_is_up_the_rows_of_what_is_done_are_answered(tmp_path, monkeypatch):
    first = module.packaged("tasks")["tasks"]["constants D4, as built in"]

    def one(work, effort, tasks, pool, on_result, **options):
        on_result(0, first)
        raise TimeIsUpError("late")

    monkeypatch.setattr(module, "run", one)
    with time_limit(9.0):
        result = cb.paper(9, seed=1, store=tmp_path)
    assert result.notices[0].facts["missing"] == (("cut_tasks", {"late": 9, "of": 10}),)
    assert {row.specimen for row in result.rows if row.part == "a" and row.verdict != INPUT} == {"D4"}


@pytest.mark.usefixtures("nothing_computed")
def test_a_table_is_answered_from_what_comes_with_the_package(tmp_path, monkeypatch):
    asked: list[str] = []
    for task in tasks_of(9, 0):
        write(tmp_path, module.FULL, task, {"of": "another machine"})
    stored = module.comes_with_the_package

    def known(task):
        asked.append(task.title)
        return stored(task)

    monkeypatch.setattr(module, "comes_with_the_package", known)
    result = cb.paper(9, store=tmp_path)
    assert asked == [task.title for task in sorted(tasks_of(9, 0), key=module._turn)]
    summary = result.report().summary
    assert (len(result.rows), len(summary.tables[0].rows)) == (89, 84)
    assert "--all" in summary.lines[-1]
    shown = [*summary.headline.splitlines(), *summary.lines, summary.next_step]
    assert sum(len(line.split()) for line in shown) <= 120


@pytest.mark.parametrize(
    ("number", "plate", "names"),
    [(2, "", ()), (1, "D&G", ("calculix", "diagnoses")), (10, "", ()), (13, "D1", ("sequences", "swarms"))],
)
def test_all_of_one_table_is_of_its_plates_alone(number, plate, names):
    assert module._behind((number,)) == dict.fromkeys(names, (plate,))
    computed = cb.paper(number).computed
    for name in names:
        spent = module.packaged(name)["seconds_each"]
        assert computed[module._SLOW[name]]["seconds"] == pytest.approx(spent[plate])


def test_printed_angles_are_written_as_ours():
    summary = cb.paper(11).report().summary
    assert "1 is not determined, 1 is not reproducible" in " ".join(summary.headline.split())
    (table,) = summary.tables
    place = [table.headings.index(name) for name in ("printed", "ours")]
    angles = [[row[i] for i in place] for row in table.rows if "angles_deg" in row]
    assert len(angles) == 4
    assert all(re.fullmatch(r"-?[\d.]+(/-?[\d.]+){3}", text) for pair in angles for text in pair)


def test_a_stored_file_that_is_damaged_or_of_other_effort_is_passed_over(tmp_path):
    (task,) = tasks_of(7, 0)
    write(tmp_path, module.QUICK, task, {"rms_percent": 1.0})
    assert module.read(tmp_path, module.QUICK, task) == {"rms_percent": 1.0}
    assert module.read(tmp_path, module.FULL, task) is None
    next(tmp_path.iterdir()).write_text("{", encoding="utf-8")
    assert module.read(tmp_path, module.QUICK, task) is None


def test_the_command_writes_json_csv_and_page(run, tmp_path):
    status, shown, said = run("paper", "3", "--json", "--quiet", "--out", tmp_path)
    assert (status, said) == (0, "")
    rows, table = json.loads(shown)["rows"], tmp_path / "comparison.csv"
    assert json.loads((tmp_path / "paper.json").read_text("utf-8"))["rows"] == rows
    assert table.read_bytes().startswith(codecs.BOM_UTF8)
    lines = list(csv.DictReader(table.read_text("utf-8-sig").splitlines()))
    assert [line["quantity"] for line in lines] == [row["quantity"] for row in rows]
    assert "Table 3" in (tmp_path / "comparison.md").read_text("utf-8")
    assert (tmp_path / "report.html").exists()


def test_four_constants_of_aluminium_are_searched_beyond_the_bounds_of_eq_8():
    unknowns = case_specimen("A1", FOUR).unknowns
    assert (unknowns.names, unknowns.upper[1]) == (("E1", "E2", "nu12", "G12"), 200e9)
    sources = [row.source for row in printed_rows(8, "A1", TWO)]
    assert sources == ["Hwang and Chang [8], two constants", "CPAM, two constants"]


@pytest.mark.parametrize("name", ["calculix", "diagnoses", "sequences", "swarms"])
def test_what_comes_with_the_package_is_what_its_study_found(name):
    spec = importlib.util.spec_from_file_location("paper_study", PROJECT / "studies" / "19_paper.py")
    study = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(study)
    assert_same(json.loads(json.dumps(study.stored(name))), module.packaged(name))


def assert_same(found, expected, rel=1e-7):
    if isinstance(expected, dict | list):
        keys = list(expected) if isinstance(expected, dict) else range(len(expected))
        assert (list(found) if isinstance(expected, dict) else range(len(found))) == keys
        for key in keys:
            assert_same(found[key], expected[key], rel)
    elif isinstance(expected, float):
        # frequencies of C3 differ by 2e-8 between two processors: rounding times (length / thickness)^4
        assert found == pytest.approx(expected, rel=rel)
    else:
        assert found == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "left_out"), [(5, set()), pytest.param(11, {"angles_deg"}, marks=pytest.mark.weekly)]
)
def test_every_printed_value_of_a_table_has_a_verdict(number, left_out, tmp_path):
    result = cb.paper(number, quick=True, executor="processes", store=tmp_path)
    assert {row.table for row in result.rows} == {number}
    assert {row.quantity for row in result.rows if row.verdict == NOT_COMPUTED} == left_out
    assert {row.verdict for row in result.rows if row.quantity not in left_out} & {*VERDICTS} - {INPUT}
    assert result.notices[0].code == "quick"


def of_the_package(numbers):
    tasks = dict.fromkeys(task for number in numbers for task in tasks_of(number, 0))
    found = {task: stored for task in tasks if (stored := module.comes_with_the_package(task)) is not None}
    return compared(numbers, found, seed=0)


@pytest.fixture(scope="module")
def document():
    return json.loads((PROJECT / "studies" / "results" / "19_paper.json").read_text("utf-8"))["paper"]


def test_the_saved_document_is_that_of_the_package_with_every_printed_value(document):
    """Its page is compared with docs/comparison.md in tests/test_pages.py."""
    again = json.loads(json.dumps(of_the_package(NUMBERS).to_dict()))
    assert_same(again | {"fingerprint": document["fingerprint"]}, document, 1e-12)  # run 19_paper.py --page
    assert not document["quick"]
    assert len(document["rows"]) == 474  # every printed value of tests/printed/test_tables.py
    assert (PROJECT / "docs" / "comparison.csv").read_text("utf-8") == csv_text(row_table(document))
    assert len((PROJECT / "docs" / "comparison.md").read_text("utf-8").split()) <= 3000
    agreeing = [row for row in document["rows"] if row["verdict_kind"] == AGREES]
    assert len(agreeing) > 30
    identified = [row for row in agreeing if row["difference_percent"] is not None and row["table"] > 5]
    assert max(abs(row["difference_percent"]) for row in identified) <= 5.3  # 5 % of ours, over ours
    outside = [r for r in document["rows"] if r["q025"] and not r["q025"] <= r["ours"] <= r["q975"]]
    assert all(":" in row["verdict"] for row in outside)


def test_the_page_follows_the_document(document):
    def of_c3(**changes):
        changed = [{**e, **changes} if e["specimen"] == "C3" else e for e in document["simulation"]]
        lines = page({**document, "simulation": changed}).splitlines()
        return next(line for line in lines if "**C3**" in line)

    assert "as thick" in of_c3()
    assert "no one factor" in of_c3(scaled_rms_percent=25.0)  # unexplained by one factor
    assert "Table 2" not in of_c3(frequency_ratio=3.0)

    def of_misfits(**changes):
        misfits = [{**m, **changes} for m in document["audit"]["misfits"]]
        return page({**document, "audit": {**document["audit"], "misfits": misfits}})

    assert "Only one swarm found it" in of_misfits()
    assert "Only one swarm" not in of_misfits(swarms_found=2)
    assert of_misfits(rms_percent=1.2345) != of_misfits()


def test_the_factor_on_the_frequencies_of_a_plate_that_is_too_thick_is_that_of_its_thickness():
    specimen, found = builtin("C3"), module.packaged("diagnoses")["plates"]["C3"]
    expected = {k: found[k] for k in ("frequency_ratio", "scaled_rms_percent")}
    assert frequency_scale("C3") == pytest.approx(expected)
    thick = with_plate("C3", thickness=2.0 * specimen.plate.thickness)
    times = cb.forward(thick, n_modes=6).frequencies / cb.forward(specimen, n_modes=6).frequencies
    assert times == pytest.approx(2.0, rel=0.02), "thin: as its thickness"


def test_a_page_without_disagreements_has_no_heading_for_them_and_says_when_it_was_computed():
    written = page(of_the_package((13,)).to_dict())
    assert "disagreements" not in written
    assert "\n\n\n" not in written
    assert re.search(r"Computed 2026-\d\d-\d\d to 2026-\d\d-\d\d by version 0\.2\.0", written)


# Hadamard's conditions against closed forms
def isotropic(frequencies, **unknowns):
    material = {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.33}
    tables = {"unknowns": unknowns, "measurement": {"frequencies_hz": frequencies}}
    return described((300.0, 200.0, 2.0), 2700.0, material, **tables)


@pytest.fixture(scope="module")
def frequencies():
    return cb.forward(isotropic([100.0], E1_GPa=[50.0, 90.0]), n_modes=6).frequencies.tolist()


def test_frequencies_grow_as_the_root_of_the_modulus(frequencies):
    """d ln f / d ln E = 1/2 for all n modes: sd(ln E) = 2 / sqrt(n) times the noise."""
    off = [f * (1.0 + 0.01 * (-1) ** i) for i, f in enumerate(frequencies)]
    answer = well_posed(cb.identify(isotropic(off, E1_GPa=[50.0, 90.0]), residuals="relative").estimate)
    assert answer["percent_per_percent"]["E1_GPa"] == pytest.approx(2.0 / math.sqrt(6.0), rel=1e-4)
    assert (answer["rank"], answer["condition"], answer["optima"]) == (1, pytest.approx(1.0), 1)
    assert answer["left_percent"] == pytest.approx(math.sqrt(6.0 / 5.0), rel=1e-3)  # sqrt(6 0.01^2 / 5)


def test_two_constants_that_all_frequencies_see_alike_are_ill_conditioned(frequencies):
    """The modulus is amplified more if Poisson's ratio is unknown too."""
    alone, both = (
        well_posed(cb.identify(isotropic(frequencies, E1_GPa=[50.0, 90.0], **more)).estimate)
        for more in ({}, {"nu12": [0.1, 0.45]})
    )
    assert both["rank"] == 2
    assert both["condition"] > 2.0
    assert both["percent_per_percent"]["E1_GPa"] > alone["percent_per_percent"]["E1_GPa"]


def test_existence_needs_a_misfit_within_repeatability_and_rounding_and_uniqueness_one_optimum():
    posed = {"frequencies": 6, "unknowns": 4, "left_percent": 0.5, "rank": 4, "condition": 10.0, "optima": 1}

    def found(layups=None, rounding=0.0, **change):
        known = {**posed, "percent_per_percent": {}, **change}
        return module.hadamard(
            module.Task("constants", "C1", "as built in", 9, 0), known, layups, 0.9, rounding
        )

    assert (found()["exists"], found()["unique"]) == (True, True)
    # sqrt(0.9^2 + 0.5^2) = 1.03
    for left, rounding, exists in ((1.0, 0.0, False), (1.0, 0.5, True), (1.1, 0.5, False), (None, 0.0, None)):
        assert found(left_percent=left, rounding=rounding)["exists"] is exists
    assert not any(one["unique"] for one in (found(rank=3), found(optima=2), found(layups=3130)))
    measured = cb.read_plate("A2").measurement  # uniform errors of the last digit
    assert measured.resolution == 1.0
    errors = np.random.default_rng(1).uniform(-0.5, 0.5, (20000, measured.size)) / measured.frequencies
    assert module.rounding_percent("A2") == pytest.approx(100.0 * np.sqrt(np.mean(errors**2)), rel=0.01)
