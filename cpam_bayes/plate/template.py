"""A commented plate file from what is known of a plate; what is not known is left to be filled in."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

__all__ = ["MATERIALS", "KnownPlate", "TypicalMaterial", "plate_file_text"]


@dataclass(frozen=True, slots=True)
class TypicalMaterial:
    """Typical constants to begin with; bounds : of the search, wide enough for the kind.

    source : where the constants are from
    """

    name: str
    symmetry: str
    constants: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    source: str


MATERIALS: Final[Mapping[str, TypicalMaterial]] = {
    "carbon": TypicalMaterial(
        "carbon/epoxy",
        "transversely_isotropic",
        {"E1_GPa": 121.2, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25},
        {"E1_GPa": (60.0, 250.0), "E2_GPa": (4.0, 16.0), "nu12": (0.1, 0.45), "G12_GPa": (2.0, 10.0)},
        "Table 3 of the paper",
    ),
    "glass": TypicalMaterial(
        "glass/epoxy",
        "transversely_isotropic",
        {"E1_GPa": 40.1, "E2_GPa": 8.9, "nu12": 0.23, "G12_GPa": 4.23},
        {"E1_GPa": (20.0, 60.0), "E2_GPa": (4.0, 18.0), "nu12": (0.1, 0.45), "G12_GPa": (2.0, 8.0)},
        "Table 3 of the paper",
    ),
    "fabric": TypicalMaterial(
        "carbon fabric/epoxy",
        "orthotropic",
        {"E1_GPa": 60.0, "E2_GPa": 60.0, "nu12": 0.05, "G12_GPa": 4.0},
        {"E1_GPa": (30.0, 90.0), "E2_GPa": (30.0, 90.0), "nu12": (0.0, 0.3), "G12_GPa": (2.0, 8.0)},
        "round numbers for a balanced weave",
    ),
    "spruce": TypicalMaterial(
        "spruce",
        "orthotropic",
        {"E1_GPa": 11.0, "E2_GPa": 0.8, "nu12": 0.4, "G12_GPa": 0.7},
        {"E1_GPa": (5.0, 20.0), "E2_GPa": (0.2, 2.0), "nu12": (0.0, 0.9), "G12_GPa": (0.3, 1.5)},
        "round numbers for a quarter-sawn board",
    ),
    "metal": TypicalMaterial(
        "aluminium",
        "isotropic",
        {"E1_GPa": 69.0, "nu12": 0.33},
        {"E1_GPa": (20.0, 250.0), "nu12": (0.15, 0.45)},
        "Table 3 of the paper",
    ),
}
"""Materials by the name that the command takes."""


@dataclass(frozen=True, slots=True)
class KnownPlate:
    """What is known of a plate; None and empty for what is not.

    size_mm : length, width, thickness. mass_g : weighed. material : a name in `MATERIALS`.
    frequencies_hz : ascending; table : path of a table of modes in their place.
    """

    name: str
    size_mm: tuple[float, float, float] | None = None
    mass_g: float | None = None
    layup: str | None = None
    edges: str | None = None
    material: str = "carbon"
    frequencies_hz: Sequence[float] = ()
    table: str | None = None


def plate_file_text(known: KnownPlate) -> str:
    """A plate file; keys that are not known are comments, so that reading it names all it lacks."""
    material = MATERIALS[known.material]
    isotropic = material.symmetry == "isotropic"
    length, width, thickness = known.size_mm or (None, None, None)
    plate = [
        _line("length_mm", length, 310.0, "along x, the direction of a ply at 0 deg"),
        _line("width_mm", width, 228.0, "along y"),
        _line("thickness_mm", thickness, 3.1, "mean of ten places"),
        _line("mass_g", known.mass_g, 340.7, "weighed, nothing attached"),
        *(
            []
            if isotropic
            else [_line("layup", known.layup, "[0_8]", 'bottom to top; "?" is an unknown angle')]
        ),
        _line(
            "edges",
            known.edges,
            "FFFF",
            "x = 0, y = 0, x = length, y = width: F free, S supported, C clamped",
        ),
    ]
    measured = [
        _line(
            "frequencies_hz",
            list(known.frequencies_hz) or None,
            [80.2, 146.3, 218.6],
            "ascending, from the first",
        ),
        _line(
            "table", known.table, "modes.csv", "instead: columns mode, hz, and if present hit, sd, damping"
        ),
    ]
    if known.table is not None or known.frequencies_hz:
        measured = [line for line in measured if not line.startswith("#")]
    of_material = [
        _line("name", material.name, "", "plates of one name share their constants in `diagnose`"),
        _line("symmetry", material.symmetry, "", "isotropic, transversely_isotropic or orthotropic"),
        *(_line(key, value, 0.0, "") for key, value in material.constants.items()),
    ]
    unknown = [_line(key, list(pair), [], "") for key, pair in material.bounds.items()]
    blocks = [
        [f"name = {json.dumps(known.name, ensure_ascii=False)}"],
        ["[plate]", *plate],
        [
            "# how well the plate was measured: the intervals of the constants then contain it",
            "# [plate.sd]",
            "# thickness_mm = 0.02",
            "# mass_g = 0.1",
        ],
        [
            f"# reference constants, {material.source}: put those of the data sheet here",
            "[material]",
            *of_material,
        ],
        ["# what to identify, with the bounds of the search", "[unknowns]", *unknown],
        [
            "# a mass that stays on the plate while it is tapped, such as an accelerometer",
            "# [[sensor]]",
            "# mass_g = 0.6",
            "# x_mm = 300.0",
            "# y_mm = 220.0",
        ],
        [
            "[environment]",
            _line("air_density_kg_m3", 1.2, 0.0, "the plate moves air; 0 is vacuum"),
        ],
        [
            "[measurement]",
            *measured,
            "# resolution_hz = 0.1         # the step of the list, or the line spacing of the analyser",
            "# relative_std = 0.002        # repeatability, a fraction of each frequency",
            "# complete = false            # modes may be missing from the list",
        ],
    ]
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def _line(key: str, value: object, example: object, comment: str) -> str:
    """A key with its value, or in a comment with an example where there is none."""
    said = f"{key} = {_toml(example if value is None else value)}"
    marked = said if value is not None else f"# {said}"
    return f"{marked:<28} # {comment}".rstrip() if comment else marked


def _toml(value: object) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(float(value)) if isinstance(value, int | float) else json.dumps(value, ensure_ascii=False)
