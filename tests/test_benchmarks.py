"""Benchmarks run in small, with the package's own dependencies, and give the results in their README."""

import json
import re

import numpy as np
import pytest

from benchmarks import forward_solvers, page_edits, peers, samplers, waits
from benchmarks.plain_likelihood import cross_ply_stiffness, plain_frequencies
from benchmarks.wait_tables import sections, tables
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.plate import read_specimen
from cpam_bayes.plate.laminate import FIVE_SIXTHS
from tests.mechanics.test_convergence import CONVERGED_HZ
from validation.reporting import with_sections

README = (waits.ROOT / "benchmarks" / "README.md").read_text("utf-8")
OURS = {
    *("ours, full", "ours, full with derivatives", "ours, reduced", "ours, reduced with derivatives"),
    *("LAPACK alone, sizes of full", "LAPACK alone, sizes of reduced"),
}
WRITTEN_HERE = {one + of for one in ("scikit-fem S2", "polynomial Ritz") for of in ("", ", bending only")}
ROW_KEYS = {"case", "what", "reach_s", "reach_gib", "load", "before", "after"}
SOLVER_KEYS = {"case", "unit", "reach", "at_least", "before", "after"}


def documented(script: str) -> tuple[set[str], set[str]]:
    section = README.partition(f"## {script}\n")[2].partition("\n## ")[0]
    keys = re.findall(r"^\| (`[^|]*) \|", section.partition("| key | what |")[2], re.MULTILINE)
    row = section.partition("\nA row has ")[2].partition("\n\n")[0]
    return set(re.findall(r"`(\w+)`", " ".join(keys))), set(re.findall(r"`(\w+)`", row))


def cells(shown: list) -> list[str]:
    return [cell for table in shown for row in table.rows for cell in row]


@pytest.mark.slow
def test_the_forward_benchmark_runs_without_the_optional_peers(monkeypatch):
    for peer in ("has_panels", "has_calculix"):
        monkeypatch.setattr(peers, peer, lambda: False)
    results = forward_solvers.run(quick=True)
    keys, row_keys = documented("forward_solvers.py")
    assert (set(results), all(set(row) == row_keys for row in results["rows"])) == (keys, True)
    built = {"case", "parameters", "seconds", "peak_mib", "full_sizes", "reduced_sizes"}
    assert all(set(one) == built | {"reduction_error"} for one in results["building"])
    assert {row["solver"] for row in results["rows"]} == OURS | WRITTEN_HERE
    assert [line.split(":")[0] for line in results["missing"]] == ["panels", "CalculiX"]
    errors = {row["solver"]: row["error"] for row in results["rows"]}  # peers are coarse, ours is exact
    assert all(errors[solver] <= results["accuracy"] for solver in WRITTEN_HERE)
    assert errors["ours, full"] < 2e-4
    assert "panels: not installed; pip install panels==0.14" in cells(forward_solvers.tables(results))


def test_the_plain_solver_has_the_plate_and_its_two_forms_agree_for_plies_along_the_axes_alone():
    specimen = read_specimen("C1")
    assembling, summing = plain_frequencies(specimen, 6, 8)
    constants = dict(specimen.material.constants)
    np.testing.assert_allclose(assembling(constants), CONVERGED_HZ["C1"], rtol=1e-3)  # 0.06 % high
    np.testing.assert_allclose(summing(constants), assembling(constants), rtol=1e-7)
    plate = specimen.plate
    found = cross_ply_stiffness(plate.layup.angles(np.empty(0)), plate.thickness, constants)
    whole = np.real(plate_problem(specimen, shear=FIVE_SIXTHS).nominal.stiffness())
    expected = [whole[i, j] for i, j in ((3, 3), (3, 4), (4, 4), (5, 5), (6, 6), (7, 7))]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    with pytest.raises(ValueError, match="accepted: 0 and 90"):
        cross_ply_stiffness(np.array([45.0]), 1e-3, constants)


@pytest.mark.slow
@pytest.mark.weekly
def test_a_small_run_of_samplers_has_the_documented_keys():
    results = samplers.run(quick=True)
    keys, row_keys = documented("samplers.py")
    assert (set(results), all(set(row) == row_keys for row in results["rows"])) == (keys, True)
    ratios = {(row["sampler"], row["moves"]): row["ratio"] for row in results["rows"]}
    assert ratios[samplers.OURS, samplers.JUMPS] == 1.0
    local = (samplers.DE, samplers.STRETCH)
    ours = {(s, m) for s in (samplers.OURS, samplers.OURS_MANY) for m in (samplers.JUMPS, *local)}
    assert set(ratios) == ours | {(s, m) for s in (samplers.ASSEMBLING, samplers.SUMMING) for m in local}
    times = {(row["moves"], row["walkers"]): row["autocorrelation_time"] for row in results["rows"]}
    # three steps against forty, on longer chains
    assert all(times[samplers.JUMPS, n] < 0.5 * times[samplers.DE, n] for n in {n for _, n in times})
    assert results["fit"]["solves"] in range(2 * 512, 13 * 512, 512), "two rounds at least, twelve at most"
    for row in results["rows"]:
        per_second = 1.0 / (row["evaluation_s"] * row["autocorrelation_time"])  # medians in another order
        assert row["effective_per_s"] == pytest.approx(per_second, rel=1e-6)
    assert not results["targets"], "coarse meshes and short chains reach nothing"
    assert samplers.ASSEMBLING in cells(samplers.tables(results))


@pytest.mark.slow
def test_a_small_run_of_waits_compares_two_trees():
    results = waits.run(quick=True, before=waits.ROOT)
    (row,) = results["waits"]
    assert (list(results), set(row)) == (list(waits.KEYS), ROW_KEYS)
    assert row["before"]["exit_status"] == row["after"]["exit_status"] == 0
    assert row["before"]["answer"] == row["after"]["answer"] != ""
    assert row["after"]["peak_gib"] > 0.05  # Python with numpy and scipy alone takes 50 MiB
    assert row["after"]["processor_seconds"] > 0.0
    assert [len(table.rows) for table in tables(results)] == [1]


def test_a_command_over_the_limit_is_stopped_and_a_tree_that_is_none_is_refused(tmp_path, capsys):
    row = waits._row(waits.QUICK, {"before": None, "after": waits.ROOT}, rounds=2, limit=0.0)
    assert row["before"] is None
    assert (row["after"]["stopped"], row["after"]["rounds"]) == (True, 1), "not tried again"
    assert "| over 0 |" in sections({"waits": [row], "solver": []})["waits"]
    with pytest.raises(SystemExit, match="2"):
        waits.main(["--before", str(tmp_path)])
    assert "accepted: a checkout of this project" in capsys.readouterr().err


def test_the_page_says_what_was_measured():
    results = json.loads(waits.RESULTS.read_text(encoding="utf-8"))
    assert (list(results), results["quick"]) == (list(waits.KEYS), False)
    assert all(set(row) == ROW_KEYS for row in results["waits"])
    assert all(set(row) == SOLVER_KEYS for row in results["solver"])
    page = (waits.ROOT / "docs" / "speed.md").read_text("utf-8")
    assert with_sections(page, "waits", sections(results)) == page


@pytest.mark.slow
def test_edits_on_the_page_are_timed(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["page_edits", "--edits", "1", "--more", "1"])
    page_edits.main()
    said = [line.partition(":")[0] for line in capsys.readouterr().out.splitlines()]
    assert said == ["frequency", "width", "memory", "memory after 1 edits more"]
