"""Units at the border: the names of the plate file, which carry their unit, and SI inside."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

USER_UNITS: Final[Mapping[str, tuple[str, float]]] = MappingProxyType(
    {
        "E1_GPa": ("E1", 1e9),
        "E2_GPa": ("E2", 1e9),
        "nu12": ("nu12", 1.0),
        "G12_GPa": ("G12", 1e9),
        "G13_GPa": ("G13", 1e9),
        "G23_GPa": ("G23", 1e9),
        "length_mm": ("length", 1e-3),
        "width_mm": ("width", 1e-3),
        "thickness_mm": ("thickness", 1e-3),
        "density_kg_m3": ("density", 1.0),
        "mass_g": ("mass", 1e-3),
        "x_mm": ("x", 1e-3),
        "y_mm": ("y", 1e-3),
        "air_density_kg_m3": ("air_density", 1.0),
        "relative_std": ("relative_std", 1.0),
        "absolute_sd_hz": ("absolute_sd", 1.0),
    }
)
"""Name in the plate file -> (name inside, what one of the file's unit is in SI)."""

_BY_NAME: Final = {name: (user, factor) for user, (name, factor) in USER_UNITS.items()}


def split_name(name: str) -> tuple[str, str]:
    """The material of a hybrid, "" of one material, and the plain name: "c.E1" is of "c" and "E1"."""
    material, _, plain = name.rpartition(".")
    return material, plain


def joined_name(material: str, name: str) -> str:
    """The name of a constant of a material: "c.E1"; of the material "" its plain name."""
    return f"{material}.{name}" if material else name


def to_si(user: str, value: float) -> float:
    """A number of the plate file in SI.

    raises ValueError for a name that is not in USER_UNITS
    """
    if user not in USER_UNITS:
        raise ValueError(f"name with unit: received {user!r}, accepted: {list(USER_UNITS)}")
    return _scaled(value, USER_UNITS[user][1])


def to_user(name: str, value: float) -> float:
    """A number inside, SI, in the unit of the plate file.

    raises ValueError for a name that is not in USER_UNITS
    """
    return _scaled(value, 1.0 / _lookup(name)[1])


def user_name(name: str) -> str:
    """The name with unit that the plate file has for a name inside.

    raises ValueError for a name that is not in USER_UNITS
    """
    return _lookup(name)[0]


def unit_of(name: str) -> str:
    """The unit of a constant's name in the plate file, "" where it has none."""
    return user_name(name).removeprefix(name).removeprefix("_")


def _lookup(name: str) -> tuple[str, float]:
    material, plain = split_name(name)
    if plain not in _BY_NAME:
        raise ValueError(f"name: received {name!r}, accepted: {list(_BY_NAME)}")
    user, factor = _BY_NAME[plain]
    return joined_name(material, user), factor


def _scaled(value: float, factor: float) -> float:
    """Dividing by 1000 rounds once, multiplying by 0.001 twice: 3.2 mm must be 0.0032 m."""
    return value * factor if factor >= 1.0 else value / round(1.0 / factor)
