"""The words beside the figures of `forward`."""

from __future__ import annotations

from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.report.modal_assurance.rows import assurance_captions
from cpam_bayes.report.sections import Caption, modes_caption


def captions(result: ForwardResult) -> dict[str, Caption]:
    """A caption for each figure."""
    of_modes = modes_caption([(m.frequency, m.label or m.kind) for m in result.modes])
    return {"modes": of_modes} | assurance_captions(result.by_shape)
