"""The first screen of an identification: what ruins the answer first, and what to check before all else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cpam_bayes.identification.identify import PointResult, identify
from cpam_bayes.plate import builtin


def with_labels(point: PointResult, *labels: str) -> PointResult:
    measurement = point.specimen.measurement
    assert measurement is not None
    given = replace(measurement, labels=(*labels, *("" for _ in range(measurement.size - len(labels)))))
    specimen = replace(point.specimen, measurement=given)
    return replace(point, specimen=specimen, estimate=replace(point.estimate, specimen=specimen))


def steps_of(point: PointResult) -> tuple[list[int], list[int]]:
    """Places of the step that checks the plate and of the one that asks for an accelerometer."""
    steps = point.in_words().next_steps
    check = [i for i, step in enumerate(steps) if step.startswith("Check ")]
    attached = [i for i, step in enumerate(steps) if step.startswith("Was an accelerometer")]
    return check, attached


def test_labels_that_contradict_the_list_are_checked_before_anything_attached(point: PointResult) -> None:
    assert steps_of(point) == ([], [0])
    first, second = (mode.label for mode in point.estimate.predicted[:2])
    assert steps_of(with_labels(point, first, second)) == ([], [0])
    swapped = with_labels(point, second, first)
    assert steps_of(swapped) == ([0], [1])
    step = swapped.in_words().next_steps[0]
    assert step == (
        "Check the labels, the edges (free on all four edges) and the order and completeness of the list: "
        "these frequencies contradict the plate model."
    )


def test_a_plate_model_that_does_not_describe_the_list_is_checked_first(point: PointResult) -> None:
    slip = "the plate model does not describe these frequencies: and so on"
    assert steps_of(replace(point, slips=(slip,), warnings=(slip,))) == ([0], [1])
    other = "2 frequencies for 3 unknowns"
    assert steps_of(replace(point, slips=(other,), warnings=(other,))) == ([], [0])


@pytest.mark.parametrize(("factor", "side"), [(0.7, "above"), (1.5, "below")])
def test_a_wrong_thickness_is_the_first_line_of_the_screen(factor: float, side: str) -> None:
    specimen = builtin("A1")
    wrong = factor * specimen.plate.thickness
    result = identify(replace(specimen, plate=replace(specimen.plate, thickness=wrong)), seed=0)
    first = result.summary().splitlines()[1]
    assert f"lies far {side} its reference" in first
    modulus = result.constants["E1"]
    right = 1e3 * wrong * (modulus / 69e9) ** 0.5
    assert f"a true thickness of {right:.2f} mm for thickness_mm = {1e3 * wrong:g}" in first
    assert abs(right / (1e3 * specimen.plate.thickness) - 1.0) < 0.02


def test_a_noise_of_a_fifth_is_the_first_line_of_the_screen() -> None:
    specimen = builtin("A1")
    assert specimen.measurement is not None
    noisy = replace(specimen, measurement=replace(specimen.measurement, relative_std=0.2))
    first = identify(noisy, seed=0).summary().splitlines()[1]
    assert first.startswith("  The stated noise, relative_std = 0.2, is 20 % of a frequency")
