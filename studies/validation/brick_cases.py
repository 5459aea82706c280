"""Worked cases: plates of bricks with one thing wrong, or nothing, as plate files with their truths.

Sizes, constants and seeds were fixed before any of the cases was diagnosed. The true constants differ from
those of the file by a few per cent, a flaw is in the geometry, masses or supports of the bricks, and lists
carry Gaussian noise of 0.2 % of each frequency.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from cpam_bayes.plate import read_plate
from cpam_bayes.plate.laminate import complete_constants
from validation.bricks import (
    Array,
    Flaws,
    Heat,
    Mass,
    Notch,
    Patch,
    Springs,
    extrapolated_frequencies,
)

NOISE: Final = 0.002
_RESOLUTION_HZ: Final = 0.1
# Elements in the plane of the two meshes whose frequencies are extrapolated.
_COARSE, _FINE = 110, 220

CONSTANTS: Final = ("E1_GPa", "E2_GPa", "nu12", "G12_GPa")
BOUNDS: Final = {
    "carbon/epoxy": ((80.0, 200.0), (5.0, 16.0), (0.15, 0.45), (2.5, 10.0)),
    "glass/epoxy": ((20.0, 70.0), (5.0, 25.0), (0.15, 0.45), (2.0, 10.0)),
}


@dataclass(frozen=True, slots=True)
class BrickCase:
    """The truth about a plate, and its description in the file.

    sides : mm, length, width, thickness
    density : kg/m3
    reference, constants : of the file and of the bricks, in the order of `CONSTANTS`
    cause : name in the catalogue, "none", or a description of what the list lacks
    size : in words, with the place
    missed : numbers of the modes missing from the list, counted from 1
    stated : whether the file states the repeatability
    has_sd : whether it states how well the reference is known
    """

    name: str
    sides: tuple[float, float, float]
    density: float
    layup: str
    edges: str
    material: str
    reference: tuple[float, float, float, float]
    constants: tuple[float, float, float, float]
    n_modes: int
    seed: int
    cause: str
    size: str
    flaws: Flaws = field(default_factory=Flaws)
    missed: tuple[int, ...] = ()
    stated: bool = True
    has_sd: bool = False

    @property
    def mass(self) -> float:
        """Mass of the plate, kg."""
        return self.density * float(np.prod(self.sides)) * 1e-9


def _mass(fraction: float, sides: tuple[float, float, float], density: float, x: float, y: float) -> Flaws:
    plate = density * float(np.prod(sides)) * 1e-9
    return Flaws(masses=(Mass(fraction * plate, x * 1e-3, y * 1e-3),))


_A, _B, _C = (285.0, 195.0, 2.3), (240.0, 170.0, 2.0), (310.0, 228.0, 3.1)
_CASES: Final = (
    BrickCase(
        "clean_free",
        _A,
        1930.0,
        "[0/45/-45/90]_s",
        "FFFF",
        "glass/epoxy",
        (42.0, 11.5, 0.28, 4.2),
        (40.6, 11.9, 0.27, 4.35),
        12,
        101,
        "none",
        "nothing is wrong",
    ),
    BrickCase(
        "clean_free_unstated",
        _C,
        1555.0,
        "[0_8]",
        "FFFF",
        "carbon/epoxy",
        (132.0, 9.1, 0.31, 4.8),
        (136.5, 8.8, 0.32, 4.62),
        10,
        102,
        "none",
        "nothing is wrong",
        stated=False,
    ),
    BrickCase(
        "clean_clamped",
        (262.0, 148.0, 2.4),
        1570.0,
        "[0/90]_2s",
        "CFFF",
        "carbon/epoxy",
        (126.0, 8.7, 0.30, 4.9),
        (122.5, 8.95, 0.295, 5.06),
        10,
        103,
        "none",
        "nothing is wrong",
        has_sd=True,
    ),
    BrickCase(
        "mass_1_corner",
        _B,
        1560.0,
        "[0/90]_2s",
        "FFFF",
        "carbon/epoxy",
        (128.0, 8.6, 0.31, 4.7),
        (131.6, 8.85, 0.30, 4.56),
        11,
        104,
        "sensor_mass",
        "1 % of the plate's mass at the corner (233, 164) mm",
        _mass(0.01, _B, 1560.0, 233.0, 164.0),
    ),
    BrickCase(
        "mass_3_off_grid",
        _C,
        1940.0,
        "[0/45/-45/90]_s",
        "FFFF",
        "glass/epoxy",
        (41.0, 11.0, 0.27, 4.0),
        (42.5, 10.7, 0.275, 4.14),
        12,
        105,
        "sensor_mass",
        "3 % of the plate's mass at (118, 61) mm",
        _mass(0.03, _C, 1940.0, 118.0, 61.0),
        has_sd=True,
    ),
    BrickCase(
        "mass_5_unstated",
        _A,
        1575.0,
        "[0/90]_2s",
        "FFFF",
        "carbon/epoxy",
        (134.0, 9.3, 0.30, 5.1),
        (130.2, 9.05, 0.31, 5.25),
        10,
        106,
        "sensor_mass",
        "5 % of the plate's mass at (243, 57) mm",
        _mass(0.05, _A, 1575.0, 243.0, 57.0),
        stated=False,
    ),
    BrickCase(
        "turned",
        _C,
        1565.0,
        "[0_12]",
        "FFFF",
        "carbon/epoxy",
        (130.0, 8.9, 0.31, 4.6),
        (126.4, 9.15, 0.30, 4.74),
        11,
        107,
        "misorientation",
        "all plies turned by 6 degrees",
        Flaws(turned_deg=6.0),
        has_sd=True,
    ),
    BrickCase(
        "taper",
        (276.0, 182.0, 2.6),
        1560.0,
        "[0/90]_2s",
        "CFFF",
        "carbon/epoxy",
        (127.0, 9.0, 0.30, 4.7),
        (130.5, 8.75, 0.31, 4.85),
        10,
        108,
        "taper_x",
        "7 % thinner at the clamp, 7 % thicker at the tip",
        Flaws(taper=(0.07, 0.0)),
    ),
    BrickCase(
        "warp",
        (300.0, 210.0, 2.0),
        1935.0,
        "[0/90]_2s",
        "FFFF",
        "glass/epoxy",
        (40.0, 10.5, 0.27, 4.1),
        (41.4, 10.8, 0.265, 3.97),
        12,
        109,
        "warp",
        "sag of 1.6 mm along x and 0.9 mm along y",
        Flaws(sag=(0.0016, 0.0009)),
        has_sd=True,
    ),
    BrickCase(
        "soft_patch",
        _A,
        1570.0,
        "[0/45/-45/90]_s",
        "FFFF",
        "carbon/epoxy",
        (129.0, 8.8, 0.31, 4.9),
        (125.6, 9.05, 0.30, 5.03),
        12,
        110,
        "damage",
        "half the stiffness from x = 171 to 224 mm and from y = 33 to 78 mm",
        Flaws(patch=Patch((0.171, 0.224), (0.033, 0.078), 0.5)),
    ),
    BrickCase(
        "residual_stress",
        _B,
        1940.0,
        "[0/90]_2s",
        "FFFF",
        "glass/epoxy",
        (41.5, 11.2, 0.28, 4.2),
        (40.3, 11.5, 0.27, 4.33),
        11,
        111,
        "membrane_stress",
        "a thermal strain of 0.0001 in the middle that falls to none at the edges",
        Flaws(heat=Heat(1e-4)),
        has_sd=True,
    ),
    BrickCase(
        "soft_clamp",
        (255.0, 142.0, 2.4),
        1565.0,
        "[0/90]_2s",
        "CFFF",
        "carbon/epoxy",
        (131.0, 9.0, 0.30, 4.8),
        (127.3, 9.2, 0.305, 4.66),
        10,
        112,
        "soft_clamp",
        "springs of 9e12 N/m3 in the plane of the plate and of 1.3e10 N/m3 across it",
        Flaws(springs=Springs(9e12, 9e12, 1.3e10)),
    ),
    BrickCase(
        "missed_mode",
        _C,
        1560.0,
        "[0/90]_2s",
        "FFFF",
        "carbon/epoxy",
        (133.0, 9.2, 0.31, 5.0),
        (129.0, 9.45, 0.30, 5.17),
        12,
        113,
        "mode_identity",
        "the list lacks the fifth of its modes",
        missed=(5,),
        has_sd=True,
    ),
    BrickCase(
        "missing_corner",
        _A,
        1945.0,
        "[0/90]_2s",
        "FFFF",
        "glass/epoxy",
        (41.0, 10.9, 0.27, 4.1),
        (42.3, 10.6, 0.28, 4.24),
        12,
        114,
        "outline",
        "a corner of 24 x 17 mm is missing",
        Flaws(notch=Notch(0.024, 0.017)),
    ),
)
CASES: Final[Mapping[str, BrickCase]] = {case.name: case for case in _CASES}


def true_frequencies(case: BrickCase, n_modes: int, *, fine: int = _FINE, coarse: int = _COARSE) -> Array:
    """The n lowest frequencies of the bricks, extrapolated from two meshes, (n,) Hz.

    Raises CalculixError if CalculiX is missing or fails.
    """
    specimen = read_plate(plate_of(case))
    given = {"E1": case.constants[0] * 1e9, "E2": case.constants[1] * 1e9}
    given |= {"nu12": case.constants[2], "G12": case.constants[3] * 1e9}
    constants = {k: float(v) for k, v in complete_constants(given, "transversely_isotropic").items()}
    return extrapolated_frequencies(specimen, constants, n_modes, case.flaws, coarse, fine)


def listed_frequencies(case: BrickCase, frequencies: Array) -> list[float]:
    """A laboratory's list: modes missed, noise of 0.2 %, rounded to 0.1 Hz, ascending."""
    noise = np.random.default_rng(case.seed).standard_normal(len(frequencies))
    f = np.delete(frequencies * np.exp(NOISE * noise), [k - 1 for k in case.missed])
    return [round(float(v), 1) for v in np.sort(f)]


