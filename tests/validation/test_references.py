"""Independent estimates of evidences: nested sampling, and a slow reference for the quick method."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import SCATTER, comparison_of
from cpam_bayes.diagnosis.evidence.sampled import sampled_near_the_best
from cpam_bayes.diagnosis.evidence.scan import Scan, Trial
from cpam_bayes.diagnosis.hypotheses import Hypothesis
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.plate import Measurement, builtin
from tests.diagnosis import toy_plates
from tests.diagnosis.toy_plates import BUMP, NOISE
from validation.evidence_reference import ReferenceSettings, reference_evidence
from validation.nested import Lockstep, nested_of_density


def test_values_are_asked_for_in_stacks_and_answers_go_to_their_tasks() -> None:
    sizes = []

    def batched(points: np.ndarray) -> np.ndarray:
        sizes.append(len(points))
        return np.sum(points**2, axis=1)

    pool = Lockstep(batched, 4)

    def walk(start: int) -> list[float]:
        """Evaluate as many points as the start says, so that tasks end at different times."""
        return [pool.value(np.array([float(start), float(i)])) for i in range(start)]

    found = pool.map(walk, range(6))
    assert found == [[float(s**2 + i**2) for i in range(s)] for s in range(6)]
    assert sizes == [3, 2, 1, 2, 2, 2, 2, 1]  # tasks 0 to 3 run together, then 4 and 5
    assert pool.value(np.array([3.0])) == 9.0


def test_a_task_or_a_likelihood_that_fails_fails_the_whole_and_hangs_nothing() -> None:
    pool = Lockstep(lambda points: points[:, 0], 3)

    def task(i: int) -> float:
        if i == 1:
            raise ValueError("no likelihood here")
        return pool.value(np.array([float(i)]))

    with pytest.raises(ValueError, match="no likelihood here"):
        pool.map(task, range(3))
    assert pool.map(task, [4, 5]) == [4.0, 5.0]

    def broken(points: np.ndarray) -> np.ndarray:
        raise FloatingPointError("no value")

    without = Lockstep(broken, 3)
    with pytest.raises(FloatingPointError, match="no value"):
        without.map(lambda i: without.value(np.array([float(i)])), range(3))


def bent_plate(size: float, sd: float = 0.02) -> tuple[CorrelatedDensity, float]:
    """The toy plate with a bump of this size in list and prior: its density and exact log evidence."""
    shifted = 1.0 + toy_plates.A @ np.array([0.03, -0.04]) + size * BUMP
    f = toy_plates.F0 * shifted * (1.0 + NOISE * toy_plates.SCATTER)
    bent = toy_plates.cause("bent", toy_plates.whole_normal(sd))
    case = toy_plates.case(toy_plates.a_list(f, NOISE), [(bent, toy_plates.straight(BUMP))])
    comparison = comparison_of([case], toy_plates.hypothesis(bent, 0.1))
    return comparison, toy_plates.exact_log_evidence(f, NOISE * f, (BUMP, sd))


@pytest.mark.slow
def test_nested_sampling_finds_the_evidence_of_a_linear_plate() -> None:
    pytest.importorskip("dynesty")
    density, exact = bent_plate(0.01)
    log_evidence, error = nested_of_density(density, np.random.default_rng(0), live_points=100)
    assert error < 0.4
    assert log_evidence == pytest.approx(exact, abs=3.0 * error)


SMALL = ReferenceSettings(draws=256, nodes=41, log2_points=(11, 13))


@pytest.mark.parametrize("size", [0.0, 0.01, -0.05])
def test_the_reference_finds_the_evidence_of_a_linear_plate(size: float) -> None:
    comparison, exact = bent_plate(size)
    found = reference_evidence(comparison, (2,), 0, SMALL)
    assert found.error < 0.05  # three of its standard errors
    assert found.log_evidence == pytest.approx(exact, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["none", pytest.param("damage", marks=pytest.mark.weekly), "taper_x"])
def test_the_quick_way_agrees_with_the_reference_on_a_plate(hidden: str) -> None:
    waiting = Measurement(np.arange(1.0, 11.0), 0.1, 0.002, None, ("",) * 10, complete=True)
    plate = plate_case(replace(builtin("C1"), measurement=waiting))
    known = {h.cause: h for h, _ in hypotheses_of([plate])}
    chosen: list[Hypothesis] = [known[name] for name in dict.fromkeys(("none", hidden, "thickness"))]
    truth, rng = comparison_of([plate], known[hidden]), np.random.default_rng(3)
    x = truth.scores.to_x(rng.standard_normal((1, truth.parameters.size)))
    f = truth.predict(x)[0][0] * (1.0 + 0.002 * rng.standard_normal(10))
    plate = replace(plate, measurement=replace(waiting, frequencies=np.sort(f)))
    scan = Scan([plate], SCATTER)
    scan.begin(chosen[0], (0,))
    scan.test([Trial(h, (0,)) for h in chosen[1:]])
    tested = sampled_near_the_best(scan.tested, [plate]) or scan.tested
    slow = [reference_evidence(t.marginal.comparison, t.marginal.sizes, 0, SMALL) for t in tested]
    highest = max(s.log_evidence for s in slow)
    for t, s in zip(tested, slow, strict=True):
        if s.log_evidence > highest - 8.0:
            assert t.marginal.log_evidence == pytest.approx(s.log_evidence, abs=0.3)
        else:
            assert t.marginal.log_evidence < highest - 8.0
