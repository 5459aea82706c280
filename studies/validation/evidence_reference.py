"""Marginal likelihood of one hypothesis by brute force, as a reference for the diagnosis's quick method.

Starts, nodes and proposals are its own. Independent draws of the prior, many more than the quick method uses,
are ranked by tempered likelihoods at several noise levels and optimised to the end. At every node of a dense
grid over the effect's size (of a cloud, if there are several sizes) the constants are optimised again, from
the draws next to the node and from the optima. All of these only form a proposal: the integral is that of an
importance sample, which is refitted and enlarged until its error is small.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.scores import Expansion
from cpam_bayes.inference.student_mixture import (
    Mixture,
    Weighted,
    log_mixture,
    shrunk_moments,
    sobol_points,
    weighted,
)
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

# Relative noise levels at which draws are ranked, and number of the best of each ranking that are optimised.
_TEMPERED, _BEST_OF_EACH = (0.1, 0.03, 0.01, 0.003), 12
# Number of draws optimised without ranking.
_AS_THEY_COME = 16
# Sizes of half of the draws, and the nodes, are spread evenly over scores up to this.
_REACH = 4.5
# Draws for a node: number of the nearest in size, and the best of these at two tempered noise levels.
_NEAREST, _BEST_AT_NODE, _TEMPERED_AT_NODE = 64, 2, (0.03, 0.005)
# Maximum steps of an optimisation and the gain in nats that ends it: jointly, and at a node.
_TO_THE_END, _AT_NODES = (40, 1e-3), (16, 1e-2)
# Optima are distinct beyond this many standard deviations; components this far below the best are left out.
_DISTINCT, _DEPTH_NATS = 0.5, 14.0
# Proposal: degrees of freedom, widening, and weight of the component that is the prior itself.
_FREEDOM, _WIDER, _OF_PRIOR = 5.0, 1.25, 0.02
_STAGES = (0.2, 0.2, 0.2, 0.4)


@dataclass(frozen=True, slots=True)
class ReferenceSettings:
    """Settings for the effort of the reference.

    draws : number of draws of the prior
    nodes : of the grid over one size, or of the cloud over several
    log2_points : of the importance sample, initially and at most
    error : of the log evidence at which the sample is large enough
    """

    draws: int = 4096
    nodes: int = 301
    log2_points: tuple[int, int] = (13, 15)
    error: float = 0.05


@dataclass(frozen=True, slots=True)
class ReferenceEvidence:
    """A log marginal likelihood with the standard error, effective size and k-hat of its sample.

    optima : distinct joint optima within 14 nats of the best
    """

    log_evidence: float
    error: float
    effective_size: float
    k_hat: float
    optima: int


@dataclass(frozen=True, slots=True)
class _Drawn:
    """Draws of the prior, scores (m, n), and their relative misfits (m, n_f)."""

    z: Array
    misfit: Array


@single_blas_thread
def reference_evidence(
    comparison: CorrelatedDensity,
    sizes: tuple[int, ...],
    seed: int,
    settings: ReferenceSettings | None = None,
    *,
    hopeless: float = -np.inf,
) -> ReferenceEvidence:
    """Log marginal likelihood of a comparison, with constants, noise and sizes integrated over their priors.

    sizes : columns of the effect's size and further coordinates
    hopeless : nodes are left out if the log evidence about the joint optima is below this
    """
    settings = settings or ReferenceSettings()
    rng = np.random.default_rng([seed, 18])
    drawn = _draws(comparison, sizes, settings.draws, rng)
    z, e = _optimised(comparison, _ranked(drawn), ())
    z, e = _separate(z, e)
    centre, factor, log_mass = [z], [np.linalg.cholesky(np.linalg.inv(e.curvature))], [_log_mass(e)]
    if sizes and float(logsumexp(log_mass[0])) > hopeless:
        at_nodes = _at_nodes(comparison, sizes, drawn, z, settings, rng)
        for part, more in zip((centre, factor, log_mass), at_nodes, strict=True):
            part.append(more)
    mixture = _proposal(np.concatenate(centre), np.concatenate(factor), np.concatenate(log_mass))
    for log2 in range(settings.log2_points[0], settings.log2_points[1] + 1):
        sample = _in_stages(comparison, mixture, log2)
        if sample.standard_error[0] < settings.error:
            break
    return ReferenceEvidence(
        float(sample.log_evidence[0]),
        float(sample.standard_error[0]),
        float(sample.effective_size[0]),
        float(sample.k_hat[0]),
        len(z),
    )


def _draws(comparison: CorrelatedDensity, sizes: tuple[int, ...], m: int, rng: np.random.Generator) -> _Drawn:
    z = rng.standard_normal((m, comparison.parameters.size))
    if sizes:
        z[::2, sizes[0]] = rng.uniform(-_REACH, _REACH, len(z[::2]))
    x = comparison.scores.to_x(z)
    allowed = comparison.model.admissible(x)
    f, _ = comparison.predict(x[allowed])
    return _Drawn(z[allowed], f / comparison.listed.frequencies - 1.0)


def _tempered(misfit: Array, noise: float) -> Array:
    """Student-t log likelihood of relative misfits (m, n_f) at a large noise, (m,)."""
    return np.asarray(-2.0 * np.sum(np.log1p((misfit / noise) ** 2 / 3.0), axis=1))


def _ranked(drawn: _Drawn) -> Array:
    """Starts: the best draws at every tempered noise level, and some without ranking."""
    which = [np.arange(min(_AS_THEY_COME, len(drawn.z)))]
    which += [np.argsort(-_tempered(drawn.misfit, s), kind="stable")[:_BEST_OF_EACH] for s in _TEMPERED]
    return np.asarray(drawn.z[np.unique(np.concatenate(which))])


def _optimised(comparison: CorrelatedDensity, z: Array, held: tuple[int, ...]) -> tuple[Array, Expansion]:
    """End points of optimisations from scores (m, n), with some columns held fixed."""
    free = np.delete(np.arange(z.shape[1]), held)
    bound = comparison.scores.upper[free]

    def target(at: Array, rows: Array) -> Expansion:
        whole = z[rows].copy()
        whole[:, free] = at
        e = comparison.expand(whole)
        return Expansion(e.value, e.gradient[:, free], e.curvature[:, free][:, :, free])

    steps, promised = _TO_THE_END if not held else _AT_NODES
    maxima = maximise(target, z[:, free], -bound, bound, most_steps=steps, promised=promised)
    ended = z.copy()
    ended[:, free] = maxima.u
    return ended, maxima.expansion


def _separate(z: Array, e: Expansion) -> tuple[Array, Expansion]:
    """The distinct optima, the best first."""
    order = np.argsort(-e.value, kind="stable")
    kept: list[int] = []
    for i in order[e.value[order] > e.value[order[0]] - _DEPTH_NATS]:
        away = z[kept] - z[i]
        distance = np.einsum("ki,kij,kj->k", away, e.curvature[kept], away)
        if not len(kept) or distance.min() > _DISTINCT**2:
            kept.append(int(i))
    return z[kept], Expansion(e.value[kept], e.gradient[kept], e.curvature[kept])


def _log_mass(e: Expansion) -> Array:
    """Log of the integral about each optimum by Laplace's approximation, (k,)."""
    n = e.curvature.shape[1]
    return np.asarray(e.value + 0.5 * n * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(e.curvature)[1])


