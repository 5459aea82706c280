"""Studies keep working: small runs, saved results, and the list of them."""

import importlib.util
import itertools
import json
import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.shared import once_a_run

PROJECT = Path(__file__).parent.parent
SAVED = PROJECT / "studies" / "results"
STUDIES = sorted(path.stem for path in (PROJECT / "studies").glob("[0-9]*.py"))
FIGURES = {path.stem for path in (PROJECT / "figures").glob("*.py")}
AGREEMENT = "02_agreement"


@cache
def script(folder: str, name: str) -> ModuleType:
    """A script with a number for a name, which the import statement cannot spell."""
    spec = importlib.util.spec_from_file_location(f"{folder}_{name}", PROJECT / folder / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@once_a_run
def quick_text(name: str) -> str:
    """Results of the small version of a study as JSON, which has no NaN."""
    return json.dumps(script("studies", name).run(True), allow_nan=False)


def quick(name: str) -> dict[str, Any]:
    return dict(json.loads(quick_text(name)))


def saved(name: str) -> dict[str, Any]:
    return dict(json.loads((SAVED / f"{name}.json").read_text(encoding="utf-8")))


# Studies whose smallest run takes more than ten seconds of a processor.
LONG = {
    *("05_calibration", "07_fpso", "08_sequences", "09_sequence_coverage", "12_findings"),
    *("14_sequence_reference", "15_claims", "21_hard_use", "23_growth", "24_nested_evidence"),
    *("26_slips", "27_coins", "29_recordings"),
}


def weekly_if_long(names: Iterable[str]) -> list[object]:
    """Studies as parameters of a test, the long ones left to the weekly run."""
    return [pytest.param(name, marks=[pytest.mark.weekly] if name in LONG else []) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("name", weekly_if_long(STUDIES))
def test_a_small_run_has_the_documented_keys(name: str) -> None:
    found = quick(name)
    assert list(found) == list(script("studies", name).KEYS)
    assert found["quick"] is True


@pytest.mark.parametrize("name", [*STUDIES, "write_pages"])
def test_saved_results_are_those_of_a_full_run_and_help_computes_nothing(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study = script("studies", name)
    if name in STUDIES:
        assert list(saved(name)) == list(study.KEYS)
        assert saved(name)["quick"] is False
    monkeypatch.setattr(study, "run", None, raising=False)
    monkeypatch.setattr("sys.argv", [f"{name}.py", "--help"])
    with pytest.raises(SystemExit) as stop:
        study.main()
    assert stop.value.code in (0, None)
    assert f"usage: {name}.py" in capsys.readouterr().out


def listed(readme: Path) -> set[str]:
    """The scripts that a README's table begins a row with."""
    return set(re.findall(r"^\| `([\w.]+)\.py` \|", readme.read_text(encoding="utf-8"), re.MULTILINE))


def test_each_study_is_listed_and_has_a_figure() -> None:
    assert listed(PROJECT / "studies" / "README.md") == set(STUDIES)
    assert set(STUDIES) <= FIGURES


@pytest.mark.slow
def test_solvers_meet_their_references_and_agree_within_the_limit() -> None:
    for found in (quick("01_first_light"), saved("01_first_light")):
        for error in found["forward_errors"]:
            assert error["passes"], error["case"]
            assert abs(error["worst_percent"]) <= error["allowed_percent"]
    for found in (quick(AGREEMENT), saved(AGREEMENT)):
        rows = [*found["specimens"], *found["unsymmetric"]]
        rows += [row for plate in found["edges"] for row in plate["rows"]]
        apart = {(r["edges"], r["worst_percent"]) for r in rows if not r["passes"]}
        assert apart == set()


def test_saved_studies_converge_and_agree() -> None:
    found = saved("01_first_light")["identifications"]
    assert {f["swarm"] for f in found} == {"converged"}
    assert all(f["solver_error_percent"] <= 0.05 for f in found)
    # thin plates: the error of the mesh; thick ones: as much again from the theory itself
    for row in saved(AGREEMENT)["specimens"]:
        if row["bricks"] is not None:
            assert row["bricks"]["same_kinds"]
            assert abs(row["bricks"]["worst_percent"]) <= (0.17 if row["modes"] == 10 else 0.06)


def test_edges_are_reduced_by_the_symmetry_of_the_plate_and_navier_is_the_thin_plate_formula() -> None:
    study = script("studies", AGREEMENT)
    mirrored, turned = study.distinct_edges(True), study.distinct_edges(False)
    # Burnside: (81 + 27 + 27 + 9) / 4 and (81 + 9) / 2 fixed combinations
    assert (len(mirrored), len(turned)) == (36, 45)
    assert set(mirrored) <= set(turned)
    assert study.edges_form("FCCF", True) == "CCFF"
    assert study.edges_form("FCCF", False) != study.edges_form("FFCC", False)
    study = script("studies", "01_first_light")
    thin = study._plate(study.cb.read_plate("D&G"), 0.3, 0.2, 2e-4, "SSSS", None)
    rigidity = np.real(study.plate_problem(thin).nominal.stiffness())[3, 3]
    exact = np.pi / 2 * (1 / 0.3**2 + 1 / 0.2**2) * np.sqrt(rigidity / (thin.plate.density * 2e-4))
    # shear deformation lowers it by (pi h / a)^2
    assert study.navier(thin, 1)[0] == pytest.approx(exact, rel=1e-5)


CASES = "17_worked_cases"


@pytest.mark.parametrize(
    ("cause", "claim", "causes", "expected"),
    [
        ("none", "none", [], "right"),
        ("none", "other", [], "wrong"),
        ("none", "named", ["warp"], "wrong"),
        ("warp", "none", [], "calm"),
        ("warp", "named", ["warp"], "right"),
        ("warp", "named", ["skew"], "wrong"),
        ("warp", "class", ["warp", "skew"], "right as a class"),
        ("warp", "class", ["taper_x", "skew"], "wrong"),
        ("warp", "pair", ["warp", "skew"], "wrong"),
        ("warp", "other", [], "other"),
        ("warp", "undecided", ["warp", "skew", "damage"], "undecided"),
        ("soft_clamp", "pair", ["clamp_translation", "clamp_rotation"], "right"),
        ("no cause of the catalogue", "other", [], "right"),
    ],
)
def test_an_answer_has_its_verdict(cause: str, claim: str, causes: list[str], expected: str) -> None:
    assert script("studies", CASES).verdict(cause, claim, causes) == expected


def test_saved_answers_are_held_against_the_truths_of_the_files() -> None:
    truths = json.loads((PROJECT / "studies/data/bricks/truths.json").read_text(encoding="utf-8"))
    for row in saved(CASES)["cases"]:
        truth = truths[row["case"]]
        assert row["truth"]["cause"] == truth["cause"]
        assert {c["name"]: c["truth"] for c in row["constants"]} == truth["constants"]


GROWTH = script("studies", "23_growth")


def test_the_exponent_of_a_power_law_is_found_with_no_error() -> None:
    found = GROWTH.row("solve", "modes", [(n, 0.3 * n**1.7) for n in (6, 12, 60)])
    assert found["exponent"] == pytest.approx(1.7, abs=1e-12)
    assert found["exponent_error"] == pytest.approx(0.0, abs=1e-12)
    assert GROWTH.row("solve", "modes", [(6, 1.0), (12, 4.0)])["exponent_error"] is None


def test_a_curve_ends_before_a_size_that_is_expected_to_cost_too_much(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run: list[int] = []
    clock = itertools.accumulate(t for n in (1, 2, 4, 8) for t in (0.0, float(n**2)))
    monkeypatch.setattr(GROWTH.time, "process_time", lambda: next(clock))
    curve = GROWTH.Curve("solve", "modes", (1, 2, 4, 8), lambda n: lambda: run.append(n))
    found = GROWTH.measured(curve, 20.0)
    assert run == [1, 2, 4]
    assert found["exponent"] == pytest.approx(2.0)
    assert GROWTH._expected([(p["size"], p["seconds"]) for p in found["points"]], 8) == pytest.approx(64.0)
    assert "solve, modes 4: 16.0 s" in capsys.readouterr().err


def test_the_model_of_a_cluster_gives_back_its_line() -> None:
    batches: list[dict[str, Any]] = [
        {"plates": n, "workers": w, "here_s": 1.0, "busiest_worker_s": 2.0 + 1.5 * n / w}
        for n, w in ((2, 1), (2, 2), (8, 1), (8, 2))
    ]
    a, b, worst = GROWTH.model_of(batches)
    assert (a, b) == (pytest.approx(3.0), pytest.approx(1.5))
    assert worst == pytest.approx(0.0, abs=1e-12)
