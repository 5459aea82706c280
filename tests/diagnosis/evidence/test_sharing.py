"""Work on hypotheses: the same on any executor, with the models of this process in every answer."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import hypotheses_of
from cpam_bayes.diagnosis.diagnose import Diagnosis, diagnose_cases
from cpam_bayes.diagnosis.evidence import sampled as sharing
from cpam_bayes.diagnosis.evidence.sampled import shared_out
from cpam_bayes.diagnosis.next_test import next_measurements
from cpam_bayes.parallel import open_executor
from tests.diagnosed import aluminium_case, listed

CAUSES = {"none", "other", "thickness", "viscoelastic", "outlier"}


def parts(*item: Any) -> tuple[Any, ...]:
    """What was sent, as the worker has it, in another order."""
    return item[::-1]


def refusing(item: object) -> object:
    raise ZeroDivisionError(item)


def diagnosed_on(executor: Any) -> tuple[Diagnosis, tuple[object, ...]]:
    case = aluminium_case()
    case = listed(case, np.array([1.0, 1.0, 1.0, 1.03, 1.0, 1.0]))
    some = [(h, at) for h, at in hypotheses_of([case]) if h.cause in CAUSES]
    diagnosis = diagnose_cases([case], hypotheses=some, executor=executor)
    return diagnosis, next_measurements(diagnosis, always=True, executor=executor)


def numbers(diagnosis: Diagnosis) -> list[bytes]:
    return [
        np.array([t.marginal.log_evidence, t.probability, *t.marginal.moments()[0]]).tobytes()
        for t in diagnosis.weighed.tested
    ]


@pytest.mark.slow
def test_diagnosis_is_the_same_bit_for_bit_on_workers() -> None:
    here, tests_here = diagnosed_on(None)
    with open_executor("processes", 2) as executor:
        there, tests_there = diagnosed_on(executor)
    assert numbers(here) == numbers(there)
    assert here.claim == there.claim
    assert here.detectable == there.detectable
    assert here.gain is not None
    assert there.gain is not None
    assert here.gain.held_out.tobytes() == there.gain.held_out.tobytes()
    assert tests_here == tests_there


def test_models_of_this_process_come_back() -> None:
    case = aluminium_case()
    effect = next(e for h, _ in hypotheses_of([case]) for e in h.effects if e.name == "thickness")
    model = case.with_effect(effect)
    paired = replace(case, modes=case.modes[::-1])
    with ThreadPoolExecutor(1) as executor:
        (answer,) = shared_out(parts, [case], [(case.models, model, paired, np.arange(3.0))], executor)
    array, back, same_model, same_models = answer
    assert same_models is case.models
    assert same_model is model
    assert back.models is case.models
    assert back.extended is case.extended
    assert np.array_equal(back.modes, paired.modes)
    assert np.array_equal(array, np.arange(3.0))


def test_what_items_have_in_common_is_sent_once(monkeypatch: pytest.MonkeyPatch) -> None:
    common = np.arange(50_000.0)
    sent: list[int] = []
    packed = sharing._packed

    def weighed(held: list[Any], value: Any) -> bytes:
        sent.append(len(packed(held, value)))
        return packed(held, value)

    monkeypatch.setattr(sharing, "_packed", weighed)
    answers = shared_out(parts, [], [(common, i) for i in range(3)], common=common)
    assert [number for number, _ in answers] == [0, 1, 2]
    assert all(one is common for _, one in answers)
    assert sum(size > 1000 for size in sent) == 1


def test_what_cannot_be_sent_is_worked_on_here() -> None:
    item = (lambda: 7,)
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pickle.dumps(item)
    with ThreadPoolExecutor(1) as executor:
        assert shared_out(parts, [], [item], executor) == [item]


def test_progress_is_told_and_errors_are_raised() -> None:
    told: list[int] = []
    shared_out(parts, [], [(1, 2), (3, 4)], progress=told.append)
    assert told == [1, 2]
    with pytest.raises(ZeroDivisionError):
        shared_out(refusing, [], [(1,)])
