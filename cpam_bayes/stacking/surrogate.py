"""The log evidence of every stacking sequence as a smooth function of its ply sums.

Gaussian processes give the scores whose squares make up the evidence, with derivatives. Their tangents on
cells of the bending lamination parameters are the piecewise-linear surrogate, fast enough to enumerate
billions of sequences.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.optimize import minimize

from cpam_bayes.parallel import run
from cpam_bayes.stacking.conditional import ConditionalPosterior
from cpam_bayes.stacking.evaluation import NEAR, Evaluated
from cpam_bayes.stacking.symmetry import PlySums

Array = NDArray[Any]

# Points from which length scales are estimated: more change them little.
_SCALES_FROM = 400
# Bounds of the length scales in standard deviations of the points, and of the nugget's variance; its start.
_LENGTHS, _NUGGETS, _NUGGET = (0.2, 200.0), (1e-8, 0.3), 1e-4
# Growth of the number of points after which length scales are estimated again.
_GROWTH = 1.25
# Points predicted at a time: their kernel fits in the processor's cache.
_ROWS = 128
# (m, 4 + n_q) sums -> scores and rest (m, n_z + 1) with their gradients (m, n_z + 1, 4 + n_q).
Tangent = Callable[[Array], tuple[Array, Array]]
# Cells along an axis, from -1 to 1, before any is halved.
_FIRST = 12
# Cells that stay farther below the top than this, nats, are halved only once.
_REFINED_DEPTH_NATS = 6.0
# Cells per task of a worker, and batches that are gathered: memory in many small pieces is not returned to
# the system.
_BATCH, _GATHERED = 8192, 64
# Factors on the half-width and on the slack of a cell that may be halved: its tangent is less accurate.
_COARSE_WIDTH, _COARSE_SLACK = 1.5, 3.0
# Depth below the best, nats, to which a lower log evidence is raised.
_MAX_DEPTH_NATS = 45.0
# Root mean square of the relative residuals above which fits are left out: they do not inform the top.
_MAX_RMS_RESIDUAL = 0.2
# Root mean square of the scores above which the nugget grows: such sequences need no close fit.
_POOR_RMS_SCORE = 10.0
# Quantile of the residuals of sequences near the top that is the unit where the noise is inferred.
_UNIT_QUANTILE = 0.1
# Least unit of relative residuals: below it a list without noise is as good as exact.
_MIN_UNIT = 1e-5
# Least length scales, in standard deviations, of the lamination parameters and of the further sums, whose
# whole range is spanned by every cell of a piecewise-linear surrogate.
_MIN_LENGTHS = (0.2, 5.0)


@dataclass(frozen=True, slots=True)
class GaussianProcess:
    """f(x) = mean + sum_i k(x, x_i) a_i, outputs in columns.

    k(x, y) = sum_s exp(-|(s x - y) / l|^2 / 2), the sum over the changes of sign under which
    f(s x) = f(x), the identity among them.

    points : (N, d) in units of the length scales.
    coefficients : (N, p).
    mean : (p,).
    lengths : (d,) length scales.
    images : (n_images, d) signs, the first row all ones.
    factor : (N, N) lower Cholesky factor of the points' covariance.
    amplitude : (p,) prior standard deviations of the functions.
    nugget : variance of the part that is not smooth, relative to that.
    training_size : number of points from which the length scales were estimated.
    """

    points: Array
    coefficients: Array
    mean: Array
    lengths: Array
    images: Array
    factor: Array
    amplitude: Array
    nugget: float
    training_size: int

    def values(self, x: Array) -> Array:
        """Functions (m, p) at points (m, d)."""
        value = np.empty((len(x), len(self.mean)))
        for i in range(0, len(x), _ROWS):
            at = x[i : i + _ROWS] / self.lengths
            value[i : i + _ROWS] = sum(_kernel(at * s, self.points) for s in self.images) @ self.coefficients
        return value + self.mean

    def error(self, x: Array) -> Array:
        """Posterior standard deviations (m, p) of the functions at points (m, d)."""
        at = x / self.lengths
        prior = sum(np.exp(-0.5 * np.sum((at * s - at) ** 2, axis=1)) for s in self.images)
        covariance = np.sum([_kernel(at * s, self.points) for s in self.images], axis=0)
        explained = scipy.linalg.solve_triangular(self.factor, covariance.T, lower=True)
        variance = np.maximum(prior - np.sum(explained**2, axis=0), 0.0)
        return np.asarray(np.sqrt(variance)[:, None] * self.amplitude)

    def expansion(self, x: Array) -> tuple[Array, Array]:
        """Functions (m, p) and their gradients (m, p, d) at points (m, d)."""
        p, d = self.coefficients.shape[1], x.shape[1]
        weighted = (self.coefficients[:, :, None] * self.points[:, None, :]).reshape(len(self.points), -1)
        both = np.column_stack((self.coefficients, weighted))
        value, slope = np.zeros((len(x), p)), np.zeros((len(x), p, d))
        for i in range(0, len(x), _ROWS):
            at = x[i : i + _ROWS] / self.lengths
            for sign in self.images:
                image = at * sign
                sums = _kernel(image, self.points) @ both
                value[i : i + _ROWS] += sums[:, :p]
                moment = sums[:, p:].reshape(len(at), p, d)
                slope[i : i + _ROWS] += (moment - sums[:, :p, None] * image[:, None, :]) * sign / self.lengths
        return value + self.mean, slope


def fit_gaussian_process(
    points: Array,
    values: Array,
    rng: np.random.Generator,
    images: Array | None = None,
    like: GaussianProcess | None = None,
    min_lengths: Array | float = _LENGTHS[0],
    nugget_factor: Array | None = None,
) -> GaussianProcess:
    """Gaussian process through values (N, p) at points (N, d), length scales by maximum marginal likelihood.

    One set of length scales, one per dimension, and one nugget serve all outputs, each in units of its
    standard deviation (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, chapters 2, 5).

    images : (n_images, d) changes of sign that leave the functions unchanged, the identity first.
    like : a process through fewer points, whose length scales are a start.
    min_lengths : (d,) lower bounds of the length scales in standard deviations of the points.
    nugget_factor : (N,) factors on the nugget, 1 where a value is to be fitted closely.
    """
    n, d = points.shape
    factors = np.ones(n) if nugget_factor is None else nugget_factor
    signs = np.ones((1, d)) if images is None else images
    unit = np.maximum(points.std(axis=0), 1e-12)
    mean, spread = values.mean(axis=0), np.maximum(values.std(axis=0), 1e-12)
    y = (values - mean) / spread
    some = _scale_points(factors, rng)
    if like is not None and n < _GROWTH * like.training_size:
        lengths, nugget, training_size = like.lengths, like.nugget, like.training_size
    else:
        lengths, nugget = _scales(points[some] / unit, y[some], factors[some], signs, like, unit, min_lengths)
        training_size = n
    at = points / lengths
    matrix = np.sum([_kernel(at * s, at) for s in signs], axis=0)
    matrix[np.diag_indices(n)] += nugget * factors
    factor = scipy.linalg.cholesky(matrix, lower=True, overwrite_a=True)
    solved = scipy.linalg.cho_solve((factor, True), y)
    amplitude = spread * np.sqrt(np.sum(y * solved, axis=0) / n)
    return GaussianProcess(
        at, solved * spread, mean, lengths, signs, factor, amplitude, nugget, training_size
    )


def _scale_points(nugget_factor: Array, rng: np.random.Generator) -> Array:
    """Indices of the points for the length scales: random, but half of them those with the least nuggets."""
    some = rng.permutation(len(nugget_factor))
    surest = some[np.argsort(nugget_factor[some], kind="stable")[: _SCALES_FROM // 2]]
    return np.concatenate((surest, some[~np.isin(some, surest)]))[:_SCALES_FROM]


def _scales(
    points: Array,
    y: Array,
    nugget_factor: Array,
    signs: Array,
    like: GaussianProcess | None,
    unit: Array,
    min_lengths: Array | float,
) -> tuple[Array, float]:
    """Length scales (d,) and nugget by maximum marginal likelihood, points (N, d) being in ``unit``."""
    d = points.shape[1]
    start = np.full(d, 2.0) if like is None else like.lengths / unit
    shortest = np.broadcast_to(min_lengths, d)
    start = np.clip(start, shortest, _LENGTHS[1])
    bounds = [(np.log(a), np.log(_LENGTHS[1])) for a in shortest]
    bounds.append((np.log(_NUGGETS[0]), np.log(_NUGGETS[1])))
    optimum = minimize(
        _cost,
        np.log(np.concatenate((start, [_NUGGET]))),
        args=(points, y, nugget_factor, signs),
        jac=True,
        bounds=bounds,
        method="L-BFGS-B",
        options={"maxiter": 60 if like is None else 15},
    )
    return np.exp(optimum.x[:d]) * unit, float(np.exp(optimum.x[d]))


def _kernel(a: Array, b: Array) -> Array:
    """Kernel exp(-|a - b|^2 / 2) (m, n) of rows (m, d) and (n, d), the exponent by one matrix product."""
    left = np.column_stack((a, -0.5 * np.sum(a**2, axis=1), np.ones(len(a))))
    right = np.column_stack((b, np.ones(len(b)), -0.5 * np.sum(b**2, axis=1)))
    exponent = left @ right.T
    np.minimum(exponent, 0.0, out=exponent)
    return np.asarray(np.exp(exponent, out=exponent))


def _cost(
    log_scales: Array, points: Array, y: Array, nugget_factor: Array, signs: Array
) -> tuple[float, Array]:
    """Negative log marginal likelihood, each output's amplitude at its best, and its gradient."""
    n, p = y.shape
    d = points.shape[1]
    at = points / np.exp(log_scales[:d])
    nugget = np.exp(log_scales[d])
    images = [at * s for s in signs]
    kernels = [_kernel(image, at) for image in images]
    matrix = np.sum(kernels, axis=0)
    matrix[np.diag_indices(n)] += nugget * nugget_factor
    try:
        factor = scipy.linalg.cho_factor(matrix, lower=True)
    except np.linalg.LinAlgError:
        return 1e10, np.zeros(d + 1)
    alpha = scipy.linalg.cho_solve(factor, y)
    amplitude = np.maximum(np.sum(y * alpha, axis=0) / n, 1e-300)
    half = np.log(np.diagonal(factor[0])).sum()
    cost = 0.5 * n * np.log(amplitude).sum() + p * half
    inverse = scipy.linalg.cho_solve(factor, np.eye(n))
    weight = (p * inverse - (alpha / amplitude) @ alpha.T) * 0.5
    gradient = np.zeros(d + 1)
    for image, kernel in zip(
        images, kernels, strict=True
    ):  # sum of w_ij (x_i - y_j)^2, squares multiplied out
        w = weight * kernel
        gradient[:d] += (
            w.sum(axis=1) @ image**2 + w.sum(axis=0) @ at**2 - 2.0 * np.sum(image * (w @ at), axis=0)
        )
    gradient[d] = np.diagonal(weight) @ nugget_factor * nugget
    return float(cost), gradient


