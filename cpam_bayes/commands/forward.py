"""`cpam-bayes forward PLATE`: natural frequencies and mode shapes from the reference constants."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands import ELEMENTS, SOLVERS
from cpam_bayes.commands.options import Commands, add_command, add_modes, add_plate

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "forward", "natural frequencies from the reference constants")
    add_plate(command)
    command.add_argument(
        "--solver",
        choices=SOLVERS,
        help="ritz; fem: finite elements, which also take [plate] mesh; ccx: the program CalculiX "
        "(default: fem for a plate with a mesh, ritz for the others)",
    )
    command.add_argument(
        "--element",
        choices=ELEMENTS,
        help="ccx: brick, 20 nodes, in layers of plies, or shell, 8 nodes (default: brick)",
    )
    add_modes(command)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.forward_model.solve import forward
    from cpam_bayes.report.progress import Terminal

    return partial(
        forward,
        args.plate,
        args.modes,
        solver=args.solver,
        element=args.element,
        seed=args.seed,
        watch=Terminal(args.quiet),
    )
