"""Options that several commands have, and how their values are read.

This module is imported for `--help`: it loads nothing beyond the standard library.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Final, TypeAlias

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"

DEFAULT_SEED: Final = 0
MAX_MODES: Final = 100
MAX_WORKERS: Final = 1000
MAX_SECONDS: Final = 1e7
STATUS_TEXT: Final = """\
exit status: 0 done, 1 ran and did not reach its goal, 2 bad input, 130 interrupted.
PLATE is a built-in specimen (`cpam-bayes plates` lists them) or the path of a plate file.
"""


def add_executor_options(parser: argparse.ArgumentParser) -> None:
    """Add `--executor` and `--workers`, for ``open_executor(args.executor, args.workers)``."""
    parser.add_argument(
        "--executor",
        type=_executor,
        metavar="WHERE",
        help="where the work is done: processes of this machine, serial: in this process, or "
        "dask://HOST:PORT: a Dask cluster that is running; the answer is the same (default: processes)",
    )
    parser.add_argument(
        "--workers",
        type=whole(1, MAX_WORKERS),
        metavar="N",
        help=f"number of processes, 1 to {MAX_WORKERS} (default: one a core)",
    )


def add_time_limit(parser: argparse.ArgumentParser) -> None:
    """Add `--time-limit`."""
    parser.add_argument(
        "--time-limit",
        type=positive(MAX_SECONDS, "number of seconds"),
        metavar="S",
        help="end after about S seconds with the best answer so far, which says what is missing; exit status "
        "1 then (default: none)",
    )


def whole(low: int, high: int) -> Callable[[str], int]:
    """What reads a whole number between two bounds; it raises argparse's error for anything else."""

    def read(text: str) -> int:
        # int() also takes "1_000", and a number of a million digits takes it minutes.
        if text.isascii() and text.isdigit() and len(text) < 20 and low <= int(text) <= high:
            return int(text)
        shown = text if len(text) < 40 else f"{text[:40]}..."
        raise argparse.ArgumentTypeError(f"received {shown!r}, accepted: a whole number from {low} to {high}")

    return read


def _executor(text: str) -> str:
    from cpam_bayes.parallel import read_spec

    try:
        return read_spec(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).removeprefix("executor: ")) from error


def add_command(
    commands: Commands,
    name: str,
    what: str,
    out: str | None = "write result files and figures to DIR",
) -> argparse.ArgumentParser:
    """Add a command with the options that all commands have; out : help of `--out DIR`, None for none."""
    parser = commands.add_parser(
        name,
        help=what,
        description=f"{what[0].upper()}{what[1:]}.",
        epilog=STATUS_TEXT,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of the screen")
    parser.add_argument(
        "--seed",
        type=whole(0, 2**63 - 1),
        default=DEFAULT_SEED,
        metavar="N",
        help=f"seed: the same one gives the same answer (default: {DEFAULT_SEED})",
    )
    if out is not None:
        parser.add_argument("--out", metavar="DIR", help=out)
    parser.add_argument(
        "--verbose", action="store_true", help="the statistics and tables behind the answer too"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
    return parser


def add_modes(command: argparse.ArgumentParser) -> None:
    """Add `--modes`."""
    command.add_argument(
        "--modes",
        type=whole(1, MAX_MODES),
        metavar="N",
        help=f"number of modes, 1 to {MAX_MODES} (default: as many as were measured, or 10)",
    )


def add_plate(command: argparse.ArgumentParser) -> None:
    """Add the argument PLATE."""
    command.add_argument("plate", metavar="PLATE", help="built-in specimen or path of a plate file")


def positive(most: float, what: str = "number") -> Callable[[str], float]:
    """What reads a number above 0 and at most ``most``; it raises argparse's error for anything else."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if 0.0 < value <= most:
            return value
        shown = text if len(text) < 40 else f"{text[:40]}..."
        raise argparse.ArgumentTypeError(
            f"received {shown!r}, accepted: a {what} above 0 and at most {most:g}"
        )

    return read
