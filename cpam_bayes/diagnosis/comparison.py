"""Plate cases, and the log density of their frequency lists under a hypothesis for each plate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, Hypothesis
from cpam_bayes.diagnosis.models import PlateModels, extended_model, plate_models
from cpam_bayes.effects import Effect
from cpam_bayes.effects.effect import MISREADINGS
from cpam_bayes.forward_model.composed import Change, ComposedModel, Part
from cpam_bayes.forward_model.known_errors import common_covariance, number_of
from cpam_bayes.forward_model.labels import ShapePairing
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.identification.density import deviation
from cpam_bayes.inference.log_density import CorrelatedDensity, Listed
from cpam_bayes.inference.scores import NormalScores
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedLogNormal
from cpam_bayes.plate import Measurement

# Prior of the repeatability of a list that does not state it; docs/priors.md gives its source.
REPEATABILITY_PRIOR = TruncatedLogNormal(0.002, 0.8, 1e-5, 0.02)
NOISE = Parameter("relative_std", "", REPEATABILITY_PRIOR)
# Relative scatter of a constant from plate to plate of one material, standard deviation.
SCATTER = 0.02


@dataclass(frozen=True, slots=True)
class PlateCase:
    """One plate with its frequency list.

    modes : (n,) model mode of each frequency where the list has no error, -1 for a false peak
    extended : reduced models with effects that were built so far, by name and variant
    of_another_material : models over the search bounds of the constants, built on first use
    log_pairing : log prior of the pairing of an incomplete list, with the density of its false peaks
    by_shape : pairing by the measured shapes, None without them
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
        """Models of the plate over the search bounds of its constants, built on first use."""
        if not self.of_another_material:
            models = plate_models(self.models.specimen, self.models.n_modes, other_material=True)
            self.of_another_material.append(models)
        return self.of_another_material[0]

    def with_effect(
        self, effect: Effect, notify: Callable[[str], None] = lambda text: None
    ) -> ReducedModel | LocalModel:
        """Reduced model of the plate with an effect, built on first use."""
        effect = effect.repeats or effect
        key = (effect.name, effect.variant)
        if key not in self.extended:
            self.extended[key] = extended_model(self.models, effect, notify)
        return self.extended[key]


