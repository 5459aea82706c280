"""A user's spelling in a plate file is understood, or all errors are reported at once, with their cure."""

import pickle
import re
import tomllib
from unittest.mock import Mock

import numpy as np
import pytest

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate import parse_specimen, schema
from tests.plate_file import BAR

LIST = "[80.2, 146.3, 218.6, 275.1]"
PLY = "E1_GPa = 132.0\nE2_GPa = 9.1\nnu12 = 0.31\nG12_GPa = 4.8\n"
# entry in the good file, and what a user may write instead: the same plate
FREE = ['"free"', '"Frei"', '"ffff"', '"F F F F"', '"F-F-F-F"', '"FFFF "', '"all edges free"']
ORTHOTROPIC = 'symmetry = "orthotropic"\nE1_GPa = 3\nE2_GPa = 1\nG12_GPa = 1\n'
MATERIALS = [
    ("isotropic = true\nE1_GPa = 69\nnu12 = 0.5\n", "-1 < nu12 < 0.5"),
    ("isotropic = true\nE1_GPa = 69\nnu12 = 0.3\n[unknowns]\nnu12 = [0.6, 0.7]\n", "no physical const"),
    ("E1_GPa = 69\nnu12 = 0.3\n", "material.symmetry: missing"),
    (f"{ORTHOTROPIC}nu12 = -1.8\n", "material.nu12: impossible constants"),
    (f"{ORTHOTROPIC}nu12 = 1.8\n", "|nu12| < sqrt(E1/E2), a positive definite stiffness"),
]
TOO_MANY = {
    "received 10000, accepted: at most 100 tables": "[[sensor]]\nmass_g = 'x'\n" * 10_000,
    "received 100000, accepted: a list of 1 to 100 frequencies, ascending": (
        f"[measurement]\nfrequencies_hz = [{'-1, ' * 100_000}]"
    ),
}
LONG_KEY = ".".join("a" * 50_000)


def problems_of(text, directory=None):
    with pytest.raises(PlateFileError) as caught:
        parse_specimen(text, "plate.toml", directory)
    return caught.value.problems


def one_problem(text, directory=None):
    problems = problems_of(text, directory)
    assert len(problems) == 1, problems
    return problems[0]


