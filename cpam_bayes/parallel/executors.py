"""Where work is done: worker processes that are replaced when one dies, or an existing Dask cluster."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import active_children, get_context, resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar, cast

from cpam_bayes import __version__
from cpam_bayes.parallel.worker import deliver, forget, has, start_worker
from cpam_bayes.threads import cores

T = TypeVar("T")

PROCESSES, SERIAL = "processes", "serial"
ACCEPTED = f"{PROCESSES}, {SERIAL} or dask://HOST:PORT, the address of a Dask scheduler"
_DASK = re.compile(r"dask://(?P<host>[^\s:/\[\]]+|\[[0-9A-Fa-f:.]+\]):(?P<port>[0-9]{1,5})/?")
# Seconds that a scheduler may take to answer and to show its first worker.
PATIENCE = 10.0


class WorkersLostError(RuntimeError):
    """Workers died again and again over the same work, or all are out of reach."""


def read_spec(text: str) -> str:
    """The name of an executor, if it is one: ``processes``, ``serial`` or ``dask://HOST:PORT``.

    Raises ``ValueError`` for others.
    """
    if text in (PROCESSES, SERIAL) or _dask_address(text):
        return text
    raise ValueError(f"executor: received {text!r}, accepted: {ACCEPTED}")


def _dask_address(text: str) -> str | None:
    match = _DASK.fullmatch(text)
    if match is None or not 0 < int(match["port"]) < 2**16:
        return None
    return f"tcp://{match['host']}:{match['port']}"


@contextmanager
def open_executor(
    spec: str | None = None, processes: int | None = None, *, patience: float = PATIENCE
) -> Iterator[Executor | None]:
    """What ``run`` shares work out over, closed at the end; its workers are stopped after an exception.

    spec : ``None`` or "processes": worker processes of this machine, ``processes`` of them or as many as
    there are cores; where there is one core, work in this process. "serial": ``None``, for work in this
    process. "dask://host:port": the workers of that cluster, whose scheduler may take ``patience`` seconds to
    answer and as many to show a worker.

    Raises ``ValueError`` for anything else, a scheduler that does not answer or has no workers, and workers
    that have another version of this package or none.
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
    """Number of batches that an executor works on at once, as far as it says."""
    if isinstance(executor, (ProcessPool, DaskCluster)):
        return executor.workers
    said = getattr(executor, "_max_workers", None)
    return said if isinstance(said, int) and said > 0 else cores()


class ProcessPool(Executor):
    """Worker processes; after the death of one the next submission starts all of them anew."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        # The workers hold the other end, and leave when this one is closed, by whatever death.
        self._reader, self._lifeline = get_context("spawn").Pipe(duplex=False)
        self._pool = self._new_pool()
        self._started: set[BaseProcess] = set()

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(
            self.workers, get_context("spawn"), initializer=start_worker, initargs=(self._reader,)
        )

    def start(self, ready: Callable[[], None]) -> None:
        """Have all workers start and call ``ready``, whose module they import, while others wait for none."""
        for _ in range(self.workers):
            self.submit(ready)

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Hand a call to the workers."""
        # A worker inherits the mask: Ctrl-C does not reach it before it has learnt to ignore it.
        resource_tracker.ensure_running()  # it would lift the mask
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
        if wait:
            self._lifeline.close()
            self._reader.close()

    def abandon(self) -> None:
        """Stop the workers whatever they are doing."""
        # one that is only starting would look for queues that are gone, and say so
        for worker in self._started:
            worker.kill()
        self._lifeline.close()
        self._pool.shutdown(cancel_futures=True)
        self._reader.close()


@contextmanager
def _interrupt_blocked() -> Iterator[None]:
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
        """Hand a call to the scheduler."""
        return cast("Future[T]", self._asked(self._calls.submit, fn, *args, **kwargs))

    def pickled(self, value: Any) -> bytes:
        """A pickle that a worker can read, which has not the main module of this process."""
        import cloudpickle

        return bytes(cloudpickle.dumps(value))

    def deliver(self, digest: str, pickled: bytes) -> None:
        """Leave a pickle with every worker that has not had it; those that just died are passed over."""
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
