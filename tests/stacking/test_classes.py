"""Classes of sequences: representatives, sizes and members, against explicit orbits."""

from __future__ import annotations

import numpy as np
import pytest

from cpam_bayes.stacking.symmetry.classes import canonical, classes, members
from cpam_bayes.stacking.symmetry.symmetries import image, plate_symmetries
from tests.inference.plate_cases import SIDE, unknown_plate

LAYUPS = ("[?/?/?]_s", "[?/?/?]", "[0/?/?/?]", "[?_2/?/?]", "[(?/?)_2]", "[45/?/?/-45]", "[0/?/?/90]")


def every_sequence(n_grid: int, n_unknown: int, dtype: type = np.int64) -> np.ndarray:
    axes = [np.arange(n_grid, dtype=dtype)] * n_unknown
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, n_unknown)


@pytest.mark.parametrize("width", [SIDE, 0.15])
@pytest.mark.parametrize("layup", LAYUPS)
def test_classes_are_the_orbits_of_the_symmetries(layup: str, width: float) -> None:
    specimen = unknown_plate(layup, width=width, step=30.0)
    symmetries = plate_symmetries(specimen)
    rows = every_sequence(6, specimen.plate.layup.n_unknown)
    orbits = canonical(rows, symmetries)
    # the slow way: images one row at a time
    for i, row in enumerate(rows):
        orbit = {tuple(row)}
        for symmetry in symmetries:
            moved, holds = image(row[None], symmetry)
            if holds[0]:
                orbit.add(tuple(moved[0]))
        assert tuple(orbits.representative[i]) == min(orbit)
        assert orbits.size[i] == len(orbit)
        assert {tuple(m) for m in members(row, symmetries)} == orbit
    # orbits that share a member are the same orbit
    again = canonical(orbits.representative, symmetries)
    assert np.array_equal(again.representative, orbits.representative)
    assert np.array_equal(again.size, orbits.size)


@pytest.mark.parametrize("layup", LAYUPS)
def test_sizes_of_all_classes_add_up_to_the_grid(layup: str) -> None:
    specimen = unknown_plate(layup, step=30.0)
    symmetries = plate_symmetries(specimen)
    rows = every_sequence(6, specimen.plate.layup.n_unknown)
    found = classes(rows, symmetries)
    assert found.size.sum() == len(rows)
    assert np.array_equal(found.size, found.present)
    representative = canonical(rows, symmetries).representative
    assert np.array_equal(rows[np.all(rows == representative, axis=1)], found.representative)
    assert np.array_equal(found.representative[found.label], representative)


def test_number_of_classes_is_burnsides() -> None:
    # C1's square: 12 angles, 3 plies; mirrored 2 angles stay (0, 90), turned none, on the diagonal two
    specimen = unknown_plate("[?/?/?]_s")
    rows = every_sequence(12, 3)
    assert len(classes(rows, plate_symmetries(specimen)).size) == (12**3 + 2**3 + 0 + 2**3) // 4


def test_a_class_is_counted_whole_when_few_of_its_members_are_there() -> None:
    specimen = unknown_plate("[?/?/?]_s")
    symmetries = plate_symmetries(specimen)
    all_of_it = members(np.array([1, 2, 3]), symmetries)
    found = classes(all_of_it[[0, 2]], symmetries)
    assert (found.size.tolist(), found.present.tolist(), found.label.tolist()) == ([4], [2], [0, 0])


def test_a_stack_longer_than_a_block_is_handled_alike() -> None:
    specimen = unknown_plate("[0/?/?/?]", step=5.0)
    symmetries = plate_symmetries(specimen)
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 36, (300_000, 3)).astype(np.uint8)
    orbits = canonical(rows, symmetries)
    part = canonical(rows[140_000:140_100], symmetries)
    assert orbits.representative.dtype == np.uint8
    assert np.array_equal(orbits.representative[140_000:140_100], part.representative)
    assert np.array_equal(orbits.size[140_000:140_100], part.size)


def test_a_plate_without_symmetries_keeps_every_sequence_apart() -> None:
    specimen = unknown_plate("[?/?]_s", edges="CSFF")
    rows = every_sequence(12, 2)
    assert plate_symmetries(specimen) == ()
    found = classes(rows, ())
    assert len(found.size) == len(rows)
    assert np.array_equal(canonical(rows, ()).representative, rows)
    assert members(rows[7], ()).tolist() == [rows[7].tolist()]


def test_an_empty_stack_has_no_classes() -> None:
    symmetries = plate_symmetries(unknown_plate("[?/?]_s"))
    assert len(classes(np.empty((0, 2), dtype=int), symmetries).size) == 0


def test_more_sequences_than_numbers_are_refused() -> None:
    specimen = unknown_plate("[" + "/".join("?" * 13) + "]_s", step=5.0)
    with pytest.raises(ValueError, match=r"13 unknown angles on a grid of 36: .*coarser"):
        canonical(np.zeros((1, 13), dtype=int), plate_symmetries(specimen))
