"""A plate file with every key, and one whose measurement is a table."""

import re
from pathlib import Path

import pytest

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate import Measurement, Specimen
from tests.plate_file import OF_TABLE


@pytest.fixture
def full_text():
    return Path(__file__).with_name("full.toml").read_text("utf-8")


@pytest.fixture
def read(tmp_path: Path):
    """Read a plate file whose measurement is in a file with this content, by default a table of modes."""

    def reading(
        content: str | bytes, more: str = "", key: str = "table", name: str = "modes.csv"
    ) -> Specimen:
        (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
        path = tmp_path / "bar.toml"
        path.write_text(f'{OF_TABLE}{key} = "{name}"\n{more}', encoding="utf-8")
        return cb.read_plate(path)

    return reading


@pytest.fixture
def measured(read):
    def measurement(*content: str | bytes, **file: str) -> Measurement:
        return read(*content, **file).measurement

    return measurement


@pytest.fixture
def refused(read):
    """Problems of such a file, each without its key and the name and line of the plate file."""

    def problems(content: str | bytes, more: str = "", *, key: str = "table", **file: str) -> list[str]:
        with pytest.raises(PlateFileError) as caught:
            read(content, more, key=key, **file)
        place = re.compile(rf".*bar\.toml:{1 + OF_TABLE.count(chr(10))}: measurement\.{key}: ")
        assert all(place.match(problem) for problem in caught.value.problems), caught.value.problems
        return [place.sub("", problem) for problem in caught.value.problems]

    return problems
