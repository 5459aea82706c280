"""What a new user writes, gives and types is understood, or refused with one message that has the cure."""

import re

import numpy as np
import pytest

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.reader import parse_specimen, read_plate
from tests.plate_file import Run, refused

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
[[sensor]]
mass_g = 0.6
x_mm = 300.0
y_mm = 220.0
[measurement]
frequencies_hz = [80.2, 146.3, 218.6, 275.1]
relative_std = 0.002
"""
LIST = "[80.2, 146.3, 218.6, 275.1]"

# (what stands in the good file, what a user writes): the same plate
UNDERSTOOD = [
    ('layup = "[0/90]_2s"', "layup = [0, 90, 0, 90, 90, 0, 90, 0]"),
    ('edges = "FFFF"', 'edges = "free"'),
    ('edges = "FFFF"', 'edges = "Frei"'),
    ('edges = "FFFF"', 'edges = "ffff"'),
    ('edges = "FFFF"', 'edges = "F F F F"'),
    ('edges = "FFFF"', 'edges = "F-F-F-F"'),
    ('edges = "FFFF"', 'edges = ["free", "free", "free", "free"]'),
    ("length_mm = 310.0", 'length_mm = "310"'),
    ("length_mm = 310.0", 'length_mm = "0,31 m"'),
    ("mass_g = 340.7", 'mass_g = "0,3407 kg"'),
    ("E1_GPa = 132.0", 'E1_GPa = "132000 MPa"'),
    ("E1_GPa = [60.0, 250.0]", 'E1_GPa = ["60 GPa", "250 GPa"]'),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", 'frequencies_hz = "80,2 146,3 218,6 275,1"'),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", 'frequencies_hz = "80.2; 146.3; 218.6; 275.1"'),
    ("frequencies_hz = [80.2,", 'frequencies_hz = ["0.0802 kHz",'),
    ("relative_std = 0.002", 'relative_std = "0.2 %"'),
    ("air_density_kg_m3 = 1.2", 'air_density_kg_m3 = "1,2 kg/m\u00b3"'),
    ('edges = "FFFF"', 'edges = "FFFF "'),
    ('edges = "FFFF"', 'edges = "all edges free"'),
    ("mass_g = 340.7", "mass_g = '340.7g'"),
    ("thickness_mm = 3.1", 'thickness_mm = "0,31 cm"'),
    (f"frequencies_hz = {LIST}", 'frequencies_hz = "80.2, 146.3, 218.6, 275.1"'),
]

# the same, and what the one message must hold
REFUSED = [
    ("[80.2, 146.3, 218.6, 275.1]", "[80,2, 146,3, 218, 275,1]", "decimal commas?"),
    ("nu12 = 0.31", "nu12=[0,15, 0,45]", "0,15 is two numbers"),
    ('name = "panel"', "date = 5.3.2026", 'a date stands in quotes: "5.3.2026"'),
    (LIST, "[80.2 Hz, 146.3 Hz]", "the unit is in the key: 80.2, not 80.2 Hz"),
    ("[80.2, 146.3, 218.6, 275.1]", "[275.1, 218.6, 146.3, 80.2]", "the other way round"),
    ("[80.2, 146.3, 218.6, 275.1]", "[80.2, 1463, 218.6, 275.1]", "1463 lost its decimal comma? 146.3 would"),
    ("[80.2, 146.3, 218.6, 275.1]", "[80.2 146.3 218.6]", "the numbers of a list: 80.2, 146.3"),
    ("length_mm = 310.0", "length_mm = 281,5", "a decimal point, not a comma"),
    ("length_mm = 310.0", "length_mm = 310 mm", "the unit is in the key"),
    ("length_mm = 310.0", 'length_mm = "1,310"', "no mark between thousands"),
    ("length_mm = 310.0", 'length_mm = "310 lb"', "a number above 0, in mm"),
    ("length_mm = 310.0", "length_mm: 310.0", "= stands between a key and its value"),
    ("length_mm = 310.0", "length = 310.0", "the nearest known key is length_mm"),
    ("thickness_mm = 3.1", "thickness_mm = 0.0031", "are the sizes in mm?"),
    ("[plate.sd]", "[plate.std]", "plate.std: unknown key, the nearest known key is sd"),
    ("mass_g = 340.7", "mass_g = 0.3407", "is the mass in kg?"),
    ("mass_g = 340.7", "mass_kg = 0.3407", "the nearest known key is mass_g"),
    ("mass_g = 340.7", "density_kg_m3 = 1.55", "1.55 g/cm3 are 1550 kg/m3"),
    ("E1_GPa = 132.0", "E1_GPa = 132000", "132000 MPa are 132 GPa"),
    ("E1_GPa = [60.0, 250.0]", "E1_GPa = [60e3, 250e3]", "60000 MPa are 60 GPa"),
    ('layup = "[0/90]_2s"', 'layup = "[0/90]_2s;"', "nothing may follow"),
    ('layup = "[0/90]_2s"', 'layup = "[22,5/-22,5]_s"', "22.5 has a point"),
    ('layup = "[0/90]_2s"', 'layup = "[0/90"', "never closed"),
    ('edges = "FFFF"', "edges = FFFF", "texts stand in quotes"),
    ("relative_std = 0.002", 'table = "C:\\Users\\me\\modes.csv"', "write / for \\ in a path"),
    ("frequencies_hz = [80.2, 146.3, 218.6, 275.1]", 'table = "data\\test.csv"', "write / for \\"),
    ("[environment]\nair_density_kg_m3 = 1.2", "[environment]\nair = true", "unknown key, accepted: air"),
    # tables and keys
    ("[plate]\n", "[PLATE]\n", "PLATE: unknown key, the nearest known key is plate"),
    ("[material]", "[properties]", "properties: unknown key, the nearest known key is material"),
    ("[[sensor]]", "[sensor]", "accepted: at most 100 tables [[sensor]]"),
    ("[plate]\n", "plate:\n", "a table is headed [plate]"),
    ("[plate]\n", "[plate\n", "a table is headed [plate]"),
    ("length_mm = 310.0", "length mm = 310.0", "a key has no spaces"),
    ("length_mm = 310.0", "length_mm 310.0", "= stands after it"),
    ("length_mm = 310.0", "length_mm =", "the value is missing"),
    ("length_mm = 310.0", "length_mm = 310.0\nlength_mm = 310.0", "a key and a table stand once"),
    ("mass_g = 340.7", "rho = 1550", "rho: unknown key, accepted: length_mm"),
    ("E1_GPa = [60.0, 250.0]", "thickness_mm = [2.0, 4.0]", "accepted: E1_GPa E2_GPa nu12"),
    # texts
    ('name = "panel"', "name = \u00abpanel\u00bb", 'quotes are "'),
    ('name = "panel"', "name = \u2018panel\u2019", 'quotes are "'),
    ('name = "panel"', 'name = "panel', "a quote is missing"),
    ('layup = "[0/90]_2s"', 'layup = "(0/90)_2s"', 'a layup begins with "["'),
    ('layup = "[0/90]_2s"', 'layup = "[0/100]"', "angle 100, accepted: -90 to 90"),
    ('edges = "FFFF"', 'edges = "h\u00e4ngend"', 'received "h\u00e4ngend", accepted: four letters'),
    # numbers
    ("thickness_mm = 3.1", "thickness_mm = .31", "a digit on each side of a point"),
    ("thickness_mm = 3.1", "thickness_mm = 3.1 // gauged", "# begins a comment"),
    ("mass_g = 340.7", "density_g_cm3 = 1.6", "the nearest known key is density_kg_m3"),
    (
        "E1_GPa = 132.0\nE2_GPa = 9.1\nnu12 = 0.31\nG12_GPa = 4.8",
        "E1_GPa = 132e9\nE2_GPa = 9.1e9\nnu12 = 0.31\nG12_GPa = 4.8e9",
        "1.32e+11 Pa are 132 GPa",
    ),
    ("[60.0, 250.0]", '"60-250"', "accepted: [lower, upper]"),
    ("[60.0, 250.0]", "[60,0, 250,0]", "are these decimal commas?"),
    ("x_mm = 300.0\ny_mm = 220.0", "x_mm = 3000\ny_mm = 2200", "outside the plate, received 3000"),
    ("relative_std = 0.002", "relative_std = 2", "0.2 % is 0.002"),
    # the list
    (LIST, "[80,85, 146,350, 218,6]", "are these decimal commas?"),
    (LIST, "[80.2; 146.3; 218.6]", "commas part the numbers of a list"),
    (LIST, "(80.2, 146.3)", "a list stands in [ ]"),
    (LIST, "80.2, 146.3, 218.6", "a list stands in [ ]"),
    (LIST, "[80,2; 146,3]", "a decimal point, not a comma: 80.2"),
    (LIST, "[80; 146,3]", "a decimal point, not a comma: 146.3"),
    (LIST, "[-12.5; 3]", "commas part the numbers of a list: -12.5, 3"),
    (LIST, "[1e2; 2e2]", "commas part the numbers of a list: 1e2, 2e2"),
    (LIST, "[80.2, 146.3", "is a ] missing"),
    (LIST, "[0, 0, 0, 0, 0, 0, 80.2, 146.3]", "no rigid-body motion; so are 5 more items"),
    (LIST, '[80.2, "n/a", "-", 218.6]', 'item 2: wrong type, received "n/a"'),
    (f"frequencies_hz = {LIST}", 'table = "plate.csv"', 'the nearest there is "plate7.csv"'),
]  # fmt: skip

# name, content and what the one message must hold
FILES = [
    ("list.csv", b"mode,hz\n1,80.2\n2,146.3\n", 'a list of frequencies is its table = "FILE"'),
    ("list.xlsx", b"PK\x03\x04\x14\0\0\0", "no plate file, received .xlsx, accepted: a TOML text"),
    ("report.pdf", b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n", "no plate file, received .pdf"),
    ("plate.json", b'{"plate": {"length_mm": 310}}', "no plate file, received .json"),
    ("plate.toml", b"", "nothing is in it, accepted: a TOML text, as `cpam-bayes new FILE` writes"),
    ("plate.toml", b"# to be done\n", "nothing is in it"),
]


@pytest.mark.parametrize(("good", "written"), UNDERSTOOD, ids=[written for _, written in UNDERSTOOD])
def test_what_can_mean_one_thing_is_understood(good: str, written: str) -> None:
    assert GOOD.count(good) == 1
    meant, found = (parse_specimen(text, "panel.toml") for text in (GOOD, GOOD.replace(good, written)))
    assert found.plate.edges == meant.plate.edges
    assert found.plate.layup.angles_deg.tolist() == meant.plate.layup.angles_deg.tolist()
    sizes = [(p.plate.length, p.plate.width, p.plate.thickness, p.plate.mass) for p in (found, meant)]
    np.testing.assert_allclose(*sizes, rtol=1e-12)
    np.testing.assert_allclose(found.measurement.frequencies, meant.measurement.frequencies, rtol=1e-12)
    assert found.material.constants == meant.material.constants
    assert (found.air_density, found.measurement.relative_std) == (1.2, 0.002)
    assert found.unknowns["E1"].prior == meant.unknowns["E1"].prior


@pytest.mark.parametrize(("good", "written", "said"), REFUSED, ids=[written for _, written, _ in REFUSED])
def test_a_slip_is_one_message_with_its_cure(run: Run, tmp_path, good: str, written: str, said: str) -> None:
    assert good in GOOD
    path = tmp_path / "panel.toml"
    path.write_text(GOOD.replace(good, written, 1), encoding="utf-8")
    (tmp_path / "plate7.csv").touch()
    answer = run("forward", path)
    refused(answer, said)
    assert re.match(rf"error: {re.escape(str(path))}:\d+: ", answer[2])
    assert len(answer[2]) < 600 + len(str(path))


def test_no_cure_has_a_part_of_a_number() -> None:
    with pytest.raises(PlateFileError, match="not valid TOML") as refusal:
        parse_specimen(GOOD.replace(LIST, "[80,5,2 146,3]"), "panel.toml")
    assert "2, 146" not in str(refusal.value)


@pytest.mark.parametrize(("name", "content", "said"), FILES)
def test_what_is_no_plate_file_is_one_message(
    run: Run, tmp_path, name: str, content: bytes, said: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    refused(run("forward", path), str(path), said)


def test_a_repeatability_in_per_cent_is_warned_of() -> None:
    text = GOOD.replace("relative_std = 0.002", "relative_std = 0.2")
    (said,) = parse_specimen(text, "panel.toml").measurement.remarks
    assert "20 % of a frequency" in said
    assert "0.2 % is 0.002" in said


ENCODINGS = ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "no mark", "old lines", "lines of Windows"]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_a_file_is_read_however_an_editor_saves_it_through_a_link_too(tmp_path, encoding: str) -> None:
    path, link = tmp_path / "panel.toml", tmp_path / "link.toml"
    mark = "\ufeff" if encoding in ("utf-16-le", "utf-16-be") else ""
    text = mark + GOOD.replace('"panel"', '"Pr\u00fcfplatte"')
    text = text.replace("\n", {"old lines": "\r", "lines of Windows": "\r\n"}.get(encoding, "\n"))
    codec = {"no mark": "utf-16-le", "old lines": "utf-8", "lines of Windows": "utf-8"}.get(
        encoding, encoding
    )
    path.write_bytes(text.encode(codec))
    link.symlink_to(path)
    assert read_plate(path).name == read_plate(link).name == "Pr\u00fcfplatte"
