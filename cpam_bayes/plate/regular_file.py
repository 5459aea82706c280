"""Reading a small regular file, whatever its path turns out to be."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

from cpam_bayes.errors import PlateFileError
from cpam_bayes.plate.problems import Problem, received
from cpam_bayes.plate.toml_lines import Path as KeyPath

__all__ = ["MAX_BYTES", "read_named_file", "read_regular_file"]

MAX_BYTES: Final = 250_000


def read_regular_file(path: str, source: str, accepted: str, most: int = MAX_BYTES) -> bytes:
    """The content of a file of at most ``most`` bytes.

    source : how messages name the file
    accepted : what it should have been, for messages
    raises FileNotFoundError where there is none, PlateFileError where it cannot be read
    """
    try:
        _require_small_file(os.stat(path), source, accepted, most)
        # Not blocking, and checked again: the path may have become a pipe in between.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(handle, "rb") as file:
            _require_small_file(os.fstat(file.fileno()), source, accepted, most)
            content = file.read(most + 1)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        if isinstance(error, PlateFileError):
            raise
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise PlateFileError(f"{source}: cannot be read: {reason}") from None
    if len(content) > most:
        raise PlateFileError(_too_large(source, "more", most))
    return content


def read_named_file(
    key: KeyPath, name: str, directory: Path | None, accepted: str, most: int = MAX_BYTES
) -> tuple[bytes | None, list[Problem]]:
    """The content of a file that a plate file names under a key, or what is wrong with it.

    directory : where relative paths begin
    accepted, most : as of `read_regular_file`
    """
    path = Path(name) if directory is None else directory / name
    try:
        return read_regular_file(str(path), received(name), accepted, most), []
    except FileNotFoundError:
        what = f"no such file, received {received(name)}, accepted: a path from the plate file"
        return None, [Problem(key, what)]
    except (PlateFileError, ValueError) as error:
        return None, [Problem(key, str(error))]


def _require_small_file(status: os.stat_result, source: str, accepted: str, most: int) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise PlateFileError(f"{source}: a directory, accepted: {accepted}")
    if not stat.S_ISREG(status.st_mode):
        raise PlateFileError(f"{source}: a pipe or device, accepted: a regular file")
    if status.st_size > most:
        raise PlateFileError(_too_large(source, f"{status.st_size} bytes", most))


def _too_large(source: str, size: str, most: int) -> str:
    return f"{source}: too large, received {size}, accepted: up to {most} bytes"
