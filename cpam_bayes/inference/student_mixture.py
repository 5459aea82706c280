"""Mixtures of Student-t densities: density, draws, mass between bounds, fits, importance sampling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import chdtri, gammaln, log_ndtr, ndtri, ndtri_exp, stdtr, stdtrit
from scipy.stats import qmc

from cpam_bayes.mechanics.problem import Array

# Fraction of the whole that a component keeps at least, and ridge of its scale over that of all points.
_LEAST_FRACTION, _RIDGE = 0.01, 1e-6


@dataclass(frozen=True, slots=True)
class Mixture:
    """A mixture of k Student-t densities of n variables, or a stack of such mixtures.

    share : (..., k) fractions of the whole, zero for components that are not used.
    centre : (..., k, n).
    factor : (..., k, n, n), square roots of the scale matrices: factor factor^T.
    degrees_of_freedom : of all of them, infinite for Gaussians.
    """

    share: Array
    centre: Array
    factor: Array
    degrees_of_freedom: float


def log_student_t(away: Array, factor: Array, nu: float) -> Array:
    """Log density of a multivariate Student-t, or of a Gaussian where nu is infinite, (..., p).

    away : (..., p, n) from the centre.
    factor : (..., n, n) square root of the scale matrix.
    """
    n = away.shape[-1]
    squared = np.sum((away @ np.swapaxes(np.linalg.inv(factor), -1, -2)) ** 2, axis=-1)
    log_det = np.linalg.slogdet(factor)[1][..., None]
    if np.isinf(nu):
        return np.asarray(-0.5 * squared - log_det - 0.5 * n * np.log(2.0 * np.pi))
    constant = gammaln(0.5 * (nu + n)) - gammaln(0.5 * nu) - 0.5 * n * np.log(nu * np.pi)
    return np.asarray(constant - log_det - 0.5 * (nu + n) * np.log1p(squared / nu))


def log_components(mixture: Mixture, points: Array) -> Array:
    """Log of share times density of every component at points (..., p, n), (..., k, p)."""
    away = points[..., None, :, :] - mixture.centre[..., :, None, :]
    with np.errstate(divide="ignore"):
        log_share = np.log(mixture.share)
    return log_share[..., None] + log_student_t(away, mixture.factor, mixture.degrees_of_freedom)


def log_mixture(mixture: Mixture, points: Array) -> Array:
    """Log density at points (..., p, n), (..., p)."""
    return log_sum_exp(log_components(mixture, points), axis=-2)


def log_blend(mixtures: list[Mixture], sizes: list[int], points: Array) -> Array:
    """Log density at points (..., p, n) of what they were drawn from, ``sizes`` from each, (..., p).

    The deterministic mixture of adaptive importance sampling (Cornuet et al., 2012).
    """
    parts = [log_components(m, points) + np.log(size) for m, size in zip(mixtures, sizes, strict=True)]
    return log_sum_exp(np.concatenate(parts, axis=-2), axis=-2) - float(np.log(sum(sizes)))


def draw(mixture: Mixture, size: int, rng: np.random.Generator | np.random.RandomState) -> Array:
    """Independent draws of one mixture, (size, n)."""
    k, n = mixture.centre.shape
    which = rng.choice(k, size=size, p=mixture.share)
    normal = rng.standard_normal((size, n))
    nu = mixture.degrees_of_freedom
    stretch = np.sqrt(nu / rng.chisquare(nu, size=size))
    away = np.einsum("mij,mj->mi", mixture.factor[which], normal)
    return np.asarray(mixture.centre[which] + stretch[:, None] * away)


def sobol_points(mixture: Mixture, log2_points: int, part: slice = slice(None)) -> Array:
    """Points of a stack of mixtures from one scrambled Sobol sequence for all of them, (..., p, n).

    log2_points : of the sequence.
    part : which of its points.
    """
    step, uniform = _standard_points(mixture.centre.shape[-1], log2_points, mixture.degrees_of_freedom)
    below = np.cumsum(mixture.share, axis=-1)[..., None, :-1] < uniform[part, None]
    which = np.sum(below, axis=-1)
    centre = np.take_along_axis(mixture.centre, which[..., None], axis=-2)
    factor = np.take_along_axis(mixture.factor, which[..., None, None], axis=-3)
    return np.asarray(centre + np.einsum("...pij,pj->...pi", factor, step[part]))


@cache
def _standard_points(n: int, log2_points: int, nu: float) -> tuple[Array, Array]:
    """Points of a standard Student-t (2^log2_points, n), and uniform ones that choose a component."""
    uniform = qmc.Sobol(n + 2, rng=np.random.default_rng(0)).random_base2(log2_points)
    uniform = np.clip(uniform, 1e-12, 1.0 - 1e-12)
    step = ndtri(uniform[:, :n])
    if np.isfinite(nu):  # a Student-t is a Gaussian over the root of a chi-squared variable
        step = step / np.sqrt(chdtri(nu, 1.0 - uniform[:, n]) / nu)[:, None]
    return step, uniform[:, n + 1]


def single(points: Array, weights: Array, nu: float) -> Mixture:
    """One component with the mean of weighted points (m, n) and their covariance as its scale."""
    mean = weights @ points
    return Mixture(np.ones(1), mean[None], _factor(_covariance(points, weights, mean))[None], nu)


def split(mixture: Mixture, points: Array, weights: Array, components: int) -> Mixture:
    """A mixture of so many components, the largest of the given ones halved along their longest axis.

    points : (m, n), weights : (m,) that add up to one; they say how far each component reaches.
    """
    while len(mixture.share) < components:
        i = int(np.argmax(mixture.share))
        values, vectors = np.linalg.eigh(mixture.factor[i] @ mixture.factor[i].T)
        values = np.maximum(values, 0.0)  # rounding, where units differ by many orders of magnitude
        scale = np.sqrt(np.diag(_covariance(points, weights, weights @ points)))
        # the longest axis in units of the whole cloud, so that no coordinate's unit decides
        longest = int(np.argmax(np.linalg.norm(vectors * np.sqrt(values) / scale[:, None], axis=0)))
        step = 0.7 * np.sqrt(values[longest]) * vectors[:, longest]
        halves = np.stack((mixture.centre[i] + step, mixture.centre[i] - step))
        rest = np.arange(len(mixture.share)) != i
        mixture = Mixture(
            np.concatenate((mixture.share[rest], np.full(2, 0.5 * mixture.share[i]))),
            np.concatenate((mixture.centre[rest], halves)),
            np.concatenate((mixture.factor[rest], np.stack((mixture.factor[i],) * 2))),
            mixture.degrees_of_freedom,
        )
    return mixture


def fit(mixture: Mixture, points: Array, weights: Array, steps: int = 10) -> Mixture:
    """The mixture that weighted points (m, n) make most probable, next to a given one.

    Expectation maximisation at fixed degrees of freedom (Peel and McLachlan, 2000), for points of an
    importance sample the update of Cappe et al. (2008, Adaptive importance sampling in general mixture
    classes). Components keep a hundredth of the whole at least. For thousands of points; of a hundred,
    ``shrunk_moments`` makes less mistakes.

    weights : (m,) that add up to one.
    """
    nu, n = mixture.degrees_of_freedom, points.shape[1]
    whole = _covariance(points, weights, weights @ points)
    ridge = _RIDGE * np.diag(np.diag(whole))
    for _ in range(steps):
        parts = log_components(mixture, points)
        member = np.exp(parts - log_sum_exp(parts, axis=0)) * weights
        share = member.sum(axis=1)
        centres, factors = [], []
        for k in range(len(share)):
            if share[k] < 1e-8:
                centres.append(mixture.centre[k])
                factors.append(mixture.factor[k])
                continue
            z = (points - mixture.centre[k]) @ np.linalg.inv(mixture.factor[k]).T
            # points in the tails say less about centre and scale
            pull = member[k] * (nu + n) / (nu + np.sum(z**2, axis=1))
            centre = pull @ points / pull.sum()
            away = points - centre
            scale = (pull[:, None] * away).T @ away / share[k]
            centres.append(centre)
            factors.append(_factor(scale + ridge))
        kept = np.maximum(share, _LEAST_FRACTION)
        mixture = Mixture(kept / kept.sum(), np.stack(centres), np.stack(factors), nu)
    return mixture


def shrunk_moments(
    mixture: Mixture, points: Array, log_weight: Array, *, least: float, wider: float, prior_points: float
) -> Mixture:
    """Stacks of mixtures with the moments that a few weighted points (..., p, n) give their components.

    A component stays near where it was if few points speak of it: its moments are weighed as
    N / (N + prior_points n) against the old ones, N being the effective number of its points.

    log_weight : (..., p).
    least : fraction of the whole that a used component keeps.
    wider : factor on the points' standard deviations.
    """
    n = points.shape[-1]
    parts = log_components(mixture, points)
    weight = np.exp(log_weight - log_weight.max(axis=-1, keepdims=True))
    weight /= weight.sum(axis=-1, keepdims=True)
    member = np.exp(parts - log_sum_exp(parts, axis=-2)[..., None, :]) * weight[..., None, :]
    held = member.sum(axis=-1)
    share = np.where(mixture.share > 0.0, np.maximum(held, least), 0.0)
    number = held**2 / np.maximum(np.sum(member**2, axis=-1), 1e-300)
    trust = (number / (number + prior_points * n))[..., None]
    member = member / np.maximum(held, 1e-300)[..., None]
    centre = mixture.centre + trust * (member @ points - mixture.centre)
    away = points[..., None, :, :] - centre[..., :, None, :]
    covariance = np.swapaxes(member[..., None] * away, -1, -2) @ away
    old = mixture.factor @ np.swapaxes(mixture.factor, -1, -2)
    trust = trust[..., None]
    factor = np.linalg.cholesky(trust * wider**2 * covariance + (1.0 - trust) * old)
    share = share / share.sum(axis=-1, keepdims=True)
    return Mixture(share, centre, factor, mixture.degrees_of_freedom)


def widened(mixture: Mixture, share: float, factor: float, points: Array, weights: Array) -> Mixture:
    """The mixture with one more component, of a given share, about all points and so many times as wide."""
    safe = single(points, weights, mixture.degrees_of_freedom)
    return Mixture(
        np.append((1.0 - share) * mixture.share, share),
        np.concatenate((mixture.centre, safe.centre)),
        np.concatenate((mixture.factor, factor * safe.factor)),
        mixture.degrees_of_freedom,
    )


def log_sum_exp(values: Array, axis: int | tuple[int, ...]) -> Array:
    """log sum exp along axes, -inf where all are."""
    top = values.max(axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        total = np.log(np.sum(np.exp(values - top), axis=axis))
    return np.asarray(total + np.squeeze(top, axis=axis))


def _covariance(points: Array, weights: Array, mean: Array) -> Array:
    away = points - mean
    return np.asarray((weights[:, None] * away).T @ away)


def _factor(scale: Array) -> Array:
    """Cholesky factor of a scale matrix that few points may have left singular."""
    spread = np.diag(np.diag(scale)) + 1e-12 * np.eye(len(scale))
    for ridge in (0.0, 1e-6, 1e-3, 1e-1):
        try:
            return np.asarray(np.linalg.cholesky(scale + ridge * spread))
        except np.linalg.LinAlgError:
            continue
    return np.asarray(np.sqrt(spread))


def log_box_mass(
    centre: Array, scale: Array, lower: Array, upper: Array, nu: float = np.inf, log2_points: int = 10
) -> Array:
    """Log probability between bounds of m Gaussian or Student-t densities, (m,).

    One variable after the other, each given those before, over a Sobol sequence, the most constrained
    first (Genz and Bretz, Computation of Multivariate Normal and t Probabilities, 2009). All in
    logarithms: a centre many standard deviations outside keeps its digits. The error is about 1e-3
    with 2^10 points in five dimensions. No chance is involved.

    centre : (m, n).
    scale : (m, n, n) covariance, or scale matrix of a Student-t of nu degrees of freedom.
    lower, upper : (n,), may be infinite.
    """
    m, n = centre.shape
    sd = np.sqrt(np.diagonal(scale, axis1=1, axis2=2))
    alone = _log_interval((lower - centre) / sd, (upper - centre) / sd, nu)
    order = np.argsort(alone, axis=1, kind="stable")
    row = np.arange(m)[:, None]
    factor = np.linalg.cholesky(scale[row[..., None], order[:, :, None], order[:, None, :]])
    sobol = qmc.Sobol(n, scramble=False).random_base2(log2_points)
    points = sobol + 0.5**log2_points / 2.0  # off the faces of the cube
    _, log_mass = _sequential(centre[row, order], factor, lower[order], upper[order], nu, points)
    top = log_mass.max(axis=1, keepdims=True)
    return np.asarray(np.log(np.mean(np.exp(log_mass - top), axis=1)) + top[:, 0])


def box_draws(
    centre: Array, scale: Array, lower: Array, upper: Array, nu: float, size: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draws between bounds near a Gaussian or Student-t, (size, n), and their log density, (size,).

    Every coordinate is drawn from its conditional density given those before, cut at its bounds. That
    is not the density cut as a whole, but one that is known, normalised, and equal to it where nothing
    is cut (Geweke, 1991). centre : (n,), scale : (n, n), lower and upper (n,).
    """
    factor = np.linalg.cholesky(scale)
    uniform = rng.uniform(size=(size, len(centre)))
    x, log_mass = _sequential(centre[None], factor[None], lower[None], upper[None], nu, uniform)
    return x[0], log_student_t(x[0] - centre, factor, nu) - log_mass[0]


