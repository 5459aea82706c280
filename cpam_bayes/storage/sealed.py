"""Sealed files: content behind a checksum of it, written to a draft, flushed to the disk, renamed.

What stands under its name is whole at whatever moment a run was killed. A file that is damaged, foreign or
in another file's place does not match its seal: it is never used, but set aside under another name.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

from cpam_bayes.storage.drafts import draft_file, put_in_place

__all__ = ["DAMAGED", "read_sealed", "seal_of", "set_aside", "write_sealed"]

DAMAGED: Final = ".damaged"
"""What is added to the name of a file that was set aside."""
_HEAD: Final = b"cpam-bayes sealed 1 "
_LOG: Final = logging.getLogger(__name__)


def seal_of(name: str, *content: bytes | memoryview) -> str:
    """SHA-256 of the name of a file and its content, in hexadecimal digits."""
    digest = hashlib.sha256(name.encode(errors="surrogateescape") + b"\n")
    for part in content:
        digest.update(part)
    return digest.hexdigest()


def write_sealed(path: Path, content: bytes | memoryview) -> None:
    """Put a sealed file in its place, whole; raise ``OSError`` where that fails."""
    with draft_file(path.parent) as (draft, file):
        file.write(_HEAD + seal_of(path.name, content).encode() + b"\n")
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
        put_in_place(draft, path)
    _flush_directory(path.parent)


def read_sealed(path: Path) -> bytes | None:
    """The content of a sealed file; ``None`` if there is none, or none that is whole: it is set aside.

    Raises ``OSError`` where a file that is there cannot be read.
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
    """Make a rename last; some file systems cannot."""
    with suppress(OSError):
        handle = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
