"""Sequences that no frequency tells apart: relevant symmetries, their classes, equal bending stiffness."""

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.forward_model.model import converged_model, reference_vector
from cpam_bayes.plate import Measurement, Sensor, Specimen, angle_grid, builtin
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.stacking import symmetry as module
from cpam_bayes.stacking.posterior import stacking_posterior
from cpam_bayes.stacking.records import StackingPosterior, StackingSettings, equal_bending
from cpam_bayes.stacking.symmetry import canonical, classes, image, members, plate_symmetries, ply_sums
from tests.stacking.cases import SIDE, frequencies, unknown_plate, with_layup

MIRROR, TURN, DIAGONAL = "mirror image", "quarter turn", "diagonal mirror image"
# A symmetry of the plate is one of the space too: only rounding remains, 1e-16 of the range of K.
ROUNDING = 1e-9
REAL = 1e-4  # Real shifts of frequencies, far above rounding.


def names(specimen: Specimen) -> list[str]:
    return [symmetry.name for symmetry in plate_symmetries(specimen)]


def find(specimen: Specimen, name: str) -> module.Symmetry:
    return plate_symmetries(specimen)[names(specimen).index(name)]


# Members of a class have the same frequencies. Cases: changes of the square plate, and its symmetries.
AROUND = tuple(Sensor(0.05, x, y) for x, y in ((0.03, 0.07), (0.13, 0.03), (0.17, 0.13), (0.07, 0.17)))
OVER = "upside down"
CASES = {
    "square": ({}, [MIRROR, TURN, DIAGONAL]),
    "rectangle": ({"width": 0.15}, [MIRROR]),
    "clamped on neighbouring edges": ({"edges": "CCFF"}, [DIAGONAL]),
    "clamped opposite a simple support": ({"edges": "CFSF"}, [MIRROR]),
    "no edge like another": ({"edges": "CSFF"}, []),
    "mass in the middle": ({"sensors": (Sensor(0.05, SIDE / 2, SIDE / 2),)}, [MIRROR, TURN, DIAGONAL]),
    "mass on the middle line": ({"sensors": (Sensor(0.05, 0.03, SIDE / 2),)}, [MIRROR]),
    "mass in a corner": ({"sensors": (Sensor(0.05, 0.19, 0.19),)}, [DIAGONAL]),
    "masses that turn into each other": ({"sensors": AROUND}, [TURN]),
    "unsymmetric": ({"layup": "[?/?/?]", "width": 0.15}, [MIRROR, OVER, f"{MIRROR} {OVER}"]),
    "known plies that are mirrored": ({"layup": "[0/?/90/?]_s"}, [MIRROR]),
    "known ply on the diagonal": ({"layup": "[45/?]_s"}, [DIAGONAL]),
    "mirrored when upside down": ({"layup": "[45/?/?/-45]", "width": 0.15}, [f"{MIRROR} {OVER}"]),
    "turned when upside down": ({"layup": "[0/?/?/90]"}, [MIRROR, f"{TURN} {OVER}", f"{DIAGONAL} {OVER}"]),
}


@pytest.mark.parametrize(("changes", "expected"), CASES.values(), ids=CASES)
def test_sequences_of_one_class_have_equal_frequencies(changes, expected: list[str]) -> None:
    specimen = unknown_plate(**changes)
    assert names(specimen) == expected
    grid = angle_grid(specimen.angle_grid_deg)
    for generic in ((1, 4, 8), (4, 2, 9)):
        row = np.array(generic[: specimen.plate.layup.n_unknown])
        found = frequencies(specimen, grid[members(row, plate_symmetries(specimen))])
        assert len(found) == 1 + len(expected), "a sequence without a symmetry of its own"
        np.testing.assert_allclose(found, np.broadcast_to(found[0], found.shape), rtol=ROUNDING)