def comparison_of(
    cases: Sequence[PlateCase], hypotheses: Mapping[int, Hypothesis] | Hypothesis, *, scatter: float = SCATTER
) -> CorrelatedDensity:
    """Log density of the plates' frequency lists under a hypothesis for each plate.

    Plates of one material share their constants; with several specimens each specimen deviates from them.

    hypotheses : by plate, or one for all plates with a common effect size; plates of one specimen share the
        size in either case
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
        part, listed = _part(joint, case, models, hypothesis, shared)
        parts.append(part)
        lists.append(listed)
    model = ComposedModel(ParameterSet(tuple(joint.parameters)), tuple(parts))
    names = [case.name for case in cases]
    each = enumerate(zip(cases, parts, strict=True))
    common = common_covariance([_tolerances(case, part, of_plate.get(i)) for i, (case, part) in each])
    return _compared(model, lists, names, joint, next(iter(of_plate.values()), None), common)


def _tolerances(
    case: PlateCase, part: Part, hypothesis: Hypothesis | None
) -> tuple[str, int, Mapping[str, Array]]:
    """Specimen, number of frequencies and their common errors, without those of numbers in doubt."""
    specimen, known = case.models.specimen, case.models.tolerances
    effects = () if hypothesis is None else hypothesis.effects
    wrong = {number_of(effect.name, specimen.plate) for effect in effects}
    errors = {n: e[np.minimum(part.modes, len(e) - 1)] for n, e in known.items() if n not in wrong}
    return specimen.specimen, len(part.modes), errors


@dataclass(slots=True)
class _Joint:
    """The joint parameter vector as it grows."""

    cases: Sequence[PlateCase]
    scatter: float
    parameters: list[Parameter] = field(default_factory=list)
    column: dict[str, int] = field(default_factory=dict)

    def add(self, parameter: Parameter, of: str = "") -> int:
        """Column of a parameter, added if it is new.

        of : the plate or material that it belongs to, among several
        """
        if of:
            parameter = replace(parameter, name=f"{parameter.name} of {of}", base=parameter.own, of=of)
        if parameter.name not in self.column:
            self.column[parameter.name] = len(self.parameters)
            self.parameters.append(parameter)
        return self.column[parameter.name]


def _part(
    joint: _Joint, case: PlateCase, models: PlateModels, hypothesis: Hypothesis | None, shared: bool
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
        scatter.append(joint.add(deviation(parameter, specimen, joint.scatter)))
    f, kept = case.measurement.frequencies, np.flatnonzero(case.modes >= 0)
    modes, log_constant = case.modes[kept], case.log_pairing
    changes, misread = list[Change](), list[tuple[int, int]]()
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
        for number, parameter in zip(listed.misread, MISREADINGS, strict=False):
            column = joint.add(parameter)
            misread += [(int(i), column) for i in np.flatnonzero(kept == number)]
    error = np.hypot(models.error, models.theory_error)[np.minimum(modes, len(models.error) - 1)]
    part = Part(models.bare, np.array(columns), np.array(scatter), tuple(changes), modes, tuple(misread))
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
    common: Array,
) -> CorrelatedDensity:
    frequencies = np.concatenate([one.frequencies for one in lists])
    listed = Listed(
        frequencies,
        np.concatenate([one.variance for one in lists]),
        np.concatenate([one.scale for one in lists]),
        sum(one.log_constant for one in lists),
        np.repeat(np.arange(len(lists)), [len(one.frequencies) for one in lists]),
        np.outer(frequencies, frequencies) * common if common.any() else None,
    )
    parameters, amplitudes = list(joint.parameters), []
    for i, one in enumerate(lists):
        inferred = bool(one.scale.any())
        amplitudes.append(len(parameters) if inferred else -1)
        if inferred:
            parameters.append(NOISE if len(lists) == 1 else _repeatability(names, i))
    discrepancy, length = None, 0.0
    if hypothesis is not None and hypothesis.correlation_length is not None:
        discrepancy, length = len(parameters), hypothesis.correlation_length
        parameters.append(DISCREPANCY)
    every = ParameterSet(tuple(parameters))
    scores = NormalScores(every)
    return CorrelatedDensity(model, listed, every, scores, tuple(amplitudes), discrepancy, length)


def _repeatability(names: list[str], i: int) -> Parameter:
    """Repeatability parameter of one of several lists, each from a test of its own."""
    of = f"{names[i]}, list {i + 1}" if names.count(names[i]) > 1 else names[i]
    return replace(NOISE, name=f"{NOISE.name} of {of}", base=NOISE.name, of=of)


# Correlation length over ln f of the error of an effect's form.
_FORM_LENGTH = 0.8
# Fraction of the noise below which a form error is neglected.
_NEGLIGIBLE = 0.1


def with_form_error(comparison: CorrelatedDensity, hypothesis: Hypothesis, x: Array) -> CorrelatedDensity:
    """The comparison with form errors of its effects at parameters x (n,); unchanged where they are small.

    Every effect adds kappa^2 D R D to the covariance, D = diag of its frequency shifts and R their
    correlation over 0.8 in ln f: no plate has an effect of exactly the catalogue's form.
    """
    added = np.zeros((len(comparison.listed.frequencies),) * 2)
    for effect in hypothesis.effects:
        if effect.form_error == 0.0:
            continue
        without = x.copy()
        without[list(effect_columns(comparison, hypothesis, effect.sizes))] = [
            effect.null[p.name] for p in effect.sizes
        ]
        try:
            f, _ = comparison.predict(np.stack((without, x)))
        except RigidBodyError:
            continue
        d = effect.form_error * (f[1] - f[0])
        added += d[:, None] * comparison.listed.correlation(_FORM_LENGTH) * d
    if np.all(np.diagonal(added) < _NEGLIGIBLE**2 * comparison.variance(x[None])[0]):
        return comparison
    common = added if comparison.listed.common is None else comparison.listed.common + added
    return replace(comparison, listed=replace(comparison.listed, common=common))


def smooth_columns(comparison: CorrelatedDensity, hypothesis: Hypothesis) -> tuple[int, ...]:
    """Columns of the hypothesis that Laplace's method integrates well even where the data leave them open."""
    each = zip(effect_columns(comparison, hypothesis), hypothesis.parameters, strict=True)
    return tuple(column for column, p in each if p.name in hypothesis.smooth)


def effect_columns(
    comparison: CorrelatedDensity, hypothesis: Hypothesis, of: Sequence[Parameter] | None = None
) -> tuple[int, ...]:
    """Columns in the joint vector of a hypothesis's parameters, or of the parameters in ``of``."""
    joint = comparison.parameters.parameters
    return tuple(
        next(i for i, q in enumerate(joint) if q.kind != "scatter" and q.own == p.name)
        for p in (hypothesis.parameters if of is None else of)
    )
