"""Plate files of several materials: what is read, and what is refused."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cpam_bayes as cb
from cpam_bayes.errors import LayupError, PlateFileError
from cpam_bayes.plate import Hybrid, to_si, to_user, unit_of, user_name
from cpam_bayes.plate.layup import PlyKind, parse_layup
from tests.hybrids import GLASS, HYBRID, hybrid

UNKNOWNS = {"carbon": {"E1_GPa": [80.0, 180.0]}, "glass": {"E1_GPa": [20.0, 60.0], "nu12": [0.1, 0.4]}}
KINDS = {name: PlyKind(name, name, 1e-4) for name in ("c", "g", "core")}


def test_constants_carry_the_name_of_their_material() -> None:
    plate = cb.read_plate({**HYBRID, "unknowns": UNKNOWNS})
    assert isinstance(plate.material, Hybrid)
    assert plate.unknowns.names == ("carbon.E1", "glass.E1", "glass.nu12")
    assert plate.material.constants["glass.E1"] == 40.1e9
    assert plate.material.complete()["carbon.G13"] == 6.25e9
    assert plate.material.name == "carbon/epoxy and glass"
    assert user_name("glass.E1") == "glass.E1_GPa"
    assert (unit_of("glass.E1"), to_user("glass.E1", 40.1e9)) == ("GPa", 40.1)
    assert to_si("E1_GPa", 1.0) == 1e9
    with pytest.raises(ValueError, match=r"received 'c\.rho'"):
        user_name("c.rho")


def test_each_material_meets_its_own_constraints() -> None:
    material = cb.read_plate(HYBRID).material
    allowed = material.admissible({"carbon.E1": np.array([1e11, 1e9]), "glass.E1": np.array([4e10, 4e10])})
    assert allowed.tolist() == [True, False]
    margins = material.margins({"glass.nu12": np.array([0.2, 0.6, 0.7])})
    assert margins.shape == (3, len(material.constraints))
    broken = [c.of for c, m in zip(material.constraints, margins[1], strict=True) if m <= 0.0]
    assert set(broken) == {"glass"}


def test_the_plies_give_mass_and_heights() -> None:
    plate = cb.read_plate(HYBRID).plate
    # 6 plies of carbon of 0.25 mm, 4 of glass of 0.375 mm
    assert_allclose(plate.density, (1590.0 * 1.5 + 1900.0 * 1.5) / 3.0, rtol=1e-12)
    stack = plate.layup.plies
    assert_allclose(
        3.0 * np.diff(stack.interfaces), [0.25] * 2 + [0.375] * 2 + [0.25] * 2 + [0.375] * 2 + [0.25] * 2
    )
    assert_allclose(stack.density @ np.diff(stack.interfaces), 1.0, rtol=1e-12)
    assert plate.layup.is_symmetric
    assert stack.is_symmetric
    weighed = cb.read_plate(hybrid(mass_g=330.0)).plate
    assert_allclose(weighed.density, 0.33 / (0.3 * 0.2 * 0.003), rtol=1e-12)
    assert_allclose(weighed.layup.plies.density, stack.density)


def without_density(material: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in material.items() if key != "density_kg_m3"}


def of_one_material(layup: str, thickness_mm: float, **plies_mm: float) -> dict[str, Any]:
    """A plate of named plies of carbon."""
    file = hybrid(density_kg_m3=1590.0, layup=layup, thickness_mm=thickness_mm)
    file["ply"] = [{"name": name, "thickness_mm": t} for name, t in plies_mm.items()]
    return file | {"material": without_density(HYBRID["material"]["carbon"])}


def test_one_density_of_the_plate_is_one_density_of_all_plies() -> None:
    materials = {name: without_density(material) for name, material in HYBRID["material"].items()}
    stack = cb.read_plate(hybrid(density_kg_m3=1700.0) | {"material": materials}).plate.layup.plies
    assert_allclose(stack.mass_moments, (0.0, 1.0), atol=1e-15)


def test_plies_of_one_material_may_differ_in_thickness() -> None:
    plate = cb.read_plate(of_one_material("[thick0/thin90]_s", 2.5, thick=1.0, thin=0.25))
    assert plate.material.constants["E1"] == 121.2e9
    assert_allclose(plate.plate.layup.plies.interfaces, [-0.5, -0.1, 0.0, 0.1, 0.5])


@pytest.mark.parametrize(
    ("text", "names", "angles"),
    [
        ("[(c0/g45)_2]_s", "c g c g g c g c", [0, 45, 0, 45, 45, 0, 45, 0]),
        ("[c+-45/core/g90_2]", "c c core g g", [45, -45, 0, 90, 90]),
        ("[ c0 / core_2 / c0 ]", "c core core c", [0, 0, 0, 0]),
        ("[c-30/g?/c90]", "c g c", [-30, np.nan, 90]),
    ],
)
def test_names_stand_before_angles_and_known_angles_keep_them(
    text: str, names: str, angles: list[float]
) -> None:
    layup = parse_layup(text, KINDS)
    assert [kind.name for kind in layup.kinds] == names.split()
    assert_allclose(layup.angles_deg, angles)
    known = layup.with_angles([45.0] * layup.n_unknown)
    assert [kind.name for kind in parse_layup(known.text, KINDS).kinds] == names.split()
    assert known.n_unknown == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[c0/k45]", 'ply "k"'),
        ("[c0/45]", 'ply ""'),
        ("[c0/core?x]", "expected"),
        ("[c]_s2", "nothing may follow"),
    ],
)
def test_a_layup_of_other_plies_is_refused(text: str, said: str) -> None:
    with pytest.raises(LayupError, match=said):
        parse_layup(text, KINDS)
    with pytest.raises(LayupError, match=r"tables \[\[ply\]\]"):
        parse_layup("[c0/g45]")


SPOILT: list[tuple[Any, str]] = [
    (
        lambda f: f["plate"].update(thickness_mm=3.2),
        "plate.thickness_mm: not the sum of the plies, received 3.2, the plies of the layup make 3 mm",
    ),
    (lambda f: f.pop("ply"), "material: several materials, received carbon glass"),
    (lambda f: f["plate"].pop("layup"), "plate.layup: missing, accepted: a layup of named plies"),
    (lambda f: f["ply"][1].update(name="c"), 'ply item 2.name: received "c" twice'),
    (
        lambda f: f["ply"][0].update(material="karbon"),
        "ply item 1.material: no table [material.karbon], accepted: carbon glass",
    ),
    (lambda f: f["ply"][0].pop("material"), "ply item 1.material: missing"),
    (lambda f: f["ply"][0].pop("thickness_mm"), "ply item 1.thickness_mm: missing"),
    (lambda f: f["material"].update(steel=GLASS), "material.steel: no ply of the layup is of it"),
    (
        lambda f: f["unknowns"].update(steel={"E1_GPa": [1.0, 2.0]}),
        'unknowns.steel: of no material, received "steel"',
    ),
    (
        lambda f: f.update(unknowns={"E1_GPa": [80.0, 180.0]}),
        'unknowns.E1_GPa: of no material, received "E1_GPa", accepted: tables [unknowns.NAME]',
    ),
    (lambda f: f["material"]["glass"].update(E1_GPa=1.0), "material.glass.E1_GPa: impossible constants"),
    (
        lambda f: f["material"]["glass"].update(E1_GPa="stiff"),
        'material.glass.E1_GPa: wrong type, received "stiff", accepted: a number above 0, in GPa',
    ),
    (
        lambda f: f["material"]["glass"].update(sd={"G23_GPa": 0.1}),
        "material.glass.sd.G23_GPa: standard deviation of a number that [material] does not give",
    ),
    (lambda f: f["material"]["glass"].pop("density_kg_m3"), "material.glass.density_kg_m3: missing"),
    (
        lambda f: f["material"]["glass"].update(density_kg_m3=1.9),
        "material.glass.density_kg_m3: no density of a solid, received 1.9",
    ),
    (lambda f: f["plate"].update(density_kg_m3=1700.0), "plate.density_kg_m3: beside densities of the"),
]
OF_ONE: list[tuple[Any, str]] = [
    (lambda f: f["ply"][0].update(material="carbon"), "ply item 1.material: beside one [material]"),
    (lambda f: f["material"].update(density_kg_m3=1590.0), "material.density_kg_m3: of one material"),
    (lambda f: f.update(unknowns={"carbon": {"E1_GPa": [80.0, 180.0]}}), "unknowns: tables for several"),
    (lambda f: f["plate"].update(layup="[0/90]_s"), 'plate.layup: malformed layup: ply ""'),
]


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        *(({**HYBRID, "unknowns": UNKNOWNS}, *wrong) for wrong in SPOILT),
        *((of_one_material("[c0/c90]_s", 1.0, c=0.25), *wrong) for wrong in OF_ONE),
    ],
    ids=[said for _, said in SPOILT + OF_ONE],
)
def test_wrong_plies_and_materials_are_one_problem_with_its_key(
    file: dict[str, Any], change: Any, said: str
) -> None:
    spoilt = deepcopy(file)
    cb.read_plate(spoilt)
    change(spoilt)
    with pytest.raises(PlateFileError) as error:
        cb.read_plate(spoilt)
    (problem,) = error.value.problems
    assert said in problem
