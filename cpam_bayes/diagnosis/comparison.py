"""The likelihood of a hypothesis: measured lists against its model, in normal scores.

A comparison is made of a plate, its list and a hypothesis; its integral is the marginal likelihood.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.hypotheses import OTHER, Hypothesis
from cpam_bayes.diagnosis.models import Change, ComposedModel, Part, PlateModels, extended_model, plate_models
from cpam_bayes.effects import Effect
from cpam_bayes.effects.effect import MISREADING
from cpam_bayes.forward_model.labels import ShapePairing
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.derivatives import Expansion, NormalScores
from cpam_bayes.inference.posterior import ForwardModel
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedLogNormal, TruncatedNormal
from cpam_bayes.plate import Measurement

Array = NDArray[Any]


# Fraction of a smooth discrepancy's variance that is common to neighbouring modes; the rest is white.
SMOOTH_FRACTION = 0.95


@dataclass(frozen=True, slots=True)
class Listed:
    """Measured frequencies of all lists and their noise.

    sigma_i^2 = variance_i + (a scale_i)^2, with the amplitude a of the list where it is inferred.
    log_constant : log probability of what the model does not predict, false peaks for instance.

    frequencies, variance, scale : (n,) Hz, Hz^2, Hz; scale is zero where the noise is given.
    lists : (n,) number of the list that each is from.
    """

    frequencies: Array
    variance: Array
    scale: Array
    log_constant: float = 0.0
    lists: Array | None = None

    @property
    def of(self) -> Array:
        """Number of the list that each frequency is from, (n,)."""
        return np.zeros(len(self.frequencies), dtype=int) if self.lists is None else self.lists

    def without(self, i: int) -> Listed:
        """The list less one frequency."""
        kept = np.arange(len(self.frequencies)) != i
        return Listed(
            self.frequencies[kept], self.variance[kept], self.scale[kept], self.log_constant, self.of[kept]
        )

    def correlation(self, length: float) -> Array:
        """Correlation of a discrepancy between the frequencies, (n, n); length over ln f, 0 if white.

        rho exp(-(ln f_i - ln f_j)^2 / (2 length^2)) + (1 - rho) delta_ij within a list, none between lists.
        """
        n = len(self.frequencies)
        if length == 0.0:
            return np.eye(n)
        apart = np.subtract.outer(np.log(self.frequencies), np.log(self.frequencies)) / length
        alike = np.exp(-0.5 * apart**2) * np.equal.outer(self.of, self.of)
        return np.asarray(SMOOTH_FRACTION * alike + (1.0 - SMOOTH_FRACTION) * np.eye(n))


def kept_of(whole: Array, listed: Array) -> Array:
    """True for the frequencies (n,) of a list that are in a shorter one of the same order, bool.

    Equal frequencies are told apart by their order.
    """
    kept, at = np.zeros(len(whole), dtype=bool), 0
    for i, f in enumerate(whole):
        if at < len(listed) and f == listed[at]:
            kept[i], at = True, at + 1
    return kept


@dataclass(frozen=True, slots=True)
class Comparison:
    """A model against lists.

    Residuals are Gaussian with the covariance diag(sigma^2) + tau^2 F R F, F = diag(f) and R the correlation
    of a discrepancy between the model and the plate (Kennedy and O'Hagan, J. R. Statist. Soc. B 63, 2001).

    parameters : those of the model, then those of the noise.
    amplitudes : column of each list's repeatability, -1 where it is given.
    discrepancy : column of tau, or ``None``.
    correlation_length : of the discrepancy over ln f, 0 where it is white.
    left_out : a frequency of the model that the list lacks on purpose, or ``None``.
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
    def noise(self) -> int | None:
        """Column of the first repeatability that is inferred, or ``None``."""
        return next((column for column in self.amplitudes if column >= 0), None)

    @property
    def nuisance(self) -> tuple[int, ...]:
        """Columns of all amplitudes of noise and discrepancy."""
        of_noise = tuple(column for column in self.amplitudes if column >= 0)
        return of_noise if self.discrepancy is None else (*of_noise, self.discrepancy)

    def carried(self, other: Comparison, values: Array, rest: Array | float = 0.0) -> Array:
        """Values (..., n) of the parameters of the same name in another comparison.

        values : (..., n_other) parameters, or scores, of the other one
        rest : (n,) or one value, for the parameters that it lacks
        """
        column_of = {name: column for column, name in enumerate(other.parameters.names)}
        carried = np.empty((*values.shape[:-1], self.parameters.size))
        carried[...] = rest
        for column, name in enumerate(self.parameters.names):
            if name in column_of:
                carried[..., column] = values[..., column_of[name]]
        return carried

    def predict(self, x: Array, *, jacobian: bool = False) -> tuple[Array, Array | None]:
        """Frequencies (m, n_f) of the list at parameters (m, n), derivatives over these."""
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

        Rows that break the constraints (9) or buckle a plate are left out, also those that are found to be
        unsound only by solving.
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

    def about(self, z: Array, tolerance: float, fraction: float = 1.0) -> Comparison:
        """The same with models that are enough about scores z (m, n), as of ``ComposedModel.about``."""
        x = self.scores.to_x(z)
        x = x[self.model.admissible(x)]
        if not len(x):
            return self
        try:
            return replace(self, model=self.model.about(x, tolerance, fraction))
        except RigidBodyError:
            return self

    def variance(self, x: Array) -> Array:
        """sigma^2 of every frequency at parameters (m, n), discrepancy included, (m, n_f) Hz^2."""
        variance = self._independent(x)
        if self.discrepancy is not None:
            variance = variance + (x[:, self.discrepancy, None] * self.listed.frequencies) ** 2
        return variance

    def covariance(self, x: Array) -> Array:
        """Covariance of all frequencies at parameters (m, n), (m, n_f, n_f) Hz^2."""
        if self.discrepancy is None:
            return np.asarray(self._independent(x)[:, :, None] * np.eye(len(self.listed.frequencies)))
        return self._with_discrepancy(x)

    def log_likelihood(self, x: Array) -> Array:
        """Log likelihood at parameters (m, n), -inf where the constraints (9) are broken, (m,)."""
        value = np.full(len(x), -np.inf)
        inside, f, _ = self.predict_inside(x)
        if len(inside):
            r = self.listed.frequencies - f
            if self._is_correlated:
                value[inside] = self._correlated(r, self._with_discrepancy(x[inside]))[0]
            else:
                value[inside] = self._gaussian(r, self.variance(x[inside]))
        return value

    def log_conditional(self, x: Array) -> Array:
        """Log density of each frequency given the others and the parameters (m, n), (m, n_f).

        With Q the inverse covariance and r the residuals, r_i given the others is Gaussian with the variance
        1 / Q_ii and lies (Q r)_i / Q_ii off its mean (Rue and Held, Gaussian Markov Random Fields, theorem
        2.3). Not a number where the constraints (9) are broken.
        """
        value = np.full((len(x), len(self.listed.frequencies)), np.nan)
        inside, f, _ = self.predict_inside(x)
        if len(inside):
            r = self.listed.frequencies - f
            precision = np.linalg.inv(self.covariance(x[inside]))
            own = np.diagonal(precision, axis1=1, axis2=2)
            off = np.einsum("mij,mj->mi", precision, r) / own
            value[inside] = 0.5 * (np.log(own / (2.0 * np.pi)) - own * off**2)
        return value

    def log_density(self, z: Array) -> Array:
        """Log of likelihood times prior density over scores (m, n), (m,)."""
        return self.scores.log_prior(z) + self.log_likelihood(self.scores.to_x(z))

    def expand(self, z: Array) -> Expansion:
        """Log density over scores (m, n), its gradient, and its curvature with the Fisher information."""
        m, n = z.shape
        x = self.scores.to_x(z)
        value, gradient, curvature = np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n))
        inside, f, slope = self.predict_inside(x, jacobian=True)
        if len(inside):
            assert slope is not None
            expand = self._expand_correlated if self._is_correlated else self._expand_independent
            value[inside], gradient[inside], curvature[inside] = expand(
                x[inside], self.listed.frequencies - f, slope
            )
        return self.scores.with_prior(Expansion(value, gradient, curvature), x, z)

    @property
    def _is_correlated(self) -> bool:
        return self.discrepancy is not None and self.correlation_length > 0.0

    def _independent(self, x: Array) -> Array:
        """sigma^2 without the discrepancy, (m, n_f) Hz^2."""
        variance = np.broadcast_to(self.listed.variance, (len(x), len(self.listed.variance)))
        if self.noise is not None:
            # scale is zero where there is no amplitude, and any column will do
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

    def _with_discrepancy(self, x: Array) -> Array:
        n = len(self.listed.frequencies)
        common = x[:, self.discrepancy, None, None] ** 2 * self._common
        return np.asarray(common + self._independent(x)[:, :, None] * np.eye(n))

    @property
    def _common(self) -> Array:
        """F R F, (n_f, n_f) Hz^2."""
        f = self.listed.frequencies
        return f[:, None] * self.listed.correlation(self.correlation_length) * f

    def _correlated(self, r: Array, covariance: Array) -> tuple[Array, Array]:
        """Log density of residuals (m, n_f) and L^-1 with L L^T the covariance, (m, n_f, n_f)."""
        back = np.linalg.inv(np.linalg.cholesky(covariance))
        white = np.einsum("mij,mj->mi", back, r)
        log_determinant = -2.0 * np.log(np.diagonal(back, axis1=1, axis2=2)).sum(axis=1)
        quadratic = np.sum(white**2, axis=1) + log_determinant + r.shape[1] * np.log(2 * np.pi)
        return np.asarray(self.listed.log_constant - 0.5 * quadratic), back

    def _expand_correlated(self, x: Array, r: Array, slope: Array) -> tuple[Array, Array, Array]:
        """Value, gradient and Fisher information of a Gaussian with the covariance S.

        d/dp = J_p^T S^-1 r + (a^T S_p a - tr S^-1 S_p) / 2 with a = S^-1 r; the information is
        J_p^T S^-1 J_q + tr(S^-1 S_p S^-1 S_q) / 2 (Kay, Estimation Theory, section 3.9).
        """
        value, back = self._correlated(r, self._with_discrepancy(x))
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
                slopes.append(twice * self._common)
            else:
                scale = np.where(self._amplitude_columns == column, self.listed.scale, 0.0)
                slopes.append(twice * (scale**2 * np.eye(n)))
        return slopes


