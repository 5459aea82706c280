"""Assessment of a sampled posterior: what determines it, what moves it, and whether it fits its data."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cpam_bayes.answer import Notice
from cpam_bayes.inference.completeness import Profile, profile_likelihoods
from cpam_bayes.inference.ensemble import EnsembleResult
from cpam_bayes.inference.pairing import Pairing
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Constraint, Hybrid, Material


@dataclass(frozen=True, slots=True)
class Combination:
    """A product of powers of the plate's parameters that the frequencies determine as one number.

    exponents : (n_plate,) the largest in size is 1.
    singular_value : of the weighted Jacobian, the prior's sd over the noise's along the combination.
    noise_sd, prior_sd : standard deviations of the product's logarithm, by the frequencies alone (infinite
    where they carry no information) and by the prior.
    """

    exponents: Array
    singular_value: float
    noise_sd: float
    prior_sd: float

    @property
    def contraction(self) -> float:
        """1 - (posterior sd / prior sd)^2 of a Gaussian prior, between 0 and 1."""
        squared = self.singular_value**2
        return squared / (1.0 + squared)


def weighted_jacobian(posterior: Posterior, x: Array, pairing: Pairing) -> Array:
    """W^(1/2) S^-1 J diag(prior sd) at x (n,): whitened by the noise, scaled by the priors.

    S are the noise's standard deviations of the paired frequencies, W the information of a
    standardised residual, 1 for Gaussian noise and (nu + 1) / (nu + 3) for Student-t noise (Lange,
    Little and Taylor, 1989). (n_pairs, n_plate).
    """
    n = posterior.model.parameters.size
    prediction = posterior.model.predict(x[None, :n], jacobian=True)
    assert prediction.jacobian is not None
    rows, columns = paired(pairing)
    sigma = posterior.noise(x[None], prediction.frequencies)[0, rows, columns]
    weight = np.sqrt(posterior.noise_model.information)
    return np.asarray(
        weight * prediction.jacobian[0, columns] / sigma[:, None] * posterior.parameters.prior_sd[:n]
    )


def paired(pairing: Pairing) -> tuple[Array, Array]:
    """Indices of the frequencies with a mode and of their modes, (n_pairs,) each."""
    rows = np.flatnonzero(pairing.mode >= 0)
    return rows, pairing.mode[rows]


def combinations(posterior: Posterior, x: Array, pairing: Pairing) -> tuple[Combination, ...]:
    """Combinations of the plate's parameters from the best to the worst determined.

    With the singular value decomposition A = U D V^T of the weighted Jacobian at x, the frequencies
    measure v^T (p - x) / prior sd with sd 1 / d. Since dp = x dln p, that is the logarithm of a product
    of powers v_k x_k / sd_k.
    """
    n = posterior.model.parameters.size
    jacobian = weighted_jacobian(posterior, x, pairing)
    _, singular_values, directions = np.linalg.svd(jacobian, full_matrices=True)
    singular = np.zeros(n)
    singular[: len(singular_values)] = singular_values[:n]
    relative = x[:n] / posterior.parameters.prior_sd[:n]
    return tuple(_combination(v * relative, float(d)) for v, d in zip(directions, singular, strict=True))


def _combination(powers: Array, singular_value: float) -> Combination:
    largest = powers[np.argmax(np.abs(powers))]
    scale = float(1.0 / abs(largest))
    # singular values below the Jacobian's rounding carry no information
    noise_sd = scale / singular_value if singular_value > 1e-12 else np.inf
    return Combination(powers / largest, singular_value, noise_sd, scale)


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
# Fewest draws left inside that determine a mean.
_FEWEST = 100


@dataclass(frozen=True, slots=True)
class PowerScaling:
    """Sensitivity of one parameter's posterior to the powers of priors and likelihood.

    prior : to the priors of all parameters but the noise.
    noise_prior : to the prior of the noise, 0 where its amplitude is given.
    """

    name: str
    prior: float
    noise_prior: float
    likelihood: float

    @property
    def diagnosis(self) -> Diagnosis:
        """Verdict on prior and likelihood, by the published threshold of 0.05."""
        if self.likelihood < THRESHOLD:
            return "prior is strong, likelihood weak" if self.prior >= THRESHOLD else "likelihood is weak"
        if self.prior >= THRESHOLD:
            return "prior and data disagree"
        if self.noise_prior >= THRESHOLD:
            return "likelihood and noise prior have a say"
        return "likelihood has a say"


@dataclass(frozen=True, slots=True)
class MovedBound:
    """Effect of moving one bound of a uniform prior inwards by a tenth of its interval.

    cut : fraction of the draws beyond the moved bound.
    shift : (n,) of every parameter's mean, in posterior standard deviations, ``nan`` where too few draws are
    left.
    """

    name: str
    bound: Literal["lower", "upper"]
    cut: float
    shift: Array


def power_scaling(
    names: tuple[str, ...], draws: Array, log_prior: Array, log_noise_prior: Array, log_likelihood: Array
) -> tuple[PowerScaling, ...]:
    """Power-scaling sensitivity of every parameter (Kallioinen et al., 2023), by ``arviz_stats.psense``.

    The cumulative Jensen-Shannon distance between the posterior p(theta) p(y | theta) and the one in which a
    factor has the power a, per log2 a at a = 1. The noise's prior is scaled separately from the others. A
    uniform prior has the sensitivity 0: ``moved_bounds`` moves its bounds.

    draws (m, n) independent of each other; log_prior of all but the noise, log_noise_prior,
    log_likelihood (m,).
    """
    import arviz_base  # heavy
    import arviz_stats

    priors, likelihood = {"prior": log_prior, "noise": log_noise_prior}, {"likelihood": log_likelihood}
    data = arviz_base.from_dict(
        {
            "posterior": {name: draws[None, :, i] for i, name in enumerate(names)},
            "log_prior": {component: values[None] for component, values in priors.items()},
            "log_likelihood": {component: values[None] for component, values in likelihood.items()},
        }
    )
    scaled = {}
    for component, values in {**priors, **likelihood}.items():
        if np.ptp(values) == 0.0:
            scaled[component] = dict.fromkeys(names, 0.0)
            continue
        group = "likelihood" if component in likelihood else "prior"
        with warnings.catch_warnings():  # tails that are too short to smooth
            warnings.simplefilter("ignore")
            sensitivity = arviz_stats.psense(data, group=group, group_var_names=[component])
        scaled[component] = {name: float(sensitivity[name]) for name in names}
    return tuple(
        PowerScaling(name, scaled["prior"][name], scaled["noise"][name], scaled["likelihood"][name])
        for name in names
    )


def moved_bounds(parameters: ParameterSet, draws: Array) -> tuple[MovedBound, ...]:
    """Effects of moving each bound of the uniform priors inwards, by leaving out the draws beyond.

    draws : (m, n).
    """
    mean, sd = draws.mean(axis=0), draws.std(axis=0)
    bounds = []
    for k, parameter in enumerate(parameters.parameters):
        prior = parameter.prior
        if not prior.is_range:
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


# A constraint cuts a posterior if this fraction of its draws lies within so many of their standard deviations
# of it: of a normal density, if 5 % or more of it is beyond.
_NEAR_SD, _LEAST_FRACTION = 0.1, 0.01
# An optimum lies on a constraint that a step of this fraction of a search interval violates.
_STEP: Final = 1e-3


def cutting_constraints(margins: Array, constraints: Sequence[Constraint]) -> tuple[Constraint, ...]:
    """The constraints that cut the posterior of the draws.

    margins : (m, n_constraints) of equally probable draws, see `constraint_margins`; (n_constraints,) where
        they are the same for all draws
    constraints : n_constraints of them
    """
    margins = np.atleast_2d(margins)
    near = np.mean(margins < _NEAR_SD * margins.std(axis=0), axis=0)
    return _chosen(constraints, near >= _LEAST_FRACTION)


def limiting_constraints(
    material: Material | Hybrid, unknowns: ParameterSet, x: Array
) -> tuple[Constraint, ...]:
    """The constraints that a small step of one constant violates; x : (n,), an optimum."""
    step = _STEP * np.diag(unknowns.upper - unknowns.lower)
    margins = np.atleast_2d(material.margins(unknowns.mapping(np.concatenate((x + step, x - step)))))
    return _chosen(material.constraints, np.any(margins <= 0.0, axis=0))


def _chosen(constraints: Sequence[Constraint], chosen: Array) -> tuple[Constraint, ...]:
    return tuple(c for c, is_chosen in zip(constraints, chosen, strict=True) if is_chosen)


def cut_notices(material: Material | Hybrid, draws: Mapping[str, Array]) -> tuple[Notice, ...]:
    """A notice for each constraint that cuts a posterior; draws : name -> (m,), equally probable."""
    constraints = cutting_constraints(material.margins(draws), material.constraints)
    return tuple(Notice("cut_posterior", facts={"constraint": c}) for c in constraints)


# Pareto k-hat above which importance sampling is unreliable for leaving a mode out.
K_HAT_LIMIT = 0.7
# Leverage from draws above which the posterior is not treated as Gaussian: with several optima its spread is
# wider than the noise allows.
MOST_LEVERAGE = 0.95


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Each paired frequency predicted from all the others, (n_pairs,) each.

    residual : measured minus predicted, Hz.
    sd : of the prediction and the noise together, Hz.
    leverage : weight of a mode's frequency in its own prediction, 0 to 1.
    basis : whether predictions and their spread are those of the draws or of a linearisation at the optimum.
    """

    residual: Array
    sd: Array
    leverage: Array
    basis: Literal["draws", "optimum"]

    @property
    def standardised(self) -> Array:
        """Residuals divided by their standard deviations."""
        return np.asarray(self.residual / self.sd)

    @property
    def log_score(self) -> float:
        """Sum of the Gaussian log densities of the frequencies left out, per Hz each."""
        log_densities = -0.5 * self.standardised**2 - np.log(self.sd) - 0.5 * np.log(2.0 * np.pi)
        return float(log_densities.sum())


