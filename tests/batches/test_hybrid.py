"""Hybrid plates in a batch: what is shared, and what a stored row is of."""

from __future__ import annotations

from typing import Any

import cpam_bayes as cb
from cpam_bayes.batches.geometry import groups_of
from cpam_bayes.batches.plate_row import row_key
from cpam_bayes.plate import Specimen
from tests.hybrids import hybrid


def measured(c_mm: float, g_mm: float, **plate: Any) -> Specimen:
    """A hybrid of 3 mm with plies of these thicknesses."""
    file = hybrid(**plate)
    file["ply"][0]["thickness_mm"], file["ply"][1]["thickness_mm"] = c_mm, g_mm
    file["unknowns"] = {"glass": {"E1_GPa": [20.0, 60.0]}}
    file["measurement"] = {"frequencies_hz": [109.3, 202.1, 248.2], "relative_std": 0.002}
    return cb.read_plate(file)


def test_plates_of_other_plies_share_no_model() -> None:
    same, again, other = measured(0.25, 0.375), measured(0.25, 0.375, thickness_mm=3.02), measured(0.3, 0.3)
    assert groups_of([same, again, other]) == [[0, 1], [2]]


def test_a_stored_row_is_of_its_plies() -> None:
    keys = {row_key(plate, 0, False, "") for plate in (measured(0.25, 0.375), measured(0.3, 0.3))}
    assert len(keys) == 2
