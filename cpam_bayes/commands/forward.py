"""`cpam-bayes forward PLATE`: natural frequencies and mode shapes from the reference constants."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from cpam_bayes.commands import SOLVERS, load
from cpam_bayes.forward_model.preconditions import plate_warnings, require_supported, solver_failure
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.report.answer import Answer, Figures
from cpam_bayes.report.forward.screen import (
    ForwardAnswer,
    forward_document,
    forward_screen,
    forward_warnings,
)
from cpam_bayes.report.progress import announce

_DEFAULT_MODES = 10


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plate and load the solver; return the work."""
    specimen = read_specimen(args.plate)
    name = args.solver or ("ritz" if specimen.plate.mesh is None else "fem")
    advice = f"--solver {name} computes rectangular plates only; use --solver fem"
    no_air = "CalculiX computes plates in vacuum; leave air_density_kg_m3 out, or use --solver ritz or fem"
    require_supported(specimen, None if name == "fem" else advice, no_air if name == "ccx" else None)
    solver = load(SOLVERS[name])
    if args.element is not None:
        if name != "ccx":
            raise ValueError(f"--element: received {args.element}, accepted: with --solver ccx only")
        solver = partial(solver, element=args.element)
    return partial(_answer, specimen, name, solver, args)


def measured_modes(specimen: Specimen) -> int:
    """As many modes as were measured, or 10."""
    return _DEFAULT_MODES if specimen.measurement is None else specimen.measurement.size


def _answer(
    specimen: Specimen,
    name: str,
    solver: Callable[[Specimen, int], ForwardAnswer],
    args: argparse.Namespace,
) -> Answer:
    n_modes = args.modes or measured_modes(specimen)
    announce(f"forward {specimen.name}: {n_modes} modes, solver {name}", args.quiet)
    try:
        result = solver(specimen, n_modes)
    except RigidBodyError as error:
        raise solver_failure(specimen, error) from error
    warnings = (*forward_warnings(result), *plate_warnings(specimen))
    return Answer(
        "forward",
        forward_document(result, args.seed, warnings),
        forward_screen(result, warnings),
        warnings,
        partial(_figures, result),
    )


def _figures(result: ForwardAnswer) -> Figures:
    from cpam_bayes.report.figures import mode_figures

    return mode_figures(result)
