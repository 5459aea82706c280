"""`cpam-bayes sequence PLATE`: the probability of every stacking sequence on the grid."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from cpam_bayes.commands.supported import require_sequence, solver_failure
from cpam_bayes.inference.sequences import DEFAULT_SETTINGS, SequenceAnswer, sequence_probabilities
from cpam_bayes.measurement import Specimen, read_specimen
from cpam_bayes.modes import RigidBodyError
from cpam_bayes.parallel import open_executor
from cpam_bayes.report.answer import Answer, Figures
from cpam_bayes.report.progress import progress
from cpam_bayes.report.sequences import sequence_document, sequence_screen, sequence_warnings


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plate with its unknown angles; return the work."""
    specimen = require_sequence(read_specimen(args.plate, sequence=True))
    return partial(_answer, specimen, args)


def _answer(specimen: Specimen, args: argparse.Namespace) -> Answer:
    settings = replace(DEFAULT_SETTINGS, listed=max(DEFAULT_SETTINGS.listed, args.top))
    with (
        progress(f"sequence {specimen.name}", 64, args.quiet, lambda done: "of the pieces") as shown,
        open_executor(args.executor, args.workers) as executor,
    ):
        try:
            result = sequence_probabilities(
                specimen,
                args.seed,
                settings=settings,
                executor=executor,
                notify=shown.notify,
                progress=lambda done, _: shown.tick(done, float(done)),
            )
        except RigidBodyError as error:
            raise solver_failure(specimen, error) from error
    warnings = sequence_warnings(result)
    return Answer(
        "sequence",
        sequence_document(result, args.seed, args.top, warnings),
        sequence_screen(result, args.seed, warnings),
        warnings,
        partial(_figures, result),
    )


def _figures(result: SequenceAnswer) -> Figures:
    from cpam_bayes.report.sequence_figures import sequence_figures

    return sequence_figures(result)