@pytest.mark.parametrize("case", [name for name in CASES if "layup" not in CASES[name][0]])
def test_symmetries_that_the_plate_lacks_do_change_its_frequencies(case: str) -> None:
    changes, kept = CASES[case]
    specimen, row = unknown_plate(**changes), np.array([[3, 9]])
    grid = angle_grid(specimen.angle_grid_deg)
    own = frequencies(specimen, grid[row])
    for name in {MIRROR, TURN, DIAGONAL}.difference(kept):
        other, _ = image(row, find(unknown_plate(), name))
        assert np.max(np.abs(frequencies(specimen, grid[other]) / own - 1.0)) > REAL, name


def test_upside_down_a_known_ply_changes_places_with_one_of_its_angle_and_a_group_ties_its_angles() -> None:
    specimen = unknown_plate("[0/?/?/?]", width=0.15)
    grid = angle_grid(specimen.angle_grid_deg)
    zero = int(np.flatnonzero(grid == 0.0)[0])
    rows = np.array([[3, 8, zero], [3, 8, 4]])
    moved, holds = image(rows, find(specimen, "upside down"))
    assert (holds.tolist(), moved[0].tolist()) == ([True, False], [8, 3, zero])
    found = members(rows[0], plate_symmetries(specimen))
    assert [8, 3, zero] in found.tolist()
    assert len(found) == 4, "mirrored, upside down, and both"
    assert len(members(rows[1], plate_symmetries(specimen))) == 2, "mirrored alone"
    f = frequencies(specimen, grid[found])
    np.testing.assert_allclose(f, np.broadcast_to(f[0], f.shape), rtol=ROUNDING)
    # upside down u0 u1 0 u0 u1 is u1 u0 0 u1 u0, and u0 u0 u1 is u1 u0 u0, which needs u0 = u1
    assert find(unknown_plate("[?/?/0/?/?]", width=0.15), "upside down").source.tolist() == [3, 2, 1, 0]
    symmetry = find(unknown_plate("[?_2/?]", width=0.15), "upside down")
    assert symmetry.ties == ((0, 1),)
    assert not symmetry.everywhere
    assert image(np.array([[4, 4], [4, 5]]), symmetry)[1].tolist() == [True, False]


@pytest.mark.parametrize("step", [1.0, 5.0, 7.5, 36.0, 60.0, 180.0])
def test_angles_of_an_image_are_those_of_the_motion(step: float) -> None:
    specimen, grid = unknown_plate(step=step), angle_grid(step)
    motions = {MIRROR: lambda t: -t, TURN: lambda t: t + 90.0, DIAGONAL: lambda t: 90.0 - t}
    rows = np.array(list(product(range(len(grid)), repeat=2)))
    for symmetry in plate_symmetries(specimen):
        moved, holds = image(rows, symmetry)
        assert holds.all()
        apart = grid[moved] - motions[symmetry.name](grid[rows])
        np.testing.assert_allclose(np.abs((apart + 90.0) % 180.0 - 90.0), 0.0, atol=1e-9)


def test_a_grid_sizes_labels_and_a_mesh_may_leave_fewer_symmetries() -> None:
    assert names(unknown_plate(step=36.0)) == [MIRROR]  # 18 turns into -72, not on the grid
    assert names(unknown_plate(step=90.0)) == [TURN], "mirroring changes neither 0 nor 90"
    assert names(unknown_plate("[22.5/?/?]", width=0.15)) == []  # a known angle off the grid
    assert names(unknown_plate("[22.5/?/-22.5]", width=0.15)) == [f"{MIRROR} {OVER}"]
    square = unknown_plate()
    for sd, expected in (({"length": 1e-4, "width": 1e-4}, 3), ({"length": 1e-4}, 1)):
        assert len(plate_symmetries(replace(square, plate=replace(square.plate, sd=sd)))) == expected
    labels = ("(1,1)", *[""] * (square.measurement.size - 1))  # labels distinguish along from across
    assert names(replace(square, measurement=replace(square.measurement, labels=labels))) == [MIRROR]
    unsymmetric = unknown_plate("[?/?]")  # meshes are not examined
    meshed = replace(unsymmetric, plate=replace(unsymmetric.plate, mesh=Path("plate.msh")))
    assert module.plane_motions(meshed) == ("",)
    assert names(meshed) == ["upside down"]


