"""Errors of the plate, the list or the model, weighed by probability: the question `diagnose`."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Final, Literal

from cpam_bayes.answer import Notice, as_written, each_once
from cpam_bayes.command import EXECUTOR, TIME_LIMIT, WORKERS, Command, option, positive
from cpam_bayes.diagnosis.cases import build_models, hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.diagnose import Diagnosis, diagnose_cases
from cpam_bayes.diagnosis.evidence.sampled import ready
from cpam_bayes.diagnosis.extension import paired_fit, plain_mode_shapes
from cpam_bayes.diagnosis.hypotheses import with_prior_of_none
from cpam_bayes.diagnosis.next_test import Candidate, next_measurements
from cpam_bayes.diagnosis.notices import diagnosis_notices
from cpam_bayes.effects import CATALOGUE, Effect
from cpam_bayes.errors import checked
from cpam_bayes.forward_model.model import air_shifts
from cpam_bayes.forward_model.preconditions import (
    count_slips,
    equal_list_slips,
    explained_failures,
    misfit_slips,
    reference_slips,
    require_choice,
    require_diagnosable,
    require_number,
    require_reachable,
    require_seed,
    stated_noise_slips,
)
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.questions.diagnose import page as page  # how it is shown
from cpam_bayes.questions.diagnose.claim import claim_sentence
from cpam_bayes.questions.diagnose.document import DiagnosisResult
from cpam_bayes.result import within_time
from cpam_bayes.running import SILENT, Watch, cut_short, is_time_up

__all__ = ["COMMAND", "DiagnosisResult", "claim_sentence", "diagnose", "diagnosis_result"]

DEFAULT_SCATTER: Final = 0.02
MAX_SCATTER: Final = 0.5
MAX_PRIOR_NONE: Final = 0.99
MAX_PLATES: Final = 50


@checked
@within_time
def diagnose(
    *plates: PlateLike,
    seed: int = 0,
    scatter: float = DEFAULT_SCATTER,
    prior_none: float | None = None,
    next_test: Literal["open", "always", "never"] = "open",
    catalogue: tuple[Effect, ...] | None = None,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> DiagnosisResult:
    """The probable errors of the plate, the list or the model, and the constants that allow for them.

    Parameters
    ----------
    plates : of each a built-in name, a path, a table or a `Specimen`, see `read_plate`;
        several plates are of one material and share their constants, those with equal ``specimen`` are one
        plate under several tests
    scatter : relative standard deviation of a constant from plate to plate of one material
    prior_none : prior probability that nothing is wrong, 0.5 where left out
    next_test : when to rank further tests: while the cause is "open", "always", or "never"
    catalogue : the effects that the plates may have; those of the package where left out
    executor, workers : where models are built and hypotheses are fitted: "serial", in this process;
        "processes", as many as cores or ``workers``, which needs the call under
        ``if __name__ == "__main__":`` in a script; or a Dask cluster, see
        `cpam_bayes.parallel.open_executor`. The answer is the same
    watch : display of the progress; none where left out

    Raises
    ------
    ValueError
        If a plate cannot be read or diagnosed, or if the plates cannot share their constants.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.diagnose("A1", next_test="never")
    >>> result.claim, [cause.name for cause in result.diagnosis.causes[:2]]
    ('undecided', ['none', 'other'])
    """
    require_seed(seed)
    require_number("scatter", scatter, MAX_SCATTER)
    require_choice("next_test", next_test, ("open", "always", "never"))
    if prior_none is not None:
        require_number("prior_none", prior_none, MAX_PRIOR_NONE)
    if not 1 <= len(plates) <= MAX_PLATES:
        raise ValueError(
            f"plates: received {len(plates) or 'none'}, accepted: one plate or more, {MAX_PLATES} at most"
        )
    specimens = tuple(require_diagnosable(read_plate(plate)) for plate in plates)
    _require_one_material(specimens)
    for specimen in specimens:
        require_reachable(specimen)
    names = " ".join(s.name for s in specimens)
    title = f"diagnose {names}"

    def announce(text: str, name: str = names) -> None:
        watch.announce(f"diagnose {name}: {text}")

    cases = []
    with open_executor(executor, workers) as pool:
        ready(pool)
        for specimen in specimens:
            with explained_failures(specimen):
                cases.append(plate_case(specimen, partial(announce, name=specimen.name)))
        diagnosis = _diagnosed(cases, title, scatter, prior_none, catalogue or CATALOGUE, pool, watch)
        candidates: tuple[Candidate, ...] = ()
        if next_test != "never" and is_time_up():
            cut_short("cut_next_tests")
        elif next_test != "never":
            always = next_test == "always"
            candidates = next_measurements(
                diagnosis, always=always, scatter=scatter, executor=pool, notify=announce
            )
    notices = (*_slips(diagnosis, specimens), *diagnosis_notices(diagnosis))
    return replace(
        diagnosis_result(diagnosis, seed, scatter, candidates),
        notices=each_once((*notices, *_remarks(specimens))),
    )


def _remarks(specimens: Sequence[Specimen]) -> tuple[Notice, ...]:
    """Doubts from reading the measurements."""
    measurements = [s.measurement for s in specimens if s.measurement is not None]
    return as_written(remark for m in measurements for remark in m.remarks)


def _slips(diagnosis: Diagnosis, specimens: Sequence[Specimen]) -> tuple[Notice, ...]:
    """Likely slips that ruin the diagnosis."""
    fit = diagnosis.extended or diagnosis.baseline
    unknowns = {name for specimen in specimens for name in specimen.unknowns.names}
    measurements = [s.measurement for s in specimens if s.measurement is not None]
    return (
        *(slip for m in measurements for slip in stated_noise_slips(m)),
        *equal_list_slips(specimens),
        *count_slips(len(diagnosis.baseline.measured), len(unknowns)),
        *misfit_slips(fit.rms),
        *(slip for specimen in specimens for slip in reference_slips(specimen)),
    )


def diagnosis_result(
    diagnosis: Diagnosis,
    seed: int,
    scatter: float = DEFAULT_SCATTER,
    candidates: tuple[Candidate, ...] = (),
) -> DiagnosisResult:
    """A diagnosis with what is shown of it: the mode of each frequency, mode shapes, what air would do."""
    specimens = tuple(case.models.specimen for case in diagnosis.cases)
    extended = diagnosis.extended
    return DiagnosisResult(
        seed=seed,
        diagnosis=diagnosis,
        plates=specimens,
        air_shifts=tuple(air_shifts(specimen) for specimen in specimens),
        plain=paired_fit(diagnosis, diagnosis.baseline, diagnosis.weighed.none),
        extended=None if extended is None else paired_fit(diagnosis, extended, diagnosis.members[0][0]),
        mode_shapes=plain_mode_shapes(diagnosis),
        scatter=scatter,
        candidates=candidates,
    )


def _diagnosed(
    cases: Sequence[PlateCase],
    title: str,
    scatter: float,
    prior_none: float | None,
    catalogue: tuple[Effect, ...],
    executor: Executor | None,
    watch: Watch,
) -> Diagnosis:
    hypotheses = hypotheses_of(cases, catalogue)
    if prior_none is not None:
        hypotheses = with_prior_of_none(hypotheses, prior_none)
    n = len(hypotheses)
    with watch.stage(title, n, counted="hypotheses") as shown:

        def progress(done: int, total: int) -> None:
            if done <= n:
                shown.tick(done, float(done))
            elif done == n + 1:
                shown.notify(f"{total - n} pairs of causes")

        def built(done: int, total: int) -> None:
            if done == total or done % max(1, total // 10) == 0:
                shown.notify(f"building {done} of {total} models")

        build_models(cases, hypotheses, executor, built)
        return diagnose_cases(
            cases,
            hypotheses=hypotheses,
            scatter=scatter,
            executor=executor,
            notify=shown.notify,
            progress=progress,
        )


def _require_one_material(specimens: Sequence[Specimen]) -> None:
    """Refuse plates that cannot share their constants, or of which two are the same."""
    names = [s.name for s in specimens]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise ValueError(
            f"PLATE: received {twice} twice, accepted: plates of different names; one list counts once"
        )
    first = specimens[0]
    for other in specimens[1:]:
        same = other.material.name == first.material.name
        if not (same and other.material.symmetry == first.material.symmetry):
            raise ValueError(
                f"{other.source}: material {other.material.name or 'not named'}, while {first.name} has "
                f"{first.material.name or 'none named'}; plates that are diagnosed together share their "
                "constants: give plates of one material, with the same material.name"
            )
    for i, other in enumerate(specimens):
        tested = next((s for s in specimens[:i] if s.specimen == other.specimen), None)
        if tested is not None and _sizes(tested) != _sizes(other):
            raise ValueError(
                f"{other.source}: specimen {other.specimen} has other sizes, density or layup than in "
                f"{tested.source}; files of one specimen are tests of one plate: give them the same [plate] "
                "but for the edges, or names of their own to the specimens"
            )


def _sizes(specimen: Specimen) -> tuple[float | str, ...]:
    """The sizes that do not change from test to test of a plate."""
    plate = specimen.plate
    return (plate.length, plate.width, plate.thickness, plate.density, plate.layup.text)


COMMAND: Final = Command(
    diagnose,
    (
        option(
            "plates",
            nargs="+",
            metavar="PLATE",
            help="built-in specimens or paths of plate files; several are plates of one material, which "
            "share their constants, or with equal `specimen` one plate under several tests",
        ),
        option(
            "--scatter",
            type=positive(MAX_SCATTER),
            default=DEFAULT_SCATTER,
            metavar="S",
            help="standard deviation of a constant from plate to plate of one material, relative, above 0, "
            f"at most {MAX_SCATTER:g} (default: {DEFAULT_SCATTER:g})",
        ),
        option(
            "--prior-none",
            type=positive(MAX_PRIOR_NONE),
            metavar="P",
            help="prior probability that nothing is wrong, above 0, at most "
            f"{MAX_PRIOR_NONE:g} (default: 0.5)",
        ),
        option(
            "--next",
            "next_test",
            choices=("open", "always", "never"),
            default="open",
            help="when to rank further tests by what they tell about the cause: while the cause is open, "
            "always, or never (default: open)",
        ),
        EXECUTOR,
        WORKERS,
        TIME_LIMIT,
    ),
)
