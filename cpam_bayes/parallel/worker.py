"""What runs in a worker: what all items share is restored once in a process, then batches are worked off."""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import socket
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from io import BufferedIOBase
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cpam_bayes import __version__
from cpam_bayes.parallel.shared_file import read_shared
from cpam_bayes.threads import keep_to_one_core, single_blas_thread

# Shared objects that a worker keeps: those of two calls of `run` that take turns on one cluster.
_MAX_KEPT = 2


@dataclass(frozen=True, slots=True)
class _Restored:
    """A shared object, and the file that it came from, if from one."""

    shared: Any
    path: str = ""


_lock = threading.Lock()
_restored: OrderedDict[str, _Restored] = OrderedDict()
_delivered: OrderedDict[str, bytes] = OrderedDict()


@dataclass(frozen=True, slots=True)
class Ticket:
    """What names the shared object to a worker.

    digest : SHA-256 of its pickle.
    path : a file that holds the pickle, for workers of this machine.
    pickled : the pickle itself, for a worker that has no other way to it.
    version : of the sender.
    """

    digest: str
    path: str = ""
    pickled: bytes | None = None
    version: str = __version__


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a batch.

    results : of the items before the first that failed.
    error : what that one raised.
    missing : the worker has no way to the shared object, nothing was done.
    seconds : spent on the items.
    """

    results: tuple[Any, ...] = ()
    error: Exception | None = None
    missing: bool = False
    seconds: float = 0.0


def digest_of(pickled: bytes) -> str:
    """The name of a pickle."""
    return hashlib.sha256(pickled).hexdigest()


def digest_of_file(file: BufferedIOBase) -> str:
    """The name of the pickle in an open file, which is left at its beginning."""
    file.seek(0)
    digest = hashlib.file_digest(file, "sha256").hexdigest()
    file.seek(0)
    return digest


def work_through(work: Callable[[Any, Any], Any], ticket: Ticket, items: bytes) -> Outcome:
    """Do the work on a batch, ``items`` being a pickled list.

    Raises ``ValueError`` if the sender runs another version of the package.
    """
    if ticket.version != __version__:
        raise ValueError(
            f"the worker on {socket.gethostname()} (process {os.getpid()}) has cpam_bayes {__version__}, "
            f"this process {ticket.version}; install the same version in both places"
        )
    available, shared = _shared(ticket)
    if not available:
        return Outcome(missing=True)
    return _through(work, shared, pickle.loads(items))


# After the shared object was restored: numpy has been loaded by then, and its BLAS with it.
@single_blas_thread
def _through(work: Callable[[Any, Any], Any], shared: Any, items: list[Any]) -> Outcome:
    start = time.perf_counter()
    results: list[Any] = []
    with keep_to_one_core():
        for item in items:
            try:
                results.append(work(shared, item))
            except Exception as error:  # noqa: BLE001 - it is raised again where `run` was called
                return Outcome(tuple(results), _portable(error))
    return Outcome(tuple(results), seconds=time.perf_counter() - start)


def _portable(error: Exception) -> Exception:
    """The error with its traceback as a note, or a plain one in its place if it cannot be pickled."""
    note = f"In the worker:\n{''.join(traceback.format_exception(error))}"
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - whatever its own methods raise
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(note)
    return error


def _shared(ticket: Ticket) -> tuple[bool, Any]:
    """Whether the shared object could be had, and the object."""
    # Threads of one process wait for the one that restores it.
    with _lock:
        restored = _restored.get(ticket.digest)
        if restored is None:
            _drop_withdrawn()
            pickled = _delivered.pop(ticket.digest, None) or ticket.pickled
            restored = _from_file(ticket) if pickled is None else _Restored(pickle.loads(pickled))
        if restored is None:
            return False, None
        # of two calls that share the same the later one's file stays longer
        _restored[ticket.digest] = replace(restored, path=ticket.path if restored.path else "")
        _restored.move_to_end(ticket.digest)
        while len(_restored) > _MAX_KEPT:
            _restored.popitem(last=False)
        return True, restored.shared


def _drop_withdrawn() -> None:
    """Drop what came from files that are gone: the calls that shared it have ended."""
    for digest, restored in list(_restored.items()):
        if restored.path and not Path(restored.path).exists():
            del _restored[digest]


def _from_file(ticket: Ticket) -> _Restored | None:
    """What the ticket's file holds, unless this machine has no such file."""
    if not ticket.path:
        return None
    path = Path(ticket.path)
    try:
        with path.open("rb") as file:
            known = digest_of_file(file) == ticket.digest
        return _Restored(read_shared(path), ticket.path) if known else None
    except OSError:
        return None


def deliver(digest: str, pickled: bytes) -> None:
    """Leave the shared object with this worker, before the first batch that needs it."""
    with _lock:
        if digest not in _restored:
            _delivered[digest] = pickled
        while len(_delivered) > _MAX_KEPT:
            _delivered.popitem(last=False)


def forget(digest: str) -> None:
    """Drop a shared object from this process."""
    with _lock:
        _restored.pop(digest, None)
        _delivered.pop(digest, None)


def has(digest: str) -> bool:
    """Whether this worker has the shared object or its pickle."""
    with _lock:
        return digest in _restored or digest in _delivered


def start_worker(lifeline: Connection) -> None:
    """Prepare a worker process of a pool: one BLAS thread, deaf to Ctrl-C, and gone with its owner.

    lifeline : the reading end of a pipe that the owner of the pool holds open.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    threading.Thread(target=_leave_at_end_of, args=(lifeline,), daemon=True).start()


def _leave_at_end_of(lifeline: Connection) -> None:
    lifeline.poll(None)
    os._exit(1)
