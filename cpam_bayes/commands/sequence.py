"""`cpam-bayes sequence PLATE`: the probability of every stacking sequence on the grid."""

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
    command = add_command(commands, "sequence", "the probability of every stacking sequence on the grid")
    command.add_argument(
        "plate",
        metavar="PLATE",
        help='built-in specimen, with the unknown angles of Table 9(b), or path of a plate file with "?" '
        "in its layup",
    )
    command.add_argument(
        "--top",
        type=whole(1, 2000),
        default=100,
        metavar="N",
        help="most probable sequences in the JSON document, 1 to 2000 (default: 100)",
    )
    add_executor_options(command)
    add_time_limit(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.report.progress import Terminal
    from cpam_bayes.stacking.sequence import sequence

    return partial(
        sequence,
        args.plate,
        seed=args.seed,
        top=args.top,
        executor=args.executor or "processes",
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
