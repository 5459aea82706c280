"""`cpam-bayes poles FILE`: natural frequencies and damping from frequency responses or recorded hits."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final

from cpam_bayes.commands.options import Commands, add_command, positive, whole

if TYPE_CHECKING:
    from cpam_bayes.result import Result

_MOST_HZ: Final = 1e6
_WINDOWS: Final = ("none", "exponential")
_MOST_CHANNELS: Final = 256


def add(commands: Commands) -> None:
    """Add the command and its options."""
    what = "frequency responses or recorded hits to a table of modes"
    command = add_command(
        commands, "poles", what, "write modes.csv, the stability diagram and the page to DIR"
    )
    command.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="universal files with datasets 58, tables of responses (.csv) or hits (.wav); of one test",
    )
    channel = whole(1, _MOST_CHANNELS)
    command.add_argument("--force", type=channel, metavar="N", help=".wav: channel of the force, from 1")
    command.add_argument(
        "--response", type=channel, nargs="+", default=(), metavar="N", help=".wav: channels of the responses"
    )
    command.add_argument(
        "--window",
        choices=_WINDOWS,
        help=".wav: what records are multiplied by; exponential: a decay to 1 %% at their ends, taken "
        "off again",
    )
    command.add_argument(
        "--range",
        type=positive(_MOST_HZ, "frequency"),
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="Hz (default: all but the first lines; of hits up to where the force has fallen to a tenth, of "
        "decays a quarter above the last line that stands above noise)",
    )
    command.add_argument(
        "--order",
        type=whole(10, 200),
        default=60,
        metavar="N",
        help="poles of the largest model (default: 60)",
    )


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.modal_analysis.poles import poles
    from cpam_bayes.report.progress import Terminal

    low, high = args.range or (None, None)
    return partial(
        poles,
        *args.files,
        force=args.force,
        response=tuple(args.response),
        window=args.window,
        low_hz=low,
        high_hz=high,
        order=args.order,
        seed=args.seed,
        watch=Terminal(args.quiet),
    )
