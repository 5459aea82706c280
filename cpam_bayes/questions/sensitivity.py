"""The question `sensitivity`: the paper's repetition on perturbed frequencies beside the posterior."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, get_args

from cpam_bayes.command import EXECUTOR, MODES, PLATE, TIME_LIMIT, WORKERS, Command, option, positive, whole
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.labels import measured_modes
from cpam_bayes.forward_model.model import air_shifts
from cpam_bayes.forward_model.preconditions import (
    explained_failures,
    rectangular_only,
    reference_slips,
    require_choice,
    require_modes,
    require_number,
    require_reachable,
    require_seed,
    require_supported,
    require_whole,
    stated_slips,
)
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import PlateLike, Specimen, read_plate, to_user, user_name
from cpam_bayes.printed.noise_study import (
    ENSEMBLE_SETTINGS,
    Cell,
    ListSource,
    Sensitivity,
    level_percent,
    model_list,
    noise_study,
    own_table,
    sensitivity_notices,
)
from cpam_bayes.printed.repetition import INTERPRETATIONS, Interpretation
from cpam_bayes.printed.tables import PrintedTable, contradictions
from cpam_bayes.render.noise_study import (
    COMPARED,
    PLACE,
    ComparedRow,
    beside_paper,
    difference_sentences,
    noise_text,
    sensitivity_figure,
)
from cpam_bayes.render.plate import plate_section
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    Table,
    facts,
    plain,
    plate_keys,
    remarks,
)
from cpam_bayes.render.sentences import plate_argument
from cpam_bayes.result import PlateResult, present, within_time
from cpam_bayes.running import SILENT, Watch

MAX_LEVEL = 0.5
"""Largest level of noise, as a fraction."""
MAX_GROUPS = 1000
"""Largest number of perturbed lists per level."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SensitivityResult(PlateResult):
    """Inversions of perturbed frequencies beside one posterior, by level of noise.

    Attributes
    ----------
    study : cells of all levels and interpretations of eq. (12)
    table : the paper's table for a built-in specimen, None for other plates
    """

    command: ClassVar[str] = "sensitivity"

    study: Sensitivity
    table: PrintedTable | None

    @property
    def status(self) -> str:
        """Either "converged", or "budget" where the chains of a posterior have not converged."""
        return "converged" if self.reached_goal else "budget"