@dataclass(frozen=True, slots=True)
class ImportanceLeftOut:
    """Leave-one-out log score by Pareto-smoothed importance sampling.

    log_score, standard_error : of the sum over the frequencies.
    k_hat : (n,) of each frequency.
    """

    log_score: float
    standard_error: float
    k_hat: Array

    @property
    def reliable(self) -> bool:
        """Whether every k-hat is below 0.7."""
        return bool(np.all(self.k_hat < K_HAT_LIMIT))


def predictive_p_value(
    posterior: Posterior, draws: Array, frequencies: Array, pairing: Pairing, rng: np.random.Generator
) -> float:
    """Probability of a replicate list with larger standardised residuals than the measured one.

    The discrepancy is the sum of squared standardised residuals at each draw (Gelman, Meng and Stern,
    1996) over the frequencies that have a mode. draws (m, n), frequencies (m, n_modes) predicted there.
    """
    rows, columns = paired(pairing)
    sigma = posterior.noise(draws, frequencies)[:, rows, columns]
    measured = posterior.measurement.frequencies[rows]
    observed = np.sum(((measured - frequencies[:, columns]) / sigma) ** 2, axis=1)
    noise = posterior.noise_model.sample(rng, sigma.shape)
    return float(np.mean(np.sum(noise**2, axis=1) >= observed))


