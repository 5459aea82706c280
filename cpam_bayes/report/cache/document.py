"""The JSON document of `cache`."""

from __future__ import annotations

from typing import Any

from cpam_bayes import __version__
from cpam_bayes.forward_model.stored_models import CacheResult


def document(result: CacheResult) -> dict[str, Any]:
    """The JSON document of `cache`."""
    return {
        "command": "cache",
        "version": __version__,
        "directory": str(result.directory),
        "files": result.content.files,
        "bytes": result.content.size,
        "limit_bytes": result.limit,
        "removed_files": result.removed.files,
        "removed_bytes": result.removed.size,
    }