def _at_nodes(
    comparison: CorrelatedDensity,
    sizes: tuple[int, ...],
    drawn: _Drawn,
    optima: Array,
    settings: ReferenceSettings,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """Components at nodes of the sizes: centres (k, n), factors (k, n, n) and log masses (k,)."""
    columns, d, n = list(sizes), len(sizes), comparison.parameters.size
    if d == 1:
        nodes = np.linspace(-_REACH, _REACH, settings.nodes)[:, None]
        width = np.array([2.0 * _REACH / settings.nodes])
    else:
        nodes = rng.standard_normal((settings.nodes, d))
        nodes[:, 0] = rng.uniform(-_REACH, _REACH, len(nodes))
        width = np.full(d, 2.0 / settings.nodes ** (1.0 / d))
    starts = np.concatenate([_starts_at(node, columns, drawn, optima) for node in nodes])
    z, e = _optimised(comparison, starts, sizes)
    log_mass = _log_mass(e) + float(np.log(width).sum())
    kept = np.flatnonzero(log_mass > log_mass.max() - _DEPTH_NATS)
    first = np.unique(np.round(np.column_stack((z[kept], log_mass[kept])), 2), axis=0, return_index=True)[1]
    kept = kept[first]
    factor = np.zeros((len(kept), n, n))
    free = np.delete(np.arange(n), columns)
    factor[:, free[:, None], free] = np.linalg.cholesky(np.linalg.inv(e.curvature[kept]))
    factor[:, columns, columns] = 1.5 * width
    return z[kept], factor, log_mass[kept]


def _starts_at(node: Array, columns: list[int], drawn: _Drawn, optima: Array) -> Array:
    """Starts (s, n) for a node (d,): the best of the draws nearest in size, and optima near it."""
    away = np.sum((drawn.z[:, columns] - node) ** 2, axis=1)
    near = np.argpartition(away, min(_NEAREST, len(away) - 1))[:_NEAREST]
    best = [
        near[np.argsort(-_tempered(drawn.misfit[near], s), kind="stable")[:_BEST_AT_NODE]]
        for s in _TEMPERED_AT_NODE
    ]
    from_optima = optima[np.argsort(np.sum((optima[:, columns] - node) ** 2, axis=1), kind="stable")[:2]]
    starts = np.concatenate((drawn.z[np.unique(np.concatenate(best))], from_optima))
    starts[:, columns] = node
    return np.asarray(starts)


def _proposal(centre: Array, factor: Array, log_mass: Array) -> Mixture:
    """A stack of one mixture of Student-t densities that includes the prior."""
    kept = log_mass > log_mass.max() - _DEPTH_NATS
    share = np.exp(0.7 * (log_mass[kept] - log_mass.max()))  # flatter than the masses, which may be wrong
    n = centre.shape[1]
    share = np.append((1.0 - _OF_PRIOR) * share / share.sum(), _OF_PRIOR)
    centres = np.concatenate((centre[kept], np.zeros((1, n))))
    factors = np.concatenate((_WIDER * factor[kept], np.eye(n)[None]))
    return Mixture(share[None], centres[None], factors[None], _FREEDOM)


def _in_stages(comparison: CorrelatedDensity, mixture: Mixture, log2_points: int) -> Weighted:
    """An importance sample in four stages, the proposal being refitted to all points after each."""
    stops = np.cumsum([0, *(round(stage * (1 << log2_points)) for stage in _STAGES)]).tolist()
    n = mixture.centre.shape[2]
    mixtures: list[Mixture] = []
    points, target = np.empty((1, 0, n)), np.empty((1, 0))
    for first, last in pairwise(stops):
        mixtures.append(mixture)
        more = sobol_points(mixture, log2_points, slice(first, last))
        points = np.concatenate((points, more), axis=1)
        target = np.concatenate((target, comparison.log_density(more[0])[None]), axis=1)
        sizes = np.diff(stops)[: len(mixtures), None, None]
        each = np.stack([log_mixture(one, points) for one in mixtures])
        log_weight = target - logsumexp(each, b=sizes / last, axis=0)
        mixture = shrunk_moments(mixture, points, log_weight, least=1e-3, wider=1.1, prior_points=6.0)
    return weighted(points, log_weight)
