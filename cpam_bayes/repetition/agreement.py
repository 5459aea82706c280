"""Repeated inversions beside a posterior: whether they agree, and if not, what measurably explains it.

In a linear model with Gaussian noise and distant bounds, inversions that weigh the frequencies by
their noise scatter about the truth exactly as wide as the posterior is. Each cause below breaks one of these
conditions, and each has a number that says whether it does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.stats import f as f_distribution
from scipy.stats import t as t_distribution

Array = NDArray[Any]
Cause = Literal[
    "missed", "bounds", "open", "optima", "skewed", "reordered", "weights", "misfit", "stopped", "unexplained"
]

# Both comparisons are made at this probability of a false alarm.
_FALSE_ALARM: Final = 0.01
# Fraction of the inversions, or of the posterior's draws, that sit on a bound.
_AT_BOUND: Final = 0.1
# Posterior sd over prior sd from which the interval rather than the data gives the width.
_OPEN: Final = 0.5
# Skewness of a posterior beyond which its mean is not where its best value is: a Gaussian's is 0, an
# exponential's 2.
_SKEWED: Final = 0.5
# Fraction of the inversions that are worse than the constants found without noise.
_MISSED: Final = 0.1
# Fraction of the perturbed lists in which modes changed places.
_REORDERED: Final = 0.2
# Linearised sd of the minimum of eq. (7) over that of the posterior.
_WEIGHTS: Final = 1.25
# Distance between the inversion without noise and the posterior's best, in posterior sd ...
_OFFSET: Final = 0.3
# ... which is due to residuals of the list if their rms is above this many standard deviations of the
# noise, and to a swarm that stopped early if not.
_RESIDUAL: Final = 0.1
# Groups of values are apart where the gap between them is so many times their width.
_GAP: Final = 3.0


@dataclass(frozen=True, slots=True)
class Evidence:
    """What was measured of one constant at one level of noise.

    groups : number of inversions.
    repetition_mean, repetition_sd : over these (sd with groups - 1).
    posterior_mean, posterior_sd, effective : of the posterior and its effective number of draws.
    repetition_at_bound : inversions that ended on a bound.
    posterior_at_bound : draws next to one.
    clusters : of the inversions.
    peaks : of the posterior's density.
    skewness : of the posterior.
    contraction : posterior sd over prior sd.
    reordered : fraction of perturbed lists in which modes changed places.
    missed : fraction of inversions whose swarms did not find the minimum.
    weighting : linearised sd of the minimum of eq. (7) over that of the posterior.
    offset : the inversion of the list without noise less the posterior's best, in posterior sd.
    residual : rms residual of that inversion over the noise's standard deviations.
    """

    groups: int
    repetition_mean: float
    repetition_sd: float
    posterior_mean: float
    posterior_sd: float
    effective: float
    repetition_at_bound: float
    posterior_at_bound: float
    clusters: int
    peaks: int
    skewness: float
    contraction: float
    reordered: float
    missed: float
    weighting: float
    offset: float
    residual: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Whether repetition and posterior agree.

    standard_error : of the mean over the groups, sd / sqrt(groups).
    shift : mean of the inversions less the posterior's, in combined standard errors.
    sd_ratio : their sd over the posterior's.
    causes : empty where both agree within chance, "unexplained" where no number shows a cause.
    """

    standard_error: float
    shift: float
    sd_ratio: float
    means_agree: bool
    sds_agree: bool
    causes: tuple[Cause, ...]


