"""`cpam-bayes report PLATE --out DIR`: constants, stacking sequences and diagnosis on one page."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands.options import Commands, add_command, add_executor_options, add_plate, add_time_limit

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    what = "constants, stacking sequences where angles are unknown, and diagnosis on one page"
    command = add_command(commands, "report", what, out=None)
    add_plate(command)
    command.add_argument(
        "--out", metavar="DIR", required=True, help="write report.html, result files and figures to DIR"
    )
    command.add_argument(
        "--quick",
        action="store_true",
        help="leave out what is slow: emcee, the enumeration of stacking sequences, the ranking of further "
        "tests",
    )
    add_executor_options(command)
    add_time_limit(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.combined import full_report
    from cpam_bayes.report.progress import Terminal

    return partial(
        full_report,
        args.plate,
        seed=args.seed,
        quick=args.quick,
        executor=args.executor or "processes",
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
