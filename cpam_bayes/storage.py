"""Atomic files: drafts, sealed files, arrays in them, and the cache directory.

A draft is written beside the finished file, under a name that identifies its owner; drafts of killed
processes are removed by the next process that makes one there. A sealed file is content behind a checksum,
written to a draft, flushed to disk and renamed; one that is damaged, foreign or in another file's place is
never used, but set aside. Several processes may write to one directory at once.
"""

from __future__ import annotations

import errno
import hashlib
import hmac
import io
import logging
import os
import re
import shutil
import socket
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from io import BufferedRandom
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_PREFIX: Final = ".cpam-bayes-"
_OWNER: Final = re.compile(rf"{re.escape(_PREFIX)}(?P<machine>[0-9a-f]{{8}})-(?P<process>[0-9]{{1,10}})-")
# Age at which a draft is removed whose owner is unknown or on another machine, s.
_ABANDONED_SECONDS: Final = 86_400.0


@contextmanager
def draft_directory(parent: Path | None = None) -> Iterator[Path]:
    """A temporary directory, removed at the end; parent : by default the system's temporary directory.

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
    """An open temporary file to read and write; removed at the end unless it was renamed.

    parent : by default the system's temporary directory.

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
    """Whether a file may be put there: the path is free, or a regular file and no link."""
    return not os.path.lexists(path) or (path.is_file() and not path.is_symlink())


def put_in_place(draft: Path, path: Path) -> None:
    """Rename a finished draft; raise ``OSError`` where that fails or would replace anything but a file."""
    if not replaceable(path):
        raise FileExistsError(errno.EEXIST, "a directory, link, pipe or device is in its place", str(path))
    draft.replace(path)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file atomically; raise ``OSError`` where that fails."""
    with draft_directory(path.parent) as folder:
        draft = folder / "file"
        draft.write_bytes(content)
        put_in_place(draft, path)


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
    # Windows has no user numbers, and signal 0 would there interrupt the process: age alone decides.
    user = getattr(os, "geteuid", None)
    if user is not None and status.st_uid != user():
        return False
    owner = _OWNER.match(entry.name)
    if user is not None and owner is not None and owner["machine"] == _machine():
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
    """Hash of the scope of process numbers: the host and its container."""
    space = Path("/proc/self/ns/pid")
    name = f"{socket.gethostname()} {os.readlink(space) if space.is_symlink() else ''}"
    return hashlib.sha256(name.encode()).hexdigest()[:8]


def _own_prefix() -> str:
    return f"{_PREFIX}{_machine()}-{os.getpid()}-"


DAMAGED: Final = ".damaged"
"""Suffix of a file that was set aside."""
_HEAD: Final = b"cpam-bayes sealed 1 "
_LOG: Final = logging.getLogger(__name__)


def seal_of(name: str, *content: bytes | memoryview) -> str:
    """SHA-256 of the name of a file and its content, in hexadecimal digits."""
    digest = hashlib.sha256(name.encode(errors="surrogateescape") + b"\n")
    for part in content:
        digest.update(part)
    return digest.hexdigest()


def write_sealed(path: Path, content: bytes | memoryview) -> None:
    """Write a sealed file atomically; raise ``OSError`` where that fails."""
    with draft_file(path.parent) as (draft, file):
        file.write(_HEAD + seal_of(path.name, content).encode() + b"\n")
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
        file.close()  # Windows renames no open file
        put_in_place(draft, path)
    _flush_directory(path.parent)


def read_sealed(path: Path) -> bytes | None:
    """The content of a sealed file; ``None`` if there is none, or if it is damaged and thus set aside.

    Raises ``OSError`` where an existing file cannot be read.
    """
    try:
        with path.open("rb") as file:
            head = file.read(len(_HEAD) + 64 + 1)
            content = file.read()
    except FileNotFoundError:
        return None
    expected = _HEAD + seal_of(path.name, content).encode() + b"\n"
    if not hmac.compare_digest(head, expected):
        set_aside(path)
        return None
    return content


def set_aside(path: Path) -> None:
    """Rename a file that cannot be used, so that it is built anew, and name it in one warning."""
    aside = path.with_name(path.name + DAMAGED)
    try:
        path.replace(aside)
    except FileNotFoundError:  # another process was first
        return
    except OSError as error:
        _LOG.warning("%s is damaged and not used; it cannot be set aside: %s", path, error.strerror)
        return
    _LOG.warning(
        "%s was damaged: it is set aside as %s, and what it held is computed again", path, aside.name
    )


def _flush_directory(directory: Path) -> None:
    """Make a rename durable; some file systems cannot."""
    with suppress(OSError):
        handle = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


Array = NDArray[Any]

ARRAYS: Final = ".arrays"
"""Suffix of files of arrays."""


def write_arrays(path: Path, arrays: Mapping[str, Array]) -> None:
    """Store arrays under their names; raise ``OSError`` where that fails."""
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    write_sealed(path, content.getbuffer())


def read_arrays(path: Path) -> dict[str, Array] | None:
    """The arrays of a file; ``None`` if there is none or it is damaged. Nothing is unpickled.

    Raises ``OSError`` where an existing file cannot be read.
    """
    content = read_sealed(path)
    if content is None:
        return None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except Exception:  # noqa: BLE001 - zipfile and numpy raise many kinds for what another program sealed
        set_aside(path)
        return None


DIRECTORY_VARIABLE: Final = "CPAM_BAYES_CACHE"
# Files of models that earlier versions kept in the cache directory.
_MODEL: Final = re.compile(
    rf"[0-9a-f]{{32}}(-local[0-9]+)?({re.escape(ARRAYS)}|\.npz)({re.escape(DAMAGED)})?"
)


def opened_draws(file: str | os.PathLike[str]) -> Any:
    """The groups of a posterior's file as an ``xarray.DataTree``, in memory; the file is closed.

    Raises ``OSError``, ``ValueError`` and others that the reader of a damaged file raises.
    """
    import xarray  # heavy

    with xarray.open_datatree(os.fspath(file)) as data:
        return data.load()


def cache_directory() -> Path:
    """Default directory of results: $CPAM_BAYES_CACHE, or the user's cache directory of the system."""
    chosen = os.environ.get(DIRECTORY_VARIABLE)
    if chosen:
        return Path(chosen)
    from platformdirs import user_cache_path

    return user_cache_path("cpam_bayes", appauthor=False)


@cache
def name_unused_models() -> None:
    """Warn once, in a process without a parent, of models of earlier versions: their place and size."""
    directory, size = cache_directory(), 0
    with suppress(OSError), os.scandir(directory) as entries:
        size = sum(e.stat(follow_symlinks=False).st_size for e in entries if _MODEL.fullmatch(e.name))
    if size and parent_process() is None:
        mib = size / 2**20
        _LOG.warning(
            "%s holds %.1f MiB of plate models that are not used any more: remove them", directory, mib
        )
