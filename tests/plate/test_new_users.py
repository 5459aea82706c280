"""What a new user writes into a plate file is understood, or refused with one message that has the cure."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.reader import read_plate
from tests.plate_file import described

GOOD = """\
name = "panel"
[plate]
length_mm = 310.0
width_mm = 228.0
thickness_mm = 3.1
mass_g = 340.7
layup = "[0/90]_2s"
edges = "FFFF"
[plate.sd]
thickness_mm = 0.02
[material]
E1_GPa = 132.0
E2_GPa = 9.1
nu12 = 0.31
G12_GPa = 4.8
[unknowns]
E1_GPa = [60.0, 250.0]
E2_GPa = [4.0, 16.0]
[environment]
air_density_kg_m3 = 1.2
[measurement]
frequencies_hz = [80.2, 146.3, 218.6, 275.1]
relative_std = 0.002
"""

# (what stands in the good file, what a user writes): the same plate
UNDERSTOOD = [
    ('layup = "[0/90]_2s"', 'layup = "[0,90]_2s"'),
    ('layup = "[0/90]_2s"', 'layup = "[0 90 0 90 90 0 90 0]"'),
    ('layup = "[0/90]_2s"', 'layup = "[0\u00b0/90\u00b0]_2s"'),
    ('layup = "[0/90]_2s"', 'layup = "[0\u00b0, 90\u00b0]_{2s}"'),
    ('layup = "[0/90]_2s"', 'layup = "[(0;90)_2]S"'),
    ('layup = "[0/90]_2s"', "layup = [0, 90, 0, 90, 90, 0, 90, 0]"),
    ('edges = "FFFF"', 'edges = "free"'),
    ('edges = "FFFF"', 'edges = "all free"'),
    ('edges = "FFFF"', 'edges = "Frei"'),
    ('edges = "FFFF"', 'edges = "ffff"'),
    ('edges = "FFFF"', 'edges = "F F F F"'),
    ('edges = "FFFF"', 'edges = "F-F-F-F"'),
    ('edges = "FFFF"', 'edges = ["F", "F", "F", "F"]'),
    ('edges = "FFFF"', 'edges = ["free", "free", "free", "free"]'),
    ("length_mm = 310.0", 'length_mm = "310"'),
    ("length_mm = 310.0", 'length_mm = "310,0"'),
    ("length_mm = 310.0", 'length_mm = "310 mm"'),
    ("length_mm = 310.0", 'length_mm = "31 cm"'),
    ("length_mm = 310.0", 'length_mm = "0,31 m"'),
    ("mass_g = 340.7", 'mass_g = "340,7"'),
    ("mass_g = 340.7", 'mass_g = "340.7 g"'),
    ("mass_g = 340.7", 'mass_g = "0,3407 kg"'),
    ("E1_GPa = 132.0", 'E1_GPa = "132000 MPa"'),
    ("E1_GPa = [60.0, 250.0]", 'E1_GPa = ["60 GPa", "250 GPa"]'),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", 'frequencies_hz = "80,2 146,3 218,6 275,1"'),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", 'frequencies_hz = "80.2; 146.3; 218.6; 275.1"'),
    ("frequencies_hz = [80.2,", 'frequencies_hz = ["80,2",'),
    ("frequencies_hz = [80.2,", 'frequencies_hz = ["0.0802 kHz",'),
    ("relative_std = 0.002", 'relative_std = "0.2 %"'),
    ("air_density_kg_m3 = 1.2", 'air_density_kg_m3 = "1,2 kg/m\u00b3"'),
]

# the same, and what the one message must hold
REFUSED = [
    ("[80.2, 146.3, 218.6, 275.1]", "[80,2, 146,3, 218,6, 275,1]", "decimal commas? 80,2 is two numbers"),
    ("[80.2, 146.3, 218.6, 275.1]", "[80,2, 146,3, 218, 275,1]", "decimal commas?"),
    ("[80.2, 146.3, 218.6, 275.1]", "[275.1, 218.6, 146.3, 80.2]", "the other way round"),
    ("[80.2, 146.3, 218.6, 275.1]", "[80.2, 218.6, 146.3, 275.1]", "146.3 after 218.6, accepted"),
    ("[80.2, 146.3, 218.6, 275.1]", "[80.2, 1463, 218.6, 275.1]", "1463 lost its decimal comma? 146.3 would"),
    ("[80.2, 146.3, 218.6, 275.1]", "[80.2 146.3 218.6]", "not valid TOML"),
    ("[80.2, 146.3, 218.6, 275.1]", "80.2", "a list of 1 to 100 frequencies"),
    ("length_mm = 310.0", "length_mm = 281,5", "a decimal point, not a comma"),
    ("length_mm = 310.0", "length_mm = 310 mm", "the unit is in the key"),
    ("length_mm = 310.0", 'length_mm = "1,310"', "no mark between thousands"),
    ("length_mm = 310.0", 'length_mm = "310 lb"', "a number above 0, in mm"),
    ("length_mm = 310.0", "length_mm: 310.0", "= stands between a key and its value"),
    ("length_mm = 310.0", "length = 310.0", "the nearest known key is length_mm"),
    ("thickness_mm = 3.1", "thickness_mm = 0.0031", "are the sizes in mm?"),
    ("[plate]", "[Plate]", "Plate: unknown key, the nearest known key is plate"),
    ("[unknowns]", "[unkowns]", "the nearest known key is unknowns"),
    ("[plate.sd]", "[plate.std]", "plate.std: unknown key, the nearest known key is sd"),
    ("mass_g = 340.7", "mass_g = 0.3407", "is the mass in kg?"),
    ("mass_g = 340.7", "mass_kg = 0.3407", "the nearest known key is mass_g"),
    ("mass_g = 340.7", "density_kg_m3 = 1.55", "1.55 g/cm3 are 1550 kg/m3"),
    ("mass_g = 340.7", 'mass_g = "about 340"', "a number above 0, in g"),
    ("E1_GPa = 132.0", "E1_GPa = 132000", "132000 MPa are 132 GPa"),
    ("E1_GPa = 132.0", "E1_GPa = 1.32e11", "stiffer than any material"),
    ("E1_GPa = 132.0", "E1_GPA = 132.0", "the nearest known key is E1_GPa"),
    ("E1_GPa = [60.0, 250.0]", "E1_GPa = 132", "[lower, upper]"),
    ("E1_GPa = [60.0, 250.0]", "E1_GPa = [60e3, 250e3]", "60000 MPa are 60 GPa"),

    ("nu12 = 0.31", "nu12 = 31", "eq. (9)"),
    ('layup = "[0/90]_2s"', 'layup = "0/90/90/0"', 'a layup begins with "["'),
    ('layup = "[0/90]_2s"', 'layup = "[0/90]_2s;"', "nothing may follow"),
    ('layup = "[0/90]_2s"', 'layup = "[22,5/-22,5]_s"', "22.5 has a point"),
    ('layup = "[0/90]_2s"', 'layup = "[0/90"', "never closed"),
    ('layup = "[0/90]_2s"', 'layup = "quasi-isotropic"', 'a layup begins with "["'),
    ('layup = "[0/90]_2s"', "layup = [0/90]_2s", "not valid TOML"),
    ('layup = "[0/90]_2s"', "layup = \u201c[0/90]_2s\u201d", 'quotes are "'),
    ('edges = "FFFF"', "edges = FFFF", "texts stand in quotes"),
    ('edges = "FFFF"', 'edges = "cantilever"', "for x=0, y=0, x=length, y=width"),
    ('edges = "FFFF"', 'edges = "hanging on strings"', "four letters of F S C"),
    ("relative_std = 0.002", 'table = "C:\\Users\\me\\modes.csv"', "write / for \\ in a path"),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", 'table = "data\\test.csv"', "write / for \\"),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", "table = 'data\\modes.csv'", "no such file"),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", "frequencies = [80.2]", "key is frequencies_hz"),
    ("[environment]\nair_density_kg_m3 = 1.2", "[environment]\nair = true", "unknown key, accepted: air"),
    ("[measurement]\n", "[measurement]\nfrequencies_hz = [80.2]\n", "not valid TOML"),
]  # fmt: skip


def read(tmp_path, text: str) -> Specimen:
    path = tmp_path / "panel.toml"
    path.write_text(text, encoding="utf-8")
    return read_plate(path)


@pytest.mark.parametrize(("good", "written"), UNDERSTOOD, ids=[written for _, written in UNDERSTOOD])
def test_what_can_mean_one_thing_is_understood(tmp_path, good: str, written: str) -> None:
    assert GOOD.count(good) == 1
    meant, found = read(tmp_path, GOOD), read(tmp_path, GOOD.replace(good, written))
    assert found.plate.edges == meant.plate.edges
    assert found.plate.layup.angles_deg.tolist() == meant.plate.layup.angles_deg.tolist()
    sizes = [(p.plate.length, p.plate.width, p.plate.thickness, p.plate.mass) for p in (found, meant)]
    np.testing.assert_allclose(*sizes, rtol=1e-12)
    np.testing.assert_allclose(found.measurement.frequencies, meant.measurement.frequencies, rtol=1e-12)
    assert found.material.constants == meant.material.constants
    assert (found.air_density, found.measurement.relative_std) == (1.2, 0.002)
    assert found.unknowns["E1"].prior == meant.unknowns["E1"].prior


@pytest.mark.parametrize(("good", "written", "said"), REFUSED, ids=[written for _, written, _ in REFUSED])
def test_a_slip_is_one_message_with_its_cure(tmp_path, good: str, written: str, said: str) -> None:
    assert good in GOOD
    with pytest.raises(PlateFileError) as caught:
        read(tmp_path, GOOD.replace(good, written, 1))
    (problem,) = caught.value.problems
    assert said in problem
    assert re.match(rf"{re.escape(str(tmp_path / 'panel.toml'))}:\d+: ", problem)
    assert len(problem) < 600


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_a_file_saved_as_unicode_by_windows_is_read(tmp_path, encoding: str) -> None:
    path = tmp_path / "panel.toml"
    mark = "" if encoding == "utf-16" else "\ufeff"
    path.write_bytes((mark + GOOD.replace('"panel"', '"Pr\u00fcfplatte"')).encode(encoding))
    assert read_plate(path).name == "Pr\u00fcfplatte"


def test_a_mapping_is_understood_as_a_file_is() -> None:
    plate = described(
        (200, 100, 3), 2700, {"isotropic": True, "E1_GPa": "69,0", "nu12": 0.33}, edges="clamped"
    )
    found = read_plate(plate)
    assert (found.plate.edges, found.material.constants["E1"]) == ("CCCC", 69e9)
