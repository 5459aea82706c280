"""Results of studies: what is run again replaces its own cases, and only these."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from validation.reporting import save_results, saved_results, with_saved

ORDER = ("C1", "D1", "D3")


def test_results_come_back_as_they_were(tmp_path: Path) -> None:
    path = tmp_path / "results" / "01.json"
    assert saved_results(path) == {}
    save_results(path, {"quick": False, "cases": [{"case": "C1", "rms": 1.5}]})
    assert saved_results(path) == {"quick": False, "cases": [{"case": "C1", "rms": 1.5}]}


def test_cases_that_were_not_run_again_stay_in_order(tmp_path: Path) -> None:
    path = tmp_path / "08.json"
    save_results(
        path,
        {
            "seeds": 3,
            "cases": [{"case": "D3", "x": 1}, {"case": "C1", "x": 1}, {"case": "C1", "x": 2}],
            "cost": [{"case": "D1", "s": 4}, {"case": "no longer a case", "s": 5}],
        },
    )
    new = {"seeds": 20, "cases": [{"case": "D1", "x": 7}, {"case": "C1", "x": 8}], "cost": []}
    both = with_saved(new, path, ORDER)
    assert both["seeds"] == 20
    assert both["cases"] == [{"case": "C1", "x": 8}, {"case": "D1", "x": 7}, {"case": "D3", "x": 1}]
    assert both["cost"] == [{"case": "D1", "s": 4}]
    assert new["cases"] == [{"case": "D1", "x": 7}, {"case": "C1", "x": 8}], (
        "the results are left as they are"
    )


def test_a_case_can_be_named_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "12.json"
    save_results(path, {"groups": [{"plates": ["C1", "C2"]}, {"plates": ["C1"], "p": 1}]})
    both = with_saved(
        {"groups": [{"plates": ["C1"], "p": 2}]}, path, [("C1",), ("C1", "C2")], lambda g: tuple(g["plates"])
    )
    assert both == {"groups": [{"plates": ["C1"], "p": 2}, {"plates": ["C1", "C2"]}]}


def test_nan_is_refused_before_anything_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "07.json"
    save_results(path, {"cases": [{"case": "C1"}]})
    with pytest.raises(ValueError, match="JSON"):
        save_results(path, {"cases": [{"case": "C1", "rms": np.nan}]})
    assert saved_results(path) == {"cases": [{"case": "C1"}]}
