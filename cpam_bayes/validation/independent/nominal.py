"""The plates of the claims benchmark as their files describe them.

Tuning and final figures have different plates. A set has few plates and many lists, because the models of a
plate are built once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.validation.independent.true_plate import TruePlate

# Names of the constants in files, and Pa in their unit.
IN_FILE = {"E1": ("E1_GPa", 1e9), "E2": ("E2_GPa", 1e9), "nu12": ("nu12", 1.0), "G12": ("G12_GPa", 1e9)}
# Relative standard deviation of a reference constant, where a file gives one.
REFERENCE_SD = 0.1
# Constants of a plate whose file gives none lie within this fraction of the reference.
SPREAD = 0.15
RESOLUTION_HZ = 0.1

_CARBON = {"E1": 125e9, "E2": 9.0e9, "nu12": 0.30, "G12": 5.2e9}
_STIFF_CARBON = {"E1": 140e9, "E2": 8.4e9, "nu12": 0.28, "G12": 4.6e9}
_GLASS = {"E1": 39e9, "E2": 9.5e9, "nu12": 0.27, "G12": 3.9e9}
_ALUMINIUM = {"E1": 70e9, "nu12": 0.33}
_BOUNDS = {
    "carbon": {"E1": (60e9, 220e9), "E2": (4e9, 20e9), "nu12": (0.15, 0.45), "G12": (2e9, 12e9)},
    "glass": {"E1": (18e9, 70e9), "E2": (4e9, 20e9), "nu12": (0.15, 0.45), "G12": (1.8e9, 9e9)},
    "aluminium": {"E1": (50e9, 95e9), "nu12": (0.2, 0.42)},
}


@dataclass(frozen=True, slots=True)
class NominalPlate:
    """A plate as its file describes it.

    plate : with reference constants and without a flaw.
    layup : in the notation of plate files.
    bounds : of the constants, Pa.
    known : whether the file says how well the reference constants are known.
    n_modes : in its lists.
    """

    name: str
    plate: TruePlate
    layup: str
    material: str
    known: bool
    n_modes: int

    @property
    def bounds(self) -> Mapping[str, tuple[float, float]]:
        """Search bounds of the constants, Pa."""
        return _BOUNDS[self.material]

    @property
    def constants(self) -> tuple[str, ...]:
        """Names of the constants."""
        return tuple(self.bounds)

    @property
    def relative_sd(self) -> NDArray[np.float64]:
        """Standard deviation of each constant's prior over its reference."""
        if self.known:
            return np.full(len(self.bounds), REFERENCE_SD)
        widths = [(high - low) / self.plate.constants[n] for n, (low, high) in self.bounds.items()]
        return np.asarray(np.array(widths) / np.sqrt(12.0))

    def drawn(self, rng: np.random.Generator) -> TruePlate:
        """The plate with constants drawn about the reference."""
        constants = {}
        for name, (low, high) in self.bounds.items():
            reference = self.plate.constants[name]
            while True:
                deviation = (
                    REFERENCE_SD * rng.standard_normal() if self.known else rng.uniform(-SPREAD, SPREAD)
                )
                value = reference * (1.0 + deviation)
                if low < value < high:
                    break
            constants[name] = float(value)
        return replace(self.plate, constants=constants)

    def file(self, frequencies_hz: list[float], *, stated: float | None, complete: bool = True) -> str:
        """The plate file with a list of frequencies; stated : relative repeatability, left out if None."""
        p = self.plate
        lines = [f'name = "{self.name}"', "", "[plate]"]
        lines += [f"{side}_mm = {1e3 * getattr(p, side):.6g}" for side in ("length", "width", "thickness")]
        lines += [f"density_kg_m3 = {p.density:.6g}", f'layup = "{self.layup}"', f'edges = "{p.edges}"']
        lines += ["", "[material]"]
        lines += [f"isotropic = {'true' if len(self.bounds) == 2 else 'false'}"]
        lines += [f"{_named(n)} = {_shown(n, p.constants[n])}" for n in self.bounds]
        if self.known:
            lines += ["", "[material.sd]"]
            lines += [f"{_named(n)} = {_shown(n, REFERENCE_SD * p.constants[n])}" for n in self.bounds]
        lines += ["", "[unknowns]"]
        lines += [f"{_named(n)} = [{_shown(n, a)}, {_shown(n, b)}]" for n, (a, b) in self.bounds.items()]
        lines += ["", "[measurement]", f"frequencies_hz = [{', '.join(f'{f:.1f}' for f in frequencies_hz)}]"]
        lines += [f"resolution_hz = {RESOLUTION_HZ}"]
        lines += [] if stated is None else [f"relative_std = {stated}"]
        lines += [] if complete else ["complete = false"]
        return "\n".join(lines) + "\n"


