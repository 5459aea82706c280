"""Computations behind the rows: plain data in, plain data out, so that each is stored when it is done."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from cpam_bayes.comparison.cases import FOUR, case_specimen, with_constants
from cpam_bayes.comparison.well_posed import well_posed
from cpam_bayes.forward_model.solve import forward
from cpam_bayes.identification.identify import identify
from cpam_bayes.identification.point import ConstantEstimate
from cpam_bayes.identification.sampled import sample
from cpam_bayes.identification.sampled_result import SampledResult
from cpam_bayes.identification.search import search
from cpam_bayes.inference.chains.ensemble import DEFAULT_SETTINGS, EnsembleSettings
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.paper import PrintedRow, printed_table
from cpam_bayes.plate import Specimen, to_user, user_name
from cpam_bayes.repetition.sensitivity import sensitivity
from cpam_bayes.repetition.study import ENSEMBLE_SETTINGS

__all__ = ["FULL", "QUICK", "Effort", "Results", "Task", "printed_rows", "work"]

Results = dict[str, Any]
Kind = Literal["forward", "constants", "noise"]

# F of two swarms that found the same optimum differs by no more than this fraction.
_SAME_OPTIMUM: Final = 1e-3
# Half the width of a 95 % interval of a normal distribution, in standard deviations.
_NORMAL_95: Final = 1.96


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is computed.

    swarms : single ones on each plate, each as the paper has it.
    groups : of perturbed lists at each level.
    full : finite elements beside the Ritz method, posteriors by emcee and not the linearised one, and the
    noise studies of thick plates, which take longest.
    """

    swarms: int
    groups: int
    full: bool
    swarm: SwarmSettings
    chains: EnsembleSettings
    noise_chains: EnsembleSettings


FULL: Final = Effort(5, 10, True, SwarmSettings(), DEFAULT_SETTINGS, ENSEMBLE_SETTINGS)
QUICK: Final = Effort(
    swarms=1,
    groups=3,
    full=False,
    swarm=SwarmSettings(particles=20, iterations=100),
    chains=DEFAULT_SETTINGS,
    noise_chains=EnsembleSettings(walkers=16, round_steps=150, most_steps=150),
)


@dataclass(frozen=True, slots=True)
class Task:
    """One computation. table : whose printed constants are held against the frequencies too."""

    kind: Kind
    specimen: str
    case: str
    table: int
    seed: int

    @property
    def title(self) -> str:
        """For the progress and the record: what is computed."""
        return f"{self.kind} {self.specimen}" + (f", {self.case}" if self.kind == "constants" else "")


def work(effort: Effort, task: Task) -> Results:
    """Do one task and return plain data, with the seconds it took."""
    start = time.perf_counter()
    computed = {"forward": _forward, "constants": _constants, "noise": _noise}[task.kind](effort, task)
    return {**computed, "seconds": time.perf_counter() - start}


def _forward(effort: Effort, task: Task) -> Results:
    """Frequencies from the reference constants by the Ritz method and finite elements."""
    ritz = forward(task.specimen)
    elements = forward(task.specimen, solver="fem") if effort.full else None
    return {
        "ritz_hz": ritz.frequencies.tolist(),
        "ritz_error": ritz.error.tolist(),
        "fem_hz": None if elements is None else elements.frequencies.tolist(),
    }


