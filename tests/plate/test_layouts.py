"""A table is read in the layouts of laboratories, or one message says what to do."""

import datetime
import io

import numpy as np
import openpyxl
import pytest

from tests.layouts import LONG, MODES, TABLE, TAPPED, THREE, WIDE, across, sheet, wide

WRITTEN = {
    "commas": TABLE,
    "semicolons and decimal commas": TABLE.replace(",", ";").replace(".", ","),
    "tabs and decimal commas": TABLE.replace(",", "\t").replace(".", ","),
    "bars": TABLE.replace(",", " | "),
    "spaces": "  mode   hz  damping\n 1 101.5  0.004\n 2   305.25 0.002 \n 3 333\n",
    "decimal commas in quotes": '"mode","hz","damping"\n"1","101,5","0,004"\n2,"305,25","0,002"\n3,333,\n',
    "a byte order mark": TABLE.encode("utf-8-sig"),
    "UTF-16": TABLE.replace("\n", "\r\n").encode("utf-16"),
    "Windows-1252": f"# Schl\u00e4ge\n{TABLE}".encode("cp1252"),
    "lines above, comments and empty lines": f"Project;bar 7, hung\nDate 3.4.\n\n# heads\n{TABLE}\n# end\n\n",
    "a separator that is declared": "sep=;\n" + TABLE.replace(",", ";").replace(".", ","),
    "heads that begin as a comment": "# " + TABLE,
    "units in brackets": "Mode No.;Frequency [kHz];Damping (%)\n1;0,1015;0,4\n2;0,30525;0,2\n3;0,333;\n",
    "units after the name": "mode,frequency_hz,damping_%\n1,101.5,0.4\n2,305.25,0.2\n3,333,\n",
    "other columns": "mode,amplitude,hz,damping\n1,9.9,101.5,0.004\n2,?,305.25,0.002\n3,,333,\n",
    "another order": "damping,hz,mode\n,333,3\n0.002,305.25,2\n0.004,101.5,1\n",
}
LISTED = "1;101,5\n2;305,25\n3;333\n"
# hits in rows, and in columns
HITS = "1;101,4;305,2;333,1\n2;101,6;305,3;332,9\n"
BESIDE = "1;101,4;101,6\n2;305,2;305,3\n3;333,1;332,9\n"
HEADS = [
    *("Modennummer;Eigenfrequenz in Hz", "Ordre;Fr\u00e9quence\u00a0propre\u00a0(Hz)", "no;\u9891\u7387"),
    *("N\u00famero de modo;Frecuencia natural (Hz)", "Mod;Cz\u0119stotliwo\u015b\u0107 [Hz]"),
    *("Mode;Frequenz/Hz", "Mode;Messwert [Hz]", "Modo;Frequenza naturale [Hz]"),
    "Nr;\u0447\u0430\u0441\u0442\u043e\u0442\u0430",
]
# headings of modes, and of the hits before them
OF_MODES = {"Frequency of mode {}": "Run", "Mode {} frequency [Hz]": "", "f_{}": "", "Eigenform {}": "Nr"}


@pytest.mark.parametrize("content", WRITTEN.values(), ids=WRITTEN)
def test_a_table_says_the_same_however_it_is_written(measured, content: str | bytes) -> None:
    found = measured(content)
    np.testing.assert_allclose(found.frequencies, [101.5, 305.25, 333.0], rtol=1e-12)
    np.testing.assert_allclose(found.damping, [0.004, 0.002, np.nan], rtol=1e-12)
    np.testing.assert_allclose(found.loss_factors, [0.008, 0.004, np.nan], rtol=1e-12)
    assert found.frequency_sd is None
    assert found.labels == ("", "", "")