SPOILT = [  # (entry in the good file, its replacement, the key, text in the message)
    # unknown keys
    ("E2_GPa = 9.34", "E2_GPa = 9.34\nE3_GPa = 9.34", "material.E3_GPa", "nearest known key is E"),
    ("[plate.sd]", "[plates]", "plates", "nearest known key is plate"),
    ("mass_g = 1.2", "mass_g = 1.2\nz_mm = 1", "sensor item 1.z_mm", "nearest known key is"),
    ("width_mm = 250", "width_mm = 250\nresolution_hz = 1", "plate.resolution_hz", "[measurement]"),
    ("sd = 0.03, ", "sd = 0.03, men = 1, ", "unknowns.nu12.men", "nearest known key is mean"),
    ("length_mm = 260.0", "length_mm = 1979-05-27", "plate.length_mm", "received datetime.date"),  # types
    ("length_mm = 260.0", f"length_mm = 1{'0' * 400}", "plate.length_mm", "wrong type"),
    ("isotropic = false", 'isotropic = "no"', "material.isotropic", "true or false"),
    ('name = "plate 7"', 'name = ""', "name", "empty text"),
    ("[environment]\nair_density_kg_m3 = 1.2", "[[environment]]", "environment", "a table"),
    ("E2_GPa = [5, 40]", "E2_GPa = [5, 40, 50]", "unknowns.E2_GPa", "wrong length"),
    ("E2_GPa = [5, 40]", "E2_GPa = {}", None, "missing"),
    ("length_mm = 260.0", "length_mm = nan", "plate.length_mm", "not a finite number"),
    ("thickness_mm = 3.2", "thickness_mm = -3.2", "plate.thickness_mm", "above 0, in mm"),
    ("thickness_mm = 3.2", "thickness_mm = 1e-300", "plate.thickness_mm", "out of range"),
    ("length_mm = 260.0", "length_mm = 1e300", "plate.length_mm", "out of range"),
    ("thickness_mm = 0.02", "thickness_mm = -0.02", "plate.sd.thickness_mm", "above 0"),
    ("nu12 = 0.23", "nu12 = nan", "material.nu12", "not a finite number"),
    ("resolution_hz = 0.5", "resolution_hz = -0.5", "measurement.resolution_hz", "0 or above"),
    ("relative_std = 0.005", "relative_std = 0.0", "measurement.relative_std", "fraction"),
    ("complete = false", "complete = false\nmissed_probability = 1.0", None, "above 0 and below 1"),
    ("complete = false", "complete = false\nfalse_peaks = -1", "measurement.false_peaks", "0 or above"),
    ("complete = false", "false_peaks = 0.5", "measurement.false_peaks", "list, received 0.5, accepted: com"),
    ("complete = false", "left_out = [7]", "measurement.left_out", "received 7, accepted: 1 to 6"),
    ("complete = false", "left_out = [1, 2, 3, 4, 5, 6]", "measurement.left_out", "at least one is left"),
    ("complete = false", "left_out = [0]", "measurement.left_out item 1", "out of range"),
    ("[0.2, 0.5,", "[0.2, 0.0,", "measurement.frequency_sd_hz item 2", "above 0"),
    ("[102, 311, 342, 342, 390, 612.5]", "[342, 342, 342, 342, 342, 342]", None, "all 6 frequencies"),
    ("sd = 0.03", "sd = 0", "unknowns.nu12.sd", "above 0"),
    ('edges = "CFSF"\n', "", "plate.edges", "missing, accepted: four letters"),  # missing
    ("E2_GPa = 9.34\n", "", "material.E2_GPa", "missing"),
    ("isotropic = false\n", 'symmetry = "ortho"\n', "material.symmetry", 'accepted: "isotropic", "tran'),
    ("isotropic = false", 'isotropic = true\nsymmetry = "orthotropic"', "material.isotropic", "contradicts"),
    ('layup = "[(0/90)_8]_s"\nsequence_', "sequence_", "plate.layup", "missing"),
    ("thickness_mm = 3.2", "thickness_mm = 250", "plate.thickness_mm", "not a plate"),  # relations
    ("density_kg_m3 = 15\n", "mass_g = 15\n", "plate.sd.mass_g", "does not give"),
    ('edges = "CFSF"', 'edges = "CFS"', "plate.edges", "four letters of F S C"),
    ('edges = "CFSF"', 'edges = "CFSF\\n"', "plate.edges", "four letters of F S C"),
    ('"[(?/?/?/?)_4]_s"', '"[(0/90)_8]_s"', "plate.sequence_layup", "no unknown angle"),
    ('"[(?/?/?/?)_4]_s"', '"[?/?]_s"', "plate.sequence_layup", "received 4, accepted: 32"),
    ("E1_GPa = 121.2", "E1_GPa = 9.0", "material.E1_GPa", "E1 > E2, fourth of eq. (9); fabrics, wood and"),
    ("nu12 = 0.23", "nu12 = 0.6", "material.nu12", "second of eq. (9)"),
    ("nu12 = 0.23", "nu12 = 5", "material.nu12", "third of eq. (9)"),
    ("[10.0, 200.0]", "[200.0, 10.0]", "unknowns.E1_GPa", "ascending"),
    ("[10.0, 200.0]", "[0.0, 200.0]", "unknowns.E1_GPa", "bounds above 0"),
    ("[0.15, 0.4]", "[0.15, 1.4]", "unknowns.nu12.bounds", "within -1 and 1"),
    ("[0.15, 0.4]", "[0.3, 0.4]", "unknowns.nu12.mean", "0.3 to 0.4"),
    ("[10.0, 200.0]", "[1.0, 4.0]", "unknowns.nu12", "no physical constants"),
    ("angle_grid_deg = 15.0", "angle_grid_deg = 7.0", "unknowns.angle_grid_deg", "divides 180"),
    ("y_mm = 240.0", "y_mm = 251", "sensor item 1.y_mm", "width_mm"),
    ("[102, 311, 342,", "[102, 342, 311,", "measurement.frequencies_hz item 3", "311 after 342"),
    ("[102, 311, 342, 342, 390, 612.5]", "[]", None, "a list of 1 to 100 frequencies"),
    ("[0.2, 0.5,", "[0.2,", "measurement.frequency_sd_hz", "received 5, accepted: 6"),
    ("[plate]\n", '[plate]\nmesh = "."\n', "plate.mesh", "no such file"),
]