@dataclass(frozen=True, slots=True)
class PiecewiseLinearSurrogate:
    """Log evidence on cells of the four sums v; cells where it is below a lower bound are left out.

    The scores z and the rest r of ``log_evidence`` are linear in the sums on each cell.

    width : of the finest cells.
    first : (4,) number along each axis of the first cell of a box about those that were kept; the outermost
    cells of the box are empty.
    leaf : (n_1, n_2, n_3, n_4) int32, row of ``tangent`` of each cell of the box, -1 where it was left out.
    tangent : (L, n_z + 1, 1 + 4 + n_q), scores, and last the rest, extrapolated to sums of zero, and their
    gradients.
    lower_bound : log evidence that left-out cells do not exceed.
    freedom : of ``log_evidence``.
    """

    width: float
    first: Array
    leaf: Array
    tangent: Array
    lower_bound: float
    freedom: float

    def lookup(self, v: Array) -> Array:
        """Rows (m,) of ``tangent`` for points (m, 4), -1 where the cell was left out."""
        # points beyond the box count as in its outermost cells
        cell = np.clip(np.floor((v + 1.0) / self.width).astype(np.int64) - self.first, 0, self._last)
        return np.asarray(self.leaf[tuple(cell.T)])

    @property
    def _last(self) -> Array:
        return np.array(self.leaf.shape) - 1

    def rows(self, v: Array, shift: Array) -> Array:
        """Rows (m,) of ``tangent`` for points v + shift, v (4, m) and shift (4,), in single precision."""
        flat = np.zeros(v.shape[1], dtype=np.int64)
        scale = np.float32(1.0 / self.width)
        for i, n in enumerate(self.leaf.shape):
            # truncated, not floored: this differs only before the box, whose first cells are empty
            begin = np.float32(shift[i] + 1.0 - self.first[i] * self.width)
            cell = ((v[i] + begin) * scale).astype(np.int32)
            np.clip(cell, 0, n - 1, out=cell)
            flat *= n
            flat += cell
        return np.asarray(self.leaf.ravel()[flat])

    def values(self, rows: Array, sums: Array) -> Array:
        """Log evidence of points in the cells ``rows`` (m,); each row of ``sums`` is 1, v and q."""
        y = np.matmul(np.take(self.tangent, rows, axis=0), sums[:, :, None])[:, :, 0]
        return log_evidence(y.astype(np.float64), self.freedom)


