"""`cpam-bayes paper [N]`: the paper's tables beside what this package computes."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands.options import Commands, add_command, add_executor_options, add_time_limit, whole

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "paper", "the paper's tables beside what this package computes")
    command.add_argument(
        "number", metavar="N", nargs="?", type=whole(1, 14), help="one table, 1 to 14 (default: all)"
    )
    command.add_argument(
        "--quick",
        action="store_true",
        help="small swarms, linearised intervals, no Tables 13 and 14: it works, and is not to be quoted",
    )
    command.add_argument(
        "--all",
        action="store_true",
        help="compute anew what was stored, and what comes with the package: posteriors over stacking "
        "sequences and frequencies of CalculiX, which take hours",
    )
    command.add_argument(
        "--store",
        metavar="DIR",
        help="keep finished computations in DIR; the same command goes on from there (default: in the cache)",
    )
    add_executor_options(command)
    add_time_limit(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.comparison.compare import compare
    from cpam_bayes.report.progress import Terminal

    return partial(
        compare,
        args.number,
        quick=args.quick,
        everything=args.all,
        seed=args.seed,
        executor=args.executor or "processes",
        workers=args.workers,
        store=args.store,
        watch=Terminal(args.quiet),
    )
