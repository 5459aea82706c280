"""`cpam-bayes export PLATE`: the input deck of a plate for CalculiX and ABAQUS."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands import ELEMENTS
from cpam_bayes.commands.options import Commands, add_command, add_modes, add_plate

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "export", "write an input file for CalculiX and ABAQUS", out=None)
    add_plate(command)
    command.add_argument(
        "--to", choices=("ccx",), required=True, help="ccx: CalculiX, and ABAQUS reads it too"
    )
    command.add_argument(
        "--element",
        choices=ELEMENTS,
        default="shell",
        help="shell, 8 nodes (S8R), or brick, 20 nodes, in layers of plies (C3D20R) (default: shell)",
    )
    add_modes(command)
    command.add_argument(
        "--out",
        dest="file",
        metavar="FILE",
        help="the file to write, not a directory as of other commands (default: PLATE.inp, here)",
    )
    command.add_argument("--force", action="store_true", help="write over a file that is there")
    command.set_defaults(out=None)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.forward_model.calculix.export import export

    return partial(
        export,
        args.plate,
        args.file,
        element=args.element,
        n_modes=args.modes,
        force=args.force,
        seed=args.seed,
    )
