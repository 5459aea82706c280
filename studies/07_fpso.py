"""How often the paper's fuzzy swarm finds a stacking sequence, and what it costs beside enumeration.

python studies/07_fpso.py [--quick] [--only CASE ...] [--workers N] [--executor SPEC]

A swarm succeeds when the sequence that it ends on, with the constants fitted to it, has F of eq. (7)
within a margin of the smallest F known. Two margins are counted: n resolution^2 / 12, the F that
rounding n frequencies makes by itself, and sum (0.01 f_i)^2, the F that a repeatability of 1 % makes: such
a list does not tell sequences apart that are closer than that. The smallest F known comes from

* enumeration of every class of sequences, where two angles are unknown;
* the plate's own sequence, whose F is zero, for synthetic data: frequencies of the printed layup with the
  reference constants from the reduced model, neither noisy nor rounded;
* otherwise the best of all seeds, of the printed sequence, and of descents from these that change one
  angle at a time: an upper bound of the minimum, so the rates are upper bounds too.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from cpam_bayes.command import add_executor_options
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS, ReductionSettings
from cpam_bayes.identification.angle_search import (
    AngleSearchProblem,
    best_constants,
    run_swarms,
    search_parameters,
    search_starts,
)
from cpam_bayes.inference.swarm import SwarmResult, SwarmSettings
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Specimen, angle_grid
from cpam_bayes.printed.tables import identified_layups
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text, timed_lines
from cpam_bayes.running import single_blas_thread
from cpam_bayes.stacking.symmetry import Symmetry, canonical, classes, plate_symmetries
from validation.reporting import (
    paragraph,
    save_results,
    saved_results,
    study_parser,
    with_saved,
    write_sections,
)
from validation.sequences import known_angles, with_unknown_layup

Array = NDArray[Any]
Results = dict[str, Any]
Notify = Callable[[str], None]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "settings": "particles, budget and seeds of the swarms, starts of the fits",
    "cases": "one case on one kind of data: smallest F known and its source, each run, success, cost",
    "particles": "success and cost on one case against the number of particles",
}

SYNTHETIC, PRINTED = "synthetic", "printed"
# Sequences of two unknown angles can be enumerated; the other cases are those of Table 9(b).
TWO_ANGLES = {"C1, two angles": ("C1", "[(?/?)_8]_s"), "D2, two angles": ("D2", "[(?/?)_8]_s")}
LADDER = ("C1", (10, 20, 40, 80, 160))
PARTICLES = "numbers of particles"
SETTINGS = SwarmSettings(iterations=200)
SEEDS = 20
STARTS = 3
# Number of sequences that each step of a descent fits constants to, and of starts of descents.
FITTED, DESCENTS = 24, 3
# F that counts as zero, Hz^2 per frequency: a thousandth of the effect of rounding to 1 Hz.
NOTHING = 1e-4


class Plan(NamedTuple):
    """Extent of the computations."""

    cases: tuple[str, ...]
    seeds: int
    settings: SwarmSettings
    ladder: tuple[int, ...]
    reduction: ReductionSettings
    step_deg: float | None
    descents: int


FULL = Plan((*TWO_ANGLES, *identified_layups()), SEEDS, SETTINGS, LADDER[1], DEFAULT_SETTINGS, None, DESCENTS)
QUICK = Plan(
    ("C1, two angles",),
    3,
    replace(SETTINGS, particles=12, iterations=15),
    (4, 8),
    ReductionSettings(training=12, checks=12, rounds=1),
    45.0,
    1,
)


@single_blas_thread
def run(
    quick: bool,
    executor: Executor | None = None,
    only: tuple[str, ...] | None = None,
    notify: Notify = lambda text: None,
) -> Results:
    """Results for all cases, or those named, on both kinds of data, then for numbers of particles."""
    plan = QUICK if quick else FULL
    wanted = only or (*plan.cases, PARTICLES)
    cases = []
    for name in (n for n in wanted if n != PARTICLES):
        specimen = case_specimen(name, plan.step_deg)
        for kind in (SYNTHETIC, PRINTED):
            notify(f"{name}, {kind} data")
            cases.append({"case": name, **_case(specimen, name, kind, plan, executor)})
    return {
        "quick": quick,
        "settings": {
            "particles": plan.settings.particles,
            "iterations": plan.settings.iterations,
            "inertia": plan.settings.inertia,
            "c1": plan.settings.c1,
            "c2": plan.settings.c2,
            "seeds": plan.seeds,
            "starts": STARTS,
        },
        "cases": cases,
        "particles": _ladder(plan, executor, notify) if PARTICLES in wanted else [],
    }


def case_specimen(name: str, step_deg: float | None = None) -> Specimen:
    """Specimen of a case by its name, on another grid of angles if wanted."""
    return with_unknown_layup(*TWO_ANGLES.get(name, (name, None)), step_deg)


def true_sequence(specimen: Specimen) -> Array:
    """Grid indices of the plate's own layup, (n_plies,)."""
    return _on_grid(known_angles(specimen), angle_grid(specimen.angle_grid_deg))


