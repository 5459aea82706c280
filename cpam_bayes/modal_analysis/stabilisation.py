"""Poles of frequency responses over many model orders, by sdypy-EMA, and those that stay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.modal_analysis.records import FrequencyResponses, ModalTestError

__all__ = ["DEFAULT_ORDER", "Stabilisation", "stabilise"]

Array = NDArray[Any]

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
