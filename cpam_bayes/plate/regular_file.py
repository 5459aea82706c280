"""Reading a small regular file, whatever its path turns out to be."""

from __future__ import annotations

import os
import stat
from typing import Final

from cpam_bayes.errors import PlateFileError

__all__ = ["MAX_BYTES", "read_regular_file"]

MAX_BYTES: Final = 250_000


def read_regular_file(path: str, source: str, accepted: str) -> bytes:
    """The content of a file of at most ``MAX_BYTES``.

    source : how messages name the file
    accepted : what it should have been, for messages
    raises FileNotFoundError where there is none, PlateFileError where it cannot be read
    """
    try:
        _require_small_file(os.stat(path), source, accepted)
        # Not blocking, and checked again: the path may have become a pipe in between.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with os.fdopen(handle, "rb") as file:
            _require_small_file(os.fstat(file.fileno()), source, accepted)
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as error:
        if isinstance(error, PlateFileError):
            raise
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise PlateFileError(f"{source}: cannot be read: {reason}") from None
    if len(content) > MAX_BYTES:
        raise PlateFileError(_too_large(source, "more"))
    return content


def _require_small_file(status: os.stat_result, source: str, accepted: str) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise PlateFileError(f"{source}: a directory, accepted: {accepted}")
    if not stat.S_ISREG(status.st_mode):
        raise PlateFileError(f"{source}: a pipe or device, accepted: a regular file")
    if status.st_size > MAX_BYTES:
        raise PlateFileError(_too_large(source, f"{status.st_size} bytes"))


def _too_large(source: str, size: str) -> str:
    return f"{source}: too large, received {size}, accepted: up to {MAX_BYTES} bytes"
