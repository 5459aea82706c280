"""A report on a terminal, in a file and in a pipe, as JSON, CSV, workbook and data frame."""

import io
import json
import math

import numpy as np
import openpyxl
import pytest

from cpam_bayes.render import report
from cpam_bayes.render.report import Column, Rows, facts
from cpam_bayes.render.terminal import screen_tables, screen_text
from tests.render.small import CONSTANTS, REPORT, RESULT, Terminal

PLAIN = """\
identify D&G
  The list is in kHz, not Hz. Divide by 1000.
  1 frequency < 2 constants: E1 is determined.

Constants
          value  95 % interval  note
  E1  136.6 GPa  131 to 142     determined
  E2    8.9 GPa                 not determined

  Fit 0.19 %, `relative_std` +- 0.2 %.
  Next: is anything wrong?  cpam-bayes diagnose 'D&G'
"""
BEHIND = """
Layup
  layup  [(0/90)_8]_s

In words
  [red]no colour[/red] <script>

Computation
  time  1 s
"""


def test_a_file_gets_aligned_plain_lines_whose_sentences_are_broken_and_tables_are_not():
    assert screen_text(screen_tables(REPORT), io.StringIO()) == PLAIN == RESULT.summary()
    assert RESULT.summary(verbose=True) == PLAIN + BEHIND
    text = screen_text((report.remarks("", ("word " * 60,)), facts("", (("a", "b" * 150),))), io.StringIO())
    sentence, table = text.split("\n\n")
    assert max(map(len, sentence.splitlines())) <= 100
    assert "b" * 150 in table


def test_a_terminal_gets_colours_and_every_bracket(monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    text = screen_text(screen_tables(REPORT, verbose=True), Terminal())
    for part in ("\x1b[", "[(0/90)_8]_s", "[red]no colour[/red]"):
        assert part in text
    assert "nothing" not in text
    for without_abilities in ("dumb", "unknown"):
        monkeypatch.setenv("TERM", without_abilities)
        assert screen_text(screen_tables(REPORT), Terminal()) == PLAIN


def test_json_csv_and_data_frame_hold_the_columns_that_have_a_key():
    records = [{"name": "E1", "value": 136.6, "sd": 2.7}, {"name": "E2", "value": 8.87, "sd": None}]
    assert RESULT.to_dict()["constants"] == records
    assert report.csv_text(CONSTANTS) == "name,value,sd\nE1,136.6,2.7\nE2,8.87,\n"
    frame = RESULT.to_dataframe()
    assert (list(frame.columns), frame["value"].tolist()) == (["name", "value", "sd"], [136.6, 8.87])
    with pytest.raises(ValueError, match="to_dataframe: received 'modes', accepted: constants"):
        RESULT.to_dataframe("modes")


def test_a_workbook_has_a_sheet_for_each_table_and_no_formula():
    names = Rows("names", (Column("name", "name", lambda row: row),), ("=1+1", "E1"))
    book = openpyxl.load_workbook(io.BytesIO(report.xlsx_bytes((CONSTANTS, names))))
    assert book.sheetnames == ["constants", "names"]
    rows = [("name", "value", "sd"), ("E1", 136.6, 2.7), ("E2", 8.87, None)]
    assert list(book["constants"].values) == rows
    assert (book["names"]["A2"].value, book["names"]["A2"].data_type) == ("=1+1", "s")


def test_numbers_of_documents_are_finite_and_in_the_units_of_their_keys():
    document = {"a": math.nan, "b": [math.inf, 1.0], "c": ({"d": -math.inf},), "e": "nan"}
    arrays = {"f": np.float64(1.5), "n": np.int64(3), "g": np.float64("nan")}
    expected = {"a": None, "b": [None, 1.0], "c": [{"d": None}], "e": "nan", "f": 1.5, "n": 3, "g": None}
    assert json.loads(report.json_text(document | arrays)) == expected
    keys = report.laminate_keys({"D11": 172.6, "Ex": 67.3e9, "nuxy": 0.35})
    assert keys == {"D11": {"value": 172.6}, "Ex_GPa": {"value": 67.3}, "nuxy": {"value": 0.35}}