@pytest.mark.parametrize(("good", "bad", "key", "said"), SPOILT, ids=[s[1][:40] for s in SPOILT])
def test_each_error_names_file_line_key_and_what_is_accepted(full_text, good, bad, key, said):
    assert full_text.count(good) >= 1
    text = full_text.replace(good, bad, 1)
    problems = problems_of(text)
    matching = [problem for problem in problems if said in problem]
    assert matching, problems
    if key is None:
        return
    place = re.match(r"plate\.toml:(\d+): ([^:]+): ", matching[0])
    assert place.group(2) == key
    assert len(problems) == 1, problems
    line = text.split("\n")[int(place.group(1)) - 1]  # the key's line, or the head of its table
    last = re.sub(r" item \d+$", "", key).split(".")[-1]
    table = re.sub(r" item \d+$", "", key).split(".")[-2] if "." in key else ""
    assert last in line or ("missing" in said and table in line)


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

WRITTEN = {
    'layup = "[0/90]_2s"': ["[0, 90, 0, 90, 90, 0, 90, 0]"],
    'edges = "FFFF"': [*FREE, '["free", "free", "free", "free"]'],
    "length_mm = 310.0": ['"310"', '"310 mm"', '"0,31 m"'],
    "thickness_mm = 3.1": ['"0,31 cm"'],
    "mass_g = 340.7": ['"0,3407 kg"', "'340.7g'"],
    "E1_GPa = 132.0": ['"132000 MPa"'],
    "E1_GPa = [60.0, 250.0]": ['["60 GPa", "250 GPa"]'],
    f"frequencies_hz = {LIST}": [
        *('"80,2 146,3 218,6 275,1"', '"80.2; 146.3; 218.6; 275.1"', '"80.2, 146.3, 218.6, 275.1"'),
        '["0.0802 kHz", 146.3, 218.6, 275.1]',
    ],
    "relative_std = 0.002": ['"0.2 %"'],
    "air_density_kg_m3 = 1.2": ['"1,2 kg/m\u00b3"'],
}
UNDERSTOOD = [
    (good, f"{good.split()[0]} = {value}") for good, written in WRITTEN.items() for value in written
]

