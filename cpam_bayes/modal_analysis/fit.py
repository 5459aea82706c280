"""Poles of frequency responses, with standard deviations.

Poles over many model orders, by sdypy-EMA; those that stay are candidates, and each is fitted by least
squares in a band about it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import f as f_distribution

from cpam_bayes.modal_analysis.read import FrequencyResponses, ModalTestError
from cpam_bayes.plate.hits import small_sample_factor

__all__ = ["DEFAULT_ORDER", "Pole", "Stabilisation", "fit_poles", "stabilise"]

Array = NDArray[Any]

# Half width of the band about a pole: half widths of its peak, and lines at least.
_WIDTHS, _LINES = 6.0, 14
# Poles beyond the band by this factor are free as well, and by the second one fixed in place.
_FREE, _FIXED = 1.3, 5.0
# Degree of the polynomial of frequency that stands for all modes further away.
_RESIDUAL_DEGREE: Final = 2
# Probability by noise alone of what a pole explains, above which it is no mode.
_SIGNIFICANT: Final = 1e-6
# A fit that moves a pole further than this, in half widths of its peak, has found another.
_FAR: Final = 2.0
# A second pole is looked for where residuals go together this much more from line to line than noise.
_STRUCTURED: Final = 0.25
_PASSES, _STEPS, _ROUNDS = 2, 50, 2
# Residuals that go together more than this are no noise about a good fit.
_MAX_CORRELATION: Final = 0.9
_LEAST_FREEDOM: Final = 10
# Poles this close, in half widths, are one.
_MERGED: Final = 0.1


@dataclass(frozen=True, slots=True)
class Pole:
    """One mode.

    frequency, sd : Hz, undamped natural frequency |s| / 2 pi
    damping, damping_sd : ratio -Re s / |s|
    """

    frequency: float
    sd: float
    damping: float
    damping_sd: float


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """Responses in a band.

    omega : (n,) rad/s
    data : (n_responses, 2 n) real parts, then imaginary parts
    fixed : (n_fixed,) poles that stay where they are, rad/s
    """

    omega: Array
    data: Array
    fixed: Array

    def residual(self, poles: Array) -> Array:
        """What is left of the responses beside poles (n_poles,) with their best residues, as ``data``."""
        i_omega, poles = 1j * self.omega[:, None], np.concatenate((poles, self.fixed))
        direct, mirrored = 1.0 / (i_omega - poles), 1.0 / (i_omega - poles.conj())
        x = (self.omega - self.omega.mean()) / np.ptp(self.omega)
        powers = np.vander(x, _RESIDUAL_DEGREE + 1)
        columns = np.hstack((direct + mirrored, 1j * (direct - mirrored), powers, 1j * powers))
        design = np.vstack((columns.real, columns.imag))
        q, _ = np.linalg.qr(design / np.linalg.norm(design, axis=0))
        return np.asarray(self.data - (self.data @ q) @ q.T)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Least squares in a band.

    poles : (n,) free ones
    covariance : (2 n, 2 n) of their real and imaginary parts in turn, by the variance of the residuals
    left : (n_responses, 2 n_lines) residuals over their standard deviations
    weight : (n_responses,)
    freedom : degrees of freedom of the residuals
    """

    poles: Array
    covariance: Array
    left: Array
    weight: Array
    freedom: int


def _solved(band: _Band, poles: Array) -> _Fit | None:
    """The best poles from a start (n,), None where there are too few lines."""
    linear = 2 * (len(poles) + len(band.fixed) + _RESIDUAL_DEGREE + 1)
    freedom = band.data.size - len(band.data) * linear - 2 * len(poles)
    if freedom < _LEAST_FREEDOM:
        return None
    scale = np.repeat(-poles.real, 2)

    def poles_of(p: Array) -> Array:
        real, imaginary = (p * scale).reshape(-1, 2).T
        return np.asarray(real + 1j * imaginary)

    p = np.column_stack((poles.real, poles.imag)).ravel() / scale
    used = weight = 1.0 / np.sqrt(np.maximum(np.mean(band.data**2, axis=1), np.finfo(float).tiny))
    for _ in range(_PASSES):  # even weights first, then those of the residuals

        def weighted(p: Array, weight: Array = weight) -> Array:
            return np.asarray((weight[:, None] * band.residual(poles_of(p))).ravel())

        solved = least_squares(weighted, p, max_nfev=_STEPS)
        p, left = solved.x, solved.fun.reshape(band.data.shape)
        variance = np.sum((left / weight[:, None]) ** 2, axis=1) * len(left) / freedom
        used, weight = weight, 1.0 / np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    jacobian = np.asarray(solved.jac)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * np.sum(left**2) / freedom
    return _Fit(poles_of(p), covariance * np.outer(scale, scale), left, used, freedom)


