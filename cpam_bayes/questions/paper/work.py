"""The computations behind the rows; each returns plain data, stored as soon as it is done.

A stopped comparison resumes from the finished ones. Those of the full effort come with the package, like the
frequencies by CalculiX, the diagnoses and the posteriors over the stacking sequences of Table 9(b).
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from cpam_bayes import __version__
from cpam_bayes.answer import Constant
from cpam_bayes.fingerprint import fingerprint
from cpam_bayes.identification.point import PointEstimate, estimate_constants
from cpam_bayes.identification.search import MOST_SWARMS, search
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS, EnsembleSettings
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import Specimen, builtin, read_plate, to_si, to_user, user_name
from cpam_bayes.printed.noise_study import ENSEMBLE_SETTINGS
from cpam_bayes.printed.tables import PrintedRow, printed_table
from cpam_bayes.questions.diagnose import diagnose
from cpam_bayes.questions.forward import forward
from cpam_bayes.questions.identify.emcee import SampledResult, sample
from cpam_bayes.questions.paper.layups import (
    bounds_alone,
    layup_case,
    searched,
    searched_without_noise,
    weighed,
)
from cpam_bayes.questions.paper.rows import BUILT_IN, CONSTRAINT, FOUR, TWO, Record, Results
from cpam_bayes.questions.sensitivity import sensitivity
from cpam_bayes.questions.sequence import sequence
from cpam_bayes.running import Watch
from cpam_bayes.storage import read_sealed, set_aside, write_sealed

Array = NDArray[Any]

# Eq. (8) bounds E2 by 40 GPa and cannot have been used for aluminium, whose E2 is about 70 GPa.
_BOUNDS: Final = {
    "E1_GPa": [10.0, 200.0],
    "E2_GPa": [10.0, 200.0],
    "nu12": [0.15, 0.4],
    "G12_GPa": [5.0, 30.0],
}


def case_specimen(name: str, case: str) -> Specimen:
    """A built-in specimen with the bounds of eq. (8) as its only prior, with four unknowns for that case.

    Four constants must satisfy the fourth constraint of eq. (9), E1 > E2: the reference E2 is a little below
    E1.
    """
    specimen = bounds_alone(name)
    if case != FOUR:
        return specimen
    plate, measurement = specimen.plate, specimen.measurement
    assert measurement is not None
    E, nu = specimen.material.constants["E1"] / 1e9, specimen.material.constants["nu12"]
    return read_plate(
        {
            "name": f"{name}, {FOUR}",
            "plate": {
                "length_mm": to_user("length", plate.length),
                "width_mm": to_user("width", plate.width),
                "thickness_mm": to_user("thickness", plate.thickness),
                "density_kg_m3": plate.density,
                "layup": "[0]",
                "edges": plate.edges,
            },
            "material": {
                "isotropic": False,
                "known": False,
                "E1_GPa": E,
                "E2_GPa": 0.999 * E,
                "nu12": nu,
                "G12_GPa": E / (2.0 * (1.0 + nu)),
            },
            "unknowns": _BOUNDS,
            "measurement": {
                "frequencies_hz": measurement.frequencies.tolist(),
                "resolution_hz": measurement.resolution,
            },
        }
    ).with_exact_sizes()


# E1 and E2 this close, as a fraction, lie on the constraint E1 > E2 of eq. (9).
_EQUAL: Final = 1e-3


def with_ends(task: Task, results: Results) -> Results:
    """Results in which constants on the constraint E1 > E2 name it as their bound."""
    if task.kind != "constants":
        return results
    constants = results["constants"]
    e1, e2 = (constants.get(name, {}).get("value", math.nan) for name in ("E1_GPa", "E2_GPa"))
    equal = ("E1_GPa", "E2_GPa") if abs(e1 - e2) <= _EQUAL * e1 else ()
    return {
        **results,
        "constants": {
            name: {**of, "bound": of["bound"] or (CONSTRAINT if name in equal else None)}
            for name, of in constants.items()
        },
    }


@cache
def bounds_of(name: str, case: str) -> Mapping[str, tuple[float, float]]:
    """The bounds of the unknown constants of a case, by name with unit."""
    unknowns = case_specimen(name, case).unknowns
    ends = zip(unknowns.names, unknowns.lower, unknowns.upper, strict=True)
    return {user_name(n): (to_user(n, float(low)), to_user(n, float(high))) for n, low, high in ends}


# A plate whose constants are bounded by eq. (8) as printed.
_AS_PRINTED: Final = "D1"


def beyond_eq_8(name: str, case: str) -> dict[str, tuple[float, float]]:
    """The bounds of a case that differ from those of eq. (8)."""
    printed = bounds_of(_AS_PRINTED, BUILT_IN)
    return {key: ends for key, ends in bounds_of(name, case).items() if ends != printed[key]}


def rounding_percent(name: str) -> float:
    """Rms relative error, %, of a measured list from its rounding to the last printed digit."""
    measurement = builtin(name).measurement
    assert measurement is not None
    error = measurement.resolution / math.sqrt(12.0) / measurement.frequencies
    return 100.0 * float(np.sqrt(np.mean(np.square(error))))


def with_constants(specimen: Specimen, row: PrintedRow) -> Specimen:
    """A specimen with the printed constants of a row as its material."""
    printed: Mapping[str, float] = {
        key: cell.number for key, cell in row.values.items() if cell.number is not None
    }
    constants = {key.partition("_")[0]: to_si(key, value) for key, value in printed.items()}
    return replace(specimen, material=replace(specimen.material.parts[""], constants=constants, sd={}))


# Singular values of the sensitivities below this fraction of the largest are zero.
_RANK: Final = 1e-6


def well_posed(estimate: PointEstimate) -> dict[str, Any]:
    """Existence, uniqueness and stability of the solution at the best optimum, as plain data.

    Existence: the remaining misfit, sqrt(sum r^2 / (n_f - n)), r the relative residuals. Uniqueness: the
    rank and the condition number of S = d ln f / d ln x, (n_f, n), and the number of optima that the misfit
    cannot distinguish. Stability: sd of ln x for independent relative noise of frequencies, over that noise:
    the roots of the diagonal of (S^T S)^-1, without bounds; None where the rank is not full.
    """
    measurement = estimate.specimen.measurement
    assert measurement is not None
    x = np.array([c.value for c in estimate.constants])
    prediction = estimate.model.full.predict(x[None], jacobian=True)
    assert prediction.jacobian is not None
    slope = (prediction.jacobian[0] / prediction.frequencies[0, :, None] * x)[: measurement.size]
    singular = np.linalg.svd(slope, compute_uv=False)
    rank = int(np.sum(singular > _RANK * singular[0]))
    amplified = np.full(len(x), np.nan)
    if rank == len(x):
        amplified = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    freedom = measurement.size - len(x)
    left = math.sqrt(measurement.size / freedom) * estimate.rms if freedom > 0 else math.nan
    names = [user_name(c.name) for c in estimate.constants]
    return {
        "frequencies": measurement.size,
        "unknowns": len(x),
        "left_percent": 100.0 * left if math.isfinite(left) else None,
        "rank": rank,
        "condition": float(singular[0] / singular[-1]) if rank == len(x) else None,
        "optima": len(estimate.optima),
        "percent_per_percent": {
            name: float(a) if math.isfinite(a) else None for name, a in zip(names, amplified, strict=True)
        },
    }


def simulation_errors(number: int, diagnosed: Mapping[str, Any]) -> Iterator[Record]:
    """Errors of Table 1's ABAQUS frequencies, or of Table 4 beside Table 5; empty for other tables.

    Misprinted frequencies are excluded from the rms.

    diagnosed : {"plates": name -> `diagnosis_row` and `frequency_scale` of the plate}
    """
    if number not in (1, 5):
        return
    printed = {row.specimen: row for row in printed_table(number).rows if row.source == "ABAQUS"}
    for name in measured_beside(number):
        stored = diagnosed["plates"].get(name)
        if stored is not None:
            rms = _rms_percent(printed[name]) if name in printed else None
            yield {
                "table": number,
                "specimen": name,
                "printed_rms_percent": rms,
                "thickness_mm": _thickness_mm(name),
                "of_one_material_mm": _of_one_material(name),
                **stored,
            }


def measured_beside(number: int) -> tuple[str, ...]:
    """Plates whose measured lists stand beside the frequencies of Table 1 or 5."""
    return tuple(dict.fromkeys(row.specimen for row in printed_table(1 if number == 1 else 4).rows))


def frequency_scale(name: str) -> dict[str, float]:
    """Ratio of the measured to the computed frequencies, and the rms left after scaling by it, %.

    The ratio is a geometric mean; the frequencies are computed at the reference constants.
    """
    measurement = builtin(name).measurement
    assert measurement is not None
    times = measurement.frequencies / forward(name, measurement.size).frequencies
    ratio = math.exp(float(np.mean(np.log(times))))
    return {
        "frequency_ratio": ratio,
        "scaled_rms_percent": 100.0 * float(np.sqrt(np.mean(np.square(times / ratio - 1.0)))),
    }


def _thickness_mm(name: str) -> float:
    """Thickness in Table 2, or of Table 1's plate."""
    return to_user("thickness", builtin(name).plate.thickness)


