"""Plate files are opened, parsed with the line of every key, and converted to SI."""

import os
import tomllib
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from cpam_bayes.errors import PlateFileError
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import MAX_BYTES, angle_grid, parse_specimen, read_specimen, to_si, to_user, user_name
from cpam_bayes.plate.text import line_numbers
from tests.effort import peak_memory
from tests.plate_file import BAR

LISTED = f"""{BAR}[measurement]
frequencies_hz = [115.0, 317.0, 622.0]
labels = ["a", "b", "c"]
frequency_sd_hz = [0.1, 0.2, 0.3]
"""
ORTHOTROPIC = {
    "balanced fabric": "E1_GPa = 60\nE2_GPa = 60\nnu12 = 0.05\nG12_GPa = 4",
    "spruce": "isotropic = false\nE1_GPa = 11\nE2_GPa = 0.9\nnu12 = 0.51\nG12_GPa = 0.8",
    "any ratio below the square root of 3": "E1_GPa = 3\nE2_GPa = 1\nnu12 = 1.0\nG12_GPa = 1",
}
ENCODINGS = {"no mark": "utf-16-le", "old lines": "utf-8", "lines of Windows": "utf-8"}
PLACES = (
    "2 top, 5 a.b, 6 quoted key, 7 plate, 8 plate.sd.x, 9 plate.inline.y, 9 plate.inline.z.0, "
    "10 plate.inline.z.1, 10 plate.inline.w.v, 11 sensor, 12 sensor.0.mass, 13 sensor.1, 14 sensor.1.mass, "
    "15 sensor.1.mass.0, 17 sensor.1.mass.1, 19 sensor.1.place, 20 sensor.1.place.x"
)
NO_FILE = "neither a file nor a built-in"


@pytest.mark.parametrize(("row", "kept", "complete"), [(3, [115.0, 317.0], True), (1, [317.0, 622.0], False)])
def test_a_frequency_left_out_is_not_used_and_this_and_a_strange_repeatability_are_said(row, kept, complete):
    measurement = parse_specimen(f"{LISTED}left_out = [{row}]\nby_hand = [2]\n", "x").measurement
    assert measurement.frequencies.tolist() == kept
    assert len(measurement.labels) == len(measurement.frequency_sd) == 2
    assert measurement.complete is complete, "a list without its last rows has every mode from the first on"
    assert measurement.whole.frequencies.tolist() == [115.0, 317.0, 622.0]
    left, added = measurement.remarks
    assert f"frequency {row} of the list" in left
    assert "317 Hz, was added by hand" in added
    (said,) = parse_specimen(f"{LISTED}relative_std = 0.2\n", "x").measurement.remarks
    assert "20 % of a frequency" in said
    assert "0.2 % is 0.002" in said


