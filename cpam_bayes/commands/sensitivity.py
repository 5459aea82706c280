"""`cpam-bayes sensitivity PLATE`: perturbed frequencies inverted again and again, beside one posterior."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from cpam_bayes.repetition.perturbation import INTERPRETATIONS
from cpam_bayes.repetition.sensitivity import SensitivityResult, sensitivity
from cpam_bayes.report.progress import Terminal


def prepare(args: argparse.Namespace) -> Callable[[], SensitivityResult]:
    """Return the work."""
    return partial(
        sensitivity,
        args.plate,
        seed=args.seed,
        levels=tuple(dict.fromkeys(percent / 100.0 for percent in args.levels)),
        groups=args.groups,
        readings=INTERPRETATIONS if args.reading == "both" else (args.reading,),
        source=args.list,
        n_modes=args.modes,
        executor=args.executor,
        workers=args.workers,
        watch=Terminal(args.quiet),
    )
