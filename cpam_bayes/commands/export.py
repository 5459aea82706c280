"""`cpam-bayes export PLATE`: the input deck of a plate for CalculiX and ABAQUS."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from cpam_bayes.commands.forward import measured_modes
from cpam_bayes.forward_model.calculix import plate_deck
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.forward_model.preconditions import require_supported
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.report.answer import Answer
from cpam_bayes.report.files import check_writable, write_whole
from cpam_bayes.report.forward.deck import WrittenDeck, deck_document, deck_screen

_NO_MESH = "decks are written for rectangular plates only; leave mesh out"
_NO_AIR = "decks hold a plate in vacuum; leave air_density_kg_m3 out"


def prepare(args: argparse.Namespace) -> Callable[[], Answer]:
    """Read the plate and look at the place of the file; return the work."""
    specimen = require_supported(read_specimen(args.plate), _NO_MESH, _NO_AIR)
    if args.file == "":
        raise ValueError("--out: received an empty name, accepted: the file to write")
    path = Path(args.file or f"{Path(args.plate).stem}.inp")
    if path.resolve() == Path(args.plate).resolve():
        raise ValueError(f"--out {path}: the plate file itself; give another name")
    check_writable(path, args.force)
    return partial(_answer, specimen, path, args)


def _answer(specimen: Specimen, path: Path, args: argparse.Namespace) -> Answer:
    n_modes = args.modes or measured_modes(specimen)
    deck = plate_deck(specimen, reference_constants(specimen), args.element, n_modes)
    write_whole(path, deck.text)
    written = WrittenDeck(specimen, path, args.element, n_modes, deck)
    return Answer("export", deck_document(written, args.to, args.seed), deck_screen(written))
