"""The words beside the figures of a diagnosis."""

from __future__ import annotations

from cpam_bayes.diagnosis.claim import PLAIN, SURE
from cpam_bayes.diagnosis.paired_modes import FrequencyRow
from cpam_bayes.diagnosis.plates import DiagnosisResult
from cpam_bayes.diagnosis.signatures import ALIKE
from cpam_bayes.formatting import listed
from cpam_bayes.report.diagnosis.rows import (
    constant_rows,
    leading,
    shows_constants,
    shows_detectable,
    shows_signatures,
)
from cpam_bayes.report.diagnosis.words import probability_text
from cpam_bayes.report.sections import Caption


def captions(result: DiagnosisResult) -> dict[str, Caption]:
    """A caption for each figure."""
    d = result.diagnosis
    extended = "" if d.extended is None else " Orange: what the extended model leaves."
    residuals = ", ".join(map(_residual, result.plain.frequencies))
    most = ", ".join(f"{c.name} {probability_text(c.probability)}" for c in leading(d, 0.05, 5))
    drawn = {
        "residuals": Caption(
            "Blue: what the plain plate model leaves of each frequency. A bar whose whisker does not reach "
            f"zero is more than noise.{extended} Below each bar stands the shape of its mode, red up and "
            "blue down: where the large bars have something in common, such as an edge or a twist, the "
            "cause acts.",
            f"Residuals of the plain model: {residuals}.",
        ),
        "causes": Caption(
            "How probable each cause is. The black mark is what a claim of that cause alone needs: "
            f"{PLAIN:g} for none, which says that nothing is wrong, {SURE:g} for the others. ln B weighs a "
            "cause against none: three and more speak for the cause.",
            f"Probabilities of the causes: {most}.",
        ),
    }
    if shows_signatures(d):
        drawn["signatures"] = Caption(
            "Two causes with a dark, framed cell move the frequencies in the same proportions: no analysis "
            "of these frequencies can tell one from the other.",
            f"Likeness of the causes' signatures; framed where the cosine is above {ALIKE:g}.",
        )
    if shows_detectable(d):
        drawn["detectable"] = Caption(
            "The shorter the bar, the smaller the error that these frequencies would have shown. A pale "
            "bar with no size is a cause that may be there unseen, however large.",
            "The smallest size of each cause that these frequencies would have shown with 95 % probability.",
        )
    if shows_constants(d):
        names = listed([row.name.split("_")[0] for row in constant_rows(d, d.baseline)], "and")
        second = (
            "averaged over all causes by their probability" if d.extended is None else "of the extended model"
        )
        drawn["constants"] = Caption(
            f"Blue: the constants as if nothing were wrong. Orange: {second}. Where the two differ, the "
            "constants depend on what is wrong with the model. Dotted: the reference of the plate file.",
            f"Means and 95 % intervals of {names}.",
        )
    return drawn


def _residual(row: FrequencyRow) -> str:
    left = "no mode" if row.residual_percent is None else f"{row.residual_percent:+.2f} %"
    return f"{row.measured:.6g} Hz {left}"
