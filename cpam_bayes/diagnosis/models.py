"""Reduced models of a plate, bare and with each effect that it may have, over the priors of its constants."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from cpam_bayes.effects import Effect, PlateFacts, extend
from cpam_bayes.forward_model.build import basis_tolerance, model_key, remembered, without_matrices
from cpam_bayes.forward_model.known_errors import common_errors
from cpam_bayes.forward_model.local.basis import local_space, patch_model, point_mass_model
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.model import (
    ForwardModel,
    PlateModel,
    Prediction,
    Samples,
    biased,
    constant_parameters,
    convergence_samples,
    model_on_basis,
    plate_problem,
    reference_vector,
    size_parameters,
)
from cpam_bayes.forward_model.reduced import ReducedModel, ReductionSettings, reduce
from cpam_bayes.forward_model.three_dimensions import theory_bias, theory_error
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.convergence import Tolerance, converge
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.problem import Array, Problem, any_of
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.parameters import ParameterSet, Uniform
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.edges import Field
from cpam_bayes.running import single_blas_thread

# Rigid-body and stretching functions that some effects need, kept in the space of the bare plate.
_CONTENT: tuple[tuple[Field, tuple[int, int]], ...] = (
    ("v", (0, 1)),
    ("u", (2, 0)),
    ("u", (0, 2)),
    ("v", (2, 0)),
    ("v", (0, 2)),
)
# Forms of an effect at which a space is converged: it holds what the other forms need.
_FARTHEST_FORMS = 6
# Accepted relative errors of a rough model: of its space and of its reduction.
_ROUGH, _ROUGH_BASIS = Tolerance(kept=1e-3, rich=1e-3, largest_degree=14), 3e-4
# Truncation of a normal prior from the plate file, standard deviations from its mean.
_CUT = 4.0


@dataclass(frozen=True, slots=True)
class ConvergedPlate:
    """A converged plate with the priors of its constants, ready to be extended.

    parameters : constants, and sizes with a standard deviation
    problem : the bare plate
    settings, keep : its converged space
    error : (n_modes,) relative error of that space
    """

    specimen: Specimen
    facts: PlateFacts
    parameters: ParameterSet
    problem: Problem
    samples: Samples
    settings: RitzSettings
    keep: Array
    error: Array
    n_modes: int


@dataclass(frozen=True, slots=True)
class PlateModels(ConvergedPlate):
    """A converged plate with its reduced model.

    theory_error : (n_modes,) scatter of first-order theory at the reference constants, relative
    tolerances : name of a size, the density or mass, or the frequency scale that is no parameter ->
        (n_modes,) relative changes of the frequencies by one standard deviation of it
    bare : its reduced model
    key : text of all inputs that it depends on
    """

    theory_error: Array
    tolerances: Mapping[str, Array]
    bare: ReducedModel
    key: str


def diagnosis_parameters(specimen: Specimen, *, other_material: bool = False) -> ParameterSet:
    """Unknown constants with the prior that all commands use, cut at four standard deviations, and the sizes.

    For another material the constants keep the prior of [unknowns], without former posteriors.
    """
    unknowns = _of_other_material(specimen) if other_material else constant_parameters(specimen, _CUT)
    return unknowns.union(size_parameters(specimen))


def _of_other_material(specimen: Specimen) -> ParameterSet:
    unknowns = specimen.unknowns
    free = (
        p if p.coupled is None else replace(p, prior=Uniform(p.prior.lower, p.prior.upper), coupled=None)
        for p in unknowns.parameters
    )
    return ParameterSet(tuple(free), unknowns.fixed)


@single_blas_thread
def plate_models(
    specimen: Specimen,
    n_modes: int,
    notify: Callable[[str], None] = lambda text: None,
    *,
    other_material: bool = False,
    is_rough: bool = False,
) -> PlateModels:
    """Converge a plate over its priors and reduce it to the modes that its list needs.

    other_material : over the search bounds of its constants, without the matrices of the full space
    is_rough : converged at the reference constants alone, and to a thousandth
    """
    assert specimen.measurement is not None
    parameters, problem, samples = _bare(specimen, other_material)
    settings = ReductionSettings(max(basis_tolerance(specimen.measurement), is_rough * _ROUGH_BASIS))
    if is_rough:
        samples = Samples(samples.x[:1], samples.allowance[:1])

    def make() -> ReducedModel:
        notify("converging the plate")
        full = converged_plate(problem, samples, n_modes, _ROUGH if is_rough else None)
        reduced = _reduced(full, settings.tolerance)
        return without_matrices(reduced) if other_material else reduced

    key = model_key(specimen, parameters, n_modes, settings, None)
    bare = remembered(json.dumps([key, "bare", other_material, is_rough]), make)
    assert bare.full.basis is not None
    return PlateModels(
        specimen,
        _facts(specimen, parameters, bare),
        parameters,
        problem,
        samples,
        *bare.full.basis,
        bare.full.error,
        n_modes,
        theory_error(specimen, bare.predict(samples.x[:1]).frequencies[0]),
        _tolerances(specimen, parameters, bare),
        bare,
        key,
    )


def _tolerances(specimen: Specimen, parameters: ParameterSet, bare: ReducedModel) -> dict[str, Array]:
    """Relative changes (n_modes,) of the frequencies by each known error that is no parameter."""
    middle = reference_vector(specimen, parameters)
    values = dict(zip(parameters.names, middle.tolist(), strict=True))
    constants = {name: values[name] for name in specimen.unknowns.names}
    every = common_errors(specimen, bare.full, constants, np.arange(bare.full.n_modes))
    return {name: error for name, error in every.items() if name not in parameters}


def _facts(specimen: Specimen, parameters: ParameterSet, model: ForwardModel) -> PlateFacts:
    middle = reference_vector(specimen, parameters)
    losses = None if specimen.measurement is None else specimen.measurement.loss_factors
    known = np.array([]) if losses is None else losses[losses > 0.0]  # 0 and nan were not measured
    return PlateFacts.of(
        specimen.plate,
        specimen.material.isotropic,
        loaded=bool(specimen.sensors),
        air_is_known=specimen.air_density is not None,
        has_references=bool(specimen.material.sd),
        first_frequency=float(model.predict(middle[None]).frequencies[0, 0]),
        loss_factor=float(np.median(known)) if len(known) else None,
    )


@single_blas_thread
def plate_under_test(specimen: Specimen, n_modes: int) -> tuple[ConvergedPlate, PlateModel]:
    """A plate under a possible further test and its full model, converged at the reference constants."""
    parameters, problem, samples = _bare(specimen, other_material=False)
    samples = Samples(samples.x[:1], samples.allowance[:1])
    full = converged_plate(problem, samples, n_modes)
    assert full.basis is not None
    facts = _facts(specimen, parameters, full)
    plate = ConvergedPlate(specimen, facts, parameters, problem, samples, *full.basis, full.error, n_modes)
    return plate, full


def extended_on_space(plate: ConvergedPlate, effect: Effect) -> PlateModel:
    """Full model of a plate with an effect in the plate's space, untrimmed where that lacks functions."""
    problem, samples = extended_problem(plate, effect)
    keep = plate.keep
    if needs_another_space(problem, effect, plate):
        space = ritz_space(problem.edges, problem.nominal, plate.settings)
        keep = np.ones(sum(sector.size for sector in space.sectors), dtype=bool)
    return model_on_basis(problem, samples, plate.n_modes, plate.error, (plate.settings, keep))