# Repeatability of a list that does not state it: docs/priors.md says where it is from.
REPEATABILITY_PRIOR = TruncatedLogNormal(0.002, 0.8, 1e-5, 0.02)
NOISE = Parameter("relative_std", "", REPEATABILITY_PRIOR)
# Relative scatter of a constant from plate to plate of one material, standard deviation.
SCATTER = 0.02


@dataclass(frozen=True, slots=True)
class PlateCase:
    """One plate with its frequency list.

    modes : (n,) model mode of each frequency where the list has no error, -1 for a false peak
    extended : reduced models with its effects so far, by name and variant
    of_another_material : the models over the search bounds of the constants, once they are needed
    log_pairing : log prior of the pairing of an incomplete list, with the density of its false peaks
    by_shape : what its measured shapes say, None without them
    """

    models: PlateModels
    measurement: Measurement
    modes: Array
    extended: dict[tuple[str, str], ReducedModel | LocalModel] = field(default_factory=dict)
    of_another_material: list[PlateModels] = field(default_factory=list)
    log_pairing: float = 0.0
    by_shape: ShapePairing | None = None

    @property
    def name(self) -> str:
        """Name of the plate's file."""
        return self.models.specimen.name

    def of_other_material(self) -> PlateModels:
        """The plate over the search bounds of its constants, built when first asked for."""
        if not self.of_another_material:
            models = plate_models(self.models.specimen, self.models.n_modes, other_material=True)
            self.of_another_material.append(models)
        return self.of_another_material[0]

    def with_effect(
        self, effect: Effect, notify: Callable[[str], None] = lambda text: None
    ) -> ReducedModel | LocalModel:
        """The reduced model of the plate with an effect, built when first asked for."""
        key = (effect.name, effect.variant)
        if key not in self.extended:
            self.extended[key] = extended_model(self.models, effect, notify)
        return self.extended[key]


