"""The paper's tables beside what this package computes: the question `paper`."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from cpam_bayes.comparison.cases import BUILT_IN, FOUR, TWO
from cpam_bayes.comparison.records import Cost, Misfit, PaperResult, Row, WellPosed
from cpam_bayes.comparison.rows import (
    Computed,
    constant_rows,
    frequency_rows,
    input_rows,
    layup_rows,
    noise_rows,
)
from cpam_bayes.comparison.simulation import simulation_errors
from cpam_bayes.comparison.slow import calculix_frequencies, diagnoses, sequence_cases
from cpam_bayes.comparison.store import packaged, read, stamp, write
from cpam_bayes.comparison.tasks import FULL, QUICK, Effort, Results, Task, work
from cpam_bayes.deadline import TimeIsUpError
from cpam_bayes.diagnosis.fitting import REPEATABILITY_PRIOR
from cpam_bayes.forward_model.preconditions import require_seed, require_whole
from cpam_bayes.paper import printed_table
from cpam_bayes.paper.layups import PAPER
from cpam_bayes.paper.perturbation import TABLES
from cpam_bayes.paper.tables import NUMBERS
from cpam_bayes.parallel import open_executor, run
from cpam_bayes.result import SILENT, Watch
from cpam_bayes.storage import cache_directory

__all__ = ["compare", "tasks_of"]

# Thick plates take longest: they begin first, so that no worker starts one at the end, and their constants
# before their noise, which needs a model that these build.
_LONGEST: Final = ("D4", "D3", "D1", "D2")
_NOISE: Final = {number: name for name, number in TABLES.items()}


def tasks_of(number: int, seed: int) -> tuple[Task, ...]:
    """The computations that a table needs."""
    if number in (1, 5):
        names = dict.fromkeys(row.specimen for row in printed_table(number).rows)
        return tuple(Task("forward", name, BUILT_IN, number, seed) for name in names)
    if number in (6, 7):
        return (Task("constants", "D&G", FOUR if number == 6 else TWO, number, seed),)
    if number == 8:
        return tuple(Task("constants", name, case, 8, seed) for name in ("A1", "A2") for case in (FOUR, TWO))
    if number == 9:
        rows = (row for row in printed_table(9).rows if row.part == "a" and row.source == PAPER)
        return tuple(Task("constants", row.specimen, BUILT_IN, 9, seed) for row in rows)
    if number in _NOISE:
        name = _NOISE[number]
        point = Task("constants", name, *((TWO, 8) if name == "A2" else (BUILT_IN, 9)), seed)
        return (Task("noise", name, BUILT_IN, number, seed), point)
    return ()


def compare(
    number: int | None = None,
    *,
    quick: bool = False,
    everything: bool = False,
    seed: int = 0,
    executor: str = "serial",
    workers: int | None = None,
    store: str | Path | None = None,
    watch: Watch = SILENT,
) -> PaperResult:
    """The paper's tables, printed values beside computed ones, with a verdict on each.

    Finished computations are stored, and the same call goes on from there. Posteriors over stacking
    sequences, frequencies of CalculiX and diagnoses of the measured lists come with the package, with version
    and date.

    Parameters
    ----------
    number : of one table, 1 to 14; all where left out
    quick : one small swarm for each plate, linearised intervals, three groups of perturbed lists, no finite
        elements, and no rows of Tables 13 and 14: shows that it works
    everything : compute anew what is stored, and what comes with the package, which takes hours
    executor, workers : as for `cb.sequence`
    store : directory of finished computations; in the cache of reduced models where left out
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the paper has no such table.
    """
    require_seed(seed)
    if number is not None:
        require_whole("table", number, NUMBERS[0], NUMBERS[-1])
    numbers = NUMBERS if number is None else (number,)
    start = time.perf_counter()
    effort = QUICK if quick else FULL
    directory = cache_directory() / "paper" if store is None else Path(store)
    computed = _computed(numbers, effort, seed, everything, executor, workers, directory, watch)
    calculix, sequences, diagnosed = packaged("calculix"), packaged("sequences"), packaged("diagnoses")
    if everything and not quick:
        if shutil.which("ccx") is not None and {1, 5} & set(numbers):
            calculix = calculix_frequencies(watch)
        if set(numbers) & {9, 11, 12, 13, 14}:
            sequences = sequence_cases(seed, executor, workers, watch)
        if {1, 5} & set(numbers):
            diagnosed = diagnoses(seed, watch)
    by_task: Computed = {(task.kind, task.specimen, task.case): results for task, results in computed.items()}
    rows = tuple(row for n in numbers for row in _rows(n, by_task, calculix, sequences))
    records = {task.title: results for task, results in computed.items()}
    return PaperResult(
        seed=seed,
        warnings=tuple(_warnings(computed, quick)),
        numbers=numbers,
        rows=rows,
        misfits=tuple(_misfits(computed)),
        well_posed=tuple(_well_posed(computed, sequences)),
        simulation_errors=tuple(error for n in numbers for error in simulation_errors(n, diagnosed)),
        costs=tuple(_costs(computed, calculix)),
        computed={
            **{title: {k: r[k] for k in ("version", "date", "seconds")} for title, r in records.items()},
            **_stored_records(numbers, calculix, sequences, diagnosed),
        },
        quick=quick,
        seconds=time.perf_counter() - start,
    )


def _computed(
    numbers: tuple[int, ...],
    effort: Effort,
    seed: int,
    everything: bool,
    executor: str,
    workers: int | None,
    directory: Path,
    watch: Watch,
) -> dict[Task, Results]:
    wanted = dict.fromkeys(task for n in reversed(numbers) for task in tasks_of(n, seed))
    if not effort.full:
        wanted = {task: None for task in wanted if task.kind != "noise" or task.specimen not in _LONGEST}
    tasks = sorted(wanted, key=_turn)
    stored = {} if everything else {task: read(directory, effort, task) for task in tasks}
    computed = {task: results for task, results in stored.items() if results is not None}
    missing = [task for task in tasks if task not in computed]
    if not missing:
        return computed
    with (
        watch.stage("paper", len(missing), lambda left: f"{left:.0f} computations left") as shown,
        open_executor(executor, workers) as pool,
    ):

        def keep(index: int, results: Results) -> None:
            task = missing[index]
            computed[task] = stamp(results)
            write(directory, effort, task, computed[task])
            done = len(missing) - sum(t not in computed for t in missing)
            shown.tick(done, float(len(missing) - done))
            shown.notify(f"{task.title}: {results['seconds']:.0f} s")

        try:
            run(work, effort, missing, pool, batch_size=1, on_result=keep, is_limited=True)
        except TimeIsUpError as error:
            raise TimeIsUpError(f"{error}; the same command goes on from there") from error
    return computed


def _turn(task: Task) -> tuple[bool, bool, int]:
    """What tasks are sorted by."""
    if task.specimen not in _LONGEST:
        return True, False, 0
    return False, task.kind == "noise", _LONGEST.index(task.specimen)


def _rows(
    number: int, computed: Computed, calculix: Mapping[str, Any], sequences: Mapping[str, Any]
) -> Iterator[Row]:
    table = printed_table(number)
    yield from input_rows(table)
    if number in (1, 5):
        yield from frequency_rows(table, computed, calculix)
    elif number in (6, 7, 8, 9):
        yield from constant_rows(table, computed)
        yield from layup_rows(table, sequences)
    elif number in _NOISE:
        yield from noise_rows(table, computed, sequences)


def _by_table(computed: Mapping[Task, Results], key: str) -> Iterator[tuple[Task, Results]]:
    """Tasks whose results have a key, by table and specimen."""
    ordered = sorted(computed.items(), key=lambda item: (item[0].table, item[0].specimen, item[0].case))
    return ((task, results) for task, results in ordered if key in results)


def _well_posed(computed: Mapping[Task, Results], sequences: Mapping[str, Any]) -> Iterator[WellPosed]:
    for task, results in _by_table(computed, "well_posed"):
        stored = sequences["cases"].get(task.specimen) if task.table == 9 else None
        yield WellPosed(
            table=task.table,
            specimen=task.specimen,
            case=task.case,
            repeatability_percent=100.0 * float(REPEATABILITY_PRIOR.ppf(0.975)),
            layups=None if stored is None else stored["credible_95_count"],
            **results["well_posed"],
        )


def _costs(computed: Mapping[Task, Results], calculix: Mapping[str, Any]) -> Iterator[Cost]:
    for task, results in _by_table(computed, "forward_solves"):
        yield Cost(
            task.specimen,
            task.case,
            results["forward_solves"],
            results["seconds"],
            calculix["seconds_each"].get(task.specimen),
        )


def _misfits(computed: Mapping[Task, Results]) -> Iterator[Misfit]:
    for task, results in _by_table(computed, "printed"):
        for printed in results["printed"]:
            yield Misfit(
                table=task.table,
                specimen=task.specimen,
                case=task.case,
                source=printed["source"],
                objective=printed["objective"],
                rms_percent=printed["rms_percent"],
                our_objective=results["objective"],
                our_rms_percent=results["rms_percent"],
                swarms=results["swarms"],
                swarms_found=results["swarms_found"],
                swarms_converged=results["swarms_converged"],
                on_bounds=tuple(k for k, c in results["constants"].items() if c["bound"] is not None),
            )


def _stored_records(
    numbers: tuple[int, ...],
    calculix: Mapping[str, Any],
    sequences: Mapping[str, Any],
    diagnosed: Mapping[str, Any],
) -> dict[str, dict[str, str | float]]:
    records = {}
    if {1, 5} & set(numbers):
        records["CalculiX, 20-node bricks"] = calculix
        records["diagnoses of the measured lists"] = diagnosed
    if set(numbers) & {9, 11, 12, 13, 14}:
        records["posteriors over stacking sequences"] = sequences
    return {name: {k: r[k] for k in ("version", "date", "seconds")} for name, r in records.items()}


def _warnings(computed: Mapping[Task, Results], quick: bool) -> Iterator[str]:
    if quick:
        yield (
            "quick: small swarms, linearised intervals, no finite elements, no rows of Tables 13 and 14: "
            "this shows that it works; do not quote these numbers"
        )
    unconverged = [t.title for t, r in computed.items() if not r.get("posterior_converged", True)]
    if unconverged and not quick:
        yield f"chains that have not converged: {'; '.join(sorted(unconverged))}"
    lonely = [t.title for t, r in computed.items() if not r.get("optimum_found_again", True)]
    if lonely:
        yield f"the best fit was found by one swarm only: {'; '.join(sorted(lonely))}"
