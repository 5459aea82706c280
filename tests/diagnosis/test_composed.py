"""The model of a hypothesis: effects put together, several plates, lists with slips, and derivatives."""

import numpy as np
import pytest

from cpam_bayes.effects import Effect
from cpam_bayes.effects.effect import FREQUENCY_SCALE, VISCOELASTIC
from cpam_bayes.forward_model.composed import Change, ComposedModel, Part
from cpam_bayes.parameters import Parameter, ParameterSet
from tests.diagnosis.toy_plates import (
    BUMP,
    CONSTANTS,
    DENT,
    F0,
    Array,
    cause,
    differences,
    even,
    plate_model,
    straight,
    whole_normal,
)
from tests.toy_models import ToyModel

BARE = plate_model()
BENT = cause("bent", whole_normal(0.01)).parameters[0]
DUSTY = cause("dusty", whole_normal(0.1)).parameters[0]
WITH_BEND = plate_model(shift=straight(BUMP), parameter=BENT)
WITH_DUST = plate_model(shift=even(DENT), parameter=DUSTY)
EVERY_MODE = np.arange(len(F0))
NO_SCATTER = np.array([-1, -1])
X = np.array([1.03, 0.95, 0.012, -0.2])


def joint(*further: Parameter) -> ParameterSet:
    return ParameterSet((*CONSTANTS.parameters, *further))


def plain(name: str, sd: float = 0.01) -> Parameter:
    return Parameter(name, "", whole_normal(sd))


def one_part(model: ParameterSet, *changes: Change, **named: object) -> ComposedModel:
    given: dict[str, object] = {"scatter": NO_SCATTER, "modes": EVERY_MODE, **named}
    return ComposedModel(model, (Part(BARE, np.array([0, 1]), changes=changes, **given),))  # type: ignore[arg-type]


def bend(column: int = 2) -> Change:
    return Change((BENT.name,), (column,), WITH_BEND)


def dust(column: int = 3) -> Change:
    return Change((DUSTY.name,), (column,), WITH_DUST)


def assert_derivatives_are_difference_quotients(model: ComposedModel, x: Array) -> None:
    found = model.predict(x[None], jacobian=True)
    assert found.jacobian is not None
    assert found.jacobian.shape == (1, found.frequencies.shape[1], len(x))
    expected = differences(lambda v: model.predict(v).frequencies, x)
    # central differences with a step of 1e-6 of frequencies of some 1e2 Hz: rounding 1e-8, curvature less
    np.testing.assert_allclose(found.jacobian[0], expected, atol=2e-6 * F0.max(), rtol=2e-7)


@pytest.mark.parametrize("bent", [False, True])
def test_the_model_is_that_of_the_bare_plate_or_with_one_effect_the_extended_one(bent: bool) -> None:
    model, same = (one_part(joint(BENT), bend()), WITH_BEND) if bent else (one_part(joint()), BARE)
    x = np.stack((X[:3], [0.9, 1.1, -0.02]))[:, : 2 + bent]
    found, expected = (m.predict(x, jacobian=True) for m in (model, same))
    np.testing.assert_allclose(found.frequencies, expected.frequencies, rtol=1e-14)
    np.testing.assert_allclose(found.jacobian, expected.jacobian, rtol=1e-13)
    # noise after the parameters is none of the model
    longer = np.column_stack((x, [0.01, 0.01]))
    np.testing.assert_array_equal(model.predict(longer).frequencies, found.frequencies)


def test_two_effects_add_their_relative_shifts() -> None:
    model = one_part(joint(BENT, DUSTY), bend(), dust())
    f = model.predict(X[None]).frequencies
    bare = BARE.predict(X[None, :2]).frequencies
    bent, dusty = (
        WITH_BEND.predict(X[None, :3]).frequencies,
        WITH_DUST.predict(X[None, [0, 1, 3]]).frequencies,
    )
    np.testing.assert_allclose(f / bare, bent / bare * dusty / bare, rtol=1e-13)
    assert_derivatives_are_difference_quotients(model, X)