def _on_grid(angles_deg: Array, grid: Array) -> Array:
    return np.abs(angles_deg[:, None] - grid).argmin(axis=1)


def _fit(specimen: Specimen, kind: str, reduction: ReductionSettings) -> AngleSearchProblem:
    assert specimen.measurement is not None
    n_modes = specimen.measurement.size
    model = reduced_model(specimen, search_parameters(specimen), n_modes, settings=reduction)
    grid = angle_grid(specimen.angle_grid_deg)
    measured = specimen.measurement.frequencies
    if kind == SYNTHETIC:
        constants = reference_vector(specimen, specimen.unknowns)
        measured = model.predict(np.concatenate((constants, grid[true_sequence(specimen)]))).frequencies[0]
    return AngleSearchProblem(specimen, model, measured, grid)


# One case


def _case(specimen: Specimen, name: str, kind: str, plan: Plan, executor: Executor | None) -> Results:
    fit = _fit(specimen, kind, plan.reduction)
    symmetries = plate_symmetries(specimen)
    starts = search_starts(fit, STARTS)
    swarms = run_swarms(fit, range(plan.seeds), plan.settings, executor)
    ends = np.array([s.sequence for s in swarms])
    fitted = _fitted_ends(fit, swarms, starts, executor)
    known = _known_sequences(specimen, name, kind)
    own = best_constants(fit, known, starts, executor)
    margins = _margins(specimen, fit)
    sequences = len(fit.grid_deg) ** fit.n_plies
    if name in TWO_ANGLES:
        every = _every_class(fit, symmetries)
        found = best_constants(fit, every, starts, executor)
        best, value, source = every[found.values.argmin()], float(found.values.min()), "enumeration"
        each, classes = found.evaluations / len(every), len(every)
    else:
        pool, values = np.concatenate((ends, known)), np.concatenate((fitted, own.values))
        best, value, source = pool[values.argmin()], float(values.min()), "best known"
        if kind == SYNTHETIC:
            best, value, source = known[0], 0.0, "own sequence"
        else:
            best, value = _descended(fit, pool, values, starts, plan.descents, executor)
        each = _solves_of_a_fit(fit, starts, executor)
        classes = _count_classes(fit, symmetries)
    if source == "enumeration" and kind == SYNTHETIC:
        assert own.values[0] < NOTHING * len(fit.measured), "the data are those of the plate's own sequence"
    same = _same_class(ends, known[0], symmetries)
    return {
        "data": kind,
        "plate": specimen.name,
        "layup": specimen.plate.layup.text,
        "unknown_angles": fit.n_plies,
        "sequences": sequences,
        "classes": classes,
        "symmetries": [s.name for s in symmetries],
        "frequencies": len(fit.measured),
        "smallest": {
            "F": value,
            "angles_deg": fit.grid_deg[best].tolist(),
            "source": source,
        },
        "reference": {
            "F": float(own.values[0]),
            "angles_deg": fit.grid_deg[known[0]].tolist(),
            "is": "own sequence"
            if kind == SYNTHETIC
            else "printed in Table 9(b)"
            if _printed(name)
            else "own",
        },
        "margins": margins,
        "runs": [
            {
                "seed": seed,
                "angles_deg": fit.grid_deg[s.sequence].tolist(),
                "F": s.value,
                "F_fitted": float(f),
                "reference_class": bool(c),
                "evaluations": s.evaluations,
                "iterations": s.iterations,
                "status": s.status,
            }
            for seed, (s, f, c) in enumerate(zip(swarms, fitted, same, strict=True))
        ],
        "success": {name: _rate(fitted <= value + margin) for name, margin in margins.items()},
        "reference_found": _rate(same),
        "cost": {
            "swarm_solves": float(np.mean([s.evaluations for s in swarms])),
            "enumeration_solves_a_class": float(each),
            "enumeration_solves": float(each) * classes,
            "enumerated": source == "enumeration",
            "solve_s": _seconds_of_a_solve(fit, plan.settings.particles),
        },
    }


def _margins(specimen: Specimen, fit: AngleSearchProblem) -> dict[str, float]:
    measurement = specimen.measurement
    assert measurement is not None
    return {
        "rounding": measurement.size * measurement.resolution**2 / 12.0,
        "one_percent": float(np.sum((0.01 * fit.measured) ** 2)),
    }


def _printed(name: str) -> bool:
    return name in identified_layups()


