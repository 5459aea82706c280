"""`cpam-bayes identify PLATE`: constants from the measured frequencies, by swarm or by emcee."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from cpam_bayes.commands import NOISE_SHAPES
from cpam_bayes.identification.identify import PointResult, identify
from cpam_bayes.identification.sampled import SampledResult, sample
from cpam_bayes.inference.chains.ensemble import DEFAULT_SETTINGS, EnsembleSettings
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.report.progress import Terminal

# Options that a back end has no use for.
_FOREIGN = {
    "pso": ("steps", "store", "likelihood", "noise"),
    "emcee": ("residuals", "particles", "iterations"),
}


def prepare(args: argparse.Namespace) -> Callable[[], PointResult | SampledResult]:
    """Check the options of the back end; return the work."""
    foreign = [name for name in _FOREIGN[args.backend] if getattr(args, name) is not None]
    if foreign:
        raise ValueError(f"--{foreign[0]}: not an option of the back end {args.backend}; leave it out")
    watch = Terminal(args.quiet)
    if args.backend == "pso":
        given = {name: getattr(args, name) for name in ("particles", "iterations")}
        settings = SwarmSettings(**{name: value for name, value in given.items() if value is not None})
        return partial(
            identify,
            args.plate,
            seed=args.seed,
            residual=args.residuals or "absolute",
            settings=settings,
            watch=watch,
        )
    if args.store is not None:
        _require_directory(args.store)
    return partial(
        sample,
        args.plate,
        seed=args.seed,
        likelihood=args.likelihood or "relative",
        degrees_of_freedom=NOISE_SHAPES[args.noise or "gaussian"],
        settings=_budget(args.steps),
        store=args.store,
        watch=watch,
    )


def _budget(steps: int | None) -> EnsembleSettings:
    """Settings for so many steps at most; a round is no longer than that."""
    if steps is None:
        return DEFAULT_SETTINGS
    return replace(DEFAULT_SETTINGS, most_steps=steps, round_steps=min(steps, DEFAULT_SETTINGS.round_steps))


def _require_directory(store: str) -> None:
    """Refuse a store that cannot be one, before any work."""
    if not store:
        raise ValueError("--store: received an empty name, accepted: a directory")
    if Path(store).exists() and not Path(store).is_dir():
        raise ValueError(f"--store {store}: a file, accepted: a directory")
