"""Slips that ruin an answer are found, and plates that are as they should be are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model.builtin import plates
from cpam_bayes.forward_model.preconditions import likely_cure
from cpam_bayes.forward_model.slips import (
    count_slips,
    equal_list_slips,
    misfit_slips,
    reference_slips,
    require_reachable,
)
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.specimens import builtin

BUILTIN = [s.name for s in plates().specimens]


def scaled(specimen: Specimen, factor: float, **changes: object) -> Specimen:
    """The specimen with all measured frequencies times a factor."""
    measurement = specimen.measurement
    assert measurement is not None
    frequencies = factor * measurement.frequencies
    return replace(specimen, measurement=replace(measurement, frequencies=frequencies, **changes))


@pytest.mark.parametrize("name", BUILTIN)
def test_every_specimen_of_the_paper_is_within_reach_with_its_angles_known_or_not(name: str) -> None:
    specimen = builtin(name)
    assert require_reachable(specimen) is specimen
    require_reachable(specimen.with_unknown_angles())
    assert reference_slips(specimen) == ()


@pytest.mark.parametrize("name", ["A1", "C1", "D3"])
@pytest.mark.parametrize(
    ("factor", "cure"),
    [
        (1e-3, "kHz for Hz"),
        (1e3, "mHz for Hz"),
        (1.0 / 31.6, "kg for g"),
    ],
)
def test_a_list_in_other_units_is_refused_with_the_likely_cure(name: str, factor: float, cure: str) -> None:
    with pytest.raises(PlateFileError, match=cure):
        require_reachable(scaled(builtin(name), factor))


def test_a_list_that_may_lack_its_first_modes_is_given_the_benefit_of_the_doubt() -> None:
    far = scaled(builtin("A1"), 10.0, complete=False)
    assert require_reachable(far) is far
    with pytest.raises(PlateFileError):
        require_reachable(scaled(builtin("A1"), 1e-3, complete=False))


def test_a_ratio_that_no_unit_explains_has_no_likely_slip() -> None:
    assert "check the units" in likely_cure(3.5)
    assert "likely slip" not in likely_cure(3.5)


@pytest.mark.parametrize(("n", "k", "found"), [(6, 4, 0), (4, 4, 0), (3, 4, 1)])
def test_fewer_frequencies_than_unknowns_are_a_slip(n: int, k: int, found: int) -> None:
    assert len(count_slips(n, k)) == found


@pytest.mark.parametrize(("level", "found"), [(0.029, 0), (0.031, 1), (1100.0, 1)])
def test_a_misfit_above_three_percent_is_a_slip(level: float, found: int) -> None:
    assert len(misfit_slips(level)) == found


@pytest.mark.parametrize(("apart", "found"), [(0.0, 1), (1e-3, 1), (0.02, 0)])
def test_nearly_equal_lists_are_one_measurement(apart: float, found: int) -> None:
    first = builtin("A1")
    second = replace(scaled(first, 1.0 + apart), name="A1 again")
    slips = equal_list_slips([first, second])
    assert len(slips) == found
    assert all("frequencies of A1 and A1 again" in slip for slip in slips)


def test_lists_of_different_length_are_different_plates() -> None:
    first = builtin("A1")
    assert first.measurement is not None
    shorter = replace(first.measurement, frequencies=first.measurement.frequencies[:5], labels=("",) * 5)
    assert equal_list_slips([first, replace(first, measurement=shorter)]) == ()
    assert np.isfinite(shorter.frequencies).all()
