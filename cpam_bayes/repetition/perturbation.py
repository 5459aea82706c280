"""Gaussian perturbation of a frequency list, eq. (12), in its two interpretations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Interpretation = Literal["relative", "rms"]

INTERPRETATIONS: Final[tuple[Interpretation, ...]] = get_args(Interpretation)

# Draws for one frequency before a list is given up: at the largest level that is accepted more than
# half of all draws are positive.
_MAX_DRAWS = 1000


@dataclass(frozen=True, slots=True)
class PerturbedList:
    """A perturbed list, in rising order as a laboratory writes it down.

    frequencies : (n,) Hz.
    reordered : whether two modes changed places, so that the i-th frequency is not the i-th mode's any
    more.
    redrawn : frequencies that were drawn again because they were not positive.
    """

    frequencies: Array
    reordered: bool
    redrawn: int


def perturbation_sd(frequencies: Array, level: float, interpretation: Interpretation) -> Array:
    """Standard deviations of the noise added to frequencies (n,), Hz.

    Eq. (12) as printed, b = p_e / sqrt(n_s (sum omega_i)^2), has the unit of 1/frequency and cannot
    be meant. Two interpretations have the unit of a frequency, p_e being the level as a fraction:

    * "relative": b_i = p_e f_i, each frequency with its own standard deviation, as 1 % of noise is commonly
      understood;
    * "rms": b = p_e sqrt(sum f_i^2 / n_s), one for all modes, the form of Liu and Han (Computational
      Inverse Techniques in Nondestructive Evaluation, 2003) that eq. (12) goes back to. The lowest
      modes then have a much larger relative noise than the highest.
    """
    if interpretation == "relative":
        return np.asarray(level * frequencies)
    return np.full(len(frequencies), level * np.sqrt(np.mean(np.square(frequencies))))


def perturbed_list(frequencies: Array, sd: Array, rng: np.random.Generator) -> PerturbedList:
    """A list (n,) with independent Gaussian noise of standard deviations sd (n,), Hz.

    A frequency that would not be positive is drawn again. Raises ``ValueError`` where that does not
    end, for a frequency that is not positive itself.
    """
    perturbed = frequencies + sd * rng.standard_normal(len(frequencies))
    redrawn = 0
    for _ in range(_MAX_DRAWS):
        not_positive = ~(perturbed > 0.0)
        if not not_positive.any():
            return PerturbedList(np.sort(perturbed), bool(np.any(np.diff(perturbed) < 0.0)), redrawn)
        redrawn += int(not_positive.sum())
        perturbed[not_positive] = frequencies[not_positive] + sd[not_positive] * rng.standard_normal(
            int(not_positive.sum())
        )
    raise ValueError(f"noise on frequencies: received {frequencies.min():g} Hz, accepted: above zero")
