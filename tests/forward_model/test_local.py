"""A plate with a mass or a soft patch anywhere, on its space and on few modes: against full models."""

import pickle
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from cpam_bayes.diagnosis.comparison import PlateCase, comparison_of
from cpam_bayes.diagnosis.diagnose import basis_error_of
from cpam_bayes.diagnosis.evidence import marginal
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.diagnosis.models import PlateModels, local_model, plate_models
from cpam_bayes.effects import CATALOGUE, Effect, add_known_mass, extend, variants
from cpam_bayes.forward_model import model as plate_model
from cpam_bayes.forward_model.local.basis import local_space
from cpam_bayes.forward_model.local.modal import changed_on_modes, on_modes
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.model import PlateModel, Prediction, converged_model, reference_vector
from cpam_bayes.inference.student_mixture import Mixture
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.fem import discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.plate import Measurement, Sensor, Specimen, builtin, layup
from tests.plates import with_plate
from tests.shared import once_a_run

N = 6
FORMS = ("mass", "bell", "rectangle")
every_form = pytest.mark.parametrize("form", FORMS)
SLOW = [("mass", "A2"), ("mass", "angled"), ("mass", "loaded"), ("bell", "A2")]
CASES = [*((form, "C1") for form in FORMS), *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW)]


def specimen_of(name: str) -> Specimen:
    """C1, A2, or C1 with oblique plies ("angled"), or in air with a known sensor ("loaded")."""
    if name == "angled":
        return with_plate("C1", layup=layup.parse_layup("[30/-40]_s"))
    if name == "loaded":
        return replace(builtin("C1"), sensors=(Sensor(2e-3, 0.02, 0.03),), air_density=1.2)
    return builtin(name)


@once_a_run
def plate_of(name: str) -> PlateModels:
    return plate_models(specimen_of(name), N)


def effect_of(form: str, name: str = "C1") -> Effect:
    cause = "sensor_mass" if form == "mass" else "damage"
    of_cause = [v for e in CATALOGUE if e.name == cause for v in variants(e, plate_of(name).facts)]
    return next(v for v in of_cause if form in ("mass", v.local))


@once_a_run
def model_of(form: str, name: str = "C1") -> LocalModel:
    return local_model(plate_of(name), effect_of(form, name))


def random_sets(form: str, n: int, name: str = "C1") -> np.ndarray:
    """Admissible draws from the priors, (n, n_parameters): size, place and radius are the last four."""
    model = model_of(form, name)
    x = model.parameters.sample(np.random.default_rng(5), 4 * n)
    return np.asarray(x[model.admissible(x)][:n])


def gross_sets(form: str, name: str) -> np.ndarray:
    """The largest mass, once in a corner; a deep and large patch, which lowers frequencies by a fifth."""
    x = random_sets(form, 2, name)
    if form == "mass":
        x[:, -4] = effect_of(form, name).parameters[0].prior.upper
        x[0, -3:-1] = 1.0
        return x
    x[0, -4:] = [0.6, 0.63, 0.71, 0.3]
    return x[:1]


def truth(form: str, row: np.ndarray, name: str = "C1", *, elements: bool = False) -> np.ndarray:
    """Frequencies of the plate with the effect at one place, on the model's own space or on elements."""
    plate, model = plate_of(name), model_of(form, name)
    named = {key: np.array([value]) for key, value in zip(model.parameters.names, row, strict=True)}
    effect = effect_of(form, name).fixed({key: value[0] for key, value in named.items()})
    problem = extend(plate.problem, effect, plate.facts)
    if elements:  # with edges along those of the rectangle below
        operator = discretise_sparse(problem, fem_space(problem.edges, problem.nominal, 20, 20), named)
    else:
        operator = discretise(problem, local_space(plate.problem, model.bare.basis[0]), named)
    return solve(operator, *operator.coefficients(named), N).frequencies[0]


@pytest.mark.parametrize(("form", "name"), CASES)
def test_frequencies_are_those_of_the_full_space_with_the_effect_there(form: str, name: str) -> None:
    for sets, tolerance in ((random_sets(form, 2, name), 5e-4), (gross_sets(form, name), 2e-3)):
        found = model_of(form, name).predict(sets).frequencies
        errors = np.array([f / truth(form, row, name) - 1.0 for f, row in zip(found, sets, strict=True)])
        assert errors.min() > (-1e-6 if form == "mass" else -tolerance)  # from above, but for rounding
        assert errors.max() < tolerance