def _bare(specimen: Specimen, other_material: bool) -> tuple[ParameterSet, Problem, Samples]:
    parameters = diagnosis_parameters(specimen, other_material=other_material)
    problem = plate_problem(specimen, parameters)
    problem = replace(problem, rigid_content=_CONTENT, bias=theory_bias(specimen))
    return parameters, problem, convergence_samples(specimen, problem)


@single_blas_thread
def extended_model(
    plate: PlateModels, effect: Effect, notify: Callable[[str], None] = lambda text: None
) -> ReducedModel | LocalModel:
    """The reduced model of a plate with an effect, over the priors of both, without matrices of a full space.

    Where the effect changes the edges or couples bending with stretching the space is converged anew. An
    effect at any place has one model for all places, forms that follow from the plate have one basis.
    """
    if effect.on_plate is not None:
        return _form_model(plate, effect, notify)

    def make() -> ReducedModel | LocalModel:
        notify(f"building {effect.name} {effect.variant}".rstrip())
        if effect.is_anywhere:
            return local_model(plate, effect)
        problem, samples = extended_problem(plate, effect)
        if needs_another_space(problem, effect, plate):
            full = converged_plate(problem, Samples(samples, np.ones(2)), plate.n_modes)
        else:
            full = model_on_basis(problem, samples, plate.n_modes, plate.error, (plate.settings, plate.keep))
        return without_matrices(_reduced(full, plate.bare.tolerance))

    priors = [[p.name, repr(p.prior)] for p in effect.parameters]
    # effects defined in scripts may share a name and differ
    key = [plate.key, effect.name, effect.variant, effect.place, repr(effect.change), priors]
    return remembered(json.dumps(key), make)