def test_every_key_arrives_in_si(plate_file, full_text):
    specimen = read_specimen(plate_file(text=full_text))
    plate, material, measurement = specimen.plate, specimen.material, specimen.measurement
    assert (specimen.name, specimen.specimen, specimen.notes) == ("plate 7", "seven", ("cut from the edge",))
    assert (plate.length, plate.width, plate.thickness) == (0.26, 0.25, 0.0032)
    assert (plate.density, plate.mass, plate.edges) == (1590.0, None, "CFSF")
    assert plate.area == pytest.approx(0.065, rel=1e-15)
    assert plate.sd == {"thickness": 2e-5, "density": 15.0}
    assert (plate.layup.text, plate.mesh) == ("[(0/90)_8]_s", None)
    assert specimen.with_unknown_angles().plate.layup.text == "[(?/?/?/?)_4]_s"
    alone = full_text.replace('sequence_layup = "[(?/?/?/?)_4]_s"\n', "")
    assert parse_specimen(alone, "x").with_unknown_angles().plate.layup.text == "[(0/90)_8]_s"
    assert (material.name, material.symmetry) == ("carbon", "transversely_isotropic")
    assert set(material.constants) == {"E1", "E2", "nu12", "G12", "G23"}
    assert material.constants["E1"] == pytest.approx(121.2e9, rel=1e-15)
    assert material.sd == {"E1": 12e9, "nu12": 0.02}
    assert (specimen.angle_grid_deg, specimen.air_density) == (15.0, 1.2)
    assert [(s.mass, s.x, s.y) for s in specimen.sensors] == [(0.0012, 0.25, 0.24), (0.0005, 0, 0)]
    assert measurement.frequencies.tolist() == [102, 311, 342, 342, 390, 612.5]
    assert measurement.frequency_sd.tolist() == [0.2, 0.5, 0.5, 0.6, 0.6, 1.0]
    assert (measurement.resolution, measurement.relative_std) == (0.5, 0.005)
    assert measurement.labels == ("(1,1)", "", "", "", "", "")
    listed = measurement.complete, measurement.missed_probability, measurement.false_peaks
    assert listed == (False, 0.1, 0.1)
    unknowns = specimen.unknowns
    assert {p.name: p.unit for p in unknowns.parameters} == {"E1": "Pa", "E2": "Pa", "nu12": "", "G12": "Pa"}
    assert unknowns["E1"].prior == Uniform(10e9, 200e9)
    assert unknowns["nu12"].prior == TruncatedNormal(0.28, 0.03, 0.15, 0.4)


def test_a_normal_modulus_a_mesh_beside_the_file_and_how_complete_a_list_is_can_be_said(tmp_path, full_text):
    (tmp_path / "plate.msh").touch()
    text = full_text.replace(
        "complete = false", "missed_probability = 0.3\nfalse_peaks = 0\ncomplete = false"
    )
    text = text.replace("[plate]\n", '[plate]\nmesh = "plate.msh"\n')
    text = text.replace("[10.0, 200.0]", "{ mean = 120, sd = 10, bounds = [80, 160] }")
    specimen = parse_specimen(text, "x", tmp_path)
    assert specimen.unknowns["E1"].prior == TruncatedNormal(120e9, 10e9, 80e9, 160e9)
    assert specimen.plate.mesh == tmp_path / "plate.msh"
    measurement = specimen.measurement
    assert (measurement.missed_probability, measurement.false_peaks) == (0.3, 0.0)


def test_what_may_be_left_out_may_be_left_out():
    text = BAR.replace("density_kg_m3 = 2700", "mass_g = 162")
    specimen = parse_specimen(text, "x")
    assert (specimen.specimen, specimen.measurement, specimen.plate.mass) == ("bar", None, 0.162)
    assert specimen.plate.density == pytest.approx(2700.0, rel=1e-14)
    assert specimen.plate.layup.angles_deg.tolist() == [0.0]
    assert (specimen.unknowns.size, specimen.angle_grid_deg, specimen.air_density) == (0, 5.0, None)
    assert specimen.sensors == specimen.notes == ()
    listed = parse_specimen(text + "[measurement]\nfrequencies_hz = [1, 2]\n", "x").measurement
    assert (listed.size, listed.resolution, listed.complete, listed.labels) == (2, 0.0, True, ("", ""))
    assert listed.relative_std is listed.frequency_sd is None


def test_density_and_mass_together_measure_the_thickness(full_text):
    alone = parse_specimen(full_text, "x").plate  # a plate 1 % heavier is 1 % thicker by its density
    mass = 1.01 * alone.density * alone.thickness * alone.area
    text = full_text.replace("density_kg_m3 = 1590.0", f"density_kg_m3 = 1590.0\nmass_g = {1e3 * mass}")
    text = text.replace(
        "thickness_mm = 0.02\ndensity_kg_m3 = 15",
        "thickness_mm = 0.032\ndensity_kg_m3 = 15.9\nmass_g = 0.001\nlength_mm = 0.001\nwidth_mm = 0.001",
    )
    plate = parse_specimen(text, "x").plate
    assert plate.mass == pytest.approx(mass)
    assert plate.thickness == pytest.approx(1.005 * alone.thickness, rel=2e-4)  # the mean of two at 1 %
    assert plate.sd["thickness"] == pytest.approx(0.032e-3 / 2**0.5, rel=0.02)
    assert plate.density * plate.thickness * plate.area == pytest.approx(mass)
    assert "density" not in plate.sd


