"""`cpam-bayes sensitivity PLATE`: noisy lists inverted again and again, beside one posterior."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from cpam_bayes.commands.forward import measured_modes
from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model.preconditions import require_supported, solver_failure
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.paper import perturbation_table
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.repetition.perturbation import INTERPRETATIONS
from cpam_bayes.repetition.study import model_list, sensitivity
from cpam_bayes.report.answer import Answer, Figures
from cpam_bayes.report.progress import progress
from cpam_bayes.report.repetition.screen import sensitivity_document, sensitivity_screen
from cpam_bayes.report.repetition.words import printed_table, sensitivity_warnings

NOT_CONVERGED = 1

_NO_MESH = "sensitivity computes rectangular plates only; leave mesh out"


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plate and check what the options ask of it; return the work."""
    specimen = require_supported(read_specimen(args.plate), _NO_MESH)
    if not specimen.unknowns.size:
        raise PlateFileError(f"{specimen.source}: [unknowns] is missing, nothing to identify")
    if args.list == "measured":
        _require_list(specimen)
        if args.modes is not None:
            raise ValueError(f"--modes: received {args.modes}, accepted: with --list model only")
    return partial(_answer, specimen, args)


def _require_list(specimen: Specimen) -> None:
    source = specimen.source
    if specimen.measurement is None:
        raise PlateFileError(f"{source}: [measurement] is missing, which --list measured needs")
    if not specimen.measurement.complete:
        raise PlateFileError(
            f"{source}: measurement.complete: received false, --list measured adds noise to a list without "
            "gaps only; use --list model"
        )


def _answer(specimen: Specimen, args: argparse.Namespace) -> Answer:
    readings = INTERPRETATIONS if args.reading == "both" else (args.reading,)
    levels = tuple(dict.fromkeys(percent / 100.0 for percent in args.levels))
    total = len(levels) * len(readings) * (args.groups + 1)

    def described(done: float) -> str:
        return "posteriors first, then inversions" if done < total else "done"

    with (
        progress(f"sensitivity {specimen.name}", total, args.quiet, described) as shown,
        open_executor(args.executor, args.workers) as executor,
    ):
        try:
            if args.list == "model":
                specimen = model_list(specimen, args.modes or measured_modes(specimen), shown.notify)
            result = sensitivity(
                specimen,
                args.seed,
                source=args.list,
                levels=levels,
                groups=args.groups,
                readings=readings,
                executor=executor,
                notify=shown.notify,
                progress=lambda done, _: shown.tick(done, float(done)),
            )
        except RigidBodyError as error:
            raise solver_failure(specimen, error) from error
    table = printed_table(result, perturbation_table(specimen.name))
    warnings = sensitivity_warnings(result)
    document = sensitivity_document(result, args.seed, table, warnings)
    return Answer(
        "sensitivity",
        document,
        sensitivity_screen(result, args.seed, table, warnings),
        warnings,
        partial(_figures, document),
        status=0 if all(cell.posterior.converged for cell in result.cells) else NOT_CONVERGED,
    )


def _figures(document: Mapping[str, Any]) -> Figures:
    from cpam_bayes.report.repetition.figures import sensitivity_figures

    return sensitivity_figures(document)
