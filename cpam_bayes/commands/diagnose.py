"""`cpam-bayes diagnose PLATE [PLATE ...]`: what the simulation gets wrong, the cause, the gain."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.diagnose import Diagnosis, diagnose_cases
from cpam_bayes.diagnosis.extension import resample
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import with_prior_of_none
from cpam_bayes.diagnosis.next_test.next_measurement import Candidate, next_measurements
from cpam_bayes.forward_model.preconditions import plate_warnings, require_diagnosable, solver_failure
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.report.answer import Answer, Figures
from cpam_bayes.report.diagnosis.document import diagnosis_document
from cpam_bayes.report.diagnosis.screen import diagnosis_screen
from cpam_bayes.report.diagnosis.words import diagnosis_warnings
from cpam_bayes.report.page import write_page
from cpam_bayes.report.progress import announce, progress
from cpam_bayes.report.tables import Table

NOT_REACHED = 1


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plates; return the work."""
    specimens = [require_diagnosable(read_specimen(plate)) for plate in args.plates]
    _require_one_material(specimens)
    return partial(_answer, specimens, args)


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
        if not (same and other.material.isotropic == first.material.isotropic):
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
    """What does not change from test to test of a plate."""
    plate = specimen.plate
    return (plate.length, plate.width, plate.thickness, plate.density, plate.layup.text)


def _answer(specimens: Sequence[Specimen], args: argparse.Namespace) -> Answer:
    title = f"diagnose {' '.join(s.name for s in specimens)}"
    cases = [_case(specimen, title, args.quiet) for specimen in specimens]
    result = _diagnosed(cases, title, args)

    def tell(text: str) -> None:
        announce(f"{title}: {text}", args.quiet)

    candidates: tuple[Candidate, ...] = ()
    if args.next != "never":
        always = args.next == "always"
        candidates = next_measurements(result, always=always, scatter=args.scatter, notify=tell)
    resampled = resample(result, args.seed, notify=tell) if args.emcee else None
    own = tuple(warning for specimen in specimens for warning in plate_warnings(specimen))
    warnings = (*diagnosis_warnings(result, resampled, emcee=args.emcee), *own)
    screen = diagnosis_screen(result, args.seed, warnings, candidates, resampled)
    return Answer(
        "diagnose",
        diagnosis_document(result, args.seed, args.scatter, warnings, candidates, resampled),
        screen,
        warnings,
        partial(_figures, result),
        partial(_files, title, screen),
        status=NOT_REACHED if resampled is not None and not resampled.converged else 0,
    )


def _case(specimen: Specimen, title: str, quiet: bool) -> PlateCase:
    try:
        return plate_case(specimen, lambda text: announce(f"{title}: {text}", quiet))
    except RigidBodyError as error:
        raise solver_failure(specimen, error) from error


def _diagnosed(cases: Sequence[PlateCase], title: str, args: argparse.Namespace) -> Diagnosis:
    hypotheses = hypotheses_of(cases)
    if args.prior_none is not None:
        hypotheses = with_prior_of_none(hypotheses, args.prior_none)
    n = len(hypotheses)
    with progress(title, n, args.quiet, lambda done: "of the hypotheses") as shown:

        def tell(done: int, total: int) -> None:
            if done <= n:
                shown.tick(done, float(done))
            elif done == n + 1:
                shown.notify(f"{total - n} pairs of causes")

        return diagnose_cases(
            cases, hypotheses=hypotheses, scatter=args.scatter, notify=shown.notify, progress=tell
        )


def _figures(result: Diagnosis) -> Figures:
    from cpam_bayes.report.diagnosis.figures import diagnosis_figures

    return diagnosis_figures(result)


def _files(title: str, screen: tuple[Table, ...], directory: Path) -> None:
    write_page(title, screen, directory)
