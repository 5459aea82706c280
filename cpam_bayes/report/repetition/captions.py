"""The words beside the figures of `sensitivity`."""

from __future__ import annotations

from cpam_bayes.formatting import listed
from cpam_bayes.repetition.sensitivity import SensitivityResult
from cpam_bayes.report.sections import Caption


def captions(result: SensitivityResult) -> dict[str, Caption]:
    """A caption for each figure."""
    names = listed([c.name for c in result.study.without_noise.constants], "and")
    return {
        "sensitivity": Caption(
            "Dots: the mean of repeated inversions, with its standard deviation (thin) and its standard "
            "error (thick). Squares: one posterior at the same noise. Where dot and square differ by more "
            "than the thick bar, the repetition is off, not unlucky. Crosses: printed in the paper.",
            f"Inversions of perturbed frequencies beside posteriors of {names} at each level of noise.",
        )
    }
