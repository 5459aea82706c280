"""A plate file to begin with: the question `new`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

from cpam_bayes.arguments import checked
from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model.preconditions import require_choice
from cpam_bayes.plate.parse import parse_specimen
from cpam_bayes.plate.template import MATERIALS, KnownPlate, plate_file_text
from cpam_bayes.result import Result
from cpam_bayes.storage import draft_directory, put_in_place, replaceable

# How a message says that a file lacks something.
_LACKING: Final = (": missing", "received neither", "received none,")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class NewPlateResult(Result):
    """A plate file that was written; missing : what it still needs, a sentence each."""

    question: ClassVar[str] = "new"
    command: ClassVar[str] = "new"
    has_figures: ClassVar[bool] = False

    path: Path
    text: str
    missing: tuple[str, ...]


@checked
def new(
    path: str | Path,
    *,
    size_mm: Sequence[float] | None = None,
    mass_g: float | None = None,
    layup: str | None = None,
    edges: str | None = None,
    material: str = "carbon",
    frequencies_hz: Sequence[float] = (),
    table: str | None = None,
) -> NewPlateResult:
    """Write a commented plate file; a file that is there is never written over.

    Parameters
    ----------
    path : the file to write; the plate has its name
    size_mm : length, width and thickness
    mass_g : of the bare plate
    layup, edges : as in a plate file
    material : a name in `MATERIALS`, whose typical constants and bounds it begins with
    frequencies_hz, table : measured frequencies, or a table of modes in their place

    Raises
    ------
    ValueError
        If the file is there or cannot be written, or what is given contradicts itself.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as directory:
    ...     file = cb.new(f"{directory}/panel.toml", size_mm=(310, 228, 3.1), material="metal", edges="FFFF")
    >>> [problem.partition(", ")[0] for problem in file.missing]
    ['plate: density', 'measurement: frequencies']
    """
    target = require_new(path)
    text, missing = plate_text(
        target,
        size_mm=size_mm,
        mass_g=mass_g,
        layup=layup,
        edges=edges,
        material=material,
        frequencies_hz=frequencies_hz,
        table=table,
    )
    try:
        with draft_directory(target.parent) as draft:
            written = draft / "file"
            written.write_text(text, encoding="utf-8", newline="\n")
            put_in_place(written, target)
    except OSError as error:
        raise ValueError(f"{target}: cannot be written to: {error.strerror}") from None
    return NewPlateResult(seed=0, path=target, text=text, missing=missing)


def require_new(path: str | Path) -> Path:
    """The path of a file that can be written and is not there yet; raise ``ValueError`` for any other."""
    target = Path(path)
    if not target.name:
        raise ValueError(f"FILE: received {str(path)!r}, accepted: the file to write")
    if target.exists() or not replaceable(target):
        raise ValueError(f"{target}: exists; give another name")
    return target


def plate_text(
    path: str | Path,
    *,
    size_mm: Sequence[float] | None = None,
    mass_g: float | None = None,
    layup: str | None = None,
    edges: str | None = None,
    material: str = "carbon",
    frequencies_hz: Sequence[float] = (),
    table: str | None = None,
) -> tuple[str, tuple[str, ...]]:
    """The text of a new plate file, and what it lacks, a sentence each; arguments and errors as `new`."""
    require_choice("material", material, tuple(MATERIALS))
    size = None if size_mm is None else tuple(size_mm)
    if size is not None and len(size) != 3:
        raise ValueError(f"size: received {len(size)} numbers, accepted: length, width and thickness in mm")
    target = Path(path)
    known = KnownPlate(target.stem, size, mass_g, layup, edges, material, tuple(frequencies_hz), table)
    text = plate_file_text(known)
    return text, _missing(text, target)


def _missing(text: str, path: Path) -> tuple[str, ...]:
    """What the file lacks; raise ``PlateFileError`` for anything else that is wrong with what was given."""
    try:
        parse_specimen(text, path.name, path.parent)
    except PlateFileError as error:
        problems = [problem.partition(": ")[2] for problem in error.problems]
        lacking = [p for p in problems if any(words in p for words in _LACKING)]
        if len(lacking) < len(problems):
            raise PlateFileError(*(p for p in problems if p not in lacking)) from None
        return tuple(lacking)
    return ()