def _form_model(plate: PlateModels, effect: Effect, notify: Callable[[str], None]) -> ReducedModel:
    """The reduced model of a plate with one of the forms of an effect, on the basis of all of them."""
    assert effect.on_plate is not None
    forms = effect.on_plate(plate.facts)

    def make() -> ReducedModel:
        notify(f"building {effect.name}")
        problem = any_of([extend(plate.problem, form, plate.facts) for form in forms])
        farthest = np.arange(min(len(forms), _FARTHEST_FORMS))
        samples = np.column_stack((np.repeat(plate.samples.x[:1], len(farthest), axis=0), farthest))
        full = converged_plate(problem, Samples(samples, np.ones(len(samples))), plate.n_modes)
        return without_matrices(_reduced(full, plate.bare.tolerance))

    key = [plate.key, effect.name, repr(effect.on_plate), [form.variant for form in forms]]
    shared = remembered(json.dumps(key), make)
    own = extend(plate.problem, effect, plate.facts)
    full, fast = (
        replace(model, operator=AffineOperator(own, model.operator.space, model.operator.blocks))
        for model in (shared.full, shared.fast)
    )
    return replace(shared, full=full, fast=fast)


def extended_problem(plate: ConvergedPlate, effect: Effect) -> tuple[Problem, Array]:
    """Problem of a plate with an effect, and parameter vectors (2, n) without and with it."""
    values = [effect.null, effect.scaled(1.0)]
    added = np.array([[v[p.name] for p in effect.parameters] for v in values])
    samples = np.column_stack((np.repeat(plate.samples.x[:1], 2, axis=0), added))
    return extend(plate.problem, effect, plate.facts), samples


def local_model(plate: PlateModels, effect: Effect) -> LocalModel:
    """The model of a plate with an effect whose place is a parameter."""
    if effect.local is None:
        raise ValueError(f"effect {effect.name}: at any place, but its form is not given in `local`")
    if effect.local == "point":
        return point_mass_model(plate.bare.full, plate.samples.x, effect.parameter_set)
    return patch_model(plate.bare.full, plate.samples.x, effect.parameter_set, effect.local)


def solved_there(plate: ConvergedPlate, effect: Effect, model: LocalModel, x: Array) -> Array:
    """Frequencies (m, n_modes) by full solves of a plate with an effect at a free place, at vectors x (m, n).

    model : the model for all places, whose full space is used
    x : parameters of the plate, then those of the effect
    """
    assert model.bare.basis is not None
    space, frequencies = local_space(plate.problem, model.bare.basis[0]), []
    for row in np.atleast_2d(x):
        parameters = (*plate.parameters.names, *(p.name for p in effect.parameters))
        named = {name: np.array([value]) for name, value in zip(parameters, row, strict=True)}
        there = effect.fixed({name: value[0] for name, value in named.items()})
        full = discretise(extend(plate.problem, there, plate.facts), space, named)
        frequencies.append(solve(full, *full.coefficients(named), model.n_modes).frequencies[0])
    return biased(Prediction(np.array(frequencies), None), model.bare.bias).frequencies


def converged_plate(
    problem: Problem, samples: Samples, n_modes: int, tolerance: Tolerance | None = None
) -> PlateModel:
    """Full model of a problem on a space that ``converge`` has converged at samples."""
    x = problem.parameters.mapping(samples.x)
    converged = converge(problem, x, n_modes, tolerance, samples.allowance)
    return PlateModel(converged.operator, n_modes, converged.error, (converged.settings, converged.keep))


def _reduced(full: PlateModel, tolerance: float) -> ReducedModel:
    # the seed is fixed: a model does not depend on the run that first needed it
    return reduce(full, np.random.default_rng(0), ReductionSettings(tolerance))


def needs_another_space(problem: Problem, effect: Effect, plate: ConvergedPlate) -> bool:
    """Whether the bare plate's space lacks functions for the problem with an effect."""
    return problem.edges != plate.problem.edges or effect.couples_stretching
