"""The question `report`: constants, stacking sequences and diagnosis of one plate in one answer."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Final

import numpy as np

from cpam_bayes.answer import Notice, each_once
from cpam_bayes.command import EXECUTOR, PLATE, TIME_LIMIT, WORKERS, Command, option
from cpam_bayes.errors import checked
from cpam_bayes.forward_model.preconditions import require_diagnosable, require_seed, require_sequence
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.questions.diagnose import DiagnosisResult, diagnose
from cpam_bayes.questions.identify import PointResult, SampledResult, answered, identify
from cpam_bayes.questions.sequence import StackingResult, sequence
from cpam_bayes.render.notices import sentences
from cpam_bayes.render.plate import PLATE as PLATE_DRAWING
from cpam_bayes.render.report import (
    COMPUTATION,
    Drawing,
    Report,
    Rows,
    Section,
    Summary,
    json_text,
    plate_keys,
    remarks,
)
from cpam_bayes.render.sentences import plate_argument
from cpam_bayes.result import PlateResult, Result, document_of, present, within_time
from cpam_bayes.running import SILENT, Watch

# Below this probability, images included, a notice says which stacking sequence was assumed.
_SURE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class FullReport(PlateResult):
    """The full answer for one plate.

    Attributes
    ----------
    specimen : as given, unknown angles included
    identification : the posterior of the constants; in a quick report their point estimates
    diagnosis : what the plate model gets wrong
    stacking : the posterior over stacking sequences, None where all angles are known and in a quick report
    quick : whether the slow parts were left out
    all_rows : the constants from all frequencies, where some were left out by hand; else None
    """

    command: ClassVar[str] = "report"

    identification: PointResult | SampledResult
    diagnosis: DiagnosisResult
    stacking: StackingResult | None
    quick: bool
    seconds: float
    all_rows: PointResult | SampledResult | None = None

    @property
    def status(self) -> str:
        """Either "done", or "not converged" where a sampler used all its steps."""
        return "done" if self.reached_goal else "not converged"

    @property
    def parts(self) -> tuple[Result, ...]:
        """The answers in order: constants, stacking sequences, diagnosis."""
        between = () if self.stacking is None else (self.stacking,)
        return (self.identification, *between, self.diagnosis)

    @property
    def has_draws(self) -> bool:
        """Whether the posterior of the constants was sampled."""
        return self.identification.has_draws

    def to_arviz(self) -> Any:
        """The draws of the constants, see `SampledResult.to_arviz`.

        Raises
        ------
        ValueError
            For a quick report.
        """
        return self.identification.to_arviz()

    def texts(self) -> Mapping[str, str]:
        """The JSON document of each part."""
        return {f"{part.command}.json": json_text(part.to_dict()) for part in self.parts}


@checked
@within_time
def report(
    plate: PlateLike,
    *,
    seed: int = 0,
    quick: bool = False,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> FullReport:
    """Constants, stacking sequences and diagnosis of a plate in one answer, for one page.

    Unknown ply angles are weighed by `sequence`; constants and diagnosis are then those of the most probable
    stacking sequence.

    Parameters
    ----------
    plate : a built-in name, a path, a table or a `Specimen`, see `read_plate`
    quick : leave out what is slow: the constants are point estimates of `identify` instead of draws of
        `sample`, unknown angles are those found by the swarm, and no further test is ranked. A list that
        may lack modes is sampled all the same
    executor, workers : as for `diagnose`
    watch : progress display; none if left out

    Raises
    ------
    ValueError
        If the plate cannot be read, identified or diagnosed.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> answer = cb.report("A1", quick=True)
    >>> answer.diagnosis.claim, answer.identification.status
    ('undecided', 'converged')
    """
    require_seed(seed)
    start = time.perf_counter()
    specimen = _answerable(read_plate(plate))
    stacking: StackingResult | None = None
    identification: PointResult | SampledResult | None = None
    known = specimen
    if specimen.plate.layup.n_unknown and not quick:
        stacking = sequence(specimen, seed=seed, executor=executor, workers=workers, watch=watch)
        known = replace(specimen, plate=stacking.most_probable.plate)
    elif specimen.plate.layup.n_unknown:
        identification = identify(specimen, seed=seed, watch=watch)
        known = replace(specimen, plate=identification.specimen.plate)
    diagnosis = diagnose(
        known,
        seed=seed,
        next_test="never" if quick else "open",
        executor=executor,
        workers=workers,
        watch=watch,
    )
    constants = partial(answered, seed=seed, watch=watch, backend=None if quick else "emcee")
    if identification is None:
        identification = constants(known)
    whole = None if known.measurement is None else known.measurement.whole
    all_rows = None if whole is None else constants(replace(known, measurement=whole))
    answer = FullReport(
        seed=seed,
        specimen=specimen,
        air_shifts=diagnosis.air_shifts[0],
        identification=identification,
        diagnosis=diagnosis,
        stacking=stacking,
        quick=quick,
        all_rows=all_rows,
        seconds=time.perf_counter() - start,
    )
    of_parts = (notice for part in answer.parts for notice in part.notices)
    return replace(
        answer,
        notices=each_once((*_layup_notice(stacking), *of_parts)),
        reached_goal=all(part.reached_goal for part in answer.parts),
    )


def _answerable(specimen: Specimen) -> Specimen:
    """The specimen itself; raises `PlateFileError` where one of the parts would refuse it."""
    layup = specimen.plate.layup
    if not layup.n_unknown:
        return require_diagnosable(specimen)
    require_sequence(specimen)
    known = replace(specimen.plate, layup=layup.with_angles(np.zeros(layup.n_unknown)))
    require_diagnosable(replace(specimen, plate=known))
    return specimen


def _layup_notice(stacking: StackingResult | None) -> tuple[Notice, ...]:
    """Notice that constants and diagnosis assume one stacking sequence of several."""
    if stacking is None:
        return ()
    answer = stacking.answer
    probability = float(answer.probability[0] * answer.multiplicity[0])
    if probability >= _SURE:
        return ()
    angles = tuple(float(a) for a in answer.top[0])
    return (Notice("one_layup_taken", facts={"angles_deg": angles, "probability": probability}),)


def _each_once(texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(texts))


_RIGHT: Final = "If nothing is wrong"
_HOLDS: Final = "These constants assume that plate and list are right; they are not the answer."


@present.register
def _present(result: FullReport) -> Report:
    """Report of all parts: the diagnosis with its constants, and stacking sequences for unknown angles.

    The constants of the identification, which allow for no error of the plate model, are folded away.
    """
    parts = {part.command: part.report() for part in result.parts}

    def document(part: Result) -> Mapping[str, Any]:
        return document_of(part, parts[part.command])

    alone = result.identification.command
    answers = {name: shown for name, shown in parts.items() if name != alone}
    main = parts[result.diagnosis.command]
    behind = [
        replace(section, figures=tuple(_figure_name(name, figure) for figure in section.figures))
        for name, shown in answers.items()
        for section in shown.sections
        if name == result.diagnosis.command or PLATE_DRAWING not in section.figures
    ]
    # the plate drawing first, folded sections last
    behind.sort(key=lambda section: (PLATE_DRAWING not in section.figures, section.folded))
    return Report(
        summary=_summary(result, main.summary, [shown.summary for shown in answers.values()]),
        sections=(*_all_rows(result), *behind, *_if_right(alone, parts[alone])),
        document={
            **plate_keys(result.command, result.seed, result.specimen),
            "quick": result.quick,
            "status": result.status,
            "identification": document(result.identification),
            "stacking": None if result.stacking is None else document(result.stacking),
            "diagnosis": document(result.diagnosis),
            "all_rows": None if result.all_rows is None else result.all_rows.to_dict(),
            "seconds": result.seconds,
            "warnings": list(result.warnings),
            "notes": list(result.specimen.notes),
        },
        drawings=tuple(
            Drawing(_figure_name(name, drawing.name), drawing.draw, drawing.caption)
            for name, shown in parts.items()
            for drawing in shown.drawings
        ),
        rows=(*main.rows, *_named_rows(parts, result.diagnosis.command)),
    )


def _summary(result: FullReport, main: Summary, answers: list[Summary]) -> Summary:
    """The summary of the diagnosis, with the stacking sequences beside it."""
    command = f"cpam-bayes report {plate_argument(result.specimen)} --out DIR"
    taken = sentences(_layup_notice(result.stacking))
    quick = f"get the posterior and a ranking of further tests.  {command}" if result.quick else ""
    return Summary(
        title=f"report {result.title}",
        headline="\n".join(part.headline for part in answers),
        tables=tuple(table for part in answers for table in part.tables),
        lines=main.lines,
        next_step=main.next_step or quick,
        slips=_each_once(slip for part in answers for slip in part.slips),
        warnings=_each_once((*taken, *(warning for part in answers for warning in part.warnings))),
    )


def _all_rows(result: FullReport) -> tuple[Section, ...]:
    """The constants with and without the frequencies that were left out by hand."""
    if result.all_rows is None:
        return ()
    used, of_both = result.specimen.measurement, (result.all_rows, result.identification)
    tables = zip(("With all frequencies", "With those used"), of_both, strict=True)
    return (
        Section(
            "Frequencies left out by hand",
            (
                remarks("By hand", () if used is None else used.remarks),
                *(replace(part.report().summary.tables[0], title=title) for title, part in tables),
            ),
            folded=False,
        ),
    )


def _if_right(name: str, shown: Report) -> tuple[Section, ...]:
    """The identification as one section, followed by how it was computed."""
    summary = shown.summary
    parts = [section for section in shown.sections if PLATE_DRAWING not in section.figures]
    computed = tuple(section for section in parts if section.title == COMPUTATION)
    behind = [section for section in parts if section.title != COMPUTATION]
    said = (_HOLDS, *summary.headline.splitlines(), *summary.lines, *summary.slips, *summary.warnings)
    return (
        Section(
            _RIGHT,
            (
                remarks(_RIGHT, _each_once(said)),
                *summary.tables,
                *(table for section in behind for table in section.tables),
            ),
            tuple(_figure_name(name, figure) for section in behind for figure in section.figures),
        ),
        *computed,
    )


def _figure_name(command: str, name: str) -> str:
    """Figure name with its command; the plate drawing, which all parts share, keeps its name."""
    return name if name == PLATE_DRAWING else f"{command}_{name}"


def _named_rows(parts: Mapping[str, Report], main: str) -> tuple[Rows, ...]:
    """The tables of the other parts, named after their commands."""
    return tuple(
        replace(rows, name=f"{name}_{rows.name}")
        for name, shown in parts.items()
        if name != main
        for rows in shown.rows
    )


COMMAND: Final = Command(
    report,
    (
        PLATE,
        option(
            "--out",
            None,
            metavar="DIR",
            required=True,
            help="write report.html, result files and figures to DIR",
        ),
        option(
            "--quick",
            action="store_true",
            help="skip what is slow: emcee, enumeration of stacking sequences, ranking of further tests",
        ),
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
    out=None,
)
