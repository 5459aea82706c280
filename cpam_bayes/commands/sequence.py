"""`cpam-bayes sequence PLATE`: the probability of every stacking sequence on the grid."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from cpam_bayes.report.progress import Terminal
from cpam_bayes.stacking.sequence import StackingResult, sequence


def prepare(args: argparse.Namespace) -> Callable[[], StackingResult]:
    """Return the work."""
    return partial(
        sequence,
        args.plate,
        seed=args.seed,
        top=args.top,
        executor=args.executor,
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
