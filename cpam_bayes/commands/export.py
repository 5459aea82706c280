"""`cpam-bayes export PLATE`: a plate as a file for other programs."""

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
    command = add_command(
        commands, "export", "write a file for CalculiX and ABAQUS, or for modal software", out=None
    )
    add_plate(command)
    command.add_argument(
        "--to",
        choices=("ccx", "uff"),
        required=True,
        help="ccx: an input file of CalculiX, and ABAQUS reads it too; uff: the predicted modes as a "
        "universal file, datasets 15 and 55",
    )
    command.add_argument(
        "--element",
        choices=ELEMENTS,
        help="ccx: shell, 8 nodes (S8R), or brick, 20 nodes, in layers of plies (C3D20R) (default: shell)",
    )
    add_modes(command)
    command.add_argument(
        "--out",
        dest="file",
        metavar="FILE",
        help="the file to write, not a directory as of other commands (default: PLATE.inp or "
        "PLATE.unv, here)",
    )
    command.add_argument("--force", action="store_true", help="write over a file that is there")
    command.set_defaults(out=None)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.forward_model.export import export

    return partial(
        export,
        args.plate,
        args.file,
        to=args.to,
        element=args.element,
        n_modes=args.modes,
        force=args.force,
        seed=args.seed,
    )
