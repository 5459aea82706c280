"""`identify` by the swarm: determined constants, ruinous errors, and first checks."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.answer import Verdict
from cpam_bayes.identification.point import point_notices
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import builtin
from cpam_bayes.questions.identify import identify
from cpam_bayes.render.report import json_text
from tests.answers import answered
from tests.plates import with_plate
from tests.stacking.cases import specimen as two_unknown_angles


@pytest.fixture(scope="module")
def point():
    return answered("identify")


def with_estimate(point, **changes):
    estimate = replace(point.estimate, **changes)
    return replace(point, specimen=estimate.specimen, estimate=estimate)


def with_constants(point, n, **changes):
    own = point.estimate.constants
    return with_estimate(point, constants=(*(replace(c, **changes) for c in own[:n]), *own[n:]))


def with_measurement(point, **changes):
    own = point.specimen
    return with_estimate(point, specimen=replace(own, measurement=replace(own.measurement, **changes)))


def cells(result, title):
    tables = (t for section in result.report().sections for t in section.tables if t.title == title)
    return {row[0]: row for table in tables for row in table.rows}


def test_constants_are_records_in_si_and_rows_in_the_units_of_the_plate_file(point):
    e1 = point.constants["E1"]
    assert e1.verdict is Verdict.DATA
    in_gpa = [v / 1e9 for v in (e1.value, *e1.interval)]
    assert point.to_dict()["constants"]["E1_GPa"]["value"] == pytest.approx(in_gpa[0])
    frame = point.to_dataframe().set_index("name")
    assert frame.loc["E1", ["value", "q025", "q975"]].tolist() == pytest.approx(in_gpa)
    assert point.to_dataframe("frequencies")["measured_hz"].tolist() == [114, 167, 218, 289, 300, 497]
    assert cells(point, "Constants in detail")["E1"][4:6] == ("69", "69 +- 6.9 in 10 to 200")
    first = cells(point, "Frequencies, residual = predicted / measured - 1")["1"]
    assert first[:4] == ("1", "(1,1)", "bending", "114")
    assert float(first[4]) == pytest.approx(114.0 * (1.0 + 0.01 * float(first[5])), abs=0.06)
    assert f"{point.estimate.swarm.evaluations} forward solves" in cells(point, "Search")["work"][1]


def test_a_constant_that_is_not_determined_is_flagged_with_the_reason(point):
    stuck = with_constants(point, 1, bound="upper", verdict=Verdict.BOTH, value=200e9, interval=None)
    prior_sd = point.specimen.unknowns["E1"].prior.sd
    loose = with_constants(point, 1, verdict=Verdict.PRIOR, sd=0.87 * prior_sd)
    tables = [one.report().summary.tables[0] for one in (stuck, loose)]
    assert all(0 in table.flagged for table in tables)
    assert tables[0].rows[0][-1] == "not determined: at its upper bound"
    assert "87 %" in cells(loose, "Constants in detail")["E1"]
    for none in (stuck, with_constants(point, 2, verdict=Verdict.PRIOR)):
        assert "determine none of the constants" in none.report().summary.headline


def test_the_origin_of_the_noise_is_named_and_without_spare_frequencies_there_are_no_intervals(point):
    stated = with_measurement(point, relative_std=0.005, resolution=0.0)
    given = with_estimate(stated, noise=0.005, noise_is_inferred=False)
    unknown = with_constants(point, 2, sd=math.nan, interval=None, verdict=Verdict.PRIOR)
    blind = with_estimate(unknown, noise=math.nan)
    noise = [cells(result, "Fit")["noise"][1] for result in (point, given, blind)]
    assert "6 frequencies minus 2 unknowns" in noise[0]
    assert noise[1:] == ["0.50 % of a frequency, as stated in the plate file", "not known"]
    assert not any("intervals contain" in line for line in blind.report().summary.lines)
    document = blind.to_dict()
    assert json.loads(json_text(document)) == document
    assert (document["noise_percent"], document["constants"]["E1_GPa"]["q025"]) == (None, None)


def test_a_solver_error_a_budget_and_another_misfit_of_the_search_are_told(point):
    estimate, swarm = point.estimate, point.estimate.swarm

    def told(residuals="absolute", **changes):
        return {n.code: n.facts for n in point_notices(replace(estimate, **changes), residuals)}

    plain = set(told())
    assert set(told(noise=1e-4)) - plain == {"solver_error"}
    assert set(told(error=np.full(6, 0.066), noise=math.nan)) - plain == {"solver_error"}
    assert set(told(swarm=replace(swarm, status="budget"))) - plain == {"swarms_disagree"}
    search = told(swarm=replace(swarm, value=6 * 5.0**2))["search_model"]
    assert search["reduced"] == pytest.approx(5.0)
    left = (
        np.array([mode.frequency for mode in estimate.predicted[:6]]) - point.specimen.measurement.frequencies
    )
    assert search["full"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-6)
    assert "search_model" not in told("relative", swarm=replace(swarm, value=6 * estimate.rms**2))


def test_labels_that_contradict_the_list_are_checked_first(point):
    def next_step(*labels):
        return with_measurement(point, labels=(*labels, *[""] * (6 - len(labels)))).report().summary.next_step

    first, second = (mode.label for mode in point.estimate.predicted[:2])
    for right in ((), (first, second)):
        assert "cpam-bayes diagnose A1" in next_step(*right)
    assert "the labels, the edges (free on all four edges)" in next_step(second, first)


@pytest.mark.parametrize(("factor", "side"), [(0.7, "above"), (1.5, "below")])
def test_a_wrong_thickness_is_the_first_line_of_the_screen(factor, side):
    wrong = factor * builtin("A1").plate.thickness
    result = identify(with_plate("A1", thickness=wrong), seed=0)
    first = result.report().summary.slips[0]
    assert f"far {side} the reference" in first
    (e1, _) = result.estimate.alone  # the reference is not used in a comparison with it
    right = 1e3 * wrong * (e1.value / 69e9) ** 0.5
    assert f"a thickness of {right:.2f} mm instead of {1e3 * wrong:g} mm" in first
    assert abs(right * factor / (1e3 * wrong) - 1.0) < 0.02


def test_a_noise_of_a_fifth_is_the_first_line_of_the_screen(point):
    first = identify(with_measurement(point, relative_std=0.2).specimen, seed=0).summary().splitlines()[1]
    assert first.startswith("  The stated repeatability, 0.2, is 20 % of a frequency")


@pytest.mark.slow
def test_unknown_angles_come_with_the_constants_of_the_sequence_that_is_found():
    own, short = two_unknown_angles(), SwarmSettings(particles=12, iterations=15)
    result = identify(own, settings=short)
    found, text = result.to_dict(), result.summary(verbose=True)
    assert len(found["angles_deg"]) == 2
    assert set(found["angles_deg"]) <= {-60.0, -30.0, 0.0, 30.0, 60.0, 90.0}
    # the swarm may stop at a lesser sequence: the constants belong to the one reported
    known = replace(own.plate, layup=own.plate.layup.with_angles(found["angles_deg"]))
    again = identify(replace(own, plate=known), settings=short).to_dict()
    assert again["constants"] == found["constants"]
    assert found["forward_solves"] > again["forward_solves"]
    assert "angles_deg" not in again
    assert all(part in text for part in ("Best angles found: ", "[?/?]_s asked for"))
    assert re.search(r"found by \d+ fuzzy swarms", text)
