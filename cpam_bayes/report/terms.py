"""Words of the field that a page explains where it uses them, as docs/glossary.md has them."""

from __future__ import annotations

import re
from typing import Final

from cpam_bayes.report.sections import Section
from cpam_bayes.report.tables import facts

__all__ = ["TERMS", "terms_section"]

TERMS: Final = {
    "contraction": "1 - (sd / prior sd)\N{SUPERSCRIPT TWO}: 1 where the data say all, 0 where they "
    "say nothing",
    "effective samples": "independent draws that would be as good as the correlated ones of the chains",
    "evidence": "the probability of the list under a model, its constants integrated over; also marginal "
    "likelihood",
    "extended model": "the plate model with the claimed cause in it",
    "false peak": "a listed frequency that is no mode of the plate",
    "interval": "unless said otherwise, from the 2.5 % to the 97.5 % quantile of the posterior",
    "k-hat": "tail index of importance weights: above 0.7 their average is not to be trusted",
    "label": "a mode named by its nodal lines across x and across y: (1,1) is the first twist of a free "
    "plate",
    "missed mode": "a mode in the range of the list that is not in it",
    "noise": "scatter of a measured frequency about that of its mode",
    "p-value": "the probability of residuals as large or larger if the model is right, with the noise that "
    "is named beside it",
    "plain model": "the plate as its file says, with nothing wrong",
    "posterior": "the probability of the constants after the measurement",
    "prior": "the probability of the constants, or of the size of a cause, before the measurement",
    "R-hat": "spread between chains over that within them: 1.01 and more means not converged",
    "repeatability": "the scatter of a frequency from test to test of one plate: `relative_std`",
    "residual": "predicted / measured - 1",
    "rms": "root mean square, here of the relative residuals",
    "signature": "how a cause shifts the frequencies, less what the constants can imitate",
    "walker": "one of the points that an ensemble sampler moves",
}
"""Word -> what it means."""


def terms_section(text: str) -> Section:
    """The words that a text uses, with what they mean."""
    used = tuple(
        (word, meaning)
        for word, meaning in TERMS.items()
        if re.search(rf"\b{re.escape(word)}s?\b", text, re.IGNORECASE)
    )
    return Section("Words on this page", (facts("Words on this page", used),))
