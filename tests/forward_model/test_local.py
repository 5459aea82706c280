"""A plate with a point mass anywhere: against the full space, finite elements, and itself."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.diagnosis.models import PlateModels, local_model, plate_models
from cpam_bayes.effects import CATALOGUE, Effect, extend, variants
from cpam_bayes.forward_model.local.basis import local_space
from cpam_bayes.forward_model.local.model import LocalModel
from cpam_bayes.forward_model.local.store import stored_local_model
from cpam_bayes.mechanics.affine import AffineOperator
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.spaces.fem import fem_space
from cpam_bayes.mechanics.sparse import discretise_sparse
from cpam_bayes.plate import builtin, layup
from cpam_bayes.plate.records import Sensor
from tests.shared import once_a_run

(MASS,) = (e for e in CATALOGUE if e.name == "sensor_mass")
N = 6


def specimen_of(name: str):  # type: ignore[no-untyped-def]
    """C1, A2, or C1 with plies at an angle ("angled"), or in air with a known sensor ("loaded")."""
    one = builtin("A2" if name == "A2" else "C1")
    if name == "angled":
        return replace(one, plate=replace(one.plate, layup=layup.parse_layup("[30/-40]_s")))
    if name == "loaded":
        return replace(one, sensors=(Sensor(2e-3, 0.02, 0.03),), air_density=1.2)
    return one


@once_a_run
def plate_of(name: str) -> PlateModels:
    return plate_models(specimen_of(name), N)


def mass_of(plate: PlateModels) -> Effect:
    return variants(MASS, plate.facts)[0]


@once_a_run
def model_of(name: str) -> LocalModel:
    plate = plate_of(name)
    return local_model(plate, mass_of(plate))


def random_sets(name: str, n: int, *, gross: bool = False) -> np.ndarray:
    """Parameter sets (m, n) from the priors; gross : at the largest mass, a third of them on an edge."""
    plate, model, rng = plate_of(name), model_of(name), np.random.default_rng(5)
    x = model.parameters.sample(rng, 4 * n)
    x = x[model.admissible(x)][:n]
    if gross:
        x[:, -4] = mass_of(plate).parameters[0].prior.upper
        x[::3, -3] = 1.0
        x[::6, -2] = 1.0
    return x


def fixed_operator(name: str, row: np.ndarray, elements: bool) -> AffineOperator:  # type: ignore[type-arg]
    """The plate with the mass at one place as an affine change, on the model's own space or on elements."""
    plate, model = plate_of(name), model_of(name)
    named = dict(zip(model.parameters.names, row[:, None], strict=True))
    effect = mass_of(plate).fixed(dict(zip(model.parameters.names, row, strict=True)))
    problem = extend(plate.problem, effect, plate.facts)
    if elements:
        space = fem_space(problem.edges, problem.nominal, 20, 20)
        return discretise_sparse(problem, space, named)  # type: ignore[return-value]
    assert model.bare.basis is not None
    return discretise(problem, local_space(plate.problem, model.bare.basis[0]), named)


def truth(name: str, row: np.ndarray, *, elements: bool = False) -> np.ndarray:
    operator = fixed_operator(name, row, elements)
    named = dict(zip(model_of(name).parameters.names, row, strict=True))
    return solve(operator, *operator.coefficients(named), N).frequencies[0]


@pytest.mark.parametrize(
    "name", ["C1", *(pytest.param(name, marks=pytest.mark.slow) for name in ("A2", "angled", "loaded"))]
)
def test_frequencies_are_those_of_the_full_space_with_the_mass_there(name: str) -> None:
    usual, gross = random_sets(name, 2), random_sets(name, 2, gross=True)
    for sets, tolerance in ((usual, 4e-4), (gross, 2e-3)):
        found = model_of(name).predict(sets).frequencies
        errors = np.array([f / truth(name, row) - 1.0 for f, row in zip(found, sets, strict=True)])
        # Rayleigh and Ritz: from above, but for rounding of the terms that were left out as dependent
        assert errors.min() > -1e-6
        assert np.median(errors) < 1e-4
        assert errors.max() < tolerance


