"""What the paper's simulation gets wrong against its measured plates, by the diagnosis of their lists."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from cpam_bayes.comparison.records import SimulationError
from cpam_bayes.paper import PrintedRow, printed_table
from cpam_bayes.plate import builtin

__all__ = ["diagnosis_row", "simulation_errors"]


def simulation_errors(number: int, diagnosed: Mapping[str, Any]) -> Iterator[SimulationError]:
    """Of Table 1's ABAQUS frequencies, or of all plates of Table 4 beside Table 5; none of another table.

    A misprinted frequency is left out of the rms.

    diagnosed : {"plates": name -> what ``diagnosis_row`` keeps}
    """
    if number not in (1, 5):
        return
    measured = printed_table(1 if number == 1 else 4).rows
    printed = {row.specimen: row for row in printed_table(number).rows if row.source == "ABAQUS"}
    for name in dict.fromkeys(row.specimen for row in measured):
        stored = diagnosed["plates"].get(name)
        if stored is not None:
            rms = _rms_percent(printed[name]) if name in printed else None
            yield SimulationError(
                table=number,
                specimen=name,
                printed_rms_percent=rms,
                **{**stored, "causes": tuple(stored["causes"])},
            )


def _rms_percent(row: PrintedRow) -> float:
    """Root mean square of the printed frequencies over the measured ones, less one, %."""
    measurement = builtin(row.specimen).measurement
    assert measurement is not None
    pairs = zip(row.values.values(), measurement.frequencies, strict=True)
    off = [float(cell.text) / f - 1.0 for cell, f in pairs if not cell.misprinted("value")]
    return 100.0 * float(np.sqrt(np.mean(np.square(off))))


def diagnosis_row(document: Mapping[str, Any]) -> dict[str, Any]:
    """What is kept of the JSON document of `diagnose` about one plate, or of a group of study 12."""
    extended, gain = document["extended"], document["gain"]
    return {
        "plain_rms_percent": document["baseline"]["rms_percent"],
        "claim": document["claim"],
        "causes": document["causes"],
        "probability": document["probability"],
        "extended_rms_percent": None if extended is None else extended["rms_percent"],
        "log_bayes_factor": None if gain is None else gain["log_bayes_factor"],
        "held_out": None if gain is None else gain["held_out_log_score_difference"],
        "held_out_se": None if gain is None else gain["held_out_log_score_se"],
    }