REFUSED = [  # the same, and text in the single message
    (LIST, "[80,2, 146,3, 218, 275,1]", "decimal commas?"),
    ("nu12 = 0.31", "nu12=[0,15, 0,45]", "0,15 is two numbers"),
    ('name = "panel"', "date = 5.3.2026", 'a date stands in quotes: "5.3.2026"'),
    (LIST, "[80.2 Hz, 146.3 Hz]", "the unit is in the key: 80.2, not 80.2 Hz"),
    (LIST, "[275.1, 218.6, 146.3, 80.2]", "the other way round"),
    (LIST, "[80.2, 1463, 218.6, 275.1]", "1463 lost its decimal comma? 146.3 would"),
    (LIST, "[80.2 146.3 218.6]", "the numbers of a list: 80.2, 146.3"),
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
    ("[plate]\n", "[PLATE]\n", "PLATE: unknown key, the nearest known key is plate"),  # tables and keys
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
    ('name = "panel"', "name = \u00abpanel\u00bb", 'quotes are "'),  # texts
    ('name = "panel"', "name = \u2018panel\u2019", 'quotes are "'),
    ('name = "panel"', 'name = "panel', "a quote is missing"),
    ('layup = "[0/90]_2s"', 'layup = "(0/90)_2s"', 'a layup begins with "["'),
    ('layup = "[0/90]_2s"', 'layup = "[0/100]"', "angle 100, accepted: -90 to 90"),
    ('edges = "FFFF"', 'edges = "h\u00e4ngend"', 'received "h\u00e4ngend", accepted: four letters'),
    ("thickness_mm = 3.1", "thickness_mm = .31", "a digit on each side of a point"),  # numbers
    ("thickness_mm = 3.1", "thickness_mm = 3.1 // gauged", "# begins a comment"),
    ("mass_g = 340.7", "density_g_cm3 = 1.6", "the nearest known key is density_kg_m3"),
    (PLY, "E1_GPa = 132e9\nE2_GPa = 9.1e9\nnu12 = 0.31\nG12_GPa = 4.8e9\n", "1.32e+11 Pa are 132 GPa"),
    ("mass_g = 340.7\n", "", "plate.toml:2: plate: density, received neither"),
    (f"[material]\n{PLY}", "", "material: missing, accepted: a table [material]"),
    (GOOD[GOOD.index("[plate]") : GOOD.index("[material]")], "", "plate: missing, accepted: a table [plate]"),
    ("[60.0, 250.0]", '"60-250"', "accepted: [lower, upper]"),
    ("[60.0, 250.0]", "[60,0, 250,0]", "are these decimal commas?"),
    ("x_mm = 300.0\ny_mm = 220.0", "x_mm = 3000\ny_mm = 2200", "outside the plate, received 3000"),
    ("relative_std = 0.002", "relative_std = 2", "0.2 % is 0.002"),
    (LIST, "[80,85, 146,350, 218,6]", "are these decimal commas?"),  # the list
    (LIST, "[80.2; 146.3; 218.6]", "commas part the numbers of a list"),
    (LIST, "(80.2, 146.3)", "a list stands in [ ]"), (LIST, "80.2, 146.3, 218.6", "a list stands in [ ]"),
    (LIST, "[80,2; 146,3]", "a decimal point, not a comma: 80.2"),
    (LIST, "[80; 146,3]", "a decimal point, not a comma: 146.3"),
    (LIST, "[-12.5; 3]", "commas part the numbers of a list: -12.5, 3"),
    (LIST, "[1e2; 2e2]", "commas part the numbers of a list: 1e2, 2e2"),
    (LIST, "[80.2, 146.3", "is a ] missing"),
    (LIST, "[0, 0, 0, 0, 0, 0, 80.2, 146.3]", "no rigid-body motion; so are 5 more items"),
    (LIST, '[80.2, "n/a", "-", 218.6]', 'item 2: wrong type, received "n/a"'),
    (f"frequencies_hz = {LIST}", 'table = "plate.csv"', 'the nearest there is "plate7.csv"'),
]  # fmt: skip


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
def test_a_slip_is_one_message_with_its_cure(tmp_path, good: str, written: str, said: str) -> None:
    assert good in GOOD
    (tmp_path / "plate7.csv").touch()
    problem = one_problem(GOOD.replace(good, written, 1), tmp_path)
    assert said in problem
    assert re.match(r"plate\.toml:\d+: ", problem)
    assert len(problem) < 600


def test_no_cure_has_a_part_of_a_number_and_entries_with_a_point_lost_no_comma() -> None:
    problem = one_problem(GOOD.replace(LIST, "[80,5,2 146,3]"))
    assert "not valid TOML" in problem
    assert "2, 146" not in problem
    problem = one_problem(GOOD.replace(LIST, "[20.2, 403.6, 347.8, 475.1]"))
    assert problem.endswith("accepted: ascending, equal ones for a degenerate pair")


@pytest.mark.parametrize(("tables", "said"), MATERIALS)
def test_a_material_that_cannot_be_is_refused_by_the_rule_of_its_symmetry(tables, said):
    plate, _, _ = BAR.partition("[material]\n")
    problem = one_problem(f'{plate}layup = "[0]"\n[material]\n{tables}')
    assert said in problem
    assert "eq. (9)" not in problem


