"""`identify` by the swarm: what is determined, what ruins the answer, and what to check first."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cpam_bayes.answer import Verdict
from cpam_bayes.identification.point import PointEstimate, point_notices
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import builtin
from cpam_bayes.questions.identify import PointResult, identify
from cpam_bayes.render.report import json_text
from tests.answers import answered
from tests.stacking.cases import specimen as two_unknown_angles

Shown = Callable[[PointEstimate], PointResult]


@pytest.fixture(scope="module")
def point() -> PointResult:
    return answered("identify")


@pytest.fixture(scope="module")
def identification(point: PointResult) -> PointEstimate:
    """The estimate alone, to be changed and put back by `with_estimate`."""
    return point.estimate


@pytest.fixture(scope="module")
def with_estimate(point: PointResult) -> Shown:
    """The result with another estimate."""
    return lambda estimate: replace(point, specimen=estimate.specimen, estimate=estimate)


def with_constant(estimate: PointEstimate, **changes: Any) -> PointEstimate:
    """The estimate with its first constant changed."""
    first, *others = estimate.constants
    return replace(estimate, constants=(replace(first, **changes), *others))


def cells(result: PointResult, title: str) -> dict[str, tuple[str, ...]]:
    """The rows of a table behind the answer by their first cell."""
    tables = (t for section in result.report().sections for t in section.tables if t.title == title)
    return {row[0]: row for table in tables for row in table.rows}


def test_the_constants_are_records_in_si_and_rows_in_the_units_of_the_plate_file(point: PointResult) -> None:
    e1 = point.constants["E1"]
    assert e1.verdict is Verdict.DATA
    assert point.to_dict()["constants"]["E1_GPa"]["value"] == pytest.approx(e1.value / 1e9)
    frame = point.to_dataframe().set_index("name")
    assert frame.loc["E1", ["value", "q025", "q975"]].tolist() == pytest.approx(
        [v / 1e9 for v in (e1.value, *e1.interval)]
    )
    assert point.to_dataframe("frequencies")["measured_hz"].tolist() == [114, 167, 218, 289, 300, 497]


def test_constants_frequencies_and_the_search_stand_behind_the_answer(point: PointResult) -> None:
    details = cells(point, "Constants in detail")
    assert details["E1"][4:6] == ("69", "69 +- 6.9 in 10 to 200")
    first = cells(point, "Frequencies, residual = predicted / measured - 1")["1"]
    assert first[:4] == ("1", "(1,1)", "bending", "114")
    assert float(first[4]) == pytest.approx(114.0 * (1.0 + 0.01 * float(first[5])), abs=0.06)
    assert f"{point.estimate.swarm.evaluations} forward solves" in cells(point, "Search")["work"][1]


def test_a_constant_on_a_bound_is_open(identification: PointEstimate, with_estimate: Shown) -> None:
    stuck = with_estimate(
        with_constant(identification, bound="upper", verdict=Verdict.BOTH, value=200e9, interval=None)
    )
    (table,) = stuck.report().summary.tables
    assert table.rows[0][-1] == "not determined: at its upper bound"
    assert 0 in table.flagged
    assert "determine none of the constants" in stuck.report().summary.headline


def test_a_constant_that_is_not_determined_is_flagged(
    identification: PointEstimate, with_estimate: Shown
) -> None:
    prior_sd = identification.specimen.unknowns["E1"].prior.sd
    loose = with_estimate(with_constant(identification, verdict=Verdict.PRIOR, sd=0.87 * prior_sd))
    assert 0 in loose.report().summary.tables[0].flagged
    assert "87 %" in cells(loose, "Constants in detail")["E1"]
    constants = tuple(replace(c, verdict=Verdict.PRIOR) for c in identification.constants)
    none = with_estimate(replace(identification, constants=constants))
    assert "determine none of the constants" in none.report().summary.headline


def test_without_spare_frequencies_there_are_no_intervals(
    identification: PointEstimate, with_estimate: Shown
) -> None:
    constants = tuple(
        replace(c, sd=math.nan, interval=None, verdict=Verdict.PRIOR) for c in identification.constants
    )
    blind = with_estimate(replace(identification, noise=math.nan, constants=constants))
    assert not any("intervals contain" in line for line in blind.report().summary.lines)
    assert cells(blind, "Fit")["noise"][1] == "not known"
    document = blind.to_dict()
    assert json.loads(json_text(document)) == document
    assert document["noise_percent"] is None
    assert document["constants"]["E1_GPa"]["q025"] is None


def test_the_origin_of_the_noise_is_named(identification: PointEstimate, with_estimate: Shown) -> None:
    assert "6 frequencies less 2 unknowns" in cells(with_estimate(identification), "Fit")["noise"][1]
    measurement = identification.specimen.measurement
    assert measurement is not None
    specimen = replace(
        identification.specimen, measurement=replace(measurement, relative_std=0.005, resolution=0.0)
    )
    given = with_estimate(replace(identification, specimen=specimen, noise=0.005, noise_is_inferred=False))
    assert cells(given, "Fit")["noise"][1] == "0.50 % of a frequency, as stated in the plate file"


def test_a_solver_error_or_a_budget_that_matters_is_told(identification: PointEstimate) -> None:
    def codes(**changes: Any) -> set[str]:
        return {n.code for n in point_notices(replace(identification, **changes), "absolute")}

    plain = codes()
    assert codes(noise=1e-4) - plain == {"solver_error"}
    assert codes(error=np.full(6, 0.066), noise=math.nan) - plain == {"solver_error"}
    assert codes(swarm=replace(identification.swarm, status="budget")) - plain == {"swarms_disagree"}


def test_a_search_that_saw_another_misfit_than_the_plate_solver_is_told(
    identification: PointEstimate,
) -> None:
    swarm = replace(identification.swarm, value=6 * 5.0**2)
    found = {n.code: n.facts for n in point_notices(replace(identification, swarm=swarm), "absolute")}
    assert found["search_model"]["reduced"] == pytest.approx(5.0)
    assert identification.specimen.measurement is not None
    measured = identification.specimen.measurement.frequencies
    left = np.array([mode.frequency for mode in identification.predicted[: len(measured)]]) - measured
    assert found["search_model"]["full"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    relative = replace(identification.swarm, value=6 * identification.rms**2)
    codes = {n.code for n in point_notices(replace(identification, swarm=relative), "relative")}
    assert "search_model" not in codes


def with_labels(point: PointResult, *labels: str) -> PointResult:
    measurement = point.specimen.measurement
    assert measurement is not None
    given = replace(measurement, labels=(*labels, *("" for _ in range(measurement.size - len(labels)))))
    specimen = replace(point.specimen, measurement=given)
    return replace(point, specimen=specimen, estimate=replace(point.estimate, specimen=specimen))


def test_labels_that_contradict_the_list_are_checked_first(point: PointResult) -> None:
    first, second = (mode.label for mode in point.estimate.predicted[:2])
    for right in (point, with_labels(point, first, second)):
        assert "cpam-bayes diagnose A1" in right.report().summary.next_step
    swapped = with_labels(point, second, first).report().summary.next_step
    assert "the labels, the edges (free on all four edges)" in swapped


@pytest.mark.parametrize(("factor", "side"), [(0.7, "above"), (1.5, "below")])
def test_a_wrong_thickness_is_the_first_line_of_the_screen(factor: float, side: str) -> None:
    specimen = builtin("A1")
    wrong = factor * specimen.plate.thickness
    result = identify(replace(specimen, plate=replace(specimen.plate, thickness=wrong)), seed=0)
    first = result.report().summary.slips[0]
    assert f"far {side} the reference" in first
    (e1, _) = result.estimate.alone  # the reference does not count in what is compared with it
    right = 1e3 * wrong * (e1.value / 69e9) ** 0.5
    assert f"a thickness of {right:.2f} mm instead of {1e3 * wrong:g} mm" in first
    assert abs(right / (1e3 * specimen.plate.thickness) - 1.0) < 0.02


def test_a_noise_of_a_fifth_is_the_first_line_of_the_screen() -> None:
    specimen = builtin("A1")
    assert specimen.measurement is not None
    noisy = replace(specimen, measurement=replace(specimen.measurement, relative_std=0.2))
    first = identify(noisy, seed=0).summary().splitlines()[1]
    assert first.startswith("  The stated repeatability, 0.2, is 20 % of a frequency")


@pytest.mark.slow
def test_unknown_angles_come_with_the_constants_of_the_sequence_that_is_found() -> None:
    own, short = two_unknown_angles(), SwarmSettings(particles=12, iterations=15)
    result = identify(own, settings=short)
    found, text = result.to_dict(), result.summary(verbose=True)
    assert len(found["angles_deg"]) == 2
    assert set(found["angles_deg"]) <= {-60.0, -30.0, 0.0, 30.0, 60.0, 90.0}
    # the swarm may stop at a lesser sequence: the constants are those of what it says
    known = replace(own.plate, layup=own.plate.layup.with_angles(found["angles_deg"]))
    again = identify(replace(own, plate=known), settings=short).to_dict()
    assert again["constants"] == found["constants"]
    assert found["forward_solves"] > again["forward_solves"]
    assert "angles_deg" not in again
    assert "Best angles found: " in text
    assert "[?/?]_s asked for" in text
    assert re.search(r"found by \d+ fuzzy swarms", text)
