"""docs/plate_file.md lists every key of a plate file with its unit, its default and a valid example."""

import re
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

import numpy as np
import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from scipy.io import wavfile

import cpam_bayes as cb
from cpam_bayes.plate.schema import PlateFile
from tests.hybrids import HYBRID
from tests.plate_file import SHEET, described
from tests.posteriors import write_posterior
from tests.universal import grid, mode_55, nodes_15
from validation.recorded_hits import RATE, Faults, recorded_hits

PAGE = (Path(__file__).parents[2] / "docs" / "plate_file.md").read_text(encoding="utf-8")
TOP, PRIOR = "The top of the file", "{ mean, sd, bounds }"
UNITS = {"mm": "mm", "g": "g", "m3": "kg/m³", "GPa": "GPa", "hz": "Hz", "deg": "°"}
FILE = described(  # All values that may have a standard deviation.
    (310.0, 228.0, 3.1),
    1555.0,
    {**SHEET, "G13_GPa": 4.8, "G23_GPa": 3.2},
    layup="[(0/90)_8]_s",
    unknowns={"nu12": {"mean": 0.31, "sd": 0.03, "bounds": [0.15, 0.45]}},
    sensor=[{"mass_g": 1.0, "x_mm": 10.0, "y_mm": 10.0}],
    measurement={"frequencies_hz": [80.2, 146.3, 218.6]},
)


def parts(annotation: Any) -> Iterator[Any]:
    yield annotation
    if get_origin(annotation) in (Union, UnionType, Annotated, list):
        for part in get_args(annotation):
            yield from parts(part)


def tables(model: type[BaseModel], heading: str) -> dict[str, dict[str, FieldInfo]]:
    found: dict[str, dict[str, FieldInfo]] = {heading: {}}
    for key, field in model.model_fields.items():
        inside = list(parts(field.annotation))
        models = [part for part in inside if isinstance(part, type) and issubclass(part, BaseModel)]
        own = f"[{key if heading == TOP else f'{heading[1:-1]}.{key}'}]"
        own = PRIOR if heading == "[unknowns]" else f"[{own}]" if list in map(get_origin, inside) else own
        for inner in models:
            for name, keys in tables(inner, own).items():
                found.setdefault(name, {}).update(keys)
        if not models or heading == "[unknowns]":
            found[heading][key] = field
    return found


TABLES = tables(PlateFile, TOP)


def documented(heading: str) -> dict[str, dict[str, str]]:
    title = heading if heading == TOP else f"`{heading}`"
    section = PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    lines = [line.strip("|").split(" | ") for line in section.splitlines() if "|" in line]
    rows = [[cell.strip() for cell in line] for line in lines]
    columns, rows = [cell.strip("| ") for cell in rows[0]], rows[2:]
    return {row[0].strip("| `"): dict(zip(columns, row, strict=True)) for row in rows}


KEYS = [(heading, key) for heading, keys in TABLES.items() for key in keys]


def test_the_page_has_a_row_for_every_key_of_every_table_and_no_other() -> None:
    headings = [heading.strip("`") for heading in re.findall(r"^## (.*)$", PAGE, re.MULTILINE)]
    rows = {heading: sorted(documented(heading)) for heading in headings}
    assert rows == {heading: sorted(keys) for heading, keys in TABLES.items()}


@pytest.mark.parametrize(("heading", "key"), KEYS)
def test_a_row_says_unit_and_default(heading: str, key: str) -> None:
    row, field = documented(heading)[key], TABLES[heading][key]
    assert row["unit"] == ("of the key" if heading == PRIOR else UNITS.get(key.rpartition("_")[2], "-"))
    assert (row["default"] == "required") == field.is_required()
    if isinstance(field.default, bool | float):
        assert row["default"] == str(field.default).lower()
    assert len(row["what it says"]) > 10


def _hybrid_with(heading: str, key: str, value: Any) -> dict[str, Any]:
    """A hybrid with the example in its ply, or in both of its materials."""
    file = deepcopy(HYBRID)
    ply = file["ply"][1] = {"name": "g", "material": "glass", "thickness_mm": 0.25}
    for table in [ply] if heading == "[[ply]]" else file["material"].values():
        table[key] = value
    file["material"][ply["material"]] = file["material"].pop("glass")
    file["plate"]["layup"] = f"[c0/{ply['name']}90]_s"
    file["plate"]["thickness_mm"] = 2.0 * (0.25 + ply["thickness_mm"])
    return file


def with_example(heading: str, key: str, value: Any) -> dict[str, Any]:
    """The file with the example of a key, and with the changes that the key requires."""
    file = deepcopy(FILE)
    if key == "mass_g" and heading.startswith("[plate"):
        del file["plate"]["density_kg_m3"]
        file["plate"]["mass_g"] = 340.7
    if heading == "[measurement.columns]":
        file["measurement"] = {"peaks": "levels.csv"} if key == "height" else {"table": "named.csv"}
    if key in ("table", "shapes", "recordings", "peaks", "range_hz"):
        del file["measurement"]["frequencies_hz"]
    if key == "range_hz":
        file["measurement"]["recordings"] = ["hits"]
    if heading == "[[ply]]" or (heading, key) == ("[material]", "density_kg_m3"):
        return _hybrid_with(heading, key, value)
    if key in ("missed_probability", "false_peaks"):
        file["measurement"]["complete"] = False
    if key == "posterior":
        file["unknowns"] = {"E1_GPa": [80.0, 200.0]}
    if heading in (PRIOR, "[[sensor]]"):
        table = file["unknowns"]["nu12"] if heading == PRIOR else file["sensor"][0]
    else:
        table = file
        for name in [] if heading == TOP else heading.strip("[]").split("."):
            table = table.setdefault(name, {})
    table[key] = value
    return file


@pytest.mark.parametrize(("heading", "key"), KEYS)
def test_the_example_of_a_key_is_accepted(heading: str, key: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plate.msh").touch()
    write_posterior(tmp_path / "posterior.nc", {"E1_GPa": np.linspace(120.0, 140.0, 200)})
    points = grid(310.0, 228.0)
    twist = np.stack((*np.zeros((2, len(points))), (points[:, 0] - 155.0) * (points[:, 1] - 114.0)))
    named = "Nr;Form;Peak A [Hz];Tap;Streuung;Verlust;Wert\n1;a;80.2;1;0.1;0.01;1\n2;b;146.3;1;0.1;0.01;1\n"
    files = {
        "modes.unv": nodes_15(points) + mode_55(80.2, twist),
        "modes.csv": "mode,hz\n1,80.2\n2,146.3\n",
        "named.csv": named,
        "levels.csv": "hz;Pegel\n80.2;5\n146.3;2\n",
        "peaks.csv": "hz,height\n80.2,5\n146.3,2\n",
    }
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    if key in ("recordings", "range_hz"):
        (tmp_path / "hits").mkdir()
        hit = recorded_hits(np.random.default_rng(0), np.array([80.2, 146.3]), np.full(2, 0.01), 1, Faults())
        wavfile.write(tmp_path / "hits" / "1.wav", RATE, hit[0])
    example = tomllib.loads(documented(heading)[key]["example"].strip("`"))
    assert list(example) == [key]
    cb.read_plate(with_example(heading, key, example[key]))
