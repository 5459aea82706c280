"""The question `calibrate`: its requirements on a plate, and its statements about ranks."""

import json

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.calibration import N_DRAWS, Repetition, rank_statistics
from cpam_bayes.questions.calibrate import CalibrationResult, _constants
from tests.answers import answered

WELL = (True, True, 1.0, 5.0, 200.0, 400)  # diagnostics of chains and model for a repetition with ranks


def made_up(ranks):
    below = [tuple((r + 0.5) / (N_DRAWS + 1)) for r in ranks]
    pairs = enumerate(zip(ranks, below, strict=True))
    found = tuple(Repetition(i, (1.0, 1.0), tuple(r), b, *WELL) for i, (r, b) in pairs)
    statistics = rank_statistics(ranks, N_DRAWS + 1, np.random.default_rng(0))
    constants = tuple(_constants(("E1", "nu12"), np.array(below), statistics))
    own = {"seed": 0, "specimen": cb.read_plate("A1"), "band": ((0, 20),) * 20}
    return CalibrationResult(**own, repetitions=found, constants=constants)


def test_intervals_that_are_too_narrow_are_flagged_and_right_ones_are_not():
    rng = np.random.default_rng(1)
    right = rng.integers(0, 100, 300)
    # truths outside half of the draws: ranks at both ends
    narrow = np.where(rng.random(300) < 0.5, rng.integers(0, 10, 300), rng.integers(90, 100, 300))
    report = made_up(np.column_stack((right, narrow))).report()
    (table,) = report.summary.tables
    assert table.flagged == {1}
    assert [c["coverage"][0]["share"] for c in report.document["constants"].values()][1] == 0.0
    assert any("nu12" in line and "do not rely" in line for line in report.summary.lines)


@pytest.mark.slow
@pytest.mark.weekly
def test_the_answer_is_the_same_on_any_number_of_processes():
    alone = answered("calibrate")
    assert cb.calibrate("A1", 20, executor="processes", workers=2).repetitions == alone.repetitions
    document = json.loads(json.dumps(alone.to_dict(), allow_nan=False))
    assert set(document["constants"]) == {"E1_GPa", "nu12", "relative_std"}
    assert sum(document["constants"]["E1_GPa"]["rank_counts"]) == document["lists"] == 20
    assert set(alone.figures()) == {"plate", "ranks"}
