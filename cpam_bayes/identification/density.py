"""Posterior density of complete lists with noise, tolerances and theory's error, and draws of the constants.

    y = f(c) (1 + J t + d) + e

with e the noise, t the common errors of sizes, mass, frequency scale and theory, d the scatter of solver
and theory from mode to mode: all Gaussian, in one covariance matrix. Several lists of one material share the
constants, whose moments are by importance sampling about all optima.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cpam_bayes.forward_model.composed import ComposedModel, Part
from cpam_bayes.forward_model.known_errors import common_covariance, common_errors
from cpam_bayes.forward_model.labels import list_order
from cpam_bayes.forward_model.preconditions import birge_ratio
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.three_dimensions import theory_error
from cpam_bayes.inference.importance import Rounds, about_optima, importance
from cpam_bayes.inference.laplace import Optima, maximised
from cpam_bayes.inference.log_density import CorrelatedDensity, Listed, log_residuals
from cpam_bayes.inference.posterior import NOISE, NOISE_PRIOR
from cpam_bayes.inference.scores import NormalScores
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal
from cpam_bayes.plate import Measurement, Specimen

# Relative noise that weights residuals where none is stated.
_USUAL_NOISE = 0.002
# Most optima about which draws are sampled.
_MOST = 8
_ROUNDS = Rounds(log2_points=8, most=10, least=3, enough=600.0)
# Steps of an optimisation at most, and the gain, nats, that ends it.
_STEPS, _PROMISED = 40, 1e-9


def scatter(specimen: Specimen, model: ReducedModel, x: Array, error: Array | None = None) -> Array:
    """Relative standard deviation (n_modes,) of each mode by solver and first-order theory, in list order.

    error : (n_modes,) of the solver at x, in ascending order of the modes; that of the model if left out
    """
    full, order = model.full, list_order(model, x)
    by_solver = np.hypot(full.error if error is None else error, model.tolerance)[order]
    return np.hypot(by_solver, theory_error(specimen, full.predict(x[None]).frequencies[0, order]))


def noise_variance(measurement: Measurement, relative: float) -> Array:
    """Variance of each frequency by its noise and rounding, Hz^2; relative : where no noise is stated."""
    stated = relative if measurement.relative_std is None else measurement.relative_std
    return np.asarray(measurement.noise_sd(stated) ** 2 + measurement.resolution**2 / 12.0)


def residual_sd(specimen: Specimen, model: ReducedModel, x: Array) -> Array:
    """Standard deviation of each frequency where sizes are as stated, at constants x (n,), (n_f,) Hz."""
    measurement = specimen.measurement
    assert measurement is not None
    by_model = (measurement.frequencies * scatter(specimen, model, x)[: measurement.size]) ** 2
    return np.asarray(np.sqrt(noise_variance(measurement, _USUAL_NOISE) + by_model))


@dataclass(frozen=True, slots=True)
class Draws:
    """Weighted draws of the constants.

    x : (p, n), SI. weight : (p,), normalised. effective : equivalent number of equally probable draws
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

    def even(self, n: int) -> Array:
        """Draws (n, n_constants) of equal weight, by systematic resampling."""
        at = np.searchsorted(np.cumsum(self.weight), (np.arange(n) + 0.5) / n)
        return np.asarray(self.x[np.minimum(at, len(self.x) - 1)])

    def beyond(self, column: int, low: float, high: float) -> tuple[float, float]:
        """Probabilities of a constant below ``low`` and above ``high``."""
        x = self.x[:, column]
        return float(self.weight[x < low].sum()), float(self.weight[x > high].sum())


def optima_about(density: CorrelatedDensity, starts: Array, noise: float) -> Optima:
    """All optima reached by derivatives from constants (m, n), the first of the parameters.

    noise : relative start of an inferred noise
    """
    x = density.scores.to_x(np.zeros((len(starts), density.parameters.size)))
    x[:, : starts.shape[1]] = starts
    for column in density.nuisance:
        prior = density.parameters.parameters[column].prior
        x[:, column] = np.clip(noise, 2.0 * prior.lower, 0.5 * prior.upper)
    z = np.vstack((density.scores.to_z(x), np.zeros(density.parameters.size)))
    # away from the ends of a prior, where its density over scores is flat
    return maximised(density, np.clip(z, -3.0, 3.0), _STEPS, _PROMISED, _MOST)


def sampled(density: CorrelatedDensity, optima: Optima, n: int) -> Draws:
    """Draws of the first n parameters, the constants, about all optima that carry weight."""
    found, _ = importance(
        lambda z: density.log_density(z[0])[None], about_optima(optima), _ROUNDS, density.expand
    )
    x = density.scores.to_x(found.points[0])[:, :n]
    return Draws(x, found.weight[0], float(found.effective_size[0]))


