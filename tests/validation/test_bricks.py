"""Plates of bricks with flaws: the content of their decks, and CalculiX's results."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cpam_bayes as cb
from cpam_bayes.forward_model.calculix.deck import Deck
from cpam_bayes.forward_model.calculix.run import solve_modes
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.plate import Sensor, Specimen
from tests.plate_file import described
from validation.brick_cases import CASES, CONSTANTS, listed_frequencies, plate_file, plate_of
from validation.bricks import Flaws, Heat, Mass, Notch, Patch, Springs, flawed_deck, flawed_frequencies

BRICKS = Path(__file__).parents[2] / "studies" / "data" / "bricks"
A, B, H, IN_PLANE = 0.2, 0.15, 0.003, 30


def plate(edges: str = "FFFF") -> Specimen:
    constants = {"E1_GPa": 128.0, "E2_GPa": 8.6, "nu12": 0.31, "G12_GPa": 4.7}
    size, material = (1e3 * A, 1e3 * B, 1e3 * H), {"isotropic": False, **constants}
    return cb.read_plate(described(size, 1560.0, material, layup="[0/90]_s", edges=edges))


def deck_of(flaws: Flaws, edges: str = "FFFF") -> Deck:
    specimen = plate(edges)
    return flawed_deck(specimen, reference_constants(specimen), 4, flaws, in_plane=IN_PLANE)


def solved(flaws: Flaws, specimen: Specimen | None = None) -> np.ndarray:
    specimen = specimen or plate()
    return flawed_frequencies(specimen, reference_constants(specimen), 4, flaws, in_plane=IN_PLANE)


def block(deck: str, keyword: str) -> list[list[float]]:
    after = deck.split(f"{keyword}\n", 1)[1].split("*", 1)[0]
    return [[float(v) for v in line.split(",") if v.strip()] for line in after.strip().splitlines()]


def test_a_taper_makes_one_end_thicker_about_the_midplane_and_a_sag_lifts_the_middle() -> None:
    flaws = Flaws(), Flaws(taper=(0.1, 0.0)), Flaws(sag=(1e-3, 5e-4))
    flat, tapered, sagging = (deck_of(flaw).mesh.nodes for flaw in flaws)
    for x, thickness in ((0.0, 0.9 * H), (A, 1.1 * H)):
        z = tapered[np.isclose(tapered[:, 0], x), 2]
        assert_allclose([z.min(), z.max()], [-thickness / 2, thickness / 2])
    lift = sagging[:, 2] - flat[:, 2]
    assert lift.max() == pytest.approx(1.5e-3, rel=0.1)
    corner = np.isclose(flat[:, 0] * flat[:, 1], 0.0) & np.isclose(flat[:, 0] + flat[:, 1], 0.0)
    assert_allclose(lift[corner], 0.0, atol=1e-15)


def test_a_mass_sits_at_its_place_on_the_top_and_a_notch_has_no_nodes() -> None:
    deck = deck_of(Flaws(masses=(Mass(1e-3, 0.073, 0.041),))).text
    ((_, node),) = block(deck, "*ELEMENT, TYPE=MASS, ELSET=MASS_1")
    (place,) = (row[1:] for row in block(deck, "*NODE, NSET=ALL") if row[0] == node)
    assert_allclose(place, [0.073, 0.041, H / 2])
    assert block(deck, "*MASS, ELSET=MASS_1") == [[1e-3]]
    x, y = np.array(block(deck_of(Flaws(notch=Notch(0.03, 0.02))).text, "*NODE, NSET=ALL")).T[1:3]
    assert not np.any((x > A - 0.03 + 1e-9) & (y > B - 0.02 + 1e-9))
    assert (x.max(), y.max()) == pytest.approx((A, B))


def test_a_patch_is_softer_by_its_fraction_and_as_large_as_asked() -> None:
    patch = Patch((0.051, 0.083), (0.033, 0.074), 0.4)
    deck = deck_of(Flaws(patch=patch)).text
    card = "*MATERIAL, NAME={}\n*ELASTIC, TYPE=ENGINEERING CONSTANTS"
    plies, soft = (np.concatenate(block(deck, card.format(name))) for name in ("PLY", "SOFT"))
    is_poisson = np.arange(9) // 3 == 1
    assert_allclose(soft, np.where(is_poisson, plies, 0.4 * plies), rtol=1e-9)
    rows = block(deck, "*ELEMENT, TYPE=C3D20R, ELSET=SOFT_1")  # two lines, which begin with the number
    numbers = {n for row in rows[::2] for n in row[1:]}.union(*rows[1::2])
    xy = np.array([row[1:3] for row in block(deck, "*NODE, NSET=ALL") if row[0] in numbers])
    assert_allclose([xy.min(axis=0), xy.max(axis=0)], [[0.051, 0.033], [0.083, 0.074]], atol=1e-12)


def test_springs_of_a_face_add_up_to_its_area() -> None:
    deck = deck_of(Flaws(springs=Springs(1.0, 2.0, 3.0)), "CFFF").text
    total = np.zeros(3)
    for part in deck.split("*ELEMENT, TYPE=SPRING1, ELSET=")[1:]:
        elements, spring = part.split("*SPRING, ELSET=", 1)
        n_nodes = len(elements.strip().splitlines()) - 1
        degree, stiffness = spring.splitlines()[1:3]
        total[int(degree) - 1] += n_nodes * float(stiffness)
    assert_allclose(total, B * H * np.array([1.0, 2.0, 3.0]), rtol=1e-6)


def test_what_has_no_meaning_is_refused() -> None:
    with pytest.raises(ValueError, match="accepted: F and C"):
        deck_of(Flaws(), "SFFF")
    with pytest.raises(ValueError, match="with a clamped edge"):
        deck_of(Flaws(springs=Springs(1.0, 1.0, 1.0)), "FFFF")
    with pytest.raises(ValueError, match="accepted: FFFF"):
        deck_of(Flaws(heat=Heat(1e-5)), "CFFF")


@pytest.mark.parametrize("name", CASES)
def test_a_file_of_a_case_is_its_plate_with_its_noise(name: str) -> None:
    truth = json.loads((BRICKS / "truths.json").read_text(encoding="utf-8"))[name]
    case, saved = CASES[name], (BRICKS / f"{name}.toml").read_text(encoding="utf-8")
    assert saved == plate_file(case, listed_frequencies(case, np.array(truth["bricks_hz"])))
    assert (truth["cause"], tuple(truth["constants"][k] for k in CONSTANTS)) == (case.cause, case.constants)
    assert cb.read_plate(str(BRICKS / f"{name}.toml")).name == name
    assert set(plate_of(case)) == {"name", "plate", "material", "unknowns"}
    assert case.reference != case.constants


@pytest.mark.needs_ccx
def test_without_flaws_the_deck_is_that_of_the_plate_and_a_mass_acts_as_one_of_the_file() -> None:
    for edges in ("FFFF", "CFFF"):
        specimen = plate(edges)
        whole = solve_modes(specimen, reference_constants(specimen), 4, in_plane=IN_PLANE)
        assert_allclose(solved(Flaws(), specimen), whole.frequencies, rtol=1e-6)
    known = replace(plate(), sensors=(Sensor(2e-3, 0.03, 0.12),))
    assert_allclose(solved(Flaws(masses=(Mass(2e-3, 0.03, 0.12),))), solved(Flaws(), known), rtol=1e-9)


@pytest.mark.needs_ccx
def test_stiff_springs_are_a_clamp_and_soft_ones_are_not() -> None:
    springs = None, Springs(1e16, 1e16, 1e16), Springs(5e12, 5e12, 1e10)
    held, stiff, soft = (solved(Flaws(springs=s), plate("CFFF")) for s in springs)
    assert_allclose(stiff, held, rtol=1e-3)
    assert np.all(soft < held)


@pytest.mark.needs_ccx
def test_heat_is_of_first_order_and_a_taper_of_second_on_a_free_plate() -> None:
    cold, none, warm = (solved(Flaws(heat=h))[0] for h in (Heat(-2e-5), None, Heat(2e-5)))
    assert warm - none == pytest.approx(none - cold, rel=0.1)  # to first order in the stress
    assert abs(warm / none - 1.0) > 1e-3
    there, back = (solved(Flaws(taper=(t, 0.0))) for t in (0.05, -0.05))
    assert_allclose(there, back, rtol=1e-6)
