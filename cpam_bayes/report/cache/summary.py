"""`cache` in plain words."""

from __future__ import annotations

from cpam_bayes.forward_model.stored_models import CacheResult
from cpam_bayes.report.summary import Summary
from cpam_bayes.storage.cache import DIRECTORY_VARIABLE, LIMIT_VARIABLE, CacheContent


def summary(result: CacheResult) -> Summary:
    """How many models are stored, where, and what makes them leave."""
    removed = f"{_text(result.removed)} removed; " if result.removed.files else ""
    return Summary(
        title="cache",
        headline=f"{removed}{_text(result.content)} stored.",
        basis=(
            f"Directory: {result.directory}; the environment variable {DIRECTORY_VARIABLE} names another.",
            f"Limit: {_size(result.limit)}, beyond which the model used least recently is removed; "
            f"{LIMIT_VARIABLE} sets another, in GiB.",
            "A model spares its plate from being solved anew; one that was removed is built again.",
        ),
        next_steps=("Remove all stored models: cpam-bayes cache --clear",) if result.content.files else (),
    )


def _text(content: CacheContent) -> str:
    return f"{content.files} model{'' if content.files == 1 else 's'} of plates ({_size(content.size)})"


def _size(size: int) -> str:
    return f"{size / 2**20:.1f} MiB" if size < 2**30 else f"{size / 2**30:.2f} GiB"
