"""A plate with a softer patch anywhere: against the full space, finite elements, and itself."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.diagnosis.models import PlateModels, local_model, plate_models
from cpam_bayes.effects import CATALOGUE, Effect, extend, variants
from cpam_bayes.forward_model.local.basis import local_space
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.local.store import stored_local_model
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.spaces.fem import fem_space
from cpam_bayes.mechanics.sparse import discretise_sparse
from cpam_bayes.plate import builtin
from tests.shared import once_a_run

(DAMAGE,) = (e for e in CATALOGUE if e.name == "damage")
FORMS = ("bell", "rectangle")
N = 6

every_form = pytest.mark.parametrize("form", FORMS)


@once_a_run
def plate_of(name: str) -> PlateModels:
    return plate_models(builtin(name), N)


def damage_of(form: str, name: str = "C1") -> Effect:
    (effect,) = (e for e in variants(DAMAGE, plate_of(name).facts) if e.local == form)
    return effect


@once_a_run
def model_of(form: str, name: str = "C1") -> LocalModel:
    return local_model(plate_of(name), damage_of(form, name))


def random_sets(form: str, n: int, name: str = "C1") -> np.ndarray:
    """Admissible draws from the priors, (n, n_parameters)."""
    model = model_of(form, name)
    x = model.parameters.sample(np.random.default_rng(5), 4 * n)
    return np.asarray(x[model.admissible(x)][:n])


def truth(form: str, row: np.ndarray, name: str = "C1", *, elements: bool = False) -> np.ndarray:
    """Frequencies of the plate with the damage there, on the model's own space or on elements."""
    plate, model = plate_of(name), model_of(form, name)
    named = {key: np.array([value]) for key, value in zip(model.parameters.names, row, strict=True)}
    effect = damage_of(form, name).fixed({key: value[0] for key, value in named.items()})
    problem = extend(plate.problem, effect, plate.facts)
    if elements:
        # the edges of elements are those of the rectangle below
        operator = discretise_sparse(problem, fem_space(problem.edges, problem.nominal, 20, 20), named)
        return solve(operator, *operator.coefficients(named), N).frequencies[0]
    assert model.bare.basis is not None
    dense = discretise(problem, local_space(plate.problem, model.bare.basis[0]), named)
    return solve(dense, *dense.coefficients(named), N).frequencies[0]


@pytest.mark.parametrize(
    ("form", "name"), [*((f, "C1") for f in FORMS), pytest.param("bell", "A2", marks=pytest.mark.slow)]
)
def test_frequencies_are_those_of_the_full_space_with_the_damage_there(form: str, name: str) -> None:
    sets = random_sets(form, 4, name)
    sets[0, -4:] = [0.6, 0.63, 0.71, 0.3]
    found = model_of(form, name).predict(sets).frequencies
    errors = np.array([f / truth(form, row, name) - 1.0 for f, row in zip(found, sets, strict=True)])
    assert np.abs(errors[1:]).max() < 5e-4
    # deep and large: it lowers frequencies by a fifth
    assert np.abs(errors[0]).max() < 2e-3


@every_form
def test_frequencies_are_those_of_finite_elements_with_the_damage_there(form: str) -> None:
    (row,) = random_sets(form, 1)
    row[-4:] = [0.4, 0.65, 0.8, 0.15]
    bare = row.copy()
    bare[-4] = 0.0
    model = model_of(form)
    f = model.predict(np.stack((row, bare))).frequencies
    expected = truth(form, row, elements=True) / truth(form, bare, elements=True)
    assert np.abs(expected - 1.0).max() > 0.02
    # curvature jumps at a sharp edge, which polynomials follow less well than elements that end there
    np.testing.assert_allclose(f[0] / f[1], expected, rtol={"bell": 5e-4, "rectangle": 2e-3}[form])


@every_form
def test_no_damage_is_the_bare_plate_wherever_it_is(form: str) -> None:
    sets = random_sets(form, 6)
    sets[:, -4] = 0.0
    found = model_of(form).predict(sets).frequencies
    # the two spaces differ by the error that the smaller one states, and by that of its reduced basis
    np.testing.assert_allclose(found, plate_of("C1").bare.predict(sets[:, :-4]).frequencies, rtol=5e-4)


@every_form
def test_more_damage_lowers_every_frequency(form: str) -> None:
    sets = random_sets(form, 6)
    deeper = sets.copy()
    deeper[:, -4] = 0.5 * (1.0 + sets[:, -4])
    f, g = (model_of(form).predict(x).frequencies for x in (sets, deeper))
    assert np.all(g < f * (1.0 + 1e-6))


@pytest.mark.slow
@every_form
def test_the_deepest_patches_of_a_clamped_plate_leave_it_stiff(form: str) -> None:
    """No patch loses more energy than there is, however coarse its quadrature is for the responses."""
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
        found = [model_of(form).predict(x).frequencies for x in (sets, other)]
        np.testing.assert_allclose(*found, rtol=1e-8)


@every_form
def test_jacobian_is_the_difference_quotient_of_the_frequencies(form: str) -> None:
    model, sets = model_of(form), random_sets(form, 5)
    prediction = model.predict(sets, jacobian=True)
    assert prediction.jacobian is not None
    np.testing.assert_allclose(prediction.frequencies, model.predict(sets).frequencies, rtol=1e-9)
    step = 1e-4 * np.abs(sets).max(axis=0)
    for k, h in enumerate(step):
        move = h * np.eye(sets.shape[1])[k]
        quotient = (model.predict(sets + move).frequencies - model.predict(sets - move).frequencies) / (2 * h)
        slope = prediction.jacobian[..., k]
        # the Ritz basis follows the parameters: a difference of second order in its small error
        assert np.abs(slope - quotient).max() < 0.05 * np.abs(slope).max(), model.parameters.names[k]


def test_a_set_has_the_same_frequencies_in_any_company() -> None:
    sets = random_sets("bell", 8)
    model = model_of("bell")
    alone = np.concatenate([model.predict(row).frequencies for row in sets])
    np.testing.assert_allclose(model.predict(sets).frequencies, alone, rtol=1e-9)


@every_form
def test_a_stored_model_is_the_same_bit_for_bit(form: str, tmp_path: Path) -> None:
    plate, added = plate_of("C1"), damage_of(form).parameter_set
    first, second = (
        stored_local_model("key", plate.problem, added, lambda: model_of(form), tmp_path) for _ in range(2)
    )
    x = random_sets(form, 5)
    for model in (second, pickle.loads(pickle.dumps(second))):
        a, b = (m.predict(x, jacobian=True) for m in (first, model))
        np.testing.assert_array_equal(a.frequencies, b.frequencies)
        np.testing.assert_array_equal(a.jacobian, b.jacobian)
    np.testing.assert_array_equal(model_of(form).predict(x).frequencies, first.predict(x).frequencies)