def lists_density(
    lists: Sequence[tuple[Specimen, ReducedModel]], at: Array, scatter_sd: float
) -> tuple[CorrelatedDensity, Array]:
    """Density of lists of one material, and the factors (l,) by which their stated noise is widened.

    Constants are shared; each of several specimens deviates from them. Errors of sizes and mass belong to a
    specimen and are common to its tests; the frequency scale, of one analyser, is common to all lists.

    at : (l, n) constants of each list, at which its covariance is evaluated. A misfit there that the stated
        noise does not explain widens it, by Birge's ratio: of the list alone, or given the others, which
        share its errors of sizes.
    scatter_sd : relative standard deviation of a constant from specimen to specimen
    """
    unknowns, n = lists[0][0].unknowns, at.shape[1]
    specimens = [specimen.specimen for specimen, _ in lists]
    measurements = [s.measurement for s, _ in lists if s.measurement is not None]
    size_of = {
        name: sum(m.size for s, m in zip(specimens, measurements, strict=True) if s == name)
        for name in specimens
    }
    parameters, column_of = list(unknowns.parameters), dict[str, Array]()
    several = len(size_of) > 1
    for name in size_of:
        column_of[name] = len(parameters) + np.arange(n) if several else np.full(n, -1)
        if several:
            parameters += [deviation(p, name, scatter_sd) for p in unknowns.parameters]
    composed = ParameterSet(tuple(parameters), unknowns.fixed)
    parts, by_model, noise, left, scale, amplitudes = [], [], [], [], [], []
    errors: list[tuple[str, int, dict[str, Array]]] = []
    for i, ((specimen, model), m, x) in enumerate(zip(lists, measurements, at, strict=True)):
        constants = dict(zip(model.full.parameters.names, x.tolist(), strict=True))
        own = common_errors(specimen, model.full, constants, list_order(model, x)[: m.size])
        errors.append((specimen.specimen, m.size, own))
        f, is_stated = m.frequencies, m.relative_std is not None or m.frequency_sd is not None
        by_model.append((f * scatter(specimen, model, x)[: m.size]) ** 2)
        noise.append(noise_variance(m, 0.0))
        left.append(log_residuals(f, model.predict(x[None]).frequencies[0, : m.size]))
        if not is_stated:
            parameters.append(_noise_of([s.name for s, _ in lists], i))
        amplitudes.append(-1 if is_stated else len(parameters) - 1)
        scale.append(np.zeros(m.size) if is_stated else f)
        parts.append(Part(model, np.arange(n), column_of[specimen.specimen], (), np.arange(m.size)))
    frequencies = np.concatenate([m.frequencies for m in measurements])
    common = np.outer(frequencies, frequencies) * common_covariance(errors)
    # tests of a specimen share its constants: each fits a part of them
    fitted = [math.ceil(n * m.size / size_of[s]) for s, m in zip(specimens, measurements, strict=True)]
    alone = [m + own for m, own in zip(by_model, noise, strict=True)]
    excess = _excess(left, alone, common, fitted, [column < 0 for column in amplitudes])
    listed = Listed(
        frequencies,
        np.concatenate([m + e**2 * own for m, e, own in zip(by_model, excess, noise, strict=True)]),
        np.concatenate(scale),
        lists=np.repeat(np.arange(len(lists)), [m.size for m in measurements]),
        common=common,
    )
    every = ParameterSet(tuple(parameters), unknowns.fixed)
    together = ComposedModel(composed, tuple(parts))
    return CorrelatedDensity(
        together, listed, every, NormalScores(every), tuple(amplitudes), discrepancy=None
    ), excess


def _excess(
    residuals: Sequence[Array],
    variance: Sequence[Array],
    common: Array,
    fitted: Sequence[int],
    is_stated: Sequence[bool],
) -> Array:
    """Misfit (l,) of each list over its stated noise; 1 where that explains it, or none is stated.

    residuals, variance : of each list, Hz, and Hz^2 by its noise and model. common : covariance of all
    frequencies by their common errors, Hz^2
    """
    ends = np.cumsum([0, *map(len, residuals)]).tolist()
    rows = [np.arange(a, b) for a, b in pairwise(ends)]
    stated = np.concatenate([r for r, known in zip(rows, is_stated, strict=True) if known] or [rows[0][:0]])
    own, every = np.concatenate(variance), np.concatenate(residuals)
    covariance = common[np.ix_(stated, stated)] + np.diag(own[stated])
    # minus the common errors as inferred from all lists together
    beside = np.zeros_like(every)
    beside[stated] = np.sqrt(own[stated]) * np.linalg.solve(covariance, every[stated])
    excess = np.ones(len(rows))
    for i in np.flatnonzero(is_stated).tolist():
        of = rows[i]
        root = np.linalg.cholesky(common[np.ix_(of, of)] + np.diag(own[of]))
        excess[i] = max(birge_ratio(e, fitted[i]) for e in (np.linalg.solve(root, every[of]), beside[of]))
    return excess


def deviation(parameter: Parameter, specimen: str, sd: float) -> Parameter:
    """Parameter for the relative deviation of a specimen's constant from that of the material."""
    prior = TruncatedNormal(0.0, sd, -4.0 * sd, 4.0 * sd)
    name = f"scatter of {parameter.name}, {specimen}"
    return Parameter(name, "", prior, kind="scatter", base=parameter.name, of=specimen)


def _noise_of(names: Sequence[str], i: int) -> Parameter:
    """Repeatability parameter of one list, named after the list where there are several."""
    if len(names) == 1:
        return Parameter(NOISE, "", NOISE_PRIOR)
    return Parameter(f"{NOISE} of {names[i]}", "", NOISE_PRIOR, base=NOISE, of=names[i])