def _of_one_material(name: str) -> dict[str, float]:
    """Thicknesses of the other plates of the same material, mm."""
    names = [row.specimen for row in printed_table(2).rows]
    alike = (other for other in names if other != name and _material(other) == _material(name))
    return {other: _thickness_mm(other) for other in alike}


def _material(name: str) -> str | None:
    return builtin(name).material.parts[""].name


def _rms_percent(row: PrintedRow) -> float:
    """Root mean square of printed / measured - 1, %."""
    measurement = builtin(row.specimen).measurement
    assert measurement is not None
    pairs = zip(row.values.values(), measurement.frequencies, strict=True)
    off = [float(cell.text) / f - 1.0 for cell, f in pairs if not cell.misprinted("value")]
    return 100.0 * float(np.sqrt(np.mean(np.square(off))))


def diagnosis_row(document: Mapping[str, Any]) -> dict[str, Any]:
    """What is stored of a `diagnose` document, of one plate or of a group of study 12."""
    extended, gain = document["extended"], document["gain"]
    return {
        "plain_rms_percent": document["baseline"]["rms_as_stated_percent"],
        "claim": document["claim"],
        "sentence": document["sentence"],
        "causes": document["causes"],
        "sizes": _sizes(document),
        "probability": document["probability"],
        "extended_rms_percent": None if extended is None else extended["rms_as_stated_percent"],
        "log_bayes_factor": None if gain is None else gain["log_bayes_factor"],
        "held_out": None if gain is None else gain["held_out_log_score_difference"],
        "held_out_se": None if gain is None else gain["held_out_log_score_se"],
    }


