"""A plate file with every key, and one whose measurement is a table."""

import re
from pathlib import Path

import pytest

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate import Measurement, Specimen
from tests.plate_file import OF_TABLE

FULL = """\
name = "plate 7"
specimen = "seven"
notes = ["cut from the edge"]
[plate]
length_mm = 260.0
width_mm = 250
thickness_mm = 3.2
density_kg_m3 = 1590.0
layup = "[(0/90)_8]_s"
sequence_layup = "[(?/?/?/?)_4]_s"
edges = "CFSF"
[plate.sd]
thickness_mm = 0.02
density_kg_m3 = 15
[material]
name = "carbon"
isotropic = false
E1_GPa = 121.2
E2_GPa = 9.34
nu12 = 0.23
G12_GPa = 6.25
G23_GPa = 3.0
[material.sd]
E1_GPa = 12.0
nu12 = 0.02
[unknowns]
E1_GPa = [10.0, 200.0]
E2_GPa = [5, 40]
nu12 = { mean = 0.28, sd = 0.03, bounds = [0.15, 0.4] }
G12_GPa = [5.0, 30.0]
angle_grid_deg = 15.0
[environment]
air_density_kg_m3 = 1.2
[[sensor]]
mass_g = 1.2
x_mm = 250.0
y_mm = 240.0
[[sensor]]
mass_g = 0.5
x_mm = 0.0
y_mm = 0.0
[measurement]
frequencies_hz = [102, 311, 342, 342, 390, 612.5]
resolution_hz = 0.5
relative_std = 0.005
frequency_sd_hz = [0.2, 0.5, 0.5, 0.6, 0.6, 1.0]
labels = ["(1,1)", "", "", "", "", ""]
complete = false
"""


@pytest.fixture
def full_text():
    return FULL


@pytest.fixture
def read(tmp_path: Path):
    """Read a plate file whose measurement is in a file of some content, a table of modes by default."""

    def reading(
        content: str | bytes, more: str = "", *, key: str = "table", name: str = "modes.csv"
    ) -> Specimen:
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
        path = tmp_path / "bar.toml"
        path.write_text(f'{OF_TABLE}{key} = "{name}"\n{more}', encoding="utf-8")
        return cb.read_plate(path)

    return reading


@pytest.fixture
def measured(read):
    def measurement(content: str | bytes, more: str = "", **file: str) -> Measurement:
        found = read(content, more, **file).measurement
        assert found is not None
        return found

    return measurement


@pytest.fixture
def refused(read):
    """The problems of such a file, each without its key and the name and line of the plate file."""

    def problems(content: str | bytes, more: str = "", *, key: str = "table", **file: str) -> list[str]:
        with pytest.raises(PlateFileError) as caught:
            read(content, more, key=key, **file)
        place = re.compile(rf".*bar\.toml:{1 + OF_TABLE.count(chr(10))}: measurement\.{key}: ")
        assert all(place.match(problem) for problem in caught.value.problems), caught.value.problems
        return [place.sub("", problem) for problem in caught.value.problems]

    return problems
