"""A plate as a file for other programs, a deck or predicted modes: the question `export`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final, Literal

from cpam_bayes.arguments import checked
from cpam_bayes.formatting import file_stem
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.calculix.deck import Deck, Element, plate_deck
from cpam_bayes.forward_model.mode_shapes.universal import (
    UniversalShapes,
    predicted_shapes,
    universal_text,
)
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.forward_model.preconditions import (
    require_choice,
    require_modes,
    require_seed,
    require_supported,
)
from cpam_bayes.forward_model.solve import measured_modes
from cpam_bayes.plate import PlateLike, read_plate
from cpam_bayes.result import PlateResult
from cpam_bayes.storage import draft_directory, put_in_place, replaceable

_NO_MESH: Final = "files are written for rectangular plates only; leave mesh out"
_NO_AIR: Final = "decks hold a plate in vacuum; leave air_density_kg_m3 out"
Format = Literal["ccx", "uff"]
_ENDINGS: Final[dict[Format, str]] = {"ccx": ".inp", "uff": ".unv"}
_TYPE: Final[dict[Element, str]] = {"shell": "S8R", "brick": "C3D20R"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ExportResult(PlateResult):
    """A deck in its file; n_modes : deformation modes that its step asks for."""

    question: ClassVar[str] = "export"
    command: ClassVar[str] = "export"
    has_figures: ClassVar[bool] = False

    path: Path
    element: Element
    n_modes: int
    deck: Deck

    @property
    def n_elements(self) -> int:
        """Elements of the plate, known masses not counted."""
        layers, in_plane, _ = self.deck.mesh.elements.shape
        return int(layers * in_plane)

    @property
    def element_type(self) -> str:
        """The name of the elements in ABAQUS."""
        return _TYPE[self.element]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class UniversalResult(PlateResult):
    """Predicted modes in a universal file."""

    question: ClassVar[str] = "universal"
    command: ClassVar[str] = "export"
    has_figures: ClassVar[bool] = False

    path: Path
    shapes: UniversalShapes


@checked
def export(
    plate: PlateLike,
    path: str | Path | None = None,
    *,
    to: Format = "ccx",
    element: Element | None = None,
    n_modes: int | None = None,
    force: bool = False,
    seed: int = 0,
) -> ExportResult | UniversalResult:
    """Write a plate with its reference constants as a file for other programs.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns
    path : the file to write, by default the name of the plate with the ending ".inp" or ".unv"
    to : "ccx", an input deck for CalculiX and ABAQUS, or "uff", predicted modes as a universal file
        (datasets 15 and 55), at the nodes of measured shapes where there are some
    element : of a deck, "shell" (S8R) or "brick" (C3D20R); "shell" where left out
    n_modes : modes that the deck asks for, or that are written; as many as were measured, or 10, where left
        out
    force : whether to write over a file that is there

    Raises
    ------
    ValueError
        If the plate cannot be read or exported, or the file cannot be written.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     deck = cb.export("A1", f"{directory}/a1.inp")
    >>> deck.n_elements, deck.element_type
    (255, 'S8R')
    """
    require_seed(seed)
    require_modes(n_modes)
    require_choice("to", to, tuple(_ENDINGS))
    if element is not None:
        require_choice("element", element, tuple(_TYPE))
        if to != "ccx":
            raise ValueError(f"--element: received {element}, accepted: with --to ccx only")
    specimen = require_supported(read_plate(plate), _NO_MESH, _NO_AIR if to == "ccx" else None)
    target = _target(plate, path, specimen.name, _ENDINGS[to])
    _require_writable(target, force)
    n = n_modes or measured_modes(specimen)
    if to == "uff":
        shapes = predicted_shapes(specimen, n)
        _write_whole(target, universal_text(specimen.name, shapes))
        return UniversalResult(
            seed=seed, specimen=specimen, air_shifts=air_shifts(specimen), path=target, shapes=shapes
        )
    deck = plate_deck(specimen, reference_constants(specimen), element or "shell", n)
    _write_whole(target, deck.text)
    return ExportResult(
        seed=seed,
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        path=target,
        element=element or "shell",
        n_modes=n,
        deck=deck,
    )


def _target(plate: PlateLike, path: str | Path | None, name: str, ending: str) -> Path:
    """The file to write, which is not the plate file."""
    given = plate if isinstance(plate, str | os.PathLike) else ""
    if path == "":
        raise ValueError("--out: received an empty name, accepted: the file to write")
    target = Path(path or f"{Path(given).stem or file_stem(name)}{ending}")
    if given and target.resolve() == Path(given).resolve():
        raise ValueError(f"--out {target}: the plate file itself; give another name")
    return target


def _require_writable(path: Path, force: bool) -> None:
    """Raise ``ValueError`` where a file cannot be written, or is there and ``force`` is not given."""
    shown = f"--out {path}"
    try:
        if path.is_dir():
            raise ValueError(f"{shown}: a directory, accepted: the file to write")
        if not replaceable(path):
            raise ValueError(f"{shown}: a link, pipe or device, accepted: a regular file or a new name")
        if os.path.lexists(path) and not force:
            raise ValueError(f"{shown}: exists; give another name, or --force to write over it")
        if not path.parent.is_dir():
            raise ValueError(f"{shown}: {path.parent} is no directory")
    except OSError as error:
        raise ValueError(f"{shown}: cannot be written to: {error.strerror}") from None


def _write_whole(path: Path, text: str) -> None:
    """Write a file that is there whole or not at all; raise ``ValueError`` where that fails."""
    try:
        with draft_directory(path.parent) as draft:
            written = draft / "file"
            written.write_text(text, encoding="utf-8", newline="\n")
            put_in_place(written, path)
    except OSError as error:
        raise ValueError(f"--out {path}: cannot be written to: {error.strerror}") from None
