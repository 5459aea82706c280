"""The question `paper`: the paper's tables beside what this package computes.

Finished computations are stored, one for each plate and choice of unknowns; the rows are made from them.
"""

from __future__ import annotations

import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

from cpam_bayes import __version__
from cpam_bayes.answer import Notice
from cpam_bayes.command import EXECUTOR, TIME_LIMIT, WORKERS, Command, option, whole
from cpam_bayes.diagnosis.comparison import REPEATABILITY_PRIOR
from cpam_bayes.errors import checked
from cpam_bayes.forward_model.preconditions import require_seed, require_whole
from cpam_bayes.parallel import open_executor, run
from cpam_bayes.printed.tables import (
    AGREEMENTS,
    NUMBERS,
    PAPER,
    TABLES,
    PrintedTable,
    identified_layups,
    percentage_checks,
    printed_table,
)
from cpam_bayes.questions.paper.angles import noisy_angles
from cpam_bayes.questions.paper.noise import means_of_ten, noise_rows
from cpam_bayes.questions.paper.present import page, report_of, row_table
from cpam_bayes.questions.paper.rows import (
    BUILT_IN,
    CONSTRAINT,
    FOUR,
    TWO,
    VERDICTS,
    Computed,
    Record,
    Results,
    Row,
    by_others,
    constant_rows,
    disagreements,
    frequency_rows,
    input_rows,
    layup_rows,
    not_determined,
    share_of_bounds,
)
from cpam_bayes.questions.paper.work import (
    FULL,
    OF_FULL_EFFORT,
    QUICK,
    Effort,
    Task,
    beyond_eq_8,
    bounds_of,
    calculix_frequencies,
    comes_with_the_package,
    diagnoses,
    hadamard,
    measured_beside,
    packaged,
    read,
    rounding_percent,
    seconds_of,
    sequence_cases,
    simulation_errors,
    stamp,
    swarms_without_noise,
    with_ends,
    work,
    write,
)
from cpam_bayes.render.report import Report, csv_text, plain
from cpam_bayes.render.terminal import duration
from cpam_bayes.result import Result, present, within_time
from cpam_bayes.running import SILENT, TimeIsUpError, Watch, cut_short
from cpam_bayes.storage import cache_directory

__all__ = ["PaperResult", "compared", "computations", "paper", "tasks_of"]

# Stamp of a computation; packaged ones may lack a fingerprint.
_STAMPED: Final = ("version", "fingerprint", "date", "seconds")
# Thick plates take longest and run first, so that no worker is left with one at the end; their constants
# precede their noise, which reuses the models.
_LONGEST: Final = ("D4", "D3", "D1", "D2")
# Work that takes up to hours -> its title.
_SLOW: Final = {
    "calculix": "CalculiX, 20-node bricks",
    "diagnoses": "diagnoses of the measured lists",
    "sequences": "posteriors over stacking sequences",
    "swarms": "fuzzy swarms without noise",
}
# Seconds of the small effort relative to the full one, by kind, over all tables; it searches no angles.
_QUICK_SHARE: Final = {"forward": 0.1, "constants": 0.16, "noise": 0.19}
# Plates whose angles are searched and whose layups are all weighed.
_WITH_ANGLES: Final = ("C1", "C3", "D1", "D3")
_NOISE: Final = {number: name for name, number in TABLES.items()}


def _plates(number: int) -> tuple[str, ...]:
    return tuple(dict.fromkeys(row.specimen for row in printed_table(number).rows))