def comparison_of(
    cases: Sequence[PlateCase],
    hypotheses: Mapping[int, Hypothesis] | Hypothesis,
    *,
    scatter: float = SCATTER,
    stand_ins: Mapping[int, ForwardModel] | None = None,
) -> Comparison:
    """The plates' frequency lists against their models under a hypothesis for each plate.

    Plates of one material have the same constants; of several specimens each deviates from them.

    hypotheses : by plate, or one for all plates, with one size of the effect; plates of one specimen have
        one size in either case
    stand_ins : cheaper models of plates, used where a plate has no hypothesis
    """
    of_plate = (
        dict.fromkeys(range(len(cases)), hypotheses) if isinstance(hypotheses, Hypothesis) else hypotheses
    )
    shared = isinstance(hypotheses, Hypothesis)
    joint = _Joint(cases, scatter)
    parts, lists = [], []
    for i, case in enumerate(cases):
        hypothesis = of_plate.get(i)
        models = case.models
        if hypothesis is not None and hypothesis.other_material:
            models = case.of_other_material()
        bare: ForwardModel = models.bare
        if hypothesis is None and stand_ins is not None:
            bare = stand_ins[i]
        part, listed = _part(joint, case, models, bare, hypothesis, shared)
        parts.append(part)
        lists.append(listed)
    model = ComposedModel(ParameterSet(tuple(joint.parameters)), tuple(parts))
    names = [case.name for case in cases]
    return _compared(model, lists, names, joint, next(iter(of_plate.values()), None))


