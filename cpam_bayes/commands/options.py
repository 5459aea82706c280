"""Options that several commands have, and how their values are read.

This module is imported for `--help`: it loads nothing beyond the standard library.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Final

MOST_WORKERS: Final = 1000


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
        type=whole(1, MOST_WORKERS),
        metavar="N",
        help=f"number of processes, 1 to {MOST_WORKERS} (default: one a core)",
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