def tasks_of(number: int, seed: int) -> tuple[Task, ...]:
    """The computations behind a table."""
    if number in (1, 5):
        return tuple(Task("forward", name, BUILT_IN, number, seed) for name in _plates(number))
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
        noise = Task("noise", name, BUILT_IN, number, seed)
        kinds = OF_FULL_EFFORT if name in _WITH_ANGLES else ()
        return (noise, point, *(Task(kind, name, BUILT_IN, number, seed) for kind in kinds))
    return ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PaperResult(Result):
    """Tables of the paper beside what this package computes.

    Attributes
    ----------
    numbers : of the tables
    rows : one for each printed value
    misfits : misfits of the printed constants, beside ours; records of the JSON document, like the next three
    well_posed : Hadamard's conditions, one for each plate and choice of unknowns
    simulation_errors : errors of the simulations of Tables 1 and 5, by plate
    costs : forward solves and seconds, one for each plate and choice of unknowns
    computed : task -> version, fingerprint, date and seconds of the computation behind the rows
    quick : whether the small effort was asked for
    seconds : wall clock of this run, stored results excluded
    """

    command: ClassVar[str] = "paper"

    numbers: tuple[int, ...]
    rows: tuple[Row, ...]
    misfits: tuple[Record, ...]
    well_posed: tuple[Record, ...] = ()
    simulation_errors: tuple[Record, ...] = ()
    costs: tuple[Record, ...] = ()
    computed: Mapping[str, Mapping[str, str | float]]
    quick: bool
    seconds: float

    @property
    def title(self) -> str:
        """Number of the table, where one was asked for."""
        return f"{self.numbers[0]}" if len(self.numbers) == 1 else ""

    def texts(self) -> Mapping[str, str]:
        """The rows as a CSV file, and the page as Markdown."""
        document = _document(self)
        return {"comparison.csv": csv_text(row_table(document)), "comparison.md": page(plain(document))}


@present.register
def _present(result: PaperResult) -> Report:
    return report_of(_document(result), result.slips, result.cautions)