def leave_one_out(
    posterior: Posterior, draws: Array, frequencies: Array, pairing: Pairing, optimum: Array
) -> LeftOut:
    """Leave-one-mode-out residuals in closed form.

    Let the posterior of a mode's frequency be N(m, v) and its noise variance sigma^2. Removing its own
    datum f from that Gaussian leaves, with the leverage h = v / sigma^2, the residual
    (f - m) / (1 - h) and the predictive variance sigma^2 / (1 - h): for a linear Gaussian model those
    of a refit without the mode (Cook and Weisberg, 1982; as the cavity of an approximate posterior,
    Vehtari et al., 2016). m and v are those of the draws, which include bounds and curvature. Where they
    give a leverage above 0.95 the posterior is not Gaussian, and h is the diagonal of
    A (A^T A + R^-1)^-1 A^T, A the weighted Jacobian at the optimum, where the residuals are taken too, and R
    the correlation of the priors, mostly 1.

    The noise is that inferred from all modes. Student-t noise counts with the variance that gives the same
    information for v and with its own variance in the prediction.

    draws : (m, n).
    frequencies : (m, n_modes) predicted there, Hz.
    optimum : (n,).
    """
    rows, columns = paired(pairing)
    nu, information = posterior.degrees_of_freedom, posterior.noise_model.information
    measured = posterior.measurement.frequencies[rows]
    wider = 1.0 if np.isinf(nu) else nu / (nu - 2.0) * information
    predicted = frequencies[:, columns]
    squared = np.mean(posterior.noise(draws, frequencies)[:, rows, columns] ** 2, axis=0)
    squared /= information
    leverage = predicted.var(axis=0) / squared
    if np.all(leverage <= MOST_LEVERAGE):
        return cavity(measured - predicted.mean(axis=0), leverage, squared, "draws", wider)
    jacobian = weighted_jacobian(posterior, optimum, pairing)
    hessian = jacobian.T @ jacobian + posterior.model.parameters.precision
    leverage = np.einsum("ij,ji->i", jacobian, np.linalg.solve(hessian, jacobian.T))
    there = posterior.predict(optimum[None])
    squared = posterior.noise(optimum[None], there)[0, rows, columns] ** 2 / information
    return cavity(measured - there[0, columns], leverage, squared, "optimum", wider)