def log_evidence(y: Array, freedom: float) -> Array:
    """Log evidence (m,) from scores z and rest r (m, n_z + 1).

    r - |z|^2 / 2 where the noise is known; r - n_f / 2 log(1 + |z|^2 / n_f) where the noise of n_f
    frequencies is inferred.

    freedom : infinite where the noise is known, else n_f.
    """
    square = np.einsum("mi,mi->m", y[:, :-1], y[:, :-1])
    deviance = square if np.isinf(freedom) else freedom * np.log1p(square / freedom)
    return np.asarray(y[:, -1] - 0.5 * deviance)


def piecewise_linear_surrogate(
    tangent: Tangent,
    q_bound: Array,
    top: float,
    depth: float,
    halvings: int,
    slack: float,
    freedom: float,
    executor: Executor | None = None,
) -> PiecewiseLinearSurrogate:
    """Tangents of a surrogate wherever it may exceed the lower bound, ``depth`` below ``top``.

    A cell is left out where no set of plies can lie (the Toeplitz matrix of 1, v1 + i v2, v3 + i v4 is
    not positive) or where the largest value that the tangents allow over the cell and over the range of q,
    plus ``slack``, stays below the lower bound. The others are halved ``halvings`` times, but only once where
    the tangents keep them far below the top.

    tangent : of the surrogate.
    q_bound : (n_q,) largest magnitude of each further sum.
    top, depth, slack : nats.
    freedom : of ``log_evidence``.
    """
    axis = (np.arange(_FIRST) + 0.5) * 2.0 / _FIRST - 1.0
    centre, width = _mesh(axis), 2.0 / _FIRST
    leaves: list[_Leaves] = []
    for side in (1 << np.arange(halvings + 1))[::-1]:
        last = side == 1
        half = np.concatenate((np.full(4, 0.5 * width), q_bound)) * (1.0 if last else _COARSE_WIDTH)
        level = _Level(
            tangent,
            int(side),
            width,
            half,
            keep_from=top - depth - slack * (1.0 if last else _COARSE_SLACK),
            halve_from=np.inf if last else -np.inf if side == 1 << halvings else top - _REFINED_DEPTH_NATS,
            freedom=freedom,
        )
        batches = np.split(centre, range(_BATCH, len(centre), _BATCH))
        halved = []
        for i in range(0, len(batches), _GATHERED):
            some = batches[i : i + _GATHERED]
            sorted_cells = run(_leaves_and_halved, level, some, executor, batch_size=1, is_limited=True)
            leaves.append(_gathered([kept for kept, _ in sorted_cells]))
            halved += [centres for _, centres in sorted_cells]
            del sorted_cells  # nothing is in memory twice
        centre = (np.concatenate(halved)[:, None, :] + width * _mesh(np.array([-0.25, 0.25]))).reshape(-1, 4)
        width *= 0.5
    first, leaf = _box(leaves, _FIRST << halvings)
    return PiecewiseLinearSurrogate(
        width=2.0 / (_FIRST << halvings),
        first=first,
        leaf=leaf,
        tangent=_taken(leaves),
        lower_bound=top - depth,
        freedom=freedom,
    )


