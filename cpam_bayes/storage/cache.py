"""The cache of models: a directory of limited size that the model used least recently leaves first.

Several processes may use it at once: files appear and go whole, and one that another process took away is
built again.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from cpam_bayes.storage import arrays
from cpam_bayes.storage.arrays import ARRAYS
from cpam_bayes.storage.drafts import sweep
from cpam_bayes.storage.sealed import DAMAGED

__all__ = [
    "DIRECTORY_VARIABLE",
    "LIMIT_VARIABLE",
    "CacheContent",
    "cache_content",
    "cache_directory",
    "cache_limit",
    "clear_cache",
    "make_room",
    "model_file",
    "read_model",
    "write_model",
]

DIRECTORY_VARIABLE: Final = "CPAM_BAYES_CACHE"
LIMIT_VARIABLE: Final = "CPAM_BAYES_CACHE_GIB"
_DEFAULT_LIMIT_GIB: Final = 4.0
_GIB: Final = 2**30
# Room is made down to this fraction of the limit, so that it is not made at every file.
_KEPT_FRACTION: Final = 0.9
# The files of this package alone, whatever else is in the directory; those of earlier versions end in .npz.
_MODEL: Final = re.compile(
    rf"[0-9a-f]{{32}}(-local[0-9]+)?({re.escape(ARRAYS)}|\.npz)({re.escape(DAMAGED)})?"
)


@dataclass(frozen=True, slots=True)
class CacheContent:
    """Number of files of models, and what they take, bytes."""

    files: int
    size: int


def cache_directory() -> Path:
    """Where models are kept: $CPAM_BAYES_CACHE, or the system's place for the caches of a user."""
    chosen = os.environ.get(DIRECTORY_VARIABLE)
    if chosen:
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("cpam_bayes", appauthor=False)


def cache_limit() -> int:
    """What models may take on disk, bytes: $CPAM_BAYES_CACHE_GIB, or 4 GiB.

    Raises ``ValueError`` where the variable is no number above 0.
    """
    given = os.environ.get(LIMIT_VARIABLE)
    try:
        limit = float(given) if given else _DEFAULT_LIMIT_GIB
    except ValueError:
        limit = math.nan
    if not 0.0 < limit < 1e9:
        raise ValueError(
            f"{LIMIT_VARIABLE}: received {given!r}, accepted: GiB that stored models may take, above 0"
        )
    return int(limit * _GIB)


def model_file(name: str, directory: Path | None = None) -> Path:
    """The file of a model, by default in the cache.

    Raises ``ValueError`` for a limit that is none, before anything is built.
    """
    cache_limit()
    return (directory or cache_directory()) / f"{name}{ARRAYS}"


def read_model(path: Path) -> dict[str, NDArray[Any]] | None:
    """The arrays of a stored model, which is then the one used last; ``None`` if it cannot be had."""
    try:
        stored = arrays.read_arrays(path)
    except OSError:
        return None
    if stored is not None:
        with suppress(OSError):
            os.utime(path)
    return stored


def write_model(path: Path, model: Mapping[str, NDArray[Any]]) -> None:
    """Store the arrays of a model and make room for it; a disk that is full or read-only is no error."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays.write_arrays(path, model)
    make_room(path.parent, cache_limit(), path)


def make_room(directory: Path, limit: int, kept: Path | None = None) -> None:
    """Remove the models used least recently until the rest fits a limit, bytes; kept : not this one."""
    found = _models(directory)
    total = sum(status.st_size for _, status in found)
    if total <= limit:
        return
    for path, status in sorted(found, key=lambda entry: entry[1].st_mtime_ns):
        if total <= _KEPT_FRACTION * limit:
            return
        if path != kept:
            with suppress(OSError):
                path.unlink()
            total -= status.st_size


def cache_content(directory: Path) -> CacheContent:
    """What models take in a directory."""
    found = _models(directory)
    return CacheContent(len(found), sum(status.st_size for _, status in found))


def clear_cache(directory: Path) -> None:
    """Remove all models of a directory and what killed processes left there, nothing else.

    Raises ``OSError`` where a file cannot be removed.
    """
    sweep(directory)
    for path, _ in _models(directory):
        path.unlink(missing_ok=True)


def _models(directory: Path) -> list[tuple[Path, os.stat_result]]:
    found: list[tuple[Path, os.stat_result]] = []
    with suppress(OSError), os.scandir(directory) as entries:
        for entry in entries:
            with suppress(OSError):
                if _MODEL.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                    found.append((Path(entry.path), entry.stat(follow_symlinks=False)))
    return found
