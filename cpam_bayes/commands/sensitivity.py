"""`cpam-bayes sensitivity PLATE`: perturbed frequencies inverted again and again, beside one posterior."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final

from cpam_bayes.commands.options import (
    Commands,
    add_command,
    add_executor_options,
    add_modes,
    add_plate,
    add_time_limit,
    positive,
    whole,
)

if TYPE_CHECKING:
    from cpam_bayes.result import Result

MAX_NOISE_PERCENT: Final = 50.0


def add(commands: Commands) -> None:
    """Add the command and its options."""
    what = "perturbed frequencies inverted again and again, beside the posterior at that noise"
    command = add_command(commands, "sensitivity", what)
    add_plate(command)
    command.add_argument(
        "--levels",
        type=positive(MAX_NOISE_PERCENT, "percentage"),
        nargs="+",
        default=(1.0, 5.0, 10.0),
        metavar="P",
        help=f"levels of noise in percent, above 0, at most {MAX_NOISE_PERCENT:g} (default: 1 5 10)",
    )
    command.add_argument(
        "--groups",
        type=whole(2, 1000),
        default=10,
        metavar="N",
        help="perturbed frequency lists at each level, 2 to 1000 (default: 10)",
    )
    command.add_argument(
        "--reading",
        choices=("both", "relative", "rms"),
        default="both",
        help="eq. (12) as a fraction of each frequency, or of the root mean square frequency for all modes "
        "(default: both)",
    )
    command.add_argument(
        "--list",
        choices=("model", "measured"),
        default="model",
        help="what noise is added to: the frequencies that the plate model gives at the reference constants, "
        "or the measured ones, as the paper does (default: model)",
    )
    add_modes(command)
    add_executor_options(command)
    add_time_limit(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.repetition.perturbation import INTERPRETATIONS
    from cpam_bayes.repetition.sensitivity import sensitivity
    from cpam_bayes.report.progress import Terminal

    return partial(
        sensitivity,
        args.plate,
        seed=args.seed,
        levels=tuple(dict.fromkeys(percent / 100.0 for percent in args.levels)),
        groups=args.groups,
        readings=INTERPRETATIONS if args.reading == "both" else (args.reading,),
        source=args.list,
        n_modes=args.modes,
        executor=args.executor or "processes",
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
