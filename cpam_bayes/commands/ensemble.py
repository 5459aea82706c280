"""`identify --backend emcee`: the ensembles, their progress, and their answer."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

from cpam_bayes.commands import NOISE_SHAPES
from cpam_bayes.forward_model.preconditions import plate_warnings, solver_failure
from cpam_bayes.identification.sampled import SampledIdentification, identify_by_sampling
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS, Diagnostics
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.plate import Specimen
from cpam_bayes.report.answer import Answer, Figures
from cpam_bayes.report.posterior.document import sampled_document
from cpam_bayes.report.posterior.screen import sampled_screen, sampled_warnings
from cpam_bayes.report.progress import progress

NOT_REACHED = 1


def identify_by_ensembles(specimen: Specimen, args: argparse.Namespace) -> Answer:
    """Sample the posterior of a specimen's constants with the options of the command line."""
    steps = args.steps or DEFAULT_SETTINGS.most_steps
    settings = replace(
        DEFAULT_SETTINGS, most_steps=steps, round_steps=min(steps, DEFAULT_SETTINGS.round_steps)
    )
    latest: list[Diagnostics] = []

    def described(r_hat: float) -> str:
        return f"R-hat {r_hat:.4f}, {latest[-1].ess_bulk:.0f} effective samples"

    with progress(f"identify {specimen.name}", settings.most_steps, args.quiet, described) as bar:

        def tell(diagnostics: Diagnostics) -> None:
            latest.append(diagnostics)
            bar.tick(diagnostics.steps, diagnostics.r_hat)

        try:
            result = identify_by_sampling(
                specimen,
                args.seed,
                likelihood=args.likelihood or "relative",
                degrees_of_freedom=NOISE_SHAPES[args.noise or "gaussian"],
                settings=settings,
                store=None if args.store is None else Path(args.store),
                notify=bar.notify,
                progress=tell,
            )
        except RigidBodyError as error:
            raise solver_failure(specimen, error) from error
    warnings = (*sampled_warnings(result), *plate_warnings(specimen))
    reached = result.result.status == "converged" and result.result.not_stored is None
    return Answer(
        "identify",
        sampled_document(result, args.seed, warnings),
        sampled_screen(result, args.seed, warnings),
        warnings,
        partial(_figures, result),
        partial(_files, result, args.seed),
        status=0 if reached else NOT_REACHED,
    )


def _figures(result: SampledIdentification) -> Figures:
    from cpam_bayes.report.posterior.figures import posterior_figures

    return posterior_figures(result)


def _files(result: SampledIdentification, seed: int, directory: Path) -> None:
    from cpam_bayes.report.posterior.data import write_posterior

    write_posterior(result, seed, directory)