WRITTEN_IN_LABORATORIES: dict[str, str | bytes] = {
    "no heads": LISTED,
    **{heads: f"{heads}\n{LISTED}" for heads in HEADS},
    "damping in Spanish": "f;Amortiguamiento (%)\n101,5;0,4\n305,25;0,3\n333;0,2\n",
    "damping in Italian": "f\tSmorzamento [%]\n101,5\t0,4\n305,25\t0,3\n333\t0,2\n",
    "cp1250": f"Mod;Cz\u0119stotliwo\u015b\u0107 [Hz]\n{LISTED}".encode("cp1250"),
    "a column of numbers": "# tap test\n101,5\n305,25\n333\n",
    "a line of other units": "Frequenz;Amplitude;Q\nHz;m/s\u00b2;-\n101,5;2;9\n305,25;2;\n333;3;\n",
    **{
        f"wide, {mode}": wide(",", [mode.format(i) for i in (1, 2, 3)], first=hit)
        for mode, hit in OF_MODES.items()
    },
    "a line of units in brackets": "Mode;f\n[-];[kHz]\n1;0,1015\n2;0,30525\n3;0,333\n",
    "a line of the units of the heads": "Mode;f [kHz];Q (1)\n;kHz;-\n1;0,1015;9\n2;0,30525;8\n3;0,333;7\n",
    "long, hits in any language": "Schlag;Mode;Frequenz\n"
    + "".join(f"{i};{m};{f}\n" for i, hit in enumerate(TAPPED, 1) for m, f in enumerate(hit, 1)),
    "wide, no column of hits": wide(",", THREE),
    "wide, Mode_1 [Hz]": wide("\t", ["Mode_1 [Hz]", "Mode_2 [Hz]", "Mode_3 [Hz]"], first="Messung"),
    "wide, coup": wide(";", ["ordre 1", "ordre 2", "ordre 3"], first="coup", mark=","),
    "wide, a head that is not known for the hits": wide(";", THREE, first="wer"),
    "wide, a line of units": wide(";", THREE, first="hit").replace("\n", "\n;Hz;Hz;Hz\n", 1),
    "wide, mean and sd below": wide(
        ";", THREE, first="hit", mark=",", more="Mittelwert;101,5;305,2;333\nStabw;0,1;0,1;0\n"
    ),
    "long, rates above": f"Samples 2000 Hz\nMode;Messwert [Hz]\n{LISTED}",
    "wide, lines above": "Projekt;Platte 7\nDatum;3.4.\n\n" + wide(";", THREE, first="Schlag", mark=","),
    "wide, a hit that shows no mode": wide(";", THREE, first="hit", more="3;-;305,25;n/a\n", mark=","),
    "wide, quoted": wide(",", ['"1"', '"2"', '"3"'], first='"hit"'),
    "across, hit 1": across(",", ["Mode", "hit 1", "hit 2"]),
    "across, Messung 1": across(";", ["Nr", "Messung 1 [Hz]", "Messung 2 [Hz]"]),
    "xlsx, long": sheet(LONG),
    "xlsx, lines above": sheet([["Platte 7"], [], *WIDE]),
    "xlsx, the second sheet": sheet(LONG, before=[["notes"], ["tapped on foam"]]),
    "UTF-16 without a mark": "Modus;Frequenz [Hz]\n1;101,5\n2;305,25\n3;333\n".encode("utf-16-le"),
    "frequencies first, commas": "Frequency (Hz),Damping (%)\n101.5,0.4\n305.25,0.3\n333,0.2\n",
    "frequencies first, square brackets": "f [Hz],zeta [-]\n101.5,0.004\n305.25,0.003\n333,0.002\n",
    "frequencies and heights of peaks": "Frequenz (Hz);Pegel (dB)\n101,5;-12\n305,25;-20\n333;-31\n",
    "columns apart by spaces, heads of several words": "Mode  Damping (%)  Natural frequency (Hz)\n"
    "1     0.4          101.5\n2     0.3          305.25\n3     0.2          333\n",
    "rates above": f"Sampling frequency;25600\nResolution;0,5 Hz\nMode;Frequency [Hz]\n{LISTED}",
    "a title with words of heads": f"Natural frequencies in Hz\n\nMode;Frequenz\n{LISTED}",
    "units in cells": "Mode;Frequenz;D\u00e4mpfung\n1;101,5 Hz;0,4 %\n2;0,30525 kHz;0,3 %\n3;333 Hz;0,2 %\n",
    "Markdown": "| Mode | f [Hz] |\n|------|--------|\n| 1 | 101.5 |\n| 2 | 305.25 |\n| 3 | 333 |\n",
    "dates, an index and blank columns": ";;Datum;Mode;Frequenz [Hz];;\n0;;03.04.2024;1;101,5;;\n;;;;;;\n"
    "1;;03.04.2024;2;305,25;;\n2;;03.04.2024;3;333;;\n",
    "a mean and a name below": f"Mode;Frequenz [Hz]\n{LISTED}Mittelwert;246,6\n\nGepr\u00fcft: A. Weber\n",
    "means of hits": "hit;mode;hz\n1;1;101,4\n2;1;101,6\nMean;1;101,5\n1;2;305,2\n2;2;305,3\nMean;2;305,3\n"
    "1;3;333,1\n2;3;332,9\n",
    "merged cells": "Mode;Hit;Frequenz\n1;1;101,4\n;2;101,6\n2;1;305,2\n;2;305,3\n3;1;333,1\n;2;332,9\n",
    "a mode that is not seen, the last": f"Mode;Frequenz [Hz]\n{LISTED}4;n/a\n",
    "a row a quantity": "Mode;1;2;3\nFrequenz [Hz];101,5;305,25;333\nD\u00e4mpfung [%];0,4;0,3;0,2\n",
    "units beside a row": "Mode;Einheit;1;2;3\nFrequenz;kHz;0,1015;0,30525;0,333\nAmplitude;g;105;301;330\n",
    "hits in kHz": "Mode;1;2;3\nHit 1 [kHz];0,1014;0,3052;0,3331\nHit 2 [kHz];0,1016;0,3053;0,3329\n",
    "columns of hits headed f1": f"Nr;f1;f2\n{BESIDE}",
    "two lines of heads": f"Mode;Frequency [Hz];\n;hit 1;hit 2\n{BESIDE}",
    "units with a name": "hit;1;2;3\nEinheit;kHz;kHz;kHz\n1;0,1014;0,3052;0,3331\n2;0,1016;0,3053;0,3329\n",
    "modes from 7 on": f"hit;Mode 7;Mode 8;Mode 9\n{HITS}",
    "1. Mode": f"Schlag;1. Mode;2. Mode;3. Mode\n{HITS}",
    "MW, CV below": f"hit;1;2;3\n{HITS}MW;101,5;305,3;333\nCV %;0,1;0,1;0,1\n\u00d8;101,5;305,3;333\n",
    "xlsx, numbers as texts below a merged title": sheet(
        [["Platte 7", None], ["Mode", "Frequenz [Hz]"], ["1", "101,5"], ["2", "305,25"], ["3", "333"]]
    ),
    "xlsx, to the right, with dates": sheet(
        [[], [None, None, "Date", "Mode", "f\n[Hz]"]]
        + [[None, None, datetime.date(2024, 4, 3), i, f] for i, f in enumerate(MODES, 1)]
    ),
}


