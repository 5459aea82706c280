"""Different plies, equal laminates: lamination parameters, stiffness and the frequencies that follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.inference.equal_laminates import equal_laminates, lamination_parameters
from cpam_bayes.inference.sequence_classes import classes
from cpam_bayes.inference.symmetries import plate_symmetries
from cpam_bayes.laminate import ENERGY_CONSISTENT, FIVE_SIXTHS, laminate_geometry
from cpam_bayes.layup import parse_layup
from cpam_bayes.measurement import Specimen
from cpam_bayes.measurement.records import angle_grid
from tests.inference.plate_cases import SIDE, frequencies, unknown_plate

# Prouhet's sets: the plies 1, 4, 6, 7 and the plies 2, 3, 5, 8 have equal sums of places and of their
# squares, so both choices of 0 and 90 make one D and one A; each is the other turned by 90 degrees.
PROUHET = "[?/?/?/?/?/?/?/?]_s"
ZERO, RIGHT = 5, 11  # grid indices on 15 degrees


def prouhet_rows() -> np.ndarray:
    first = np.array([ZERO, RIGHT, RIGHT, ZERO, RIGHT, ZERO, ZERO, RIGHT])
    return np.array([first, ZERO + RIGHT - first])


@pytest.mark.parametrize("layup", ["[?/?]_s", "[?/20/?]", "[(?/?)_2/30]_s"])
def test_lamination_parameters_are_the_integrals_of_the_laminate(layup: str) -> None:
    found = parse_layup(layup)
    grid = angle_grid(15.0)
    rows = np.array([[0, 3], [7, 11], [5, 5]])
    geometry = laminate_geometry(found.angles(grid[rows]))
    got = lamination_parameters(found, grid, rows)
    for part, factor, integral in (
        (0, 1.0, geometry.in_plane),
        (1, 4.0, geometry.coupling),
        (2, 12.0, geometry.flexural),
    ):
        np.testing.assert_allclose(got[:, part], factor * integral[:, 1:], atol=1e-14)


def test_layups_with_one_d_are_equal_where_the_shear_stiffness_is_that_of_the_plies() -> None:
    specimen = unknown_plate(PROUHET, width=0.15)
    rows = prouhet_rows()
    parameters = lamination_parameters(specimen.plate.layup, angle_grid(15.0), rows)
    np.testing.assert_allclose(parameters[0], parameters[1], atol=1e-14)
    assert equal_laminates(specimen, rows, shear=FIVE_SIXTHS).tolist() == [0, 0]


def test_the_order_of_plies_enters_the_energy_consistent_shear_stiffness() -> None:
    specimen = unknown_plate(PROUHET, width=0.15)
    rows = prouhet_rows()
    assert equal_laminates(specimen, rows, shear=ENERGY_CONSISTENT).tolist() == [0, 1]
    f = frequencies(specimen, angle_grid(15.0)[rows])
    # nothing but shear is left to tell them apart, in a plate fifteen times as wide as thick
    assert 1e-6 < np.max(np.abs(f[1] / f[0] - 1.0)) < 1e-2


def test_equal_after_a_turn_of_the_square() -> None:
    rows = prouhet_rows()
    assert equal_laminates(unknown_plate(PROUHET, width=SIDE), rows).tolist() == [0, 0]


def test_bending_alone_does_not_see_the_membrane() -> None:
    # E1 = E2 has no part in it: thin outer plies carry D, all carry A
    specimen = unknown_plate("[(?/?)_2]_s", width=0.15)
    rows = np.array([[1, 4], [4, 1], [1, 4]])
    assert equal_laminates(specimen, rows, bending_only=True).tolist() == [0, 1, 0]


@pytest.mark.parametrize("layup", ["[?/?]_s", "[?/?]", "[0/?/?]", "[45/?/?/-45]"])
@pytest.mark.parametrize("width", [SIDE, 0.15])
def test_groups_hold_the_classes_of_the_plate_and_equal_frequencies(layup: str, width: float) -> None:
    specimen = unknown_plate(layup, width=width, step=22.5)
    grid = angle_grid(22.5)
    rows = np.stack(np.meshgrid(np.arange(8), np.arange(8), indexing="ij"), axis=-1).reshape(-1, 2)
    groups = equal_laminates(specimen, rows)
    assert np.array_equal(groups[groups], groups), "each group is named by a member"
    label = classes(rows, plate_symmetries(specimen)).label
    for own in np.unique(label):
        assert len(set(groups[label == own])) == 1
    _assert_equal_within_groups(specimen, grid, rows, groups)


def _assert_equal_within_groups(
    specimen: Specimen, grid: np.ndarray, rows: np.ndarray, groups: np.ndarray
) -> None:
    name, count = np.unique(groups, return_counts=True)
    for own in name[np.argsort(count)[::-1]][:2]:
        f = frequencies(specimen, grid[rows[groups == own]])
        # rounding of the space, as in the tests of symmetries
        np.testing.assert_allclose(f, np.broadcast_to(f[0], f.shape), rtol=1e-9)


def test_no_two_sequences_of_a_two_angle_laminate_share_a_stiffness_but_by_symmetry() -> None:
    specimen = replace(unknown_plate("[(?/?)_8]_s"), angle_grid_deg=5.0)
    rows = np.stack(np.meshgrid(np.arange(36), np.arange(36), indexing="ij"), axis=-1).reshape(-1, 2)
    groups = equal_laminates(specimen, rows)
    assert len(np.unique(groups)) == len(classes(rows, plate_symmetries(specimen)).size)


def test_a_coarse_tolerance_and_bending_of_an_unsymmetric_layup_are_refused() -> None:
    specimen = unknown_plate("[?/?]")
    with pytest.raises(ValueError, match=r"tolerance .*received 0.01"):
        equal_laminates(specimen, np.array([[0, 1]]), tolerance=0.01)
    with pytest.raises(ValueError, match="not symmetric"):
        equal_laminates(specimen, np.array([[0, 1]]), bending_only=True)
