"""Studies keep working: small runs, saved results, and their index."""

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
AGREEMENT = "02_agreement"
# over ten CPU seconds
LONG = ("05", "07", "08", "09", "12", "14", "15", "21", "23", "24", "26", "27", "29", "30", "31")
CASES = "17_worked_cases"


@cache
def script(folder: str, name: str) -> ModuleType:
    """Import a script whose name begins with a number."""
    spec = importlib.util.spec_from_file_location(f"{folder}_{name}", PROJECT / folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@once_a_run
def quick_text(name: str) -> str:
    return json.dumps(script("studies", name).run(True), allow_nan=False)


def quick(name: str) -> dict[str, Any]:
    return json.loads(quick_text(name))


def saved(name: str) -> dict[str, Any]:
    return json.loads((SAVED / f"{name}.json").read_text(encoding="utf-8"))


GROWTH = script("studies", "23_growth")


def weekly_if_long(names: Iterable[str]) -> list[object]:
    return [pytest.param(name, marks=pytest.mark.weekly if name[:2] in LONG else ()) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("name", weekly_if_long(STUDIES))
def test_a_small_run_has_the_documented_keys(name):
    assert (list(quick(name)), quick(name)["quick"]) == (list(script("studies", name).KEYS), True)


@pytest.mark.parametrize("name", [*STUDIES, "write_pages"])
def test_saved_results_are_those_of_a_full_run_and_help_computes_nothing(name, monkeypatch, capsys):
    study = script("studies", name)
    if name in STUDIES:
        assert (list(saved(name)), saved(name)["quick"]) == (list(study.KEYS), False)
    monkeypatch.setattr(study, "run", None, raising=False)
    monkeypatch.setattr("sys.argv", [f"{name}.py", "--help"])
    with pytest.raises(SystemExit) as stop:
        study.main()
    assert stop.value.code in (0, None)
    assert f"usage: {name}.py" in capsys.readouterr().out


def listed(readme: Path) -> set[str]:
    """Scripts that begin a row of a README's table."""
    return set(re.findall(r"^\| `([\w.]+)\.py` \|", readme.read_text(encoding="utf-8"), re.MULTILINE))


def test_each_study_is_listed_and_has_a_figure():
    assert listed(PROJECT / "studies" / "README.md") == set(STUDIES)
    assert set(STUDIES) <= {path.stem for path in (PROJECT / "figures").glob("*.py")}


@pytest.mark.slow
def test_solvers_meet_their_references_and_agree_within_the_limit():
    for error in (e for of in (quick, saved) for e in of("01_first_light")["forward_errors"]):
        assert error["passes"], error["case"]
        assert abs(error["worst_percent"]) <= error["allowed_percent"]
    for found in (quick(AGREEMENT), saved(AGREEMENT)):
        rows = [*found["specimens"], *found["unsymmetric"]]
        rows += [row for plate in found["edges"] for row in plate["rows"]]
        assert [(r["edges"], r["worst_percent"]) for r in rows if not r["passes"]] == []


def test_saved_studies_converge_and_agree():
    found = saved("01_first_light")["identifications"]
    assert {(f["swarm"], f["solver_error_percent"] <= 0.05) for f in found} == {("converged", True)}
    for row in saved(AGREEMENT)["specimens"]:  # thin: error of the mesh; thick: of the theory too
        if row["bricks"] is not None:
            assert row["bricks"]["same_kinds"]
            assert abs(row["bricks"]["worst_percent"]) <= (0.17 if row["modes"] == 10 else 0.06)


def test_edges_are_reduced_by_the_symmetry_of_the_plate_and_navier_is_the_thin_plate_formula():
    study = script("studies", AGREEMENT)
    mirrored, turned = study.distinct_edges(True), study.distinct_edges(False)
    assert (len(mirrored), len(turned)) == (36, 45)  # Burnside: (81 + 27 + 27 + 9) / 4, (81 + 9) / 2
    assert set(mirrored) <= set(turned)
    assert study.edges_form("FCCF", True) == "CCFF"
    assert study.edges_form("FCCF", False) != study.edges_form("FFCC", False)
    study = script("studies", "01_first_light")
    thin = study._plate(study.cb.read_plate("D&G"), 0.3, 0.2, 2e-4, "SSSS", None)
    rigidity = np.real(study.plate_problem(thin).nominal.stiffness())[3, 3]
    exact = np.pi / 2 * (1 / 0.3**2 + 1 / 0.2**2) * np.sqrt(rigidity / (thin.plate.density * 2e-4))
    # shear deformation lowers it by (pi h / a)^2
    assert study.navier(thin, 1)[0] == pytest.approx(exact, rel=1e-5)


def test_an_answer_has_its_verdict():
    verdicts = {"none none": "right", "none other": "wrong", "none named warp": "wrong", "warp none": "calm"}
    verdicts |= {"warp named warp": "right", "warp named skew": "wrong", "warp other": "other"}
    verdicts |= {"warp class warp skew": "right as a class", "warp class taper_x skew": "wrong"}
    verdicts |= {"warp pair warp skew": "wrong", "warp undecided warp skew damage": "undecided"}
    verdicts |= {"soft_clamp pair clamp_translation clamp_rotation": "right"}
    verdict = script("studies", CASES).verdict
    for asked, expected in verdicts.items():
        cause, claim, *causes = asked.split()
        assert verdict(cause, claim, causes) == expected, asked
    assert verdict("no cause of the catalogue", "other", []) == "right"


def test_saved_answers_are_held_against_the_truths_of_the_files():
    truths = json.loads((PROJECT / "studies/data/bricks/truths.json").read_text(encoding="utf-8"))
    for row in saved(CASES)["cases"]:
        constants = {c["name"]: c["truth"] for c in row["constants"]}
        of_file = truths[row["case"]]
        assert (row["truth"]["cause"], constants) == (of_file["cause"], of_file["constants"])


def test_the_exponent_of_a_power_law_is_found_with_no_error():
    found = GROWTH.row("solve", "modes", [(n, 0.3 * n**1.7) for n in (6, 12, 60)])
    assert (found["exponent"], found["exponent_error"]) == pytest.approx((1.7, 0.0), abs=1e-12)
    assert GROWTH.row("solve", "modes", [(6, 1.0), (12, 4.0)])["exponent_error"] is None


def test_a_curve_ends_before_a_size_that_is_expected_to_cost_too_much(monkeypatch, capsys):
    run = []
    clock = itertools.accumulate(t for n in (1, 2, 4, 8) for t in (0.0, float(n**2)))
    monkeypatch.setattr(GROWTH.time, "process_time", lambda: next(clock))
    curve = GROWTH.Curve("solve", "modes", (1, 2, 4, 8), lambda n: lambda: run.append(n))
    found = GROWTH.measured(curve, 20.0)
    assert run == [1, 2, 4]
    assert found["exponent"] == pytest.approx(2.0)
    assert GROWTH._expected([(p["size"], p["seconds"]) for p in found["points"]], 8) == pytest.approx(64.0)
    assert "solve, modes 4: 16.0 s" in capsys.readouterr().err


def test_the_model_of_a_cluster_gives_back_its_line():
    batches = [
        {"plates": n, "workers": w, "here_s": 1.0, "busiest_worker_s": 2.0 + 1.5 * n / w}
        for n, w in itertools.product((2, 8), (1, 2))
    ]
    a, b, worst = GROWTH.model_of(batches)
    assert (a, b, worst) == (pytest.approx(3.0), pytest.approx(1.5), pytest.approx(0.0, abs=1e-12))
