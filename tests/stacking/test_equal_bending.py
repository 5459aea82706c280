"""Sequences with the same bending stiffness, against all of a grid and against the full plate model."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cpam_bayes.forward_model.model import converged_model, reference_vector
from cpam_bayes.plate import Measurement, Specimen, angle_grid, builtin
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking.posterior import stacking_posterior
from cpam_bayes.stacking.records import StackingPosterior, StackingSettings, equal_bending
from cpam_bayes.stacking.symmetry import all_sequences, ply_sums
from tests.stacking.cases import with_layup

# 6^3 - 5^3 + 2^3 - 1^3 = 5^3 - 3^3: the first and the fifth ply weigh as much as the second and the third.
LAYUP = "[?/?/?/0/?/0]_s"
STEP = 45.0
# Thickness over that of C1: length over thickness 200, and 16.
THIN, THICK = 0.4, 5.0


def specimen(thickness: float) -> Specimen:
    """A plate of twelve plies whose list is that of the sequence 0/90/90/0."""
    own = builtin("C1")
    own = replace(own, plate=replace(own.plate, thickness=thickness * own.plate.thickness))
    frequencies = frequencies_of(own, "[0/90/90/0/0/0]_s")
    listed = Measurement(frequencies, 0.0, 0.005, None, ("",) * 6, complete=True)
    return replace(with_layup(own, parse_layup(LAYUP)), measurement=listed, angle_grid_deg=STEP)


def frequencies_of(own: Specimen, layup: str) -> np.ndarray:
    model = converged_model(with_layup(own, parse_layup(layup)), own.unknowns, 6)
    return model.predict(reference_vector(own, own.unknowns)).frequencies[0, :6]


@cache
def answer(thickness: float) -> StackingPosterior:
    settings = StackingSettings(draws=40, listed=40, log2_points=7)
    return stacking_posterior(specimen(thickness), 0, settings=settings)


@pytest.mark.parametrize(("layup", "step"), [(LAYUP, 15.0), ("[?/?]_s", 15.0)])
def test_what_is_found_is_what_a_look_at_all_finds(layup: str, step: float) -> None:
    grid = angle_grid(step)
    sums = ply_sums(parse_layup(layup), grid)
    k = sums.n_unknown
    every = all_sequences(len(grid), k)
    v = sums.first[np.arange(k), every].sum(axis=1)
    rng = np.random.default_rng(1)
    asked = every[rng.integers(len(every), size=12)]
    if k > 2:
        asked[0] = 0, 3, 3, 0
    for target, found in zip(asked, equal_bending(sums, asked), strict=True):
        at = v[np.all(every == target, axis=1)][0]
        expected = every[np.all(np.abs(v - at) < 1e-9, axis=1)]
        assert {tuple(s) for s in found} == {tuple(s) for s in expected}
    if k > 2:
        assert len(equal_bending(sums, asked[:1])[0]) > 1


def row_of(found: StackingPosterior, angles: list[float]) -> int:
    grid = found.grid_deg.tolist()
    return int(found.classes_of(np.array([[grid.index(a) for a in angles]]))[0])


@pytest.mark.slow
def test_classes_of_equal_bending_are_merged_where_the_plate_is_thin() -> None:
    found = answer(THIN)
    row = row_of(found, [0, 90, 90, 0])
    assert row >= 0
    assert row_of(found, [90, 0, 0, 90]) == row
    members = found.grid_deg[found.class_members(row)].tolist()
    assert sorted(members) == [[0, 90, 90, 0], [90, 0, 0, 90]]
    assert found.multiplicity[row] == 2
    assert len(found.same_bending[row]) == len(found.alike[row]) == 1
    # what is merged stands in one class only
    everyone = np.concatenate([found.class_members(i) for i in range(len(found.top))])
    assert len(np.unique(everyone, axis=0)) == len(everyone) == found.multiplicity.sum()
    assert np.all(np.diff(found.probability) <= 1e-15)
    assert float(found.probability @ found.multiplicity) <= 1.0 + 1e-9
    rows = np.repeat(np.arange(len(found.top)), found.multiplicity)
    assert found.classes_of(everyone).tolist() == rows.tolist()


@pytest.mark.slow
def test_a_thick_plate_tells_them_apart_by_its_shear() -> None:
    found = answer(THICK)
    row = row_of(found, [0, 90, 90, 0])
    assert row != row_of(found, [90, 0, 0, 90])
    assert found.grid_deg[found.same_bending[row]].tolist() == [[90, 0, 0, 90]]
    assert not any(len(others) for others in found.alike)


@pytest.mark.parametrize(("thickness", "least", "most"), [(THIN, 0.0, 1e-4), (THICK, 5e-3, 0.5)])
def test_the_full_model_says_so_too(thickness: float, least: float, most: float) -> None:
    own = specimen(thickness)
    one, other = (frequencies_of(own, layup) for layup in ("[0/90/90/0/0/0]_s", "[90/0/0/0/90/0]_s"))
    assert least <= np.abs(other / one - 1.0).max() < most
