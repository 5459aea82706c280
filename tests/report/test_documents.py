"""The JSON documents: units, and nothing that JSON does not know."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.report.documents import json_text, laminate_keys


def test_what_is_not_a_finite_number_becomes_null():
    document = {"a": math.nan, "b": [math.inf, 1.0], "c": ({"d": -math.inf},), "e": "nan"}
    expected = {"a": None, "b": [None, 1.0], "c": [{"d": None}], "e": "nan"}
    assert json.loads(json_text(document)) == expected


def test_numbers_of_arrays_are_numbers():
    document = {"f": np.float64(1.5), "n": np.int64(3), "nan": np.float64("nan")}
    assert json.loads(json_text(document)) == {"f": 1.5, "n": 3, "nan": None}


def test_the_bending_stiffness_is_in_newton_metres_and_moduli_in_gigapascals():
    keys = laminate_keys({"D11": 172.6, "Ex": 67.3e9, "nuxy": 0.35})
    assert keys == {"D11": {"value": 172.6}, "Ex_GPa": {"value": 67.3}, "nuxy": {"value": 0.35}}


def test_a_document_is_in_the_units_of_the_plate_file(point):
    document = point.to_dict()
    constant = point.estimate.constants[0]
    shown = document["constants"]["E1_GPa"]
    assert shown["value"] == pytest.approx(constant.value / 1e9)
    assert shown["sd"] == pytest.approx(constant.sd / 1e9)
    rms = np.sqrt(np.mean([row["residual_percent"] ** 2 for row in document["frequencies"]]))
    assert document["rms_percent"] == pytest.approx(rms)


def test_a_noise_that_is_not_known_is_null(identification, result_of):
    document = result_of(replace(identification, noise=math.nan)).to_dict()
    assert json.loads(json_text(document)) == document
    assert document["noise_percent"] is None