def _known_sequences(specimen: Specimen, name: str, kind: str) -> Array:
    """The sequence that a run is compared with, then others whose F is of interest."""
    own = true_sequence(specimen)
    if kind == SYNTHETIC or not _printed(name):
        return own[None]
    printed = np.array(identified_layups()[name].angles_deg, dtype=float)
    return np.array([_on_grid(printed, angle_grid(specimen.angle_grid_deg)), own])


def _fitted_ends(
    fit: AngleSearchProblem, swarms: list[SwarmResult], starts: Array, executor: Executor | None
) -> Array:
    """Smallest F of each swarm's sequence with fitted constants, started from the swarm's own too, (m,)."""
    ends = np.array([s.sequence for s in swarms])
    fitted = best_constants(fit, ends, starts, executor).values
    # a fit may miss the minimum in which the swarm's own constants lie
    return np.minimum(
        fitted,
        [
            best_constants(fit, s.sequence[None], s.best[None]).values[0] if s.value < f else f
            for s, f in zip(swarms, fitted, strict=True)
        ],
    )


def _same_class(sequences: Array, other: Array, symmetries: tuple[Symmetry, ...]) -> Array:
    both = canonical(np.vstack((other, sequences)), symmetries).representative
    return np.all(both[1:] == both[0], axis=1)


def _rate(successes: Array) -> Results:
    """A success rate with its 68 % interval, Jeffreys' prior."""
    n, k = len(successes), int(np.sum(successes))
    low, high = beta.ppf([0.16, 0.84], k + 0.5, n - k + 0.5)
    return {"count": k, "of": n, "low": float(low) if k else 0.0, "high": float(high) if k < n else 1.0}


# Enumeration


def _every_class(fit: AngleSearchProblem, symmetries: tuple[Symmetry, ...]) -> Array:
    axes = [np.arange(len(fit.grid_deg))] * fit.n_plies
    every = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, fit.n_plies)
    return classes(every, symmetries).representative


def _count_classes(fit: AngleSearchProblem, symmetries: tuple[Symmetry, ...]) -> int:
    """Number of classes by Burnside's lemma: mean number of sequences that a symmetry leaves unchanged."""
    assert all(s.everywhere for s in symmetries)
    index = np.arange(len(fit.grid_deg))
    fixed = [len(index) ** fit.n_plies]
    fixed += [int(np.sum(s.permutation == index)) ** fit.n_plies for s in symmetries]
    return sum(fixed) // len(fixed)


def _solves_of_a_fit(fit: AngleSearchProblem, starts: Array, executor: Executor | None) -> float:
    """Solves with derivatives needed for the constants of one random sequence."""
    rows = np.random.default_rng(0).integers(0, len(fit.grid_deg), (64, fit.n_plies))
    return best_constants(fit, rows, starts, executor).evaluations / len(rows)


def _descended(
    fit: AngleSearchProblem, pool: Array, values: Array, starts: Array, n: int, executor: Executor | None
) -> tuple[Array, float]:
    """The smallest F reached from the best n sequences by changing one angle at a time.

    In each round all neighbours are evaluated with the constants of the current sequence, and constants are
    fitted to the best of them.
    """
    _, first = np.unique(pool, axis=0, return_index=True)
    first = first[np.argsort(values[first], kind="stable")][:n]
    best, value = pool[first[0]], float(values[first[0]])
    for start in first:
        here, own = pool[start], best_constants(fit, pool[start][None], starts)
        while True:
            near = _neighbours(here, len(fit.grid_deg))
            guess = fit.values(np.repeat(own.constants, len(near), axis=0), near)
            near = near[np.argsort(guess, kind="stable")[:FITTED]]
            found = best_constants(fit, near, np.vstack((own.constants, starts)), executor)
            if not found.values.min() < own.values[0]:
                break
            here = near[found.values.argmin()]
            own = best_constants(fit, here[None], np.vstack((found.constants[found.values.argmin()], starts)))
        if own.values[0] < value:
            best, value = here, float(own.values[0])
    return best, value


def _neighbours(sequence: Array, n_angles: int) -> Array:
    rows = np.tile(sequence, (len(sequence) * n_angles, 1))
    ply, angle = np.divmod(np.arange(len(rows)), n_angles)
    rows[np.arange(len(rows)), ply] = angle
    return rows[angle != sequence[ply]]


def _seconds_of_a_solve(fit: AngleSearchProblem, particles: int) -> float:
    """CPU seconds of one solve in a stack of a swarm's size."""
    rng = np.random.default_rng(0)
    rows = rng.integers(0, len(fit.grid_deg), (particles, fit.n_plies))
    constants = np.repeat(search_starts(fit, 1), particles, axis=0)
    taken = []
    for _ in range(3):
        start = time.process_time()
        fit.values(constants, rows)
        taken.append((time.process_time() - start) / particles)
    return float(np.median(taken))


