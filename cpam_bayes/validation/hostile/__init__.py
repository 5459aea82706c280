"""Files and texts that no user means, by hypothesis, and damage to stored files."""

from __future__ import annotations

from cpam_bayes.validation.hostile.crossing import crossed
from cpam_bayes.validation.hostile.damage import DAMAGES
from cpam_bayes.validation.hostile.layups import layups
from cpam_bayes.validation.hostile.plate_files import LARGE_FILES, plate_texts
from cpam_bayes.validation.hostile.recordings import recordings
from cpam_bayes.validation.hostile.tables import LARGE_TABLES, mode_tables, response_tables
from cpam_bayes.validation.hostile.universal import (
    LARGE_UNIVERSAL_FILES,
    universal_modes_files,
    universal_response_files,
)

__all__ = [
    "DAMAGES",
    "LARGE_FILES",
    "LARGE_TABLES",
    "LARGE_UNIVERSAL_FILES",
    "crossed",
    "layups",
    "mode_tables",
    "plate_texts",
    "recordings",
    "response_tables",
    "universal_modes_files",
    "universal_response_files",
]
