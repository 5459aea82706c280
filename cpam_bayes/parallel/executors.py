"""Executors: worker processes that are replaced when one dies, or a Dask cluster.

The object that all items share is sent to a worker once: as a message, or by a file of this machine whose
large arrays are memory-mapped, so that all processes share their pages. A process that writes into such an
array gets its own copy of the page.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import pickle
import re
import signal
import socket
import struct
import sys
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, replace
from io import BufferedIOBase
from multiprocessing import active_children, get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar, cast

from cpam_bayes import __version__
from cpam_bayes.running import cores, keep_to_one_core, single_blas_thread
from cpam_bayes.storage import draft_file

# Size of a buffer, bytes, from which it is stored beside the pickle.
_LARGE = 1 << 20
# Most processes that Windows can wait for.
_MOST_WORKERS = 61
# Alignment of buffers, bytes.
_ALIGNED = 64
_NUMBER = struct.Struct("<Q")


def write_shared(value: Any, file: BufferedIOBase) -> None:
    """Write an object: number of large buffers, their sizes, that of the pickle, then pickle and buffers."""
    large: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(value, protocol=5, buffer_callback=lambda buffer: _kept(buffer, large))
    views = [buffer.raw() for buffer in large]
    numbers = [len(views), *(view.nbytes for view in views), len(pickled)]
    file.write(b"".join(map(_NUMBER.pack, numbers)))
    at = _NUMBER.size * len(numbers)
    for part in (memoryview(pickled), *views):
        file.write(b"\0" * (-at % _ALIGNED))
        file.write(part)
        at += -at % _ALIGNED + part.nbytes
    file.flush()


def read_shared(path: Path) -> Any:
    """The object in a file, its large buffers memory-mapped; they outlive the file's name."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if os.name == "posix":
            whole = memoryview(mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY))
        else:  # a mapped file cannot be removed there
            whole = memoryview(bytearray(file.read()))
    n = _NUMBER.unpack_from(whole)[0]
    sizes = [_NUMBER.unpack_from(whole, _NUMBER.size * (1 + i))[0] for i in range(n + 1)]
    at = _NUMBER.size * (n + 2)
    parts = []
    for length in (sizes[-1], *sizes[:-1]):
        at += -at % _ALIGNED
        parts.append(whole[at : at + length])
        at += length
    return pickle.loads(parts[0], buffers=parts[1:])


def copied(value: Any) -> Any:
    """The object restored from its pickle, in this process; raises as pickle does."""
    large: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(value, protocol=5, buffer_callback=lambda buffer: _kept(buffer, large))
    # only one copy of a large array, none in a pickle besides
    return pickle.loads(pickled, buffers=[bytearray(buffer.raw()) for buffer in large])


def _kept(buffer: pickle.PickleBuffer, large: list[pickle.PickleBuffer]) -> bool:
    """Whether a buffer goes into the pickle; if not, it joins the large ones."""
    if buffer.raw().nbytes < _LARGE:
        return True
    large.append(buffer)
    return False


# Most shared objects that a worker keeps: those of two calls of `run` alternating on one cluster.
_MAX_KEPT = 2


@dataclass(frozen=True, slots=True)
class _Restored:
    """A shared object, and the file from which it came, if any."""

    shared: Any
    path: str = ""


_lock = threading.Lock()
_restored: OrderedDict[str, _Restored] = OrderedDict()
_delivered: OrderedDict[str, bytes] = OrderedDict()


@dataclass(frozen=True, slots=True)
class Ticket:
    """A reference to a shared object for a worker.

    digest : SHA-256 of its pickle.
    path : a file that holds the pickle, for workers of this machine.
    pickled : the pickle itself, for a worker that cannot get it otherwise.
    version : of the sender.
    """

    digest: str
    path: str = ""
    pickled: bytes | None = None
    version: str = __version__


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a batch.

    results : of the items before the first that failed.
    error : raised by that one.
    missing : the worker could not get the shared object, nothing was done.
    seconds : spent on the items.
    """

    results: tuple[Any, ...] = ()
    error: Exception | None = None
    missing: bool = False
    seconds: float = 0.0


def digest_of(pickled: bytes) -> str:
    """Digest of a pickle, by which it is named."""
    return hashlib.sha256(pickled).hexdigest()


def digest_of_file(file: BufferedIOBase) -> str:
    """Digest of an open file's content; the file is left at its beginning."""
    file.seek(0)
    digest = hashlib.file_digest(file, "sha256").hexdigest()
    file.seek(0)
    return digest