def cavity(
    residual: Array,
    leverage: Array,
    noise_variance: Array,
    basis: Literal["draws", "optimum"],
    wider: float = 1.0,
) -> LeftOut:
    """Leave-one-out prediction from residuals, leverages and noise variances of all modes, (n_pairs,) each.

    wider : noise variance of a prediction over the one in the leverage.
    """
    remaining = 1.0 - leverage
    sd = np.sqrt(noise_variance * (leverage / remaining + wider))
    return LeftOut(residual / remaining, sd, leverage, basis)


def importance_leave_one_out(log_density: Array) -> ImportanceLeftOut:
    """Leave-one-out log score from the log density of every frequency at every draw.

    Pareto-smoothed importance sampling (Vehtari, Gelman and Gabry, 2017).

    log_density : (m, n), draws independent of each other.
    """
    import arviz_base  # heavy
    import arviz_stats

    with warnings.catch_warnings():  # what k-hat says here
        warnings.simplefilter("ignore")
        data = arviz_base.from_dict(
            {
                "posterior": {"any": np.zeros((1, len(log_density)))},
                "log_likelihood": {"f": log_density[None]},
            }
        )
        result = arviz_stats.loo(data, pointwise=True, reff=1.0)
    return ImportanceLeftOut(float(result.elpd), float(result.se), np.asarray(result.pareto_k))


@dataclass(frozen=True, slots=True)
class Assessment:
    """What determines a posterior and how it fits, from the draws and from the optimum.

    combinations : best determined first.
    profiles : of the constants.
    power_scaling : of all parameters.
    left_out : in closed form.
    importance : ``None`` where a list may lack modes: its frequencies are not independent of each other.
    """

    combinations: tuple[Combination, ...]
    profiles: tuple[Profile, ...]
    power_scaling: tuple[PowerScaling, ...]
    moved_bounds: tuple[MovedBound, ...]
    left_out: LeftOut
    importance: ImportanceLeftOut | None


@dataclass(frozen=True, slots=True)
class ThinnedDraws:
    """Draws one autocorrelation time apart, ensembles as chains.

    step : steps of the chains between two draws.
    draws : (chains, draws, n).
    """

    step: int
    draws: Array

    @property
    def flat(self) -> Array:
        """All draws in one list, (n_draws, n)."""
        return self.draws.reshape(-1, self.draws.shape[-1])


def thinned(result: EnsembleResult) -> ThinnedDraws:
    """Draws of the ensembles, thinned by the autocorrelation time.

    An ensemble is one chain, step by step with all its walkers, since these move by each other's positions.
    """
    step = max(1, int(np.ceil(result.diagnostics.autocorrelation_time)))
    chain = result.chain[:, ::step]
    n_ensembles, _, _, n = chain.shape
    return ThinnedDraws(step, chain.reshape(n_ensembles, -1, n))


def assess(
    posterior: Posterior, result: EnsembleResult, pairing: Pairing, constants: tuple[str, ...]
) -> Assessment:
    """Assess a sampled posterior; ``constants`` are the parameters that have profiles.

    Profiles reach far beyond the draws, so ``posterior`` must be on the whole basis. The Jacobian is that at
    the most probable draw, with the median noise.
    """
    draws = thinned(result).flat
    best = result.draws[int(result.log_prob.argmax())].copy()
    n_plate = posterior.model.parameters.size
    best[n_plate:] = np.median(draws[:, n_plate:], axis=0)
    predicted = posterior.predict(draws)
    log_likelihood, pointwise = log_likelihoods(posterior, draws, predicted, pairing)
    of_plate = posterior.model.parameters
    noise = posterior.parameters.without(*of_plate.names)
    return Assessment(
        combinations=combinations(posterior, best, pairing),
        profiles=profile_likelihoods(posterior, constants, result.draws, result.log_prob.ravel()),
        power_scaling=power_scaling(
            posterior.parameters.names,
            draws,
            of_plate.log_prior(draws[:, :n_plate]),
            noise.log_prior(draws[:, n_plate:]),
            log_likelihood,
        ),
        moved_bounds=moved_bounds(posterior.parameters, draws),
        left_out=leave_one_out(posterior, draws, predicted, pairing, best),
        importance=None if pointwise is None else importance_leave_one_out(pointwise),
    )


def log_likelihoods(
    posterior: Posterior, x: Array, predicted: Array, pairing: Pairing
) -> tuple[Array, Array | None]:
    """Log likelihood (m,) at x (m, n) with the frequencies predicted there, and that of each frequency.

    The latter (m, n_frequencies) is ``None`` where pairings are summed over.
    """
    if not posterior.measurement.complete:
        return posterior.log_likelihood(x), None
    rows, columns = paired(pairing)
    pointwise = posterior.of_pairs(predicted, posterior.noise(x, predicted))[:, rows, columns]
    return pointwise.sum(axis=1), pointwise