def _band_about(responses: FrequencyResponses, candidates: Array, target: int) -> tuple[_Band, Array]:
    """The band of a candidate, and which candidates are free in it, (n,) bool."""
    s = candidates[target]
    reach = max(_WIDTHS * -s.real / (2.0 * np.pi), _LINES * responses.step)
    lines = np.abs(responses.frequencies - s.imag / (2.0 * np.pi)) <= reach
    away = np.abs(candidates.imag - s.imag) / (2.0 * np.pi)
    frf = responses.frf[:, lines]
    fixed = candidates[(away > _FREE * reach) & (away <= _FIXED * reach)]
    omega = 2.0 * np.pi * responses.frequencies[lines]
    return _Band(omega, np.hstack((frf.real, frf.imag)), fixed), away <= _FREE * reach


def _explains(band: _Band, fit: _Fit, at: int) -> bool:
    """Whether noise alone does not explain what a pole explains, by an F test of independent lines."""
    without, rest = band.residual(np.delete(fit.poles, at)), float(np.sum(fit.left**2))
    added = 2 + 2 * len(fit.left)
    ratio = (float(np.sum((fit.weight[:, None] * without) ** 2)) - rest) / added / (rest / fit.freedom)
    wider = _widening(fit.left)
    return bool(f_distribution.sf(ratio / wider, added, fit.freedom / wider) < _SIGNIFICANT)


def _is_at(found: complex, start: complex) -> bool:
    return found.real < 0.0 and abs(found - start) < _FAR * -start.real


def _refined(responses: FrequencyResponses, candidates: Array) -> Array:
    """Candidates moved to their fits, with a second pole beside those that one pole does not describe."""
    poles: list[complex] = []
    for i, s in enumerate(candidates):
        band, free = _band_about(responses, candidates, i)
        fit = _solved(band, candidates[free])
        if fit is None:
            continue
        at = int(np.sum(free[:i]))
        kept = [complex(fit.poles[at])] if _is_at(fit.poles[at], s) else [complex(s)]
        if _lag_one(fit.left) > responses.correlation + _STRUCTURED * (1.0 - responses.correlation):
            kept = _split(band, fit, at) or kept
        poles += [one for one in kept if all(abs(one - p) > _MERGED * -one.real for p in poles)]
    return np.array(sorted(poles, key=lambda one: one.imag), dtype=complex)


def _split(band: _Band, fit: _Fit, at: int) -> list[complex]:
    """The two poles that describe a band where one does not, none where two do no better."""
    s, best = fit.poles[at], None
    for side in (-1.0, 1.0):
        both = _solved(band, np.append(fit.poles, s + 1j * side * -s.real))
        if both is not None and (best is None or np.sum(both.left**2) < np.sum(best.left**2)):
            best = both
    if best is None or not (_explains(band, best, at) and _explains(band, best, len(best.poles) - 1)):
        return []
    pair = [complex(best.poles[at]), complex(best.poles[-1])]
    return pair if all(_FAR * s.real < one.real < 0.2 * s.real for one in pair) else []


def fit_poles(responses: FrequencyResponses, candidates: Array) -> tuple[Pole, ...]:
    """Every candidate (n,) fitted with those near it, without those that explain no more than noise.

    H_k(i w) = sum_r [A_kr / (i w - s_r) + conj(A_kr) / (i w - conj(s_r))] + c_k0 + c_k1 w + c_k2 w^2 in a
    band of six half widths of the peak, at least 14 lines, to either side. Residues and polynomials are
    linear and eliminated (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973); least squares move the poles
    near the band, further ones stay. The covariance is that of the residuals' variance, each response's
    own, and wider by their correlation from line to line where there is one and as `small_sample_factor`
    says. Where that is large, two
    poles are tried for one.
    """
    for _ in range(_ROUNDS):
        candidates = _refined(responses, candidates)
    poles = []
    for i, s in enumerate(candidates):
        band, free = _band_about(responses, candidates, i)
        fit, at = _solved(band, candidates[free]), int(np.sum(free[:i]))
        if fit is None or not _is_at(fit.poles[at], s) or not _explains(band, fit, at):
            continue
        own = slice(2 * at, 2 * at + 2)
        wider = _widening(fit.left)
        covariance = fit.covariance[own, own] * wider * small_sample_factor(fit.freedom / wider) ** 2
        pole = _described(complex(fit.poles[at]), covariance, responses.added_decay)
        poles += [] if pole is None else [pole]
    return tuple(sorted(poles, key=lambda pole: pole.frequency))


def _lag_one(left: Array) -> float:
    """How much residuals go together from line to line, their correlation if it is above 0."""
    parts = left.reshape(2 * len(left), -1)
    r = float(np.sum(parts[:, 1:] * parts[:, :-1]) / np.sum(parts**2))
    return float(np.clip(r, 0.0, _MAX_CORRELATION))


