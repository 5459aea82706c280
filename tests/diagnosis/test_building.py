"""Models built before the fits are those that would be built when asked for, whoever builds them."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import build_models, hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.forward_model.build import forget_models
from cpam_bayes.plate import read_plate

CAUSES = ("air", "shear_ratio", "sensor_mass")


@pytest.fixture(scope="module")
def whole() -> PlateCase:
    return plate_case(read_plate("C1"))


@pytest.fixture
def case(whole: PlateCase) -> PlateCase:
    return replace(whole, extended={}, of_another_material=[])


def hypotheses(case: PlateCase) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    return [entry for entry in hypotheses_of([case]) if entry[0].cause in CAUSES]


def test_models_are_the_same_from_workers_and_on_demand(case: PlateCase) -> None:
    seen: list[tuple[int, int]] = []
    forget_models()
    with ThreadPoolExecutor(2) as pool:
        build_models([case], hypotheses(case), pool, lambda done, total: seen.append((done, total)))
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert len(case.extended) == 3
    forget_models()
    on_demand = replace(case, extended={})
    for hypothesis, _ in hypotheses(case):
        (effect,) = hypothesis.effects
        model, built = on_demand.with_effect(effect), case.extended[effect.name, effect.variant]
        assert model is not built
        x = model.parameters.sample(np.random.default_rng(0), 20)
        x = x[model.admissible(x)]
        np.testing.assert_array_equal(model.predict(x).frequencies, built.predict(x).frequencies)


def test_models_at_hand_are_not_built_again(case: PlateCase) -> None:
    build_models([case], hypotheses(case))
    seen: list[tuple[int, int]] = []
    build_models([case], hypotheses(case), None, lambda *n: seen.append(n))
    assert not seen


def test_effect_that_cannot_be_sent_is_left_to_be_built_when_asked_for(case: PlateCase) -> None:
    hypothesis, plates = hypotheses(case)[0]
    effect = replace(hypothesis.effects[0], change=lambda problem, facts: problem)
    build_models([case], [(replace(hypothesis, effects=(effect,)), plates)])
    assert not case.extended