@contextmanager
def written_ticket(shared: Any) -> Iterator[Ticket]:
    """A ticket for an object in a file, for workers of this machine, as long as it is needed."""
    with draft_file() as (path, file):
        write_shared(shared, file)
        digest = digest_of_file(file)
        file.close()
        yield Ticket(digest, str(path))


def work_through(work: Callable[[Any, Any], Any], ticket: Ticket, items: bytes) -> Outcome:
    """Do the work on a batch; items : a pickled list.

    Raises ``ValueError`` if the sender runs another version of the package.
    """
    if ticket.version != __version__:
        raise ValueError(
            f"the worker on {socket.gethostname()} (process {os.getpid()}) has cpam_bayes {__version__}, "
            f"this process {ticket.version}; install the same version in both places"
        )
    available, shared = shared_of(ticket)
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
    """The error with its traceback as a note, or a plain substitute if it cannot be pickled."""
    note = f"In the worker:\n{''.join(traceback.format_exception(error))}"
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - whatever its own methods raise
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(note)
    return error


def shared_of(ticket: Ticket) -> tuple[bool, Any]:
    """Whether the shared object is available, and the object."""
    # Threads of one process wait for the one that restores it.
    with _lock:
        restored = _restored.get(ticket.digest)
        if restored is None:
            _drop_withdrawn()
            pickled = _delivered.pop(ticket.digest, None) or ticket.pickled
            restored = _from_file(ticket) if pickled is None else _Restored(pickle.loads(pickled))
        if restored is None:
            return False, None
        # of two calls that share the same object, the later one's file is kept longer
        _restored[ticket.digest] = replace(restored, path=ticket.path if restored.path else "")
        _restored.move_to_end(ticket.digest)
        while len(_restored) > _MAX_KEPT:
            _restored.popitem(last=False)
        return True, restored.shared


def _drop_withdrawn() -> None:
    """Drop objects from files that are gone: the calls that shared them have ended."""
    for digest, restored in list(_restored.items()):
        if restored.path and not Path(restored.path).exists():
            del _restored[digest]


