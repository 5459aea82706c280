"""`cpam-bayes identify PLATE`: constants from the measured frequencies."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from cpam_bayes.commands import BACKENDS, load
from cpam_bayes.forward_model.preconditions import require_paired_list, require_supported
from cpam_bayes.plate import read_specimen
from cpam_bayes.report.answer import Answer

_NO_MESH = (
    "identify computes rectangular plates only; leave mesh out, or compute this plate's frequencies "
    "from its reference constants: forward --solver fem"
)
# Options that a back end has no use for.
_FOREIGN = {
    "pso": ("steps", "store", "likelihood", "noise"),
    "emcee": ("residuals", "particles", "iterations"),
}


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plate and load the back end; return the work."""
    specimen = require_supported(read_specimen(args.plate), _NO_MESH, angles=args.backend == "pso")
    foreign = [name for name in _FOREIGN[args.backend] if getattr(args, name) is not None]
    if foreign:
        raise ValueError(f"--{foreign[0]}: not an option of the back end {args.backend}; leave it out")
    if args.store is not None:
        _require_directory(args.store)
    if args.backend == "pso":
        require_paired_list(specimen)
    return partial(load(BACKENDS[args.backend]), specimen, args)


def _require_directory(store: str) -> None:
    """Refuse a store that cannot be one, before any work."""
    if not store:
        raise ValueError("--store: received an empty name, accepted: a directory")
    if Path(store).exists() and not Path(store).is_dir():
        raise ValueError(f"--store {store}: a file, accepted: a directory")
