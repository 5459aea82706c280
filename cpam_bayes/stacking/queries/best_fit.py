"""How well the most probable stacking sequence explains the list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.identification.point import bound_of
from cpam_bayes.stacking.posterior import StackingPosterior

__all__ = ["BestFit", "best_fit"]

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class BestFit:
    """The most probable sequence at its best constants beside the list.

    predicted, residual : (n,) Hz, and predicted / measured - 1; nan where a frequency of a list that may lack
    modes belongs to none, by the most probable pairing. missed : (k,) Hz, modes in the range of the list that
    it lacks. p_value : probability that the noise stated alone leaves squared residuals with such a sum or a
    larger one, chi-square with as many degrees of freedom as frequencies have a mode, as if nothing were
    fitted, so that a small one is no accident; ``None`` where the noise is inferred or none has a mode.
    noise : relative, the root mean square of what is stated, or the posterior mean where it is inferred.
    bounds : constants at a bound, and which, "lower" or "upper".
    """

    predicted: Array
    residual: Array
    missed: Array
    p_value: float | None
    noise: float
    bounds: tuple[tuple[str, str], ...]


def best_fit(answer: StackingPosterior) -> BestFit:
    """The fit of the first sequence listed."""
    template, first = answer.conditional.template, answer.components[:1]
    x, n = first.fits.x, template.model.parameters.size
    p = template.parameters
    ends = [bound_of(*row) for row in zip(x[0, :n], p.lower[:n], p.upper[:n], strict=True)]
    bounds = [(name, end) for name, end in zip(p.names, ends, strict=False) if end is not None]
    at = answer.conditional.at(answer.top[:1])
    measured, found = template.measurement.frequencies, at.predict(x)[0]
    pairing = at.most_probable_pairing(x[0])
    paired = pairing.mode >= 0
    predicted = np.where(paired, found[pairing.mode], np.nan)
    p_value = None
    if template.noise_is_inferred:
        noise = float(first.conditionals.mean[0, -1])
    else:
        noise = float(np.sqrt(np.mean(answer.conditional.relative_noise(x) ** 2)))
        i = np.flatnonzero(paired)
        sigma = template.noise(x, found[None])[0, i, pairing.mode[i]]
        if len(i):
            p_value = float(chi2.sf(np.sum(((measured - predicted)[i] / sigma) ** 2), len(i)))
    return BestFit(
        predicted, predicted / measured - 1.0, found[pairing.missed], p_value, noise, tuple(bounds)
    )
