"""Documents, CSV files and data frames: nothing that JSON does not know, one declaration of columns."""

import io
import json
import math

import numpy as np
import openpyxl
import pytest

from cpam_bayes.render.report import Column, Rows, csv_text, json_text, laminate_keys, xlsx_bytes
from tests.render.small import CONSTANTS, RESULT

CSV = "name,value,sd\nE1,136.6,2.7\nE2,8.87,\n"


def test_json_csv_and_data_frame_hold_the_columns_that_have_a_key() -> None:
    records = [{"name": "E1", "value": 136.6, "sd": 2.7}, {"name": "E2", "value": 8.87, "sd": None}]
    assert RESULT.to_dict()["constants"] == records
    assert csv_text(CONSTANTS) == CSV
    frame = RESULT.to_dataframe()
    assert list(frame.columns) == ["name", "value", "sd"]
    assert frame["value"].tolist() == [136.6, 8.87]
    with pytest.raises(ValueError, match="to_dataframe: received 'modes', accepted: constants"):
        RESULT.to_dataframe("modes")


def test_what_is_not_a_finite_number_becomes_null_and_numbers_of_arrays_are_numbers() -> None:
    document = {"a": math.nan, "b": [math.inf, 1.0], "c": ({"d": -math.inf},), "e": "nan"}
    arrays = {"f": np.float64(1.5), "n": np.int64(3), "g": np.float64("nan")}
    expected = {"a": None, "b": [None, 1.0], "c": [{"d": None}], "e": "nan", "f": 1.5, "n": 3, "g": None}
    assert json.loads(json_text(document | arrays)) == expected


def test_the_bending_stiffness_is_in_newton_metres_and_moduli_in_gigapascals() -> None:
    keys = laminate_keys({"D11": 172.6, "Ex": 67.3e9, "nuxy": 0.35})
    assert keys == {"D11": {"value": 172.6}, "Ex_GPa": {"value": 67.3}, "nuxy": {"value": 0.35}}


def test_a_workbook_has_a_sheet_for_each_table_and_no_formula() -> None:
    names = Rows("names", (Column("name", "name", lambda row: row),), ("=1+1", "E1"))
    book = openpyxl.load_workbook(io.BytesIO(xlsx_bytes((CONSTANTS, names))))
    assert book.sheetnames == ["constants", "names"]
    assert list(book["constants"].values) == [
        ("name", "value", "sd"),
        ("E1", 136.6, 2.7),
        ("E2", 8.87, None),
    ]
    cell = book["names"]["A2"]
    assert (cell.value, cell.data_type) == ("=1+1", "s")
