"""The stored models of plates on disk: the question `cache`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Final

from cpam_bayes import __version__
from cpam_bayes.command import Command, option
from cpam_bayes.errors import checked
from cpam_bayes.render.report import Report, Summary
from cpam_bayes.result import Result, present
from cpam_bayes.storage import (
    DIRECTORY_VARIABLE,
    LIMIT_VARIABLE,
    CacheContent,
    cache_content,
    cache_directory,
    cache_limit,
    clear_cache,
)

__all__ = ["CacheResult", "cache"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CacheResult(Result):
    """Models in the store after the call, and those that it removed; limit : bytes."""

    command: ClassVar[str] = "cache"

    directory: Path
    content: CacheContent
    removed: CacheContent
    limit: int


@checked
def cache(*, clear: bool = False) -> CacheResult:
    """Count the models of plates on disk, or remove them.

    Parameters
    ----------
    clear : whether to remove them; they are built again when they are needed

    Raises
    ------
    ValueError
        If the limit in CPAM_BAYES_CACHE_GIB is none, or a model cannot be removed.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> f"{cb.cache().limit / 2**30:.0f} GiB"
    '4 GiB'
    """
    directory, limit = cache_directory(), cache_limit()
    before = cache_content(directory)
    if clear:
        try:
            clear_cache(directory)
        except OSError as error:
            raise ValueError(f"cache {directory}: cannot be cleared: {error.strerror}") from None
    left = cache_content(directory)
    removed = CacheContent(max(before.files - left.files, 0), max(before.size - left.size, 0))
    return CacheResult(seed=0, directory=directory, content=left, removed=removed, limit=limit)


@present.register
def _present(result: CacheResult) -> Report:
    """Number and size of the stored models, their place and their limit."""
    removed = f"{_text(result.removed)} removed; " if result.removed.files else ""
    return Report(
        summary=Summary(
            title="cache",
            headline=f"{removed}{_text(result.content)} stored.",
            lines=(
                f"Directory: {result.directory} ({DIRECTORY_VARIABLE} names another).",
                f"Limit: {_size(result.limit)} ({LIMIT_VARIABLE} sets another, in GiB). Beyond it the model "
                "used least recently is removed.",
            ),
            next_step="remove all stored models: cpam-bayes cache --clear" if result.content.files else "",
        ),
        document={
            "command": result.command,
            "version": __version__,
            "directory": str(result.directory),
            "files": result.content.files,
            "bytes": result.content.size,
            "limit_bytes": result.limit,
            "removed_files": result.removed.files,
            "removed_bytes": result.removed.size,
        },
    )


def _text(content: CacheContent) -> str:
    return f"{content.files} model{'' if content.files == 1 else 's'} of plates ({_size(content.size)})"


def _size(size: int) -> str:
    return f"{size / 2**20:.1f} MiB" if size < 2**30 else f"{size / 2**30:.2f} GiB"


COMMAND: Final = Command(
    cache,
    (
        option(
            "--clear",
            action="store_true",
            help="remove all stored models; they are built again when needed",
        ),
    ),
    watched=False,
    seeded=False,
)
