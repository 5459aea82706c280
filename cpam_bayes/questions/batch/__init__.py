"""The question `batch`: many plates one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from glob import glob
from pathlib import Path
from typing import Final, TypeAlias

from cpam_bayes.answer import Notice
from cpam_bayes.batches.geometry import with_shared_sizes
from cpam_bayes.batches.limits import Limit, read_limit
from cpam_bayes.batches.plate_row import (
    PlateDiagnosis,
    PlateRow,
    computed_row,
    diagnosed,
    failed_row,
    read_row,
    row_key,
    write_row,
)
from cpam_bayes.batches.population import Population, population_of
from cpam_bayes.command import EXECUTOR, TIME_LIMIT, WORKERS, Command, option
from cpam_bayes.diagnosis.cases import build_models, hypotheses_of, plate_case
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.fingerprint import fingerprint
from cpam_bayes.forward_model.preconditions import (
    disagrees,
    equal_list_slips,
    require_diagnosable,
    require_paired_list,
    require_seed,
    require_supported,
)
from cpam_bayes.identification.search import NO_MESH, required
from cpam_bayes.parallel import WorkersLostError, open_executor, run
from cpam_bayes.plate import PlateLike, Specimen, read_plate, user_name
from cpam_bayes.questions.batch import page as page  # how it is shown
from cpam_bayes.questions.batch.result import BatchResult
from cpam_bayes.questions.batch.verdicts import weighs_slip
from cpam_bayes.questions.identify.pso import identify
from cpam_bayes.result import within_time
from cpam_bayes.running import SILENT, TimeIsUpError, Watch, cut_short, is_time_up

__all__ = ["BatchResult", "batch"]

MAX_PLATES: Final = 10_000
# Misfitting plates that are diagnosed unasked, those of the largest misfit.
MOST_DIAGNOSED: Final = 6
# File name with the plate as computed, or with the row that says why it cannot be.
_Item: TypeAlias = "tuple[str, Specimen | PlateRow]"


@checked
@within_time
def batch(
    *plates: PlateLike,
    limits: Sequence[str] = (),
    diagnosis: bool = False,
    hierarchical: bool = False,
    share_models: bool = True,
    seed: int = 0,
    store: str | Path | None = None,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> BatchResult:
    """The constants of many plates, each as by `identify`, and their diagnosis.

    A plate that fails gets a row with the reason; the others are computed all the same. For up to six plates
    that the model does not describe, the reason is sought: a slip of the file, or the claim of a diagnosis
    without sets. Plates of one geometry, thickness and density within 5 % of the first, length and width
    within 1 %, share its models: their lists are scaled to its sizes by d log f / d log s at the reference
    constants.

    Parameters
    ----------
    plates : each a built-in name, a path, a table or a `Specimen`, see `read_plate`; a folder stands for all
        its plate files, a pattern such as ``*.toml`` for all files that match, both sorted by name
    limits : such as "E1_GPa >= 115"; each row has the probability of meeting them
    diagnosis : whether to diagnose every plate, as `diagnose` does
    hierarchical : whether to estimate the mean constants of the material and their scatter from plate to
        plate, by emcee
    share_models : False computes each plate with its own sizes
    store : directory of finished plates, from which the same call resumes
    executor, workers : where the plates are computed, see `cpam_bayes.parallel.open_executor`; the answer is
        the same
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If there is no plate, a limit cannot be read or is on a constant that no plate asks for, or the store
        is no directory.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.batch("A1", "no such plate", limits=["E1_GPa >= 60"])
    >>> [row.status for row in result.rows]
    ['done', 'failed']
    >>> print(result.probability(result.rows[0], result.limits[0]) > 0.95)
    True
    """
    require_seed(seed)
    start = time.perf_counter()
    plates = tuple(each for plate in plates for each in _of_folder(plate))
    if not 1 <= len(plates) <= MAX_PLATES:
        raise ValueError(
            f"plates: received {len(plates) or 'none'}, accepted: one plate or more, {MAX_PLATES} at most"
        )
    read = tuple(read_limit(text) for text in limits)
    if store is not None and (not str(store) or (Path(store).exists() and not Path(store).is_dir())):
        raise ValueError(f"store: received {str(store)!r}, accepted: a directory")
    read_items = [_read(plate, diagnosis) for plate in plates]
    _require_limits_of_unknowns(read, read_items)
    items, n_models = _with_shared_sizes(read_items) if share_models else (read_items, _readable(read_items))
    rows, from_store = _computed(
        items, seed, diagnosis, None if store is None else Path(store), executor, workers, watch
    )
    if not diagnosis:
        rows = _explained(rows, items, seed, None if store is None else Path(store), executor, workers, watch)
    rows = [_as_given(row, plate) for row, (_, plate) in zip(rows, read_items, strict=True)]
    failed = sum(row.status == "failed" for row in rows)
    population, not_pooled = (
        _population([row for row in rows if row.is_judged], seed, watch) if hierarchical else (None, ())
    )
    # plates without a name of their material differ where other constants are sought
    materials = {(row.material, *(c.name for c in row.constants)) for row in rows if row.status == "done"}
    return BatchResult(
        seed=seed,
        notices=(
            *([Notice("failed_plates", facts={"count": failed})] if failed else []),
            *([Notice("mixed_materials")] if len(materials) > 1 else []),
            *_disagreeing([plate for _, plate in read_items if isinstance(plate, Specimen)]),
            *equal_list_slips([plate for _, plate in read_items if isinstance(plate, Specimen)]),
            *_not_described(rows),
            *not_pooled,
        ),
        reached_goal=not failed and not not_pooled,
        rows=tuple(rows),
        limits=read,
        diagnosis=diagnosis,
        models=n_models,
        from_store=from_store,
        population=population,
        seconds=time.perf_counter() - start,
    )


def _disagreeing(specimens: Sequence[Specimen]) -> Iterator[Notice]:
    """Notice of plates whose thickness, mass and density contradict one another."""
    names = tuple(specimen.name for specimen in specimens if disagrees(specimen.plate))
    if names:
        yield Notice("disagreeing_plates", "slip", {"plates": names})


def _not_described(rows: Sequence[PlateRow]) -> Iterator[Notice]:
    """Notice of plates whose misfit exceeds the stated noise."""
    worst = sorted((row for row in rows if row.misfit > 1.0), key=lambda row: -row.misfit)
    if worst:
        yield Notice("undescribed_plates", facts={"plates": tuple((row.name, row.misfit) for row in worst)})


def _population(
    rows: Sequence[PlateRow], seed: int, watch: Watch
) -> tuple[Population | None, tuple[Notice, ...]]:
    """Mean and scatter of the material, with notices of why there are none or why to distrust them."""
    watch.announce("batch: mean and scatter of the material")
    try:
        population = population_of(rows, seed)
    except ValueError as error:
        return None, (Notice("no_population", facts={"reason": str(error)}),)
    if population.status == "converged":
        return population, ()
    d = population.diagnostics
    facts = {"steps": d.steps, "r_hat": d.r_hat, "ess_bulk": d.ess_bulk}
    return population, (Notice("population_chains", facts=facts),)


def _of_folder(plate: PlateLike) -> Sequence[PlateLike]:
    """The plate files of a folder or of a pattern such as ``*.toml``; any other plate as it is."""
    if not isinstance(plate, str | Path):
        return (plate,)
    if Path(plate).is_dir():
        found = sorted(str(path) for path in Path(plate).glob("*.toml"))
        if not found:
            raise ValueError(f"{plate}: a folder without plate files, accepted: files that end in .toml")
        return found
    if Path(plate).exists() or not set("*?") & set(str(plate)):
        return (plate,)
    found = sorted(glob(str(plate)))
    if not found:
        raise ValueError(f"{plate}: no file matches, accepted: plate files, folders, built-in specimens")
    return found


def _as_given(row: PlateRow, plate: Specimen | PlateRow) -> PlateRow:
    """The row with density, certificate and remarks from the plate file."""
    if isinstance(plate, PlateRow):
        return row
    of = plate.plate
    return replace(
        row,
        density=None if of.mass is None else of.density,
        certificate=(("specimen", plate.specimen), *plate.certificate),
        remarks=() if plate.measurement is None else plate.measurement.remarks,
    )


def _read(plate: PlateLike, diagnosis: bool) -> _Item:
    """A plate with its file name, or the row that says why it cannot be computed."""
    file = str(plate.get("name", "plate")) if isinstance(plate, Mapping) else str(plate)
    try:
        specimen = read_plate(plate)
        file = specimen.source if isinstance(plate, Specimen) else file
        required(require_paired_list(require_supported(specimen, NO_MESH)))
        if diagnosis:
            require_diagnosable(specimen)
    except ValueError as error:
        return file, failed_row(file, Path(file).stem, str(error))
    return file, specimen


def _require_limits_of_unknowns(limits: Sequence[Limit], items: Sequence[_Item]) -> None:
    """Raise ``ValueError`` for a limit on a constant that is unknown in no plate."""
    read = [item for _, item in items if isinstance(item, Specimen)]
    unknown = list(dict.fromkeys(name for specimen in read for name in specimen.unknowns.names))
    for limit in limits:
        if read and limit.name not in unknown:
            raise ValueError(
                f"limit: received {limit.text!r}, a constant in no plate's [unknowns], accepted: "
                f"{' '.join(user_name(name) for name in unknown)}"
            )


def _readable(items: Sequence[_Item]) -> int:
    return sum(isinstance(plate, Specimen) for _, plate in items)


def _with_shared_sizes(items: Sequence[_Item]) -> tuple[Sequence[_Item], int]:
    """The plates with the sizes of the first of their geometry, and the number of geometries."""
    plates, count = with_shared_sizes([plate for _, plate in items if isinstance(plate, Specimen)])
    left = iter(plates)
    shared = [(file, next(left) if isinstance(plate, Specimen) else plate) for file, plate in items]
    return shared, count


def _computed(
    items: Sequence[_Item],
    seed: int,
    diagnosis: bool,
    store: Path | None,
    executor: str,
    workers: int | None,
    watch: Watch,
) -> tuple[list[PlateRow], int]:
    """All rows, and how many of them were stored."""
    rows: dict[int, PlateRow] = {}
    keys: dict[int, str] = {}
    sources = fingerprint(__name__)
    for i, (file, plate) in enumerate(items):
        if isinstance(plate, PlateRow):
            rows[i] = plate
            continue
        keys[i] = row_key(plate, seed, diagnosis, sources)
        kept = read_row(store, keys[i])
        if kept is not None:
            rows[i] = replace(kept, file=file)
    from_store = sum(i in rows for i in keys)
    missing = [i for i in keys if i not in rows]

    def keep(index: int, row: PlateRow) -> None:
        i = missing[index]
        if row.status == "done":
            write_row(store, keys[i], row)
        rows[i] = row
        shown.tick(len(rows), float(len(items) - len(rows)))

    with (
        open_executor(executor, workers) as pool,
        watch.stage("batch", len(items), counted="plates") as shown,
    ):
        if diagnosis:
            _build_models([items[i][1] for i in missing], pool, shown.notify)
        given = (items[i] for i in missing)
        todo = [(file, plate) for file, plate in given if isinstance(plate, Specimen)]
        with suppress(TimeIsUpError):
            run(_row, (seed, diagnosis), todo, pool, batch_size=1, on_result=keep, is_limited=True)
    late = [i for i in missing if i not in rows]
    for i in late:
        file, plate = items[i]
        assert isinstance(plate, Specimen)
        rows[i] = failed_row(file, plate.name, "time was up before this plate")
    if late:
        cut_short("cut_plates", late=len(late), of=len(items))
    return [rows[i] for i in range(len(items))], from_store


def _explained(
    rows: Sequence[PlateRow],
    items: Sequence[_Item],
    seed: int,
    store: Path | None,
    executor: str,
    workers: int | None,
    watch: Watch,
) -> list[PlateRow]:
    """The rows, with a brief diagnosis of misfitting plates unless a slip of the plate explains them."""
    done, sources = list(rows), fingerprint(__name__)
    wrong = [i for i, r in enumerate(rows) if r.misfit > 1.0 and (r.slip is None or weighs_slip(r.slip))]
    wrong = sorted(sorted(wrong, key=lambda i: -rows[i].misfit)[:MOST_DIAGNOSED])
    plates = {i: plate for i in wrong if isinstance(plate := items[i][1], Specimen)}
    keys = {i: row_key(plate, seed, "brief", sources) for i, plate in plates.items()}
    for i, key in keys.items():
        kept = read_row(store, key)
        done[i] = done[i] if kept is None else replace(kept, file=done[i].file)
    missing = [i for i in keys if done[i].diagnosis is None]
    if not missing:
        return done

    def keep(index: int, found: PlateDiagnosis | None) -> None:
        i = missing[index]
        done[i] = replace(done[i], diagnosis=found)
        write_row(store, keys[i], done[i])
        shown.tick(index + 1, float(len(missing) - index - 1))

    with (
        open_executor(executor, workers) as pool,
        watch.stage("plates that misfit", len(missing), counted="plates") as shown,
        suppress(TimeIsUpError),
    ):
        run(_brief, None, [plates[i] for i in missing], pool, batch_size=1, on_result=keep, is_limited=True)
    return done


def _brief(shared: None, specimen: Specimen) -> PlateDiagnosis | None:
    """The diagnosis of a plate without sets; None where it cannot be diagnosed."""
    try:
        return diagnosed(require_diagnosable(specimen), sets=False)
    except (ValueError, ArithmeticError, RuntimeError):
        return None


def _build_models(
    plates: Sequence[Specimen | PlateRow], pool: Executor | None, notify: Callable[[str], None]
) -> None:
    """Build the models for the diagnoses on all workers, once for each geometry."""
    if pool is None:
        return
    seen = set()
    for plate in plates:
        if not isinstance(plate, Specimen) or is_time_up():
            continue
        key = repr((plate.plate, plate.material, plate.unknowns))
        if key in seen:
            continue
        seen.add(key)
        try:
            case = plate_case(plate)
            built = hypotheses_of([case], CATALOGUE)
            notify(f"models of the causes, geometry of {plate.name}")
            build_models([case], built, pool)
        except WorkersLostError:
            raise
        except (ValueError, ArithmeticError, RuntimeError):  # it is said in the row of the plate
            continue


def _row(shared: tuple[int, bool], item: tuple[str, Specimen]) -> PlateRow:
    """The row of one plate; an exception becomes a failed row."""
    (seed, diagnosis), (file, specimen) = shared, item
    try:
        return _identified_row(file, specimen, seed, diagnosis)
    except PlateFileError as error:
        return failed_row(file, specimen.name, str(error))
    except Exception as error:  # noqa: BLE001
        return failed_row(file, specimen.name, f"{type(error).__name__}: {error}")


def _identified_row(file: str, specimen: Specimen, seed: int, diagnosis: bool) -> PlateRow:
    """The row of a plate: constants by swarms, and the claim if asked for."""
    point = identify(specimen, seed=seed)
    whole = None if specimen.measurement is None else specimen.measurement.whole
    row = computed_row(
        file,
        point.estimate,
        message=" ".join(point.warnings),
        search=point.status,
        diagnosis=diagnosed(specimen) if diagnosis else None,
        slip=next(((s.kind, s.number) for s in point.explained_by), None),
    )
    if whole is None:
        return row
    of_all = _identified_row(file, replace(specimen, measurement=whole), seed, False)
    return replace(row, all_rows=of_all.constants)


COMMAND: Final = Command(
    batch,
    (
        option(
            "files",
            nargs="+",
            metavar="FILE",
            help="plate files, folders of them, or built-in specimens; one that fails does not stop the rest",
        ),
        option(
            "--limit",
            "limits",
            action="append",
            default=[],
            metavar="LIMIT",
            help='such as "E1_GPa >= 115 GPa": the probability that each plate meets it; repeatable',
        ),
        option(
            "--diagnosis",
            action="store_true",
            help="diagnose every plate, as `diagnose` does (default: those that misfit)",
        ),
        option(
            "--hierarchical",
            action="store_true",
            help="the mean constants of the material and their scatter from plate to plate, by emcee",
        ),
        option(
            "--own-models",
            "share_models",
            action="store_false",
            help="compute each plate with its own sizes (default: plates of one geometry share models)",
        ),
        option("--store", metavar="DIR", help="keep finished plates in DIR; the same command resumes there"),
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
    out="write results.csv, results.nc, certificate.html, report.html and figures to DIR",
)