@checked
@within_time
def paper(
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
    """Printed values of the paper's tables beside computed ones, with a verdict on each.

    The computations come with the package, with version and date. Others are stored as they finish, and the
    same call resumes from there; the slow work of ``everything`` (CalculiX, diagnoses, stacking sequences,
    swarms without noise) is not stored.

    Parameters
    ----------
    number : of one table, 1 to 14; all if left out
    quick : a small demonstration: one small swarm for each plate, linearised intervals, three groups of
        perturbed lists, no finite elements, no joint search of angles and constants
    everything : compute what comes with the package anew, which takes hours
    executor, workers : as for `cb.sequence`
    store : directory of computations that this code has finished; in the cache if left out
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If the paper has no such table.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.paper(2)
    >>> result.rows[0].printed, result.rows[0].verdict
    ('30.00', 'input')
    """
    require_seed(seed)
    if number is not None:
        require_whole("table", number, NUMBERS[0], NUMBERS[-1])
    numbers = NUMBERS if number is None else (number,)
    start = time.perf_counter()
    effort = QUICK if quick else FULL
    directory = cache_directory() / "paper" if store is None else Path(store)

    def known(task: Task) -> Results | None:
        packaged_too = effort.full and not everything
        return (comes_with_the_package(task) if packaged_too else None) or read(directory, effort, task)

    slow = _slow(numbers) if everything and not quick else {}
    for name, plates in slow.items():
        watch.announce(f"{_SLOW[name]}: about {duration(seconds_of(packaged(name), plates))} on one core")
    computed = computations(numbers, effort, seed, known, directory, executor, workers, watch)
    anew = {
        "calculix": lambda plates: calculix_frequencies(plates, watch),
        "diagnoses": lambda plates: diagnoses(plates, seed, watch),
        "sequences": lambda plates: sequence_cases(plates, seed, executor, workers, watch),
        "swarms": lambda plates: swarms_without_noise(plates, effort),
    }
    found = {name: anew[name](plates) for name, plates in slow.items()}
    seconds = time.perf_counter() - start
    return compared(numbers, computed, seed=seed, slow=found, quick=quick, seconds=seconds)


def compared(
    numbers: tuple[int, ...],
    computed: Mapping[Task, Results],
    *,
    seed: int,
    slow: Mapping[str, Mapping[str, Any]] | None = None,
    quick: bool = False,
    seconds: float = 0.0,
) -> PaperResult:
    """The comparison from finished computations; nothing is computed.

    slow : "calculix", "sequences", "diagnoses" and "swarms"; those left out come with the package
    """
    stored = {**{name: packaged(name) for name in _SLOW}, **(slow or {})}
    calculix, sequences, diagnosed = (stored[name] for name in ("calculix", "sequences", "diagnoses"))
    computed = {task: with_ends(task, results) for task, results in computed.items()}
    by_task: Computed = {(task.kind, task.specimen, task.case): results for task, results in computed.items()}
    rows = tuple(
        row if row.q025 is None else share_of_bounds(row, bounds_of(row.specimen, _sought(row)))
        for n in numbers
        for row in _rows(n, by_task, stored)
    )
    return PaperResult(
        seed=seed,
        notices=tuple(_notices(computed, quick)),
        numbers=numbers,
        rows=rows,
        misfits=tuple(_misfits(computed)),
        well_posed=tuple(_well_posed(computed, sequences)),
        simulation_errors=tuple(error for n in numbers for error in simulation_errors(n, diagnosed)),
        costs=tuple(_costs(computed, calculix)),
        computed={
            **{task.title: _stamped(results) for task, results in computed.items()},
            **{
                _SLOW[name]: {**_stamped(stored[name]), "seconds": seconds_of(stored[name], plates)}
                for name, plates in _behind(numbers).items()
            },
        },
        quick=quick,
        seconds=seconds,
    )


def computations(
    numbers: Sequence[int],
    effort: Effort,
    seed: int,
    known: Callable[[Task], Results | None],
    directory: Path,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> dict[Task, Results]:
    """Results of all tasks of some tables; unknown ones are computed and stored, as long as there is time."""
    wanted = dict.fromkeys(task for n in reversed(numbers) for task in tasks_of(n, seed))
    tasks = sorted((t for t in wanted if effort.full or t.kind not in OF_FULL_EFFORT), key=_turn)
    computed = {task: results for task in tasks if (results := known(task)) is not None}
    missing = [task for task in tasks if task not in computed]
    if not missing:
        return computed
    watch.announce(_forecast(missing, effort))
    with (
        watch.stage("paper", len(missing), counted="computations") as shown,
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
            if not computed:
                raise TimeIsUpError(f"{error}; the same command resumes there") from error
            cut_short("cut_tasks", late=len(tasks) - len(computed), of=len(tasks))
    return computed


def _forecast(missing: Sequence[Task], effort: Effort) -> str:
    """Expected time of computations, from packaged timings and the share of a smaller effort.

    One that is not packaged counts as the longest of its kind.
    """
    known: Mapping[str, Results] = packaged("tasks")["tasks"]

    def full(task: Task) -> float:
        alike = (results["seconds"] for title, results in known.items() if title.startswith(task.kind))
        return float(known[task.title]["seconds"] if task.title in known else max(alike))

    seconds = sum(full(task) * (1.0 if effort.full else _QUICK_SHARE[task.kind]) for task in missing)
    counted = f"{len(missing)} computation{'s' * (len(missing) > 1)}"
    return f"{counted}, about {duration(seconds)} on one core; finished ones are kept"


def _turn(task: Task) -> tuple[bool, bool, int]:
    if task.specimen not in _LONGEST:
        return True, False, 0
    return False, task.kind == "noise", _LONGEST.index(task.specimen)


def _rows(number: int, computed: Computed, stored: Mapping[str, Mapping[str, Any]]) -> Iterator[Row]:
    """The rows of a table; stored : slow work by name."""
    table = printed_table(number)
    yield from input_rows(table)
    if number in (1, 5):
        yield from frequency_rows(table, computed, stored["calculix"])
    elif number in (6, 7, 8, 9):
        yield from constant_rows(table, computed)
        yield from layup_rows(table, stored["sequences"])
    elif number in _NOISE:
        yield from noise_rows(table, computed, stored["sequences"], stored["swarms"])


def _sought(row: Row) -> str:
    """The choice of unknowns behind a row's interval."""
    return FOUR if row.table in (6, 8) and TWO not in row.source else BUILT_IN


def _by_table(computed: Mapping[Task, Results], key: str) -> Iterator[tuple[Task, Results]]:
    """Tasks whose results have a key, sorted by table and specimen."""
    ordered = sorted(computed.items(), key=lambda item: (item[0].table, item[0].specimen, item[0].case))
    return ((task, results) for task, results in ordered if key in results)


def _well_posed(computed: Mapping[Task, Results], sequences: Mapping[str, Any]) -> Iterator[Record]:
    repeatability = 100.0 * float(REPEATABILITY_PRIOR.ppf(0.975))
    for task, results in _by_table(computed, "well_posed"):
        stored = sequences["cases"].get(task.specimen) if task.table == 9 else None
        layups = None if stored is None else stored["credible_95_count"]
        rounding = rounding_percent(task.specimen)
        yield hadamard(task, results["well_posed"], layups, repeatability, rounding)


def _costs(computed: Mapping[Task, Results], calculix: Mapping[str, Any]) -> Iterator[Record]:
    """Forward solves and their time, beside the time of as many sequential runs of CalculiX."""
    for task, results in _by_table(computed, "forward_solves"):
        each = calculix["seconds_each"].get(task.specimen)
        yield {
            "specimen": task.specimen,
            "case": task.case,
            "forward_solves": results["forward_solves"],
            "seconds": results["seconds"],
            "calculix_seconds": each,
            "calculix_hours": None if each is None else results["forward_solves"] * each / 3600.0,
        }


def _misfits(computed: Mapping[Task, Results]) -> Iterator[Record]:
    for task, results in _by_table(computed, "printed"):
        for printed in results["printed"]:
            yield {
                "table": task.table,
                "specimen": task.specimen,
                "case": task.case,
                "source": printed["source"],
                "objective": printed["objective"],
                "rms_percent": printed["rms_percent"],
                "our_objective": results["objective"],
                "our_rms_percent": results["rms_percent"],
                "swarms": results["swarms"],
                "swarms_found": results["swarms_found"],
                "swarms_converged": results["swarms_converged"],
                "on_bounds": list(_ends(results["constants"])),
                "beyond_eq_8": beyond_eq_8(task.specimen, task.case),
            }


def _ends(constants: Mapping[str, Mapping[str, Any]]) -> Iterable[str]:
    """Constants on a bound, or the constraint where two lie on it."""
    found = (
        CONSTRAINT if c["bound"] == CONSTRAINT else name
        for name, c in constants.items()
        if c["bound"] is not None
    )
    return dict.fromkeys(found)


def _behind(numbers: Sequence[int]) -> dict[str, tuple[str, ...]]:
    """Slow work behind some tables: name -> its plates."""
    found: dict[str, dict[str, None]] = {name: {} for name in _SLOW}
    for number in numbers:
        if number in (1, 5):
            found["calculix"] |= dict.fromkeys(_plates(number))
            found["diagnoses"] |= dict.fromkeys(measured_beside(number))
        elif number == 9:
            found["sequences"] |= dict.fromkeys(identified_layups())
        elif _NOISE.get(number) in _WITH_ANGLES:
            found["sequences"] |= {_NOISE[number]: None}
            found["swarms"] |= {_NOISE[number]: None}
    return {name: tuple(plates) for name, plates in found.items() if plates}


def _slow(numbers: Sequence[int]) -> dict[str, tuple[str, ...]]:
    """Slow work behind some tables that can be done here: CalculiX only if it is installed."""
    here = _behind(numbers)
    return {name: of for name, of in here.items() if name != "calculix" or shutil.which("ccx") is not None}


def _stamped(results: Mapping[str, Any]) -> dict[str, str | float]:
    return {key: results[key] for key in _STAMPED if key in results}


def _notices(computed: Mapping[Task, Results], quick: bool) -> Iterator[Notice]:
    if quick:
        yield Notice("quick")
    unconverged = sorted(t.title for t, r in computed.items() if not r.get("posterior_converged", True))
    if unconverged and not quick:
        yield Notice("unconverged_tasks", facts={"titles": tuple(unconverged)})
    lonely = sorted(t.title for t, r in computed.items() if not r.get("optimum_found_again", True))
    if lonely:
        yield Notice("tasks_of_one_swarm", facts={"titles": tuple(lonely)})


def _document(result: PaperResult) -> dict[str, Any]:
    """The JSON document, from which everything shown is written."""
    checks = [check for number in result.numbers for check in percentage_checks(number)]
    return {
        "command": result.command,
        "version": __version__,
        "seed": result.seed,
        "quick": result.quick,
        "tables": [_counts(result.rows, number) for number in result.numbers],
        "rows": [_record(row) for row in result.rows],
        "disagreements": list(disagreements(result.rows, result.misfits, result.simulation_errors)),
        "audit": {
            "misprints": [note for n in result.numbers for note in _misprints(printed_table(n))],
            "means_of_ten": means_of_ten(result.rows) or None,
            "not_determined": not_determined(result.rows) or None,
            "angles": list(noisy_angles(result.rows)),
            "percentages": [
                {
                    "table": check.table,
                    "specimen": check.row.specimen,
                    "source": check.row.source,
                    "quantity": check.column,
                    "printed_percent": float(check.printed),
                    "recomputed_percent": check.recomputed,
                    "possible_percent": [check.lowest, check.highest],
                    "agreement": check.agreement,
                }
                for check in checks
            ],
            "misfits": list(result.misfits),
        },
        "hadamard": list(result.well_posed),
        "simulation": list(result.simulation_errors),
        "costs": list(result.costs),
        "computed": {task: dict(record) for task, record in result.computed.items()},
        "seconds": result.seconds,
        "warnings": list(result.warnings),
    }


def _counts(rows: tuple[Row, ...], number: int) -> dict[str, Any]:
    """Verdicts on a table's rows, and how many of its percentages follow from their digits."""
    verdicts = Counter(row.verdict for row in rows if row.table == number)
    of_others = Counter(row.verdict for row in rows if row.table == number and by_others(row.source))
    percentages = Counter(check.agreement for check in percentage_checks(number))
    return {
        "table": number,
        "title": printed_table(number).title,
        "verdicts": {verdict: verdicts[verdict] for verdict in VERDICTS},
        "verdicts_of_others": {verdict: of_others[verdict] for verdict in VERDICTS},
        "percentages": {agreement: percentages[agreement] for agreement in AGREEMENTS},
    }


def _record(row: Row) -> dict[str, Any]:
    try:
        printed: float | str = float(row.printed)
    except ValueError:
        printed = row.printed
    return {
        "table": row.table,
        "part": row.part,
        "specimen": row.specimen,
        "source": row.source,
        "quantity": row.quantity,
        "printed": printed,
        "printed_text": row.printed,
        "ours": list(row.ours) if isinstance(row.ours, tuple) else row.ours,
        "difference_percent": row.difference_percent,
        "q025": row.q025,
        "q975": row.q975,
        "verdict": f"{row.verdict}: {row.reason}" if row.reason else row.verdict,
        "verdict_kind": row.verdict,
        "details": dict(row.details),
    }


def _misprints(table: PrintedTable) -> Iterator[str]:
    """Misprints and other contradictions of a table, one sentence each, identical ones merged."""
    places: dict[tuple[str, str], list[str]] = {}
    for row, column, misprint in table.misprints:
        cell = row.values[column]
        said = cell.text if misprint.print == "value" else f"{cell.percent} %"
        where = ", ".join(part for part in (row.specimen, row.source, column) if part)
        places.setdefault((f"printed {said}", misprint.note), []).append(where)
    for (said, note), each in places.items():
        yield f"Table {table.number}, {'; '.join(each)}, {said}: {note}"
    yield from (f"Table {table.number}: {note}" for note in table.notes)


COMMAND: Final = Command(
    paper,
    (
        option(
            "number",
            metavar="N",
            nargs="?",
            type=whole(NUMBERS[0], NUMBERS[-1]),
            help="one table, 1 to 14 (default: all)",
        ),
        option(
            "--quick",
            action="store_true",
            help="small swarms, linearised intervals, no search of angles: a demonstration, not to be quoted",
        ),
        option(
            "--all",
            "everything",
            action="store_true",
            help="compute what comes with the package anew; says first how long it takes: hours for Table 9 "
            "and for all tables",
        ),
        option(
            "--store",
            metavar="DIR",
            help="keep finished computations in DIR; the same command resumes there (default: in the cache)",
        ),
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
)
