"""Known labels: the mode keeps its name where modes cross, and a label decides between two pairings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.labels import LabelError, LabelledModel, labelled_model, same_label
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.identification.point import estimate_constants
from cpam_bayes.identification.search import start_of
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Measurement, Specimen, read_specimen

TWISTED_FIRST = ("(1,1)", "(0,2)")
BENT_FIRST = ("(0,2)", "(1,1)")
SPARE = 4


def known(name: str, *names: str) -> Specimen:
    """A built-in plate of which only the named constants are unknown."""
    specimen = read_specimen(name)
    return replace(specimen, unknowns=ParameterSet(tuple(specimen.unknowns[n] for n in names)))


def listed(frequencies: np.ndarray, labels: tuple[str, ...], complete: bool = True) -> Measurement:
    return Measurement(np.asarray(frequencies), 0.0, 0.003, None, labels, complete)


@pytest.fixture(scope="module")
def plate() -> Specimen:
    """B1, whose twisting and first bending mode cross as G12 grows."""
    return known("B1", "E2", "G12")


@pytest.fixture(scope="module")
def model(plate: Specimen) -> ReducedModel:
    return reduced_model(plate, plate.unknowns, 2 + SPARE)


@pytest.fixture(scope="module")
def crossed(plate: Specimen, model: ReducedModel) -> np.ndarray:
    """Two frequencies of a plate whose twisting mode is above its bending mode: G12 16 GPa, E2 9.34 GPa."""
    truth = model.full.modes(np.array([9.34e9, 16e9]))
    assert [mode.label for mode in truth[:2]] == list(BENT_FIRST)
    return np.array([mode.frequency for mode in truth[:2]])


def test_a_labelled_mode_is_followed_through_crossings(plate: Specimen, model: ReducedModel) -> None:
    own = labelled_model(model, listed(np.array([60.0, 84.0]), TWISTED_FIRST), plate)
    assert isinstance(own, LabelledModel)
    x = plate.unknowns.sample(np.random.default_rng(0), 60)
    x = x[own.admissible(x)]
    found = own.predict(x).frequencies
    for i, one in enumerate(x):
        by_label = {mode.label: mode.frequency for mode in model.full.modes(one)}
        # the reduced model is good to 5e-5 where it was trained, to twice that in between
        np.testing.assert_allclose(found[i, :2], [by_label[label] for label in TWISTED_FIRST], rtol=2e-4)
    order = own.order(x)
    assert 0.2 < np.mean(order[:, 0] == 1) < 0.8
    np.testing.assert_array_equal(np.sort(order, axis=1), np.tile(np.arange(6), (len(x), 1)))
    np.testing.assert_array_equal(np.take_along_axis(model.predict(x).frequencies, order, axis=1), found)
    assert np.all(np.diff(found[:, 2:], axis=1) > 0)


def test_derivatives_stand_in_the_places_of_their_modes(plate: Specimen, model: ReducedModel) -> None:
    own = labelled_model(model, listed(np.array([60.0, 84.0]), TWISTED_FIRST), plate)
    x, step = np.array([[9.34e9, 16e9]]), np.array([[0.0, 1e7]])
    jacobian = own.predict(x, jacobian=True).jacobian
    up, down = (own.predict(x + s * step).frequencies for s in (1, -1))
    # a step of 6e-4 of G12: curvature enters with its square; rounding of f by 1e-6 Hz gives 1e-13
    np.testing.assert_allclose(jacobian[0, :, 1], (up - down)[0] / 2e7, rtol=1e-5, atol=1e-13)
    assert jacobian[0, 0, 1] > 10 * abs(jacobian[0, 1, 1])  # twisting depends on G12, bending hardly


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("labels", [TWISTED_FIRST, BENT_FIRST])
def test_labels_decide_between_two_constants_that_give_the_same_list(
    plate: Specimen, crossed: np.ndarray, labels: tuple[str, str], complete: bool
) -> None:
    data = listed(crossed, labels, complete)
    settings = SwarmSettings(particles=20, iterations=60)
    begun = start_of(replace(plate, measurement=data), 0, swarm_settings=settings)
    best = begun.bests[np.argmin(begun.values)]
    predicted = begun.posterior.predict(best[None])[0, :2]
    np.testing.assert_allclose(predicted, crossed, rtol=3e-3)  # one standard deviation of the data
    by_label = {mode.label: mode.frequency for mode in begun.model.full.modes(best)}
    np.testing.assert_allclose([by_label[label] for label in labels], crossed, rtol=3e-3)
    g12 = best[1] / 16e9
    if labels == BENT_FIRST:
        assert g12 == pytest.approx(1.0, abs=0.02)
    else:  # the twisting mode at 84 instead of 96 Hz: (84 / 96)^2 of the shear modulus
        assert g12 == pytest.approx((crossed[0] / crossed[1]) ** 2, abs=0.04)
    np.testing.assert_array_equal(begun.posterior.most_probable_pairing(best).mode, [0, 1])


def test_the_swarm_reports_modes_beside_the_frequencies_that_they_belong_to(plate: Specimen) -> None:
    # too far apart for the bounds of G12: the labelled modes stay crossed in the answer
    data = listed(np.array([80.0, 84.0]), BENT_FIRST)
    narrow = replace(plate, unknowns=plate.unknowns.fix(G12=16e9), measurement=data)
    found = estimate_constants(narrow, 0, settings=SwarmSettings(particles=10, iterations=30))
    assert [mode.label for mode in found.predicted] == list(BENT_FIRST)
    assert len(found.error) == 2


def test_a_label_that_the_model_does_not_have_is_refused_with_those_that_it_has(
    plate: Specimen, model: ReducedModel
) -> None:
    data = listed(np.array([60.0, 84.0]), ("(1,1)", "(7,7)"))
    with pytest.raises(
        LabelError, match=r"received '\(7,7\)' for one frequency, no mode.*\(1,1\) at"
    ) as caught:
        labelled_model(model, data, plate)
    for mode in model.full.modes(np.array([9.34e9, 6.25e9])):
        assert mode.label in str(caught.value)


def test_a_label_of_two_modes_names_them_in_ascending_order_and_not_one_of_them() -> None:
    plate = read_specimen("A1")
    model = reduced_model(plate, plate.unknowns, 6 + SPARE)
    f = np.array([114.0, 167.0, 218.0, 289.0, 300.0, 497.0])
    both = "(2,0)+(0,2)"
    own = labelled_model(model, listed(f, ("", both, " (0,2) + (2,0)", "", "", "")), plate)
    assert isinstance(own, LabelledModel)
    np.testing.assert_array_equal(own.order(np.array([[69e9, 0.33]]))[0], np.arange(10))
    with pytest.raises(LabelError, match="for one frequency, 2 modes of the model have it"):
        labelled_model(model, listed(f, ("", both, "", "", "", "")), plate)
    with pytest.raises(LabelError, match="for 3 frequencies, 2 modes"):
        labelled_model(model, listed(f, ("", both, both, both, "", "")), plate)


def test_a_list_without_labels_leaves_the_model_alone(plate: Specimen, model: ReducedModel) -> None:
    assert labelled_model(model, listed(np.array([60.0, 84.0]), ("", "")), plate) is model


def test_a_posterior_does_not_pass_over_labels(model: ReducedModel) -> None:
    with pytest.raises(ValueError, match="labelled_model"):
        plate_posterior(model, listed(np.array([60.0, 84.0]), TWISTED_FIRST), np.zeros(6))


@pytest.mark.parametrize("label", ["(2,0)+(0,2)", "(0,2)+(2,0)", " (0, 2) + (2,0) "])
def test_spaces_and_the_order_of_parts_do_not_matter(label: str) -> None:
    assert same_label(label) == "(2,0)+(0,2)"
