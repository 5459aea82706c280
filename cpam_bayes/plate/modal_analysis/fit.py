"""Poles of frequency responses, with standard deviations.

Candidates are poles of rational models that are stable over many orders, an octave at a time. Each is fitted
by least squares in a band of its own, hit by hit; a mode recurs in the hits and stands out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.stats import f as f_distribution

from cpam_bayes.plate.modal_analysis.hits import MAINS, FrequencyResponses
from cpam_bayes.plate.modes_of_hits import small_sample_factor

Array = NDArray[Any]

# Half width of the band about a pole, in half widths of its peak, and in lines at least.
_WIDTHS, _LINES = 6.0, 14
# Poles up to this multiple of the band are free as well, those up to the second one fixed.
_FREE, _FIXED = 1.3, 5.0
# Degree of the polynomial of frequency that represents all modes further away.
_RESIDUAL_DEGREE: Final = 2
# p-value of a pole under noise alone, above which it is no mode.
_SIGNIFICANT: Final = 1e-6
# A fit that moves a pole further than this, in half widths of its peak, has found another.
_FAR: Final = 2.0
_STEPS: Final = 25
# A fit ends where steps are below this fraction of the half widths.
_SMALL: Final = 1e-4
# A basis column is linearly dependent on the others where its remainder is no larger than this.
_DEPENDENT: Final = 1e-12
# Residuals that are correlated more than this are not noise about a good fit.
_MAX_CORRELATION: Final = 0.9
_LEAST_FREEDOM: Final = 10
# Poles this close, in half widths, are one.
_MERGED: Final = 0.1
# Peaks this many times their sum cancel each other: a degenerate fit.
_CANCELLING: Final = 10.0
STANDS_OUT: Final = 0.6
"""Least height of a mode's peak over the rest of the response; a lower one may be an artefact of the fit."""
_HIGHEST: Final = 1e3
LEAST_SD: Final = 0.01
"""Least standard deviation that is claimed, Hz: plates change by more from day to day."""
# A tone that decays by no more than this exponent within a record is steady.
_STEADY: Final = 3.0
# Least standard deviation of a frequency in a single hit, as a fraction of the line spacing.
_OF_A_LINE: Final = 1.0 / 30.0
# Poles of different hits are one mode up to this difference, as a fraction of the frequency.
_DRIFT: Final = 0.025


class Taken(Enum):
    """The kinds of pole; values as in tables and JSON documents."""

    MODE = "mode"
    WEAK = "weak"
    RARE = "too few hits"
    HUM = "hum"
    SECOND_HIT = "second hit"


