"""Many plates one after the other: the question `batch`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar, Final, TypeAlias

from cpam_bayes.arguments import checked
from cpam_bayes.batches.control_chart import ControlChart, control_chart
from cpam_bayes.batches.geometry import carried, groups_of, size_powers
from cpam_bayes.batches.limits import Limit, read_limit
from cpam_bayes.batches.plate_row import PlateRow, computed_row, failed_row
from cpam_bayes.batches.population import Population, population_of
from cpam_bayes.batches.row_store import read_row, row_key, write_row
from cpam_bayes.deadline import TimeIsUpError, cut_short, is_time_up
from cpam_bayes.diagnosis.building import build_models
from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.errors import PlateFileError
from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.preconditions import (
    require_diagnosable,
    require_paired_list,
    require_seed,
    require_supported,
)
from cpam_bayes.forward_model.slips import equal_list_slips
from cpam_bayes.identification.identify import NO_MESH
from cpam_bayes.identification.search import required
from cpam_bayes.parallel import WorkersLostError, open_executor, run
from cpam_bayes.plate import PlateLike, Specimen, read_plate, user_name
from cpam_bayes.result import SILENT, Result, Watch, within_time

__all__ = ["BatchResult", "batch"]

MAX_PLATES: Final = 10_000
# Plates that a warning names.
_SHOWN = 5

# A plate as it is computed, or why it cannot be.
_Item: TypeAlias = "tuple[str, Specimen | PlateRow]"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class BatchResult(Result):
    """One row a plate.

    Attributes
    ----------
    rows : in the order of the plates
    limits : what the constants have to meet
    diagnosis : whether each plate was diagnosed
    models : number of geometries, whose plates share one model
    from_store : number of plates that a stored run had finished
    population : mean constants of the material and their scatter, where asked for
    seconds : wall clock
    """

    question: ClassVar[str] = "batch"
    command: ClassVar[str] = "batch"

    rows: tuple[PlateRow, ...]
    limits: tuple[Limit, ...]
    diagnosis: bool
    models: int
    from_store: int
    seconds: float
    population: Population | None = None

    @property
    def status(self) -> str:
        """Either "done", "failed" where a plate has no answer, or "not converged", of the scatter."""
        if self.failed or self.reached_goal:
            return "failed" if self.failed else "done"
        return "not converged"

    @property
    def title(self) -> str:
        """The number of plates."""
        return f"of {len(self.rows)} plate{'' if len(self.rows) == 1 else 's'}"

    @property
    def done(self) -> tuple[PlateRow, ...]:
        """The plates that have an answer."""
        return tuple(row for row in self.rows if row.status == "done")

    @property
    def failed(self) -> tuple[PlateRow, ...]:
        """The plates that have none."""
        return tuple(row for row in self.rows if row.status == "failed")

    @property
    def constants(self) -> tuple[str, ...]:
        """All constants that a plate has, in the order in which they come."""
        return tuple(dict.fromkeys(c.name for row in self.done for c in row.constants))

    def chart(self, name: str) -> ControlChart | None:
        """The control chart of one constant over the plates that have it."""
        found = [row.constant(name) for row in self.done]
        return control_chart([c.value for c in found if c is not None])

    def outside(self, name: str) -> tuple[PlateRow, ...]:
        """The plates beyond the limits of the control chart of one constant."""
        chart, having = self.chart(name), [row for row in self.done if row.constant(name) is not None]
        return () if chart is None else tuple(having[i] for i in chart.outside)

    def probability(self, row: PlateRow, limit: Limit) -> float | None:
        """The probability that a plate meets a limit; None where it has no such constant."""
        constant = row.constant(limit.name)
        return None if constant is None else constant.posterior.meets(limit)

    def texts(self) -> Mapping[str, str]:
        """The table for a spreadsheet."""
        return {"results.csv": import_module("cpam_bayes.report.batch.files").csv_text(self)}

    def datasets(self) -> Mapping[str, Any]:
        """The table as an xarray dataset, and the draws of means and scatters."""
        files = import_module("cpam_bayes.report.batch.files")
        table = {"results.nc": files.dataset(self)}
        return (
            table if self.population is None else {**table, "population.nc": files.population_dataset(self)}
        )


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
    """The constants of many plates by swarm and Laplace's approximation, and their diagnosis.

    A plate that fails has a row with the reason, and the others are done. Plates of one geometry whose
    thickness and density are within 5 % of the first, length and width within 1 %, share its models: their
    lists are carried to its sizes by d log f / d log s at the reference constants.

    Parameters
    ----------
    plates : what `read_plate` takes, or what it returns
    limits : such as "E1_GPa >= 115"; each row has the probability of meeting them
    diagnosis : whether to ask what the plate model gets wrong, as `diagnose` does
    hierarchical : whether to ask for the mean constants of the material and their scatter from plate to
        plate, by emcee
    share_models : False computes each plate with its own sizes
    store : a directory that keeps finished plates; the same call goes on from there
    executor, workers : where the plates are computed, see `cpam_bayes.parallel.open_executor`; the answer is
        the same
    watch : is shown the progress

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
    if not 1 <= len(plates) <= MAX_PLATES:
        raise ValueError(
            f"plates: received {len(plates) or 'none'}, accepted: one plate or more, {MAX_PLATES} at most"
        )
    read = tuple(read_limit(text) for text in limits)
    if store is not None and (not str(store) or (Path(store).exists() and not Path(store).is_dir())):
        raise ValueError(f"store: received {str(store)!r}, accepted: a directory")
    read_items = [_read(plate, diagnosis) for plate in plates]
    _require_limits_of_unknowns(read, read_items)
    items, n_models = _with_shared_sizes(read_items, share_models)
    rows, from_store = _computed(
        items, seed, diagnosis, None if store is None else Path(store), executor, workers, watch
    )
    failed = sum(row.status == "failed" for row in rows)
    many = f"{failed} plate{' has' if failed == 1 else 's have'} no answer: the rows say why"
    population, not_pooled = _population(rows, seed, watch) if hierarchical else (None, ())
    materials = {row.material for row in rows if row.status == "done"}
    mixed = "the plates are of several materials: means and control limits are those of a mixture"
    return BatchResult(
        seed=seed,
        warnings=(
            *((many,) if failed else ()),
            *((mixed,) if len(materials) > 1 else ()),
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


def _not_described(rows: Sequence[PlateRow]) -> tuple[str, ...]:
    """Which plates have a misfit that the stated noise does not explain."""
    worst = sorted((row for row in rows if row.misfit > 1.0), key=lambda row: -row.misfit)
    if not worst:
        return ()
    shown = [f"{row.name} ({significant(row.misfit, 2)} times the noise)" for row in worst[:_SHOWN]]
    more = f" and {len(worst) - _SHOWN} more" if len(worst) > _SHOWN else ""
    return (
        f"the plate model does not describe the frequencies of {', '.join(shown)}{more}: their constants, "
        "and what is said of limits, means and scatter with them, cannot be trusted until the cause is known",
    )


def _population(
    rows: Sequence[PlateRow], seed: int, watch: Watch
) -> tuple[Population | None, tuple[str, ...]]:
    """Mean and scatter of the material, and why there is none or why not to trust it."""
    watch.announce("batch: mean and scatter of the material")
    try:
        population = population_of(rows, seed)
    except ValueError as error:
        return None, (f"no mean and scatter of the material: {error}",)
    if population.status == "converged":
        return population, ()
    d = population.diagnostics
    return population, (
        f"the chains of mean and scatter used their budget of {d.steps} steps before they converged (R-hat "
        f"{d.r_hat:.3f}, {d.ess_bulk:.0f} effective samples)",
    )


def _read(plate: PlateLike, diagnosis: bool) -> _Item:
    """A plate with the name it was given by, or the row that says why it cannot be computed."""
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
    """Raise ``ValueError`` for a limit on a constant that no plate asks for."""
    read = [item for _, item in items if isinstance(item, Specimen)]
    unknown = list(dict.fromkeys(name for specimen in read for name in specimen.unknowns.names))
    for limit in limits:
        if read and limit.name not in unknown:
            raise ValueError(
                f"limit: received {limit.text!r}, a constant that is in [unknowns] of no plate, accepted: "
                f"{' '.join(user_name(name) for name in unknown)}"
            )


def _with_shared_sizes(items: Sequence[_Item], share: bool) -> tuple[list[_Item], int]:
    """The plates of one geometry with the sizes of its first, and the number of geometries."""
    known = [(i, item[1]) for i, item in enumerate(items) if isinstance(item[1], Specimen)]
    shared = list(items)
    groups = groups_of([s for _, s in known]) if share else [[k] for k in range(len(known))]
    count = len(groups)
    for group in groups:
        nominal = known[group[0]][1]
        others = [k for k in group[1:] if known[k][1].plate != nominal.plate]
        if not others:
            continue
        assert nominal.measurement is not None
        try:
            powers = size_powers(nominal, nominal.measurement.size)
        except ValueError:  # it is said where the plate is computed
            count += len(others)
            continue
        for k in others:
            i, specimen = known[k]
            moved = carried(specimen, nominal, powers)
            count += moved is None
            shared[i] = (shared[i][0], moved or specimen)
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
    """All rows, and the number of those that were stored."""
    rows: dict[int, PlateRow] = {}
    keys: dict[int, str] = {}
    for i, (file, plate) in enumerate(items):
        if isinstance(plate, PlateRow):
            rows[i] = plate
            continue
        keys[i] = row_key(plate, seed, diagnosis)
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
        watch.stage("batch", len(items), lambda left: f"{left:.0f} plates left") as shown,
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
        cut_short(f"{len(late)} of {len(items)} plates were not computed")
    return [rows[i] for i in range(len(items))], from_store


def _build_models(
    plates: Sequence[Specimen | PlateRow], pool: Executor | None, notify: Callable[[str], None]
) -> None:
    """Build what the diagnoses of the plates need on all workers, a geometry once."""
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
    """The row of one plate; whatever stops it stops no other."""
    (seed, diagnosis), (file, specimen) = shared, item
    try:
        return computed_row(file, specimen, seed, diagnosis)
    except PlateFileError as error:
        return failed_row(file, specimen.name, str(error))
    except Exception as error:  # noqa: BLE001
        return failed_row(file, specimen.name, f"{type(error).__name__}: {error}")
