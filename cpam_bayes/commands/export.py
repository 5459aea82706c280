"""`cpam-bayes export PLATE`: the input deck of a plate for CalculiX and ABAQUS."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from cpam_bayes.forward_model.calculix.export import ExportResult, export


def prepare(args: argparse.Namespace) -> Callable[[], ExportResult]:
    """Return the work."""
    return partial(
        export,
        args.plate,
        args.file,
        element=args.element,
        n_modes=args.modes,
        force=args.force,
        seed=args.seed,
    )