def test_frequencies_are_those_of_finite_elements_with_the_mass_there() -> None:
    rows = random_sets("C1", 2)
    rows[:, -4:] = [[0.02, 0.83, 0.61, 0.004], [0.01, 0.97, 0.96, 0.004]]
    model = model_of("C1")
    bare = rows.copy()
    bare[:, -4] = 0.0
    found = model.predict(rows).frequencies / model.predict(bare).frequencies
    expected = [
        truth("C1", a, elements=True) / truth("C1", b, elements=True) for a, b in zip(rows, bare, strict=True)
    ]
    # the shifts, of up to 20 %; a point on a Mindlin plate yields more the finer the elements
    np.testing.assert_allclose(found, expected, rtol=2e-3)


@pytest.mark.parametrize("name", ["C1", "A2"])
def test_no_mass_is_the_bare_plate_wherever_it_is(name: str) -> None:
    sets = random_sets(name, 6)
    sets[:, -4] = 0.0
    plate = plate_of(name)
    bare = plate.bare.predict(sets[:, :-4]).frequencies
    found = model_of(name).predict(sets).frequencies
    # the two spaces differ by the error that the smaller one states, and by that of its reduced basis
    np.testing.assert_allclose(found, bare, rtol=5e-4)
    elsewhere = sets.copy()
    elsewhere[:, -3:-1] = 0.77
    np.testing.assert_allclose(model_of(name).predict(elsewhere).frequencies, found, rtol=2e-5)


def test_images_of_a_place_have_equal_frequencies() -> None:
    sets = random_sets("C1", 6)
    for axis in (-2, -3):
        other = sets.copy()
        other[:, axis] = 1.0 - other[:, axis]
        found = [model_of("C1").predict(x).frequencies for x in (sets, other)]
        np.testing.assert_allclose(*found, rtol=1e-8)


@pytest.mark.parametrize("name", ["C1", "A2", "angled"])
def test_jacobian_is_the_difference_quotient_of_the_frequencies(name: str) -> None:
    model, sets = model_of(name), random_sets(name, 5)
    sets[:, -3:-1] = 0.55 + 0.4 * (sets[:, -3:-1] - 0.5)
    prediction = model.predict(sets, jacobian=True)
    assert prediction.jacobian is not None
    np.testing.assert_allclose(prediction.frequencies, model.predict(sets).frequencies, rtol=1e-9)
    step = 1e-4 * np.maximum(np.abs(sets).max(axis=0), 1e-12)
    for k, h in enumerate(step):
        move = h * np.eye(sets.shape[1])[k]
        quotient = (model.predict(sets + move).frequencies - model.predict(sets - move).frequencies) / (2 * h)
        slope = prediction.jacobian[..., k]
        # the Ritz basis follows the parameters: a difference of second order in its small error
        assert np.abs(slope - quotient).max() < 0.02 * np.abs(slope).max(), model.parameters.names[k]


def test_a_stored_model_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    plate, built = plate_of("C1"), []

    def build() -> LocalModel:
        built.append(1)
        return model_of("C1")

    added = mass_of(plate).parameter_set
    first, second = (stored_local_model("key", plate.problem, added, build, tmp_path) for _ in range(2))
    assert len(built) == 1
    x = random_sets("C1", 5)
    for model in (first, second, pickle.loads(pickle.dumps(second))):
        for jacobian in (False, True):
            a, b = (m.predict(x, jacobian=jacobian) for m in (first, model))
            np.testing.assert_array_equal(a.frequencies, b.frequencies)
            if jacobian:
                np.testing.assert_array_equal(a.jacobian, b.jacobian)
    np.testing.assert_array_equal(model_of("C1").predict(x).frequencies, first.predict(x).frequencies)
