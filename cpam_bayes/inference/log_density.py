"""The log density of frequency lists under a model of the plate.

All commands use it: its optima are sought over normal scores of the parameters (`laplace`), and its
integral, the marginal likelihood, is computed by importance sampling about these (`importance`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from cpam_bayes.forward_model.composed import ComposedModel
from cpam_bayes.inference.scores import Expansion, NormalScores
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet


class LogDensity(ABC):
    """The log density of frequency lists over the parameters of a model and its noise, or over their scores.

    Common errors of the frequencies, of sizes and of theory, are in the covariance (`CorrelatedDensity`), or
    among the parameters where frequencies must be independent, because their pairings with modes are summed
    over or their noise is Student's t (`Posterior`).

    scores : normal scores of the parameters
    """

    __slots__ = ()
    parameters: ParameterSet
    scores: NormalScores

    @property
    @abstractmethod
    def n_model(self) -> int:
        """Number of the model's parameters, which come first; the others are amplitudes of noise."""

    @abstractmethod
    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood (m,) at parameters (m, n), -inf where the constraints (9) are violated."""

    @abstractmethod
    def expand_likelihood(self, x: Array) -> Expansion:
        """Log likelihood with its gradient and its Fisher information over the parameters."""

    @abstractmethod
    def far_off(self, z: Array) -> Array:
        """Misfit (m,) that ranks scores (m, n) even far from an optimum, infinite outside the support."""

    def log_density(self, z: Array) -> Array:
        """Log (m,) of likelihood times prior density over scores (m, n)."""
        return self.scores.log_prior(z) + self.log_likelihood(self.scores.to_x(z))

    def expand(self, z: Array) -> Expansion:
        """Log density over scores (m, n), its gradient, and its curvature with the Fisher information."""
        x = self.scores.to_x(z)
        return self.scores.with_prior(self.expand_likelihood(x), x, z)


# Relative misfit beyond which more hardly counts; fraction of the mean misfit that one modulus absorbs.
_COARSE, _FORGIVEN = 0.02, 0.9


def coarse_misfit(r: Array) -> Array:
    """Misfit (m,) that ranks large residuals (m, n_f) of the log frequencies."""
    r = r - _FORGIVEN * r.mean(axis=1, keepdims=True)
    return np.asarray(np.sum(np.log1p((r / _COARSE) ** 2), axis=1))


# Fraction of a smooth discrepancy's variance that is common to neighbouring modes; the rest is white.
SMOOTH_FRACTION = 0.95


@dataclass(frozen=True, slots=True)
class Listed:
    """Measured frequencies of all lists and their noise.

    sigma_i^2 = variance_i + (a scale_i)^2, with the amplitude a of the list where it is inferred.
    common : (n, n) Hz^2, covariance by common errors, of sizes and mass for instance, None where these are
        parameters.
    log_constant : log probability of what the model does not predict, false peaks for instance.

    frequencies, variance, scale : (n,) Hz, Hz^2, Hz; scale is zero where the noise is given.
    lists : (n,) number of the list of each frequency.
    """

    frequencies: Array
    variance: Array
    scale: Array
    log_constant: float = 0.0
    lists: Array | None = None
    common: Array | None = None

    @property
    def of(self) -> Array:
        """Number (n,) of the list of each frequency."""
        return np.zeros(len(self.frequencies), dtype=int) if self.lists is None else self.lists

    def without(self, i: int) -> Listed:
        """The list without one frequency."""
        kept = np.arange(len(self.frequencies)) != i
        common = None if self.common is None else self.common[np.ix_(kept, kept)]
        return Listed(
            self.frequencies[kept],
            self.variance[kept],
            self.scale[kept],
            self.log_constant,
            self.of[kept],
            common,
        )

    def correlation(self, length: float) -> Array:
        """Correlation (n, n) of a discrepancy between the frequencies; length over ln f, 0 if white.

        rho exp(-(ln f_i - ln f_j)^2 / (2 length^2)) + (1 - rho) delta_ij within a list, none between lists.
        """
        n = len(self.frequencies)
        if length == 0.0:
            return np.eye(n)
        apart = np.subtract.outer(np.log(self.frequencies), np.log(self.frequencies)) / length
        alike = np.exp(-0.5 * apart**2) * np.equal.outer(self.of, self.of)
        return np.asarray(SMOOTH_FRACTION * alike + (1.0 - SMOOTH_FRACTION) * np.eye(n))


def kept_of(whole: Array, listed: Array) -> Array:
    """Mask (n,) of the frequencies of a list that are in a shorter one of the same order.

    Equal frequencies are matched in order.
    """
    kept, at = np.zeros(len(whole), dtype=bool), 0
    for i, f in enumerate(whole):
        if at < len(listed) and f == listed[at]:
            kept[i], at = True, at + 1
    return kept


def log_residuals(listed: Array, f: Array) -> Array:
    """Residuals of the logarithms of listed frequencies (n,) at predictions f (..., n), in Hz of the list."""
    return np.asarray(listed * np.log(listed / f))


@dataclass(frozen=True, slots=True)
class CorrelatedDensity(LogDensity):
    """The log density of lists with a known mode for each frequency, with common errors.

    `residuals` are Gaussian with the covariance diag(sigma^2) + C + tau^2 F R F: C of the common errors,
    F = diag(f) and R the correlation of a discrepancy between the model and the plate
    (Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001).

    parameters : those of the model, then those of the noise.
    amplitudes : column of each list's repeatability, -1 where it is given.
    discrepancy : column of tau, or ``None``.
    correlation_length : of the discrepancy over ln f, 0 where it is white.
    left_out : a frequency of the model that was removed from the list on purpose, or ``None``.
    """

    model: ComposedModel
    listed: Listed
    parameters: ParameterSet
    scores: NormalScores
    amplitudes: tuple[int, ...]
    discrepancy: int | None
    correlation_length: float = 0.0
    left_out: int | None = None

    @property
    def n_model(self) -> int:
        """Number of the model's parameters, which come first; the others are amplitudes."""
        return self.model.parameters.size

    @property
    def noise(self) -> int | None:
        """Column of the first repeatability that is inferred, or ``None``."""
        return next((column for column in self.amplitudes if column >= 0), None)

    @property
    def nuisance(self) -> tuple[int, ...]:
        """Columns of all amplitudes of noise and discrepancy."""
        of_noise = tuple(column for column in self.amplitudes if column >= 0)
        return of_noise if self.discrepancy is None else (*of_noise, self.discrepancy)

    def carried(self, other: CorrelatedDensity, values: Array, rest: Array | float = 0.0) -> Array:
        """Values (..., n) for these parameters, taken over by name from another comparison.

        values : (..., n_other) parameters, or scores, of the other one
        rest : (n,) or one value, for the parameters that the other one lacks
        """
        column_of = {name: column for column, name in enumerate(other.parameters.names)}
        carried = np.empty((*values.shape[:-1], self.parameters.size))
        carried[...] = rest
        for column, name in enumerate(self.parameters.names):
            if name in column_of:
                carried[..., column] = values[..., column_of[name]]
        return carried

    def predict(self, x: Array, *, jacobian: bool = False) -> tuple[Array, Array | None]:
        """Frequencies (m, n_f) of the list at parameters (m, n), and their derivatives over these."""
        prediction = self.model.predict(x, jacobian=jacobian)
        f, slope = prediction.frequencies, prediction.jacobian
        if self.left_out is not None:
            kept = np.arange(f.shape[1]) != self.left_out
            f, slope = f[:, kept], None if slope is None else slope[:, kept]
        if slope is not None and x.shape[1] > slope.shape[2]:
            further = np.zeros((*slope.shape[:2], x.shape[1] - slope.shape[2]))
            slope = np.concatenate((slope, further), axis=2)
        return f, slope

    def predict_inside(self, x: Array, *, jacobian: bool = False) -> tuple[Array, Array, Array | None]:
        """Rows of parameters (m, n) at which the plates have modes, and the predictions there.

        Rows that violate the constraints (9) or buckle a plate are left out, also those where only the solve
        shows it.
        """
        rows = np.flatnonzero(self.model.admissible(x))
        if not len(rows):
            n = len(self.listed.frequencies)
            return rows, np.empty((0, n)), np.empty((0, n, x.shape[1]))
        try:
            return rows, *self.predict(x[rows], jacobian=jacobian)
        except RigidBodyError:
            if len(rows) == 1:
                return self.predict_inside(x[:0], jacobian=jacobian)
        halves = []
        for part in np.array_split(rows, 2):
            inside, f, slope = self.predict_inside(x[part], jacobian=jacobian)
            halves.append((part[inside], f, slope))
        slopes = [slope for _, _, slope in halves if slope is not None]
        return (
            np.concatenate([inside for inside, _, _ in halves]),
            np.concatenate([f for _, f, _ in halves]),
            np.concatenate(slopes) if jacobian else None,
        )

    def about(self, z: Array, tolerance: float, fraction: float = 1.0) -> CorrelatedDensity:
        """The density with models reduced for the region of scores z (m, n), see ``ComposedModel.about``."""
        x = self.scores.to_x(z)
        x = x[self.model.admissible(x)]
        if not len(x):
            return self
        try:
            return replace(self, model=self.model.about(x, tolerance, fraction))
        except RigidBodyError:
            return self

    def variance(self, x: Array) -> Array:
        """sigma^2 (m, n_f), Hz^2, of every frequency at parameters (m, n), discrepancy included.

        Common errors are not included.
        """
        variance = self._independent(x)
        if self.discrepancy is not None:
            variance = variance + (x[:, self.discrepancy, None] * self.listed.frequencies) ** 2
        return variance

    def covariance(self, x: Array) -> Array:
        """Covariance (m, n_f, n_f), Hz^2, of all frequencies at parameters (m, n)."""
        covariance = self._independent(x)[:, :, None] * np.eye(len(self.listed.frequencies))
        if self.listed.common is not None:
            covariance = covariance + self.listed.common
        if self.discrepancy is not None:
            covariance = covariance + x[:, self.discrepancy, None, None] ** 2 * self._discrepant
        return np.asarray(covariance)

    def residuals(self, f: Array) -> Array:
        """Residuals of predictions f (m, n_f): f_listed ln(f_listed / f), Hz.

        An error common to all frequencies is then a factor of them, even where the model is far off.
        """
        return log_residuals(self.listed.frequencies, f)

    def residual_slopes(self, f: Array, slope: Array) -> Array:
        """Minus the derivatives of the residuals, from those (..., n_f, n) of predictions (..., n_f)."""
        return np.asarray(slope * (self.listed.frequencies / f)[..., None])

    def misfit(self, x: Array, f: Array) -> Array:
        """r^T S^-1 r (m,) of the residuals of predictions (m, n_f) at parameters (m, n)."""
        white, _ = _whitened(self.residuals(f), self.covariance(x))
        return np.asarray(np.sum(white**2, axis=1))

    def common_part(self, z: Array) -> Array:
        """Expected part (m, n_f), Hz, of the residuals by common errors at scores (m, n).

        C S^-1 r, C the covariance by common errors and S that of all.
        """
        x = self.scores.to_x(z)
        r = self.residuals(self.predict(x)[0])
        if self.listed.common is None:
            return np.zeros_like(r)
        return np.asarray(np.linalg.solve(self.covariance(x), r[..., None])[..., 0] @ self.listed.common)

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood (m,) at parameters (m, n), -inf where the constraints (9) are violated."""
        value = np.full(len(x), -np.inf)
        inside, f, _ = self.predict_inside(x)
        if len(inside):
            r = self.residuals(f)
            if self._is_correlated:
                value[inside] = self._correlated(r, self.covariance(x[inside]))[0]
            else:
                value[inside] = self._gaussian(r, self.variance(x[inside]))
        return value

    def log_conditional(self, x: Array) -> Array:
        """Log density (m, n_f) of each frequency given the others and the parameters (m, n).

        With Q the inverse covariance and r the residuals, r_i given the others is Gaussian with the variance
        1 / Q_ii and lies (Q r)_i / Q_ii off its mean (Rue and Held, Gaussian Markov Random Fields, theorem
        2.3). Not a number where the constraints (9) are violated.
        """
        value = np.full((len(x), len(self.listed.frequencies)), np.nan)
        inside, f, _ = self.predict_inside(x)
        if len(inside):
            r = self.residuals(f)
            precision = np.linalg.inv(self.covariance(x[inside]))
            own = np.diagonal(precision, axis1=1, axis2=2)
            off = np.einsum("mij,mj->mi", precision, r) / own
            value[inside] = 0.5 * (np.log(own / (2.0 * np.pi)) - own * off**2)
        return value

    def expand_likelihood(self, x: Array) -> Expansion:
        """Log likelihood at parameters (m, n), its gradient and Fisher information over them."""
        m, n = x.shape
        value, gradient, curvature = np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n))
        inside, f, slope = self.predict_inside(x, jacobian=True)
        if len(inside):
            assert slope is not None
            expand = self._expand_correlated if self._is_correlated else self._expand_independent
            value[inside], gradient[inside], curvature[inside] = expand(
                x[inside], self.residuals(f), self.residual_slopes(f, slope)
            )
        return Expansion(value, gradient, curvature)

    def far_off(self, z: Array) -> Array:
        """The misfit (m,) of `coarse_misfit` at scores (m, n)."""
        misfit = np.full(len(z), np.inf)
        inside, f, _ = self.predict_inside(self.scores.to_x(z))
        if len(inside):
            misfit[inside] = coarse_misfit(np.log(self.listed.frequencies / f))
        return misfit

    @property
    def _is_correlated(self) -> bool:
        return self.listed.common is not None or (
            self.discrepancy is not None and self.correlation_length > 0.0
        )

    def _independent(self, x: Array) -> Array:
        """sigma^2 (m, n_f), Hz^2, without the discrepancy."""
        variance = np.broadcast_to(self.listed.variance, (len(x), len(self.listed.variance)))
        if self.noise is not None:
            # scale is zero where there is no amplitude, so that any column will do
            variance = variance + (x[:, self._amplitude_columns] * self.listed.scale) ** 2
        return variance

    @property
    def _amplitude_columns(self) -> Array:
        return np.array(self.amplitudes)[self.listed.of]

    def _expand_independent(self, x: Array, r: Array, slope: Array) -> tuple[Array, Array, Array]:
        variance = self.variance(x)
        log_sigma = self._log_sigma_slope(x, variance)
        gradient = np.einsum("mi,mij->mj", r / variance, slope)
        gradient += np.einsum("mi,mij->mj", r**2 / variance - 1.0, log_sigma)
        weighted = slope / np.sqrt(variance)[..., None]
        curvature = np.swapaxes(weighted, 1, 2) @ weighted
        curvature += 2.0 * np.swapaxes(log_sigma, 1, 2) @ log_sigma
        return self._gaussian(r, variance), gradient, curvature

    def _gaussian(self, r: Array, variance: Array) -> Array:
        log_density = -0.5 * np.sum(r**2 / variance + np.log(2 * np.pi * variance), axis=1)
        return np.asarray(log_density + self.listed.log_constant)

    def _log_sigma_slope(self, x: Array, variance: Array) -> Array:
        """d ln sigma_i / d x_j, (m, n_f, n)."""
        slope = np.zeros((*variance.shape, x.shape[1]))
        if self.noise is not None:
            rows, columns = np.arange(variance.shape[1]), self._amplitude_columns
            slope[:, rows, columns] = x[:, columns] * self.listed.scale**2 / variance
        if self.discrepancy is not None:
            tau = x[:, self.discrepancy, None]
            slope[:, :, self.discrepancy] = tau * self.listed.frequencies**2 / variance
        return slope

    @property
    def _discrepant(self) -> Array:
        """F R F, (n_f, n_f) Hz^2."""
        f = self.listed.frequencies
        return f[:, None] * self.listed.correlation(self.correlation_length) * f

    def _correlated(self, r: Array, covariance: Array) -> tuple[Array, Array]:
        """Log density of residuals (m, n_f) and L^-1 with L L^T the covariance, (m, n_f, n_f)."""
        white, back = _whitened(r, covariance)
        log_determinant = -2.0 * np.log(np.diagonal(back, axis1=1, axis2=2)).sum(axis=1)
        quadratic = np.sum(white**2, axis=1) + log_determinant + r.shape[1] * np.log(2 * np.pi)
        return np.asarray(self.listed.log_constant - 0.5 * quadratic), back

    def _expand_correlated(self, x: Array, r: Array, slope: Array) -> tuple[Array, Array, Array]:
        """Value, gradient and Fisher information of a Gaussian with the covariance S.

        d/dp = J_p^T S^-1 r + (a^T S_p a - tr S^-1 S_p) / 2 with a = S^-1 r; the information is
        J_p^T S^-1 J_q + tr(S^-1 S_p S^-1 S_q) / 2 (Kay, Estimation Theory, section 3.9).
        """
        value, back = self._correlated(r, self.covariance(x))
        white, weighted = np.einsum("mij,mj->mi", back, r), back @ slope
        gradient = np.einsum("mi,mij->mj", white, weighted)
        curvature = np.swapaxes(weighted, 1, 2) @ weighted
        columns = self.nuisance
        turned = [back @ d @ np.swapaxes(back, 1, 2) for d in self._covariance_slopes(x)]
        for p, first in zip(columns, turned, strict=True):
            gradient[:, p] += 0.5 * np.einsum("mi,mij,mj->m", white, first, white)
            gradient[:, p] -= 0.5 * np.trace(first, axis1=1, axis2=2)
            for q, second in zip(columns, turned, strict=True):
                curvature[:, p, q] += 0.5 * np.einsum("mij,mij->m", first, second)
        return value, gradient, curvature

    def _covariance_slopes(self, x: Array) -> list[Array]:
        """Derivatives of the covariance over every column of ``nuisance``, (m, n_f, n_f) each."""
        n, slopes = len(self.listed.frequencies), []
        for column in self.nuisance:
            twice = 2.0 * x[:, column, None, None]
            if column == self.discrepancy:
                slopes.append(twice * self._discrepant)
            else:
                scale = np.where(self._amplitude_columns == column, self.listed.scale, 0.0)
                slopes.append(twice * (scale**2 * np.eye(n)))
        return slopes


def _whitened(r: Array, covariance: Array) -> tuple[Array, Array]:
    """L^-1 r of residuals (m, n_f), and L^-1 (m, n_f, n_f) with L L^T the covariance."""
    back = np.linalg.inv(np.linalg.cholesky(covariance))
    return np.einsum("mij,mj->mi", back, r), back
