"""Log densities with gradient and curvature for stacks of points, in scaled coordinates and in normal scores.

Over normal scores every prior is standard normal: no bounds, and flat directions are integrated exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.priors import Priors

# Step of the complex-step derivative: any small number does, no digits go.
_COMPLEX_STEP = 1e-30
# Steps of central differences of priors and of likelihoods along the model's tangent, in scaled
# coordinates: of first derivatives and of second ones.
_STEP, _SECOND_STEP = 1e-5, 1e-4
# Differences of a summed likelihood that are computed at once: as many stay in a processor's cache.
_MOST_AT_ONCE = 1000
# Share of a standard deviation by which the exact Hessian steps.
_HESSIAN_STEP = 1e-3


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Coordinates u in which a posterior is near a Gaussian.

    u = x / (standard deviation of the prior), but log x for the noise's amplitude, a scale parameter.

    scale : (n,) in the parameters' units.
    logged : (n,) bool.
    lower, upper : (n,) bounds of u.
    inner, outer : (n,) bounds of x.
    """

    scale: Array
    logged: Array
    lower: Array
    upper: Array
    inner: Array
    outer: Array

    def to_u(self, x: Array) -> Array:
        """Parameter vectors (..., n) in these coordinates."""
        safe = np.where(self.logged, x, 1.0)
        return np.asarray(np.where(self.logged, np.log(safe), x / self.scale))

    def to_x(self, u: Array) -> Array:
        """Parameter vectors of coordinates (..., n), within their bounds."""
        x = np.where(self.logged, np.exp(np.where(self.logged, u, 0.0)), u * self.scale)
        return np.asarray(np.clip(x, self.inner, self.outer))

    def slope(self, x: Array) -> Array:
        """d x / d u at x (..., n)."""
        return np.asarray(np.where(self.logged, x, self.scale))

    def log_jacobian(self, x: Array) -> Array:
        """log |dx / du| at x (..., n), (...)."""
        return np.asarray(np.log(self.slope(x)).sum(axis=-1))


@dataclass(frozen=True, slots=True)
class Expansion:
    """Log density of m points with its derivatives.

    value : (m,), -inf outside the support, where the derivatives are zero.
    gradient : (m, n).
    curvature : (m, n, n), positive semidefinite: the negative Hessian less the second derivatives of the
    frequencies, in the mean over the data.
    """

    value: Array
    gradient: Array
    curvature: Array

    def of(self, rows: Array) -> Expansion:
        """That of some of the points."""
        return Expansion(self.value[rows], self.gradient[rows], self.curvature[rows])


def prior_sd(posterior: Posterior) -> Array:
    """Standard deviations of the priors, (n,)."""
    return np.array([p.prior.sd for p in posterior.parameters.parameters])


def coordinates(posterior: Posterior) -> Coordinates:
    """The scaled coordinates of a posterior."""
    parameters = posterior.parameters
    scale = prior_sd(posterior)
    logged = np.array([name == posterior.noise_name for name in parameters.names])
    with np.errstate(divide="ignore"):
        lower, upper = (
            np.where(logged, np.log(np.where(logged, b, 1.0)), b / scale)
            for b in (parameters.lower, parameters.upper)
        )
    return Coordinates(scale, logged, lower, upper, parameters.lower, parameters.upper)


def log_density(posterior: Posterior, axes: Coordinates, u: Array) -> Array:
    """Log posterior density over u but for the evidence, (m, n) -> (m,)."""
    x = axes.to_x(u)
    return np.asarray(posterior.log_prob(x) + axes.log_jacobian(x))


def expand(posterior: Posterior, x: Array) -> Expansion:
    """Log probability, gradient and curvature over the parameters themselves, x (m, n).

    d log p / dx = sum_i (d l_i / d f_i) (d f_i / dx) + d l / dx + d log prior / dx, with the model's
    analytic d f / dx. The gradient is zero where the log probability is -inf, one-sided at a bound.

    The curvature is the Fisher information of the data and the curvature of the priors. Where
    pairings are summed it is the negative Hessian for a model that is linear in its parameters,
    its negative eigenvalues set to zero.
    """
    x = np.atleast_2d(x)
    m, n = x.shape
    value = posterior.log_prior(x)
    gradient, curvature = np.zeros((m, n)), np.zeros((m, n, n))
    inside = np.isfinite(value)
    if inside.any():
        x_inside = x[inside]
        likelihood = expand_likelihood(posterior, x_inside)
        prior_slope, prior_curvature = _prior(posterior, x_inside)
        value[inside] += likelihood.value
        gradient[inside] = likelihood.gradient + prior_slope
        curvature[inside] = likelihood.curvature + prior_curvature
    return Expansion(value, gradient, curvature)