def compare(evidence: Evidence) -> Comparison:
    """Test means and standard deviations against each other and list what can explain a difference.

    Means: a t-test of the difference with groups - 1 degrees of freedom; standard deviations: an
    F-test of their squared ratio with groups - 1 and effective - 1; each with a false alarm in 1 %.
    A cause is listed where its own number is beyond its threshold and it can act in that direction.
    """
    n = evidence.groups
    error = evidence.repetition_sd / np.sqrt(n)
    combined = float(np.hypot(error, evidence.posterior_sd / np.sqrt(max(evidence.effective, 1.0))))
    difference = evidence.repetition_mean - evidence.posterior_mean
    shift = difference / combined if combined > 0.0 else float(np.copysign(np.inf, difference))
    ratio = evidence.repetition_sd / evidence.posterior_sd if evidence.posterior_sd > 0.0 else np.inf
    half = _FALSE_ALARM / 2
    means = bool(abs(shift) <= t_distribution.ppf(1 - half, n - 1)) or difference == 0.0
    freedom = (n - 1, max(evidence.effective - 1.0, 1.0))
    low, high = (float(f_distribution.ppf(p, *freedom)) for p in (half, 1 - half))
    sds = bool(low <= ratio**2 <= high)
    return Comparison(
        float(error), float(shift), float(ratio), means, sds, _causes(evidence, float(ratio), means, sds)
    )


def _causes(evidence: Evidence, ratio: float, means: bool, sds: bool) -> tuple[Cause, ...]:
    if means and sds:
        return ()
    at_bound = max(evidence.repetition_at_bound, evidence.posterior_at_bound) >= _AT_BOUND
    signs: dict[Cause, bool] = {
        "missed": evidence.missed >= _MISSED,
        "bounds": at_bound,
        "open": evidence.contraction >= _OPEN,
        "optima": max(evidence.clusters, evidence.peaks) > 1,
        "skewed": abs(evidence.skewness) >= _SKEWED,
        "reordered": evidence.reordered >= _REORDERED,
        # weights that are not the noise's can only widen the scatter
        "weights": not sds and ratio > 1.0 and evidence.weighting >= _WEIGHTS,
        "misfit": abs(evidence.offset) >= _OFFSET and evidence.residual >= _RESIDUAL,
        "stopped": abs(evidence.offset) >= _OFFSET and evidence.residual < _RESIDUAL,
    }
    return tuple(cause for cause, shown in signs.items() if shown) or ("unexplained",)


def clusters(values: Array) -> int:
    """Number of groups, one or two, that a few values (n,) fall into.

    Two where the widest gap that leaves at least two values on either side is more than three times
    the standard deviation within the sides: draws of one Gaussian hardly ever do that.
    """
    x = np.sort(np.asarray(values, dtype=float))
    n = len(x)
    if n < 4:
        return 1
    gaps = np.diff(x)[1 : n - 2]
    cut = 2 + int(np.argmax(gaps))
    within = np.sqrt((cut * x[:cut].var() + (n - cut) * x[cut:].var()) / (n - 2))
    return 2 if gaps.max() > _GAP * within else 1


def density_peaks(draws: Array, bins: int = 60) -> int:
    """Number of separate peaks of the density that many draws (m,) come from.

    A histogram between the 0.1 % and 99.9 % quantiles is smoothed with a Gaussian of two bins; two
    peaks of at least a tenth of the highest are separate where the density between them falls below half of
    the lower one.
    """
    low, high = np.quantile(draws, (0.001, 0.999))
    if not high > low:
        return 1
    width = 2.0
    kernel = np.exp(-0.5 * (np.arange(-8, 9) / width) ** 2)
    count, _ = np.histogram(draws, bins=bins, range=(low, high))
    # what lies on a bound would leak out over it: the density is mirrored at both ends
    mirrored = np.concatenate((count[7::-1], count, count[:-9:-1])).astype(float)
    density = np.convolve(mirrored, kernel / kernel.sum(), mode="valid")
    # between zeros, the height of the highest peak counts in full
    _, properties = find_peaks(np.pad(density, 1), height=0.1 * density.max(), prominence=0.0)
    return int(np.count_nonzero(properties["prominences"] > 0.5 * properties["peak_heights"]))


def skewness(draws: Array) -> float:
    """Third standardised moment of draws (m,), 0 where they do not vary."""
    away = np.asarray(draws - np.mean(draws))
    sd = float(np.sqrt(np.mean(away**2)))
    return float(np.mean(away**3)) / sd**3 if sd > 0.0 else 0.0
