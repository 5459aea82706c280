"""Plates with something hidden in them, simulated by finite elements, and what could be seen of it at best.

The frequencies come from elements on a mesh of their own, the plate's constants are known to whoever hides
the effect, and the effect is as large as a signal-to-noise ratio asks: the norm of the shift of the log
frequencies, less what the constants imitate within their priors, over the relative noise s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case, with_list
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.diagnosis.signatures import ABSORBED
from cpam_bayes.effects import Effect, extend
from cpam_bayes.forward_model.calculix.solve import solve_specimen
from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.inference.standard_normal import NormalScores
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.spaces.fem import fem_space
from cpam_bayes.mechanics.sparse import discretise_sparse
from cpam_bayes.parameters import Parameter, ParameterSet
from cpam_bayes.plate import Measurement, Specimen, builtin

Array = NDArray[Any]

# Elements along x and y: not the default mesh. Its frequencies are within 1e-4 of converged ones.
MESH = (20, 18)
# Operators kept at a time.
_KEPT = 3


@dataclass(frozen=True, slots=True)
class Bench:
    """A plate ready for trials.

    case : with the models of all that it may have.
    operators : finite elements by what they have.
    """

    case: PlateCase
    mesh: tuple[int, int] = MESH
    operators: dict[tuple[tuple[str, str], ...], AffineOperator[Any, Any]] = field(default_factory=dict)

    @property
    def n_listed(self) -> int:
        """Number of frequencies in a list."""
        return self.case.measurement.size

    @property
    def noise(self) -> float:
        """Relative standard deviation of the noise."""
        s = self.case.measurement.relative_std
        assert s is not None
        return s

    @property
    def singles(self) -> tuple[Hypothesis, ...]:
        """The hypotheses of one cause, none first."""
        return tuple(h for h, _ in hypotheses_of([self.case]))

    def model_of(self, effect: Effect) -> Effect:
        """The effect whose model predicts this one: that at any place, of one at a fixed place."""
        of = [e for h in self.singles for e in h.effects if e.name == effect.name and e.is_anywhere]
        alike = (e for e in of if e.local == effect.local)
        return effect if effect.place is None else next(alike, effect)

    def list_of(self, frequencies: Array) -> Measurement:
        """A list of these frequencies, rounded to the resolution, ascending."""
        measurement = self.case.measurement
        rounded = np.sort(np.round(frequencies / measurement.resolution) * measurement.resolution)
        return replace(measurement, frequencies=rounded)

    def measured(self, frequencies: Array, noise: Array) -> PlateCase:
        """The plate with a list of these frequencies, measured with noise in units of s."""
        return with_list(self.case, self.list_of(frequencies * np.exp(self.noise * noise)))


def bench(plate: str | Specimen, n_listed: int, *, noise: float, resolution: float) -> Bench:
    """A plate, built-in by its name, with all its models.

    noise : relative standard deviation, given in the plate's file.
    resolution : Hz.
    """
    labels = ("",) * n_listed
    any_list = Measurement(np.arange(1.0, n_listed + 1.0), resolution, noise, None, labels, complete=True)
    specimen = builtin(plate) if isinstance(plate, str) else plate
    plate_bench = Bench(plate_case(replace(specimen, measurement=any_list)))
    for h in plate_bench.singles:
        if h.other_material:
            plate_bench.case.of_other_material()
        for effect in h.effects:
            if effect.change is not None:
                plate_bench.case.with_effect(effect)
    return plate_bench


def random_constants(bench: Bench, spread: float, rng: np.random.Generator) -> Array:
    """Constants within a relative ``spread`` of the reference that satisfy the constraints (9), (n,)."""
    models = bench.case.models
    centre = reference_vector(models.specimen, models.parameters)
    while True:
        x = centre * (1.0 + rng.uniform(-spread, spread, len(centre)))
        x = np.clip(x, models.parameters.lower, models.parameters.upper)
        if models.bare.admissible(x[None])[0]:
            return x


def true_frequencies(bench: Bench, hidden: Sequence[Hypothesis], x: Array, sizes: Array, n: int) -> Array:
    """The n lowest frequencies of the plate with effects of these sizes by finite elements, (n,) Hz.

    x : constants.
    sizes : of the hidden causes, one each; what is wrong with a list is not applied.
    """
    models = bench.case.models
    effects = [(h.effects[0], float(size)) for h, size in zip(hidden, sizes, strict=True) if h.effects]
    of_plate = [(e, size) for e, size in effects if e.change is not None]
    problem = models.problem
    for effect, _ in of_plate:
        problem = extend(problem, effect, models.facts)
    key = tuple((e.name, f"{e.variant} {e.place}") for e, _ in of_plate)
    names = models.parameters.names
    if key not in bench.operators:
        while len(bench.operators) >= _KEPT:
            bench.operators.pop(next(iter(bench.operators)))
        # what any size needs: that of none and that of one standard deviation
        samples = {name: np.array([v, v]) for name, v in zip(names, x, strict=True)}
        for effect, _ in of_plate:
            samples |= {k: np.array([v, effect.scaled(1.0)[k]]) for k, v in effect.null.items()}
        space = fem_space(problem.edges, problem.nominal, *bench.mesh)
        bench.operators[key] = discretise_sparse(problem, space, samples)
    values: dict[str, Any] = dict(zip(names, x, strict=True))
    for effect, size in of_plate:
        values |= of_size(effect, size)
    # the samples' problem has the same terms; sizes enter through the coefficients alone
    operator = bench.operators[key]
    f = solve(operator, *operator.coefficients(values), n).frequencies[0]
    for effect, size in effects:
        if effect.observe is not None:
            f = effect.observe(f, of_size(effect, np.asarray(size)))
    return np.asarray(f)


def brick_frequencies(bench: Bench, x: Array, n: int) -> Array:
    """The n lowest frequencies of the plate as it should be, by CalculiX on bricks of 20 nodes, (n,) Hz.

    x : constants.

    Raises ``CalculixError`` where CalculiX is not there or fails.
    """
    models = bench.case.models
    every = models.specimen.material.complete(dict(zip(models.parameters.names, x, strict=True)))
    constants = {name: float(value) for name, value in every.items()}
    return np.asarray(solve_specimen(models.specimen, constants, n))


@dataclass(frozen=True)
class Linear:
    """A plate at its true constants, whose log frequencies are linear in the constants' scores.

    log_f : (n_modes,) of the bare model.
    slope : (n_modes, n_constants) derivatives over the scores in units of s.
    z : (n_constants,) scores of the truth.
    """

    own: Bench
    x: Array
    log_f: Array
    slope: Array
    z: Array

    @cached_property
    def root(self) -> Array:
        """(I + A A^T)^-1/2, (n_listed, n_listed): what is left of a shift that the constants may imitate.

        It is the root of the data's precision with the constants integrated over their priors.
        """
        a = self.slope[self.own.case.modes]
        values, vectors = np.linalg.eigh(np.eye(len(a)) + a @ a.T)
        return np.asarray((vectors / np.sqrt(values)) @ vectors.T)

    def shift(self, h: Hypothesis, sizes: Array) -> Array:
        """Shifts of the listed log frequencies by sizes (m,) of a cause, (m, n_listed), in units of s."""
        modes = self.own.case.modes
        if h.listed.misread is not None:
            shifts = np.zeros((len(sizes), len(modes)))
            shifts[:, h.listed.misread] = np.log1p(sizes)
            return shifts / self.own.noise
        effect = h.effects[0]
        if effect.change is not None:
            place = () if effect.place is None else effect.place
            at = np.tile(np.array([*self.x, 0.0, *place]), (len(sizes), 1))
            at[:, len(self.x)] = sizes
            effect, vectors = self.own.model_of(effect), at
            if not effect.is_anywhere:
                vectors = np.tile(np.array([*self.x, *effect.null.values()]), (len(sizes), 1))
                vectors[:, len(self.x)] = sizes
            log_f = np.log(self.own.case.with_effect(effect).predict(vectors).frequencies)
        else:
            assert effect.observe is not None
            plain = np.tile(np.exp(self.log_f), (len(sizes), 1))
            log_f = np.log(effect.observe(plain, of_size(effect, sizes)))
        return np.asarray((log_f - self.log_f)[:, modes] / self.own.noise)

    def visible(self, h: Hypothesis, sizes: Array) -> Array:
        """What is left of these shifts, (m, n_listed): their norms are signal-to-noise ratios."""
        return np.asarray(self.shift(h, sizes) @ self.root)


def linear(bench: Bench, x: Array) -> Linear:
    """The plate at constants (n,); of another material, with the scores nearest to them."""
    models = bench.case.models
    scores = NormalScores(models.parameters)
    z = scores.to_z(x[None])
    prediction = models.bare.predict(x[None], jacobian=True)
    assert prediction.jacobian is not None
    f = prediction.frequencies[0]
    slope = prediction.jacobian[0] / f[:, None] * scores.slope(scores.to_x(z), z)[0] / bench.noise
    return Linear(bench, x, np.log(f), slope, z[0])


def parameter_of(h: Hypothesis) -> Parameter:
    """The size of a cause."""
    return h.parameters[0]


def of_size(effect: Effect, size: Any) -> dict[str, Any]:
    """Values of an effect's parameters: the first has this size, the others their nulls."""
    return effect.null | {effect.parameters[0].name: size}