def test_derivatives_with_the_effect_before_the_constants() -> None:
    own = ParameterSet((BENT, *CONSTANTS.parameters))
    part = Part(BARE, np.array([1, 2]), NO_SCATTER, (bend(0),), EVERY_MODE)
    model = ComposedModel(own, (part,))
    x = np.array([[0.012, 1.03, 0.95]])
    expected = WITH_BEND.predict(X[None, :3], jacobian=True)
    found = model.predict(x, jacobian=True)
    np.testing.assert_allclose(found.frequencies, expected.frequencies, rtol=1e-14)
    assert found.jacobian is not None
    assert expected.jacobian is not None
    np.testing.assert_allclose(found.jacobian[:, :, [1, 2, 0]], expected.jacobian, rtol=1e-13)


@pytest.mark.parametrize("effect", [FREQUENCY_SCALE, VISCOELASTIC], ids=lambda e: e.name)
def test_an_effect_on_the_frequencies_acts_on_those_of_the_plate_with_its_effect(effect: Effect) -> None:
    own = effect.parameters[0]
    model = one_part(joint(BENT, own), bend(), Change((own.name,), (3,), None, effect.observe))
    x = np.array([1.03, 0.95, 0.012, 0.02])
    assert_derivatives_are_difference_quotients(model, x)
    f = WITH_BEND.predict(x[None, :3]).frequencies
    factor = (f / f[:, :1]) ** (0.02 / np.pi) if effect is VISCOELASTIC else 1.02
    np.testing.assert_allclose(model.predict(x[None]).frequencies, f * factor, rtol=1e-13)


def test_a_frequency_that_is_misread_is_multiplied() -> None:
    model = one_part(joint(BENT, plain("slip", 0.05)), bend(), misread=((3, 3),))
    x = np.array([1.03, 0.95, 0.012, 0.2])
    factor = np.ones(len(F0))
    factor[3] = 1.2
    np.testing.assert_allclose(
        model.predict(x[None]).frequencies, factor * WITH_BEND.predict(x[None, :3]).frequencies, rtol=1e-13
    )
    assert_derivatives_are_difference_quotients(model, x)


def two_plates() -> ComposedModel:
    """Two plates of one material: constants, the scatter of each, and an effect of the second."""
    own = joint(*(plain(f"scatter {i}") for i in range(4)), BENT)
    parts = (
        Part(BARE, np.array([0, 1]), np.array([2, 3]), (), EVERY_MODE[:5]),
        Part(BARE, np.array([0, 1]), np.array([4, 5]), (bend(6),), EVERY_MODE[2:]),
    )
    return ComposedModel(own, parts)


def test_each_plate_has_its_own_deviation_from_the_shared_constants() -> None:
    x = np.array([1.03, 0.95, 0.02, -0.01, 0.005, 0.03, 0.012])
    first = BARE.predict(np.array([[1.03 * 1.02, 0.95 * 0.99]])).frequencies[:, :5]
    second = WITH_BEND.predict(np.array([[1.03 * 1.005, 0.95 * 1.03, 0.012]])).frequencies[:, 2:]
    expected = np.concatenate((first, second), axis=1)
    np.testing.assert_allclose(two_plates().predict(x[None]).frequencies, expected, rtol=1e-14)
    assert_derivatives_are_difference_quotients(two_plates(), x)


def test_plates_are_admissible_where_every_one_of_them_is() -> None:
    def below(limit: float) -> ToyModel:
        return ToyModel(CONSTANTS, BARE.function, lambda x: x[:, 0] < limit)

    parts = tuple(
        Part(below(limit), np.array([0, 1]), np.array([2, -1]), (), EVERY_MODE) for limit in (1.1, 1.0)
    )
    model = ComposedModel(joint(plain("scatter")), parts)
    x = np.array([[0.9, 1.0, 0.0], [1.05, 1.0, 0.0], [0.9, 1.0, 0.2], [1.2, 1.0, -0.3]])
    np.testing.assert_array_equal(model.admissible(x), [True, False, False, True])
