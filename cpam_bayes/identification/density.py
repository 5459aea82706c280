"""The density of a complete list with noise, tolerances and theory's error, and the constants that it leaves.

    y = f(c) (1 + J t + d) + e

with e the noise, t the errors of sizes, mass and frequency scale, d the scatter of solver and theory: all
Gaussian, in one covariance matrix. Moments of the constants are by importance sampling about all optima.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cpam_bayes.forward_model.composed import ComposedModel, Part
from cpam_bayes.forward_model.known_errors import Array, known_errors, powers, theory_error
from cpam_bayes.forward_model.labels import LabelledModel, list_order
from cpam_bayes.forward_model.preconditions import birge_ratio
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.derivatives import NormalScores
from cpam_bayes.inference.log_density import Listed, LogDensity
from cpam_bayes.inference.posterior import NOISE, NOISE_PRIOR
from cpam_bayes.inference.proposal import Rounds, about, adaptive_importance, maximised, refitted_moments
from cpam_bayes.parameters import Parameter, ParameterSet
from cpam_bayes.plate import Material, Measurement, Specimen

Model = ReducedModel | LabelledModel

# Noise that residuals are weighed by where none is stated, relative.
_USUAL_NOISE = 0.002
# Optima that are sampled about at most.
_MOST = 8
_ROUNDS = Rounds(log2_points=8, most=10, least=3, enough=600.0)
# Steps of an optimisation at most, and the gain, nats, that ends it.
_STEPS, _PROMISED = 40, 1e-9


def common_covariance(specimen: Specimen, model: Model, x: Array) -> Array:
    """Relative covariance of the frequencies by errors that they have in common, (n_f, n_f).

    Of the sizes, the mass and the frequency scale as they are known, to first order at constants x (n,).
    """
    measurement, full = specimen.measurement, model.full
    assert measurement is not None
    order = list_order(model, x)[: measurement.size]
    known = known_errors(specimen)
    found = powers(specimen, full, dict(zip(full.parameters.names, x.tolist(), strict=True)), order)
    assert found is not None
    j = np.stack([sd * found.of_sizes[name] for name, sd in known.items()])
    return np.asarray(j.T @ j)


def scatter(specimen: Specimen, model: Model, x: Array) -> Array:
    """Relative standard deviation of each frequency by solver and first-order theory, (n_f,)."""
    measurement, full = specimen.measurement, model.full
    assert measurement is not None
    order = list_order(model, x)[: measurement.size]
    by_solver = np.hypot(full.error, model.tolerance)[order]
    if not isinstance(specimen.material, Material):
        return np.asarray(by_solver)
    return np.hypot(by_solver, theory_error(specimen, full.predict(x[None]).frequencies[0, order]))


def noise_variance(measurement: Measurement, relative: float) -> Array:
    """Variance of each frequency by its noise and rounding, Hz^2; relative : where no noise is stated."""
    stated = relative if measurement.relative_std is None else measurement.relative_std
    return np.asarray(measurement.noise_sd(stated) ** 2 + measurement.resolution**2 / 12.0)


def residual_sd(specimen: Specimen, model: Model, x: Array) -> Array:
    """Standard deviation of each frequency where sizes are as stated, at constants x (n,), (n_f,) Hz."""
    measurement = specimen.measurement
    assert measurement is not None
    by_model = (measurement.frequencies * scatter(specimen, model, x)) ** 2
    return np.asarray(np.sqrt(noise_variance(measurement, _USUAL_NOISE) + by_model))


@dataclass(frozen=True, slots=True)
class Draws:
    """Weighted draws of the constants.

    x : (p, n), SI. weight : (p,), they add up to one. effective : number of equally probable ones
    """

    x: Array
    weight: Array
    effective: float

    @property
    def mean(self) -> Array:
        """Mean of each constant, (n,)."""
        return np.asarray(self.weight @ self.x)

    @property
    def covariance(self) -> Array:
        """Covariance of the constants, (n, n)."""
        away = self.x - self.mean
        return np.asarray((self.weight[:, None] * away).T @ away)

    def quantiles(self, column: int, at: tuple[float, ...]) -> Array:
        """Quantiles of one constant."""
        order = np.argsort(self.x[:, column], kind="stable")
        cumulative = np.cumsum(self.weight[order]) - 0.5 * self.weight[order]
        return np.asarray(np.interp(at, cumulative, self.x[order, column]))

    def beyond(self, column: int, low: float, high: float) -> tuple[float, float]:
        """Probability of a constant below the one and above the other."""
        x = self.x[:, column]
        return float(self.weight[x < low].sum()), float(self.weight[x > high].sum())


def sampled(density: LogDensity, starts: Array, noise: float) -> Draws:
    """Draws about all optima that carry weight, next to constants (m, n).

    noise : where an inferred noise begins, relative
    """
    n = density.model.parameters.size
    if density.noise is not None:
        prior = density.parameters.parameters[density.noise].prior
        level = np.clip(noise, 2.0 * prior.lower, 0.5 * prior.upper)
        starts = np.column_stack((starts, np.full(len(starts), level)))
    z = np.vstack((density.scores.to_z(starts), np.zeros(density.parameters.size)))
    # off the ends of a prior, where its density over scores is flat
    optima = maximised(density, np.clip(z, -3.0, 3.0), _STEPS, _PROMISED, _MOST)
    _, proposal = about(optima.z, optima.factor, optima.log_mass)
    found = adaptive_importance(
        lambda z: density.log_density(z[0])[None], density.expand, proposal, refitted_moments, _ROUNDS
    )
    x = density.scores.to_x(found.points[0])[:, :n]
    return Draws(x, found.weight[0], float(found.effective_size[0]))


def list_density(specimen: Specimen, model: Model, best: Array) -> tuple[LogDensity, float]:
    """The density of the list of a specimen, and the factor by which the stated noise is widened in it.

    best : (n,) constants of the best optimum, where the covariance is taken. A misfit there that the stated
    noise does not explain widens it, by Birge's ratio.
    """
    measurement = specimen.measurement
    assert measurement is not None
    f = measurement.frequencies
    n_f, n = len(f), len(best)
    is_stated = measurement.relative_std is not None or measurement.frequency_sd is not None
    common = np.outer(f, f) * common_covariance(specimen, model, best)
    by_model, noise = (f * scatter(specimen, model, best)) ** 2, noise_variance(measurement, 0.0)
    excess, parameters = 1.0, specimen.unknowns
    if is_stated:
        left = f - model.predict(best[None]).frequencies[0, :n_f]
        covariance = common + np.diag(by_model + noise)
        white = np.linalg.solve(np.linalg.cholesky(covariance), left)
        excess = birge_ratio(np.asarray(white, dtype=np.float64), n)
    else:
        parameters = parameters.union(ParameterSet((Parameter(NOISE, "", NOISE_PRIOR),)))
    part = Part(model, np.arange(n), np.full(n, -1), (), np.arange(n_f))
    listed = Listed(f, by_model + excess**2 * noise, np.zeros(n_f) if is_stated else f, common=common)
    density = LogDensity(
        ComposedModel(specimen.unknowns, (part,)),
        listed,
        parameters,
        NormalScores(parameters),
        amplitudes=(-1 if is_stated else n,),
        discrepancy=None,
    )
    return density, excess