def at_random_place(h: Hypothesis, rng: np.random.Generator) -> Hypothesis:
    """A hypothesis with its effect at a place drawn from its prior; itself where it has none."""
    if not h.effects or not h.effects[0].is_anywhere:
        return h
    effect = h.effects[0]
    fixed = effect.fixed({p.name: p.prior.sample(rng, 1)[0] for p in effect.coordinates})
    return replace(h, effects=(fixed,), parameters=fixed.parameters, variant=fixed.variant)


def sizes_of(h: Hypothesis, scores: Array) -> Array:
    """Sizes of a cause at scores (m,) of its prior, (m,)."""
    return NormalScores(ParameterSet((parameter_of(h),))).to_x(scores[:, None])[:, 0]


@dataclass(frozen=True, slots=True)
class Reached:
    """The size at which a cause has a signal-to-noise ratio, or why there is none.

    size : nan where it is not reached within the prior.
    most : ratio at the end of the prior.
    share : of the shift that the constants do not imitate, there or at the size.
    """

    size: float
    most: float
    share: float

    @property
    def usable(self) -> bool:
        """Whether the ratio is reached by more than the constants' priors."""
        return bool(np.isfinite(self.size)) and self.share >= ABSORBED


def size_for(at: Linear, h: Hypothesis, ratio: float, sign: float) -> Reached:
    """The smallest size of a cause on one side of its null with a signal-to-noise ratio."""
    prior = parameter_of(h).prior
    end = prior.upper if sign > 0 else prior.lower
    # sizes grow as squares: even effects are of second order
    sizes = end * np.linspace(0.0, 1.0, 97) ** 2
    shift = at.shift(h, sizes)
    norm = np.linalg.norm(shift @ at.root, axis=1)
    highest = np.maximum.accumulate(norm)
    if highest[-1] < ratio:
        size, i = np.nan, len(sizes) - 1
    else:
        i = int(np.argmax(highest >= ratio))
        part = (ratio - highest[i - 1]) / (highest[i] - highest[i - 1])
        size = float(sizes[i - 1] + part * (sizes[i] - sizes[i - 1]))
    whole = float(np.linalg.norm(shift[i]))
    return Reached(size, float(highest[-1]), float(norm[i]) / whole if whole > 0.0 else 0.0)


def variants_of_cause(bench: Bench, cause: str) -> tuple[Hypothesis, ...]:
    """The variants of a cause that are no slips of the pen; none of another material, which has no size."""
    return tuple(h for h in bench.singles if h.cause == cause and not h.is_gross)
