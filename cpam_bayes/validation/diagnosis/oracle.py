"""The best that could be said of a list by somebody who knows the truth's own model."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.evidence.comparison import Listed
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis
from cpam_bayes.diagnosis.signatures import ABSORBED, ALIKE, nearest_of
from cpam_bayes.validation.diagnosis.truths import Linear, at_random_place, sizes_of

Array = NDArray[Any]

# Scores of an effect's size that its shifts are computed at, and points between them.
_SCORES = np.linspace(-3.6, 3.6, 41)
# Places that stand for all of them.
_PLACES = 48
_FINE = np.linspace(-3.6, 3.6, 401)


@dataclass(frozen=True, slots=True)
class Oracle:
    """What somebody makes of a list who knows the truth's own model, linear in the constants.

    probability : by cause, with the priors of the diagnosis.
    alike : causes whose visible signature, at the size that fits best, has a cosine above 0.95 with the
    truth's; the cosine by cause in ``cosine``.
    """

    probability: Mapping[str, float]
    cosine: Mapping[str, float]

    @property
    def alike(self) -> frozenset[str]:
        """Causes that frequencies cannot tell from the truth."""
        return frozenset(c for c, value in self.cosine.items() if value > ALIKE)


def oracle(at: Linear, truth: Array, noise: Array) -> Oracle:
    """Exact marginal likelihoods of the linear plate, by quadrature over each cause's size.

    truth : (n_listed,) shift of the listed log frequencies in units of s, that of the dictionary's own
    model.
    noise : (n_listed,) in the same units. Causes that reorder the list are left out: they are tens of per
    cent away.
    """
    a = at.slope[at.own.case.modes]
    residual = truth + noise + a @ at.z
    visible, target = at.root @ truth, at.root @ residual
    weight = np.exp(-0.5 * _FINE**2)
    log_weight = np.log(weight / weight.sum())
    log_p: dict[str, list[float]] = defaultdict(list)
    cosines: dict[str, float] = {}
    for h in at.own.singles:
        prior = float(np.log(h.prior))
        if h.cause == NONE:
            log_p[NONE].append(prior - 0.5 * float(target @ target))
        elif h.cause == OTHER:
            log_p[OTHER].append(prior + _scattered(at, h, residual, a, log_weight))
        elif h.parameters:
            placed = _placed(h)
            for one in placed:
                shifts = at.shift(one, sizes_of(one, _SCORES))
                fine = np.stack([np.interp(_FINE, _SCORES, column) for column in shifts.T], axis=1)
                seen = fine @ at.root
                log_likelihood = -0.5 * np.sum((target - seen) ** 2, axis=1) + log_weight
                log_p[h.cause].append(prior - np.log(len(placed)) + float(logsumexp(log_likelihood)))
                cosines[h.cause] = max(cosines.get(h.cause, 0.0), _best_cosine(visible, seen, fine))
    total = {cause: float(logsumexp(values)) for cause, values in log_p.items()}
    whole = float(logsumexp(list(total.values())))
    ranked = sorted(total, key=lambda c: -total[c])
    return Oracle({c: float(np.exp(total[c] - whole)) for c in ranked}, cosines)


def _placed(h: Hypothesis) -> list[Hypothesis]:
    """A cause that may be anywhere at places that stand for its prior; another one alone."""
    if not h.coordinates:
        return [h]
    rng = np.random.default_rng(0)
    return [at_random_place(h, rng) for _ in range(_PLACES)]


def _best_cosine(truth: Array, seen: Array, whole: Array) -> float:
    """Cosine at the size whose visible signature is nearest to the truth's; 0 where it is absorbed."""
    if not truth.any():
        return 0.0
    i = nearest_of(seen, truth)
    size, full = float(np.linalg.norm(seen[i])), float(np.linalg.norm(whole[i]))
    if size == 0.0 or size < ABSORBED * full:
        return 0.0
    return abs(float(truth @ seen[i])) / size / float(np.linalg.norm(truth))


def _scattered(at: Linear, h: Hypothesis, residual: Array, a: Array, log_weight: Array) -> float:
    """Log marginal likelihood of a scatter of all modes, over that of none with zero residuals."""
    ratio = (sizes_of(h, _FINE) / at.own.noise) ** 2
    listed = Listed(np.exp(at.log_f[at.own.case.modes]), residual, residual)
    plain = np.eye(len(residual)) + a @ a.T
    covariance = plain + ratio[:, None, None] * listed.correlation(h.correlation_length)
    quadratic = np.linalg.solve(covariance, residual[:, None])[..., 0] @ residual
    log_determinant = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(plain)[1]
    return float(logsumexp(log_weight - 0.5 * (quadratic + log_determinant)))
