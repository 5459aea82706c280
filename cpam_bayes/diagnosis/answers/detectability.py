"""Detection limit of each cause: the smallest size that simulated lists would have shown, by a linear model.

About the plain model's optimum the log frequencies are linear in the constants, which are integrated within
their priors in closed form; a cause at one of its places shifts the frequencies along a line. With y the
whitened residuals and t a whitened node of a line, the evidence of a cause over
that of the plain model is sum_k p_k exp(y.t_k - t_k.t_k / 2). For y = noise + shift this is a matrix product
of exp(noise.t_k) and exp(shift.t_k - t_k.t_k / 2), so that all draws of the noise share the work for every
size.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.sampled import shared_out
from cpam_bayes.diagnosis.evidence.weighing import Tested, Weighed
from cpam_bayes.diagnosis.hypotheses import (
    CLAIM_RULES,
    DISCREPANCY,
    NONE,
    OTHER,
    SET,
    causes_in,
    prior_by_cause,
)
from cpam_bayes.diagnosis.signatures import ABSORBED, ALIKE, AS_WELL, HARDLY
from cpam_bayes.inference.laplace import SIZE_RANGE
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.student_mixture import log_sum_exp
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter
from cpam_bayes.running import single_blas_thread

# Scores of the size at which shifts at a place are computed.
_SCORES = np.linspace(-SIZE_RANGE, SIZE_RANGE, 19)
# Interpolated scores of a line, and places at which a cause is taken, log2.
_FINE = 289
_LOG2_PLACES = 4
# Scores by which a second size differs from the first, and weights of a standard normal there.
_OFFSETS = np.array([-1.5, -0.5, 0.0, 0.5, 1.5])


@dataclass(frozen=True, slots=True)
class ShiftLine:
    """Shifts of the log frequencies by a cause at one place, at the plain model's optimum.

    log_prior : of the cause and the place
    score : (k,) normal scores of the size
    size : (k,) its distance from the value that gives back the plain model, SI
    shift : (k, n_f)
    """

    cause: str
    log_prior: float
    score: Array
    size: Array
    shift: Array


def shift_lines(tested: Sequence[Tested], none: Marginal) -> tuple[ShiftLine, ...]:
    """Shift lines of all single hypotheses that leave the pairing of modes unchanged."""
    lines: list[ShiftLine] = []
    for t in tested:
        h = t.hypothesis
        if h.family == SET or h.cause in (NONE, OTHER) or not h.parameters or t.shift is None:
            continue
        one = len(h.parameters) == 1
        lines += _line(t, t.shift.scores[:, 0], t.shift.shift) if one else _at_places(t, none)
    return tuple(lines)


def _line(t: Tested, score: Array, shift: Array, log_prior: float = 0.0) -> list[ShiftLine]:
    """Shift line interpolated between the shifts at some scores, smooth in the size itself."""
    prior = t.hypothesis.parameters[0].prior
    x = prior.from_normal(score)
    new = np.diff(x, prepend=-np.inf) > 0.0
    if new.sum() < 2:
        return []
    score, x, shift = score[new], x[new], shift[new]
    fine = np.linspace(score[0], score[-1], _FINE)
    at = np.clip(prior.from_normal(fine), x[0], x[-1])
    log_prior += float(np.log(t.hypothesis.prior))
    curve = PchipInterpolator(x, shift, axis=0)(at)
    null = t.hypothesis.parameters[0].null
    return [ShiftLine(t.hypothesis.cause, log_prior, fine, at - (null or 0.0), np.asarray(curve))]


def _at_places(t: Tested, none: Marginal) -> list[ShiftLine]:
    """Shift lines at several places or, for two sizes at once, at several ratios of them."""
    comparison, parameters = t.marginal.comparison, t.hypothesis.parameters
    further = parameters[1:]
    places = [k for k, p in enumerate(further) if p.prior.is_range]
    sizes = [k for k in range(len(further)) if k not in places]
    n = 2**_LOG2_PLACES if places else 1
    where = np.zeros((n, len(further)))
    if places:
        where[:, places] = ndtri(qmc.Sobol(len(places), seed=0).random_base2(_LOG2_PLACES))
    offsets = _OFFSETS if sizes else np.zeros(1)
    log_fraction = -0.5 * offsets**2
    log_fraction -= np.log(np.exp(log_fraction).sum())
    plain = comparison.carried(none.comparison, none.best)
    lines: list[ShiftLine] = []
    for place in where:
        for offset, fraction in zip(offsets, log_fraction, strict=True):
            z = np.tile(place, (len(_SCORES), 1))
            z[:, sizes] = _SCORES[:, None] + offset
            x = np.tile(plain, (len(_SCORES), 1))
            x[:, t.columns[0]] = parameters[0].prior.from_normal(_SCORES)
            for k, (p, column) in enumerate(zip(further, t.columns[1:], strict=True)):
                x[:, column] = p.prior.from_normal(z[:, k])
            bare = x[:1].copy()
            for p, column in zip(parameters, t.columns, strict=True):
                if not p.prior.is_range:
                    bare[:, column] = 0.0 if p.null is None else p.null
            inside, f, _ = comparison.predict_inside(np.vstack((bare, x)))
            if len(inside) < 2 or inside[0] != 0:
                continue
            with np.errstate(invalid="ignore", divide="ignore"):
                shift = np.log(f[1:]) - np.log(f[0])
            known = np.isfinite(shift).all(axis=1)
            score = _SCORES[inside[1:] - 1]
            lines += _line(t, score[known], shift[known], float(fraction) - float(np.log(n)))
    return lines


# Nodes of a line: largest spacing in standard deviations of the data and in scores, and the distance from the
# plain model beyond which none are needed.
_APART_SD, _APART_SCORES, _FARTHEST_SD = 1.6, 0.9, 50.0
# Largest spacing, standard deviations, of nodes whose directions are compared.
_DIRECTION_SD = 0.8
# Amplitudes of an inferred noise over which evidences are integrated, and how far they reach beyond the true
# ones: a large noise explains a shift too.
_AMPLITUDES, _BELOW, _ABOVE = 8, 0.6, 10.0
# Midpoints of equal parts of a discrepancy's prior.
_DISCREPANCIES = 8
_LARGEST_EXPONENT = 680.0


@dataclass(frozen=True, slots=True)
class _Gaussians:
    """Weighted normal densities of residuals of the log frequencies (n_f,).

    log_weight : (g,) with the constants of the densities
    means : (g, n_f)
    roots : (g, n_f, n_f), root^T root the precision
    """

    log_weight: Array
    means: Array
    roots: Array

    @staticmethod
    def of(mean: Array, covariances: Array, log_weight: float) -> _Gaussians:
        """Equally probable densities with one mean and covariances (g, n_f, n_f)."""
        factor = np.linalg.cholesky(covariances)
        log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        each = log_weight - log_det - float(np.log(len(covariances)))
        return _Gaussians(each, np.tile(mean, (len(covariances), 1)), np.linalg.inv(factor))

    @staticmethod
    def joined(parts: Sequence[_Gaussians]) -> _Gaussians:
        """Concatenation of several groups of densities, in this order."""
        each = ([getattr(g, name) for g in parts] for name in ("log_weight", "means", "roots"))
        return _Gaussians(*(np.concatenate(of) for of in each))


@dataclass(frozen=True, slots=True)
class _Level:
    """Precomputed terms of the evidences at one level of the noise.

    root : (n_f, n_f) of the precision of the plain model
    nodes : (k, n_f) of all lines, whitened by this root, grouped by cause
    log_prior : (k,) of the nodes, minus half their squared norms
    factors : (n, k_c) exp(y . nodes) of the simulated noise for the nodes of each cause
    densities : of the residuals, under the plain model and then under each cause that has no line
    firsts : indices of the first densities of these causes
    white : (g, n, n_f) the simulated noise, centred and whitened by the root of each density
    """

    root: Array
    nodes: Array
    log_prior: Array
    factors: tuple[Array, ...]
    densities: _Gaussians
    firsts: Array
    white: Array

    def log_evidences(self, shift: Array) -> Array:
        """Log evidences (n_causes, n, m) of all causes for the simulated noise and shifts (m, n_f)."""
        turned = shift @ np.swapaxes(self.densities.roots, 1, 2)
        exponent = self.densities.log_weight[:, None] - 0.5 * np.sum(turned**2, axis=2)
        each = exponent[:, None] - self.white @ np.swapaxes(turned, 1, 2)
        each -= 0.5 * np.sum(self.white**2, axis=2, keepdims=True)
        plain, others = each[0], each[1:]
        exponent = self.nodes @ (shift @ self.root.T).T + self.log_prior[:, None]
        top = exponent.max(axis=0, initial=-np.inf)
        weight = np.exp(exponent - top)
        n_lines, start = len(self.factors), 0
        evidences = np.empty((n_lines + len(self.firsts), *plain.shape))
        for evidence, factor in zip(evidences, self.factors, strict=False):
            np.matmul(factor, weight[start : start + factor.shape[1]], out=evidence)
            start += factor.shape[1]
        with np.errstate(divide="ignore"):
            evidences[:n_lines] = np.log(evidences[:n_lines]) + (top + plain)
        highest = np.maximum.reduceat(others, self.firsts)
        others = np.exp(others - np.repeat(highest, np.diff(self.firsts, append=len(others)), axis=0))
        evidences[n_lines:] = np.log(np.add.reduceat(others, self.firsts)) + highest
        return evidences


@dataclass(frozen=True, slots=True)
class LinearOracle:
    """Evidences of all hypotheses for lists simulated about the plain model's optimum.

    causes : in the order of the evidences, none and other among them
    prior : (n_causes,) of each
    noise : (n, n_f) simulated noise of the log frequencies
    levels : of the noise in the evidences
    root : (n_f, n_f) of the precision at a typical level of the noise
    sd : (n_f,) of the log frequencies there
    paths : the nodes of every line, whitened by that root
    material : indices of the causes of another material, and the roots of their precisions
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
        return log_sum_exp(np.stack([level.log_evidences(shift) for level in self.levels]), axis=0)

    def alike(self, shift: Array) -> Array:
        """Mask (n_causes, m) of causes that cannot be distinguished from the one with shifts (m, n_f).

        By the rules of `signatures`: the cosine with the nearest shift of the cause, the constants' part
        removed from both, or an equally good fit without noise.
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
    """Whitened nodes of all lines.

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
        """Largest cosine with targets (m, n_f) and least squared distance of a node, (n_causes, m) each."""
        if not len(self.starts):
            return np.zeros((0, len(target))), np.zeros((0, len(target)))
        norm, size = np.linalg.norm(self.nodes, axis=1), np.linalg.norm(target, axis=1)
        product = self.nodes @ target.T
        distance = norm[:, None] ** 2 - 2.0 * product
        of_cause = np.minimum.reduceat(distance, self.starts[self.firsts]) + size**2
        # negligible shifts have no direction; a line of only these is taken at its end
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
    """Oracle about the optimum of the plain model, with n draws of its noise."""
    none = weighed.none.marginal
    slope, mean = _linear(none.comparison, none.best)
    levels_x, log_weight, true = _noise_levels(none, n)
    noise = _sd(none.comparison, true) * rng.standard_normal((n, len(mean)))
    names = tuple(dict.fromkeys(line.cause for line in lines))
    without = tuple(dict.fromkeys(t.hypothesis.cause for t in weighed.tested if _has_no_line(t)))
    of_others = [
        [
            _densities(t, none, levels_x, log_weight)
            for t in weighed.tested
            if t.hypothesis.cause == cause and _has_no_line(t)
        ]
        for cause in without
    ]
    levels = []
    for number, (x, log_w) in enumerate(zip(levels_x, log_weight, strict=True)):
        covariance = _covariance(none.comparison, x[None]) + slope @ slope.T
        plain = _Gaussians.of(mean, covariance, float(log_w))
        root = plain.roots[0]
        of_causes = [[_nodes(line, root) for line in lines if line.cause == name] for name in names]
        flat = [of_line for of_cause in of_causes for of_line in of_cause]
        ends = np.cumsum([0, *(sum(len(t) for t, _ in of_cause) for of_cause in of_causes)])
        nodes = np.concatenate([np.empty((0, len(mean))), *(t for t, _ in flat)])
        log_prior = np.concatenate([np.empty(0), *(p for _, p in flat)])
        exponent = np.clip((noise - mean) @ root.T @ nodes.T, -_LARGEST_EXPONENT, _LARGEST_EXPONENT)
        others = [_Gaussians.joined([of_level[number] for of_level in of_cause]) for of_cause in of_others]
        densities = _Gaussians.joined([plain, *others])
        levels.append(
            _Level(
                root,
                nodes,
                log_prior - 0.5 * np.sum(nodes**2, axis=1),
                tuple(np.exp(exponent[:, a:b]) for a, b in pairwise(ends)),
                densities,
                np.cumsum([0, *(len(g.means) for g in others[:-1])]),
                (noise - densities.means[:, None]) @ np.swapaxes(densities.roots, 1, 2),
            )
        )
    causes = (*names, *without)
    prior = prior_by_cause([t.hypothesis for t in weighed.tested])
    prior = {name: weighed.prior.get(name, prior[name]) for name in causes}
    middle = len(levels) // 2
    root, sd = levels[middle].root, _sd(none.comparison, levels_x[middle : middle + 1])[0]
    paths = _paths([line for name in names for line in lines if line.cause == name], root, sd)
    material = tuple(
        (causes.index(t.hypothesis.cause), _densities(t, none, levels_x, log_weight)[middle].roots[0])
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
    is_one_step = t.shift is not None and not t.hypothesis.parameters
    return t.hypothesis.cause in (NONE, OTHER) or t.hypothesis.other_material or is_one_step


def _linear(comparison: CorrelatedDensity, x: Array) -> tuple[Array, Array]:
    """d ln f / d z of the constants (n_f, n_free), and the mean (n_f,) of ln f - ln f(x) over their prior."""
    free = np.delete(np.arange(len(x)), comparison.nuisance)
    x = np.clip(x, comparison.parameters.lower, comparison.parameters.upper)
    z = comparison.scores.to_z(x[None])
    f, slope = comparison.predict(x[None], jacobian=True)
    assert slope is not None
    by_score = (comparison.scores.by_score(slope, x[None], z)[0] / f[0][:, None])[:, free]
    return by_score, -by_score @ z[0, free]


def _sd(comparison: CorrelatedDensity, x: Array) -> Array:
    """Standard deviations (m, n_f) of the log frequencies at parameters (m, n)."""
    return np.asarray(np.sqrt(comparison.variance(x)) / comparison.listed.frequencies)


def _covariance(comparison: CorrelatedDensity, x: Array) -> Array:
    """Covariance of the log frequencies at parameters (m, n), (m, n_f, n_f)."""
    f = comparison.listed.frequencies
    return np.asarray(comparison.covariance(x) / np.outer(f, f))


def _noise_levels(none: Marginal, n: int) -> tuple[Array, Array, Array]:
    """Parameters (a, n_x) for the evidences, their log prior weights, and true parameters (n, n_x).

    All are the plain model's optimum with other amplitudes of an inferred noise: true ones are drawn from
    their posterior, those of the evidences are its median times common factors.
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


def _densities(t: Tested, none: Marginal, at: Array, log_weight: Array) -> list[_Gaussians]:
    """Densities of the residuals at every level of the noise, under a hypothesis without a line.

    Such a hypothesis scatters them, lets the constants vary more, or shifts them by one step.

    at : (a, n) parameters of the plain model, which differ by the amplitudes of the noise
    log_weight : (a,)
    """
    comparison = t.marginal.comparison
    x = comparison.carried(none.comparison, at)
    slope, mean = _linear(comparison, x[0])
    if t.shift is not None:
        mean = mean + t.shift.shift[0]
    each = x[:, None]
    if comparison.discrepancy is not None:
        probability = (np.arange(_DISCREPANCIES) + 0.5) / _DISCREPANCIES
        each = np.tile(each, (1, _DISCREPANCIES, 1))
        each[:, :, comparison.discrepancy] = DISCREPANCY.prior.ppf(probability)
    return [
        _Gaussians.of(mean, _covariance(comparison, rows) + slope @ slope.T, log_w)
        for rows, log_w in zip(each, log_weight + np.log(t.hypothesis.prior), strict=True)
    ]


def _nodes(line: ShiftLine, root: Array, apart: float = _APART_SD) -> tuple[Array, Array]:
    """Nodes (k, n_f) of a line, whitened by a root of the precision, and their log prior weights (k,).

    They are evenly spread over the whitened path, and over the scores where that is short.
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


# Probability with which the smallest size would have been claimed.
POWER = 0.95
# Simulated lists, common to all sizes, and the seed of their noise.
_DRAWS, _SEED = 100, 20
# First and last visible shift at which sizes are tried, standard deviations of the data; their number, and
# that of further ones between the two that enclose the answer.
_FIRST_SD, _LAST_SD, _COARSE, _BETWEEN = 2.0, 40.0, 8, 5
# Places of a cause that are tried, of which the median counts; fewer where it may be on one plate or another.
_PLACES = 5
# Shifts of opposite sizes that differ by less than this fraction are the same.
_EVEN = 1e-3


@dataclass(frozen=True, slots=True)
class Detectable:
    """Detection limit of one cause in these lists.

    parameter : its size, ``None`` for a cause that has none
    smallest : least distance of the size from its null, SI, at which the cause or its class would have been
        claimed with probability `POWER`, of either sign and at the median place; ``None`` where no size would
    probability_of_claim : at that size, or at the best one
    """

    cause: str
    parameter: Parameter | None
    smallest: float | None
    probability_of_claim: float | None


@single_blas_thread
def detectable(
    weighed: Weighed, cases: Sequence[PlateCase] = (), executor: Executor | None = None
) -> tuple[Detectable, ...]:
    """Smallest detectable size of every single cause that was tested, in the order of their probability.

    The lists are simulated at the plain model's optimum with a cause of some size and noise as stated, or
    from the posterior of the repeatability; a claim is made as for the lists themselves (`linear_oracle`).
    Incomplete lists have their most probable pairing under the plain model.

    cases, executor : the plates, and where the causes are processed
    """
    weighed = weighed.in_plain_pairing()
    lines = shift_lines(weighed.tested, weighed.none.marginal)
    oracle = linear_oracle(weighed, lines, _DRAWS, np.random.default_rng(_SEED))
    wanted: list[tuple[LinearOracle, str, Parameter | None, list[ShiftLine]]] = []
    for cause in weighed.by_cause():
        if cause in (NONE, OTHER) or len(causes_in(cause)) > 1:
            continue
        variants = [t.hypothesis for t in weighed.tested if t.hypothesis.cause == cause]
        # a frequency far off is one of another mode: such a variant has no size
        size_of = next((h.parameters[0] for h in variants if h.parameters), None)
        of_plates = len({t.plates for t in weighed.tested if t.hypothesis.cause == cause})
        some = _spread([line for line in lines if line.cause == cause], max(_PLACES // of_plates, 1))
        wanted.append((oracle, cause, size_of, some))
    return tuple(shared_out(_detectable, cases, wanted, executor, common=oracle))


def _detectable(
    oracle: LinearOracle, cause: str, size_of: Parameter | None, some: list[ShiftLine]
) -> Detectable:
    by_place = [_worse_sign(oracle, line) for line in some]
    if not by_place:
        return Detectable(cause, size_of, None, None)
    size, power = sorted(by_place)[len(by_place) // 2]
    return Detectable(cause, size_of, size if np.isfinite(size) else None, power)


def _spread(lines: list[ShiftLine], most: int) -> list[ShiftLine]:
    """At most ``most`` lines of a cause, evenly spread over its places."""
    if len(lines) <= most:
        return lines
    return [lines[i] for i in np.linspace(0, len(lines) - 1, most).round().astype(int)]


def _worse_sign(oracle: LinearOracle, line: ShiftLine) -> tuple[float, float]:
    """Smallest detectable size of the worse sign, infinite if one sign is not detected, and its power."""
    by_sign = []
    mirrored = np.abs(line.shift[::-1] - line.shift).max() < _EVEN * np.abs(line.shift).max()
    for side in (line.size > 0.0, (line.size < 0.0) & (not mirrored)):
        rows = np.flatnonzero(side)
        rows = rows[np.argsort(np.abs(line.size[rows]), kind="stable")]
        if len(rows) > 1:
            by_sign.append(_smallest(oracle, line.cause, np.abs(line.size[rows]), line.shift[rows]))
    return max(by_sign, key=lambda entry: (entry[0], -entry[1]), default=(np.inf, 0.0))


def _smallest(oracle: LinearOracle, cause: str, size: Array, shift: Array) -> tuple[float, float]:
    """Smallest of ascending sizes (k,) with shifts (k, n_f) that is claimed with `POWER`, and its power."""
    seen = np.maximum.accumulate(np.linalg.norm(shift @ oracle.root.T, axis=1))
    seen += 1e-9 * np.arange(len(seen))
    high = min(_LAST_SD, seen[-1])
    low = max(min(_FIRST_SD, 0.5 * high), seen[0])
    at = np.geomspace(low, high, _COARSE)
    for more in (_BETWEEN, 0):
        place = np.interp(at, seen, np.arange(len(seen)))
        power = _power(oracle, cause, _between(shift, place))
        enough = np.flatnonzero(power >= POWER)
        if not len(enough):
            return np.inf, float(power.max())
        first = int(enough[0])
        if not first or not more:
            break
        at = np.linspace(at[first - 1], at[first], more)
    if first:  # the power grows nearly linearly between the two
        part = (POWER - power[first - 1]) / (power[first] - power[first - 1])
        place = place[first - 1] + part * (place[first] - place[first - 1]) * np.ones(1)
        return float(_between(size, place)[0]), POWER
    return float(_between(size, place)[0]), float(power[0])


def _between(values: Array, place: Array) -> Array:
    """Values (m, ...) interpolated in (k, ...) at fractional rows (m,)."""
    i = np.minimum(place.astype(int), len(values) - 2)
    part = (place - i).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[i] + part * (values[i + 1] - values[i]))


def _power(oracle: LinearOracle, cause: str, shift: Array) -> Array:
    """Fraction of the simulated lists with shifts (m, n_f) of a cause that claim it or its class, (m,)."""
    log_weight = oracle.log_weights(shift)
    log_weight -= log_weight.max(axis=0)
    members = oracle.alike(shift) | np.array([name == cause for name in oracle.causes])[:, None]
    inside, outside = members[:, None], ~members[:, None]
    weight = np.exp(log_weight)
    claimed = np.where(inside, weight, 0.0)
    if members.sum(axis=0).max() > CLAIM_RULES.most:
        claimed = -np.partition(-claimed, CLAIM_RULES.most - 1, axis=0)[: CLAIM_RULES.most]
    probability = claimed.sum(axis=0) / weight.sum(axis=0)
    log_evidence = log_weight - np.log(oracle.prior)[:, None, None]
    best, outsider = (np.where(of, log_evidence, -np.inf).max(axis=0) for of in (inside, outside))
    return np.asarray(
        ((probability >= CLAIM_RULES.sure) & (best >= outsider + CLAIM_RULES.clear)).mean(axis=0)
    )
