"""`cpam-bayes predict POSTERIOR PLATE`: frequencies of another plate from a stored posterior."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands.options import Commands, add_command, add_modes, add_plate, whole

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "predict", "frequencies of another plate from a stored posterior")
    command.add_argument(
        "posterior",
        metavar="POSTERIOR",
        help="posterior.nc of `identify --backend emcee --out DIR`, of a plate of the same material",
    )
    add_plate(command)
    add_modes(command)
    command.add_argument(
        "--draws",
        type=whole(2, 20_000),
        default=1000,
        metavar="N",
        help="draws of the posterior at most, 2 to 20000 (default: 1000)",
    )


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.prediction.predict import predict
    from cpam_bayes.report.progress import Terminal

    return partial(
        predict,
        args.posterior,
        args.plate,
        args.modes,
        draws=args.draws,
        seed=args.seed,
        watch=Terminal(args.quiet),
    )
