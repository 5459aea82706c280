"""The constants averaged over all hypotheses: what is known of them whatever is wrong with the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.evidence.weighing import Weighed

Array = NDArray[Any]

# Hypotheses with less probability are dropped.
_NEGLIGIBLE = 1e-6
_QUANTILES = np.array([0.025, 0.975])


def averaged_constants(weighed: Weighed) -> Mapping[str, tuple[float, float, float, float]]:
    """The parameters of the plain model over all hypotheses: name -> mean, sd, 2.5 and 97.5 % quantile, SI.

    The density is sum_h P(h | data) p(x | h, data), Bayesian model averaging (Hoeting et al., Stat. Sci. 14,
    1999), by the draws of every hypothesis with their weights.
    """
    names, draws, weight = averaged_draws(weighed)
    mean = weight @ draws
    sd = np.sqrt(weight @ (draws - mean) ** 2)
    quantiles = [weighted_quantiles(draws[:, i], weight, _QUANTILES) for i in range(len(names))]
    return {
        name: (float(mean[i]), float(sd[i]), float(quantiles[i][0]), float(quantiles[i][1]))
        for i, name in enumerate(names)
    }


def averaged_draws(weighed: Weighed) -> tuple[tuple[str, ...], Array, Array]:
    """Names, draws (d, n) and weights (d,) of the parameters of the plain model over all hypotheses."""
    names = weighed.none.marginal.comparison.model.parameters.names
    kept = [
        t
        for t in weighed.tested
        if t.probability >= _NEGLIGIBLE and set(names) <= set(t.marginal.comparison.parameters.names)
    ]
    columns = [[t.marginal.comparison.parameters.names.index(n) for n in names] for t in kept]
    draws = np.concatenate([t.marginal.draws[:, at] for t, at in zip(kept, columns, strict=True)])
    weight = np.concatenate([t.probability * np.exp(t.marginal.log_weight) for t in kept])
    return names, draws, weight / weight.sum()


def weighted_quantiles(x: Array, weight: Array, p: Array) -> Array:
    """Quantiles p of draws (d,) with weights (d,), linear between the draws."""
    order = np.argsort(x, kind="stable")
    cumulative = np.cumsum(weight[order]) - 0.5 * weight[order]
    return np.interp(p, cumulative / weight.sum(), x[order])
