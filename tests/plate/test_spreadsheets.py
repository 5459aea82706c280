"""Tables of laboratories are read, wide and long, in their languages; others are one clear message."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest

import cpam_bayes as cb
from cpam_bayes.errors import PlateFileError
from tests.plate_file import BAR

MODES = [101.5, 305.25, 333.0]
# hits of three modes, whose means are these
HITS = [[101.4, 305.2, 333.1], [101.6, 305.3, 332.9]]


def wide(separator: str, heads: list[str], *, first: str = "", mark: str = ".", more: str = "") -> str:
    lines = [separator.join(([first] if first else []) + heads)]
    for i, hit in enumerate(HITS, 1):
        lines.append(separator.join(([str(i)] if first else []) + [f"{f}".replace(".", mark) for f in hit]))
    return "\n".join(lines) + f"\n{more}"


def across(separator: str, heads: list[str]) -> str:
    rows = [[str(i), *(f"{hit[i - 1]}" for hit in HITS)] for i in (1, 2, 3)]
    return "\n".join(separator.join(row) for row in [heads, *rows]) + "\n"


def sheet(rows: list[list[Any]], *, before: list[list[Any]] | None = None) -> bytes:
    book = openpyxl.Workbook()
    if before is not None:
        for row in before:
            book.active.append(row)
    page = book.active if before is None else book.create_sheet("data")
    for row in rows:
        page.append(row)
    held = io.BytesIO()
    book.save(held)
    return held.getvalue()


LONG = [["Mode", "Frequenz [Hz]"], *([i, f] for i, f in enumerate(MODES, 1))]
WIDE = [["Schlag", "Mode 1", "Mode 2", "Mode 3"], *([i, *hit] for i, hit in enumerate(HITS, 1))]
THREE = ["1", "2", "3"]

READ: dict[str, str | bytes] = {
    "long, English": "Mode,Natural frequency (Hz)\n1,101.5\n2,305.25\n3,333\n",
    "long, German, decimal commas": "Modus;Frequenz [Hz]\n1;101,5\n2;305,25\n3;333,0\n",
    "long, German, cp1252": "Nr;Eigenfrequenz in Hz;D\u00e4mpfung\n1;101,5;0,01\n2;305,25;\n3;333;\n".encode(
        "cp1252"
    ),
    "long, French": "Ordre;Fr\u00e9quence propre (Hz)\n1;101,5\n2;305,25\n3;333\n",
    "long, Spanish": "modo\tfrecuencia\n1\t101,5\n2\t305,25\n3\t333\n",
    "long, Italian": "modo|frequenza [kHz]\n1|0.1015\n2|0.30525\n3|0.333\n",
    "long, Russian": "\u0447\u0430\u0441\u0442\u043e\u0442\u0430\n101,5\n305,25\n333\n",
    "long, Chinese": "\u9891\u7387\n101.5\n305.25\n333\n".encode("utf-16"),
    "a head that is not known, in Hz": "Mode;Messwert [Hz]\n1;101,5\n2;305,25\n3;333\n",
    "units after a slash": "Mode;Frequenz/Hz\n1;101,5\n2;305,25\n3;333\n",
    "a line of units": "Mode;Frequenz\n;Hz\n1;101,5\n2;305,25\n3;333\n",
    "a line of units in brackets": "Mode;f\n[-];[kHz]\n1;0,1015\n2;0,30525\n3;0,333\n",
    "long, hits in any language": "Schlag;Mode;Frequenz\n" + "".join(
        f"{i};{m};{f}\n" for i, hit in enumerate(HITS, 1) for m, f in enumerate(hit, 1)
    ),
    "wide, numbers as heads": wide(",", THREE, first="hit"),
    "wide, no column of hits": wide(",", THREE),
    "wide, mode 1": wide(";", ["Mode 1", "Mode 2", "Mode 3"], first="Schlag", mark=","),
    "wide, Mode_1 [Hz]": wide("\t", ["Mode_1 [Hz]", "Mode_2 [Hz]", "Mode_3 [Hz]"], first="Messung"),
    "wide, f1": wide(" ", ["f1", "f2", "f3"], first="tap"),
    "wide, f1 (Hz)": wide(",", ["f1 (Hz)", "f2 (Hz)", "f3 (Hz)"], first="Run"),
    "wide, f_1": wide(",", ["f_1", "f_2", "f_3"], first=""),
    "wide, Frequenz 1": wide(";", ["Frequenz 1", "Frequenz 2", "Frequenz 3"], first="Versuch", mark=","),
    "wide, Eigenform 1": wide(";", ["Eigenform 1", "Eigenform 2", "Eigenform 3"], first="Nr"),
    "wide, coup": wide(";", ["ordre 1", "ordre 2", "ordre 3"], first="coup", mark=","),
    "wide, a head that is not known for the hits": wide(";", THREE, first="wer"),
    "wide, a line of units": wide(";", THREE, first="hit").replace("\n", "\n;Hz;Hz;Hz\n", 1),
    "wide, mean and sd below": wide(
        ";", THREE, first="hit", mark=",", more="Mittelwert;101,5;305,2;333\nStabw;0,1;0,1;0\n"
    ),
    "long, rates above": "Samples 2000 Hz\nMode;Messwert [Hz]\n1;101,5\n2;305,25\n3;333\n",
    "wide, lines above": "Projekt;Platte 7\nDatum;3.4.\n\n" + wide(";", THREE, first="Schlag", mark=","),
    "wide, a declared separator": "sep=;\n" + wide(";", THREE, first="hit", mark=","),
    "wide, a hit that shows no mode": wide(";", THREE, first="hit", more="3;-;305,25;n/a\n", mark=","),
    "wide, quoted": wide(",", ['"1"', '"2"', '"3"'], first='"hit"'),
    "across, hit 1": across(",", ["Mode", "hit 1", "hit 2"]),
    "across, Messung 1": across(";", ["Nr", "Messung 1 [Hz]", "Messung 2 [Hz]"]),
    "xlsx, long": sheet(LONG),
    "xlsx, wide": sheet(WIDE),
    "xlsx, lines above": sheet([["Platte 7"], [], *WIDE]),
    "xlsx, the second sheet": sheet(LONG, before=[["notes"], ["tapped on foam"]]),
}  # fmt: skip

REFUSED: dict[str, tuple[str | bytes, str]] = {
    "no heads": ("1;101,5\n2;305,25\n", 'no column of frequencies'),
    "two columns in Hz": ("mode;left [Hz];right [Hz]\n1;101,5;101,6\n", "name it in [measurement.columns]"),
    "decimal commas between commas": ("hit,1,2\n1,101,5,305,2\n", "decimal commas need another separator"),
    "thousands": (wide(";", THREE, first="hit").replace("305.2", "1.305,2"), "not a number"),
    "a text for a number": (wide(";", THREE, first="hit").replace("305.2", "305 ?"), "not a number"),
    "units that differ": ("hit;f1 [Hz];f2 [kHz]\n1;101,5;0,305\n", "units hz and khz beside each other"),
    "a hit in the wrong column": ("hit;1;2\n1;101;305\n2;305;101\n", "hits of one mode, which agree to 20 %"),
    "an old workbook": (b"\xd0\xcf\x11\xe0" + bytes(2000), "an .xls file or one with a password"),
    "a torn workbook": (sheet(WIDE)[:900], "no workbook that can be read"),
    "a zip of something else": (b"PK\x03\x04" + bytes(500), "no workbook that can be read"),
    "a workbook without a table": (sheet([["tapped on foam"]]), "no column of frequencies"),
    "heads alone": ("hit;1;2;3\n", "no rows below the heads"),
}  # fmt: skip


def read(tmp_path: Path, content: str | bytes, more: str = "") -> cb.Specimen:
    (tmp_path / "modes.tab").write_bytes(content.encode() if isinstance(content, str) else content)
    path = tmp_path / "bar.toml"
    path.write_text(f'{BAR}[measurement]\ntable = "modes.tab"\n{more}', encoding="utf-8")
    return cb.read_plate(path)


@pytest.mark.parametrize("content", READ.values(), ids=READ)
def test_a_table_of_a_laboratory_gives_its_frequencies(tmp_path: Path, content: str | bytes) -> None:
    measurement = read(tmp_path, content).measurement
    np.testing.assert_allclose(measurement.frequencies, MODES, rtol=1e-9)


@pytest.mark.parametrize(("content", "said"), REFUSED.values(), ids=REFUSED)
def test_any_other_table_is_one_message(tmp_path: Path, content: str | bytes, said: str) -> None:
    with pytest.raises(PlateFileError) as caught:
        read(tmp_path, content)
    assert said in caught.value.problems[0]
    assert len(caught.value.problems) <= 2


def test_a_wide_table_has_the_scatter_of_its_hits(tmp_path: Path) -> None:
    hits = "mode,hit,hz\n" + "".join(
        f"{m},{i},{f}\n" for i, hit in enumerate(HITS, 1) for m, f in enumerate(hit, 1)
    )
    meant = read(tmp_path, hits).measurement.frequency_sd
    found = read(tmp_path, wide(";", THREE, first="hit", mark=",")).measurement.frequency_sd
    np.testing.assert_allclose(found, meant, rtol=1e-12)


def test_labels_as_heads_name_the_modes(tmp_path: Path) -> None:
    measurement = read(tmp_path, wide(";", ["(1,1)", "(2,0)", "(0,2)"], first="hit", mark=",")).measurement
    assert measurement.labels == ("(1,1)", "(2,0)", "(0,2)")


@pytest.mark.parametrize(
    ("content", "columns"),
    [
        ("a;b\n1;101,5\n2;305,25\n3;333\n", 'mode = "a"\nhz = "b"'),
        (wide(";", ["erste", "zweite", "dritte"], first="wer"), 'hz = ["erste", "zweite", "dritte"]'),
        ("mode;left [Hz];right [Hz]\n1;101,5;9\n2;305,25;9\n3;333;9\n", 'hz = "left [Hz]"'),
    ],
)
def test_heads_are_named_in_the_plate_file(tmp_path: Path, content: str, columns: str) -> None:
    measurement = read(tmp_path, content, f"[measurement.columns]\n{columns}\n").measurement
    np.testing.assert_allclose(measurement.frequencies, MODES, rtol=1e-9)


def test_a_head_that_the_table_lacks_is_named_with_those_it_has(tmp_path: Path) -> None:
    with pytest.raises(PlateFileError, match="column sigma: no such head, accepted: a, b"):
        read(tmp_path, "a;b\n1;101,5\n", '[measurement.columns]\nhz = "b"\nsd = "sigma"\n')


def test_columns_belong_to_a_table(tmp_path: Path) -> None:
    path = tmp_path / "bar.toml"
    path.write_text(
        f'{BAR}[measurement]\nfrequencies_hz = [100]\n[measurement.columns]\nhz = "b"\n', encoding="utf-8"
    )
    with pytest.raises(PlateFileError, match="beside no table"):
        cb.read_plate(path)
