"""Material data that a laboratory writes into a plate file: reference constants, and bounds about them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# Constants, Pa, and density, kg/m3.
REFERENCES: dict[str, tuple[dict[str, float], float]] = {
    "carbon": ({"E1": 128e9, "E2": 9.0e9, "nu12": 0.3, "G12": 4.9e9}, 1560.0),
    "glass": ({"E1": 40e9, "E2": 10.5e9, "nu12": 0.27, "G12": 4.2e9}, 1920.0),
}
_WIDE, _MOST_NU12 = 2.5, 0.45


def material_tables(reference: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """[material] with reference constants, SI, and [unknowns] with wide bounds about them."""
    values = {n if n == "nu12" else f"{n}_GPa": v if n == "nu12" else v / 1e9 for n, v in reference.items()}
    bounds = {
        key: [v / _WIDE, min(_WIDE * v, _MOST_NU12) if key == "nu12" else _WIDE * v]
        for key, v in values.items()
    }
    return {"material": values, "unknowns": bounds}
