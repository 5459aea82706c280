"""The study of growth: exponents, where a curve ends, and the model of a thousand plates."""

import itertools
from types import SimpleNamespace
from typing import Any

import pytest

import cpam_bayes as cb
from tests import plate_file
from tests.test_studies import script

STUDY = script("studies", "23_growth")


def test_the_exponent_of_a_power_law_is_found_with_no_error() -> None:
    found = STUDY.row("solve", "modes", [(n, 0.3 * n**1.7) for n in (6, 12, 60)])
    assert found["exponent"] == pytest.approx(1.7, abs=1e-12)
    assert found["exponent_error"] == pytest.approx(0.0, abs=1e-12)
    assert STUDY.row("solve", "modes", [(6, 1.0), (12, 4.0)])["exponent_error"] is None


def test_a_curve_ends_before_a_size_that_is_expected_to_cost_too_much(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run: list[int] = []
    clock = itertools.accumulate(t for n in (1, 2, 4, 8) for t in (0.0, float(n**2)))
    monkeypatch.setattr(STUDY.time, "process_time", lambda: next(clock))
    curve = STUDY.Curve("solve", "modes", (1, 2, 4, 8), lambda n: lambda: run.append(n))
    found = STUDY.measured(curve, 20.0)
    assert run == [1, 2, 4]
    assert found["exponent"] == pytest.approx(2.0)
    assert STUDY._expected([(p["size"], p["seconds"]) for p in found["points"]], 8) == pytest.approx(64.0)
    assert "solve, modes 4: 16.0 s" in capsys.readouterr().err


def test_the_model_of_a_cluster_gives_back_its_line() -> None:
    batches: list[dict[str, Any]] = [
        {"plates": n, "workers": w, "here_s": 1.0, "busiest_worker_s": 2.0 + 1.5 * n / w}
        for n, w in ((2, 1), (2, 2), (8, 1), (8, 2))
    ]
    a, b, worst = STUDY.model_of(batches)
    assert (a, b) == (pytest.approx(3.0), pytest.approx(1.5))
    assert worst == pytest.approx(0.0, abs=1e-12)


def test_sizes_that_were_not_run_are_said() -> None:
    curve = next(c for c in STUDY.curves(False) if c.name == "batch, plates")
    points = [(n, 2.0 * n) for n in curve.sizes[:3]]
    left = ", ".join(map(str, curve.sizes[3:]))
    said = STUDY._unreached(STUDY.row(curve.question, curve.size, points))
    assert said == f"{left}: {2.0 * curve.sizes[3]:.0f} s expected at {curve.sizes[3]}"
    whole = STUDY.row(curve.question, curve.size, [(n, 2.0 * n) for n in curve.sizes])
    assert STUDY._unreached(whole) == ""


@pytest.mark.parametrize("parameters", [2, 4, 6, 8])
def test_a_plate_has_as_many_unknowns_as_are_asked_for(
    parameters: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # its list needs a solve, and is of no interest here
    monkeypatch.setattr(STUDY.cb, "forward", lambda plate, n: SimpleNamespace(frequencies=100.0))
    specimen = cb.read_plate(STUDY.plate(parameters=parameters, modes=3))
    assert specimen.unknowns.size + len(specimen.plate.sd) == parameters


def test_plies_of_known_layups_are_counted() -> None:
    layups = [cb.read_plate(described(STUDY.cross_ply(n))).plate.layup for n in (4, 16, 64)]
    assert [layup.n_plies for layup in layups] == [4, 16, 64]


def described(layup: str) -> dict[str, Any]:
    material = {"isotropic": False, **STUDY.CONSTANTS}
    return plate_file.described((260.0, 220.0, 3.2), 1590.0, material, layup=layup)
