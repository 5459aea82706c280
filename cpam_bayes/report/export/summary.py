"""`export` in plain words."""

from __future__ import annotations

import shlex

from cpam_bayes.forward_model.export import ExportResult
from cpam_bayes.report.sentences import plate_argument, plate_sentence
from cpam_bayes.report.summary import Summary


def summary(result: ExportResult) -> Summary:
    """What was written, and what to do with it."""
    n_rigid = result.deck.n_rigid
    return Summary(
        title=f"export {result.title}",
        slips=result.slips,
        headline=(
            f"The file {result.path} asks CalculiX or ABAQUS for the first {result.n_modes} natural "
            f"frequencies of this plate{'' if not n_rigid else f', after {n_rigid} rigid-body motions'}."
        ),
        basis=(
            plate_sentence(result.specimen),
            f"The mesh: {result.n_elements} {result.element} elements of type {result.element_type}, "
            f"{len(result.deck.mesh.nodes)} nodes; units N, m, kg, s.",
            "The constants are those of [material], not identified ones.",
        ),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=(
            f"Solve with CalculiX: ccx {shlex.quote(str(result.path.with_suffix('')))}",
            f"Compare with this package: cpam-bayes forward {plate_argument(result.specimen)}",
        ),
    )
