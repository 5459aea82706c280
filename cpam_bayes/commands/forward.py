"""`cpam-bayes forward PLATE`: natural frequencies and mode shapes from the reference constants."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from cpam_bayes.forward_model.solve import ForwardResult, forward
from cpam_bayes.report.progress import Terminal


def prepare(args: argparse.Namespace) -> Callable[[], ForwardResult]:
    """Return the work."""
    return partial(
        forward,
        args.plate,
        args.modes,
        solver=args.solver,
        element=args.element,
        seed=args.seed,
        watch=Terminal(args.quiet),
    )
