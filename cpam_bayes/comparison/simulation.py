"""What the paper's simulation gets wrong against its measured plates, by the diagnosis of their lists."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from cpam_bayes.comparison.records import SimulationError
from cpam_bayes.paper import printed_table
from cpam_bayes.plate import builtin

__all__ = ["diagnosis_row", "simulation_errors"]


def simulation_errors(number: int, diagnosed: Mapping[str, Any]) -> Iterator[SimulationError]:
    """Of the ABAQUS frequencies of Table 1 or 5, plate by plate; none of another table.

    A misprinted frequency is left out of the rms.

    diagnosed : {"plates": name -> what ``diagnosis_row`` keeps}
    """
    if number not in (1, 5):
        return
    for row in printed_table(number).rows:
        stored = diagnosed["plates"].get(row.specimen)
        if row.role != "computed" or row.source != "ABAQUS" or stored is None:
            continue
        measurement = builtin(row.specimen).measurement
        assert measurement is not None
        pairs = zip(row.values.values(), measurement.frequencies, strict=True)
        off = [float(cell.text) / f - 1.0 for cell, f in pairs if not cell.misprinted("value")]
        yield SimulationError(
            table=number,
            specimen=row.specimen,
            printed_rms_percent=100.0 * float(np.sqrt(np.mean(np.square(off)))),
            **{**stored, "causes": tuple(stored["causes"])},
        )


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
