"""`cpam-bayes diagnose PLATE [PLATE ...]`: what the simulation gets wrong, the cause, the gain."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from cpam_bayes.diagnosis.plates import DiagnosisResult, diagnose
from cpam_bayes.report.progress import Terminal


def prepare(args: argparse.Namespace) -> Callable[[], DiagnosisResult]:
    """Return the work."""
    return partial(
        diagnose,
        *args.plates,
        seed=args.seed,
        scatter=args.scatter,
        prior_none=args.prior_none,
        next_test=args.next,
        emcee=args.emcee,
        watch=Terminal(args.quiet),
    )