@dataclass(frozen=True, slots=True)
class _Level:
    """Cells of one width, and the log evidence above which they are kept and halved.

    side : of a cell, in finest ones.
    half : (4 + n_q,) largest distance of the sums of a cell from its centre.
    keep_from : least upper bound of the log evidence of a cell that is kept.
    halve_from : least upper bound of one that is halved.
    freedom : of ``log_evidence``.
    """

    tangent: Tangent
    side: int
    width: float
    half: Array
    keep_from: float
    halve_from: float
    freedom: float


@dataclass(frozen=True, slots=True)
class _Leaves:
    """Cells that are kept as they are: ``corner`` (l, 4) and ``side`` in finest cells."""

    side: int
    corner: Array
    tangent: Array


def _leaves_and_halved(level: _Level, centre: Array) -> tuple[_Leaves, Array]:
    """Kept cells among those about centres (c, 4), in single precision, and centres of those to be halved."""
    centre = centre[_realisable(centre, level.width)]
    y, slope = level.tangent(np.column_stack((centre, np.zeros((len(centre), len(level.half) - 4)))))
    reach = np.abs(slope) @ level.half
    nearest = np.maximum(np.abs(y[:, :-1]) - reach[:, :-1], 0.0)
    upper = log_evidence(np.column_stack((nearest, y[:, -1] + reach[:, -1])), level.freedom)
    finer = (upper >= level.keep_from) & (upper >= level.halve_from)
    leaf = (upper >= level.keep_from) & ~finer
    corner = np.rint(level.side * ((centre[leaf] + 1.0) / level.width - 0.5)).astype(np.int64)
    at_zero = y[leaf] - np.einsum("lzj,lj->lz", slope[leaf, :, :4], centre[leaf])
    tangent = np.concatenate((at_zero[:, :, None], slope[leaf]), axis=2)
    return _Leaves(level.side, corner, tangent.astype(np.float32)), centre[finer]


