"""Plate files of several materials: what is read, and what is refused."""

import re
from copy import deepcopy
from functools import reduce
from operator import getitem
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
OTHERS = [
    ("[c0/k45]", 'ply "k"'),
    ("[c0/45]", 'ply ""'),
    ("[c0/core?x]", "expected"),
    ("[c]_s2", "nothing may follow"),
]
# key's value, None to remove it; message
STEEL, SD = {"E1_GPa": [1.0, 2.0]}, {"G23_GPa": 0.1}
OF_ONE: list[tuple[str, Any, str]] = [
    ("ply item 1.material", "carbon", ": beside one [material]"),
    ("material.density_kg_m3", 1590.0, ": of one material"),
    ("unknowns", {"carbon": STEEL}, ": tables for several"),
    ("plate.layup", "[0/90]_s", ': malformed layup: ply ""'),
]


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
    assert_allclose(plate.density, (1590.0 * 1.5 + 1900.0 * 1.5) / 3.0, rtol=1e-12)  # 1.5 mm of each
    stack = plate.layup.plies
    heights = np.diff(stack.interfaces)
    assert_allclose(3.0 * heights, [0.25] * 2 + [0.375] * 2 + [0.25] * 2 + [0.375] * 2 + [0.25] * 2)
    assert_allclose(stack.density @ heights, 1.0, rtol=1e-12)
    assert plate.layup.is_symmetric
    assert stack.is_symmetric
    weighed = cb.read_plate(hybrid(mass_g=330.0)).plate
    assert_allclose(weighed.density, 0.33 / (0.3 * 0.2 * 0.003), rtol=1e-12)
    assert_allclose(weighed.layup.plies.density, stack.density)
    materials = {name: without_density(name) for name in HYBRID["material"]}  # one density for all plies
    of_one = cb.read_plate(hybrid(density_kg_m3=1700.0) | {"material": materials}).plate.layup.plies
    assert_allclose(of_one.mass_moments, (0.0, 1.0), atol=1e-15)


def without_density(name: str) -> dict[str, Any]:
    return {key: value for key, value in HYBRID["material"][name].items() if key != "density_kg_m3"}


def of_one_material(layup: str, thickness_mm: float, **plies_mm: float) -> dict[str, Any]:
    file = hybrid(density_kg_m3=1590.0, layup=layup, thickness_mm=thickness_mm)
    file["ply"] = [{"name": name, "thickness_mm": t} for name, t in plies_mm.items()]
    return file | {"material": without_density("carbon")}


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
def test_names_stand_before_angles_and_known_angles_keep_them(text: str, names: str, angles) -> None:
    layup = parse_layup(text, KINDS)
    assert [kind.name for kind in layup.kinds] == names.split()
    assert_allclose(layup.angles_deg, angles)
    known = layup.with_angles([45.0] * layup.n_unknown)
    assert [kind.name for kind in parse_layup(known.text, KINDS).kinds] == names.split()
    assert known.n_unknown == 0


@pytest.mark.parametrize(("text", "said"), OTHERS)
def test_a_layup_of_other_plies_is_refused(text: str, said: str) -> None:
    with pytest.raises(LayupError, match=said):
        parse_layup(text, KINDS)
    with pytest.raises(LayupError, match=r"tables \[\[ply\]\]"):
        parse_layup("[c0/g45]")


SPOILT: list[tuple[str, Any, str]] = [
    ("plate.thickness_mm", 3.2, ": not the sum of the plies, received 3.2, the plies of the layup make 3 mm"),
    ("ply", None, "material: several materials, received carbon glass"),
    ("plate.layup", None, ": missing, accepted: a layup of named plies"),
    ("ply item 2.name", "c", ': received "c" twice'),
    ("ply item 1.material", "karbon", ": no table [material.karbon], accepted: carbon glass"),
    *((f"ply item 1.{key}", None, ": missing") for key in ("material", "thickness_mm")),
    ("material.steel", GLASS, ": no ply of the layup is of it"),
    ("unknowns.steel", STEEL, ': of no material, received "steel"'),
    ("unknowns", STEEL, '.E1_GPa: of no material, received "E1_GPa", accepted: tables [unknowns.NAME]'),
    ("material.glass.E1_GPa", 1.0, ": impossible constants"),
    ("material.glass.E1_GPa", "stiff", ': wrong type, received "stiff", accepted: a number above 0, in GPa'),
    ("material.glass.sd", SD, ".G23_GPa: standard deviation of a number that [material] does not give"),
    ("material.glass.density_kg_m3", None, ": missing"),
    ("material.glass.density_kg_m3", 1.9, ": no density of a solid, received 1.9"),
    ("plate.density_kg_m3", 1700.0, ": beside densities of the"),
]


@pytest.mark.parametrize(
    ("file", "key", "value", "said"),
    [
        *(({**HYBRID, "unknowns": UNKNOWNS}, *wrong) for wrong in SPOILT),
        *((of_one_material("[c0/c90]_s", 1.0, c=0.25), *wrong) for wrong in OF_ONE),
    ],
    ids=[f"{key}: {value}" for key, value, _ in SPOILT + OF_ONE],
)
def test_wrong_plies_and_materials_are_one_problem_with_its_key(file, key: str, value, said: str) -> None:
    spoilt = deepcopy(file)
    cb.read_plate(spoilt)
    *tables, last = (int(part) - 1 if part.isdigit() else part for part in re.split(r" item |\.", key))
    table = reduce(getitem, tables, spoilt)
    table[last] = value
    if value is None:
        del table[last]
    with pytest.raises(PlateFileError) as error:
        cb.read_plate(spoilt)
    (problem,) = error.value.problems
    assert (f"{key}{said}" if said[0] in ".:" else said) in problem
