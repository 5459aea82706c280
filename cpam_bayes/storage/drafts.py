"""Drafts: files and directories that are not finished, beside the place where they will stand.

The name of a draft says whose it is. A process that is killed leaves its drafts behind; the next one that
makes a draft in that directory sweeps them.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from io import BufferedRandom
from pathlib import Path
from typing import Final

__all__ = ["draft_directory", "draft_file", "put_in_place", "replaceable", "sweep"]

_PREFIX: Final = ".cpam-bayes-"
_OWNER: Final = re.compile(rf"{re.escape(_PREFIX)}(?P<machine>[0-9a-f]{{8}})-(?P<process>[0-9]{{1,10}})-")
# Age at which a draft is swept whose owner is on another machine, or not known, s.
_ABANDONED_SECONDS: Final = 86_400.0


@contextmanager
def draft_directory(parent: Path | None = None) -> Iterator[Path]:
    """A directory to write in, removed at the end; parent : by default that of temporary files.

    Raises ``OSError`` where it cannot be made.
    """
    place = Path(tempfile.gettempdir()) if parent is None else parent
    _sweep_once(place)
    draft = Path(tempfile.mkdtemp(prefix=_own_prefix(), dir=place))
    try:
        yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)


@contextmanager
def draft_file(parent: Path | None = None) -> Iterator[tuple[Path, BufferedRandom]]:
    """A file to write to and read from, open; removed at the end unless it was renamed.

    parent : by default that of temporary files.

    Raises ``OSError`` where it cannot be made.
    """
    place = Path(tempfile.gettempdir()) if parent is None else parent
    _sweep_once(place)
    handle, name = tempfile.mkstemp(prefix=_own_prefix(), dir=place)
    draft = Path(name)
    try:
        with os.fdopen(handle, "w+b") as file:
            yield draft, file
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def replaceable(path: Path) -> bool:
    """Whether a file may be put there: nothing is, or a regular file, which no link stands for."""
    return not os.path.lexists(path) or (path.is_file() and not path.is_symlink())


def put_in_place(draft: Path, path: Path) -> None:
    """Rename a finished draft; raise ``OSError`` where that fails or would replace anything but a file."""
    if not replaceable(path):
        raise FileExistsError(errno.EEXIST, "a directory, link, pipe or device is in its place", str(path))
    draft.replace(path)


def sweep(directory: Path) -> None:
    """Remove the drafts of processes that ended, and those of other machines that are a day old."""
    with suppress(OSError), os.scandir(directory) as entries:
        for entry in entries:
            if entry.name.startswith(_PREFIX):
                with suppress(OSError):
                    if _is_abandoned(entry):
                        _remove(entry)


def _is_abandoned(entry: os.DirEntry[str]) -> bool:
    status = entry.stat(follow_symlinks=False)
    if status.st_uid != os.geteuid():
        return False
    owner = _OWNER.match(entry.name)
    if owner is not None and owner["machine"] == _machine():
        return not _is_running(int(owner["process"]))
    return time.time() - status.st_mtime > _ABANDONED_SECONDS


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # of another user
        return True
    return True


def _remove(entry: os.DirEntry[str]) -> None:
    if entry.is_dir(follow_symlinks=False):
        shutil.rmtree(entry.path, ignore_errors=True)
    else:
        os.unlink(entry.path)


@cache
def _sweep_once(directory: Path) -> None:
    sweep(directory)


@cache
def _machine() -> str:
    """What process numbers belong to: a host, and there the container."""
    space = Path("/proc/self/ns/pid")
    name = f"{socket.gethostname()} {os.readlink(space) if space.is_symlink() else ''}"
    return hashlib.sha256(name.encode()).hexdigest()[:8]


def _own_prefix() -> str:
    return f"{_PREFIX}{_machine()}-{os.getpid()}-"
