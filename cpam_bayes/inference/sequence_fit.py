"""How well the most probable stacking sequence explains the list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.inference.identify import bound_of
from cpam_bayes.inference.sequences import SequenceAnswer

__all__ = ["SequenceListFit", "fit_of_the_first"]

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class SequenceListFit:
    """The most probable sequence at its best constants beside the list.

    predicted, residual : (n,) Hz, and predicted / measured - 1; ``None`` where the list may lack modes: there
    no frequency has a mode of its own. p_value : probability that the noise stated alone leaves squared
    residuals with such a sum or a larger one, chi-square with n degrees of freedom as if nothing were fitted,
    so that a small one is no accident; ``None`` where the noise is inferred. noise : its posterior mean,
    relative, ``None`` where it is stated. bounds : constants at a bound, and which, "lower" or "upper".
    """

    predicted: Array | None
    residual: Array | None
    p_value: float | None
    noise: float | None
    bounds: tuple[tuple[str, str], ...]


def fit_of_the_first(answer: SequenceAnswer) -> SequenceListFit:
    """The fit of the first sequence listed."""
    template, first = answer.own.template, answer.components[:1]
    x, n = first.fits.x, template.model.parameters.size
    p = template.parameters
    ends = [bound_of(*row) for row in zip(x[0, :n], p.lower[:n], p.upper[:n], strict=True)]
    bounds = [(name, end) for name, end in zip(p.names, ends, strict=False) if end is not None]
    noise = float(first.conditionals.mean[0, -1]) if template.noise_is_inferred else None
    if not template.measurement.complete:
        return SequenceListFit(None, None, None, noise, tuple(bounds))
    measured = template.measurement.frequencies
    predicted = measured / (1.0 + first.fits.residual[0])
    p_value = None
    if noise is None:
        i = np.arange(len(measured))
        z = (measured - predicted) / template.noise(x, predicted[None])[0, i, i]
        p_value = float(chi2.sf(np.sum(z**2), len(z)))
    return SequenceListFit(predicted, predicted / measured - 1.0, p_value, noise, tuple(bounds))
