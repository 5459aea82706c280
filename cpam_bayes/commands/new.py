"""`cpam-bayes new FILE`: a commented plate file to begin with."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands import MATERIALS
from cpam_bayes.commands.options import Commands, add_command, positive

if TYPE_CHECKING:
    from cpam_bayes.result import Result

_LARGEST = 1e9


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "new", "write a commented plate file to begin with", out=None)
    command.add_argument("file", metavar="FILE", help="the plate file to write; never written over")
    number = positive(_LARGEST)
    command.add_argument(
        "--size",
        nargs=3,
        type=number,
        metavar=("LENGTH", "WIDTH", "THICKNESS"),
        help="length (along x), width and thickness, mm",
    )
    command.add_argument("--mass", type=number, metavar="GRAMS", help="mass of the bare plate, g")
    command.add_argument("--layup", metavar="LAYUP", help='ply angles, bottom to top, such as "[0/90]_2s"')
    command.add_argument(
        "--edges", metavar="EDGES", help="FFFF: free; F, S or C for x=0, y=0, x=length, y=width"
    )
    command.add_argument(
        "--material",
        choices=MATERIALS,
        default=MATERIALS[0],
        help=f"whose typical constants and bounds it begins with (default: {MATERIALS[0]})",
    )
    measured = command.add_mutually_exclusive_group()
    measured.add_argument(
        "--frequencies", nargs="+", type=number, default=(), metavar="HZ", help="ascending, Hz"
    )
    measured.add_argument("--table", metavar="TABLE", help="a table of modes, its path from FILE")
    command.set_defaults(out=None)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.forward_model.new_plate import new

    return partial(
        new,
        args.file,
        size_mm=args.size,
        mass_g=args.mass,
        layup=args.layup,
        edges=args.edges,
        material=args.material,
        frequencies_hz=tuple(args.frequencies),
        table=args.table,
    )
