"""`cpam-bayes plates`: the built-in specimens."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from cpam_bayes.forward_model.builtin import BuiltinPlates, plates


def prepare(args: argparse.Namespace) -> Callable[[], BuiltinPlates]:
    """Return the work: reading the specimens."""
    del args
    return plates