def plate_of(case: BrickCase, frequencies_hz: list[float] | None = None) -> dict[str, Any]:
    """Plate file of a case as a dictionary; without its list if there is none."""
    bounds = {k: list(b) for k, b in zip(CONSTANTS, BOUNDS[case.material], strict=True)}
    reference = dict(zip(CONSTANTS, case.reference, strict=True))
    plate: dict[str, Any] = {
        "name": case.name,
        "plate": {
            "length_mm": case.sides[0],
            "width_mm": case.sides[1],
            "thickness_mm": case.sides[2],
            "density_kg_m3": case.density,
            "layup": case.layup,
            "edges": case.edges,
        },
        "material": {"name": case.material, "isotropic": False, **reference},
        "unknowns": bounds,
    }
    if case.has_sd:
        plate["material"]["sd"] = {k: round(0.07 * v, 4) for k, v in reference.items()}
    if frequencies_hz is not None:
        plate["measurement"] = {"frequencies_hz": frequencies_hz, "resolution_hz": _RESOLUTION_HZ}
        if case.stated:
            plate["measurement"]["relative_std"] = NOISE
    return plate


def plate_file(case: BrickCase, frequencies_hz: list[float]) -> str:
    """Plate file of a case as TOML, which reveals nothing of the truth."""
    lines: list[str] = []
    plate = plate_of(case, frequencies_hz)
    _write_table(lines, "", plate)
    return "\n".join(lines).strip() + "\n"


def _write_table(lines: list[str], name: str, table: Mapping[str, Any]) -> None:
    if name:
        lines += ["", f"[{name}]"]
    lines += [f"{k} = {_value(v)}" for k, v in table.items() if not isinstance(v, Mapping)]
    for key, value in table.items():
        if isinstance(value, Mapping):
            _write_table(lines, f"{name}.{key}" if name else key, value)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    return str(value)


def truth_of(case: BrickCase, frequencies: Array) -> dict[str, Any]:
    """Truth hidden from the file: cause, size, constants, and the bricks' frequencies without noise."""
    return {
        "case": case.name,
        "cause": case.cause,
        "size": case.size,
        "constants": dict(zip(CONSTANTS, case.constants, strict=True)),
        "missed_modes": list(case.missed),
        "noise": NOISE,
        "seed": case.seed,
        "plate_mass_g": round(1e3 * case.mass, 3),
        "flaws": {k: v for k, v in asdict(case.flaws).items() if v not in (None, (), 0.0, (0.0, 0.0))},
        "bricks_hz": [round(float(f), 4) for f in frequencies],
    }
