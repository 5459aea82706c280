"""`cpam-bayes sequence PLATE`: the probability of every stacking sequence on the grid."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cpam_bayes.forward_model.preconditions import require_sequence, solver_failure
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.paper.layups import identified_layups
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.report.answer import Answer, Figures
from cpam_bayes.report.progress import progress
from cpam_bayes.report.stacking.screen import sequence_document, sequence_screen, sequence_warnings
from cpam_bayes.stacking.mixture import StackingMixture, n_sampled_classes, sample_mixture
from cpam_bayes.stacking.posterior import DEFAULT_SETTINGS, StackingPosterior, stacking_posterior
from cpam_bayes.stacking.queries.given_layup import GivenLayup, given_layup

NOT_REACHED = 1


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plate with its unknown angles; return the work."""
    specimen = require_sequence(read_specimen(args.plate, sequence=True))
    return partial(_answer, specimen, args)


def _answer(specimen: Specimen, args: argparse.Namespace) -> Answer:
    settings = replace(DEFAULT_SETTINGS, listed=max(DEFAULT_SETTINGS.listed, args.top))
    with open_executor(args.executor, args.workers) as executor:
        with progress(f"sequence {specimen.name}", 64, args.quiet, lambda done: "of the pieces") as shown:
            try:
                result = stacking_posterior(
                    specimen,
                    args.seed,
                    settings=settings,
                    executor=executor,
                    notify=shown.notify,
                    progress=lambda done, _: shown.tick(done, float(done)),
                )
            except RigidBodyError as error:
                raise solver_failure(specimen, error) from error
        given = _printed(result, args.plate)
        classes = n_sampled_classes(result) + (given is not None)
        with progress("constants by emcee", classes, args.quiet, lambda done: "a class each") as shown:
            mixture = sample_mixture(
                result,
                args.seed,
                given=given,
                executor=executor,
                progress=lambda done, _: shown.tick(done, float(done)),
            )
    warnings = sequence_warnings(result, mixture)
    return Answer(
        "sequence",
        sequence_document(result, mixture, given, args.seed, args.top, warnings),
        sequence_screen(result, mixture, given, args.seed, warnings),
        warnings,
        partial(_figures, result, mixture, given),
        partial(_files, result, mixture, args.seed),
        status=0 if mixture.converged else NOT_REACHED,
    )


def _printed(result: StackingPosterior, plate: str) -> GivenLayup | None:
    """What Table 9(b) prints for a built-in specimen."""
    printed = identified_layups().get(plate)
    if printed is None:
        return None
    return given_layup(result, np.array(printed.angles_deg, dtype=float))


def _figures(result: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None) -> Figures:
    from cpam_bayes.report.stacking.figures import sequence_figures

    return sequence_figures(result, mixture, given)


def _files(result: StackingPosterior, mixture: StackingMixture, seed: int, directory: Path) -> None:
    from cpam_bayes.report.stacking.data import write_sequence_posterior

    write_sequence_posterior(result, mixture, seed, directory)
