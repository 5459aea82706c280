"""How well the most probable stacking sequence fits the measured frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.identification.point import bound_of
from cpam_bayes.stacking.records import StackingPosterior

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class BestFit:
    """The most probable stacking sequence at its best constants beside the measured frequencies.

    predicted : (n,) Hz; nan where a frequency of a list that may lack modes is paired with none, by the
    most probable pairing.
    residual : (n,) predicted / measured - 1.
    missed : (k,) Hz, modes in the range of the list that it lacks.
    p_value : probability that the noise stated alone leaves squared residuals with such a sum or a larger
    one, chi-square with as many degrees of freedom as frequencies are paired, as if nothing were fitted, so
    that a small one is no accident; ``None`` where the noise is inferred or no frequency is paired.
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
    """The fit of the first stacking sequence listed."""
    template, first = answer.conditional.template, answer.components[:1]
    x, n = first.fits.x, template.model.parameters.size
    p = template.parameters
    ends = [bound_of(*row) for row in zip(x[0, :n], p.lower[:n], p.upper[:n], strict=True)]
    bounds = [(name, end) for name, end in zip(p.names, ends, strict=False) if end is not None]
    posterior = answer.conditional.at(answer.top[:1])
    measured, frequencies = template.measurement.frequencies, posterior.predict(x)[0]
    pairing = posterior.most_probable_pairing(x[0])
    paired = pairing.mode >= 0
    predicted = np.where(paired, frequencies[pairing.mode], np.nan)
    p_value = None
    if template.noise_is_inferred:
        noise = float(first.conditionals.mean[0, -1])
    else:
        noise = float(np.sqrt(np.mean(answer.conditional.relative_noise(x) ** 2)))
        i = np.flatnonzero(paired)
        sigma = template.noise(x, frequencies[None])[0, i, pairing.mode[i]]
        if len(i):
            p_value = float(chi2.sf(np.sum(((measured - predicted)[i] / sigma) ** 2), len(i)))
    residual = predicted / measured - 1.0
    return BestFit(predicted, residual, frequencies[pairing.missed], p_value, noise, tuple(bounds))
