"""Models built before the fits are those that would be built when asked for, whoever builds them."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import build_models, hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.plate import read_plate
from cpam_bayes.storage import read_arrays

CAUSES = ("air", "shear_ratio", "sensor_mass")


@pytest.fixture
def case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PlateCase:
    monkeypatch.setenv("CPAM_BAYES_CACHE", str(tmp_path))
    return plate_case(read_plate("C1"))


def hypotheses(case: PlateCase) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    return [entry for entry in hypotheses_of([case]) if entry[0].cause in CAUSES]


def stored(directory: Path) -> dict[str, dict[str, np.ndarray]]:
    found = {path.name: read_arrays(path) for path in directory.iterdir()}
    return {name: arrays for name, arrays in found.items() if arrays is not None}


def test_models_are_the_same_from_workers_and_on_demand(case: PlateCase, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    with ThreadPoolExecutor(2) as pool:
        build_models([case], hypotheses(case), pool, lambda done, total: seen.append((done, total)))
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    from_workers = stored(tmp_path)
    again = replace(case, extended={})
    for path in tmp_path.iterdir():
        path.unlink()
    for hypothesis, _ in hypotheses(case):
        again.with_effect(hypothesis.effects[0])
    on_demand = stored(tmp_path)
    assert len(on_demand) == 3
    for name, arrays in on_demand.items():
        assert arrays.keys() == from_workers[name].keys()
        assert all(np.array_equal(value, from_workers[name][key]) for key, value in arrays.items())


def test_stored_models_are_not_built_again(case: PlateCase) -> None:
    build_models([case], hypotheses(case))
    seen: list[tuple[int, int]] = []
    build_models([replace(case, extended={})], hypotheses(case), None, lambda *n: seen.append(n))
    assert not seen


def test_effect_that_cannot_be_sent_is_left_to_be_built_when_asked_for(case: PlateCase) -> None:
    hypothesis, plates = hypotheses(case)[0]
    effect = replace(hypothesis.effects[0], change=lambda problem, facts: problem)
    build_models([case], [(replace(hypothesis, effects=(effect,)), plates)])
    assert not case.extended