@pytest.mark.parametrize("content", WRITTEN_IN_LABORATORIES.values(), ids=WRITTEN_IN_LABORATORIES)
def test_a_table_of_a_laboratory_gives_its_frequencies(measured, content: str | bytes) -> None:
    np.testing.assert_allclose(measured(content).frequencies, MODES, rtol=1e-9)


@pytest.mark.parametrize(
    "thousands",
    [" ", "\u00a0", "\u202f", "'", "\u2019", "."],
    ids=[" ", "nbsp", "narrow", "'", "\u2019", "."],
)
def test_marks_between_thousands_are_read_where_they_can_be_nothing_else(measured, thousands: str) -> None:
    found = measured(f"Mode;Frequenz [Hz]\n1;901,5\n2;1{thousands}234,5\n3;2{thousands}345,6\n")
    assert found.frequencies.tolist() == [901.5, 1234.5, 2345.6]
    assert measured('Mode,f\n1,901.5\n2,"1,234.5"\n').frequencies.tolist() == [901.5, 1234.5]


AMBIGUOUS: list[tuple[str, str | bytes]] = [  # part of the message, and a table with two meanings or none
    ("received 901, 1.234, 2.345", "Mode;f\n1;901\n2;1.234\n3;2.345\n"),
    ("no mark between thousands", "f [Hz]\n901\n1,234\n2,345\n"),
    ("no mark between thousands", "Mode;f [Hz]\n1;1.234\n2;2.345\n3;3.456\n"),
    ("a unit in the head, Hz or kHz", "Mode;f\n1;0,1015\n2;0,30525\n3;0,333\n"),
    ("a unit in the head", "Mode;Frequency [kHz];\n;hit 1;hit 2\n1;0,1014;0,1016\n2;0,3052;0,3053\n"),
    ("101,5, two cells", "Mode,f [Hz],Damping [%]\n1,101,5\n2,305,2\n3,333,0\n"),
    ("are these decimal commas?", "Mode,f [Hz],Note\n1,101,5,\n2,305,2,\n3,333,0,\n"),
    ("are these decimal commas", "hit,1,2,3,4\n1,101,5,305,2\n"),
    ('received "1;101"', "Mode,f\n1;101,5\n2;305,25\n"),
    ("or Peak?", "Mode;Peak;Bandwidth (Hz)\n1;101,5;1,1\n2;305,25;3,1\n"),
    ("or Mittelwert?", "Mode;Mittelwert;Std [Hz]\n1;101,5;0,5\n2;305,25;0,5\n"),
    ("name it in [measurement.columns]", "Mode;FEM [Hz];Test [Hz]\n1;103;101,5\n2;309;305,25\n"),
    ("several plates, received A, B", "Plate;Mode;f [Hz]\nA;1;101,4\nA;2;305,2\nB;1;103,6\nB;2;308\n"),
    ("a table for each", "Platte;1;2\nA;101,4;305,2\nB;103,6;308\n"),
    ("line 3, column mode: missing", "Mode;f\n1;101,4\n;101,6\n2;305,2\n;305,3\n"),
    ("received Schnitt", "hit;1;2\n1;101,4;305,2\n2;101,6;305,3\nSchnitt;101,5;305,3\n"),
    ("the lines of a spectrum", "Frequency [Hz],Level\n" + "".join(f"{0.5 * i},{i}\n" for i in range(1, 60))),
    ("a second column mode", "Mode;f;;Mode;f\n1;101,5;;1;103,6\n2;305;;2;309\n"),
    ("3 cells for 2", "Mode;f [Hz];\n;FEM;Test\n1;103;101,5\n2;309;305,25\n"),
    ("the numbers of modes, received 1, 2", "f [Hz];Mode\n1;101,5\n2;305,25\n"),
    ("a line of heads above the numbers", "0,1;101,5\n0,2;305,25\n0,1;333\n"),
    ("no mark between thousands", "1,101\n2,305\n3,333\n"),
    ("no column", "Mode Natural frequency (Hz) Loss\n1 101.5 0.4\n2 305 0.3\n"),
    ("received 0.0, accepted: a frequency above 0; so is 1", "Mode,f [Hz]\n1,0.0\n2,0\n3,101.5\n"),
    ('\u00b1 0,1", accepted: a frequency', "Mode;f [Hz]\n1;101,5 \u00b1 0,1\n2;305,25 \u00b1 0,2\n"),
    ("mode 2 is left out, accepted: complete", "Mode;f [Hz]\n1;101,5\n2;n/a\n3;305,25\n"),
    ('received "2024-05-01', sheet([["Mode", "f [Hz]"], [1, datetime.datetime(2024, 5, 1)], [2, 305.25]])),
    ('received "see below"', sheet(LONG, before=[["Mode", "f [Hz]"], [1, "see below"], [2, 305]])),
]


