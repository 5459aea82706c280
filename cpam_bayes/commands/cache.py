"""`cpam-bayes cache`: what the stored models take, and their removal."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from cpam_bayes.commands.options import Commands, add_command

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    command = add_command(commands, "cache", "show what the stored models of plates take, or remove them")
    command.add_argument(
        "--clear", action="store_true", help="remove all stored models; they are built again when needed"
    )


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work."""
    from cpam_bayes.forward_model.stored_models import cache

    return partial(cache, clear=args.clear)
