"""The pairing of measured shapes as a section, as JSON, and in the words beside its figure."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.mode_shapes.assurance import ShapePairing
from cpam_bayes.plate import Measurement
from cpam_bayes.report.sections import Caption, Section
from cpam_bayes.report.tables import Table, headed

__all__ = ["FIGURE", "assurance_captions", "assurance_sections", "shape_keys"]

FIGURE = "modal_assurance"


def assurance_sections(pairing: ShapePairing | None, measurement: Measurement | None) -> tuple[Section, ...]:
    """Which measured shape is which mode, none without shapes."""
    if pairing is None or measurement is None:
        return ()
    return (Section("Measured shapes", (_table(pairing, measurement),), (FIGURE,)),)


def _table(pairing: ShapePairing, measurement: Measurement) -> Table:
    columns = headed("#measured Hz", "mode", "#model Hz", "#MAC", "#next MAC", "#probability")
    rows = []
    for f, j, mac, p in zip(
        measurement.frequencies, pairing.modes, pairing.assurance, pairing.probability, strict=True
    ):
        mode = pairing.candidates[j] if j >= 0 else None
        others = np.delete(mac, j) if mode is not None else mac
        rows.append(
            (
                f"{f:.10g}",
                "none" if mode is None else mode.label,
                "" if mode is None else significant(mode.frequency, 5),
                "" if mode is None else f"{mac[j]:.3f}",
                f"{others.max(initial=0.0):.3f}",
                "" if mode is None else significant(float(p[j]), 3),
            )
        )
    return Table("Modal assurance at the reference constants", columns, tuple(rows))


def shape_keys(pairing: ShapePairing | None, measurement: Measurement | None) -> dict[str, Any]:
    """The pairing in a JSON document, nothing without shapes."""
    if pairing is None or measurement is None:
        return {}
    rows = zip(measurement.frequencies, pairing.modes, pairing.probability, strict=True)
    return {
        "modal_assurance": pairing.assurance.tolist(),
        "shapes": [
            {
                "measured_hz": float(f),
                "mode": None if j < 0 else int(j) + 1,
                "label": None if j < 0 else pairing.candidates[j].label,
                "probability": None if j < 0 else float(p[j]),
            }
            for f, j, p in rows
        ],
    }


def assurance_captions(pairing: ShapePairing | None) -> dict[str, Caption]:
    """The words beside the matrix, none without shapes."""
    if pairing is None:
        return {}
    n, k = pairing.assurance.shape
    paired = int(np.sum(pairing.modes >= 0))
    return {
        FIGURE: Caption(
            "Each row is a measured shape, each column a mode of the model at the reference constants; dark "
            "is like, 1 is the same shape. A red ring marks the mode that a frequency is taken for, a grey "
            "one a mode that it may be as well. Two dark squares in a row: the nodes do not "
            "tell these modes apart, or the constants differ so much from the reference that the modes "
            "have mixed.",
            f"Modal assurance of {n} measured shapes with {k} modes; {paired} are paired.",
        )
    }