def _sizes(document: Mapping[str, Any]) -> dict[str, Any]:
    """Sizes of the claimed causes, each from the most probable set that contains it, by name."""
    hypotheses = document["hypotheses"]
    claimed = document["causes"] or ([] if document["claim"] == "none" else [hypotheses[0]["cause"]])
    found: dict[str, Any] = {}
    for cause in claimed:
        of_cause = [h["parameters"] for h in hypotheses if cause in h["cause"].split(" + ")]
        found |= {name: size for name, size in of_cause[0].items() if name not in found} if of_cause else {}
    return found


Kind = Literal["forward", "constants", "noise", "angles", "layups"]
OF_FULL_EFFORT: Final[tuple[Kind, ...]] = ("angles", "layups")
"""Kinds skipped by the small effort."""

# Objectives F of two swarms at the same optimum differ by no more than this fraction.
_SAME_OPTIMUM: Final = 1e-3
# Half width of the 95 % interval of a normal distribution, in standard deviations.
_NORMAL_95: Final = 1.96


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is computed.

    swarms : single swarms on each plate, each as in the paper.
    groups : perturbed lists at each level.
    full : finite elements beside the Ritz method, posteriors by emcee instead of linearised ones, joint
    searches of angles and constants, and posteriors over layups of perturbed lists.
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
    """One computation. table : whose printed constants are also tested against the frequencies."""

    kind: Kind
    specimen: str
    case: str
    table: int
    seed: int

    @property
    def title(self) -> str:
        """Name of the task in the progress display and in the record."""
        return f"{self.kind} {self.specimen}" + (f", {self.case}" if self.kind == "constants" else "")


