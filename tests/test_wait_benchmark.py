"""The benchmark of waits: commands from nothing, stopped at a limit, and the page that it writes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import fresh, waits
from benchmarks.wait_tables import sections, tables
from cpam_bayes.plate import read_plate
from validation.reporting import with_sections

PAGE = waits.ROOT / "docs" / "speed.md"
# As benchmarks/README.md has them.
ROW_KEYS = {"case", "what", "reach_s", "reach_gib", "load", "before", "after"}
WAIT_KEYS = {
    *("commit", "rounds", "stopped", "exit_status", "seconds"),
    *("processor_seconds", "peak_gib", "answer"),
}
SOLVER_KEYS = {"case", "unit", "reach", "at_least", "before", "after"}


def test_a_small_run_compares_two_trees() -> None:
    results = waits.run(quick=True, before=waits.ROOT)
    assert list(results) == list(waits.KEYS)
    (row,) = results["waits"]
    assert set(row) == ROW_KEYS
    assert set(row["before"]) == set(row["after"]) == WAIT_KEYS
    assert row["before"]["exit_status"] == row["after"]["exit_status"] == 0
    assert row["before"]["answer"] == row["after"]["answer"] != ""
    # Python with numpy and scipy alone holds 50 MiB
    assert row["after"]["peak_gib"] > 0.05
    assert row["after"]["processor_seconds"] > 0.0
    assert [len(table.rows) for table in tables(results)] == [1]


def test_a_command_over_the_limit_is_stopped_and_said_so() -> None:
    case = waits.QUICK
    row = waits._row(case, {"before": None, "after": waits.ROOT}, rounds=2, limit=0.0)
    assert row["before"] is None
    assert row["after"]["stopped"]
    assert row["after"]["rounds"] == 1, "not tried again"
    assert "| over 0 |" in sections({"waits": [row], "solver": []})["waits"]


def test_a_command_runs_in_the_tree_with_an_empty_cache(tmp_path: Path) -> None:
    package = tmp_path / "told"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "__main__.py").write_text(
        "import json, os, pathlib, sys\n"
        "kept = list(pathlib.Path(os.environ['CPAM_BAYES_CACHE']).iterdir())\n"
        "print(json.dumps({'given': sys.argv[1:], 'cached': len(kept), 'file': __file__}))\n"
        "sys.exit(3)\n"
    )
    found = fresh.waited("told", ("a", "b"), tmp_path, 60.0)
    assert found.exit_status == 3
    assert found.document == {"given": ["a", "b"], "cached": 0, "file": str(package / "__main__.py")}


@pytest.mark.parametrize("name", ["cross_ply", "cross_ply_sensor"])
def test_plates_of_the_benchmark_have_twelve_modes(name: str) -> None:
    plate = read_plate(waits.PLATES / f"{name}.toml")
    assert plate.measurement is not None
    assert plate.measurement.size == 12
    assert len(plate.sensors) == ("sensor" in name)


def test_a_tree_that_is_none_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        waits.main(["--before", str(tmp_path)])
    assert stop.value.code == 2
    assert "accepted: a checkout of this project" in capsys.readouterr().err


def test_the_page_says_what_was_measured() -> None:
    results = json.loads(waits.RESULTS.read_text(encoding="utf-8"))
    assert list(results) == list(waits.KEYS)
    assert not results["quick"]
    assert all(set(row) == ROW_KEYS for row in results["waits"])
    assert all(set(row) == SOLVER_KEYS for row in results["solver"])
    page = PAGE.read_text(encoding="utf-8")
    assert with_sections(page, "waits", sections(results)) == page
