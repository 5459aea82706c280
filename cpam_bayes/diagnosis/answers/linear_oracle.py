"""Evidences of all causes for simulated lists, with the model linear in the constants.

About the plain model's optimum the log frequencies are linear in the constants, which are integrated within
their priors in closed form; a cause shifts the frequencies along a line. With y the residuals and t a node of
a line, both multiplied by the root of the precision, the evidence of a cause over that of the plain model is
sum_k p_k exp(y.t_k - t_k.t_k / 2). For y = noise + shift this is a matrix product of exp(noise.t_k) and
exp(shift.t_k - t_k.t_k / 2), so that all draws of the noise share the work for every size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.answers.shift_lines import ShiftLine
from cpam_bayes.diagnosis.evidence.comparison import Comparison
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.weighing import Tested, Weighed
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, prior_by_cause
from cpam_bayes.diagnosis.signatures import ABSORBED, ALIKE, AS_WELL, HARDLY

Array = NDArray[Any]

# Nodes of a line: their distance in standard deviations of the data at most, in scores at most, and the
# distance from the plain model beyond which none are needed.
_APART_SD, _APART_SCORES, _FARTHEST_SD = 1.6, 0.9, 50.0
# The same of nodes whose directions are compared.
_DIRECTION_SD = 0.8
# Amplitudes of an inferred noise that evidences are integrated over, and how far beyond those of the truth:
# a large noise explains a shift too.
_AMPLITUDES, _BELOW, _ABOVE = 8, 0.6, 10.0
# Midpoints of equal parts of a discrepancy's prior.
_DISCREPANCIES = 8
_LARGEST_EXPONENT = 680.0


@dataclass(frozen=True, slots=True)
class _Gaussians:
    """Sum of weighted normal densities of residuals of the log frequencies (n_f,), with one mean.

    log_weight : (g,) with the constants of the densities
    roots : (g, n_f, n_f), root^T root the precision
    """

    log_weight: Array
    mean: Array
    roots: Array

    @staticmethod
    def of(mean: Array, covariances: Array, log_weight: float) -> _Gaussians:
        """Equally probable ones with covariances (g, n_f, n_f)."""
        factor = np.linalg.cholesky(covariances)
        log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return _Gaussians(log_weight - log_det - float(np.log(len(covariances))), mean, np.linalg.inv(factor))

    def log_density(self, noise: Array, shift: Array) -> Array:
        """Of residuals noise + shift, (n, n_f) and (m, n_f) -> (n, m)."""
        turned = np.swapaxes(self.roots, 1, 2)
        a, b = (noise - self.mean) @ turned, shift @ turned
        squares = 2.0 * a @ np.swapaxes(b, 1, 2)
        squares += np.einsum("gni,gni->gn", a, a)[:, :, None] + np.einsum("gmi,gmi->gm", b, b)[:, None]
        return _log_sum(self.log_weight[:, None, None] - 0.5 * squares)


def _log_sum(terms: Array) -> Array:
    """Logarithm of the sum of exponentials over the first axis."""
    if len(terms) == 1:
        return np.asarray(terms[0])
    top = np.maximum(terms.max(axis=0), -1e300)
    with np.errstate(divide="ignore"):
        return np.asarray(top + np.log(np.exp(terms - top).sum(axis=0)))


@dataclass(frozen=True, slots=True)
class _Level:
    """One level of the noise.

    plain : density of the residuals under the plain model
    nodes : (k, n_f) of all lines, times the root of the precision, those of one cause together
    log_prior : (k,) of the nodes, less half their squared norms
    factor : (n, k) exp(y . nodes) of the simulated noise
    blocks : rows of ``nodes`` by cause
    others : densities under each cause that has no line, none among them
    """

    plain: _Gaussians
    nodes: Array
    log_prior: Array
    factor: Array
    blocks: tuple[slice, ...]
    others: tuple[tuple[_Gaussians, ...], ...]

    def log_evidences(self, noise: Array, shift: Array) -> Array:
        """Of all causes, (n_causes, n, m), for noise (n, n_f) and shifts (m, n_f)."""
        plain = self.plain.log_density(noise, shift)
        exponent = self.nodes @ (shift @ self.plain.roots[0].T).T + self.log_prior[:, None]
        top = exponent.max(axis=0, initial=-np.inf)
        weight = np.exp(exponent - top)
        with np.errstate(divide="ignore"):
            each = [np.log(self.factor[:, b] @ weight[b]) + top + plain for b in self.blocks]
        each += [
            _log_sum(np.stack([g.log_density(noise, shift) for g in of_cause])) for of_cause in self.others
        ]
        return np.stack(each)


@dataclass(frozen=True, slots=True)
class LinearOracle:
    """Simulated noise about the plain model's optimum, and what the evidences of all hypotheses need.

    causes : in the order of the evidences, none and other among them
    prior : (n_causes,) of each
    noise : (n, n_f) of the log frequencies
    levels : of the noise in the evidences
    root : (n_f, n_f) of the precision at a typical level of the noise
    sd : (n_f,) of the log frequencies there
    paths : the nodes of every line, times that root
    material : numbers of the causes whose constants may be anything, and the roots of their precisions
    """

    causes: tuple[str, ...]
    prior: Array
    noise: Array
    levels: tuple[_Level, ...]
    root: Array
    sd: Array
    paths: _Paths
    material: tuple[tuple[int, Array], ...]

    def log_weights(self, shift: Array) -> Array:
        """Log of prior times evidence of every cause for shifts (m, n_f), (n_causes, n, m)."""
        return _log_sum(np.stack([level.log_evidences(self.noise, shift) for level in self.levels]))

    def alike(self, shift: Array) -> Array:
        """Whether a cause cannot be told from the one that shifts by (m, n_f), (n_causes, m).

        By the rules of `signatures`: the cosine with the nearest shift that it has, the constants' part
        taken out of both, or a fit without noise that is as good.
        """
        target = shift @ self.root.T
        visible = np.linalg.norm(target, axis=1) >= ABSORBED * np.linalg.norm(shift / self.sd, axis=1)
        n = len(self.paths.firsts)
        alike = np.zeros((len(self.causes), len(shift)), dtype=bool)
        cosine, distance = self.paths.nearest(target)
        alike[:n] = ((cosine > ALIKE) & visible) | (0.5 * distance < AS_WELL)
        for number, root in self.material:
            alike[number] = 0.5 * np.sum((shift @ root.T) ** 2, axis=1) < AS_WELL
        return alike


@dataclass(frozen=True, slots=True)
class _Paths:
    """Nodes of all lines as the data see them.

    nodes : (k, n_f) times the root of the precision
    visible : (k,) whether the constants do not absorb them
    starts : (n_lines,) rows at which the lines begin
    firsts : (n_causes,) first lines of the causes
    """

    nodes: Array
    visible: Array
    starts: Array
    firsts: Array

    def nearest(self, target: Array) -> tuple[Array, Array]:
        """Of targets (m, n_f) and the nearest node: largest cosine, squared distance, (n_causes, m) each."""
        if not len(self.starts):
            return np.zeros((0, len(target))), np.zeros((0, len(target)))
        norm, size = np.linalg.norm(self.nodes, axis=1), np.linalg.norm(target, axis=1)
        product = self.nodes @ target.T
        distance = norm[:, None] ** 2 - 2.0 * product
        of_cause = np.minimum.reduceat(distance, self.starts[self.firsts]) + size**2
        # shifts that are hardly there have no direction; a line without others is met at its end
        distance = np.where(norm[:, None] >= HARDLY * size, distance, 1e9 - norm[:, None])
        lengths = np.diff(self.starts, append=len(norm))
        best = np.repeat(np.minimum.reduceat(distance, self.starts), lengths, axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = np.abs(product) / (norm[:, None] * size)
        cosine = np.where((distance == best) & self.visible[:, None], cosine, 0.0)
        return np.nan_to_num(np.maximum.reduceat(cosine, self.starts[self.firsts])), of_cause


def linear_oracle(
    weighed: Weighed, lines: Sequence[ShiftLine], n: int, rng: np.random.Generator
) -> LinearOracle:
    """The oracle about the optimum of the plain model, with n draws of its noise."""
    none = weighed.none.marginal
    slope, mean = _linear(none.comparison, none.best)
    levels_x, log_weight, true = _noise_levels(none, n)
    noise = _sd(none.comparison, true) * rng.standard_normal((n, len(mean)))
    names = tuple(dict.fromkeys(line.cause for line in lines))
    without = tuple(dict.fromkeys(t.hypothesis.cause for t in weighed.tested if _has_no_line(t)))
    levels = []
    for x, log_w in zip(levels_x, log_weight, strict=True):
        covariance = _covariance(none.comparison, x) + slope @ slope.T
        plain = _Gaussians.of(mean, covariance[None], float(log_w))
        root = plain.roots[0]
        of_causes = [[_nodes(line, root) for line in lines if line.cause == name] for name in names]
        flat = [of_line for of_cause in of_causes for of_line in of_cause]
        ends = np.cumsum([0, *(sum(len(t) for t, _ in of_cause) for of_cause in of_causes)])
        nodes = np.concatenate([np.empty((0, len(mean))), *(t for t, _ in flat)])
        log_prior = np.concatenate([np.empty(0), *(p for _, p in flat)])
        y = (noise - mean) @ root.T
        levels.append(
            _Level(
                plain,
                nodes,
                log_prior - 0.5 * np.sum(nodes**2, axis=1),
                np.exp(np.clip(y @ nodes.T, -_LARGEST_EXPONENT, _LARGEST_EXPONENT)),
                tuple(slice(a, b) for a, b in pairwise(ends)),
                tuple(
                    tuple(
                        _densities(t, none, x, float(log_w))
                        for t in weighed.tested
                        if t.hypothesis.cause == cause
                    )
                    for cause in without
                ),
            )
        )
    causes = (*names, *without)
    prior = prior_by_cause([t.hypothesis for t in weighed.tested])
    prior = {name: weighed.prior.get(name, prior[name]) for name in causes}
    middle = len(levels) // 2
    root, sd = levels[middle].plain.roots[0], _sd(none.comparison, levels_x[middle : middle + 1])[0]
    paths = _paths([line for name in names for line in lines if line.cause == name], root, sd)
    material = tuple(
        (causes.index(t.hypothesis.cause), _densities(t, none, levels_x[middle], 0.0).roots[0])
        for t in weighed.tested
        if t.hypothesis.other_material
    )
    each = np.array(list(prior.values()))
    return LinearOracle(causes, each, noise, tuple(levels), root, sd, paths, material)


def _paths(lines: Sequence[ShiftLine], root: Array, sd: Array) -> _Paths:
    nodes = [_nodes(line, root, _DIRECTION_SD)[0] for line in lines]
    back = np.linalg.inv(root.T) / sd
    visible = [np.linalg.norm(t, axis=1) >= ABSORBED * np.linalg.norm(t @ back, axis=1) for t in nodes]
    starts = np.cumsum([0, *(len(t) for t in nodes[:-1])])
    names = [line.cause for line in lines]
    firsts = [i for i, name in enumerate(names) if not i or name != names[i - 1]]
    empty = np.empty((0, len(sd)))
    return _Paths(
        np.concatenate([empty, *nodes]),
        np.concatenate([np.empty(0, dtype=bool), *visible]),
        starts,
        np.array(firsts, dtype=int),
    )


def _has_no_line(t: Tested) -> bool:
    return t.hypothesis.cause in (NONE, OTHER) or t.hypothesis.other_material


def _linear(comparison: Comparison, x: Array) -> tuple[Array, Array]:
    """d ln f / d z of the constants (n_f, n_free), and the mean (n_f,) of ln f - ln f(x) over their prior."""
    free = np.delete(np.arange(len(x)), comparison.nuisance)
    x = np.clip(x, comparison.parameters.lower, comparison.parameters.upper)
    z = comparison.scores.to_z(x[None])
    f, slope = comparison.predict(x[None], jacobian=True)
    assert slope is not None
    by_score = (slope[0] * comparison.scores.slope(x[None], z)[0] / f[0][:, None])[:, free]
    return by_score, -by_score @ z[0, free]


def _sd(comparison: Comparison, x: Array) -> Array:
    """Noise (m, n_f) of the log frequencies at parameters (m, n)."""
    return np.asarray(np.sqrt(comparison.variance(x)) / comparison.listed.frequencies)


def _covariance(comparison: Comparison, x: Array) -> Array:
    """Of the log frequencies at parameters (n,), (n_f, n_f)."""
    f = comparison.listed.frequencies
    return np.asarray(comparison.covariance(x[None])[0] / np.outer(f, f))


def _noise_levels(none: Marginal, n: int) -> tuple[Array, Array, Array]:
    """Parameters (a, n_x) to integrate evidences over, logs of their prior weights, (n, n_x) of the truth.

    The plain model's optimum, with other amplitudes of an inferred noise: those of the truth are drawn from
    their posterior, evidences have its median times common factors.
    """
    comparison, columns = none.comparison, [c for c in none.comparison.amplitudes if c >= 0]
    true = np.tile(none.best, (n, 1))
    if not columns:
        return none.best[None], np.zeros(1), true
    draws = none.resampled(n)[:, columns]
    low, high = np.quantile(draws, (0.05, 0.95), axis=0)
    true[:, columns] = np.clip(draws, low, high)
    middle = np.median(draws, axis=0)
    priors = [comparison.parameters.parameters[c].prior for c in columns]
    least = max(_BELOW * (low / middle).min(), max(p.lower / m for p, m in zip(priors, middle, strict=True)))
    most = min(_ABOVE * (high / middle).max(), min(p.upper / m for p, m in zip(priors, middle, strict=True)))
    factor = np.geomspace(least, most, _AMPLITUDES)
    levels = np.tile(none.best, (_AMPLITUDES, 1))
    levels[:, columns] = factor[:, None] * middle
    log_weight = np.log(np.gradient(factor))
    for column, prior in zip(columns, priors, strict=True):
        log_weight += prior.log_density(np.clip(levels[:, column], prior.lower, prior.upper))
    return levels, log_weight, true


def _densities(t: Tested, none: Marginal, at: Array, log_weight: float) -> _Gaussians:
    """Of the residuals under a hypothesis that scatters them, or lets the constants vary more.

    at : (n,) parameters of the plain model, with a level of the noise
    """
    log_weight += float(np.log(t.hypothesis.prior))
    comparison = t.marginal.comparison
    x = comparison.carried(none.comparison, at)
    slope, mean = _linear(comparison, x)
    if comparison.discrepancy is None:
        covariances = _covariance(comparison, x)[None]
    else:
        probability = (np.arange(_DISCREPANCIES) + 0.5) / _DISCREPANCIES
        each = np.tile(x, (_DISCREPANCIES, 1))
        each[:, comparison.discrepancy] = t.hypothesis.parameters[0].prior.ppf(probability)
        covariances = np.stack([_covariance(comparison, row) for row in each])
    return _Gaussians.of(mean, covariances + slope @ slope.T, log_weight)


def _nodes(line: ShiftLine, root: Array, apart: float = _APART_SD) -> tuple[Array, Array]:
    """Nodes (k, n_f) of a line times a root of the precision, and logs (k,) of their prior weights.

    They are evenly spread over the path that the data see, and over the scores where that is short.
    """
    path = line.shift @ root.T
    near = np.linalg.norm(path, axis=1) < _FARTHEST_SD
    step = np.linalg.norm(np.diff(path, axis=0), axis=1) / apart
    step = np.hypot(np.where(near[1:] | near[:-1], step, 0.0), np.diff(line.score) / _APART_SCORES)
    at = np.concatenate(([0.0], np.cumsum(step)))
    place = np.interp(np.linspace(0.0, at[-1], int(np.ceil(at[-1])) + 1), at, np.arange(len(at)))
    i = np.minimum(place.astype(int), len(at) - 2)
    part = place - i
    score = line.score[i] + part * (line.score[i + 1] - line.score[i])
    nodes = path[i] + part[:, None] * (path[i + 1] - path[i])
    log_weight = np.log(np.gradient(score)) - 0.5 * score**2 - 0.5 * np.log(2 * np.pi) + line.log_prior
    norm = np.linalg.norm(nodes, axis=1)
    kept = norm < max(_FARTHEST_SD, 1.001 * norm.min())
    return nodes[kept], log_weight[kept]