def work(effort: Effort, task: Task) -> Results:
    """Do one task and return plain data, with the CPU seconds it took."""
    start = time.process_time()
    computed = _DONE_BY[task.kind](effort, task)
    return {**computed, "seconds": time.process_time() - start}


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
    """Best optimum of several swarms, single swarms, the posterior, misfit of the printed constants."""
    specimen = case_specimen(task.specimen, task.case)
    best = estimate_constants(specimen, task.seed, swarms=MOST_SWARMS, settings=effort.swarm)
    seeds = range(task.seed, task.seed + effort.swarms)
    singles = [search(specimen, seed, settings=effort.swarm, centre=best.centre).swarm for seed in seeds]
    least = best.swarm.value
    found = [single.value <= (1.0 + _SAME_OPTIMUM) * least for single in singles]
    posterior = None
    if effort.full:
        posterior = sample(specimen, seed=task.seed, settings=effort.chains, swarm_settings=effort.swarm)
    intervals = _linearised(best.constants) if posterior is None else _sampled(posterior)
    return {
        "constants": {
            user_name(c.name): {
                "value": to_user(c.name, c.value),
                "bound": c.bound,
                **{key: to_user(c.name, value) for key, value in intervals[c.name].items()},
            }
            for c in best.constants
        },
        "objective": float(least),
        "rms_percent": 100.0 * best.rms,
        "optimum_found_again": best.swarm.status == "converged",
        "swarms": effort.swarms,
        "swarms_found": sum(found),
        "swarms_converged": sum(single.status == "converged" for single in singles),
        "well_posed": well_posed(best),
        "posterior_converged": posterior is None or posterior.reached_goal,
        "forward_solves": sum(swarm.evaluations for swarm in (best.swarm, *singles))
        + (0 if posterior is None else posterior.forward_solves),
        "printed": [
            {"source": row.source, **_misfit(specimen, row)}
            for row in printed_rows(task.table, task.specimen, task.case)
        ],
    }


def _sampled(posterior: SampledResult) -> dict[str, dict[str, float]]:
    """Mean, sd and 95 % interval of each constant, SI, by emcee."""
    keys = ("mean", "sd", "q025", "q975")
    marginals = posterior.marginals
    return {name: {k: float(getattr(marginals[name], k)) for k in keys} for name in posterior.constants}


def _linearised(constants: Sequence[Constant]) -> dict[str, dict[str, float]]:
    """Linearised intervals about the optimum, cut at the bounds; the bounds where the sd is not known."""
    computed = {}
    for c in constants:
        half = _NORMAL_95 * c.sd if math.isfinite(c.sd) else math.inf
        low, high = max(c.value - half, c.prior.lower), min(c.value + half, c.prior.upper)
        computed[c.name] = {
            "mean": c.value,
            "sd": min(half, c.prior.upper - c.prior.lower) / _NORMAL_95,
            "q025": low,
            "q975": high,
        }
    return computed


def printed_rows(table: int, name: str, case: str) -> tuple[PrintedRow, ...]:
    """Rows with identified constants of a specimen in a table, chosen by their number."""
    rows = printed_table(table).rows
    chosen = [r for r in rows if r.specimen == name and r.role == "identified" and "E1_GPa" in r.values]
    return tuple(r for r in chosen if case not in (TWO, FOUR) or (case == FOUR) == ("E2_GPa" in r.values))


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
    """The paper's repetition on the measured list: eq. (12) on the root mean square frequency."""
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


_DONE_BY: Final[Mapping[Kind, Callable[[Effort, Task], Results]]] = {
    "forward": _forward,
    "constants": _constants,
    "noise": _noise,
    "angles": lambda effort, task: searched(
        task.specimen, task.table, task.seed, effort.groups, effort.swarm
    ),
    "layups": lambda effort, task: weighed(task.specimen, task.table, task.seed),
}


def hadamard(
    task: Task, found: Results, layups: int | None, repeatability_percent: float, rounding: float
) -> Record:
    """Hadamard's conditions of a case, from the result of `well_posed`.

    layups : stacking sequences in the 95 % set where angles are unknown too, None where not computed
    repeatability_percent : 97.5 % quantile of this package's prior of the repeatability of a tap test
    rounding : rms relative error of the list, %, from its last printed digit
    """
    left = found["left_percent"]
    return {
        "table": task.table,
        "specimen": task.specimen,
        "case": task.case,
        "frequencies": found["frequencies"],
        "unknowns": found["unknowns"],
        "left_percent": left,
        "repeatability_percent": repeatability_percent,
        "rounding_percent": rounding,
        "rank": found["rank"],
        "condition": found["condition"],
        "optima": found["optima"],
        "layups": layups,
        "percent_per_percent": found["percent_per_percent"],
        "exists": None if left is None else left <= math.hypot(repeatability_percent, rounding),
        "unique": found["rank"] == found["unknowns"] and found["optima"] == 1 and layups in (None, 1),
    }


