"""`identify --backend pso`: the particle swarm, its progress, and its answer."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeVar

from cpam_bayes.forward_model.preconditions import plate_warnings, solver_failure
from cpam_bayes.identification.angle_search import AngleSearchResult, search_angles
from cpam_bayes.identification.point import Identification, Residual, identify
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.plate import Specimen
from cpam_bayes.report.answer import Answer, Figures
from cpam_bayes.report.documents import identification_document
from cpam_bayes.report.identification.screen import identification_screen
from cpam_bayes.report.identification.words import warnings_of
from cpam_bayes.report.progress import progress

Found = TypeVar("Found")


def identify_by_swarm(specimen: Specimen, args: argparse.Namespace) -> Answer:
    """Identify a specimen with the options of the command line."""
    chosen = {
        name: getattr(args, name) for name in ("particles", "iterations") if getattr(args, name) is not None
    }
    settings = replace(SwarmSettings(), **chosen)
    n = 1 if specimen.measurement is None else specimen.measurement.size
    residual: Residual = args.residuals or "absolute"
    unit, factor = ("%", 100.0) if residual == "relative" else ("Hz", 1.0)

    def described(value: float) -> str:
        return f"rms misfit {factor * math.sqrt(value / n):.4g} {unit}"

    def watched(search: Callable[..., Found], plate: Specimen, title: str) -> Found:
        with progress(title, settings.iterations, args.quiet, described) as shown:
            return search(
                plate,
                args.seed,
                settings=settings,
                residual=residual,
                progress=shown.tick,
                notify=shown.notify,
            )

    found: AngleSearchResult | None = None
    try:
        if specimen.plate.layup.n_unknown:
            found = watched(search_angles, specimen, f"angles of {specimen.name}")
            specimen = found.known
        result = watched(identify, specimen, f"identify {specimen.name}")
    except RigidBodyError as error:
        raise solver_failure(specimen, error) from error
    warnings = (*warnings_of(result, residual), *plate_warnings(specimen))
    return Answer(
        "identify",
        identification_document(result, args.seed, args.backend, residual, warnings, found),
        identification_screen(result, residual, args.seed, warnings, found),
        warnings,
        partial(_figures, result),
    )


def _figures(result: Identification) -> Figures:
    from cpam_bayes.report.figures import identification_figures

    return identification_figures(result)
