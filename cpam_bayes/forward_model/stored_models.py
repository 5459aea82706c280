"""The models of plates on disk: the question `cache`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from cpam_bayes.arguments import checked
from cpam_bayes.result import Result
from cpam_bayes.storage.cache import (
    CacheContent,
    cache_content,
    cache_directory,
    cache_limit,
    clear_cache,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CacheResult(Result):
    """What the stored models take; removed : what was removed, limit : bytes."""

    question: ClassVar[str] = "cache"
    command: ClassVar[str] = "cache"
    has_figures: ClassVar[bool] = False

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