def expand_u(posterior: Posterior, axes: Coordinates, u: Array) -> Expansion:
    """The expansion of the log density over u at points u (m, n)."""
    x = axes.to_x(np.atleast_2d(u))
    expansion = expand(posterior, x)
    inside = np.isfinite(expansion.value)[:, None]
    slope = axes.slope(x)
    gradient = expansion.gradient * slope + np.where(axes.logged & inside, 1.0, 0.0)
    curvature = expansion.curvature * slope[:, :, None] * slope[:, None, :]
    return Expansion(expansion.value + axes.log_jacobian(x), gradient, curvature)


def hessian_u(posterior: Posterior, axes: Coordinates, u: Array, sd: Array) -> Array:
    """The exact negative Hessian of the log density over u at one point (n,), (n, n).

    Central differences of the analytic gradient with a step of a thousandth of ``sd`` (n,); at a bound
    the one-sided formula of second order, (-3 g_0 + 4 g_1 - g_2) / 2 h. ``nan`` where a step leaves
    the support.
    """
    n = len(u)
    h = _HESSIAN_STEP * sd
    sign = np.where(u + h > axes.upper, -1.0, 1.0)
    central = (u + h <= axes.upper) & (u - h >= axes.lower)
    h = h * sign
    first, second = u + np.diag(h), u + np.where(central, -1.0, 2.0) * np.diag(h)
    points = np.concatenate((u[None], first, second))
    expansion = expand_u(posterior, axes, points)
    g = np.where(np.isfinite(expansion.value)[:, None], expansion.gradient, np.nan)
    g0, g1, g2 = g[0], g[1 : n + 1], g[n + 1 :]
    difference = np.where(central[:, None], g1 - g2, -3.0 * g0 + 4.0 * g1 - g2) / (2.0 * h[:, None])
    return np.asarray(-0.5 * (difference + difference.T))


def expand_likelihood(posterior: Posterior, x: Array) -> Expansion:
    """Log likelihood, gradient and Fisher information over the parameters x (m, n) within the support."""
    return (_one_to_one if posterior.is_one_to_one else _summed)(posterior, x)


def _one_to_one(posterior: Posterior, x: Array) -> Expansion:
    """Expansion for a complete list: every frequency depends on its own mode alone.

    The Fisher information of location and log scale of a Student-t density of nu degrees of freedom is
    (nu + 1) / (nu + 3) / sigma^2 and 2 nu / (nu + 3) (Lange, Little and Taylor, 1989).
    """
    n_plate, n_f = posterior.model.parameters.size, posterior.measurement.size
    prediction = posterior.model.predict(x[:, :n_plate], jacobian=True)
    assert prediction.jacobian is not None
    f = prediction.frequencies
    slope = np.zeros((len(x), n_f, x.shape[1]))  # d f_i / dx
    slope[:, :, :n_plate] = prediction.jacobian[:, :n_f]
    i = np.arange(n_f)

    def paired(x: Array, f: Array) -> tuple[Array, Array]:
        sigma = posterior.noise(x, f)
        return posterior.log_density(f, sigma)[:, i, i], sigma[:, i, i]

    step = 1j * _COMPLEX_STEP
    density, sigma = paired(x, f + step)
    value, sigma_0 = density.real.sum(axis=1), sigma.real
    by_f = density.imag / _COMPLEX_STEP
    gradient = np.einsum("mi,mij->mj", by_f, slope)
    log_sigma = (sigma.imag / _COMPLEX_STEP / sigma_0)[..., None] * slope  # d log sigma_i / dx
    for j in range(n_plate, x.shape[1]):
        density, sigma = paired(x + step * (np.arange(x.shape[1]) == j), f)
        gradient[:, j] += density.imag.sum(axis=1) / _COMPLEX_STEP
        log_sigma[:, :, j] += sigma.imag / _COMPLEX_STEP / sigma_0
    nu = posterior.degrees_of_freedom
    location, scale = posterior.noise_model.information, 2.0 if np.isinf(nu) else 2.0 * nu / (nu + 3.0)
    weighted = slope / sigma_0[..., None]
    curvature = location * _gram(weighted) + scale * _gram(log_sigma)
    return Expansion(value, gradient, curvature)


def _gram(a: Array) -> Array:
    return np.asarray(np.swapaxes(a, 1, 2) @ a)


@dataclass(frozen=True, slots=True)
class _Tangent:
    """A model that is linear in its parameters: the tangent of another at m points."""

    parameters: ParameterSet
    at: Array
    frequencies: Array
    jacobian: Array

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        away = np.einsum("mij,mj->mi", self.jacobian, x - self.at)
        return Prediction(self.frequencies + away, self.jacobian if jacobian else None)

    def admissible(self, x: Array) -> Array:
        return np.ones(len(x), dtype=bool)