@pytest.mark.parametrize("form", ["mass", "bell"])
def test_an_answer_states_what_the_basis_of_all_places_errs_at_a_few_draws(form: str) -> None:
    effect, model, sets = effect_of(form), model_of(form), random_sets(form, 8)
    measured = Measurement(np.arange(1.0, N + 1.0), 0.0, 0.002, None, ("",) * N, complete=True)
    case = PlateCase(plate_of("C1"), measured, np.arange(N), {(effect.name, effect.variant): model})
    hypothesis = Hypothesis(effect.name, effect.family, effects=(effect,))
    comparison, even = comparison_of([case], hypothesis), np.full(8, -np.log(8))
    nothing = Mixture(np.ones((1, 1)), np.zeros((1, 1, 1)), np.ones((1, 1, 1)), np.inf)
    drawn = marginal.Marginal(comparison, (), 0.0, np.nan, sets[:1], np.ones(1), nothing, sets, even)
    found = Prediction(np.array([truth(form, row) for row in sets[::2]]), None)  # with the theory's bias
    truths = plate_model.biased(found, model.bare.bias)
    errors = np.abs(model.predict(sets[::2]).frequencies / truths.frequencies - 1.0)
    assert errors.max() > 1e-7
    found = basis_error_of([marginal.Tested(hypothesis, (0,), drawn)], [case])
    assert found == pytest.approx(errors.max(), rel=1e-4)


@pytest.mark.parametrize(
    ("form", "effect", "tolerance"),
    [
        ("mass", [0.02, 0.83, 0.61, 0.004], 2e-3),  # under a point finer Mindlin elements are softer
        ("bell", [0.4, 0.65, 0.8, 0.15], 5e-4),
        ("rectangle", [0.4, 0.65, 0.8, 0.15], 2e-3),  # the curvature jumps at a sharp edge
    ],
)
def test_shifts_are_those_of_finite_elements(form: str, effect: list[float], tolerance: float) -> None:
    (row,) = random_sets(form, 1)
    row[-4:] = effect
    bare = row.copy()
    bare[-4] = 0.0
    f = model_of(form).predict(np.stack((row, bare))).frequencies
    expected = truth(form, row, elements=True) / truth(form, bare, elements=True)
    assert np.abs(expected - 1.0).max() > 0.02
    np.testing.assert_allclose(f[0] / f[1], expected, rtol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["bell", "rectangle"])
def test_the_deepest_patches_of_a_clamped_plate_leave_it_stiff(form: str) -> None:
    """No patch loses more energy than there is, however coarse the quadrature of its responses."""
    model, sets = model_of(form, "A2"), random_sets(form, 200, "A2")
    sets[:, -4] = 0.95
    ratio = model.predict(sets).frequencies / plate_of("A2").bare.predict(sets[:, :-4]).frequencies
    assert ratio.max() < 1.0 + 1e-3
    assert ratio.min() > 0.05**0.5


@every_form
def test_images_of_a_place_have_equal_frequencies(form: str) -> None:
    sets = random_sets(form, 6)
    for axis in (-2, -3):
        other = sets.copy()
        other[:, axis] = 1.0 - other[:, axis]
        np.testing.assert_allclose(*(model_of(form).predict(x).frequencies for x in (sets, other)), rtol=1e-8)


@pytest.mark.parametrize(
    ("form", "name"), [*((form, "C1") for form in FORMS), ("mass", "A2"), ("mass", "angled")]
)
def test_jacobian_is_the_difference_quotient_of_the_frequencies(form: str, name: str) -> None:
    model, sets = model_of(form, name), random_sets(form, 5, name)
    if form == "mass":  # away from edges, where a place ends
        sets[:, -3:-1] = 0.55 + 0.4 * (sets[:, -3:-1] - 0.5)
    prediction = model.predict(sets, jacobian=True)
    np.testing.assert_allclose(prediction.frequencies, model.predict(sets).frequencies, rtol=1e-9)
    step = 1e-4 * np.maximum(np.abs(sets).max(axis=0), 1e-12)
    for k, h in enumerate(step):
        move = h * np.eye(sets.shape[1])[k]
        quotient = (model.predict(sets + move).frequencies - model.predict(sets - move).frequencies) / (2 * h)
        slope = prediction.jacobian[..., k]
        tolerance = 0.02 if form == "mass" else 0.05  # the Ritz basis depends on the parameters
        assert np.abs(slope - quotient).max() < tolerance * np.abs(slope).max(), model.parameters.names[k]