def _widening(left: Array) -> float:
    """By what variances grow where noise goes together from line to line as r^k, (1 + r) / (1 - r)."""
    r = _lag_one(left)
    return (1.0 + r) / (1.0 - r)


def _described(s: complex, covariance: Array, added_decay: float) -> Pole | None:
    """Frequency and damping of a pole less the decay that a window adds, None without any damping left."""
    s += added_decay
    size = abs(s)
    if not s.real < 0.0:
        return None
    of_frequency = np.array([s.real, s.imag]) / size / (2.0 * np.pi)
    of_damping = np.array([-(s.imag**2), s.real * s.imag]) / size**3
    sd, damping_sd = (float(np.sqrt(g @ covariance @ g)) for g in (of_frequency, of_damping))
    return Pole(size / (2.0 * np.pi), sd, -s.real / size, damping_sd)


DEFAULT_ORDER: Final = 60
"""Number of poles of the largest model."""
_MISSING: Final = 'poles need the library sdypy-EMA, accepted: pip install "cpam-bayes[ema]"'
# A pole stays where the order below has one this close: a fraction of the frequency, and of the damping.
_SAME_FREQUENCY, _SAME_DAMPING = 0.005, 0.3
# Poles of all orders are one where they are closer than this many half widths of their peaks.
_APART: Final = 1.0
# Fraction of the orders above the one that first shows a pole in which it has to stay.
_LEAST_STABLE, _LEAST_ORDERS = 0.3, 5
_MAX_DAMPING: Final = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Stabilisation:
    """Poles by model order.

    orders : (n,) number of poles of the model that each pole is of
    frequencies : (n,) Hz
    damping : (n,) ratios
    stable : (n,) whether the order below has the pole too
    candidates : (n_modes,) complex eigenvalues s of poles that stay over many orders, rad/s, ascending
    """

    orders: Array
    frequencies: Array
    damping: Array
    stable: Array
    candidates: Array


def stabilise(responses: FrequencyResponses, low: float, high: float, order: int) -> Stabilisation:
    """Poles of the least-squares complex frequency-domain estimator for 1 to ``order`` poles.

    Guillaume, Verboven and Vanlanduit, ISMA 23, 1998, as sdypy-EMA has it. A pole is stable where the order
    below has one within 0.5 % of its frequency and 30 % of its damping. Stable poles of all orders that are
    closer than the half width of their peaks are one.

    low, high : Hz, the range
    order : number of poles of the largest model

    Raises ``ModalTestError`` where sdypy-EMA is missing, or where nothing determines poles.
    """
    found = _poles(responses, low, high, order)
    orders, s = np.concatenate([np.full(len(p), n) for n, p in found]), np.concatenate([p for _, p in found])
    frequency, damping = np.abs(s) / (2.0 * np.pi), -s.real / np.abs(s)
    stable = np.zeros(len(s), dtype=bool)
    for n, _ in found[1:]:
        here, below = np.flatnonzero(orders == n), np.flatnonzero(orders == n - 1)
        if len(below):
            near = np.abs(frequency[here, None] / frequency[below] - 1.0) < _SAME_FREQUENCY
            near &= np.abs(damping[here, None] - damping[below]) < _SAME_DAMPING * damping[here, None]
            stable[here] = near.any(axis=1)
    return Stabilisation(orders, frequency, damping, stable, _candidates(s[stable], orders[stable], order))


def _poles(responses: FrequencyResponses, low: float, high: float, order: int) -> list[tuple[int, Array]]:
    """Order and its stable poles s with positive frequency within the range, (n,) complex rad/s."""
    try:
        from sdypy import EMA
    except ImportError:
        raise ModalTestError(_MISSING) from None
    model = EMA.Model(responses.frf, responses.frequencies, lower=low, upper=high, pol_order_high=order)
    with np.errstate(all="ignore"):
        try:
            model.get_poles(method="lscf", show_progress=False)
        except np.linalg.LinAlgError:
            raise ModalTestError(
                f"the responses from {low:g} to {high:g} Hz do not determine models of {order} poles, "
                "accepted: measured responses, which have noise, and which are not zero there"
            ) from None
    found = []
    for n, poles in enumerate(model.all_poles, start=1):
        s = np.asarray(poles)
        s = s[np.isfinite(s) & (s.imag > 0.0) & (s.real < 0.0)]
        frequency = np.abs(s) / (2.0 * np.pi)
        kept = (frequency >= low) & (frequency <= high) & (-s.real / np.abs(s) < _MAX_DAMPING)
        found.append((n, s[kept][np.argsort(frequency[kept])]))
    return found


def _candidates(s: Array, orders: Array, order: int) -> Array:
    """Median poles of groups that stay over many orders, ascending."""
    order_of = np.argsort(s.imag, kind="stable")
    left = [int(i) for i in order_of]
    poles = []
    while left:
        # the pole with most others about it, each order once, is the middle of a group
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
