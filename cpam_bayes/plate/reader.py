"""Opening plate files, whatever the path turns out to be."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from cpam_bayes.arguments import checked
from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.parse import parse_specimen, specimen_of
from cpam_bayes.plate.problems import received
from cpam_bayes.plate.records import Specimen
from cpam_bayes.plate.regular_file import MAX_BYTES, read_regular_file
from cpam_bayes.plate.specimens import builtin, builtin_names

__all__ = ["MAX_BYTES", "PlateLike", "builtin_plates", "read_plate", "read_specimen"]

PlateLike: TypeAlias = str | os.PathLike[str] | Mapping[str, Any] | Specimen
"""What a plate can be given as, see `read_plate`."""


@checked
def read_plate(plate: PlateLike) -> Specimen:
    """Read a plate file, its content, or a built-in specimen.

    Parameters
    ----------
    plate : the name of a built-in specimen, the path of a plate file, or a mapping with the sections of
        one (the keys and units of the file; tuples and numpy arrays are lists); a `Specimen` is returned as
        it is

    Raises
    ------
    PlateFileError
        With all problems of the plate at once.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> plate = cb.read_plate("C1")
    >>> plate.plate.layup.text, plate.unknowns.names
    ('[(0/90)_8]_s', ('E1', 'E2', 'nu12', 'G12'))
    """
    if isinstance(plate, Specimen):
        return plate
    if isinstance(plate, Mapping):
        return specimen_of(_as_of_a_file(plate), str(plate.get("name", "plate")), None, {})
    return read_specimen(os.fspath(plate))


def _as_of_a_file(value: Any) -> Any:
    """What Python or numpy hold, as TOML has it: tables, lists and single values."""
    if isinstance(value, Mapping):
        return {key: _as_of_a_file(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return [_as_of_a_file(inner) for inner in value] if isinstance(value, list | tuple) else value


def builtin_plates() -> tuple[Specimen, ...]:
    """The specimens of the paper, as `read_plate` gives each by its name.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> [plate.name for plate in cb.builtin_plates()][:5]
    ['D&G', 'A1', 'A2', 'B1', 'B2']
    """
    return tuple(builtin(name) for name in builtin_names())


def read_specimen(path_or_name: str) -> Specimen:
    """Read a plate file, or take a built-in specimen by its name.

    A file that has the name of a built-in specimen is reached as "./NAME". Raises ``PlateFileError`` with
    all problems of the file at once.
    """
    if path_or_name in builtin_names():
        return builtin(path_or_name)
    source = path_or_name if path_or_name.isprintable() and path_or_name else received(path_or_name)
    text = _read_text(path_or_name, source)
    return parse_specimen(text, source, Path(path_or_name).parent)


def _read_text(path: str, source: str) -> str:
    try:
        content = read_regular_file(path, source, "a plate file or a built-in specimen")
    except FileNotFoundError:
        raise PlateFileError(_unknown_name(path, source)) from None
    if b"\0" in content:
        raise PlateFileError(f"{source}: a binary file, accepted: a TOML text")
    try:
        return content.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise PlateFileError(
            f"{source}:{line}: file: not UTF-8 text, received byte 0x{content[error.start]:02x}, "
            "accepted: a TOML text in UTF-8"
        ) from None


def _unknown_name(name: str, source: str) -> str:
    names = builtin_names()
    folded = {known.casefold(): known for known in names}
    close = difflib.get_close_matches(name.casefold(), folded, n=3, cutoff=0.5)
    nearest = [folded[match] for match in close]
    hint = f"the nearest built-in: {' '.join(nearest)}" if nearest else f"built in: {' '.join(names)}"
    return f"{source}: neither a file nor a built-in specimen, {hint}"
