"""`cpam-bayes batch FILES --out DIR`: many plates, one row each."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands.options import Commands, add_command, add_executor_options, add_time_limit

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(
        commands,
        "batch",
        "the constants of many plates, one row each, with limits and a control chart",
        out="write results.csv, results.nc, report.html and figures to DIR",
    )
    command.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="plate files, or built-in specimens; one that fails stops no other",
    )
    command.add_argument(
        "--limit",
        action="append",
        default=[],
        metavar="LIMIT",
        help='such as "E1_GPa >= 115": the probability that each plate meets it; may be given again',
    )
    command.add_argument(
        "--diagnosis", action="store_true", help="ask of each plate what the plate model gets wrong"
    )
    command.add_argument(
        "--hierarchical",
        action="store_true",
        help="the mean constants of the material and their scatter from plate to plate, by emcee",
    )
    command.add_argument(
        "--own-models",
        action="store_true",
        help="compute each plate with its own sizes; left out, plates of one geometry share their models",
    )
    command.add_argument(
        "--store", metavar="DIR", help="keep finished plates in DIR; the same command goes on from there"
    )
    add_executor_options(command)
    add_time_limit(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Read the limits; return the work."""
    from cpam_bayes.batches.batch import batch
    from cpam_bayes.batches.limits import read_limit
    from cpam_bayes.report.progress import Terminal

    for limit in args.limit:
        read_limit(limit)
    return partial(
        batch,
        *args.files,
        limits=args.limit,
        diagnosis=args.diagnosis,
        hierarchical=args.hierarchical,
        share_models=not args.own_models,
        seed=args.seed,
        store=args.store,
        executor=args.executor or "processes",
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