@dataclass(frozen=True, slots=True)
class _TangentPosterior(Posterior):
    """A posterior over a tangent, with the modes in range held as they are at its points.

    A mode comes into range at the highest frequency listed, next to which every optimum lies: a
    difference across that small jump would say nothing about the slope.
    """

    seen: Array = field(default_factory=lambda: np.empty((0, 0), dtype=bool))

    def in_range(self, predicted: Array) -> Array:
        return self.seen


def _summed(posterior: Posterior, x: Array) -> Expansion:
    """Where pairings are summed over: differences of the likelihood along the model's tangent, no solves."""
    n_plate, n = posterior.model.parameters.size, x.shape[1]
    prediction = posterior.model.predict(x[:, :n_plate], jacobian=True)
    assert prediction.jacobian is not None
    seen = posterior.in_range(prediction.frequencies)
    slope, unit = coordinates(posterior).slope(x), np.eye(n)
    pairs = np.array([(j, k) for j in range(n) for k in range(j + 1)])
    j, k = pairs.T
    first, second = _STEP * unit, _SECOND_STEP * unit
    offsets = np.concatenate(
        (np.zeros((1, n)), first, -first, *(s * second[j] + t * second[k] for s in (1, -1) for t in (1, -1)))
    )
    changed = {f.name: getattr(posterior, f.name) for f in fields(Posterior)}
    values = np.empty((len(x), len(offsets)))
    block = max(_MOST_AT_ONCE // len(offsets), 1)
    for rows in (slice(i, i + block) for i in range(0, len(x), block)):
        at, of_model, frequencies, jacobian, in_range = (
            np.repeat(a[rows], len(offsets), axis=0)
            for a in (x, x[:, :n_plate], prediction.frequencies, prediction.jacobian, seen)
        )
        tangent = _Tangent(posterior.model.parameters, of_model, frequencies, jacobian)
        along = _TangentPosterior(**changed | {"model": tangent}, seen=in_range)
        moved = at + (offsets * slope[rows, None]).reshape(at.shape)
        values[rows] = along.log_likelihood(moved).reshape(-1, len(offsets))
    value, up, down, *corners = np.split(values, np.cumsum([1, n, n, *[len(pairs)] * 3]), axis=1)
    gradient = (up - down) / (2.0 * _STEP)
    bend = np.empty((len(x), n, n))
    bend[:, j, k] = bend[:, k, j] = -(corners[0] - corners[1] - corners[2] + corners[3]) / (
        4.0 * _SECOND_STEP**2
    )
    values, vectors = np.linalg.eigh(bend)
    bend = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    inverse = 1.0 / slope
    return Expansion(value[:, 0], gradient * inverse, bend * inverse[:, :, None] * inverse[:, None, :])


def _prior(posterior: Posterior, x: Array) -> tuple[Array, Array]:
    """Gradient (m, n) and curvature (m, n, n) of the log prior, positive semidefinite.

    Central differences of independent priors. Next to a bound they are taken a step inside and carried to it
    by the second derivative. The second derivative of the noise is that of its density over log x. Correlated
    priors have the curvature of the normal density of their scores.
    """
    axes = coordinates(posterior)
    gradient, bend = np.zeros_like(x), np.zeros_like(x)
    for j, parameter in enumerate(posterior.parameters.parameters):
        prior = parameter.prior
        h = _SECOND_STEP * axes.slope(x)[:, j]
        at = np.clip(x[:, j], prior.lower + h, prior.upper - h)
        down, here, up = (np.asarray(prior.log_density(at + s * h)) for s in (-1, 0, 1))
        second = (up - 2.0 * here + down) / h**2
        gradient[:, j] = (up - down) / (2.0 * h) + second * (x[:, j] - at)
        bend[:, j] = -second - (gradient[:, j] / x[:, j] if axes.logged[j] else 0.0)
    parameters = posterior.parameters
    curvature = np.maximum(bend, 0.0)[..., None] * np.eye(x.shape[1])
    if parameters.root is not None:
        scores = NormalScores(parameters)
        v, by_x = scores.of_each(x)
        precision = parameters.precision
        own = np.array([p.coupled is not None for p in parameters.parameters])
        gradient += by_x * (v - v @ precision)
        among = np.ix_(np.arange(len(x)), own, own)
        curvature[among] = (by_x[:, :, None] * precision * by_x[:, None, :])[among]
    return gradient, curvature


# Scores are cut here: probabilities beyond are rounding.
MAX_SCORE = 7.0
_HALF_LOG_2PI = 0.5 * float(np.log(2.0 * np.pi))


@dataclass(frozen=True)
class NormalScores:
    """z with Phi(L z) = F(x), F the distribution functions of the parameters' priors, L their `root`.

    The density over z is the likelihood times the standard normal density.
    """

    parameters: ParameterSet

    @cached_property
    def _priors(self) -> Priors:
        return Priors(tuple(p.prior for p in self.parameters.parameters))

    @property
    def lower(self) -> Array:
        """Least scores, (n,)."""
        return np.full(self.parameters.size, -MAX_SCORE)

    @property
    def upper(self) -> Array:
        """Largest scores, (n,)."""
        return np.full(self.parameters.size, MAX_SCORE)

    def to_x(self, z: Array) -> Array:
        """Parameters of scores (..., n), within their bounds."""
        # cut, for half-bounded parameters have no finite value at the end
        return self._priors.from_normal(np.minimum(np.maximum(self._coupled(z), -MAX_SCORE), MAX_SCORE))

    def to_z(self, x: Array) -> Array:
        """Scores of parameters (..., n)."""
        z = np.clip(self._priors.to_normal(x), -MAX_SCORE, MAX_SCORE)
        if self.parameters.root is None:
            return z
        return np.clip(z @ np.linalg.inv(self.parameters.root).T, -MAX_SCORE, MAX_SCORE)

    def _coupled(self, z: Array) -> Array:
        root = self.parameters.root
        return z if root is None else np.asarray(z @ root.T)

    def of_each(self, x: Array) -> tuple[Array, Array]:
        """Scores of parameters (..., n) as if they were independent, and the slopes of these, (..., n)."""
        v = np.clip(self._priors.to_normal(x), -MAX_SCORE, MAX_SCORE)
        return v, np.exp(self._priors.log_densities(x) + 0.5 * v**2 + _HALF_LOG_2PI)

    def by_score(self, slope: Array, x: Array, z: Array) -> Array:
        """Derivatives over parameters (..., k, n) as ones over scores, at parameters and scores (..., n).

        d x_i / d z_j = L_ij phi(v_i) / p_i(x_i), v = L z, p_i the density of the prior.
        """
        scaled, root = slope * self.slope(x, z)[..., None, :], self.parameters.root
        return np.asarray(scaled if root is None else scaled @ root)

    def slope(self, x: Array, z: Array) -> Array:
        """Slopes of parameters over their own scores L z, (..., n): the normal density over the prior's."""
        log_density, own = self._priors.log_densities(x), self._coupled(z)
        if self.parameters.root is not None:
            own = np.clip(own, -MAX_SCORE, MAX_SCORE)
        return np.asarray(np.exp(-0.5 * own**2 - _HALF_LOG_2PI - log_density))

    def log_prior(self, z: Array) -> Array:
        """Log prior density over scores (..., n), (...)."""
        return np.asarray(-0.5 * np.sum(z**2, axis=-1) - z.shape[-1] * _HALF_LOG_2PI)

    def with_prior(self, likelihood: Expansion, x: Array, z: Array) -> Expansion:
        """The log posterior density over scores z (m, n), from the log likelihood over parameters x (m, n).

        The standard normal prior has the gradient -z and the curvature 1.
        """
        slope, root = self.slope(x, z), self.parameters.root
        gradient = likelihood.gradient * slope
        curvature = likelihood.curvature * slope[:, :, None] * slope[:, None, :]
        if root is not None:
            gradient, curvature = gradient @ root, root.T @ curvature @ root
        curvature = curvature + np.eye(z.shape[1])
        return Expansion(likelihood.value + self.log_prior(z), gradient - z, curvature)


def apart(z: Array, curvature: Array, distance: float, most: int | None = None) -> list[int]:
    """Indices of points (k, n) that lie apart from those kept before them, ``most`` at the most.

    distance : in standard deviations by the curvature (k, n, n) of the point kept.
    """
    kept: list[int] = []
    for i in range(len(z)):
        if len(kept) == most:
            break
        away = z[i] - z[kept]
        if np.all(np.einsum("ki,kij,kj->k", away, curvature[kept], away) > distance**2):
            kept.append(i)
    return kept


def distinct(z: Array, expansion: Expansion, distance: float, most: int | None = None) -> list[int]:
    """Indices of the ends (k, n) of optimisations that are different optima, the best first."""
    value = np.where(np.isfinite(expansion.value), expansion.value, -np.inf)
    order = np.argsort(-value, kind="stable")
    order = order[value[order] > -np.inf]
    return [int(order[i]) for i in apart(z[order], expansion.curvature[order], distance, most)]