@dataclass(slots=True)
class _Joint:
    """The joint parameter vector as it grows."""

    cases: Sequence[PlateCase]
    scatter: float
    parameters: list[Parameter] = field(default_factory=list)
    column: dict[str, int] = field(default_factory=dict)

    def add(self, parameter: Parameter, of: str = "") -> int:
        """Column of a parameter, which is added if it is new.

        of : the plate or material that it belongs to, among several
        """
        if of:
            parameter = replace(parameter, name=f"{parameter.name} of {of}", base=parameter.own, of=of)
        if parameter.name not in self.column:
            self.column[parameter.name] = len(self.parameters)
            self.parameters.append(parameter)
        return self.column[parameter.name]


def _part(
    joint: _Joint,
    case: PlateCase,
    models: PlateModels,
    bare: ForwardModel,
    hypothesis: Hypothesis | None,
    shared: bool,
) -> tuple[Part, Listed]:
    several = len({c.models.specimen.specimen for c in joint.cases}) > 1
    materials = {c.models.specimen.material.name for c in joint.cases}
    material = models.specimen.material.name or models.specimen.name if len(materials) > 1 else ""
    specimen = models.specimen.specimen if several else ""
    columns, scatter = [], []
    for parameter in models.parameters.parameters:
        of_material = parameter.name in models.specimen.unknowns
        columns.append(joint.add(parameter, material if of_material else specimen))
    for parameter in models.parameters.parameters:
        if not (several and parameter.name in models.specimen.unknowns):
            scatter.append(-1)
            continue
        prior = TruncatedNormal(0.0, joint.scatter, -4 * joint.scatter, 4 * joint.scatter)
        name = f"scatter of {parameter.name}, {specimen}"
        deviation = Parameter(name, "", prior, kind="scatter", base=parameter.name, of=specimen)
        scatter.append(joint.add(deviation))
    f, kept = case.measurement.frequencies, np.flatnonzero(case.modes >= 0)
    modes, log_constant, misread = case.modes[kept], case.log_pairing, None
    changes: list[Change] = []
    if hypothesis is not None:
        for effect in hypothesis.effects:
            at = tuple(joint.add(p, "" if shared else specimen) for p in effect.parameters)
            names = tuple(p.name for p in effect.parameters)
            model = None if effect.change is None else case.with_effect(effect)
            changes.append(Change(names, at, model, effect.observe))
        listed = hypothesis.listed
        if listed.spurious is not None:
            kept = np.delete(kept, listed.spurious)
            modes = np.where(np.arange(len(f)) > listed.spurious, modes - 1, modes)[kept]
            log_constant -= float(np.log(f[-1]))  # a false peak lies anywhere below the last one
        for missed in listed.missed:
            modes = np.where(modes >= missed, modes + 1, modes)
        if listed.misread is not None:
            column = joint.add(MISREADING)
            at_misread = np.flatnonzero(kept == listed.misread)
            misread = (int(at_misread[0]), column) if len(at_misread) else None
    error = np.hypot(models.error, models.theory_error)[np.minimum(modes, len(models.error) - 1)]
    part = Part(bare, np.array(columns), np.array(scatter), tuple(changes), modes, misread)
    return part, _listed(case.measurement, kept, error, log_constant)


