"""The question `calibrate`: what it asks of a plate, what it says of ranks."""

from __future__ import annotations

import json

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.calibration import N_DRAWS, Repetition, rank_statistics
from cpam_bayes.questions.calibrate import CalibrationResult, _constants


def answered(ranks: np.ndarray) -> CalibrationResult:
    """The answer to ranks (n, 2) that are made up."""
    found = tuple(
        Repetition(
            i, (1.0, 1.0), tuple(r), tuple((r + 0.5) / (N_DRAWS + 1)), True, True, 1.0, 5.0, 200.0, 400
        )
        for i, r in enumerate(ranks)
    )
    statistics = rank_statistics(ranks, N_DRAWS + 1, np.random.default_rng(0))
    return CalibrationResult(
        seed=0,
        specimen=cb.read_plate("A1"),
        repetitions=found,
        constants=tuple(_constants(("E1", "nu12"), found, statistics)),
        band=((0, 20),) * 20,
    )


def test_intervals_that_are_too_narrow_are_flagged_and_right_ones_are_not() -> None:
    rng = np.random.default_rng(1)
    right = rng.integers(0, 100, 300)
    # truths that lie outside half of the draws: ranks at both ends
    narrow = np.where(rng.random(300) < 0.5, rng.integers(0, 10, 300), rng.integers(90, 100, 300))
    report = answered(np.column_stack((right, narrow))).report()
    (table,) = report.summary.tables
    assert table.flagged == {1}
    assert [c["coverage"][0]["share"] for c in report.document["constants"].values()][1] == 0.0
    assert any("nu12" in line and "do not rely" in line for line in report.summary.lines)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"measurement": None}, "measurement"),
        ({"frequency_sd_hz": [1.0, 1.0]}, "relative_std"),
    ],
)
def test_a_plate_without_a_list_of_one_repeatability_is_refused(change: dict, said: str) -> None:
    plate = {
        "name": "strip",
        "plate": {
            "length_mm": 200.0,
            "width_mm": 100.0,
            "thickness_mm": 2.0,
            "density_kg_m3": 2700.0,
            "edges": "FFFF",
        },
        "material": {"isotropic": True, "E1_GPa": 69.0, "nu12": 0.33},
        "unknowns": {"E1_GPa": [50.0, 90.0]},
        "measurement": {"frequencies_hz": [250.0, 270.0]},
    }
    if "measurement" in change:
        del plate["measurement"]
    else:
        plate["measurement"] |= change
    with pytest.raises(ValueError, match=said):
        cb.calibrate(plate)


@pytest.mark.slow
def test_the_answer_is_the_same_on_any_number_of_processes() -> None:
    alone = cb.calibrate("A1", 20, seed=3)
    shared = cb.calibrate("A1", 20, seed=3, executor="processes", workers=2)
    assert shared.repetitions == alone.repetitions
    document = json.loads(json.dumps(alone.to_dict(), allow_nan=False))
    assert set(document["constants"]) == {"E1_GPa", "nu12", "relative_std"}
    assert sum(document["constants"]["E1_GPa"]["rank_counts"]) == document["lists"] == 20
    assert set(alone.figures()) == {"plate", "ranks"}