def _from_file(ticket: Ticket) -> _Restored | None:
    """The content of the ticket's file, None where this machine has no such file."""
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
    """Store a shared object's pickle in this worker, before the first batch that needs it."""
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
    """Prepare a worker process of a pool: one BLAS thread, ignoring Ctrl-C, and ending with its owner.

    lifeline : the reading end of a pipe that the owner of the pool holds open.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    threading.Thread(target=_leave_at_end_of, args=(lifeline,), daemon=True).start()


def _leave_at_end_of(lifeline: Connection) -> None:
    with suppress(OSError):  # on Windows a closed end is an error
        lifeline.poll(None)
    os._exit(1)


T = TypeVar("T")

PROCESSES, SERIAL = "processes", "serial"
ACCEPTED = (
    f"{PROCESSES}, {SERIAL} or dask://HOST:PORT, the address of a Dask scheduler; with TLS tls://HOST:PORT"
)
_DASK = re.compile(r"(?P<scheme>dask|tls)://(?P<host>[^\s:/\[\]]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})/?")
# Time that a scheduler may take to answer and to have a first worker, s.
PATIENCE = 10.0


class WorkersLostError(RuntimeError):
    """Repeated death of workers over the same work, or all of them out of reach."""


def read_spec(text: str) -> str:
    """The checked name of an executor: `processes`, `serial`, `dask://HOST:PORT`, `tls://HOST:PORT`.

    Raises ``ValueError`` for others.
    """
    if text in (PROCESSES, SERIAL) or _dask_address(text):
        return text
    raise ValueError(f"executor: received {text!r}, accepted: {ACCEPTED}")


def _dask_address(text: str) -> str | None:
    match = _DASK.fullmatch(text)
    if match is None or not 0 < int(match["port"]) < 2**16:
        return None
    scheme = "tls" if match["scheme"] == "tls" else "tcp"
    return f"{scheme}://{match['host']}:{match['port']}"


@contextmanager
def open_executor(
    spec: str | None = None, processes: int | None = None, *, patience: float = PATIENCE
) -> Iterator[Executor | None]:
    """An executor for ``run``, closed at the end; its workers are stopped after an exception.

    spec : ``None`` or "processes": worker processes of this machine, ``processes`` of them or as many as
    there are cores; where there is one core, work in this process. "serial": yields ``None``, for work in
    this process. "dask://host:port": the workers of that cluster, whose scheduler may take ``patience``
    seconds to answer and as many to have a worker. "tls://host:port": the same with TLS, with the
    certificates of Dask's own configuration.

    Raises ``ValueError`` for anything else, a scheduler that does not answer or has no workers, TLS without
    certificates, and workers that have another version of this package or none.
    """
    spec = PROCESSES if spec is None else read_spec(spec)
    if processes is not None and spec != PROCESSES:
        raise ValueError(
            f"number of workers: received {processes} with executor {spec}, accepted: with {PROCESSES} only"
        )
    if processes is not None and processes < 1:
        raise ValueError(f"number of workers: received {processes}, accepted: 1 or more")
    address = _dask_address(spec)
    if address is not None:
        with _connected(spec, address, patience) as executor:
            yield executor
    elif spec == SERIAL or (processes is None and cores() == 1):
        yield None
    else:
        pool = ProcessPool(cores() if processes is None else processes)
        try:
            yield pool
        except BaseException:
            pool.abandon()
            raise
        pool.shutdown()


def workers_of(executor: Executor) -> int:
    """Number of batches that an executor works on at once, the number of cores if it is unknown."""
    if isinstance(executor, (ProcessPool, DaskCluster)):
        return executor.workers
    said = getattr(executor, "_max_workers", None)
    return said if isinstance(said, int) and said > 0 else cores()


class ProcessPool(Executor):
    """A pool of worker processes; after the death of one the next submission restarts all of them."""

    def __init__(self, workers: int) -> None:
        self.workers = min(workers, _MOST_WORKERS) if sys.platform == "win32" else workers
        # The workers hold the other end, and end when this one is closed, for whatever reason.
        self._reader, self._lifeline = get_context("spawn").Pipe(duplex=False)
        self._pool = self._new_pool()
        self._started: set[BaseProcess] = set()
        self._lasting: tuple[list[Any], Ticket] | None = None
        self._files = ExitStack()

    def ticket_of(self, parts: list[Any]) -> Ticket:
        """A ticket for objects, the previous one where they are the same objects; raises as pickle does."""
        if self._lasting is not None:
            known, ticket = self._lasting
            if len(known) == len(parts) and all(a is b for a, b in zip(known, parts, strict=True)):
                return ticket
        self._forget()
        ticket = self._files.enter_context(written_ticket(parts))
        self._lasting = (parts, ticket)
        return ticket

    def _forget(self) -> None:
        self._lasting = None
        self._files.close()

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self.workers, get_context("spawn"), initializer=start_worker, initargs=(self._reader,)
        )

    def start(self, ready: Callable[[], None]) -> None:
        """Start all workers with calls of ``ready``, whose module they import, ahead of other work."""
        for _ in range(self.workers):
            self.submit(ready)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit a call to the workers."""
        # A worker inherits the mask: Ctrl-C does not reach it before it ignores the signal.
        with _interrupt_blocked():
            before = set(active_children())
            try:
                return self._pool.submit(fn, *args, **kwargs)
            except BrokenExecutor:
                self._pool.shutdown()
                self._pool = self._new_pool()
                return self._pool.submit(fn, *args, **kwargs)
            finally:
                self._started |= set(active_children()) - before

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the workers finish, then stop them."""
        self._pool.shutdown(wait, cancel_futures=cancel_futures)
        self._forget()
        if wait:
            self._lifeline.close()
            self._reader.close()

    def abandon(self) -> None:
        """Stop the workers whatever they are doing."""
        # one that is still starting would look for queues that are gone, and report it
        for worker in self._started:
            worker.kill()
        self._lifeline.close()
        self._pool.shutdown(cancel_futures=True)
        self._forget()
        self._reader.close()


@contextmanager
def _interrupt_blocked() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):  # Windows has no masks
        yield
        return
    resource_tracker.ensure_running()  # it would lift the mask
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class DaskCluster(Executor):
    """The workers of a Dask cluster. All methods raise ``WorkersLostError`` once its scheduler is gone."""

    def __init__(self, client: Any, address: str) -> None:
        self._client = client
        self._address = address
        self._calls: Executor = client.get_executor(pure=False)

    @property
    def workers(self) -> int:
        """Number of threads of all workers, which may come and go."""
        threads: dict[str, int] = self._asked(self._client.nthreads)
        return max(1, sum(threads.values()))

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Submit a call to the scheduler."""
        return cast("Future[T]", self._asked(self._calls.submit, fn, *args, **kwargs))

    def pickled(self, value: Any) -> bytes:
        """A pickle that a worker can read without the main module of this process."""
        import cloudpickle

        return bytes(cloudpickle.dumps(value))

    def deliver(self, digest: str, pickled: bytes) -> None:
        """Send a pickle to every worker that lacks it; those that just died are skipped."""
        held: dict[str, bool] = self._asked(self._client.run, has, digest, on_error="ignore")
        lacking = [worker for worker, there in held.items() if not there]
        if lacking:
            self._asked(self._client.run, deliver, digest, pickled, workers=lacking, on_error="ignore")

    def forget(self, digest: str) -> None:
        """Let the workers drop a shared object."""
        with suppress(WorkersLostError):
            self._asked(self._client.run, forget, digest, on_error="ignore")

    def _asked(self, request: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        gone = f"the Dask scheduler at {self._address} is gone; start one with its workers, and try again"
        if self._client.status != "running":
            raise WorkersLostError(gone)
        try:
            return request(*args, **kwargs)
        except OSError as error:
            raise WorkersLostError(f"{gone} ({error})") from error


@contextmanager
def _connected(spec: str, address: str, patience: float) -> Iterator[DaskCluster]:
    try:
        import distributed
    except ImportError as error:
        raise ValueError(
            f"executor: received {spec}, but Dask is not installed; install cpam-bayes[dask]"
        ) from error
    security: Any = distributed.Security
    _require_encryption_as_configured(security(), spec, address)
    connect: Any = distributed.Client
    try:
        client = connect(address, timeout=patience, set_as_default=False)
    except OSError as error:
        raise ValueError(
            f"executor: received {spec}, but no Dask scheduler answers there ({error}); "
            "start one with `dask scheduler`, or check host and port"
        ) from error
    try:
        _require_workers(client, spec, patience)
        yield DaskCluster(client, address)
    finally:
        client.close()


def _require_encryption_as_configured(security: Any, spec: str, address: str) -> None:
    """Raise ``ValueError`` for TLS without certificates, and for no TLS where Dask is set to require it."""
    try:
        configured = security.get_connection_args("client")
    except OSError as error:
        raise ValueError(
            f"executor: received {spec}, but a certificate or key that Dask is set to use cannot be read "
            f"({error}); check distributed.comm.tls in its configuration"
        ) from error
    if address.startswith("tls") and configured["ssl_context"] is None:
        raise ValueError(
            f"executor: received {spec}, but Dask has no certificates; set ca-file, client.cert and "
            "client.key under distributed.comm.tls in its configuration"
        )
    if not address.startswith("tls") and configured["require_encryption"]:
        raise ValueError(
            f"executor: received {spec}, but Dask is set to require encryption; write tls:// for dask://"
        )


def _require_workers(client: Any, spec: str, patience: float) -> None:
    """Raise ``ValueError`` unless there are workers, all with this version of the package."""

    # Nested, so that it is sent by value: a worker may lack the package.
    def version() -> str:
        from cpam_bayes import __version__ as remote

        return str(remote)

    try:
        client.wait_for_workers(1, timeout=patience)
    except TimeoutError as error:
        raise ValueError(
            f"executor: the Dask scheduler {spec} has no workers; start some with `dask worker`"
        ) from error
    for worker, installed in client.run(version, on_error="return").items():
        if installed != __version__:
            what = (
                f"cannot import it ({installed})" if isinstance(installed, Exception) else f"has {installed}"
            )
            raise ValueError(
                f"executor: this process has cpam_bayes {__version__}, but the Dask worker {worker} {what}; "
                "install the same version there"
            )


Observer = Callable[[int, int], None]

_observer: ContextVar[Observer | None] = ContextVar("observer_of_shared_work", default=None)


@contextmanager
def observed(observer: Observer) -> Iterator[None]:
    """Report all work distributed inside to an observer: the number of items done, from 0, and of all."""
    before = _observer.set(observer)
    try:
        yield
    finally:
        _observer.reset(before)


@contextmanager
def reporting(n: int) -> Iterator[Callable[[], None]]:
    """Report ``n`` items; yields a function to call after each. Work that an item distributes is not."""
    observer, done = _observer.get(), 0
    if observer is None:
        yield lambda: None
        return

    def one_done() -> None:
        nonlocal done
        done += 1
        observer(done, n)

    observer(0, n)
    before = _observer.set(None)
    try:
        yield one_done
    finally:
        _observer.reset(before)
