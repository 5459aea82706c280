"""A batch of one material: its mean constants and their scatter from plate to plate, by emcee.

The constants of plate i are drawn from those of the batch, c_i ~ N(mu, diag(tau^2)), and the likelihood of
its list is log p(list_i | c) = g . d - 1/2 d . F d about its optimum, d = c - at (Laplace). Marginalised over
c_i,

    log p(list_i | mu, tau) = g . e - 1/2 e . F e + 1/2 r . (T^-1 + F)^-1 r - 1/2 log det(1 + T F),

e = mu - at, r = g - F e, T = diag(tau^2): Gaussian integrals (Gelman et al., Bayesian Data Analysis, 5.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.batches.plate_row import LocalLikelihood, PlateRow
from cpam_bayes.inference.ensemble import Diagnostics, EnsembleSettings, sample_density
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT, Uniform
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

LEAST_PLATES: Final = 3
# Prior of a relative scatter: half a Student-t of width 5 %, as sheets of one material differ; its bounds.
_WIDTH, _FREEDOM, _LEAST, _MOST = 0.05, 4.0, 1e-4, 0.5
_SETTINGS: Final = EnsembleSettings(walkers=64, round_steps=200, most_steps=6000)
# Initial spread of the walkers, relative.
_START_MEAN, _START_SCATTER = 0.01, (0.005, 0.05)


@dataclass(frozen=True, slots=True)
class PopulationConstant:
    """One constant of the batch, SI; each tuple is mean, sd, 2.5 % and 97.5 % quantile.

    mean : of the batch
    scatter : relative standard deviation from plate to plate
    next_plate : predictive, for a further plate of the batch
    """

    name: str
    mean: tuple[float, float, float, float]
    scatter: tuple[float, float, float, float]
    next_plate: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Population:
    """Means and scatters of a batch.

    plates : number of plates
    draws : (n_draws, 2 n) of the means (SI), then of the relative scatters
    """

    constants: tuple[PopulationConstant, ...]
    plates: int
    draws: Array
    diagnostics: Diagnostics
    status: str


@dataclass(frozen=True, slots=True)
class BatchPosterior:
    """Log probability of means, in units of ``scale``, and relative scatters of a batch.

    scale : (n,) SI
    at, gradient : (plates, n); information : (plates, n, n), in units of the scale
    """

    parameters: ParameterSet
    scale: Array
    at: Array
    gradient: Array
    information: Array

    def log_prob(self, x: Array) -> Array:
        """Log probability of vectors x (m, 2 n), (m,)."""
        x = np.atleast_2d(x)
        value = self.parameters.log_prior(x)
        inside = np.isfinite(value)
        if inside.any():
            value[inside] += self.log_likelihood(x[inside])
        return np.asarray(value)

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood of all lists at vectors x (m, 2 n), up to a constant, (m,)."""
        n = len(self.scale)
        tau = x[:, None, n:]
        away = x[:, None, :n] - self.at
        pulled = np.einsum("pij,mpj->mpi", self.information, away)
        residual = (self.gradient - pulled) * tau
        matrix = tau[..., :, None] * self.information * tau[..., None, :] + np.eye(n)
        solved = np.linalg.solve(matrix, residual[..., None])[..., 0]
        quadratic = np.sum((self.gradient - 0.5 * pulled) * away + 0.5 * residual * solved, axis=-1)
        return np.asarray(np.sum(quadratic - 0.5 * np.linalg.slogdet(matrix)[1], axis=-1))


def batch_posterior(
    likelihoods: Sequence[LocalLikelihood], bounds: Sequence[tuple[float, float]]
) -> BatchPosterior:
    """The posterior of means and scatters.

    Means have a uniform prior within bounds (SI), scatters half a Student-t of width 5 % with four degrees of
    freedom.

    raises ValueError unless the likelihoods are of the same constants
    """
    names = likelihoods[0].names
    if any(other.names != names for other in likelihoods):
        raise ValueError("the plates have different unknown constants")
    at = np.array([v.at for v in likelihoods])
    scale = np.abs(at).mean(axis=0)
    means = [
        Parameter(name, "", Uniform(low / s, high / s))
        for name, s, (low, high) in zip(names, scale, bounds, strict=True)
    ]
    prior = ScaledStudentT(_WIDTH, _FREEDOM, _LEAST, _MOST)
    scatters = [Parameter(f"{name}_scatter", "", prior) for name in names]
    return BatchPosterior(
        ParameterSet((*means, *scatters)),
        scale,
        at / scale,
        np.array([v.gradient for v in likelihoods]) * scale,
        np.array([v.information for v in likelihoods]) * scale * scale[:, None],
    )


@single_blas_thread
def population_of(rows: Sequence[PlateRow], seed: int) -> Population:
    """Means and scatters of the plates of one material that have an answer.

    raises ValueError for fewer than three plates, several materials or different unknowns
    """
    done = [row for row in rows if row.likelihood is not None]
    if len(done) < LEAST_PLATES:
        raise ValueError(f"{len(done)} plates have an answer, a scatter needs {LEAST_PLATES} or more")
    if len({row.material for row in done}) > 1:
        named = ", ".join(sorted({row.material or "not named" for row in done}))
        raise ValueError(f"the plates are of several materials: {named}; give those of one")
    likelihoods = [row.likelihood for row in done if row.likelihood is not None]
    bounds = [
        (
            min(row.constants[k].posterior.lower for row in done),
            max(row.constants[k].posterior.upper for row in done),
        )
        for k in range(len(likelihoods[0].names))
        if all(k < len(row.constants) for row in done)
    ]
    density = batch_posterior(likelihoods, bounds)
    result = sample_density(density, _start(density, seed), seed, _SETTINGS)
    n = len(density.scale)
    draws = result.draws * np.concatenate((density.scale, np.ones(n)))
    rng = np.random.default_rng([seed, 11])
    further = draws[:, :n] + draws[:, n:] * density.scale * rng.standard_normal((len(draws), n))
    constants = tuple(
        PopulationConstant(name, _summary(draws[:, k]), _summary(draws[:, n + k]), _summary(further[:, k]))
        for k, name in enumerate(likelihoods[0].names)
    )
    return Population(constants, len(done), draws, result.diagnostics, result.status)


def _start(density: BatchPosterior, seed: int) -> Array:
    """Walkers about the information-weighted mean of the plates, (ensembles, walkers, 2 n)."""
    rng = np.random.default_rng([seed, 10])
    n, parameters = len(density.scale), density.parameters
    shape = (_SETTINGS.ensembles, _SETTINGS.walkers, n)
    # a constant that no list determines starts at the mean of the answers
    weak = np.eye(n)
    told = np.einsum("pij,pj->i", density.information, density.at) + density.gradient.sum(axis=0)
    mean = np.linalg.solve(density.information.sum(axis=0) + weak, told + density.at.mean(axis=0))
    means = mean + _START_MEAN * rng.standard_normal(shape)
    start = np.concatenate((means, rng.uniform(*_START_SCATTER, size=shape)), axis=-1)
    room = 1e-3 * (parameters.upper - parameters.lower)
    low, high = parameters.lower + room, parameters.upper - room
    outside = (start < low) | (start > high)
    return np.where(outside, low + (high - low) * rng.uniform(size=start.shape), start)


def _summary(values: Array) -> tuple[float, float, float, float]:
    """Mean, sd, 2.5 % and 97.5 % quantile."""
    low, high = np.quantile(values, (0.025, 0.975))
    return float(values.mean()), float(values.std(ddof=1)), float(low), float(high)