def _gathered(leaves: list[_Leaves]) -> _Leaves:
    """Cells of one width in one record."""
    corner, tangent = (
        np.concatenate([getattr(each, name) for each in leaves]) for name in ("corner", "tangent")
    )
    return _Leaves(leaves[0].side, corner, tangent)


def _box(leaves: list[_Leaves], n: int) -> tuple[Array, Array]:
    """First cell of a box about all leaves and a rim, and the leaf of each of its cells, -1 for none.

    n : number of finest cells along an axis.
    """
    first = np.min([each.corner.min(axis=0, initial=n) for each in leaves], axis=0) - 1
    end = np.max([each.corner.max(axis=0, initial=0) + each.side for each in leaves], axis=0)
    leaf = np.full(np.maximum(end - first + 1, 1), -1, dtype=np.int32)
    begin = 0
    for each in leaves:
        rows = np.arange(begin, begin + len(each.corner), dtype=np.int32)
        for offset in _mesh(np.arange(each.side)):
            leaf[tuple((each.corner + offset - first).T)] = rows
        begin += len(rows)
    return first, leaf


def _taken(leaves: list[_Leaves]) -> Array:
    """Tangents of all leaves, which are removed from the list so that nothing is in memory twice."""
    n = sum(len(each.tangent) for each in leaves)
    tangent = np.empty((n, *leaves[0].tangent.shape[1:]), dtype=np.float32)
    while leaves:
        of_level = leaves.pop().tangent
        tangent[n - len(of_level) : n] = of_level
        n -= len(of_level)
    return tangent


