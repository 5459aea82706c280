"""The benchmark runs on what is installed with the package alone and says what it left out."""

import pytest

from benchmarks import forward_solvers, peers

OURS = {
    "ours, full",
    "ours, full with derivatives",
    "ours, reduced",
    "ours, reduced with derivatives",
    "ours, reduced with error estimates",
    "LAPACK alone, sizes of full",
    "LAPACK alone, sizes of reduced",
}
WRITTEN_HERE = {
    "scikit-fem S2",
    "scikit-fem S2, bending only",
    "polynomial Ritz",
    "polynomial Ritz, bending only",
}
# As benchmarks/README.md has them.
KEYS = {
    "quick",
    "rounds",
    "stack",
    "accuracy",
    "load",
    "converged",
    "rows",
    "building",
    "targets",
    "missing",
}
ROW_KEYS = {
    "case",
    "solver",
    "size",
    "sets",
    "rounds",
    "median_s",
    "ratio",
    "ratio_quartiles",
    "error",
}
BUILDING_KEYS = {
    "case",
    "parameters",
    "seconds",
    "peak_mib",
    "full_sizes",
    "reduced_sizes",
    "reduction_error",
}


@pytest.mark.slow
def test_the_forward_benchmark_runs_without_the_optional_peers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "has_panels", lambda: False)
    monkeypatch.setattr(peers, "has_calculix", lambda: False)
    results = forward_solvers.run(quick=True)
    assert set(results) == KEYS
    assert all(set(row) == ROW_KEYS for row in results["rows"])
    assert all(set(built) == BUILDING_KEYS for built in results["building"])
    assert {row["solver"] for row in results["rows"]} == OURS | WRITTEN_HERE
    assert [line.split(":")[0] for line in results["missing"]] == ["panels", "CalculiX"]
    # a peer is as coarse as the accuracy allows, ours is as exact as ever
    errors = {row["solver"]: row["error"] for row in results["rows"]}
    assert all(errors[solver] <= results["accuracy"] for solver in WRITTEN_HERE)
    assert errors["ours, full"] < 2e-4
    text = [cell for table in forward_solvers.tables(results) for row in table.rows for cell in row]
    assert "panels: not installed; pip install panels==0.14" in text