@every_form
def test_a_set_has_the_same_frequencies_in_any_company_and_bit_for_bit_in_another_process(form: str) -> None:
    x, model = random_sets(form, 8), model_of(form)
    alone = np.concatenate([model.predict(row).frequencies for row in x])
    np.testing.assert_allclose(model.predict(x).frequencies, alone, rtol=1e-9)
    a, b = (m.predict(x, jacobian=True) for m in (model, pickle.loads(pickle.dumps(model))))
    np.testing.assert_array_equal(a.frequencies, b.frequencies)
    np.testing.assert_array_equal(a.jacobian, b.jacobian)


@cache
def on_own_modes(name: str) -> tuple[Specimen, PlateModel, np.ndarray]:
    """A plate, its full model, and twenty parameter vectors within 3 % of its reference constants."""
    specimen = builtin(name)
    full = converged_model(specimen, specimen.unknowns, N)
    about = np.random.default_rng(0).uniform(0.97, 1.03, (20, full.parameters.size))
    return specimen, full, reference_vector(specimen, full.parameters) * about


def with_terms(full: PlateModel, problem: Any, samples: np.ndarray) -> np.ndarray:
    model = plate_model.model_on_basis(problem, samples, N, full.error, full.basis)
    return model.predict(samples).frequencies


def test_a_plate_on_its_modes_has_the_frequencies_of_its_full_model_nearby() -> None:
    _, full, x = on_own_modes("C1")
    found = on_modes(full, x.mean(axis=0)).model.predict(x).frequencies
    np.testing.assert_allclose(found, full.predict(x).frequencies, rtol=2e-5)


@pytest.mark.parametrize(("name", "share"), [("C1", 0.02), ("C1", 0.2), ("A2", 0.02)])
def test_a_known_mass_is_added_to_the_modes_of_the_plate_without_it(name: str, share: float) -> None:
    specimen, full, x = on_own_modes(name)
    of = specimen.plate
    sensor = Sensor(share * of.density * of.thickness * of.area, 0.95 * of.length, 0.9 * of.width)
    expected = with_terms(full, add_known_mass(full.operator.problem, sensor.mass, sensor.x, sensor.y), x)
    found = on_modes(full, x.mean(axis=0), [sensor]).model.predict(x).frequencies
    moved = np.log(expected / full.predict(x).frequencies)
    assert np.abs(moved).max() > 0.02
    np.testing.assert_allclose(np.log(found / expected), 0.0, atol=1e-2 * np.abs(moved).max())
    np.testing.assert_allclose(found, expected, rtol=2e-3 * share / 0.02)


@pytest.mark.parametrize(("form", "size"), [("mass", 0.02), ("bell", 0.2)])
def test_a_change_anywhere_moves_the_modes_as_it_moves_the_full_plate(form: str, size: float) -> None:
    specimen, full, x = on_own_modes("C1")
    of = specimen.plate
    anywhere = effect_of(form)
    if form == "mass":
        size *= of.density * of.thickness * of.area
    along, across, *_ = (p.name for p in anywhere.coordinates)
    place = {p.name: float(p.prior.mean) for p in anywhere.coordinates} | {along: 0.31, across: 0.22}
    added = np.array([place.get(p.name, size) for p in anywhere.parameters])
    problem = extend(full.operator.problem, anywhere.fixed(place), plate_of("C1").facts)
    expected = with_terms(full, problem, np.column_stack((x, np.full(len(x), size))))
    on_own = changed_on_modes(on_modes(full, x.mean(axis=0)), anywhere)
    found = on_own.predict(np.column_stack((x, np.tile(added, (len(x), 1))))).frequencies
    moved = np.log(expected / full.predict(x).frequencies)
    assert np.sqrt(np.mean(moved**2)) > 2e-3
    # a few per cent of the shift
    assert np.sqrt(np.mean(np.log(found / expected) ** 2)) < 0.05 * np.sqrt(np.mean(moved**2))


def test_an_effect_without_a_place_and_derivatives_are_refused() -> None:
    _, full, x = on_own_modes("C1")
    mass = changed_on_modes(on_modes(full, x[0]), effect_of("mass"))
    with pytest.raises(ValueError, match="no derivatives"):
        mass.predict(np.column_stack((x, np.tile([0.01, 0.5, 0.5, 0.01], (len(x), 1)))), jacobian=True)
    with pytest.raises(ValueError, match="not given in `local`"):
        changed_on_modes(on_modes(full, x[0]), next(e for e in CATALOGUE if e.name == "thickness"))
