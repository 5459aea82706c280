"""`cpam-bayes diagnose PLATE [PLATE ...]`: what the simulation gets wrong, the cause, the gain."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final

from cpam_bayes.commands.options import Commands, add_command, add_executor_options, add_time_limit, positive

if TYPE_CHECKING:
    from cpam_bayes.result import Result

MAX_SCATTER: Final = 0.5
MAX_PRIOR: Final = 0.99


def add(commands: Commands) -> None:
    """Add the command and its options."""
    what = "what the plate model gets wrong, the cause by its probability, the extended model and its gain"
    command = add_command(commands, "diagnose", what)
    command.add_argument(
        "plates",
        nargs="+",
        metavar="PLATE",
        help="built-in specimens or paths of plate files; several are plates of one material, which share "
        "their constants, or with equal `specimen` one plate under several tests",
    )
    command.add_argument(
        "--scatter",
        type=positive(MAX_SCATTER),
        default=0.02,
        metavar="S",
        help="standard deviation of a constant from plate to plate of one material, relative, above 0, at "
        "most 0.5 (default: 0.02)",
    )
    command.add_argument(
        "--prior-none",
        type=positive(MAX_PRIOR),
        metavar="P",
        help="prior probability that nothing is wrong, above 0, at most 0.99 (default: 0.5)",
    )
    command.add_argument(
        "--next",
        choices=("open", "always", "never"),
        default="open",
        help="when to say which further test would tell most about the cause: while the cause is open, "
        "always, or never (default: open)",
    )
    command.add_argument(
        "--emcee",
        action="store_true",
        help="sample the constants of the extended model by emcee too",
    )
    add_executor_options(command)
    add_time_limit(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.diagnosis.plates import diagnose
    from cpam_bayes.report.progress import Terminal

    return partial(
        diagnose,
        *args.plates,
        seed=args.seed,
        scatter=args.scatter,
        prior_none=args.prior_none,
        next_test=args.next,
        emcee=args.emcee,
        executor=args.executor or "processes",
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
