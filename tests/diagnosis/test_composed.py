"""The model of a hypothesis: effects put together, several plates, lists with slips, and derivatives."""

import numpy as np
import pytest

from cpam_bayes.effects import Effect
from cpam_bayes.effects.effect import FREQUENCY_SCALE, VISCOELASTIC
from cpam_bayes.forward_model.composed import Change, ComposedModel, Part
from cpam_bayes.parameters import Parameter, ParameterSet
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import BENT, BUMP, CONSTANTS, DENT, F0, Array
from tests.toy_models import ToyModel

BARE = toy.plate_model()
(BEND,), (DUST,) = BENT.parameters, toy.WARP.parameters
WITH_BEND = toy.plate_model(shift=toy.straight(BUMP), parameter=BEND)
WITH_DUST = toy.plate_model(shift=toy.even(DENT), parameter=DUST)
EVERY_MODE = np.arange(len(F0))
X = np.array([1.03, 0.95, 0.012, -0.2])


def plain(name: str, sd: float = 0.01) -> Parameter:
    return Parameter(name, "", toy.whole_normal(sd))


def one_plate(
    *changes: Change, further: tuple[Parameter, ...] = (), misread: tuple[tuple[int, int], ...] = ()
) -> ComposedModel:
    part = Part(BARE, np.array([0, 1]), np.array([-1, -1]), changes, EVERY_MODE, misread)
    return ComposedModel(ParameterSet((*CONSTANTS.parameters, *further)), (part,))


def bend(column: int = 2) -> Change:
    return Change((BEND.name,), (column,), WITH_BEND)


def assert_predicts(model: ComposedModel, x: Array, expected: Array) -> None:
    """Frequencies, and derivatives that are their difference quotients."""
    found = model.predict(x[None], jacobian=True)
    np.testing.assert_allclose(found.frequencies[0], expected, rtol=1e-13)
    assert found.jacobian is not None
    assert found.jacobian.shape == (1, len(expected), len(x))
    slopes = toy.differences(lambda v: model.predict(v).frequencies, x)
    # central differences with a step of 1e-6 of frequencies of some 1e2 Hz: rounding 1e-8, curvature less
    np.testing.assert_allclose(found.jacobian[0], slopes, atol=2e-6 * F0.max(), rtol=2e-7)


def bent(constants: Array, size: float) -> Array:
    return np.asarray(WITH_BEND.predict(np.append(constants, size)).frequencies[0])


@pytest.mark.parametrize("is_bent", [False, True])
def test_the_model_is_that_of_the_bare_plate_or_with_one_effect_the_extended_one(is_bent: bool) -> None:
    model, same = (one_plate(bend(), further=(BEND,)), WITH_BEND) if is_bent else (one_plate(), BARE)
    x = np.stack((X[:3], [0.9, 1.1, -0.02]))[:, : 2 + is_bent]
    found, expected = (m.predict(x, jacobian=True) for m in (model, same))
    np.testing.assert_allclose(found.frequencies, expected.frequencies, rtol=1e-14)
    assert found.jacobian is not None
    assert expected.jacobian is not None
    np.testing.assert_allclose(found.jacobian, expected.jacobian, rtol=1e-13)
    # noise after the parameters is none of the model
    longer = np.column_stack((x, [0.01, 0.01]))
    np.testing.assert_array_equal(model.predict(longer).frequencies, found.frequencies)


def test_two_effects_add_their_relative_shifts() -> None:
    model = one_plate(bend(), Change((DUST.name,), (3,), WITH_DUST), further=(BEND, DUST))
    bare, dusty = (m.predict(x).frequencies[0] for m, x in ((BARE, X[:2]), (WITH_DUST, X[[0, 1, 3]])))
    assert_predicts(model, X, bent(X[:2], X[2]) * dusty / bare)


@pytest.mark.parametrize("effect", [FREQUENCY_SCALE, VISCOELASTIC], ids=lambda e: e.name)
def test_an_effect_on_the_frequencies_acts_on_those_of_the_plate_with_its_effect(effect: Effect) -> None:
    own = effect.parameters[0]
    model = one_plate(bend(), Change((own.name,), (3,), None, effect.observe), further=(BEND, own))
    f = bent(X[:2], X[2])
    factor = (f / f[0]) ** (0.02 / np.pi) if effect is VISCOELASTIC else 1.02
    assert_predicts(model, np.append(X[:3], 0.02), f * factor)


def test_a_frequency_that_is_misread_is_multiplied() -> None:
    model = one_plate(bend(), further=(BEND, plain("slip", 0.05)), misread=((3, 3),))
    factor = np.where(EVERY_MODE == 3, 1.2, 1.0)
    assert_predicts(model, np.append(X[:3], 0.2), factor * bent(X[:2], X[2]))


def test_each_plate_has_its_own_deviation_from_the_shared_constants() -> None:
    """The effect of the second one is the first parameter, and then the constants."""
    scatter = (plain(f"scatter {i}") for i in range(4))
    parts = (
        Part(BARE, np.array([1, 2]), np.array([3, 4]), (), EVERY_MODE[:5]),
        Part(BARE, np.array([1, 2]), np.array([5, 6]), (bend(0),), EVERY_MODE[2:]),
    )
    model = ComposedModel(ParameterSet((BEND, *CONSTANTS.parameters, *scatter)), parts)
    first = BARE.predict(np.array([1.03 * 1.02, 0.95 * 0.99])).frequencies[0, :5]
    second = bent(np.array([1.03 * 1.005, 0.95 * 1.03]), 0.012)[2:]
    x = np.array([0.012, 1.03, 0.95, 0.02, -0.01, 0.005, 0.03])
    assert_predicts(model, x, np.concatenate((first, second)))


def test_plates_are_admissible_where_every_one_of_them_is() -> None:
    parts = tuple(
        Part(
            ToyModel(CONSTANTS, BARE.function, lambda x, limit=limit: x[:, 0] < limit),  # type: ignore[misc]
            np.array([0, 1]),
            np.array([2, -1]),
            (),
            EVERY_MODE,
        )
        for limit in (1.1, 1.0)
    )
    model = ComposedModel(ParameterSet((*CONSTANTS.parameters, plain("scatter"))), parts)
    x = np.array([[0.9, 1.0, 0.0], [1.05, 1.0, 0.0], [0.9, 1.0, 0.2], [1.2, 1.0, -0.3]])
    np.testing.assert_array_equal(model.admissible(x), [True, False, False, True])