def _sequential(
    centre: Array, factor: Array, lower: Array, upper: Array, nu: float, uniform: Array
) -> tuple[Array, Array]:
    """Points between the bounds, (m, k, n), and the log product of the conditional masses, (m, k).

    centre, lower, upper : (m, n).
    factor : (m, n, n).
    uniform : (k, n) in (0, 1).
    """
    m, n = centre.shape
    z = np.zeros((m, len(uniform), n))
    log_mass = np.zeros((m, len(uniform)))
    squared = np.zeros((m, len(uniform)))
    for i in range(n):
        shift = np.einsum("mkj,mj->mk", z[:, :, :i], factor[:, i, :i]) + centre[:, i, None]
        # given those before, a t coordinate is a t of more degrees of freedom and another width
        dof = nu + i
        width = np.ones_like(squared) if np.isinf(nu) else np.sqrt((nu + squared) / dof)
        a, b = ((bound[:, i, None] - shift) / (factor[:, i, i, None] * width) for bound in (lower, upper))
        log_mass += _log_interval(a, b, dof)
        z[:, :, i] = width * _interval_quantile(a, b, dof, uniform[:, i])
        squared += z[:, :, i] ** 2
    x = centre[:, None] + np.einsum("mkj,mij->mki", z, factor)
    return np.clip(x, lower[:, None], upper[:, None]), log_mass