@pytest.mark.parametrize("name", ORTHOTROPIC)
def test_a_composite_is_orthotropic_in_any_order_where_it_is_said_to_be(full_text, name):
    before, _, after = full_text.partition("[material]")
    after = after.partition("[unknowns]")[2].replace("nu12 = {", "nu12 = [-1.5, 1.5] # {")
    material = f'[material]\nsymmetry = "orthotropic"\n{ORTHOTROPIC[name]}\n'
    specimen = parse_specimen(f"{before}{material}[unknowns]{after}", "x")
    assert (specimen.material.symmetry, specimen.material.isotropic) == ("orthotropic", False)
    assert specimen.unknowns["nu12"].prior == Uniform(-1.5, 1.5)
    complete = specimen.material.complete()
    assert complete["G13"] == complete["G23"] == complete["G12"]
    unsaid = parse_specimen(full_text.replace("isotropic = false\n", ""), "x").material
    assert (unsaid.symmetry, unsaid.isotropic) == ("transversely_isotropic", False)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", *ENCODINGS])
def test_a_file_is_read_however_an_editor_saves_it_through_a_link_too(tmp_path, encoding):
    path, link = tmp_path / "plate.toml", tmp_path / "link.toml"
    mark = "\ufeff" if encoding in ("utf-16-le", "utf-16-be") else ""
    text = mark + BAR.replace('"bar"', '"Pr\u00fcfplatte"')
    text = text.replace("\n", {"old lines": "\r", "lines of Windows": "\r\n"}.get(encoding, "\n"))
    path.write_bytes(text.encode(ENCODINGS.get(encoding, encoding)))
    link.symlink_to(path)
    assert read_specimen(str(path)).name == read_specimen(str(link)).name == "Pr\u00fcfplatte"


TEXT = '''# a comment with [brackets] and = signs
top = """
[not.a.table]
"""
a.b = 1  # dotted
"quoted key" = 'it' # odd
[plate] # after
  "sd".x = 1_000
  inline = { y = 1, z = [2,
    3], "w" = { v = 4 } }
[[sensor]]
mass = 1
[[sensor]]
mass = [
  1, # one

  "a, ] b",
]
[sensor.place]
x = 1979-05-27 07:32:00
'''


def test_lines_of_tables_keys_and_elements_are_found():
    tomllib.loads(TEXT)
    lines = line_numbers(TEXT)
    for place in PLACES.split(", "):
        line, _, key = place.partition(" ")
        path = tuple(int(part) if part.isdigit() else part for part in key.split("."))
        assert lines.get(path) == int(line), key
    assert ("not",) not in lines


class Counted(str):
    """A text that counts how many of its characters were searched for line ends."""

    searched = 0

    def count(self, part, start=0, end=None):
        self.searched += (len(self) if end is None else end) - start
        return super().count(part, start, end)


def test_a_large_file_is_scanned_once():
    text = Counted("x = [\n" + "1.0, # one\n" * 2000 + "]\n")
    assert line_numbers(text)[("x", 1999)] == 2001
    assert text.searched <= len(text)


def sparse(path):
    path.touch()
    os.truncate(path, 10**9)


def circle(path):
    path.symlink_to("b")
    path.with_name("b").symlink_to(path.name)


def nearest(path):
    path.with_name("panel.toml").touch()