@checked
@within_time
def sensitivity(
    plate: PlateLike,
    *,
    seed: int = 0,
    levels: Sequence[float] = (0.01, 0.05, 0.1),
    groups: int = 10,
    readings: Interpretation | Sequence[Interpretation] = INTERPRETATIONS,
    source: ListSource = "model",
    n_modes: int | None = None,
    settings: SwarmSettings | None = None,
    chains: EnsembleSettings = ENSEMBLE_SETTINGS,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> SensitivityResult:
    """The paper's noise study, section 7.4: constants from perturbed frequencies, beside a posterior.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    levels : of noise, as fractions, above 0 and at most 0.5
    groups : perturbed frequency lists at each level
    readings : interpretations of eq. (12): noise as a fraction of each frequency ("relative"), or of the
        root mean square frequency ("rms")
    source : what is perturbed: the frequencies of the "model" at the reference constants, or the "measured"
    n_modes : number of modes with ``source="model"``; as many as were measured, or 10, if left out
    settings : of the swarms
    chains : of the ensembles
    executor, workers : as for `cb.sequence`
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If the plate cannot be read, has no unknowns, or measured frequencies are asked for that are missing
        or may lack modes.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.sensitivity("A1", levels=[0.01], groups=3, readings=["rms"], executor="serial")
    >>> (cell,) = result.study.cells
    >>> result.status, cell.repetition.constants.shape
    ('converged', (3, 2))
    """
    require_seed(seed)
    require_modes(n_modes)
    require_choice("source", source, get_args(ListSource))
    readings = (readings,) if isinstance(readings, str) else tuple(readings)
    for reading in readings or ("",):
        require_choice("readings", reading, INTERPRETATIONS)
    levels = tuple(dict.fromkeys(levels))
    for level in levels or (0.0,):
        require_number("levels, as fractions", level, MAX_LEVEL)
    require_whole("groups", groups, 2, MAX_GROUPS)
    specimen = require_supported(read_plate(plate), rectangular_only("sensitivity"))
    if not specimen.unknowns.size:
        raise PlateFileError(f"{specimen.source}: [unknowns] is missing, nothing to identify")
    if source == "measured":
        _require_complete(specimen)
        require_reachable(specimen)
        if n_modes is not None:
            raise ValueError(f"--modes: received {n_modes}, accepted: with --list model only")
    total = len(levels) * len(readings) * (groups + 1)
    title = f"sensitivity {specimen.name}"
    with (
        watch.stage(title, total, counted="posteriors and inversions") as shown,
        open_executor(executor, workers) as pool,
        explained_failures(specimen),
    ):
        if source == "model":
            specimen = model_list(specimen, n_modes or measured_modes(specimen), shown.notify)
        study = noise_study(
            specimen,
            seed,
            source=source,
            levels=levels,
            groups=groups,
            readings=readings,
            swarm_settings=settings,
            chains=chains,
            executor=pool,
            notify=shown.notify,
            progress=lambda done, _: shown.tick(done, float(done)),
        )
    return SensitivityResult(
        seed=seed,
        notices=(*stated_slips(specimen), *reference_slips(specimen), *sensitivity_notices(study)),
        reached_goal=all(cell.posterior.converged for cell in study.cells),
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        study=study,
        table=own_table(specimen),
    )


def _require_complete(specimen: Specimen) -> None:
    if specimen.measurement is None:
        raise PlateFileError(f"{specimen.source}: [measurement] is missing; --list measured needs it")
    if not specimen.measurement.complete:
        raise PlateFileError(
            f"{specimen.source}: measurement.complete: received false, --list measured needs a list "
            "without gaps; use --list model"
        )


_READINGS: Final[Mapping[Interpretation, str]] = {
    "relative": "each mode has its own standard deviation, the level times its frequency",
    "rms": "all modes have one standard deviation, the level times the root mean square frequency",
}
_LISTS: Final[Mapping[ListSource, str]] = {
    "model": "what the plate model gives at the reference constants",
    "measured": "the measured frequencies",
}


def _rows(result: SensitivityResult, cell: Cell) -> tuple[ComparedRow, ...]:
    study = result.study
    return tuple(ComparedRow(study, cell, i, result.table) for i in range(len(study.without_noise.constants)))


@present.register
def _present(result: SensitivityResult) -> Report:
    study = result.study
    by_cell = [_rows(result, cell) for cell in study.cells]
    rows = tuple(row for rows in by_cell for row in rows)
    document = _document(result, by_cell)
    tables = (
        Rows("cell", (*PLACE, *COMPARED), each, lambda r: bool(r.comparison.causes)).table(
            f"Noise {noise_text(each[0].cell)}"
        )
        for each in by_cell
    )
    names = listed([c.name for c in study.without_noise.constants], "and")
    return Report(
        summary=result.screen(
            headline=_headline(by_cell[0]),
            tables=(_spreads(study, by_cell),),
            lines=(_agreement(rows), f"Noise is added to {_LISTS[study.source]}."),
            next_step=(
                "what are the plate's constants and their accuracy?  cpam-bayes identify "
                f"{plate_argument(result.specimen)} --backend emcee"
            ),
        ),
        sections=(
            plate_section(result.specimen, result.air_shifts),
            Section(
                "Repeated inversions beside the posterior",
                (
                    *tables,
                    remarks("Where repetition and posterior differ", difference_sentences(rows)),
                    remarks("Compared with the paper", beside_paper(study, result.table)),
                ),
                ("sensitivity",),
                folded=False,
            ),
            Section(COMPUTATION, (facts("Study", _computation(study, result.seed)),)),
        ),
        document=document,
        drawings=(
            Drawing(
                "sensitivity",
                partial(sensitivity_figure, plain(document)),
                Caption(
                    "Dots: the mean of repeated inversions, with its standard deviation (thin) and its "
                    "standard error (thick). Squares: one posterior at the same noise. Where dot and square "
                    "differ by more than the thick bar, the repetition is off, not unlucky. Crosses: printed "
                    "in the paper.",
                    f"Inversions of perturbed frequencies beside posteriors of {names} at each level of "
                    "noise.",
                ),
            ),
        ),
        rows=(Rows("sensitivity", (*PLACE, *COMPARED), rows),),
    )


def _headline(rows: tuple[ComparedRow, ...]) -> str:
    """The constant that the first level of noise moves most."""
    worst = max(rows, key=lambda r: r.spread(r.cell.posterior.sd))
    percent = significant(worst.spread(worst.cell.posterior.sd), 2)
    level = f"{level_percent(worst.cell.level):g}"
    most = ", the largest of all constants" if len(rows) > 1 else ""
    return f"{level} % noise in the frequencies gives {worst.name} a standard deviation of {percent} %{most}."


def _spreads(study: Sensitivity, by_cell: list[tuple[ComparedRow, ...]]) -> Table:
    """A row for each level and reading, a column for each constant."""

    def both(i: int) -> Callable[[tuple[ComparedRow, ...]], str]:
        def cell(rows: tuple[ComparedRow, ...]) -> str:
            kinds = rows[i].cell.repetition, rows[i].cell.posterior
            return " / ".join(significant(rows[i].spread(by.sd), 2) for by in kinds)

        return cell

    of = {"relative": "of each frequency", "rms": "of the rms frequency"}
    columns = (
        Column("noise", None, lambda rs: f"{level_percent(rs[0].cell.level):g} %", number=True),
        Column("", None, lambda rs: of[rs[0].cell.reading]),
        *(Column(c.name, None, both(i), number=True) for i, c in enumerate(study.without_noise.constants)),
        Column("differ", None, lambda rs: " ".join(r.name for r in rs if r.comparison.causes)),
    )
    rows = Rows("levels", columns, tuple(by_cell), lambda rs: any(r.comparison.causes for r in rs))
    return rows.table(f"Standard deviations, %: of {study.groups} repeated inversions / of the posterior")


def _agreement(rows: tuple[ComparedRow, ...]) -> str:
    agree = sum(not r.comparison.causes for r in rows)
    said = f"Repetition and posterior agree within chance in {agree} of {len(rows)} comparisons"
    return f"{said}." if agree == len(rows) else f"{said}; --verbose explains the others."


def _computation(study: Sensitivity, seed: int) -> tuple[tuple[str, str], ...]:
    cells, n = study.cells, study.groups
    restarted = sum(cell.repetition.restarted for cell in cells)
    return (
        ("list", _LISTS[study.source]),
        *((reading, _READINGS[reading]) for reading in dict.fromkeys(cell.reading for cell in cells)),
        ("repetition", f"{n} noisy lists, each inverted by the swarm, eq. (7): mean and sd over the {n}"),
        (
            "error",
            "mean / noise-free inversion - 1; se: standard error of the mean, sd / sqrt(groups)",
        ),
        (
            "search",
            f"without noise {study.found_again} of {study.starts} swarms found the best constants; "
            f"{restarted} swarms on noisy lists missed the minimum and were restarted",
        ),
        ("posterior", "one, of the list without added noise; its noise is set to the level"),
        (
            "work",
            f"{sum(cell.repetition.solves for cell in cells)} forward solves of the swarms, "
            f"{study.seconds:.0f} s in all, seed {seed}",
        ),
    )


def _document(result: SensitivityResult, by_cell: list[tuple[ComparedRow, ...]]) -> dict[str, Any]:
    """The JSON document; `constants` of a level are those of its first reading."""
    study, table = result.study, result.table
    measurement = study.without_noise.specimen.measurement
    assert measurement is not None
    levels: dict[float, dict[str, Any]] = {}
    for rows in by_cell:
        cell, keys = rows[0].cell, _cell_keys(rows)
        level = levels.setdefault(
            cell.level,
            {
                "level_percent": level_percent(cell.level),
                "reading": cell.reading,
                "constants": keys["constants"],
                "readings": {},
            },
        )
        level["readings"][cell.reading] = keys
    return {
        **plate_keys(result.command, result.seed, result.specimen),
        "list": study.source,
        "frequencies_hz": [float(f) for f in measurement.frequencies],
        "groups": study.groups,
        "without_noise": {
            "constants": {
                user_name(c.name): {"value": to_user(c.name, c.value), "bound": c.bound}
                for c in study.without_noise.constants
            },
            "rms_percent": 100.0 * study.without_noise.rms,
            "status": study.without_noise.swarm.status,
            "swarms": study.starts,
            "swarms_that_found_it": study.found_again,
        },
        "levels": list(levels.values()),
        "paper": None if table is None else _paper_keys(table),
        "forward_solves": sum(cell.repetition.solves for cell in study.cells),
        "seconds": study.seconds,
        "warnings": list(result.warnings),
        "notes": list(study.specimen.notes),
    }


def _cell_keys(rows: tuple[ComparedRow, ...]) -> dict[str, Any]:
    cell = rows[0].cell
    return {
        "noise_sd_hz": [float(sd) for sd in cell.noise_sd],
        "reordered_share": cell.repetition.reordered,
        "redrawn": cell.repetition.redrawn,
        "swarms_converged": cell.repetition.converged,
        "swarms_restarted": cell.repetition.restarted,
        "lists_missed": cell.repetition.missed,
        "posterior_converged": cell.posterior.converged,
        "posterior_effective": cell.posterior.effective,
        "constants": {
            user_name(row.name): keys
            for row, keys in zip(rows, Rows("constants", COMPARED, rows).records(), strict=True)
        },
    }


def _paper_keys(table: PrintedTable) -> dict[str, Any]:
    return {
        "table": table.number,
        "angles_deg": [
            list(row.values["angles_deg"].angles_deg) for row in table.rows if "angles_deg" in row.values
        ],
        "contradictions": [
            {
                "constant": c.column,
                "level_percent": c.row.level_percent,
                "printed_percent": float(c.printed),
                "possible_percent": [c.lowest, c.highest],
            }
            for c in contradictions(table)
        ],
    }


def _level(text: str) -> float:
    return positive(100.0 * MAX_LEVEL, "percentage")(text) / 100.0


def _readings(text: str) -> tuple[Interpretation, ...]:
    chosen = tuple(each for each in INTERPRETATIONS if text in ("both", each))
    if not chosen:
        raise argparse.ArgumentTypeError(f"received {text!r}, accepted: both {' '.join(INTERPRETATIONS)}")
    return chosen


COMMAND: Final = Command(
    sensitivity,
    (
        PLATE,
        option(
            "--levels",
            type=_level,
            nargs="+",
            default=(0.01, 0.05, 0.1),
            metavar="P",
            help=f"levels of noise in percent, above 0, at most {100 * MAX_LEVEL:g} (default: 1 5 10)",
        ),
        option(
            "--groups",
            type=whole(2, MAX_GROUPS),
            default=10,
            metavar="N",
            help=f"perturbed frequency lists at each level, 2 to {MAX_GROUPS} (default: 10)",
        ),
        option(
            "--reading",
            "readings",
            type=_readings,
            default=INTERPRETATIONS,
            metavar="{both,relative,rms}",
            help="eq. (12) as a fraction of each frequency, or of the root mean square frequency for all "
            "modes (default: both)",
        ),
        option(
            "--list",
            "source",
            choices=get_args(ListSource),
            default="model",
            help="what noise is added to: the frequencies that the plate model gives at the reference "
            "constants, or the measured ones, as the paper does (default: model)",
        ),
        MODES,
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
)
