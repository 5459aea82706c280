"""A plate on a few of its modes against full models of the same plate with a known mass, a mass, a patch."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cpam_bayes.effects import PlateFacts, add_known_mass, extend, variants
from cpam_bayes.forward_model.local.modal import changed_on_modes, on_modes
from cpam_bayes.forward_model.model import PlateModel, converged_model, model_on_basis, reference_vector
from cpam_bayes.plate.reader import builtin
from cpam_bayes.plate.records import Sensor, Specimen
from tests.effects.cases import BY_NAME

Array = NDArray[Any]
N_MODES = 6


@lru_cache
def plate(name: str) -> tuple[Specimen, PlateModel, Array]:
    """A plate, its full model and twenty parameter vectors within 3 % of its reference constants."""
    specimen = builtin(name)
    full = converged_model(specimen, specimen.unknowns, N_MODES)
    middle = reference_vector(specimen, full.parameters)
    about = np.random.default_rng(0).uniform(0.97, 1.03, (20, len(middle)))
    return specimen, full, middle * about


def facts_of(specimen: Specimen) -> PlateFacts:
    isotropic = specimen.material.isotropic
    return PlateFacts.of(specimen.plate, isotropic, loaded=False, air_is_known=True, has_references=True)


def with_terms(full: PlateModel, problem: Any, samples: Array) -> Array:
    """Frequencies of the plate with more terms, on its own basis."""
    return model_on_basis(problem, samples, N_MODES, full.error, full.basis).predict(samples).frequencies


def test_a_plate_on_its_modes_has_the_frequencies_of_its_full_model_nearby() -> None:
    _, full, x = plate("C1")
    found = on_modes(full, x.mean(axis=0)).model.predict(x).frequencies
    np.testing.assert_allclose(found, full.predict(x).frequencies, rtol=2e-5)


@pytest.mark.parametrize(("name", "share"), [("C1", 0.02), ("C1", 0.2), ("A2", 0.02)])
def test_a_known_mass_is_added_to_the_modes_of_the_plate_without_it(name: str, share: float) -> None:
    specimen, full, x = plate(name)
    of = specimen.plate
    sensor = Sensor(share * of.density * of.thickness * of.area, 0.95 * of.length, 0.9 * of.width)
    expected = with_terms(full, add_known_mass(full.operator.problem, sensor.mass, sensor.x, sensor.y), x)
    found = on_modes(full, x.mean(axis=0), [sensor]).model.predict(x).frequencies
    moved = np.log(expected / full.predict(x).frequencies)
    assert np.abs(moved).max() > 0.02
    np.testing.assert_allclose(np.log(found / expected), 0.0, atol=1e-2 * np.abs(moved).max())
    np.testing.assert_allclose(found, expected, rtol=2e-3 * share / 0.02)


@pytest.mark.parametrize(("effect", "size"), [("sensor_mass", 0.02), ("damage", 0.2)])
def test_a_change_anywhere_moves_the_modes_as_it_moves_the_full_plate(effect: str, size: float) -> None:
    specimen, full, x = plate("C1")
    of = specimen.plate
    facts = facts_of(specimen)
    anywhere = variants(BY_NAME[effect], facts)[0]
    if effect == "sensor_mass":
        size *= of.density * of.thickness * of.area
    along, across, *_ = (p.name for p in anywhere.coordinates)
    place = {p.name: float(p.prior.mean) for p in anywhere.coordinates} | {along: 0.31, across: 0.22}
    fixed = anywhere.fixed(place)
    added = np.array([place.get(p.name, size) for p in anywhere.parameters])
    problem = extend(full.operator.problem, fixed, facts)
    sized = np.column_stack((x, np.full(len(x), size)))
    expected = with_terms(full, problem, sized)
    on_own = changed_on_modes(on_modes(full, x.mean(axis=0)), anywhere)
    found = on_own.predict(np.column_stack((x, np.tile(added, (len(x), 1))))).frequencies
    moved = np.log(expected / full.predict(x).frequencies)
    assert np.sqrt(np.mean(moved**2)) > 2e-3
    # a few per cent of what it moves
    assert np.sqrt(np.mean(np.log(found / expected) ** 2)) < 0.05 * np.sqrt(np.mean(moved**2))


def test_an_effect_without_a_place_and_derivatives_are_refused() -> None:
    specimen, full, x = plate("C1")
    mass = changed_on_modes(on_modes(full, x[0]), variants(BY_NAME["sensor_mass"], facts_of(specimen))[0])
    with pytest.raises(ValueError, match="no derivatives"):
        mass.predict(np.column_stack((x, np.tile([0.01, 0.5, 0.5, 0.01], (len(x), 1)))), jacobian=True)
    with pytest.raises(ValueError, match="not given in `local`"):
        changed_on_modes(on_modes(full, x[0]), BY_NAME["thickness"])
