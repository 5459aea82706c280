"""Evidence of stacking sequences, the constants and the noise marginalised: many sequences at once.

A sequence is fixed; what is left is a posterior of the constants alone. Its evidence is Laplace's about
the best of a few optima, and, where it must be exact, that of importance sampling about the same optima.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp, ndtri
from scipy.stats import chi2, qmc

from cpam_bayes.inference.climb import climb
from cpam_bayes.inference.expansion import Expansion, expand
from cpam_bayes.inference.normal_scores import NormalScores, normal_scores
from cpam_bayes.laminate import LaminateGeometry, laminate_geometry
from cpam_bayes.model import PlateModel
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.posterior import ForwardModel, Posterior, plate_posterior
from cpam_bayes.problem import PlateState, StateFunction, Values
from cpam_bayes.reduced import ReducedModel
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Degrees of freedom and widening of the proposals of importance sampling.
_NU, _WIDER = 6.0, 1.1
# Draws of the constants that are kept of each sequence.
_KEPT = 8
# Two climbs of a sequence ended at one optimum if they are this near, in standard deviations.
_SAME = 0.5
# Optima this far below the best one of a sequence carry nothing.
_HOPELESS = 12.0
# Least curvature, against a flat direction that prior and data leave.
_FLOOR = 1e-3
# Climbs end where a step promises less than this, nats, or after so many steps.
_PROMISED, _MOST_STEPS = 1e-4, 30
# Numbers in the matrices of sequences that are solved for together: they stay in the processor's cache.
_CACHED = 1 << 19
# Points of importance sampling that are solved for together.
_POINTS = 2048
# log2 of the points from which on a proposal is refitted, and from which on unsure evidences get 2^_MORE times
# as many; standard error, nats, that is unsure.
_ADAPTED, _CAREFUL, _MORE, _UNSURE = 8, 9, 3, 0.08
# Points a dimension that the first proposal counts as where it is refitted.
_PRIOR_POINTS = 3.0
# Shares of optima that count in a proposal, and the least that one then has.
_USED, _LEAST_SHARE = 1e-4, 0.1


@dataclass(frozen=True, slots=True)
class SequencePosterior:
    """The posterior of constants (and noise) that any sequence of one layup has.

    model : reduced, of the unknown angles and then the constants. template : a posterior of the
    constants alone, whose model is that of some sequence. axes : coordinates in which
    the prior is a standard normal.
    """

    model: ReducedModel
    template: Posterior
    axes: NormalScores
    n_angles: int

    @property
    def parameters(self) -> ParameterSet:
        """Constants, and the noise where it is inferred."""
        return self.template.parameters

    def at(self, angles_deg: Array) -> Posterior:
        """The posterior of stacks whose row i has the sequence i, (m, n_angles) degrees."""
        return replace(self.template, model=_model_at(self.model, self.n_angles, _geometry(self, angles_deg)))


def sequence_posterior(
    model: ReducedModel, n_angles: int, measurement: Any, solver_error: Array, **options: Any
) -> SequencePosterior:
    """The posterior of the constants of a model whose first ``n_angles`` parameters are ply angles.

    options : as of ``plate_posterior``.
    """
    some = _model_at(model, n_angles, None)
    template = plate_posterior(some, measurement, solver_error, **options)
    return SequencePosterior(model, template, normal_scores(template), n_angles)


def _geometry(own: SequencePosterior, angles_deg: Array) -> LaminateGeometry:
    problem = own.model.fast.operator.problem
    names = problem.parameters.names[: own.n_angles]
    others = {p.name: np.asarray(p.prior.mean) for p in problem.parameters.parameters[own.n_angles :]}
    values = {**others, **{name: angles_deg[:, i] for i, name in enumerate(names)}}
    state = problem.state(values)
    assert not isinstance(state.layup, LaminateGeometry)
    return laminate_geometry(state.layup, symmetric=state.symmetric)


def _model_at(model: ReducedModel, n_angles: int, geometry: LaminateGeometry | None) -> ForwardModel:
    """The reduced plate with the sequences of a geometry: row i of a stack has the layup i."""
    operator = model.fast.operator
    problem = operator.problem
    constants = ParameterSet(problem.parameters.parameters[n_angles:], problem.parameters.fixed)
    angles = {name: np.asarray(0.0) for name in problem.parameters.names[:n_angles]}
    state = partial(_state_at, problem.state, angles, geometry)
    admissible = partial(_admissible_at, problem.admissible, angles)
    bound = replace(problem, parameters=constants, state=state, admissible=admissible)
    return PlateModel(replace(operator, problem=bound), model.n_modes, model.fast.error)


def _state_at(
    state: StateFunction, angles: Values, geometry: LaminateGeometry | None, values: Values
) -> PlateState:
    found = state({**values, **angles})
    if geometry is None or len(geometry.first) == 1:
        return found if geometry is None else replace(found, layup=geometry)
    size = int(np.prod(np.broadcast_shapes(*(np.shape(v) for v in values.values()))))
    # derivatives ask for every row as often as there are parameters, one after the other
    return replace(found, layup=_repeated(geometry, size // len(geometry.first)))


def _admissible_at(admissible: Any, angles: Values, values: Values) -> Any:
    return admissible({**values, **angles})


def _repeated(geometry: LaminateGeometry, times: int) -> LaminateGeometry:
    return geometry if times == 1 else _rows(geometry, np.repeat(np.arange(len(geometry.first)), times))


def _rows(geometry: LaminateGeometry, rows: Array) -> LaminateGeometry:
    """The geometry of some layups of a stack."""
    return replace(
        geometry,
        in_plane=geometry.in_plane[rows],
        coupling=geometry.coupling[rows],
        flexural=geometry.flexural[rows],
        ply=geometry.ply[rows],
        first=geometry.first[rows],
        zeroth=None if geometry.zeroth is None else geometry.zeroth[rows],
    )


@dataclass(frozen=True, slots=True)
class SequenceFits:
    """The conditional posteriors of m sequences about their optima.

    log_evidence : (m,) Laplace's, summed over the distinct optima. x : (m, n) parameters at the best
    optimum. residual : (m, n_frequencies) measured / predicted - 1 there, modes in ascending order.
    optima : (m, s, n) all optima, normal scores; weight : (m, s) their shares of the evidence, zero for
    copies. curvature : (m, s, n, n) negative Hessians (Gauss-Newton) there.
    """

    log_evidence: Array
    x: Array
    residual: Array
    optima: Array
    weight: Array
    curvature: Array

    def __getitem__(self, rows: Any) -> SequenceFits:
        """The fits of some of the sequences."""
        return SequenceFits(*(getattr(self, name)[rows] for name in self.__slots__))


Stack = TypeVar("Stack", "SequenceFits", "Conditionals")


def joined(pieces: list[Stack]) -> Stack:
    """What is known of several stacks as that of one."""
    kind = type(pieces[0])
    return kind(*(np.concatenate([getattr(p, name) for p in pieces]) for name in kind.__slots__))


@single_blas_thread
def fit_sequences(own: SequencePosterior, angles_deg: Array, starts: Array) -> SequenceFits:
    """Laplace's evidence of sequences (m, n_angles), each climbed from every one of its starts.

    Z = sum over optima of (2 pi)^(n/2) det(H)^(-1/2) p(z), z being normal scores: the prior has no
    bounds there, and a constant that the data leave open is integrated exactly.

    starts : (s, n) for all sequences, or (m, s, n), parameters.
    """
    starts = np.broadcast_to(starts, (len(angles_deg), *starts.shape[-2:]))
    largest = max(block.size for block in own.model.fast.operator.blocks)
    each = int(np.clip(_CACHED // largest**2, 64, 512))
    return joined(
        [_fit(own, angles_deg[i : i + each], starts[i : i + each]) for i in range(0, len(angles_deg), each)]
    )


def _fit(own: SequencePosterior, angles_deg: Array, starts: Array) -> SequenceFits:
    m, s, n = starts.shape
    axes = own.axes
    geometry = _geometry(own, angles_deg)
    of_start = np.repeat(np.arange(m), s)

    def target(z: Array, rows: Array) -> Expansion:
        return _expand(own, geometry, z, of_start[rows])

    summit = climb(
        target,
        axes.to_z(starts.reshape(m * s, n)),
        axes.lower,
        axes.upper,
        most_steps=_MOST_STEPS,
        promised=_PROMISED,
    )
    e = summit.expansion
    value = np.where(np.isfinite(e.value), e.value, -1e300).reshape(m, s)
    z = summit.u.reshape(m, s, n)
    curvature = e.curvature.reshape(m, s, n, n)
    log_z = value + 0.5 * n * np.log(2 * np.pi) - 0.5 * np.linalg.slogdet(curvature + _FLOOR * np.eye(n))[1]
    log_z[~_distinct(z, value, curvature)] = -np.inf
    total = logsumexp(log_z, axis=1)
    x = axes.to_x(z[np.arange(m), value.argmax(axis=1)])
    at = replace(own.template, model=_model_at(own.model, own.n_angles, geometry))
    measured = own.template.measurement.frequencies
    residual = measured / at.predict(x)[:, : len(measured)] - 1.0
    return SequenceFits(total, x, residual, z, np.exp(log_z - total[:, None]), curvature)


def _expand(own: SequencePosterior, geometry: LaminateGeometry, z: Array, rows: Array) -> Expansion:
    """Log density over normal scores of stacks whose rows have the sequences ``rows`` of a geometry."""
    axes = own.axes
    x = axes.to_x(z)
    # rows outside the support go first: every row of a stack must have its parameter set
    inside = np.flatnonzero(np.isfinite(own.template.log_prior(x)))
    m, n = z.shape
    found = Expansion(np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n)))
    if not len(inside):
        return found
    model = _model_at(own.model, own.n_angles, _rows(geometry, rows[inside]))
    e = expand(replace(own.template, model=model), x[inside])
    value, gradient, curvature = axes.carried(e, x[inside], z[inside])
    found.value[inside], found.gradient[inside], found.curvature[inside] = value, gradient, curvature
    return found


def _distinct(z: Array, value: Array, curvature: Array) -> Array:
    """Which of the optima (m, s) count: no copies of better ones and not hopeless, bool."""
    m, s = value.shape
    order = np.argsort(-value, axis=1, kind="stable")
    keep = np.asarray(value > value.max(axis=1, keepdims=True) - _HOPELESS)
    row = np.arange(m)
    for a in range(s):
        first = order[:, a]
        for b in range(a + 1, s):
            second = order[:, b]
            away = z[row, first] - z[row, second]
            near = np.einsum("mi,mij,mj->m", away, curvature[row, first], away) < _SAME**2
            keep[row, second] &= ~(near & keep[row, first])
    return keep


@dataclass(frozen=True, slots=True)
class Conditionals:
    """The conditional posteriors of m sequences by importance sampling.

    log_evidence : (m,); error : (m,) its standard error, that of independent draws, an upper bound.
    mean, sd : (m, n) of the parameters; draws : (m, 8, n), equally probable.
    """

    log_evidence: Array
    error: Array
    mean: Array
    sd: Array
    draws: Array

    def __getitem__(self, rows: Any) -> Conditionals:
        """Those of some of the sequences."""
        return Conditionals(*(getattr(self, name)[rows] for name in self.__slots__))


@single_blas_thread
def importance_evidence(
    own: SequencePosterior, angles_deg: Array, fits: SequenceFits, log2_points: int = 9
) -> Conditionals:
    """Conditional posteriors of sequences by importance sampling about their optima.

    The proposal is a mixture of Student-t densities about the optima. From 256 points on half of them
    are spent on it; its components then take mean and covariance of the posterior that these found, and
    all points are weighed against the blend of both proposals (Cornuet et al., 2012). Points are those
    of a Sobol sequence, scrambled in the same way for every sequence, so that differences between
    sequences are known better than each alone. Evidences of 512 points and more that stay unsure are
    sampled again with eight times as many.
    """
    found = _in_parts(own, angles_deg, fits, log2_points)
    unsure = np.flatnonzero(found.error > _UNSURE)
    if log2_points < _CAREFUL or not len(unsure):
        return found
    again = _in_parts(own, angles_deg[unsure], fits[unsure], log2_points + _MORE)
    place = np.arange(len(angles_deg))
    place[unsure] = len(angles_deg) + np.arange(len(unsure))
    return joined([found, again])[place]


def _in_parts(
    own: SequencePosterior, angles_deg: Array, fits: SequenceFits, log2_points: int
) -> Conditionals:
    each = max(_POINTS >> log2_points, 1)
    return joined(
        [
            _importance(own, angles_deg[i : i + each], fits[i : i + each], log2_points)
            for i in range(0, len(angles_deg), each)
        ]
    )


@dataclass(frozen=True, slots=True)
class _Proposals:
    """Mixtures of Student-t densities over normal scores, one for each of m sequences.

    share : (m, s). centre : (m, s, n). factor : (m, s, n, n) lower Cholesky factors.
    """

    share: Array
    centre: Array
    factor: Array

    def points(self, step: Array, uniform: Array) -> Array:
        """Points (m, p, n) from those of a standard Student-t (p, n) and uniform numbers (p, 1)."""
        component = np.sum(np.cumsum(self.share, axis=1)[:, None, :-1] < uniform[:, None], axis=2)
        row = np.arange(len(self.share))[:, None]
        moved = np.einsum("mpij,pj->mpi", self.factor[row, component], step)
        return np.asarray(self.centre[row, component] + moved)

    def log_components(self, z: Array) -> Array:
        """Log of share times density of every component at points (m, p, n), (m, s, p)."""
        m, s = self.share.shape
        found = np.full((m, s, z.shape[1]), -np.inf)
        for j in range(s):
            rows = np.flatnonzero(self.share[:, j] > 0.0)
            away = z[rows] - self.centre[rows, j][:, None, :]
            own = _log_student_t(away, self.factor[rows, j])
            found[rows, j] = np.log(self.share[rows, j])[:, None] + own
        return found


def _about_optima(fits: SequenceFits) -> _Proposals:
    used = fits.weight > _USED
    share = np.where(used, np.maximum(fits.weight, _LEAST_SHARE), 0.0)
    n = fits.optima.shape[2]
    covariance = np.linalg.inv(fits.curvature + _FLOOR * np.eye(n))
    return _Proposals(
        share / share.sum(axis=1, keepdims=True), fits.optima, np.linalg.cholesky(covariance) * _WIDER
    )


def _refitted(before: _Proposals, z: Array, log_target: Array) -> _Proposals:
    """The mixtures with the moments that weighted points (m, p, n) give their components.

    A component that few points speak of stays near where it was.
    """
    n = z.shape[2]
    parts = before.log_components(z)
    log_q = logsumexp(parts, axis=1)
    log_ratio = log_target - log_q
    weight = np.exp(log_ratio - log_ratio.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    member = np.exp(parts - log_q[:, None, :]) * weight[:, None, :]
    held = member.sum(axis=2)
    share = np.where(before.share > 0.0, np.maximum(held, _LEAST_SHARE), 0.0)
    scale = np.maximum(held, 1e-300)[:, :, None]
    number = (held**2 / np.maximum(np.sum(member**2, axis=2), 1e-300))[:, :, None]
    trust = number / (number + _PRIOR_POINTS * n)
    mean = np.einsum("msp,mpi->msi", member / scale, z)
    centre = before.centre + trust * (mean - before.centre)
    away = z[:, None] - centre[:, :, None, :]
    covariance = np.einsum("msp,mspi,mspj->msij", member / scale, away, away)
    old = before.factor @ np.swapaxes(before.factor, 2, 3)
    trust = trust[..., None]
    factor = np.linalg.cholesky(trust * _WIDER**2 * covariance + (1.0 - trust) * old)
    return _Proposals(share / share.sum(axis=1, keepdims=True), centre, factor)


def _importance(
    own: SequencePosterior, angles_deg: Array, fits: SequenceFits, log2_points: int
) -> Conditionals:
    axes, n = own.axes, fits.optima.shape[2]
    size = 1 << log2_points
    row = np.arange(len(angles_deg))[:, None]
    step, uniform = _proposal_points(n, log2_points)
    proposals = [_about_optima(fits)]
    if log2_points < _ADAPTED:
        z = proposals[0].points(step, uniform)
        log_target = _log_density(own, angles_deg, z)
    else:
        half = size // 2
        z = proposals[0].points(step[:half], uniform[:half])
        log_target = _log_density(own, angles_deg, z)
        proposals.append(_refitted(proposals[0], z, log_target))
        more = proposals[1].points(step[half:], uniform[half:])
        z = np.concatenate((z, more), axis=1)
        log_target = np.concatenate((log_target, _log_density(own, angles_deg, more)), axis=1)
    log_q = logsumexp(np.concatenate([p.log_components(z) for p in proposals], axis=1), axis=1)
    log_ratio = log_target - (log_q - np.log(len(proposals)))
    top = log_ratio.max(axis=1)
    weights = np.exp(log_ratio - top[:, None])
    mean_weight = weights.mean(axis=1)
    share = weights / weights.sum(axis=1, keepdims=True)
    x = axes.to_x(z)
    mean = np.einsum("mp,mpj->mj", share, x)
    sd = np.sqrt(np.einsum("mp,mpj->mj", share, (x - mean[:, None, :]) ** 2))
    # systematic resampling over the points as the Sobol sequence has them, which is as good as at random
    places = (np.arange(_KEPT) + 0.5) / _KEPT
    kept = np.sum(np.cumsum(share, axis=1)[:, :, None] < places, axis=1)
    draws = x[row, np.minimum(kept, size - 1)]
    error = weights.std(axis=1) / mean_weight / np.sqrt(size)
    return Conditionals(top + np.log(mean_weight), error, mean, sd, draws)


def _log_density(own: SequencePosterior, angles_deg: Array, z: Array) -> Array:
    """Log density over normal scores z (m, p, n), row i having the sequence i, (m, p)."""
    axes, (m, p, n) = own.axes, z.shape
    z = z.reshape(m * p, n)
    x = axes.to_x(z)
    inside = np.all((z >= axes.lower) & (z <= axes.upper), axis=1) & np.isfinite(own.template.log_prior(x))
    found = np.full(m * p, -np.inf)
    # every row of a stack must have its parameter set: those outside the support go first
    rows = np.flatnonzero(inside)
    if len(rows):
        geometry = _rows(_geometry(own, angles_deg), rows // p)
        at = replace(own.template, model=_model_at(own.model, own.n_angles, geometry))
        found[rows] = at.log_prob(x[rows]) + np.log(axes.slope(x[rows], z[rows])).sum(axis=1)
    return found.reshape(m, p)


@cache
def _proposal_points(n: int, log2_points: int) -> tuple[Array, Array]:
    """Points of a standard Student-t (2^log2_points, n), and uniform ones that choose its component."""
    uniform = qmc.Sobol(n + 2, rng=np.random.default_rng(0)).random(1 << log2_points)
    # a Student-t is a Gaussian over the root of a chi-squared variable
    return ndtri(uniform[:, :n]) / np.sqrt(chi2.ppf(uniform[:, n], _NU) / _NU)[:, None], uniform[:, n + 1]


def _log_student_t(away: Array, factor: Array) -> Array:
    """Log density of Student-t's ``away`` (m, p, n) from their centres, factors (m, n, n), (m, p)."""
    n = away.shape[2]
    squared = np.sum(np.einsum("mij,mpj->mpi", np.linalg.inv(factor), away) ** 2, axis=2)
    log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    constant = gammaln(0.5 * (_NU + n)) - gammaln(0.5 * _NU) - 0.5 * n * np.log(_NU * np.pi)
    return np.asarray(constant - log_det[:, None] - 0.5 * (_NU + n) * np.log1p(squared / _NU))
