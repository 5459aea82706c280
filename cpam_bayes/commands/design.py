"""`cpam-bayes design PLATE`: which specimen and test would determine the constants."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands.options import (
    MAX_MODES,
    Commands,
    add_command,
    add_executor_options,
    add_plate,
    positive,
    whole,
)

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "design", "which specimen and test would determine the constants")
    add_plate(command)
    command.add_argument(
        "--constants",
        nargs="+",
        metavar="NAME",
        help="those that the information is about, such as nu12 (default: all of [unknowns])",
    )
    command.add_argument(
        "--layups",
        nargs="+",
        metavar="LAYUP",
        help='such as "[0_8]" "[0/90]_2s" (default: that of the plate, and usual ones of as many plies)',
    )
    command.add_argument(
        "--ratios",
        nargs="+",
        type=positive(20.0),
        metavar="R",
        help="length over width, at the area of the plate (default: that of the plate, and 0.5 to 2.8)",
    )
    command.add_argument(
        "--thicknesses",
        nargs="+",
        type=positive(1000.0),
        metavar="MM",
        help="thicknesses in mm (default: that of the plate)",
    )
    command.add_argument(
        "--edges", nargs="+", metavar="EDGES", help="such as FFFF CFFF (default: those, and the plate's)"
    )
    command.add_argument(
        "--modes",
        nargs="+",
        type=whole(1, MAX_MODES),
        metavar="N",
        help=f"numbers of the lowest modes in the list, 1 to {MAX_MODES} (default: as many as were measured, "
        "or 10, and 5 and 10 more)",
    )
    command.add_argument(
        "--relative-std",
        type=positive(0.3),
        metavar="S",
        help="repeatability of a frequency, as in a plate file (default: that of the plate file, or 0.005)",
    )
    add_executor_options(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.report.progress import Terminal
    from cpam_bayes.specimen_design.design import design

    return partial(
        design,
        args.plate,
        constants=args.constants,
        layups=args.layups,
        ratios=args.ratios,
        thicknesses_mm=args.thicknesses,
        edges=args.edges,
        modes=args.modes,
        relative_std=args.relative_std,
        seed=args.seed,
        executor=args.executor or "processes",
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
