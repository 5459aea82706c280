"""`cpam-bayes plates`: the built-in specimens."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from cpam_bayes.plate import builtin, builtin_names
from cpam_bayes.report.answer import Answer
from cpam_bayes.report.plates import plates_document, plates_screen


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Return the work: reading the specimens."""
    return _answer


def _answer() -> Answer:
    specimens = tuple(builtin(name) for name in builtin_names())
    return Answer("plates", plates_document(specimens), plates_screen(specimens))
