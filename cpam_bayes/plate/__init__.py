"""Plate files, their units, and the built-in specimens."""

from cpam_bayes.plate.reader import (
    PlateLike,
    builtin,
    builtin_names,
    builtin_plates,
    parse_specimen,
    read_plate,
    read_specimen,
)
from cpam_bayes.plate.records import Hybrid, Material, Measurement, Plate, Sensor, Specimen, angle_grid
from cpam_bayes.plate.text import MAX_BYTES
from cpam_bayes.plate.units import USER_UNITS, to_si, to_user, unit_of, user_name

__all__ = [
    "MAX_BYTES",
    "USER_UNITS",
    "Hybrid",
    "Material",
    "Measurement",
    "Plate",
    "PlateLike",
    "Sensor",
    "Specimen",
    "angle_grid",
    "builtin",
    "builtin_names",
    "builtin_plates",
    "parse_specimen",
    "read_plate",
    "read_specimen",
    "to_si",
    "to_user",
    "unit_of",
    "user_name",
]
