"""What a model, or a mixture of models, makes of the lists once it is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import chi2

from cpam_bayes.diagnosis.answers.predictive import PredictiveChecks
from cpam_bayes.diagnosis.evidence.comparison import kept_of
from cpam_bayes.diagnosis.evidence.tested import Tested, prior_of

Array = NDArray[Any]

# Draws that fits are summarised from.
_DRAWS = 1024


@dataclass(frozen=True, slots=True)
class Fit:
    """What a model makes of the lists.

    constants : name -> mean, sd, 2.5 % and 97.5 % quantile, SI.
    predicted, predicted_sd, sigma : of all frequencies, plate by plate.
    rms : relative.
    p_value : posterior predictive, of the sum of squared standardised residuals.
    predictive_p : the same against the stated repeatability, or the prior of one that is inferred.
    log_evidence : prior-weighted over the members.
    log_evidence_error, k_hat : largest of the members that were sampled, ``nan`` where none was.
    draws : (d, n_constants) behind it, equally probable.
    """

    constants: Mapping[str, tuple[float, float, float, float]]
    measured: Array
    predicted: Array
    predicted_sd: Array
    sigma: Array
    rms: float
    p_value: float
    predictive_p: float
    log_evidence: float
    log_evidence_error: float
    k_hat: float
    draws: Array

    @property
    def standardised(self) -> Array:
        """Residuals over the standard deviations of noise and prediction together."""
        return np.asarray((self.measured - self.predicted) / np.hypot(self.sigma, self.predicted_sd))


def fit_of(members: Sequence[tuple[Tested, float]], whole: Array, checks: PredictiveChecks) -> Fit:
    """The fit of a mixture of hypotheses with the same constants; whole : all listed frequencies."""
    first = members[0][0].marginal.comparison
    sampled = [t for t, _ in members if np.isfinite(t.marginal.error)]
    model_names = first.model.parameters.names
    shared = [n for n in model_names if all(n in t.marginal.comparison.parameters.names for t, _ in members)]
    kept_names = [n for n in shared if n not in {p.name for t, _ in members for p in t.hypothesis.parameters}]
    draws, predicted, variance, tail = [], [], [], []
    for t, fraction in members:
        marginal, comparison = t.marginal, t.marginal.comparison
        x = marginal.resampled(max(round(fraction * _DRAWS), 2))
        f, _ = comparison.predict(x)
        v = comparison.variance(x)
        freedom = f.shape[1]
        if freedom < len(whole):  # a false peak is predicted as measured
            kept = kept_of(whole, comparison.listed.frequencies)
            f_all, v_all = np.tile(whole, (len(x), 1)), np.full((len(x), len(whole)), np.median(v))
            f_all[:, kept], v_all[:, kept] = f, v
            f, v = f_all, v_all
        names = comparison.parameters.names
        draws.append(x[:, [names.index(n) for n in kept_names]])
        predicted.append(f)
        variance.append(v)
        tail.append(chi2.sf(np.sum((whole - f) ** 2 / v, axis=1), freedom))
    x, f, v = np.concatenate(draws), np.concatenate(predicted), np.concatenate(variance)
    whole_prior = prior_of([t for t, _ in members])
    low, high = np.quantile(x, (0.025, 0.975), axis=0)
    mean = f.mean(axis=0)
    return Fit(
        constants={
            n: (float(x[:, i].mean()), float(x[:, i].std()), float(low[i]), float(high[i]))
            for i, n in enumerate(kept_names)
        },
        measured=whole,
        predicted=mean,
        predicted_sd=f.std(axis=0),
        sigma=np.sqrt(v.mean(axis=0)),
        rms=float(np.sqrt(np.mean((mean / whole - 1.0) ** 2))),
        p_value=float(np.mean(np.concatenate(tail))),
        predictive_p=sum(fraction * checks.p_value(t) for t, fraction in members),
        log_evidence=float(
            logsumexp(
                [t.marginal.log_evidence for t, _ in members],
                b=[t.hypothesis.prior / whole_prior for t, _ in members],
            )
        ),
        log_evidence_error=max((t.marginal.error for t in sampled), default=np.nan),
        k_hat=max((t.marginal.k_hat for t in sampled), default=np.nan),
        draws=x,
    )