def test_sequences_that_do_not_fit_are_refused() -> None:
    for rows in ([[0, 12]], [[-1, 0]], [[0]], [[0.0, 1.0]]):
        with pytest.raises(ValueError, match="sequences: received"):
            image(np.array(rows), find(unknown_plate(), MIRROR))
    many = plate_symmetries(unknown_plate("[" + "/".join("?" * 13) + "]_s", step=5.0))
    with pytest.raises(ValueError, match=r"13 unknown angles on a grid of 36: .*coarser"):
        canonical(np.zeros((1, 13), dtype=int), many)


# square, rectangle, asymmetric
SQUARE = ("[?/?/?]_s", "[0/?/?/?]", "[?_2/?/?]", "[(?/?)_2]", "[0/?/?/90]")
PLATES = (*((layup, SIDE) for layup in SQUARE), ("[45/?/?/-45]", 0.15), ("[22.5/?/?]", 0.15))


@pytest.mark.parametrize(("layup", "width"), PLATES)
def test_classes_are_the_orbits_of_the_symmetries(layup: str, width: float) -> None:
    specimen = unknown_plate(layup, width=width, step=30.0)
    symmetries = plate_symmetries(specimen)
    rows = np.array(list(product(range(6), repeat=specimen.plate.layup.n_unknown)))
    orbits = canonical(rows, symmetries)
    for i, row in enumerate(rows):  # slowly: images one row at a time
        orbit = {tuple(row)}
        for symmetry in symmetries:
            moved, holds = image(row[None], symmetry)
            if holds[0]:
                orbit.add(tuple(moved[0]))
        assert (tuple(orbits.representative[i]), orbits.size[i]) == (min(orbit), len(orbit))
        assert {tuple(m) for m in members(row, symmetries)} == orbit
    again = canonical(orbits.representative, symmetries)  # orbits with a common member are equal
    assert np.array_equal(again.representative, orbits.representative)
    assert np.array_equal(again.size, orbits.size)
    found = classes(rows, symmetries)
    assert found.size.sum() == len(rows)
    assert np.array_equal(found.size, found.present)
    assert np.array_equal(found.representative[found.label], orbits.representative)


def test_a_class_is_counted_whole_when_few_of_its_members_are_there_and_in_a_stack_longer_than_a_block() -> (
    None
):
    symmetries = plate_symmetries(unknown_plate("[?/?/?]_s"))
    all_of_it = members(np.array([1, 2, 3]), symmetries)
    found = classes(all_of_it[[0, 2]], symmetries)
    assert (found.size.tolist(), found.present.tolist(), found.label.tolist()) == ([4], [2], [0, 0])
    assert len(classes(all_of_it[:0], symmetries).size) == 0
    symmetries = plate_symmetries(unknown_plate("[0/?/?/?]", step=5.0))  # a stack longer than a block
    rows = np.random.default_rng(0).integers(0, 36, (300_000, 3)).astype(np.uint8)
    orbits, part = canonical(rows, symmetries), slice(140_000, 140_100)
    alone = canonical(rows[part], symmetries)
    assert orbits.representative.dtype == np.uint8
    assert np.array_equal(orbits.representative[part], alone.representative)
    assert np.array_equal(orbits.size[part], alone.size)


# 6^3 - 5^3 + 2^3 - 1^3 = 5^3 - 3^3: the first and fifth plies count as much as the second and third.
LAYUP = "[?/?/?/0/?/0]_s"
THIN, THICK = 0.4, 5.0  # Thickness relative to C1's: length over thickness 200 and 16.


