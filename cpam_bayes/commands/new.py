"""`cpam-bayes new FILE`: a commented plate file to begin with."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final

from cpam_bayes.commands import MATERIALS
from cpam_bayes.commands.options import Commands, add_command, positive

if TYPE_CHECKING:
    from cpam_bayes.result import Result

_LARGEST = 1e9
# Option -> the argument of `cpam_bayes.new` that it fills.
_ARGUMENTS: Final = {
    "size": "size_mm",
    "mass": "mass_g",
    "layup": "layup",
    "edges": "edges",
    "material": "material",
    "frequencies": "frequencies_hz",
    "table": "table",
}


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(
        commands,
        "new",
        "write a commented plate file to begin with, by questions at a terminal where no option says more",
        out=None,
    )
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
        help=f"whose typical constants and bounds it begins with (default: {MATERIALS[0]})",
    )
    measured = command.add_mutually_exclusive_group()
    measured.add_argument("--frequencies", nargs="+", type=number, metavar="HZ", help="ascending, Hz")
    measured.add_argument("--table", metavar="TABLE", help="a table of modes, its path from FILE")
    command.set_defaults(out=None)


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work; what is known is asked for where no option says anything of the plate."""
    from cpam_bayes.forward_model.new_plate import new, plate_text, require_new

    given = {name: getattr(args, option) for option, name in _ARGUMENTS.items()}
    given = {name: value for name, value in given.items() if value is not None}
    if not given and not args.json and _at_a_terminal():
        from cpam_bayes.commands.questions import asked

        require_new(args.file)
        given = asked(lambda told: plate_text(args.file, **told))
    return partial(new, args.file, **given)


def _at_a_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty()