@dataclass(frozen=True, slots=True)
class Pole:
    """One pole, of one hit or averaged over hits.

    frequency, sd : Hz, undamped natural frequency |s| / 2 pi, the mean over the hits
    damping, damping_sd : ratio -Re s / |s|
    height : of its peak over the rest of the response there
    peak : Hz, where the responses are largest within its half width, nan where that is at an end
    hits : number of hits that show it
    scatter : Hz, standard deviation from hit to hit, nan for one
    each : (n_hits,) Hz in each hit, nan where it does not show
    taken : its kind, a mode or the reason why it is none
    """

    frequency: float
    sd: float
    damping: float
    damping_sd: float
    height: float = np.inf
    peak: float = np.nan
    hits: int = 1
    scatter: float = np.nan
    each: tuple[float, ...] = ()
    taken: Taken = Taken.MODE


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """Responses in a band.

    omega : (n,) rad/s
    data : (n, n_responses)
    fixed : (n_fixed,) poles that stay where they are, rad/s
    force_noise : (n, n_responses) variance of data by the noise of the force
    """

    omega: Array
    data: Array
    fixed: Array
    force_noise: Array

    def fitted(self, poles: Array) -> tuple[Array, Array, Array]:
        """Residuals of the responses from poles (n_poles,), the best residues, and a basis of all columns."""
        x = (self.omega - self.omega.mean()) / np.ptp(self.omega)
        peaks = 1.0 / (1j * self.omega[:, None] - np.concatenate((poles, self.fixed)))
        columns = np.hstack((peaks, np.vander(x, _RESIDUAL_DEGREE + 1)))
        norms = np.linalg.norm(columns, axis=0)
        q, r = np.linalg.qr(columns / norms)
        inside = q.conj().T @ self.data
        diagonal = np.abs(np.diag(r))
        r = r + np.diag(np.where(diagonal > _DEPENDENT, 0.0, 1.0))  # columns that others hold get nothing
        residues = (np.linalg.solve(r, inside) / norms[:, None])[: len(poles)]
        return self.data - q @ inside, residues, q


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A least-squares fit in a band.

    poles : (n,) free ones
    variance : (n,) of real and of imaginary parts, from the variance of the residuals
    peaks : (n, n_responses) complex, at each pole's own frequency
    left : (n_lines, n_responses) residuals over their standard deviations
    weight : (n_responses,)
    freedom : degrees of freedom of the residuals
    """

    poles: Array
    variance: Array
    peaks: Array
    left: Array
    weight: Array
    freedom: int


def _solved(band: _Band, poles: Array) -> _Fit | None:
    """The fit from starting poles (n,), None where there are too few lines.

    Residues and polynomials are eliminated; Gauss-Newton steps on the projected derivatives A / (i w - s)^2
    (Kaufman, BIT 15, 1975) are halved until the residual falls.
    """
    n, m = band.data.shape
    freedom = 2 * (n * m - m * (len(poles) + len(band.fixed) + _RESIDUAL_DEGREE + 1) - len(poles))
    if freedom < _LEAST_FREEDOM:
        return None
    tiny = np.finfo(float).tiny
    left, residues, q = band.fitted(poles)
    for _ in range(_STEPS):
        weight = 1.0 / np.sqrt(np.maximum(m * np.sum(np.abs(left) ** 2, axis=0) / freedom, tiny))
        amplitudes = residues * weight
        slopes = 1.0 / (1j * band.omega[:, None] - poles) ** 2
        slopes = slopes - q @ (q.conj().T @ slopes)
        normal = (slopes.conj().T @ slopes) * (amplitudes.conj() @ amplitudes.T)
        gradient = np.sum(amplitudes.conj() * (slopes.conj().T @ (left * weight)), axis=1)
        size = np.sqrt(np.maximum(np.abs(np.diag(normal)), tiny))
        inverse = np.linalg.pinv(normal / np.outer(size, size), hermitian=True) / np.outer(size, size)
        step, cost = inverse @ gradient, np.sum(np.abs(left * weight) ** 2)
        for _ in range(_STEPS):
            ahead = poles + step
            if np.all(ahead.real < 0.0):
                after = band.fitted(ahead)
                if np.sum(np.abs(after[0] * weight) ** 2) <= cost:
                    poles, (left, residues, q) = ahead, after
                    break
            step = 0.5 * step
        if np.all(np.abs(step) < _SMALL * -poles.real):
            break
    weight = 1.0 / np.sqrt(np.maximum(m * np.sum(np.abs(left) ** 2, axis=0) / freedom, tiny))
    peaks = residues / -poles.real[:, None]
    # noise of the force is largest at the peaks, where the fit absorbs the residuals: it is added as known,
    # and its share of the residuals is subtracted
    moved = np.abs(inverse @ (slopes.conj()[:, None, :] * amplitudes.T.conj()).reshape(-1, len(poles)).T) ** 2
    of_force = 0.5 * band.force_noise * weight**2
    share = np.average(of_force.mean(axis=1), weights=1.0 - np.sum(np.abs(q) ** 2, axis=1))
    variance = np.diag(inverse).real * max(1.0 - float(share), 0.0) + moved @ of_force.ravel()
    return _Fit(poles, variance, peaks, left * weight, weight, freedom)


def _band_about(responses: FrequencyResponses, candidates: Array, target: int) -> tuple[_Band, Array]:
    """The band of a candidate, and which candidates are free in it, (n,) bool."""
    s = candidates[target]
    reach = max(_WIDTHS * -s.real / (2.0 * np.pi), _LINES * responses.step)
    lines = np.abs(responses.frequencies - s.imag / (2.0 * np.pi)) <= reach
    away = np.abs(candidates.imag - s.imag) / (2.0 * np.pi)
    fixed = candidates[(away > _FREE * reach) & (away <= _FIXED * reach)]
    omega = 2.0 * np.pi * responses.frequencies[lines]
    data = responses.frf[:, lines].T
    relative = 0.0 if responses.force_noise is None else responses.force_noise[:, lines].T
    return _Band(omega, data, fixed, relative * np.abs(data) ** 2), away <= _FREE * reach


def _explains(band: _Band, fit: _Fit, at: int) -> bool:
    """Whether a pole explains more than noise alone would, by an F test of independent lines."""
    without = np.sum(np.abs(band.fitted(np.delete(fit.poles, at))[0] * fit.weight) ** 2)
    rest = float(np.sum(np.abs(fit.left) ** 2))
    added = 2 + 2 * fit.left.shape[1]
    wider = _widening(fit.left)
    ratio = (float(without) - rest) / added / max(rest / fit.freedom, np.finfo(float).tiny)
    return bool(f_distribution.sf(ratio / wider, added, fit.freedom / wider) < _SIGNIFICANT)


def _height(band: _Band, fit: _Fit, at: int) -> float:
    """Height of a pole's peak over the rest of the response there."""
    line = int(np.argmin(np.abs(band.omega - fit.poles[at].imag)))
    own = fit.peaks[at] * -fit.poles[at].real / (1j * band.omega[line] - fit.poles[at])
    beside = np.linalg.norm((band.data[line] - own) * fit.weight)
    size = float(np.linalg.norm(own * fit.weight))
    return size / max(float(beside), size / _HIGHEST, np.finfo(float).tiny)