def task_key(effort: Effort, task: Task) -> str:
    """Hash of all that a result depends on: sources, effort, seed, plate and printed rows."""
    specimen = case_specimen(task.specimen, task.case)
    measured = specimen.measurement
    content = {
        "sources": fingerprint(__name__),
        "effort": asdict(effort),
        "task": asdict(task),
        "plate": repr(specimen.plate),
        "material": [repr(specimen.material), specimen.unknowns.names],
        "bounds": [specimen.unknowns.lower.tolist(), specimen.unknowns.upper.tolist()],
        "measured": None if measured is None else measured.frequencies.tolist(),
        "printed": [repr(row) for row in printed_rows(task.table, task.specimen, task.case)],
    }
    text = json.dumps(content, sort_keys=True, default=repr)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def stamp(results: Results) -> Results:
    """The results with version, fingerprint and date of the computation."""
    made = {"version": __version__, "fingerprint": fingerprint(__name__)}
    return {**made, "date": datetime.now(UTC).date().isoformat(), **results}


def read(directory: Path, effort: Effort, task: Task) -> Results | None:
    """The stored results of a task; None where missing, from other inputs, or damaged, which is set aside."""
    path = _path(directory, effort, task)
    try:
        content = read_sealed(path)
    except OSError:
        return None
    if content is None:
        return None
    try:
        computed: Results = json.loads(content)
    except ValueError:
        set_aside(path)
        return None
    return computed


def write(directory: Path, effort: Effort, task: Task, results: Results) -> None:
    """Store a finished task; silently skipped where the directory cannot be written."""
    with suppress(OSError):
        directory.mkdir(parents=True, exist_ok=True)
        write_sealed(_path(directory, effort, task), json.dumps(results, indent=1).encode())


@cache
def packaged(name: str) -> Mapping[str, Any]:
    """Packaged results with version and date: "calculix", "diagnoses", "sequences", "swarms", "tasks".

    Those of tasks are keyed by title.
    """
    resource = files("cpam_bayes") / "data" / "paper" / "computed" / f"{name}.json"
    computed: Mapping[str, Any] = json.loads(resource.read_text(encoding="utf-8"))
    return computed


def comes_with_the_package(task: Task) -> Results | None:
    """The packaged results of a task at the full effort, None where there are none for its seed."""
    stored: Mapping[str, Results] = packaged("tasks")["tasks"]
    return stored.get(task.title) if task.seed == packaged("tasks")["seed"] else None


def _path(directory: Path, effort: Effort, task: Task) -> Path:
    return directory / f"{task_key(effort, task)}.results"


T = TypeVar("T")


def _of_each(key: str, names: Sequence[str], of: Callable[[str], T]) -> dict[str, Any]:
    """The result of each plate by name under a key, with the seconds of each and in all."""
    found, seconds = {}, {}
    for name in names:
        start = time.perf_counter()
        found[name] = of(name)
        seconds[name] = time.perf_counter() - start
    return stamp({"seconds": sum(seconds.values()), "seconds_each": seconds, key: found})


def seconds_of(stored: Mapping[str, Any], names: Sequence[str]) -> float:
    """Seconds spent on these plates in results of `calculix_frequencies` and the like."""
    return float(sum(stored["seconds_each"].get(name, 0.0) for name in names))


def calculix_frequencies(names: Sequence[str], watch: Watch) -> dict[str, Any]:
    """Frequencies of plates by 20-node bricks of CalculiX, Hz."""
    return _of_each(
        "frequencies_hz", names, lambda name: forward(name, solver="ccx", watch=watch).frequencies.tolist()
    )


def diagnoses(names: Sequence[str], seed: int, watch: Watch) -> dict[str, Any]:
    """Diagnoses of the measured lists of plates."""

    def of(name: str) -> dict[str, Any]:
        answer = diagnose(name, seed=seed, next_test="never", watch=watch)
        return {**diagnosis_row(answer.to_dict()), **frequency_scale(name)}

    return _of_each("plates", names, of)


def sequence_cases(
    names: Sequence[str], seed: int, executor: str, workers: int | None, watch: Watch
) -> dict[str, Any]:
    """The posterior over the stacking sequences of specimens of Table 9(b)."""

    def of(name: str) -> dict[str, Any]:
        specimen = bounds_alone(name)
        return layup_case(sequence(specimen, seed=seed, executor=executor, workers=workers, watch=watch))

    return _of_each("cases", names, of)


# Number of fuzzy swarms, of different seeds, on each measured list.
_FREE_SWARMS: Final = 20


def swarms_without_noise(names: Sequence[str], effort: Effort) -> dict[str, Any]:
    """Angles at which fuzzy swarms end on the measured lists of plates."""
    seeds = range(_FREE_SWARMS)
    return _of_each("cases", names, lambda name: searched_without_noise(name, seeds, effort.swarm))
