"""Trials of several plates and tests: one hidden cause, diagnosed alone and with what else is measured.

Sister plates are of the same material, their constants scattered about common ones; nothing is wrong with
them. Further tests are of the same plate: what is wrong with it is wrong in them too.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis
from cpam_bayes.plate import builtin
from cpam_bayes.plate.records import Sensor
from cpam_bayes.validation.diagnosis.hiding import Hidden, Trial, hide
from cpam_bayes.validation.diagnosis.oracle import oracle
from cpam_bayes.validation.diagnosis.truths import Bench, Reached, bench, true_frequencies

Array = NDArray[Any]
Record = dict[str, Any]

# A known mass over the plate's, and where it sits, over the sides.
_MASS_SHARE, _PLACE = 0.02, (0.05, 0.05)
# Draws that the spread of the constants is that of.
_DRAWS = 1024
# Setups: the plate alone, with sisters, and with a further test of itself.
ALONE, ONE_SISTER, TWO_SISTERS = "alone", "one sister", "two sisters"
CLAMPED, LOADED = "clamped as well", "with a mass as well"
TESTS = (CLAMPED, LOADED)


@dataclass(frozen=True, slots=True)
class Laboratory:
    """A plate, two sisters of the same material, and further tests of the plate by their setups."""

    alone: Bench
    sisters: tuple[Bench, Bench]
    tests: Mapping[str, Bench]

    @property
    def setups(self) -> tuple[str, ...]:
        """All that is diagnosed."""
        return (ALONE, ONE_SISTER, TWO_SISTERS, *self.tests)


def laboratory(
    plate: str, n_listed: int, *, noise: float, resolution: float, tests: Sequence[str] = TESTS
) -> Laboratory:
    """A built-in plate with free edges, what is measured besides, and all models.

    noise : relative standard deviation, given in every file.
    resolution : Hz.
    tests : of ``TESTS``.
    """
    plate_alone = builtin(plate)
    mass = _MASS_SHARE * plate_alone.plate.density * plate_alone.plate.thickness * plate_alone.plate.area
    at = (_PLACE[0] * plate_alone.plate.length, _PLACE[1] * plate_alone.plate.width)
    further = {
        CLAMPED: replace(
            plate_alone, name=f"{plate_alone.name} clamped", plate=replace(plate_alone.plate, edges="CFFF")
        ),
        LOADED: replace(
            plate_alone,
            name=f"{plate_alone.name} with a mass",
            sensors=(*plate_alone.sensors, Sensor(mass, *at)),
        ),
    }
    alone, *others = (
        bench(specimen, n_listed, noise=noise, resolution=resolution)
        for specimen in (plate_alone, *(further[name] for name in tests))
    )
    # a sister's models are the plate's own
    first, second = (_renamed(alone, f"{plate_alone.name}, sister {i}") for i in (1, 2))
    return Laboratory(alone, (first, second), dict(zip(tests, others, strict=True)))


def _renamed(bench_alone: Bench, name: str) -> Bench:
    models = replace(
        bench_alone.case.models, specimen=replace(bench_alone.case.models.specimen, name=name, specimen=name)
    )
    return replace(bench_alone, case=replace(bench_alone.case, models=models))


def run_joint_trial(laboratory: Laboratory, trial: Trial) -> Record:
    """One hidden cause, diagnosed in every setup: its probability, what is claimed, and the constants.

    The constants are those of the plate itself, by the model with the hidden cause, claimed or not.
    "reached" is false where the cause cannot be hidden with the ratio.
    """
    rng = trial.rng(laboratory.alone)
    hidden = hide(laboratory.alone, trial, rng)
    head: Record = {"trial": asdict(trial)}
    if isinstance(hidden, Reached):
        return head | {"reached": False}
    alone = hidden.own.measured(hidden.listed, hidden.noise)
    # common constants from which this plate's are off as a sister's are
    common = hidden.at.x / _scattered(len(hidden.at.x), rng)
    sisters = [
        _simulated(b, hidden, False, common * _scattered(len(common), rng), rng) for b in laboratory.sisters
    ]
    cases: dict[str, Sequence[PlateCase]] = {
        ALONE: [alone],
        ONE_SISTER: [alone, sisters[0]],
        TWO_SISTERS: [alone, *sisters],
    }
    cases |= {
        name: [alone, _simulated(b, hidden, True, hidden.at.x, rng)] for name, b in laboratory.tests.items()
    }
    names = {h.cause for h in hidden.causes}
    alike = oracle(hidden.at, hidden.shift, hidden.noise).alike | names
    return head | {
        "reached": True,
        "causes": sorted(names),
        "alike": sorted(alike),
        "setups": {setup: _answer(plates, names, alike) for setup, plates in cases.items()},
    }


def _scattered(n: int, rng: np.random.Generator) -> Array:
    return np.asarray(1.0 + SCATTER * rng.standard_normal(n))


def _simulated(other: Bench, hidden: Hidden, is_same: bool, x: Array, rng: np.random.Generator) -> PlateCase:
    """Another plate or test with its list; is_same : whether it is of the plate that has the cause."""
    singles = {(h.cause, h.variant): h for h in other.singles}
    pairs = zip(hidden.causes, hidden.sizes, strict=True)
    there = [
        (h if _is_placed(h) else singles.get((h.cause, h.variant)), size) for h, size in pairs if is_same
    ]
    kept = [(h, size) for h, size in there if h is not None and not h.is_of_one_test]
    sizes = np.array([size for _, size in kept])
    f = true_frequencies(other, [h for h, _ in kept], x, sizes, other.n_listed)
    return other.measured(f, rng.standard_normal(other.n_listed))


def _answer(cases: Sequence[PlateCase], names: set[str], alike: frozenset[str] | set[str]) -> Record:
    start = time.process_time()
    diagnosis = diagnose_cases(cases, gain=False, power=False)
    probability = {c.name: c.probability for c in diagnosis.causes}
    leading = next((c.name for c in diagnosis.causes if c.name not in (NONE, OTHER)), NONE)
    with_cause = next(t for t in diagnosis.weighed.tested if t.hypothesis.cause in names)
    model = with_cause.marginal.comparison.model
    constants = model.parts[0].plate_vector(with_cause.marginal.resampled(_DRAWS))
    return {
        "cause_probability": sum(probability.get(name, 0.0) for name in names),
        "class_probability": sum(probability.get(name, 0.0) for name in alike),
        "none": probability[NONE],
        "leads": leading in names,
        "leads_class": leading in alike,
        "claim": diagnosis.claim.kind,
        "claimed": list(diagnosis.claim.causes),
        "claim_is_right": bool(names & set(diagnosis.claim.causes)),
        "relative_sd": (constants.std(axis=0) / np.abs(constants.mean(axis=0))).tolist(),
        "processor_seconds": time.process_time() - start,
    }


def _is_placed(h: Hypothesis) -> bool:
    """Whether its effect is at a place that was drawn: it is on every test of the plate."""
    return any(e.place is not None for e in h.effects)
