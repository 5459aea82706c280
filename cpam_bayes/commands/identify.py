"""`cpam-bayes identify PLATE`: constants from the measured frequencies, by swarm or by emcee."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cpam_bayes.commands import BACKENDS, NOISE_SHAPES
from cpam_bayes.commands.options import Commands, add_command, add_plate, add_time_limit, whole

if TYPE_CHECKING:
    from cpam_bayes.inference.chains.ensemble import EnsembleSettings
    from cpam_bayes.result import Result

# Options that a back end has no use for.
_FOREIGN = {
    "pso": ("steps", "store", "likelihood", "noise"),
    "emcee": ("residuals", "swarms", "particles", "iterations"),
}


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "identify", "constants from the measured frequencies")
    add_plate(command)
    command.add_argument(
        "--backend",
        choices=BACKENDS,
        default="pso",
        help="pso: the paper's particle swarm; emcee: the posterior, sampled from that swarm on",
    )
    command.add_argument(
        "--residuals",
        choices=("absolute", "relative"),
        help="pso: what the swarm minimises, squares of differences in Hz, eq. (7), or of relative ones "
        "(default: absolute)",
    )
    command.add_argument(
        "--swarms",
        type=whole(1, 1000),
        metavar="N",
        help="pso: swarms at most, until two have found the best optimum, 1 to 1000; 1 is the paper's single "
        "swarm, not polished (default: 12)",
    )
    command.add_argument(
        "--particles",
        type=whole(5, 10_000),
        metavar="N",
        help="pso: particles of a swarm, 5 to 10000 (default: 40)",
    )
    command.add_argument(
        "--iterations",
        type=whole(1, 100_000),
        metavar="N",
        help="pso: budget of a swarm, 1 to 100000 iterations (default: 400)",
    )
    command.add_argument(
        "--steps",
        type=whole(1, 10_000_000),
        metavar="N",
        help="emcee: budget of the chains in steps, used in rounds of 100 (default: 10000)",
    )
    command.add_argument(
        "--store",
        metavar="DIR",
        help="emcee: keep finished rounds in DIR; the same command goes on from there",
    )
    command.add_argument(
        "--likelihood",
        choices=("relative", "absolute"),
        help="emcee: noise in proportion to a frequency, or one standard deviation in Hz for all modes, "
        "which is inferred: eq. (7) (default: relative)",
    )
    command.add_argument(
        "--noise",
        choices=tuple(NOISE_SHAPES),
        help="emcee: gaussian, or student-t with 4 degrees of freedom, which a few bad frequencies do "
        "not sway (default: gaussian)",
    )
    add_time_limit(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Check the options of the back end; return the work."""
    from cpam_bayes.identification.identify import identify
    from cpam_bayes.identification.sampled import sample
    from cpam_bayes.identification.search import MOST_SWARMS
    from cpam_bayes.inference.swarm.settings import SwarmSettings
    from cpam_bayes.report.progress import Terminal

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
            swarms=args.swarms or MOST_SWARMS,
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
    from cpam_bayes.inference.chains.ensemble import DEFAULT_SETTINGS

    if steps is None:
        return DEFAULT_SETTINGS
    return replace(DEFAULT_SETTINGS, most_steps=steps, round_steps=min(steps, DEFAULT_SETTINGS.round_steps))


def _require_directory(store: str) -> None:
    """Refuse a store that cannot be one, before any work."""
    if not store:
        raise ValueError("--store: received an empty name, accepted: a directory")
    if Path(store).exists() and not Path(store).is_dir():
        raise ValueError(f"--store {store}: a file, accepted: a directory")
