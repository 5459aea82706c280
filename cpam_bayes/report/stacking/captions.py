"""The words beside the figures of `sequence`."""

from __future__ import annotations

from cpam_bayes.report.sections import Caption
from cpam_bayes.stacking.sequence import StackingResult


def captions(result: StackingResult) -> dict[str, Caption]:
    """A caption for each figure."""
    answer = result.answer
    best = "/".join(f"{a:g}" for a in answer.top[0])
    many = f"{answer.credible_count} of {answer.enumerated}"
    return {
        "angles": Caption(
            "One row for each unknown angle, the lowest ply first: a single dark cell is an angle that the "
            "frequencies determine, a grey row one that they leave open. The circle is the most probable "
            "sequence.",
            f"Probability of every angle for {len(answer.marginals)} unknown angles; most probable {best}.",
        ),
        "credible_set": Caption(
            "Left: the most probable sequences with their angles. Middle: the probability of each with its "
            "images, which no frequency tells apart. Right: how many sequences hold 95 % of the probability: "
            "one is an answer, many are a list to choose from by other knowledge.",
            f"The most probable stacking sequences; {many} hold 95 % of the probability.",
        ),
        "constants": Caption(
            "Grey: the constants whatever the sequence. A red curve elsewhere than the grey one says that "
            "the constants depend on which sequence is true.",
            "Posterior densities of the constants over all sequences and given the most probable one.",
        ),
    }