def _listed(measurement: Measurement, kept: Array, error: Array, log_constant: float) -> Listed:
    f = measurement.frequencies[kept]
    variance = measurement.resolution**2 / 12 + (error * f) ** 2
    scale = np.zeros_like(f)
    if measurement.frequency_sd is not None:
        variance = variance + measurement.frequency_sd[kept] ** 2
    elif measurement.relative_std is not None:
        variance = variance + (measurement.relative_std * f) ** 2
    else:
        scale = f
    return Listed(f, variance, scale, log_constant)


def _compared(
    model: ComposedModel,
    lists: list[Listed],
    names: list[str],
    joint: _Joint,
    hypothesis: Hypothesis | None,
) -> Comparison:
    listed = Listed(
        np.concatenate([one.frequencies for one in lists]),
        np.concatenate([one.variance for one in lists]),
        np.concatenate([one.scale for one in lists]),
        sum(one.log_constant for one in lists),
        np.repeat(np.arange(len(lists)), [len(one.frequencies) for one in lists]),
    )
    parameters, amplitudes = list(joint.parameters), []
    for i, one in enumerate(lists):
        inferred = bool(one.scale.any())
        amplitudes.append(len(parameters) if inferred else -1)
        if inferred:
            parameters.append(NOISE if len(lists) == 1 else _repeatability(names, i))
    discrepancy, length = None, 0.0
    if hypothesis is not None and hypothesis.cause == OTHER:
        discrepancy, length = len(parameters), hypothesis.correlation_length
        parameters.append(hypothesis.parameters[0])
    every = ParameterSet(tuple(parameters))
    scores = NormalScores(every)
    return Comparison(model, listed, every, scores, tuple(amplitudes), discrepancy, length)


def _repeatability(names: list[str], i: int) -> Parameter:
    """That of one list of several, each of which is from a test of its own."""
    of = f"{names[i]}, list {i + 1}" if names.count(names[i]) > 1 else names[i]
    return replace(NOISE, name=f"{NOISE.name} of {of}", base=NOISE.name, of=of)


def smooth_columns(comparison: Comparison, hypothesis: Hypothesis) -> tuple[int, ...]:
    """Those of the hypothesis's columns that Laplace's method integrates well wherever they are left open."""
    each = zip(effect_columns(comparison, hypothesis), hypothesis.parameters, strict=True)
    return tuple(column for column, p in each if p.name in hypothesis.smooth)


def effect_columns(comparison: Comparison, hypothesis: Hypothesis) -> tuple[int, ...]:
    """Columns of a hypothesis's parameters in the joint vector, one for each."""
    joint = comparison.parameters.parameters
    return tuple(
        next(i for i, q in enumerate(joint) if q.kind != "scatter" and q.own == p.name)
        for p in hypothesis.parameters
    )