def _named(constant: str) -> str:
    return IN_FILE[constant][0]


def _shown(constant: str, value: float) -> str:
    return f"{value / IN_FILE[constant][1]:.6g}"


def _of(
    name: str,
    size_mm: tuple[float, float, float],
    layup: tuple[str, tuple[float, ...]],
    material: str,
    constants: Mapping[str, float],
    density: float,
    edges: str = "FFFF",
    *,
    known: bool,
    n_modes: int,
) -> NominalPlate:
    a, b, h = (1e-3 * s for s in size_mm)
    plate = TruePlate(a, b, h, density, edges, layup[1], constants)
    return NominalPlate(name, plate, layup[0], material, known, n_modes)


def _symmetric(text: str, half: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    return text, (*half, *half[::-1])


_CROSS_8 = _symmetric("[(0/90)_2]_s", (0.0, 90.0) * 2)
_CROSS_16 = _symmetric("[(0/90)_4]_s", (0.0, 90.0) * 4)
_CROSS_OUT_90 = _symmetric("[(90/0)_3]_s", (90.0, 0.0) * 3)
_QUASI_8 = _symmetric("[0/45/-45/90]_s", (0.0, 45.0, -45.0, 90.0))
_QUASI_16 = _symmetric("[(0/45/-45/90)_2]_s", (0.0, 45.0, -45.0, 90.0) * 2)
_METAL = ("[0]", (0.0,))


def _one_way(n: int) -> tuple[str, tuple[float, ...]]:
    return f"[0_{n}]", (0.0,) * n


TUNING = (
    _of("T1", (270, 270, 3.1), _CROSS_16, "carbon", _CARBON, 1570, known=True, n_modes=6),
    _of("T2", (310, 205, 2.3), _CROSS_OUT_90, "carbon", _STIFF_CARBON, 1600, known=False, n_modes=12),
    _of("T3", (225, 165, 2.1), _one_way(12), "carbon", _CARBON, 1555, known=True, n_modes=10),
    _of("T4", (240, 150, 2.8), _CROSS_8, "glass", _GLASS, 1950, "CFFF", known=True, n_modes=10),
    _of("T5", (255, 190, 2.0), _QUASI_16, "carbon", _STIFF_CARBON, 1590, known=True, n_modes=12),
    _of("T6", (260, 215, 2.5), _METAL, "aluminium", _ALUMINIUM, 2710, "CFFF", known=True, n_modes=10),
)
FINAL = (
    _of("F1", (240, 240, 2.6), _CROSS_8, "carbon", _STIFF_CARBON, 1585, known=True, n_modes=6),
    _of("F2", (285, 178, 2.9), _CROSS_16, "carbon", _CARBON, 1565, known=False, n_modes=12),
    _of("F3", (230, 140, 1.9), _one_way(10), "carbon", _CARBON, 1575, "CFFF", known=True, n_modes=10),
    _of("F4", (295, 220, 3.3), _CROSS_OUT_90, "glass", _GLASS, 1900, known=False, n_modes=10),
    _of("F5", (215, 195, 1.6), _QUASI_8, "carbon", _CARBON, 1560, "CFFF", known=True, n_modes=12),
    _of("F6", (305, 235, 3.0), _METAL, "aluminium", _ALUMINIUM, 2690, known=True, n_modes=10),
)
ROWS = (
    _of("R1", (250, 180, 2.4), _one_way(12), "carbon", _CARBON, 1580, known=False, n_modes=10),
    _of("R2", (260, 170, 2.7), _CROSS_16, "carbon", _CARBON, 1580, "CFFF", known=False, n_modes=10),
    _of("R3", (230, 230, 2.2), _CROSS_8, "carbon", _CARBON, 1580, known=True, n_modes=10),
)
