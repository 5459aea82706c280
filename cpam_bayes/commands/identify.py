"""`cpam-bayes identify PLATE`: constants from the measured frequencies."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from cpam_bayes.commands import BACKENDS, load
from cpam_bayes.commands.supported import require_paired_list, require_supported
from cpam_bayes.measurement import read_specimen
from cpam_bayes.report.answer import Answer

_NO_MESH = (
    "identify computes rectangular plates only; leave mesh out, or compute this plate's frequencies "
    "from its reference constants: forward --solver fem"
)


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plate and load the back end; return the work."""
    specimen = require_supported(read_specimen(args.plate), _NO_MESH)
    if args.backend == "pso":
        require_paired_list(specimen)
    return partial(load(BACKENDS[args.backend]), specimen, args)
