"""Result files: written beside their place and moved there when all of them are whole."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cpam_bayes.report.answer import Answer
from cpam_bayes.report.documents import json_text

__all__ = ["Stage", "check_writable", "save", "staging", "write_whole"]

_FIGURES = "figures"

# Where the files go in the end, and where they are written first.
Stage = tuple[Path, Path]


@contextmanager
def staging(out: str | None) -> Iterator[Stage | None]:
    """Make the directory and a place to write in, before any work; leave nothing if the work fails.

    Raises ``ValueError`` if `out` cannot be made or written to.
    """
    if out is None:
        yield None
        return
    if not out:
        raise ValueError("--out: received an empty name, accepted: a directory")
    directory = Path(out)
    made = _made(directory)
    draft = _draft(directory, made)
    try:
        yield directory, draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        _remove_empty(made)


def save(answer: Answer, stage: Stage | None) -> None:
    """Write NAME.json, the figures as PNG and SVG, other files; raise ``OSError`` where that fails."""
    if stage is None:
        return
    directory, draft = stage
    figures = answer.figures()
    if figures:
        from cpam_bayes.report.figures import save_figures

        (draft / _FIGURES).mkdir()
        save_figures(figures, draft / _FIGURES)
    answer.files(draft)
    (draft / f"{answer.name}.json").write_text(json_text(answer.document), encoding="utf-8")
    written = sorted(path for path in draft.rglob("*") if path.is_file())
    for path in written:
        target = directory / path.relative_to(draft)
        target.parent.mkdir(exist_ok=True)
        os.replace(path, target)


def check_writable(path: Path, force: bool) -> None:
    """Raise ``ValueError`` where a file cannot be written, or is there and ``force`` is not given."""
    shown = f"--out {path}"
    try:
        if path.is_dir():
            raise ValueError(f"{shown}: a directory, accepted: the file to write")
        if os.path.lexists(path) and not force:
            raise ValueError(f"{shown}: exists; give another name, or --force to write over it")
        if not path.parent.is_dir():
            raise ValueError(f"{shown}: {path.parent} is no directory")
    except OSError as error:
        raise ValueError(f"{shown}: cannot be written to: {error.strerror}") from None


def write_whole(path: Path, text: str) -> None:
    """Write a file that is there whole or not at all; raise ``ValueError`` where that fails."""
    try:
        with tempfile.TemporaryDirectory(prefix=".cpam-bayes-", dir=path.parent) as draft:
            written = Path(draft, "file")
            written.write_text(text, encoding="utf-8", newline="\n")
            os.replace(written, path)
    except OSError as error:
        raise ValueError(f"--out {path}: cannot be written to: {error.strerror}") from None


def _made(directory: Path) -> list[Path]:
    """Make a directory and return the ones that were not there, the innermost first."""
    try:
        missing = [path for path in (directory, *directory.parents) if not os.path.lexists(path)]
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise ValueError(f"--out {directory}: a file, accepted: a directory") from None
    except (OSError, ValueError) as error:
        raise _refused(directory, error) from None
    return missing


def _draft(directory: Path, made: list[Path]) -> Path:
    figures = directory / _FIGURES
    try:
        if figures.exists() and not (figures.is_dir() and os.access(figures, os.W_OK | os.X_OK)):
            raise ValueError(f"--out {directory}: {figures} is no directory to write to")
        return Path(tempfile.mkdtemp(prefix=".cpam-bayes-", dir=directory))
    except OSError as error:
        _remove_empty(made)
        raise _refused(directory, error) from None


def _refused(directory: Path, error: Exception) -> ValueError:
    reason = error.strerror if isinstance(error, OSError) else str(error)
    return ValueError(f"--out {directory}: cannot be written to: {reason}")


def _remove_empty(made: list[Path]) -> None:
    for path in made:
        with suppress(OSError):
            path.rmdir()
