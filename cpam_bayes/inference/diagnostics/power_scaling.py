"""How a posterior moves when its prior or its likelihood is made stronger, or a bound is moved."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.parameters import ParameterSet, Uniform

Array = NDArray[Any]
Diagnosis = Literal[
    "prior and data disagree",
    "prior is strong, likelihood weak",
    "likelihood is weak",
    "likelihood and noise prior have a say",
    "likelihood has a say",
]

# Sensitivity from which a posterior counts as sensitive (Kallioinen et al., 2023).
THRESHOLD = 0.05
# Fraction of the search interval by which a bound is moved inwards.
MOVED = 0.1
# Fewer effective draws than this left inside say nothing about a mean.
_FEWEST = 100


@dataclass(frozen=True, slots=True)
class PowerScaling:
    """Sensitivity of one parameter's posterior to the powers of priors and likelihood.

    prior : of all but the noise.
    noise_prior : of the noise, 0 where its amplitude is given.
    """

    name: str
    prior: float
    noise_prior: float
    likelihood: float

    @property
    def diagnosis(self) -> Diagnosis:
        """What they say together, by the published threshold of 0.05."""
        if self.likelihood < THRESHOLD:
            return "prior is strong, likelihood weak" if self.prior >= THRESHOLD else "likelihood is weak"
        if self.prior >= THRESHOLD:
            return "prior and data disagree"
        if self.noise_prior >= THRESHOLD:
            return "likelihood and noise prior have a say"
        return "likelihood has a say"


@dataclass(frozen=True, slots=True)
class MovedBound:
    """What moving one bound of a uniform prior inwards by a tenth of its interval does.

    cut : fraction of the draws that lies beyond.
    shift : (n,) of every parameter's mean, in its posterior standard deviation, ``nan`` where too few draws
    are left.
    """

    name: str
    bound: Literal["lower", "upper"]
    cut: float
    shift: Array


def power_scaling(
    names: tuple[str, ...], draws: Array, log_prior: Array, log_noise_prior: Array, log_likelihood: Array
) -> tuple[PowerScaling, ...]:
    """Power-scaling sensitivity of every parameter (Kallioinen et al., 2023), by ``arviz.psens``.

    The distance between the posterior p(theta) p(y | theta) and the one in which a factor has the power
    a, per log2 a at a = 1, as cumulative Jensen-Shannon distance. The noise's prior is scaled apart
    from the others: it pulls at every constant without being a statement about any. A uniform prior
    is the same to every power and has the sensitivity 0: what it does it does by its bounds, which
    ``moved_bounds`` moves.

    draws (m, n) independent of each other; log_prior of all but the noise, log_noise_prior,
    log_likelihood (m,).
    """
    import arviz

    psens: Callable[..., Any] = arviz.psens
    components = {"prior": log_prior, "noise": log_noise_prior, "likelihood": log_likelihood}
    scaled = {}
    with warnings.catch_warnings():
        # arviz announces its next version, and warns of tails that are too short to smooth
        warnings.simplefilter("ignore")
        posterior = {name: draws[None, :, i] for i, name in enumerate(names)}
        for component, values in components.items():
            if np.ptp(values) == 0.0:
                scaled[component] = dict.fromkeys(names, 0.0)
                continue
            data = arviz.from_dict(posterior=posterior)
            group = "log_likelihood" if component == "likelihood" else "log_prior"
            data.add_groups({group: {"all": values[None]}})
            sensitivity = psens(data, component=group.removeprefix("log_"))
            scaled[component] = {name: float(sensitivity[name]) for name in names}
    return tuple(
        PowerScaling(name, scaled["prior"][name], scaled["noise"][name], scaled["likelihood"][name])
        for name in names
    )


def moved_bounds(parameters: ParameterSet, draws: Array) -> tuple[MovedBound, ...]:
    """What each bound of the uniform priors does to the means, by leaving out the draws beyond.

    draws : (m, n).
    """
    mean, sd = draws.mean(axis=0), draws.std(axis=0)
    bounds = []
    for k, parameter in enumerate(parameters.parameters):
        prior = parameter.prior
        if not isinstance(prior, Uniform):
            continue
        step = MOVED * (prior.upper - prior.lower)
        inside: dict[Literal["lower", "upper"], Array] = {
            "lower": draws[:, k] >= prior.lower + step,
            "upper": draws[:, k] <= prior.upper - step,
        }
        for bound, kept in inside.items():
            enough = kept.sum() >= _FEWEST
            shift = (draws[kept].mean(axis=0) - mean) / sd if enough else np.full(len(mean), np.nan)
            bounds.append(MovedBound(parameter.name, bound, float(np.mean(~kept)), shift))
    return tuple(bounds)