def specimen(thickness: float) -> Specimen:
    """A plate of twelve plies whose list is that of the sequence 0/90/90/0."""
    own = builtin("C1")
    own = replace(own, plate=replace(own.plate, thickness=thickness * own.plate.thickness))
    frequencies = frequencies_of(own, "[0/90/90/0/0/0]_s")
    listed = Measurement(frequencies, 0.0, 0.005, None, ("",) * 6, complete=True)
    return replace(with_layup(own, parse_layup(LAYUP)), measurement=listed, angle_grid_deg=45.0)


def frequencies_of(own: Specimen, layup: str) -> np.ndarray:
    model = converged_model(with_layup(own, parse_layup(layup)), own.unknowns, 6)
    return model.predict(reference_vector(own, own.unknowns)).frequencies[0, :6]


@cache
def answer(thickness: float) -> StackingPosterior:
    settings = StackingSettings(draws=40, listed=40, log2_points=7)
    return stacking_posterior(specimen(thickness), 0, settings=settings)


@pytest.mark.parametrize("layup", [LAYUP, "[?/?]_s"])
def test_what_is_found_is_what_a_look_at_all_finds(layup: str) -> None:
    grid = angle_grid(15.0)
    sums = ply_sums(parse_layup(layup), grid)
    k = sums.n_unknown
    every = module.all_sequences(len(grid), k)
    v = sums.first[np.arange(k), every].sum(axis=1)
    asked = every[np.random.default_rng(1).integers(len(every), size=12)]
    if k > 2:
        asked[0] = 0, 3, 3, 0
    for target, found in zip(asked, equal_bending(sums, asked), strict=True):
        expected = every[np.all(np.abs(v - v[np.all(every == target, axis=1)][0]) < 1e-9, axis=1)]
        assert {tuple(s) for s in found} == {tuple(s) for s in expected}
    if k > 2:
        assert len(equal_bending(sums, asked[:1])[0]) > 1


def row_of(found: StackingPosterior, angles: list[float]) -> int:
    return int(found.classes_of(np.array([[found.grid_deg.tolist().index(a) for a in angles]]))[0])


@pytest.mark.slow
def test_classes_of_equal_bending_are_merged_where_the_plate_is_thin() -> None:
    found = answer(THIN)
    row = row_of(found, [0, 90, 90, 0])
    assert row_of(found, [90, 0, 0, 90]) == row >= 0
    assert sorted(found.grid_deg[found.class_members(row)].tolist()) == [[0, 90, 90, 0], [90, 0, 0, 90]]
    assert found.multiplicity[row] == 2
    assert len(found.same_bending[row]) == len(found.alike[row]) == 1
    everyone = np.concatenate([found.class_members(i) for i in range(len(found.top))])  # in one class only
    assert len(np.unique(everyone, axis=0)) == len(everyone) == found.multiplicity.sum()
    assert np.all(np.diff(found.probability) <= 1e-15)
    assert float(found.probability @ found.multiplicity) <= 1.0 + 1e-9
    rows = np.repeat(np.arange(len(found.top)), found.multiplicity)
    assert found.classes_of(everyone).tolist() == rows.tolist()
    thick = answer(THICK)  # a thick plate tells them apart by its shear
    row = row_of(thick, [0, 90, 90, 0])
    assert row != row_of(thick, [90, 0, 0, 90])
    assert thick.grid_deg[thick.same_bending[row]].tolist() == [[90, 0, 0, 90]]
    assert not any(len(others) for others in thick.alike)


@pytest.mark.parametrize(("thickness", "least", "most"), [(THIN, 0.0, 1e-4), (THICK, 5e-3, 0.5)])
def test_the_full_model_says_so_too(thickness: float, least: float, most: float) -> None:
    own = specimen(thickness)
    one, other = (frequencies_of(own, layup) for layup in ("[0/90/90/0/0/0]_s", "[90/0/0/0/90/0]_s"))
    assert least <= np.abs(other / one - 1.0).max() < most
