"""Plates of the comparison: the built-in ones, and the aluminium plates with four unknown constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from cpam_bayes.paper import PrintedRow
from cpam_bayes.plate import Specimen, builtin, read_plate, to_user
from cpam_bayes.plate.units import to_si

__all__ = ["BUILT_IN", "FOUR", "TWO", "case_specimen", "with_constants"]

BUILT_IN, TWO, FOUR = "as built in", "two constants", "four constants"
# Eq. (8) bounds E2 by 40 GPa and cannot have been used for aluminium, whose E2 is about 70 GPa.
_BOUNDS: Final = {
    "E1_GPa": [10.0, 200.0],
    "E2_GPa": [10.0, 200.0],
    "nu12": [0.15, 0.4],
    "G12_GPa": [5.0, 30.0],
}


def case_specimen(name: str, case: str) -> Specimen:
    """A built-in specimen, with four unknown constants where that is the case.

    The fourth constraint of eq. (9), E1 > E2, holds for four constants, so that the reference E2 is a little
    below E1.
    """
    specimen = builtin(name)
    if case != FOUR:
        return specimen
    plate, measurement = specimen.plate, specimen.measurement
    assert measurement is not None
    E, nu = specimen.material.constants["E1"] / 1e9, specimen.material.constants["nu12"]
    return read_plate(
        {
            "name": f"{name}, {FOUR}",
            "plate": {
                "length_mm": to_user("length", plate.length),
                "width_mm": to_user("width", plate.width),
                "thickness_mm": to_user("thickness", plate.thickness),
                "density_kg_m3": plate.density,
                "layup": "[0]",
                "edges": plate.edges,
            },
            "material": {
                "isotropic": False,
                "E1_GPa": E,
                "E2_GPa": 0.999 * E,
                "nu12": nu,
                "G12_GPa": E / (2.0 * (1.0 + nu)),
            },
            "unknowns": _BOUNDS,
            "measurement": {
                "frequencies_hz": measurement.frequencies.tolist(),
                "resolution_hz": measurement.resolution,
            },
        }
    )


def with_constants(specimen: Specimen, row: PrintedRow) -> Specimen:
    """A specimen with the printed constants of a row in place of its reference."""
    printed: Mapping[str, float] = {
        key: cell.number for key, cell in row.values.items() if cell.number is not None
    }
    constants = {key.partition("_")[0]: to_si(key, value) for key, value in printed.items()}
    return replace(specimen, material=replace(specimen.material.parts[""], constants=constants, sd={}))
