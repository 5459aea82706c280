"""The words beside the drawing of a plate."""

from __future__ import annotations

from collections.abc import Sequence

from cpam_bayes.plate import Specimen
from cpam_bayes.report.sections import Caption
from cpam_bayes.report.sentences import plate_sentence


def plate_caption(specimens: Sequence[Specimen]) -> Caption:
    """What the drawing of one plate, or of several, shows."""
    edges = {edge for s in specimens for edge in s.plate.edges}
    sensors = any(s.sensors for s in specimens)
    parts = ["The plate as the model has it, seen from above"]
    if "C" in edges:
        parts.append("hatched edges are clamped")
    if "S" in edges:
        parts.append("edges on triangles are simply supported")
    if sensors:
        parts.append("a red dot is a mass attached to the plate")
    if not all(s.material.isotropic for s in specimens):
        parts.append("beside it the plies from the bottom to the top, like colours at like angles")
    text = (
        "; ".join(parts)
        + ". Whatever was on the plate in the laboratory and is not drawn is not in the model."
    )
    return Caption(text, " ".join(plate_sentence(s) for s in specimens))
