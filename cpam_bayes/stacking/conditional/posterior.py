"""Evidence of stacking sequences, the constants and the noise marginalised: many sequences at once.

A sequence is fixed; what is left is a posterior of the constants alone. Its evidence here is Laplace's
about the best of a few optima; ``sequence_importance`` samples about the same optima.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.forward_model.model import PlateModel
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.derivatives import Expansion, expand_likelihood
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.posterior import ForwardModel, Posterior, plate_posterior
from cpam_bayes.inference.standard_normal import NormalScores
from cpam_bayes.mechanics.problem import PlateState, StateFunction, Values
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate.laminate import LaminateGeometry
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Two optimisations of a sequence ended at one optimum if they are this near, in standard deviations.
_SAME = 0.5
# Optima this far below the best one of a sequence carry nothing.
_NEGLIGIBLE_NATS = 12.0
# Least curvature, against a flat direction that prior and data leave.
CURVATURE_FLOOR = 1e-3
# Optimisations end where a step promises less than this, nats, or after so many steps.
_PROMISED, _MOST_STEPS = 1e-4, 30
# Numbers in the matrices of sequences that are solved for together: they stay in the processor's cache.
_CACHED = 1 << 19


@dataclass(frozen=True, slots=True)
class ConditionalPosterior:
    """The posterior of constants (and noise) that any sequence of one layup has.

    model : reduced, of the unknown angles and then the constants.
    template : a posterior of the constants alone, whose model is that of some sequence.
    axes : coordinates in which the prior is a standard normal.
    """

    model: ReducedModel
    template: Posterior
    axes: NormalScores
    n_angles: int

    @property
    def parameters(self) -> ParameterSet:
        """Constants, and the noise where it is inferred."""
        return self.template.parameters

    def at(self, angles_deg: Array, rows: Array | None = None) -> Posterior:
        """The posterior of stacks whose row i has the sequence i, or rows[i], of (m, n_angles) degrees."""
        geometry = _geometry(self, angles_deg)
        geometry = geometry if rows is None else _rows(geometry, rows)
        return replace(self.template, model=_model_at(self.model, self.n_angles, geometry))

    def relative_noise(self, x: Array) -> Array:
        """Standard deviations of noise and rounding over the frequencies at parameters x (m, n), (m, n_f)."""
        noise = self.template.noise_model
        variance = (self.template.amplitude(x)[:, None] * noise.scale) ** 2 + noise.rounding
        return np.asarray(np.sqrt(variance) / self.template.measurement.frequencies)

    def least_noise(self, x: Array) -> float:
        """The least of these at any of the parameters x (m, n)."""
        return float(self.relative_noise(x).min())


def conditional_posterior(
    model: ReducedModel, n_angles: int, measurement: Any, solver_error: Array, **options: Any
) -> ConditionalPosterior:
    """The posterior of the constants of a model whose first ``n_angles`` parameters are ply angles.

    options : as of ``plate_posterior``.
    """
    some = _model_at(model, n_angles, None)
    template = plate_posterior(some, measurement, solver_error, **options)
    return ConditionalPosterior(model, template, NormalScores(template.parameters), n_angles)


def _geometry(conditional: ConditionalPosterior, angles_deg: Array) -> LaminateGeometry:
    problem = conditional.model.fast.operator.problem
    names = problem.parameters.names[: conditional.n_angles]
    others = {p.name: np.asarray(p.prior.mean) for p in problem.parameters.parameters[conditional.n_angles :]}
    values = {**others, **{name: angles_deg[:, i] for i, name in enumerate(names)}}
    state = problem.state(values)
    assert not isinstance(state.layup, LaminateGeometry)
    return state.geometry()


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
class ConditionalFits:
    """The conditional posteriors of m sequences about their optima.

    log_evidence : (m,) Laplace's, summed over the distinct optima.
    x : (m, n) parameters at the best optimum.
    residual : (m, n_frequencies) measured / predicted - 1 there, modes in ascending order.
    optima : (m, s, n) all optima, normal scores.
    weight : (m, s) their shares of the evidence, zero for copies.
    curvature : (m, s, n, n) negative Hessians (Gauss-Newton) there.
    """

    log_evidence: Array
    x: Array
    residual: Array
    optima: Array
    weight: Array
    curvature: Array

    def __getitem__(self, rows: Any) -> ConditionalFits:
        """The fits of some of the sequences."""
        return ConditionalFits(*(getattr(self, name)[rows] for name in self.__slots__))


Stack = TypeVar("Stack")


def joined(pieces: list[Stack]) -> Stack:
    """What is known of several stacks as that of one."""
    kind: Any = type(pieces[0])
    found: Stack = kind(*(np.concatenate([getattr(p, name) for p in pieces]) for name in kind.__slots__))
    return found


@single_blas_thread
def fit_conditionals(
    conditional: ConditionalPosterior, angles_deg: Array, starts: Array, promised: float = _PROMISED
) -> ConditionalFits:
    """Laplace's evidence of sequences (m, n_angles), each optimised from every one of its starts.

    Z = sum over optima of (2 pi)^(n/2) det(H)^(-1/2) p(z), z being normal scores: the prior has no
    bounds there, and a constant that the data leave open is integrated exactly.

    starts : (s, n) for all sequences, or (m, s, n), parameters.
    promised : gain in nats below which one ends.
    """
    starts = np.broadcast_to(starts, (len(angles_deg), *starts.shape[-2:]))
    largest = max(block.size for block in conditional.model.fast.operator.blocks)
    each = int(np.clip(_CACHED // largest**2, 64, 512))
    return joined(
        [
            _fit(conditional, angles_deg[i : i + each], starts[i : i + each], promised)
            for i in range(0, len(angles_deg), each)
        ]
    )


def _fit(
    conditional: ConditionalPosterior, angles_deg: Array, starts: Array, promised: float
) -> ConditionalFits:
    m, s, n = starts.shape
    axes = conditional.axes
    geometry = _geometry(conditional, angles_deg)
    of_start = np.repeat(np.arange(m), s)

    def target(z: Array, rows: Array) -> Expansion:
        return _expand(conditional, geometry, z, of_start[rows])

    maxima = maximise(
        target,
        axes.to_z(starts.reshape(m * s, n)),
        axes.lower,
        axes.upper,
        most_steps=_MOST_STEPS,
        promised=promised,
    )
    e = maxima.expansion
    value = np.where(np.isfinite(e.value), e.value, -1e300).reshape(m, s)
    z = maxima.u.reshape(m, s, n)
    curvature = e.curvature.reshape(m, s, n, n)
    log_det = np.linalg.slogdet(curvature + CURVATURE_FLOOR * np.eye(n))[1]
    log_z = value + 0.5 * n * np.log(2 * np.pi) - 0.5 * log_det
    log_z[~_distinct(z, value, curvature)] = -np.inf
    total = logsumexp(log_z, axis=1)
    x = axes.to_x(z[np.arange(m), value.argmax(axis=1)])
    at = replace(conditional.template, model=_model_at(conditional.model, conditional.n_angles, geometry))
    measured = conditional.template.measurement.frequencies
    residual = measured / at.predict(x)[:, : len(measured)] - 1.0
    return ConditionalFits(total, x, residual, z, np.exp(log_z - total[:, None]), curvature)


def _expand(
    conditional: ConditionalPosterior, geometry: LaminateGeometry, z: Array, rows: Array
) -> Expansion:
    """Log density over normal scores of stacks whose rows have the sequences ``rows`` of a geometry."""
    axes = conditional.axes
    x = axes.to_x(z)
    # rows outside the support go first: every row of a stack must have its parameter set
    inside = np.flatnonzero(np.isfinite(conditional.template.log_prior(x)))
    m, n = z.shape
    found = Expansion(np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n)))
    if not len(inside):
        return found
    model = _model_at(conditional.model, conditional.n_angles, _rows(geometry, rows[inside]))
    likelihood = expand_likelihood(replace(conditional.template, model=model), x[inside])
    e = axes.with_prior(likelihood, x[inside], z[inside])
    found.value[inside], found.gradient[inside], found.curvature[inside] = e.value, e.gradient, e.curvature
    return found


def _distinct(z: Array, value: Array, curvature: Array) -> Array:
    """Which of the optima (m, s) count: no copies of better ones and not negligible, bool."""
    m, s = value.shape
    order = np.argsort(-value, axis=1, kind="stable")
    keep = np.asarray(value > value.max(axis=1, keepdims=True) - _NEGLIGIBLE_NATS)
    row = np.arange(m)
    for a in range(s):
        first = order[:, a]
        for b in range(a + 1, s):
            second = order[:, b]
            away = z[row, first] - z[row, second]
            near = np.einsum("mi,mij,mj->m", away, curvature[row, first], away) < _SAME**2
            keep[row, second] &= ~(near & keep[row, first])
    return keep