def _peak(responses: FrequencyResponses, pole: complex) -> float:
    """Frequency of the largest response within the half width of a pole, Hz, nan where it is at an end."""
    step = responses.step
    reach = max(int(np.ceil(-pole.real / (2.0 * np.pi) / step)), 2)
    at = int(np.rint((pole.imag / (2.0 * np.pi) - responses.frequencies[0]) / step))
    near = slice(max(at - reach, 0), at + reach + 1)
    size = np.linalg.norm(responses.frf[:, near], axis=0)
    top = int(np.argmax(size)) if len(size) else 0
    return float(responses.frequencies[near][top]) if 0 < top < len(size) - 1 else np.nan


def _cancels(band: _Band, fit: _Fit, at: int) -> bool:
    """Whether a peak is many times the sum of all: it and a neighbour describe the same mode."""
    there = np.linalg.norm(band.data * fit.weight, axis=1).max()
    return bool(np.linalg.norm(fit.peaks[at] * fit.weight) > _CANCELLING * there)


def _is_at(found: complex, start: complex) -> bool:
    return abs(found - start) < _FAR * -start.real


def _refined(responses: FrequencyResponses, candidates: Array) -> Array:
    """Candidates moved to their fits, without those that cancel a neighbour or coincide with one."""
    poles: list[complex] = []
    i = 0
    while i < len(candidates):
        band, free = _band_about(responses, candidates, i)
        fit, at = _solved(band, candidates[free]), int(np.sum(free[:i]))
        if fit is None or _cancels(band, fit, at):
            candidates = np.delete(candidates, i)
            continue
        s = complex(candidates[i])
        one = complex(fit.poles[at]) if _is_at(fit.poles[at], s) else s
        if all(abs(one - p) > _MERGED * -one.real for p in poles):
            poles.append(one)
        i += 1
    return np.array(sorted(poles, key=lambda one: one.imag), dtype=complex)


def fit_poles(responses: FrequencyResponses, candidates: Array) -> tuple[Pole, ...]:
    """Poles fitted to candidates (n,), each with those near it, where they explain more than noise.

    H_k(i w) = sum_r A_kr / (i w - s_r) + c_k0 + c_k1 w + c_k2 w^2 in a band of six half widths of the peak,
    at least 14 lines, to either side; the conjugate poles are far off and smooth there. Residues and
    polynomials are linear and eliminated (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973); the poles near
    the band are free, those further away fixed. The covariance is from the residual variance of each
    response, widened for correlation from line to line and by `small_sample_factor`. Poles that cancel each
    other are refused.
    """
    candidates = _refined(responses, candidates)
    poles = []
    for i, s in enumerate(candidates):
        band, free = _band_about(responses, candidates, i)
        fit, at = _solved(band, candidates[free]), int(np.sum(free[:i]))
        if fit is None or not _is_at(fit.poles[at], s) or not _explains(band, fit, at):
            continue
        if _cancels(band, fit, at):
            continue
        wider = _widening(fit.left)
        variance = fit.variance[at] * wider * small_sample_factor(fit.freedom / wider) ** 2
        pole = _described(complex(fit.poles[at]), variance, responses, _height(band, fit, at))
        poles += [] if pole is None else [replace(pole, peak=_peak(responses, complex(fit.poles[at])))]
    return tuple(sorted(poles, key=lambda pole: pole.frequency))