def test_all_errors_of_a_file_come_at_once_in_the_order_of_their_lines(full_text):
    text = (
        full_text.replace("width_mm = 250", "width_mm = -250")
        .replace('"[(0/90)_8]_s"', '"[(0/90]_s"')
        .replace("[plate.sd]\nthickness_mm", "[plate.sd]\nthicknes_mm")
        .replace("E1_GPa = 121.2", "E1_GPa = 9.0")
        .replace("[10.0, 200.0]", "[200.0, 10.0]")
        .replace("[102, 311, 342", "[102, 342, 311")
        .replace('["(1,1)", ', "[")
    )
    with pytest.raises(PlateFileError) as caught:
        parse_specimen(text, "plate.toml")
    problems = caught.value.problems
    assert str(caught.value) == "\n".join(problems)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    assert not any("no physical constants" in problem for problem in problems)
    lines, keys = zip(*(re.match(r"plate\.toml:(\d+): ([^:]+):", p).groups() for p in problems), strict=True)
    assert ", ".join(keys) == (
        "plate.width_mm, plate.layup, plate.sd.thicknes_mm, material.E1_GPa, unknowns.E1_GPa, "
        "measurement.frequencies_hz item 3, measurement.labels"
    )
    assert list(lines) == sorted(lines, key=int)


def test_an_isotropic_plate_has_two_constants():
    problems = problems_of(f"{BAR}G12_GPa = 25\n[material.sd]\nG12_GPa = 2\n[unknowns]\nG12_GPa = [5, 30]\n")
    for problem, table in zip(problems, ("material", "material.sd", "unknowns"), strict=True):
        assert f": {table}.G12_GPa: " in problem
        assert "E1_GPa and nu12 only" in problem


def test_only_the_problems_that_are_shown_are_put_in_words(monkeypatch):
    nearest = Mock(wraps=schema.difflib.get_close_matches)
    monkeypatch.setattr(schema.difflib, "get_close_matches", nearest)
    problems = problems_of("".join(f"key{i} = 1\n" for i in range(20_000)))
    assert len(problems) == 101
    assert "more problems" in problems[-1]
    assert 0 < nearest.call_count <= 100


@pytest.mark.parametrize("said", TOO_MANY)
def test_too_many_of_a_kind_are_one_problem(said):
    problems = problems_of(TOO_MANY[said])
    assert [f"too many, {said}" in problem for problem in problems if "too many" in problem] == [True]
    assert len(problems) < 6  # besides what is missing


def test_sensors_heavier_than_the_plate_are_refused_with_its_mass(full_text):
    said = one_problem(full_text.replace("mass_g = 0.5", "mass_g = 500.0"))
    assert "sensor item 2.mass_g: heavier than the plate, received 501.2 in all" in said
    assert "accepted: up to 330.7" in said
    assert parse_specimen(full_text.replace("mass_g = 0.5", "mass_g = 300.0"), "x").sensors[1].mass == 0.3


def test_received_values_are_shown_short_and_printable(full_text):
    red = "\\u001b[31m"
    for old, new in (("CFSF", "F" * 100_000), ("CFSF", red), ("[unknowns]", f'[unknowns]\n"{red}" = 1')):
        problem = one_problem(full_text.replace(old, new))
        assert len(problem) < 400
        assert "\x1b" not in problem


@pytest.mark.parametrize(
    ("text", "line"),
    [
        *(
            ("a = 1\nb = = 2\n", 2),
            ('a = "\x1b"\n', 1),
            ("a = 1\n\nb = [1, 2\n", 3),
            ("x = 1" + "0" * 5000, 1),
        ),
        *(("a = " + "[" * 100_000, 1), (f"{LONG_KEY} = 1", 1), (f"b = 1\nx = {{{LONG_KEY} = 1}}", 2)),
    ],
    ids=lambda given: f"{given!r:.20}",
)
def test_invalid_toml_is_one_message_with_its_line(monkeypatch, text, line):
    if LONG_KEY in text:  # never reaches the parser, which is quadratic in its parts
        monkeypatch.setattr(tomllib, "loads", lambda text: pytest.fail("parsed"))
    problem = one_problem(text)
    assert ("a key of 50000 parts, accepted: up to 100" in problem) == (LONG_KEY in text)
    assert problem.startswith(f"plate.toml:{line}: file: ")
    assert "\n" not in problem
    assert "\x1b" not in problem
    assert len(problem) < 300
