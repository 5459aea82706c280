"""The question `paper`: what is computed, stored, shown and written."""

from __future__ import annotations

import csv
import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

import cpam_bayes as cb
from cpam_bayes.printed.tables import NUMBERS
from cpam_bayes.questions import paper as module
from cpam_bayes.questions.paper import PaperResult, tasks_of
from cpam_bayes.questions.paper.present import page, row_table
from cpam_bayes.questions.paper.rows import FOUR, INPUT, NOT_REPRODUCIBLE, TWO, VERDICTS
from cpam_bayes.questions.paper.work import FULL, QUICK, case_specimen, packaged, printed_rows, read, write
from cpam_bayes.render.report import csv_text
from tests.answers import table_7
from tests.plate_file import Run

ROW_KEYS = {
    "table",
    "specimen",
    "quantity",
    "printed",
    "ours",
    "difference_percent",
    "q025",
    "q975",
    "verdict",
}
PROJECT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def aluminium() -> tuple[PaperResult, Path]:
    return table_7()


def test_every_table_has_rows_for_all_its_printed_values() -> None:
    empty = {n: list(module._rows(n, {}, packaged("calculix"), packaged("sequences"))) for n in NUMBERS}
    assert all(empty[n] for n in (2, 3, 4, 9))
    assert {n for n in NUMBERS if not tasks_of(n, 0)} == {2, 3, 4}


def test_rows_have_the_keys_of_the_command_and_the_misfits_are_beside_them(
    aluminium: tuple[PaperResult, Path],
) -> None:
    document = aluminium[0].to_dict()
    assert all(row.keys() >= ROW_KEYS for row in document["rows"])
    assert len(document["rows"]) == 6
    assert [m["source"] for m in document["audit"]["misfits"]] == ["Hwang and Chang [8]", "CPAM"]
    assert all(m["objective"] >= m["our_objective"] for m in document["audit"]["misfits"])
    assert document["tables"][0]["percentages"]["does not follow"] == 1
    (row,) = (r for r in document["rows"] if r["quantity"] == "E1_GPa" and r["source"] == "CPAM")
    assert row["printed"] == 72.6
    assert row["q025"] < row["q975"]
    assert {row["verdict_kind"] for row in document["rows"]} <= set(VERDICTS)
    json.dumps(document, allow_nan=False)


def test_what_is_finished_is_not_computed_again(
    aluminium: tuple[PaperResult, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, store = aluminium

    def refuse(*args: Any, **options: Any) -> None:
        raise AssertionError("computed again")

    monkeypatch.setattr(module, "run", refuse)
    again = cb.paper(7, quick=True, store=store)
    assert again.rows == result.rows
    with pytest.raises(AssertionError, match="again"):
        cb.paper(7, quick=True, store=store, seed=1)
    with pytest.raises(AssertionError, match="again"):
        cb.paper(7, quick=True, store=store, everything=True)


def test_a_stored_file_that_is_damaged_or_of_other_effort_is_passed_over(tmp_path: Path) -> None:
    (task,) = tasks_of(7, 0)
    write(tmp_path, QUICK, task, {"rms_percent": 1.0})
    assert read(tmp_path, QUICK, task) == {"rms_percent": 1.0}
    assert read(tmp_path, FULL, task) is None
    next(tmp_path.iterdir()).write_text("{", encoding="utf-8")
    assert read(tmp_path, QUICK, task) is None


def test_the_command_writes_json_csv_page_and_figures(run: Run, tmp_path: Path) -> None:
    status, shown, said = run("paper", "3", "--json", "--quiet", "--out", tmp_path)
    assert (status, said) == (0, "")
    document = json.loads(shown)
    assert json.loads((tmp_path / "paper.json").read_text("utf-8"))["rows"] == document["rows"]
    with (tmp_path / "paper.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [line["quantity"] for line in lines] == [row["quantity"] for row in document["rows"]]
    assert lines[0].keys() >= ROW_KEYS
    assert "Table 3" in (tmp_path / "comparison.md").read_text("utf-8")
    assert (tmp_path / "report.html").exists()


def test_figures_are_drawn_where_there_is_something_to_draw(aluminium: tuple[PaperResult, Path]) -> None:
    assert list(aluminium[0].figures()) == ["differences", "misfits"]
    assert cb.paper(2).figures() == {}


def test_four_constants_of_aluminium_are_searched_beyond_the_bounds_of_eq_8() -> None:
    specimen = case_specimen("A1", FOUR)
    assert specimen.unknowns.names == ("E1", "E2", "nu12", "G12")
    assert specimen.unknowns.upper[1] == 200e9
    assert [row.source for row in printed_rows(8, "A1", TWO)] == [
        "Hwang and Chang [8], two constants",
        "CPAM, two constants",
    ]


@pytest.mark.parametrize("name", ["calculix", "diagnoses", "sequences"])
def test_what_comes_with_the_package_is_what_its_study_found(name: str) -> None:
    spec = importlib.util.spec_from_file_location("paper_study", PROJECT / "studies" / "19_paper.py")
    study = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(study)
    assert json.loads(json.dumps(study.stored()[name])) == packaged(name)


@pytest.mark.slow
def test_the_quick_comparison_gives_every_printed_value_a_verdict(tmp_path: Path) -> None:
    result = cb.paper(quick=True, executor="processes", store=tmp_path)
    assert len(result.rows) == 474
    assert {row.table for row in result.rows} == set(NUMBERS)
    assert all(row.verdict for row in result.rows)
    assert len({m.specimen for m in result.misfits}) == 13
    assert result.notices[0].code == "quick"


@pytest.mark.parametrize("number", [3, 7])
def test_the_first_screen_holds_the_rows_of_the_table(
    aluminium: tuple[PaperResult, Path], number: int
) -> None:
    result = aluminium[0] if number == 7 else cb.paper(3, quick=True)
    (table,) = result.report().summary.tables
    rows = [row for row in result.rows if row.verdict != INPUT] or result.rows
    assert len(table.rows) == len(rows)
    disputed = [i for i, row in enumerate(rows) if row.verdict == NOT_REPRODUCIBLE]
    assert disputed == sorted(table.flagged)


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    saved = json.loads((PROJECT / "studies" / "results" / "19_paper.json").read_text("utf-8"))
    found: dict[str, Any] = saved["paper"]
    return found


def test_a_changed_number_changes_the_page(document: dict[str, Any]) -> None:
    misfits = [dict(misfit) for misfit in document["audit"]["misfits"]]
    misfits[-1]["rms_percent"] = 1.2345
    changed = {**document, "audit": {**document["audit"], "misfits": misfits}}
    assert page(changed) != page(document)


def test_the_saved_document_has_every_printed_value_and_three_disagreements(document: dict[str, Any]) -> None:
    assert [t["table"] for t in document["tables"]] == list(NUMBERS)
    assert len(document["disagreements"]) == 3
    assert not document["quick"]
    assert {row["verdict"].partition(":")[0] for row in document["rows"]} <= set(VERDICTS)
    written = (PROJECT / "docs" / "comparison.csv").read_text("utf-8")
    assert written == csv_text(row_table(document))
    # every printed value of tests/printed/test_tables.py
    assert len(document["rows"]) == 474
