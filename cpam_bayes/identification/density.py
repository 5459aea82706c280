"""The density of a complete list with noise, tolerances and theory's error, and the constants that it leaves.

    y = f(c) (1 + J t + d) + e

with e the noise, t the errors of sizes, mass and frequency scale, d the scatter of solver and theory: all
Gaussian, in one covariance matrix. Moments of the constants are by importance sampling about all optima.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from cpam_bayes.forward_model.labels import LabelledModel, list_order
from cpam_bayes.forward_model.preconditions import birge_ratio
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.theory_error import theory_error
from cpam_bayes.forward_model.tolerances import Array, known_errors, powers
from cpam_bayes.inference.derivatives import Expansion, NormalScores, apart
from cpam_bayes.inference.laplace import maximise
from cpam_bayes.inference.posterior import NOISE, NOISE_PRIOR
from cpam_bayes.inference.proposal import Rounds, adaptive_importance
from cpam_bayes.inference.student_mixture import Mixture, shrunk_moments
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parameters import Parameter, ParameterSet
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.records import Material

Model = ReducedModel | LabelledModel

# Noise that residuals are weighed by where none is stated, relative.
_USUAL_NOISE = 0.002
# Optima nearer than this, standard deviations, are one; so many are sampled about at most.
_SAME, _MOST = 1.0, 8
# Degrees of freedom of the proposal, and by how much it is wider than the Gaussian at an optimum.
_FREEDOM, _WIDER = 5.0, 1.2
_ROUNDS = Rounds(log2_points=8, most=10, least=3, enough=600.0)
_STEPS = 40


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
        """Of each constant, (n,)."""
        return np.asarray(self.weight @ self.x)

    @property
    def covariance(self) -> Array:
        """Of the constants, (n, n)."""
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


@dataclass(frozen=True, slots=True)
class ListDensity:
    """Log density of constants, and of the noise where it is not stated, over normal scores.

    model : of the plate, its modes in the places of the list
    frequencies : (n_f,) Hz
    covariance : (n_f, n_f) Hz^2, with the noise where it is stated
    parameters : the constants, then the relative noise
    """

    model: Model
    frequencies: Array
    covariance: Array
    parameters: ParameterSet
    scores: NormalScores

    @property
    def _n(self) -> int:
        return self.model.parameters.size

    def log_density(self, z: Array) -> Array:
        """At scores (m, n), (m,); -inf where the constants cannot be."""
        return self._expanded(z, derivatives=False).value

    def expand(self, z: Array) -> Expansion:
        """With gradient and Fisher information, at scores (m, n)."""
        return self._expanded(z, derivatives=True)

    def _expanded(self, z: Array, *, derivatives: bool) -> Expansion:
        m, n = z.shape
        x = self.scores.to_x(z)
        value, gradient, curvature = np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n))
        inside = np.flatnonzero(self.model.full.admissible(x[:, : self._n]))
        if len(inside):
            try:
                found = self._of_likelihood(x[inside], derivatives=derivatives)
                value[inside], gradient[inside], curvature[inside] = found
            except RigidBodyError:
                pass  # no modes: no density
        if not derivatives:
            return Expansion(value + self.scores.log_prior(z), gradient, curvature)
        return self.scores.with_prior(Expansion(value, gradient, curvature), x, z)

    def _of_likelihood(self, x: Array, *, derivatives: bool) -> tuple[Array, Array, Array]:
        f, n_f = self.frequencies, len(self.frequencies)
        prediction = self.model.predict(x[:, : self._n], jacobian=derivatives)
        covariance = np.broadcast_to(self.covariance, (len(x), n_f, n_f))
        has_noise = x.shape[1] > self._n
        if has_noise:
            covariance = covariance + (x[:, -1, None] * f)[:, :, None] ** 2 * np.eye(n_f)
        back = np.linalg.inv(np.linalg.cholesky(covariance))
        white = np.einsum("mij,mj->mi", back, f - prediction.frequencies[:, :n_f])
        log_determinant = np.log(np.diagonal(back, axis1=1, axis2=2)).sum(axis=1)
        value = log_determinant - 0.5 * np.sum(white**2, axis=1) - 0.5 * n_f * np.log(2.0 * np.pi)
        gradient, curvature = np.zeros(x.shape), np.zeros((len(x), x.shape[1], x.shape[1]))
        if prediction.jacobian is not None:
            slope = back @ prediction.jacobian[:, :n_f]
            gradient[:, : self._n] = np.einsum("mi,mij->mj", white, slope)
            curvature[:, : self._n, : self._n] = np.swapaxes(slope, 1, 2) @ slope
            if has_noise:
                d = back * (2.0 * x[:, -1, None] * f**2)[:, None, :] @ np.swapaxes(back, 1, 2)
                gradient[:, -1] = 0.5 * (
                    np.einsum("mi,mij,mj->m", white, d, white) - np.trace(d, axis1=1, axis2=2)
                )
                curvature[:, -1, -1] = 0.5 * np.einsum("mij,mij->m", d, d)
        return value, gradient, curvature

    def sampled(self, starts: Array, noise: float) -> Draws:
        """Draws about all optima that carry weight, next to constants (m, n); noise : where it begins."""
        if self.parameters.size > self._n:
            prior = self.parameters.parameters[-1].prior
            level = np.clip(noise, 2.0 * prior.lower, 0.5 * prior.upper)
            starts = np.column_stack((starts, np.full(len(starts), level)))
        z = np.vstack((self.scores.to_z(starts), np.zeros(self.parameters.size)))
        ends = maximise(
            lambda z, rows: self.expand(z),
            np.clip(z, -3.0, 3.0),  # off the ends of a prior, where its density over scores is flat
            self.scores.lower,
            self.scores.upper,
            most_steps=_STEPS,
        )
        order = np.argsort(-ends.expansion.value, kind="stable")
        order = order[np.isfinite(ends.expansion.value[order])]
        u, curvature, height = ends.u[order], ends.expansion.curvature[order], ends.expansion.value[order]
        kept = apart(u, curvature, _SAME, _MOST)
        log_share = height[kept] - 0.5 * np.linalg.slogdet(curvature[kept])[1]
        share = np.maximum(np.exp(log_share - logsumexp(log_share)), 0.02)
        factor = _WIDER * np.linalg.cholesky(np.linalg.inv(curvature[kept]))
        proposal = Mixture((share / share.sum())[None], u[kept][None], factor[None], _FREEDOM)
        found = adaptive_importance(
            lambda z: self.log_density(z[0])[None], self.expand, proposal, _refitted, _ROUNDS
        )
        x = self.scores.to_x(found.points[0])[:, : self._n]
        return Draws(x, found.weight[0], float(found.effective_size[0]))


def _refitted(mixture: Mixture, points: Array, log_weight: Array) -> Mixture:
    return shrunk_moments(mixture, points, log_weight, least=1e-3, wider=_WIDER, prior_points=4.0)


def list_density(specimen: Specimen, model: Model, best: Array) -> tuple[ListDensity, float]:
    """The density of the list of a specimen, and the factor by which the stated noise is widened in it.

    best : (n,) constants of the best optimum, where the covariance is taken. A misfit there that the stated
    noise does not explain widens it, by Birge's ratio.
    """
    measurement = specimen.measurement
    assert measurement is not None
    f = measurement.frequencies
    is_stated = measurement.relative_std is not None or measurement.frequency_sd is not None
    relative = common_covariance(specimen, model, best) + np.diag(scatter(specimen, model, best) ** 2)
    covariance, noise = np.outer(f, f) * relative, np.diag(noise_variance(measurement, 0.0))
    excess, parameters = 1.0, specimen.unknowns
    if is_stated:
        left = f - model.predict(best[None]).frequencies[0, : len(f)]
        white = np.linalg.solve(np.linalg.cholesky(covariance + noise), left)
        excess = birge_ratio(np.asarray(white, dtype=np.float64), len(best))
    else:
        parameters = parameters.union(ParameterSet((Parameter(NOISE, "", NOISE_PRIOR),)))
    density = ListDensity(model, f, covariance + excess**2 * noise, parameters, NormalScores(parameters))
    return density, excess