@pytest.mark.parametrize(
    ("name", "said", "make"),
    [
        *((name, NO_FILE, None) for name in ("none.toml", "", "\x1b[31m.toml")),
        *(("C5", "C4", None), ("c1", "built-in: C1", None), ("d&g", "built-in: D&G", None)),
        ("specimen", "D&G A1 A2", None),
        *((n, "no such file, the nearest there is panel.toml", nearest) for n in ("panle.toml", "panel")),
        (".", "a directory, accepted: a plate file", None),
        ("plate.toml", "a binary file, accepted", bytes(range(256)) * 10),
        ("plate.toml", "plate.toml:2: file: not UTF-8 text, received byte 0xe9", b"a = 1\nname = '\xe9'\n"),
        ("list.csv", "no plate file, received .csv, accepted: a TOML text", b"mode,hz\n1,80.2\n2,146.3\n"),
        ("list.xlsx", "no plate file, received .xlsx", b"PK\x03\x04\x14\0\0\0"),
        ("report.pdf", "no plate file, received .pdf", b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"),
        ("plate.json", "no plate file, received .json", b'{"plate": {"length_mm": 310}}'),
        ("plate.toml", "nothing is in it, accepted: a TOML text, as `cpam-bayes new FILE` writes", b""),
        ("plate.toml", 'a list of frequencies is its table = "FILE"', b"# to be done\n"),
        ("plate.toml", f"received 1000000000 bytes, accepted: up to {MAX_BYTES}", sparse),
        pytest.param("pipe", "pipe or device", os.mkfifo, id="a pipe, without waiting for a writer"),
        ("/dev/zero", "pipe or device", None),
        *((name, "cannot be read", make) for name, make in (("a", circle), ("plate\0.toml", None))),
        ("x" * 5000, "cannot be read", None),
    ],
)
def test_what_is_no_plate_file_is_one_problem(tmp_path, monkeypatch, name, said, make):
    monkeypatch.chdir(tmp_path)
    if isinstance(make, bytes):
        Path(name).write_bytes(make)
    elif make is not None:
        make(Path(name))
    with peak_memory() as peak, pytest.raises(PlateFileError) as caught:
        read_specimen(name)
    assert peak() < 2 * MAX_BYTES  # the buffer of one file of that size, and little more
    (problem,) = caught.value.problems
    assert said in problem
    assert problem.isprintable()


def test_a_file_that_may_not_be_read_is_refused(monkeypatch, plate_file):
    path = plate_file()
    # not by chmod: root, which runs some CI, may read everything
    monkeypatch.setattr(os, "open", Mock(side_effect=PermissionError(13, "Permission denied")))
    with pytest.raises(PlateFileError, match="cannot be read: Permission denied"):
        read_specimen(path)


def test_numbers_are_scaled_without_rounding_twice():
    for user, value, name, si in (
        *(("E1_GPa", 121.2, "E1", 121.2e9), ("nu12", 0.23, "nu12", 0.23), ("mass_g", 1.2, "mass", 0.0012)),
        *(("length_mm", 3.2, "length", 0.0032), ("density_kg_m3", 1590.0, "density", 1590.0)),
    ):
        assert (to_si(user, value), user_name(name), to_user(name, si)) == (si, user, value)
    for convert in (to_si, to_user):
        with pytest.raises(ValueError, match="accepted"):
            convert("rho", 1.0)


@pytest.mark.parametrize("step", [0.1, 0.3, 5.0, 22.5, 36.0, 180.0])
def test_the_angle_grid_of_eq_10_ends_at_90_and_omits_minus_90(step):
    grid = angle_grid(step)
    assert grid.size == round(180.0 / step)
    np.testing.assert_allclose(grid, 90.0 - step * np.arange(grid.size)[::-1], atol=1e-11)
    assert grid[-1] == 90.0
    assert np.all(grid == np.round(grid, 1))


@pytest.mark.parametrize("step", [7.0, 0.0, -5.0, 1e-9, 200.0, float("nan"), float("inf")])
def test_steps_that_do_not_divide_180_are_refused(step):
    with pytest.raises(ValueError, match="accepted"):
        angle_grid(step)