def _widening(left: Array) -> float:
    """Growth of variances by noise with the correlation r^k over k lines, (1 + r) / (1 - r)."""
    together = np.sum((left[1:] * left[:-1].conj()).real) / max(np.sum(np.abs(left) ** 2), 1e-300)
    r = float(np.clip(together, 0.0, _MAX_CORRELATION))
    return (1.0 + r) / (1.0 - r)


def _described(s: complex, variance: float, responses: FrequencyResponses, height: float) -> Pole | None:
    """The pole without the decay that a window adds, None where no damping is left."""
    s += responses.added_decay
    size = abs(s)
    if not s.real < 0.0:
        return None
    sd = float(np.sqrt(variance))
    least = max(LEAST_SD, _OF_A_LINE * responses.step)
    frequency = size / (2.0 * np.pi)
    return Pole(frequency, max(sd / (2.0 * np.pi), least), -s.real / size, sd * abs(s.imag) / size**2, height)


def with_others(candidates: Array, others: Array) -> Array:
    """Candidates (n,) and those ``others`` that have no candidate within their half width, ascending."""
    new = [s for s in others if not np.any(np.abs(candidates - s) < _APART * -s.real)]
    return np.array(sorted((*candidates, *new), key=lambda s: s.imag), dtype=complex)


def modes_of_hits(
    each: Sequence[Sequence[Pole]], step: float, struck_twice: Sequence[bool] = ()
) -> tuple[Pole, ...]:
    """One table of the poles of all hits, ascending, each with its kind.

    Poles of different hits within 2.5 % are merged, the nearest first. The standard deviation is that of the
    mean over the hits, from their scatter enlarged by `small_sample_factor`, and not below that of the fits.
    A mode shows in half the hits, at least in two of several, and its peak is more than 0.6 of the rest of
    the response. A tone at a multiple of the mains that does not decay is hum. Other poles that show only in
    double hits, where there are single hits too, are of the second stroke.

    step : between two lines, Hz
    struck_twice : for each hit; empty where none was
    """
    groups = [{number: pole} for number, poles in enumerate(each) for pole in poles]
    groups.sort(key=lambda group: next(iter(group.values())).frequency)
    while True:
        gaps = [_apart(a, b) for a, b in pairwise(groups)]
        if not gaps or min(gaps) > _DRIFT:
            break
        at = int(np.argmin(gaps))
        groups[at : at + 2] = [groups[at] | groups[at + 1]]
    needed = 1 if len(each) == 1 else max(2, (len(each) + 1) // 2)
    once = {k for k in range(len(each)) if not (struck_twice and struck_twice[k])}
    found = (_classed(_mean(group, len(each)), needed, step) for group in groups)
    return tuple(
        replace(pole, taken=Taken.SECOND_HIT)
        if pole.taken in (Taken.WEAK, Taken.RARE) and once and not once & group.keys()
        else pole
        for pole, group in zip(found, groups, strict=True)
    )


def is_of_mains(frequency: float, step: float) -> bool:
    """Whether a frequency is a multiple of the mains frequency, within a line."""
    return any(abs(frequency - mains * np.rint(frequency / mains)) < step for mains in MAINS)


def _classed(pole: Pole, needed: int, step: float) -> Pole:
    """A pole with its kind."""
    if is_of_mains(pole.frequency, step) and pole.damping * 2.0 * np.pi * pole.frequency < _STEADY * step:
        return replace(pole, taken=Taken.HUM)
    if pole.hits < needed:
        return replace(pole, taken=Taken.RARE)
    return pole if pole.height > STANDS_OUT else replace(pole, taken=Taken.WEAK)


def _apart(a: dict[int, Pole], b: dict[int, Pole]) -> float:
    """The largest relative difference of two groups' frequencies, infinite where a hit has both."""
    if a.keys() & b.keys():
        return np.inf
    low = min(pole.frequency for pole in (*a.values(), *b.values()))
    high = max(pole.frequency for pole in (*a.values(), *b.values()))
    return high / low - 1.0


def _mean(group: dict[int, Pole], n_hits: int) -> Pole:
    poles = list(group.values())
    n = len(poles)
    each = tuple(group[k].frequency if k in group else np.nan for k in range(n_hits))
    if n == 1:
        return replace(poles[0], each=each)
    f, damping = (np.array([getattr(p, name) for p in poles]) for name in ("frequency", "damping"))
    of_fit, of_damping = (
        float(np.sqrt(np.mean([getattr(p, name) ** 2 for p in poles]) / n)) for name in ("sd", "damping_sd")
    )
    enlarged = small_sample_factor(n - 1) / np.sqrt(n)
    return Pole(
        float(f.mean()),
        max(float(np.std(f, ddof=1)) * enlarged, of_fit, LEAST_SD),
        float(damping.mean()),
        max(float(np.std(damping, ddof=1)) * enlarged, of_damping),
        float(np.median([p.height for p in poles])),
        float(np.median([p.peak for p in poles if np.isfinite(p.peak)] or [np.nan])),
        n,
        float(np.std(f, ddof=1)),
        each,
    )


DEFAULT_ORDER: Final = 50
"""Number of poles of the largest model of an octave."""
# A pole is stable where the order below has one this close, as fractions of frequency and damping.
_SAME_FREQUENCY, _SAME_DAMPING = 0.005, 0.3
# Poles of all orders are merged where they are closer than this many half widths of their peaks.
_APART: Final = 1.0
# Least fraction, and number, of the orders from the first that shows a pole in which it is stable.
_LEAST_STABLE, _LEAST_ORDERS = 0.3, 5
_MAX_DAMPING: Final = 0.1
# A model covers an octave extended by this factor, on this part of the unit circle; least lines per pole.
_BEYOND, _OF_CIRCLE, _LINES_A_POLE = 1.12, 0.8, 3
# Lines are weighted by one over the local median, over this fraction of the frequency and at least these
# lines; sizes are at least this fraction of the largest.
_ABOUT, _ABOUT_LINES, _LEAST_SIZE = 0.02, 5, 1e-4
# Responses below this are ignored: one over their square would overflow.
_NOTHING: Final = 1e-70


@dataclass(frozen=True, slots=True, eq=False)
class Stabilisation:
    """Poles by model order.

    orders : (n,) number of poles of each pole's model
    frequencies : (n,) Hz
    damping : (n,) ratios
    stable : (n,) whether the order below has the pole too
    candidates : (n_modes,) complex eigenvalues s of poles stable over many orders, rad/s, ascending
    """

    orders: Array
    frequencies: Array
    damping: Array
    stable: Array
    candidates: Array


def stabilise(responses: FrequencyResponses, low: float, high: float, order: int) -> Stabilisation:
    """Poles of least-squares complex frequency-domain models of 2 to ``order`` poles, an octave at a time.

    Guillaume, Verboven and Vanlanduit, ISMA 23, 1998, with complex coefficients: lines of an octave are
    angles on the unit circle, and conjugate poles lie outside. Lines are weighted by one over the local
    median size, so that weak modes count as much as strong ones; models with equal weights, which noise
    biases less, add their candidates. A pole is stable where the order below has one within 0.5 % of its
    frequency and 30 % of its damping. Stable poles closer than the half width of their peaks are merged.

    low, high : Hz, the range
    """
    of_octaves = [_of_octave(responses, a, b, order) for a, b in _octaves(low, high)]
    return Stabilisation(*(np.concatenate(arrays) for arrays in zip(*of_octaves, strict=True)))


def _octaves(low: float, high: float) -> list[tuple[float, float]]:
    n = max(int(np.ceil(np.log2(high / max(low, 1e-3 * high)) - 0.3)), 1)
    edges = [low, *(high / 2.0**k for k in range(n - 1, 0, -1)), high]
    return list(pairwise(edges))


def _of_octave(
    responses: FrequencyResponses, low: float, high: float, order: int
) -> tuple[Array, Array, Array, Array, Array]:
    """The fields of a `Stabilisation` of one band."""
    even, plain = (_stable(_poles(responses, low, high, order, evenly)) for evenly in (True, False))
    candidates = with_others(
        *(_candidates(s[kept], orders[kept], int(orders.max(initial=0))) for orders, s, kept in (even, plain))
    )
    orders, s, stable = even
    return orders, np.abs(s) / (2.0 * np.pi), -s.real / np.abs(s), stable, candidates


def _stable(found: list[tuple[int, Array]]) -> tuple[Array, Array, Array]:
    """Orders, poles, and whether the order below has the pole too, (n,) each."""
    orders, s = np.concatenate([np.full(len(p), n) for n, p in found]), np.concatenate([p for _, p in found])
    stable = np.zeros(len(s), dtype=bool)
    for n, _ in found[1:]:
        here, below = np.flatnonzero(orders == n), np.flatnonzero(orders == n - 1)
        if len(below) and len(here):
            near = np.abs(s[here, None].imag - s[below].imag) < _SAME_FREQUENCY * np.abs(s[here, None])
            change = np.abs(s[here, None].real - s[below].real)
            stable[here] = (near & (change < _SAME_DAMPING * -s[here, None].real)).any(axis=1)
    return orders, s, stable


def _poles(
    responses: FrequencyResponses, low: float, high: float, order: int, evenly: bool
) -> list[tuple[int, Array]]:
    """Each order with its decaying poles s from ``low`` to ``high``, (n,) rad/s; evenly : local weights."""
    f = responses.frequencies
    lines = np.flatnonzero((f >= low / _BEYOND) & (f <= high * _BEYOND))
    order = max(min(order, len(lines) // _LINES_A_POLE), 2)
    start, span = f[lines[0]], np.ptp(f[lines])
    delay = _OF_CIRCLE / span  # s: the angle of a line is 2 pi (f - start) delay
    powers = np.exp(-2j * np.pi * np.outer((f[lines] - start) * delay, np.arange(order + 1)))
    about = 2 * max(int(_ABOUT * 0.5 * (low + high) / responses.step), _ABOUT_LINES) + 1
    normal = np.zeros((order + 1, order + 1), dtype=complex)
    for frf in responses.frf[:, lines]:
        size = np.abs(frf)
        if size.max() < _NOTHING:
            continue
        near = median_filter(size, about, mode="nearest") if evenly else np.full_like(size, size.mean())
        weight = 1.0 / np.maximum(near, _LEAST_SIZE * size.max())
        numerator, denominator = powers * weight[:, None], powers * (-frf * weight)[:, None]
        cross = numerator.conj().T @ denominator
        own = np.linalg.lstsq(numerator.conj().T @ numerator, cross, rcond=None)[0]
        normal += denominator.conj().T @ denominator - cross.conj().T @ own
    found = []
    for n in range(2, order + 1):
        coefficients = np.linalg.lstsq(normal[:n, :n], -normal[:n, n], rcond=None)[0]
        roots = np.roots(np.append(1.0, coefficients[::-1]))
        roots = roots[np.abs(roots) > 0.0]
        turned = np.mod(-np.angle(roots), 2.0 * np.pi)
        s = (-np.log(np.abs(roots)) + 1j * turned) / delay + 2j * np.pi * start
        frequency = s.imag / (2.0 * np.pi)
        kept = (frequency >= low) & (frequency < high) & (s.real < 0.0) & (-s.real < _MAX_DAMPING * np.abs(s))
        found.append((n, s[kept][np.argsort(frequency[kept])]))
    return found


def _candidates(s: Array, orders: Array, order: int) -> Array:
    """Median poles of groups that are stable over many orders, ascending.

    order : of the largest model, lower than requested in an octave of few lines
    """
    order_of = np.argsort(s.imag, kind="stable")
    left = [int(i) for i in order_of]
    poles = []
    while left:
        # the pole with most others near it, counting each order once, is the middle of a group
        about = [_about(s, left, i) for i in left]
        counts = [len(set(orders[near].tolist())) for near in about]
        best = int(np.argmax(counts))
        near = about[best]
        enough = max(_LEAST_ORDERS, _LEAST_STABLE * (order - orders[near].min() + 1))
        if counts[best] >= enough:
            poles.append(complex(np.median(s[near].real), np.median(s[near].imag)))
        gone = set(near.tolist()) if counts[best] >= enough else {left[best]}
        left = [i for i in left if i not in gone]
        if counts[best] < _LEAST_ORDERS:
            break
    return np.array(sorted(poles, key=lambda one: one.imag), dtype=complex)


def _about(s: Array, left: list[int], i: int) -> Array:
    others = np.array(left)
    return np.asarray(others[np.abs(s[others] - s[i]) < _APART * -s[i].real])