def _mirrored(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Intervals carried to the lower tail, where distribution functions are accurate, and their signs."""
    with np.errstate(invalid="ignore"):
        flip = a + b > 0  # not where both are infinite: then nothing is cut
    return np.where(flip, -b, a), np.where(flip, -a, b), np.where(flip, -1.0, 1.0)


def _log_interval(a: Array, b: Array, nu: float) -> Array:
    """Log probability of a standard variable between a and b."""
    a, b, _ = _mirrored(a, b)
    with np.errstate(divide="ignore"):
        if np.isinf(nu):
            below, above = log_ndtr(a), log_ndtr(b)
            return np.asarray(above + np.log(-np.expm1(np.minimum(below - above, 0.0))))
        return np.asarray(np.log(stdtr(nu, b) - stdtr(nu, a)))


def _interval_quantile(a: Array, b: Array, nu: float, p: Array) -> Array:
    """Quantiles p in (0, 1) of a standard variable cut to [a, b]."""
    a, b, sign = _mirrored(a, b)
    p = np.where(sign > 0, p, 1.0 - p)
    if np.isinf(nu):
        with np.errstate(divide="ignore"):
            log_p = np.logaddexp(log_ndtr(a) + np.log1p(-p), log_ndtr(b) + np.log(p))
        x = ndtri_exp(np.minimum(log_p, 0.0))
    else:
        x = stdtrit(nu, (1.0 - p) * stdtr(nu, a) + p * stdtr(nu, b))
    return np.asarray(sign * np.clip(x, a, b))


# Importance weights with a heavier tail than this have no useful error (Vehtari et al., 2024).
RELIABLE_K = 0.7
# Fewest weights in the tail that a Pareto density is fitted to.
_FEWEST_IN_TAIL = 5


@dataclass(frozen=True, slots=True)
class Weighted:
    """Weighted points of m densities and the integrals of these.

    points : (m, p, n).
    weight : (m, p), each row adds up to one.
    log_evidence : (m,) log of the mean weight.
    standard_error : (m,) of it, that of independent points, an upper bound for a Sobol sequence.
    effective_size : (m,) (sum w)^2 / sum w^2.
    k_hat : (m,) Pareto shape of the largest weights.
    """

    points: Array
    weight: Array
    log_evidence: Array
    standard_error: Array
    effective_size: Array
    k_hat: Array


def weighted(points: Array, log_ratio: Array) -> Weighted:
    """Points (m, p, n) with the logs (m, p) of target density over the density they were drawn from.

    Where all of a row are -inf its log evidence is too, and the rest of it is not a number.
    """
    top = log_ratio.max(axis=1)
    top = np.where(np.isfinite(top), top, 0.0)
    ratio = np.exp(log_ratio - top[:, None])
    mean = ratio.mean(axis=1)
    p = log_ratio.shape[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        return Weighted(
            points=points,
            weight=ratio / ratio.sum(axis=1, keepdims=True),
            log_evidence=top + np.log(mean),
            standard_error=ratio.std(axis=1) / mean / np.sqrt(p),
            effective_size=ratio.sum(axis=1) ** 2 / np.sum(ratio**2, axis=1),
            k_hat=np.array([pareto_shape(row) for row in log_ratio]),
        )


def staged_importance(
    log_density: Callable[[Array], Array],
    mixture: Mixture,
    log2_points: int,
    stages: tuple[float, ...] = (1.0,),
    refit: Callable[[Mixture, Array, Array], Mixture] | None = None,
) -> Weighted:
    """Integrals of m densities by importance sampling from a stack of Student-t mixtures.

    The points are those of one scrambled Sobol sequence for all densities, so that differences between
    these are known better than each alone. After each stage the mixtures are refitted to all points before;
    all of them are weighed against the blend of the mixtures (Cornuet et al., 2012).

    log_density : (m, p, n) -> (m, p).
    stages : fractions of the points.
    refit : mixture, points and their log weights -> the mixture of the next stage.
    """
    m, n = mixture.centre.shape[0], mixture.centre.shape[2]
    stops = np.cumsum([0, *(round(stage * (1 << log2_points)) for stage in stages)])
    mixtures, sizes = [mixture], [int(size) for size in np.diff(stops)]
    points, target = np.empty((m, 0, n)), np.empty((m, 0))
    for i in range(len(stages)):
        if i and refit is not None:
            log_weight = target - log_blend(mixtures, sizes[:i], points)
            mixtures.append(refit(mixtures[-1], points, log_weight))
        more = sobol_points(mixtures[i], log2_points, slice(stops[i], stops[i + 1]))
        points = np.concatenate((points, more), axis=1)
        target = np.concatenate((target, log_density(more)), axis=1)
    return weighted(points, target - log_blend(mixtures, sizes, points))


def effective_size(log_weight: Array) -> float:
    """(sum w)^2 / sum w^2 of weights (p,) that are given by their logarithms."""
    top = float(log_weight.max())
    if not np.isfinite(top):
        return 0.0
    w = np.exp(log_weight - top)
    return float(w.sum() ** 2 / np.sum(w**2))


def pareto_shape(log_weight: Array) -> float:
    """Shape k-hat of a generalised Pareto density fitted to the largest of weights (p,).

    The fifth or 3 sqrt(p) largest, whichever are fewer, by the posterior mean of Zhang and Stephens (2009)
    with the prior of Vehtari et al. (2024, Pareto smoothed importance sampling, eq. 10): 10 weights of
    shape 0.5. Infinite where fewer than five stand out.
    """
    finite = log_weight[np.isfinite(log_weight)]
    n = len(finite)
    n_tail = int(np.ceil(min(n / 5.0, 3.0 * np.sqrt(n))))
    if n_tail < _FEWEST_IN_TAIL:
        return np.inf
    ordered = np.sort(finite) - finite.max()
    cut = max(float(ordered[-n_tail - 1]), float(np.log(np.finfo(float).tiny)))
    tail = np.exp(ordered[ordered > cut]) - np.exp(cut)
    return _generalised_pareto_shape(tail) if len(tail) >= _FEWEST_IN_TAIL else np.inf


def _generalised_pareto_shape(tail: Array) -> float:
    """Shape of a generalised Pareto distribution of exceedances (m,) in ascending order."""
    m = len(tail)
    n_grid = 30 + int(np.sqrt(m))
    b = 1.0 - np.sqrt(n_grid / (np.arange(1, n_grid + 1) - 0.5))
    b = b / (3.0 * tail[int(m / 4 + 0.5) - 1]) + 1.0 / tail[-1]
    k = np.log1p(-b[:, None] * tail).mean(axis=1)
    log_likelihood = m * (np.log(-b / k) - k - 1.0)
    with np.errstate(over="ignore"):
        weight = 1.0 / np.exp(log_likelihood - log_likelihood[:, None]).sum(axis=1)
    kept = weight >= 10.0 * np.finfo(float).eps
    mean = np.sum(b[kept] * weight[kept]) / weight[kept].sum()
    shape = float(np.log1p(-mean * tail).mean())
    return (m * shape + 10.0 * 0.5) / (m + 10.0)
