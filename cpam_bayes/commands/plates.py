"""`cpam-bayes plates`: the built-in specimens."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from cpam_bayes.commands.options import Commands, add_command

if TYPE_CHECKING:
    from cpam_bayes.result import Result


def add(commands: Commands) -> None:
    """Add the command and its options."""
    add_command(commands, "plates", "list the built-in specimens")


def prepare(args: argparse.Namespace) -> Callable[[], Result]:
    """Return the work: reading the specimens."""
    from cpam_bayes.forward_model.builtin import plates

    del args
    return plates