@pytest.mark.parametrize(("said", "content"), AMBIGUOUS, ids=[said for said, _ in AMBIGUOUS])
def test_what_may_be_read_wrongly_is_one_message(refused, said: str, content: str | bytes) -> None:
    (problem,) = refused(content)
    assert said in problem
    assert "accepted" in problem
    assert len(problem) < 400


def test_tables_in_further_sheets_are_told_of(measured) -> None:
    found = measured(sheet([["Mode", "f [Hz]"], [1, 103.6], [2, 309.0]], before=LONG))
    assert found.frequencies.tolist() == MODES
    assert found.remarks == ("modes.csv: tables of modes stand in data too, which are not read",)


def test_plates_of_a_table_may_be_hits_of_one(measured) -> None:
    rows = "Sample;1;2\na;101,4;305,2\nb;101,6;305,3\n"
    found = measured(rows, '[measurement.columns]\nhit = "Sample"\n')
    np.testing.assert_allclose(found.frequencies, MODES[:2], rtol=1e-9)


def test_per_cent_of_a_sheet_are_what_it_shows(measured) -> None:
    book = openpyxl.Workbook()
    for row in (["Mode", "f [Hz]", "D\u00e4mpfung [%]"], [1, 101.5, 0.004], [2, 305.25, 0.003]):
        book.active.append(row)
    for cell in book.active["C"]:
        cell.number_format = "0.00%"
    held = io.BytesIO()
    book.save(held)
    assert measured(held.getvalue()).damping == pytest.approx([0.004, 0.003], rel=1e-12)