def _constants(effort: Effort, task: Task) -> Results:
    """The optimum that several swarms find, single swarms, the posterior, the misfit of printed constants."""
    specimen = case_specimen(task.specimen, task.case)
    best = identify(specimen, seed=task.seed, settings=effort.swarm)
    seeds = range(task.seed, task.seed + effort.swarms)
    singles = [
        search(specimen, seed, settings=effort.swarm, centre=best.estimate.centre).swarm for seed in seeds
    ]
    least = best.estimate.swarm.value
    found = [single.value <= (1.0 + _SAME_OPTIMUM) * least for single in singles]
    posterior = None
    if effort.full:
        posterior = sample(specimen, seed=task.seed, settings=effort.chains, swarm_settings=effort.swarm)
    intervals = _linearised(best.estimate.constants) if posterior is None else _sampled(posterior)
    return {
        "constants": {
            user_name(c.name): {
                "value": to_user(c.name, c.value),
                "bound": c.bound,
                **{key: to_user(c.name, value) for key, value in intervals[c.name].items()},
            }
            for c in best.estimate.constants
        },
        "objective": float(least),
        "rms_percent": 100.0 * best.estimate.rms,
        "optimum_found_again": best.status == "converged",
        "swarms": effort.swarms,
        "swarms_found": sum(found),
        "swarms_converged": sum(single.status == "converged" for single in singles),
        "well_posed": well_posed(best),
        "posterior_converged": posterior is None or posterior.reached_goal,
        "forward_solves": sum(swarm.evaluations for swarm in (best.estimate.swarm, *singles))
        + (0 if posterior is None else posterior.forward_solves),
        "printed": [
            {"source": row.source, **_misfit(specimen, row)}
            for row in printed_rows(task.table, task.specimen, task.case)
        ],
    }


def _sampled(posterior: SampledResult) -> dict[str, dict[str, float]]:
    """Mean, sd and 95 % interval of each constant, SI, by emcee."""
    keys = ("mean", "sd", "q025", "q975")
    return {c.name: {k: float(getattr(c, k)) for k in keys} for c in posterior.elastic_constants}


def _linearised(constants: Sequence[ConstantEstimate]) -> dict[str, dict[str, float]]:
    """To first order about the optimum, within the bounds; all between these where the sd is not known."""
    computed = {}
    for c in constants:
        half = _NORMAL_95 * c.sd if math.isfinite(c.sd) else math.inf
        low, high = max(c.value - half, c.lower), min(c.value + half, c.upper)
        computed[c.name] = {
            "mean": c.value,
            "sd": min(half, c.upper - c.lower) / _NORMAL_95,
            "q025": low,
            "q975": high,
        }
    return computed


def printed_rows(table: int, name: str, case: str) -> tuple[PrintedRow, ...]:
    """Rows of a table with identified constants of a specimen, by the number of constants."""
    rows = printed_table(table).rows
    chosen = [r for r in rows if r.specimen == name and r.role == "identified" and "E1_GPa" in r.values]
    return tuple(
        r for r in chosen if case not in ("two constants", FOUR) or (case == FOUR) == ("E2_GPa" in r.values)
    )


def _misfit(specimen: Specimen, row: PrintedRow) -> Mapping[str, float]:
    measurement = specimen.measurement
    assert measurement is not None
    measured = measurement.frequencies
    computed = forward(with_constants(specimen, row), len(measured)).frequencies
    return {
        "objective": float(np.sum((computed - measured) ** 2)),
        "rms_percent": 100.0 * float(np.sqrt(np.mean((computed / measured - 1.0) ** 2))),
    }


def _noise(effort: Effort, task: Task) -> Results:
    """The paper's repetition on the measured list, eq. (12) on the root mean square frequency."""
    result = sensitivity(
        task.specimen,
        seed=task.seed,
        groups=effort.groups,
        readings=("rms",),
        source="measured",
        settings=effort.swarm,
        chains=effort.noise_chains,
    )
    study = result.study
    names = [c.name for c in study.without_noise.constants]
    return {
        "without_noise": {user_name(c.name): to_user(c.name, c.value) for c in study.without_noise.constants},
        "groups": effort.groups,
        "swarms": study.starts,
        "swarms_found": study.found_again,
        "posterior_converged": result.reached_goal,
        "levels": [
            {
                "level_percent": 100.0 * cell.level,
                "missed": cell.repetition.missed,
                "constants": {
                    user_name(name): {
                        "repetition_mean": to_user(name, float(cell.repetition.mean[i])),
                        "repetition_sd": to_user(name, float(cell.repetition.sd[i])),
                        "on_bound": float(cell.repetition.on_bound[:, i].mean()),
                        "posterior_mean": to_user(name, float(cell.posterior.mean[i])),
                        "q025": to_user(name, float(cell.posterior.q025[i])),
                        "q975": to_user(name, float(cell.posterior.q975[i])),
                    }
                    for i, name in enumerate(names)
                },
            }
            for cell in study.cells
        ],
    }
