"""Constants, stacking sequences and diagnosis of one plate as one answer: the question `report`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from cpam_bayes.arguments import checked
from cpam_bayes.diagnosis.plates import DiagnosisResult, diagnose
from cpam_bayes.forward_model.preconditions import require_diagnosable, require_seed, require_sequence
from cpam_bayes.identification.identify import PointResult, identify
from cpam_bayes.identification.sampled import SampledResult, sample
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.result import SILENT, PlateResult, Result, Watch, within_time
from cpam_bayes.stacking.sequence import StackingResult, sequence

__all__ = ["FullReport", "full_report"]

# Probability of a stacking sequence with its images below which more than a footnote says that it was taken.
_SURE = 0.95


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class FullReport(PlateResult):
    """All that is asked of one plate.

    Attributes
    ----------
    specimen : as it was given, unknown angles included
    identification : the posterior of the constants, or of a quick report their point estimates
    diagnosis : what the plate model gets wrong
    stacking : the posterior over stacking sequences, None where all angles are known and of a quick report
    quick : whether the slow parts were left out
    """

    question: ClassVar[str] = "combined"
    command: ClassVar[str] = "report"

    identification: PointResult | SampledResult
    diagnosis: DiagnosisResult
    stacking: StackingResult | None
    quick: bool
    seconds: float

    @property
    def status(self) -> str:
        """Either "done", or "not converged" where a sampler used all its steps."""
        return "done" if self.reached_goal else "not converged"

    @property
    def parts(self) -> tuple[Result, ...]:
        """The answers one by one: constants, stacking sequences, diagnosis."""
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
            If the report is a quick one.
        """
        return self.identification.to_arviz()

    def texts(self) -> Mapping[str, str]:
        """The JSON document of each part."""
        json_text = import_module("cpam_bayes.report.documents").json_text
        return {f"{part.command}.json": json_text(part.to_dict()) for part in self.parts}


@checked
@within_time
def full_report(
    plate: PlateLike,
    *,
    seed: int = 0,
    quick: bool = False,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> FullReport:
    """Constants, stacking sequences and diagnosis of a plate as one answer, for one page.

    Unknown ply angles are weighed by `sequence`; the constants and the diagnosis are then those of the most
    probable stacking sequence.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns
    quick : leave out what is slow: the constants are point estimates of `identify` instead of draws of
        `sample`, unknown angles are those that the swarm finds, and no further test is ranked. A list that
        may lack modes is sampled all the same
    executor, workers : as for `diagnose`
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the plate cannot be read, identified or diagnosed.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> report = cb.full_report("A1", quick=True)
    >>> report.diagnosis.claim, report.identification.status
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
        known = stacking.most_probable
    elif specimen.plate.layup.n_unknown:
        identification = identify(specimen, seed=seed, watch=watch)
        known = identification.specimen
    diagnosis = diagnose(
        known,
        seed=seed,
        next_test="never" if quick else "open",
        executor=executor,
        workers=workers,
        watch=watch,
    )
    if identification is None:
        identification = _constants(known, seed, quick, watch)
    report = FullReport(
        seed=seed,
        specimen=specimen,
        air_shifts=diagnosis.air_shifts[0],
        identification=identification,
        diagnosis=diagnosis,
        stacking=stacking,
        quick=quick,
        seconds=time.perf_counter() - start,
    )
    warnings = (*_layup_warning(stacking), *(w for part in report.parts for w in part.warnings))
    return replace(
        report,
        warnings=tuple(dict.fromkeys(warnings)),
        slips=tuple(dict.fromkeys(slip for part in report.parts for slip in part.slips)),
        reached_goal=all(part.reached_goal for part in report.parts),
    )


def _constants(specimen: Specimen, seed: int, quick: bool, watch: Watch) -> PointResult | SampledResult:
    assert specimen.measurement is not None
    if quick and specimen.measurement.complete:
        return identify(specimen, seed=seed, watch=watch)
    return sample(specimen, seed=seed, watch=watch)


def _answerable(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` with all that one of the parts would refuse."""
    layup = specimen.plate.layup
    if not layup.n_unknown:
        return require_diagnosable(specimen)
    require_sequence(specimen)
    known = replace(specimen.plate, layup=layup.with_angles(np.zeros(layup.n_unknown)))
    require_diagnosable(replace(specimen, plate=known))
    return specimen


def _layup_warning(stacking: StackingResult | None) -> tuple[str, ...]:
    if stacking is None:
        return ()
    answer = stacking.answer
    probability = float(answer.probability[0] * answer.multiplicity[0])
    if probability >= _SURE:
        return ()
    angles = "/".join(f"{a:g}" for a in answer.top[0])
    return (
        f"constants and diagnosis take the stacking sequence {angles} for true, whose probability with its "
        f"images is {probability:.2g}: with another sequence they would differ",
    )
