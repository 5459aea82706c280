"""Places that no frequency tells apart: as independent elements find them, and draws laid on one of them."""

import numpy as np
import pytest
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.diagnosis.places import images_of, laid_on
from cpam_bayes.effects import CATALOGUE, PlateFacts
from cpam_bayes.plate import Specimen
from tests.plate_file import described
from validation.independent.true_plate import Mass, TruePlate, natural_frequencies

PLACE = (0.83, 0.62)
CARBON = {"E1_GPa": 132.0, "E2_GPa": 9.1, "nu12": 0.31, "G12_GPa": 4.8}
METAL = {"E1_GPa": 70.0, "nu12": 0.33}
MASS = next(e for e in CATALOGUE if e.local == "point")


def plate(layup: str, edges: str, width: float = 200.0) -> Specimen:
    """A metal plate where there is no layup."""
    constants, of = (CARBON, {"layup": layup}) if layup else ({**METAL, "isotropic": True}, {})
    return cb.read_plate(described((200.0, width, 2.0), 1600.0, constants, edges=edges, **of))


def frequencies(bare: Specimen, place: tuple[float, float]) -> NDArray[np.float64]:
    """Of independent elements with a mass of 6 g at a place over the sides."""
    of, stated = bare.plate, METAL if bare.material.isotropic else CARBON
    angles = tuple(of.layup.angles_deg.tolist())
    constants = {n.removesuffix("_GPa"): v * (1e9 if "GPa" in n else 1.0) for n, v in stated.items()}
    mass = Mass(0.006, place[0] * of.length, place[1] * of.width)
    sides = (of.length, of.width, of.thickness)
    true = TruePlate(*sides, of.density, of.edges, angles, constants, masses=(mass,), mesh=4)
    return natural_frequencies(true, 8)


@pytest.mark.parametrize(
    ("layup", "edges", "width", "number"),
    [
        ("", "FFFF", 150.0, 4),
        ("", "FFFF", 200.0, 8),
        ("", "CCFF", 200.0, 2),
        ("", "CFCF", 200.0, 4),
        ("[45/-45]_s", "FFFF", 200.0, 4),
        ("[45/-45]_s", "FFFF", 150.0, 2),
        ("[0/90]_s", "FFFF", 200.0, 4),
        ("[30/-30]_s", "FFFF", 200.0, 2),
        ("[0/90]_s", "CFFF", 150.0, 2),
        ("[30/-30]_s", "CFFF", 150.0, 1),
    ],
)
def test_images_are_the_places_at_which_a_mass_leaves_the_same_frequencies(
    layup: str, edges: str, width: float, number: int
) -> None:
    bare = plate(layup, edges, width)
    facts = PlateFacts.of(bare.plate, bare.material.isotropic)
    found = images_of(PLACE, [facts])
    assert found[0] == pytest.approx(PLACE)
    assert len(found) == number
    x, y = PLACE
    every = {(u, v) for a, b in ((x, y), (y, x)) for u in (a, 1 - a) for v in (b, 1 - b)}
    own = frequencies(bare, PLACE)
    for image in every:
        there = frequencies(bare, image)
        is_one = any(np.allclose(image, other) for other in found)
        assert np.allclose(there, own, rtol=1e-6) == is_one, image


def test_a_known_mass_another_test_and_the_place_itself_leave_fewer_images() -> None:
    free, held = (plate("", edges, 150.0) for edges in ("FFFF", "CFFF"))
    first, second = (PlateFacts.of(p.plate, isotropic=True) for p in (free, held))
    loaded = PlateFacts.of(free.plate, isotropic=True, loaded=True)
    assert len(images_of(PLACE, [loaded])) == 1
    assert images_of(PLACE, [first, second]) == (PLACE, pytest.approx((0.83, 0.38)))
    # beside a line of symmetry the image is the place
    assert images_of((0.83, 0.49), [first], (0.01, 0.03)) == ((0.83, 0.49), pytest.approx((0.17, 0.49)))


def test_draws_are_laid_on_the_optimum_whichever_image_and_of_two_whichever_is_first() -> None:
    rng = np.random.default_rng(3)
    two = (MASS, MASS.again())
    names = [p.name for e in two for p in e.parameters]
    columns = {name: i + 1 for i, name in enumerate(names)}
    optimum = np.array([7.0, 0.006, 0.80, 0.55, 0.004, 0.002, 0.90, 0.95, 0.003])
    true = optimum + 1e-3 * rng.standard_normal((400, 9)) * [1, 0, 1, 1, 0, 0, 1, 1, 0]
    draws = true.copy()
    # a square of metal: x and y exchanged of some, the two masses exchanged of others
    turned, exchanged = rng.random(400) < 0.5, rng.random(400) < 0.5
    draws[np.ix_(turned, [2, 3])] = draws[np.ix_(turned, [3, 2])]
    draws[np.ix_(exchanged, range(1, 9))] = draws[np.ix_(exchanged, [5, 6, 7, 8, 1, 2, 3, 4])]
    square = plate("", "FFFF")
    facts = [PlateFacts.of(square.plate, isotropic=True)]
    np.testing.assert_allclose(laid_on(draws, optimum, two, columns, facts), true, rtol=1e-12)
    assert draws[turned & ~exchanged, 2].mean() == pytest.approx(0.55, abs=0.01)
