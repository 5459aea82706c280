"""`export --to uff` in plain words."""

from __future__ import annotations

from cpam_bayes.forward_model.export import UniversalResult
from cpam_bayes.report.sentences import plate_argument, plate_sentence
from cpam_bayes.report.summary import Summary


def summary(result: UniversalResult) -> Summary:
    """What was written, and what to do with it."""
    shapes = result.shapes
    where = "the nodes of the measured shapes" if shapes.measured else "nodes of a grid"
    return Summary(
        title=f"export {result.title}",
        slips=result.slips,
        headline=(
            f"The universal file {result.path} holds {len(shapes.modes)} predicted modes of this plate, "
            f"{shapes.modes[0].frequency:.4g} to {shapes.modes[-1].frequency:.4g} Hz, at {len(shapes.nodes)} "
            f"{where}."
        ),
        basis=(
            plate_sentence(result.specimen),
            "Datasets 15 (nodes, mm from the corner x = y = 0) and 55 (displacements along x, y, z).",
            "The constants are those of [material], not identified ones.",
        ),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=(
            "Import the file into the modal software beside the measured modes.",
            f"See the same modes here: cpam-bayes forward {plate_argument(result.specimen)}",
        ),
    )