def _mesh(axis: Array) -> Array:
    """All points (n^4, 4) with four coordinates from an axis (n,)."""
    return np.stack(np.meshgrid(axis, axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 4)


def _realisable(v: Array, width: float) -> Array:
    """Mask of cells about v that may hold sums of unit vectors: the Toeplitz matrix is nearly positive."""
    a, b = v[:, 0] + 1j * v[:, 1], v[:, 2] + 1j * v[:, 3]
    unit = np.ones(len(v), dtype=complex)
    rows = ((unit, a, b), (a.conj(), unit, a), (b.conj(), a.conj(), unit))
    matrix = np.stack([np.stack(row, -1) for row in rows], -2)
    # an entry moves by at most sqrt(2) width / 2, half a diagonal, and a row has two beside its unit
    return np.asarray(np.linalg.eigvalsh(matrix)[:, 0] >= -np.sqrt(2.0) * width)


@dataclass(frozen=True, slots=True)
class Surrogate:
    """An approximate log evidence over features.

    process : gives the scores of the frequencies, residuals at the best fit in standard deviations of the
    noise, or of a small noise where it is inferred, and last the rest of the log evidence, which varies
    little (``log_evidence``); if not ``scored``, log Z, compressed far below the top.
    scored : whether frequencies are paired with modes, so that they have scores.
    freedom : of ``log_evidence``.
    top : largest log evidence of the training set.
    rms_error, largest_error : on fresh draws from the posterior, nats.
    """

    process: GaussianProcess
    scored: bool
    freedom: float
    top: float
    rms_error: float
    largest_error: float

    def values(self, features: Array) -> Array:
        """Log evidence (m,) at features (m, d)."""
        y = self.process.values(features)
        return log_evidence(y, self.freedom) if self.scored else _expanded(y[:, 0], self.top)

    def upper_bound(self, features: Array) -> Array:
        """Log evidence (m,) at features (m, d), raised by two standard deviations."""
        y, sd = self.process.values(features), self.process.error(features)
        if not self.scored:
            return _expanded(y[:, 0] + 2.0 * sd[:, 0], self.top)
        z = np.maximum(np.abs(y[:, :-1]) - 2.0 * sd[:, :-1], 0.0)
        return log_evidence(np.column_stack((z, y[:, -1] + 2.0 * sd[:, -1])), self.freedom)

    def tangent(self, features: Array) -> tuple[Array, Array]:
        """Scores and rest (m, n_z + 1) at features (m, d), and their gradients (m, n_z + 1, d)."""
        y, slope = self.process.expansion(features)
        if self.scored:
            return y, slope
        return _expanded(y, self.top), slope * _expansion_slope(y, self.top)[:, :, None]


def _compressed(log_evidence: Array, top: float) -> Array:
    """Values near the top unchanged, those far below smoothly compressed."""
    return np.asarray(np.logaddexp(log_evidence, top - _MAX_DEPTH_NATS))


def _expanded(y: Array, top: float) -> Array:
    """Inverse of ``_compressed``."""
    least = top - _MAX_DEPTH_NATS
    above = np.maximum(y - least, 1e-3)
    return np.asarray(least + above + np.log1p(-np.exp(-above)))


def _expansion_slope(y: Array, top: float) -> Array:
    above = np.maximum(y - (top - _MAX_DEPTH_NATS), 1e-3)
    return np.asarray(1.0 / -np.expm1(-above))


def fit_surrogate(
    conditional: ConditionalPosterior,
    sums: PlySums,
    images: Array,
    data: Evaluated,
    rng: np.random.Generator,
    rms: float,
    largest: float,
    before: Surrogate | None,
) -> Surrogate:
    """Surrogate through evaluated sequences.

    images : (n_images, d) changes of sign of the features that change no frequency.
    before : a surrogate through fewer sequences.
    rms, largest : its error on fresh draws, nats.
    """
    like = None if before is None else before.process
    template, top = conditional.template, float(data.log_evidence.max())
    features = sums.features(data.sequences)
    min_lengths = np.where(np.arange(features.shape[1]) < 4, *_MIN_LENGTHS)
    if not template.measurement.complete:  # frequencies are not paired with modes
        y = _compressed(data.log_evidence, top)[:, None]
        process = fit_gaussian_process(features, y, rng, images, like, min_lengths)
        return Surrogate(process, False, np.inf, top, rms, largest)
    high = data.log_evidence > top - NEAR
    freedom = float(template.measurement.size) if template.noise_is_inferred else np.inf
    z = _scores(conditional, data, high)
    rms_residual = np.sqrt(np.mean(data.fits.residual**2, axis=1))
    kept = rms_residual <= max(_MAX_RMS_RESIDUAL, float(np.median(rms_residual)))
    # far below the top few points are sampled: Laplace's evidence is better there
    log_z = np.where(high, data.log_evidence, data.fits.log_evidence)
    rest = log_z - log_evidence(np.column_stack((z, np.zeros(len(z)))), freedom)
    y = np.column_stack((z, rest))[kept]
    nugget_factor = np.maximum(np.mean(z[kept] ** 2, axis=1) / _POOR_RMS_SCORE**2, 1.0)
    process = fit_gaussian_process(features[kept], y, rng, images, like, min_lengths, nugget_factor)
    return Surrogate(process, True, freedom, top, rms, largest)


def _scores(conditional: ConditionalPosterior, data: Evaluated, high: Array) -> Array:
    """Residuals (m, n_frequencies) at the best fits in standard deviations of the noise.

    An inferred noise differs from sequence to sequence and is no smooth function of their features: the
    residuals of the best of the sequences with a ``high`` evidence are then the unit.
    """
    template, residual = conditional.template, data.fits.residual
    if template.noise_is_inferred:
        rms = np.sqrt(np.mean(residual**2, axis=1))
        return np.asarray(residual / max(float(np.quantile(rms[high], _UNIT_QUANTILE)), _MIN_UNIT))
    measured = template.measurement.frequencies
    predicted = measured / (1.0 + residual)
    i = np.arange(len(measured))
    sigma = template.noise(data.fits.x, predicted)[:, i, i]
    return np.asarray((measured - predicted) / sigma)