# Number of particles


def _ladder(plan: Plan, executor: Executor | None, notify: Notify) -> list[Results]:
    specimen = case_specimen(LADDER[0] if plan is FULL else plan.cases[0], plan.step_deg)
    fit = _fit(specimen, SYNTHETIC, plan.reduction)
    starts = search_starts(fit, STARTS)
    margins = _margins(specimen, fit)
    points = []
    for particles in plan.ladder:
        notify(f"{particles} particles")
        swarms = run_swarms(fit, range(plan.seeds), replace(plan.settings, particles=particles), executor)
        fitted = _fitted_ends(fit, swarms, starts, executor)
        points.append(
            {
                "case": specimen.name,
                "particles": particles,
                "success": {name: _rate(fitted <= margin) for name, margin in margins.items()},
                "median_F": float(np.median(fitted)),
                "swarm_solves": float(np.mean([s.evaluations for s in swarms])),
            }
        )
    return points


# Output


def show(results: Results) -> None:
    """Print the results as tables."""
    rows = tuple(
        (
            c["case"],
            c["data"],
            *(_share(c["success"][margin]) for margin in ("rounding", "one_percent")),
            _share(c["reference_found"]),
            f"{c['smallest']['F']:.4g}",
            c["smallest"]["source"],
            _angles(c["smallest"]["angles_deg"]),
            f"{c['reference']['F']:.4g}",
            f"{np.median([r['F_fitted'] for r in c['runs']]):.4g}",
            f"{c['cost']['swarm_solves']:.0f}",
            f"{c['cost']['enumeration_solves']:.3g}",
        )
        for c in results["cases"]
    )
    headings = (
        *("case", "data", "to rounding", "to 1 %", "own or printed", "smallest F", "from", "angles"),
        *("F of own or printed", "median F", "solves", "by enumeration"),
    )
    tables = [Table("Fuzzy swarms", _columns(headings, (0, 1, 6, 7)), rows)]
    rows = tuple(
        (
            str(p["particles"]),
            *(_share(p["success"][margin]) for margin in ("rounding", "one_percent")),
            f"{p['median_F']:.4g}",
            f"{p['swarm_solves']:.0f}",
        )
        for p in results["particles"]
    )
    tables.append(
        Table(
            "Number of particles",
            _columns(("particles", "to rounding", "to 1 %", "median F", "solves"), ()),
            rows,
        )
    )
    print(screen_text(tuple(tables), sys.stdout))


def _share(rate: Results) -> str:
    return f"{rate['count']}/{rate['of']}"


def _angles(angles_deg: Iterable[float]) -> str:
    return "/".join(f"{a:g}" for a in angles_deg)


def _columns(headings: tuple[str, ...], text: tuple[int, ...]) -> tuple[Heading, ...]:
    return tuple(Heading(heading, i not in text) for i, heading in enumerate(headings))


# Sections of docs/unknown_angles.md


def sections(results: Results) -> dict[str, str]:
    """Section of docs/unknown_angles.md on the fuzzy swarm."""
    return {"remarks": "\n".join(paragraph(text, "- ") for text in _remarks(results["cases"]))}


def _remarks(cases: Sequence[Results]) -> Iterable[str]:
    runs = sum(c["success"]["rounding"]["of"] for c in cases)
    exact, near = (sum(c["success"][m]["count"] for c in cases) for m in ("rounding", "one_percent"))
    c1 = next((c for c in cases if (c["case"], c["data"]) == ("C1", "printed")), None)
    printed = ""
    if c1:
        different = len({tuple(r["angles_deg"]) for r in c1["runs"]})
        printed = f" The {len(c1['runs'])} seeds on C1's printed list give {different} stacking sequences."
    yield (
        f"**It ends near the best fit, hardly ever on it.** {exact} of {runs} runs end within the rounding "
        f"of the list, {near} within 1 % of the frequencies.{printed}"
    )


def main() -> None:
    """Run the study, print its tables and save the results, case by case."""
    parser = study_parser(__doc__)
    names = (*FULL.cases, PARTICLES)
    parser.add_argument("--only", nargs="+", choices=names, metavar="CASE", help="of: " + "; ".join(names))
    add_executor_options(parser)
    args = parser.parse_args()

    tell = timed_lines()
    with open_executor(args.executor, args.workers) as executor:
        if args.quick:
            show(run(True, executor, notify=tell))
            return
        for name in args.only or names:
            save_results(RESULTS, with_saved(run(False, executor, (name,), tell), RESULTS, FULL.cases))
    found = saved_results(RESULTS)
    show(found)
    write_sections(Path(__file__).parents[1], RESULTS.stem, sections(found))


if __name__ == "__main__":
    main()
