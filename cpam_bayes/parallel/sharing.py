"""Distribution of work: items go to workers in batches and their results come back in order."""

from __future__ import annotations

import math
import pickle
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from itertools import count
from typing import Any, TypeVar, cast

from cpam_bayes.parallel.executors import (
    DaskCluster,
    Outcome,
    ProcessPool,
    Ticket,
    WorkersLostError,
    copied,
    digest_of,
    forget,
    open_executor,
    reporting,
    shared_of,
    work_through,
    workers_of,
    written_ticket,
)
from cpam_bayes.running import TimeIsUpError, is_time_up, single_blas_thread, time_is_up_error, time_limit

T = TypeVar("T")
Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

# Most times that a batch may be lost with its worker.
_MAX_LOSSES = 3
# Target duration of a batch, s: long compared with the cost of sending it, short for a user.
_BATCH_SECONDS = 0.5
# Largest growth factor from one batch to the next.
_GROWTH = 8
# Interval at which work that is limited in time checks the clock, s.
_LOOK_SECONDS = 1.0
# Batches handed out per worker: one in work and one waiting.
_AHEAD = 2


class Lasting:
    """Objects shared by several calls of `run`, sent to worker processes once for all calls."""

    def __init__(self, parts: list[Any] | None, ticket: Ticket | None = None) -> None:
        self._parts, self._ticket = parts, ticket

    @property
    def parts(self) -> list[Any]:
        """The objects; in a worker, its own copies."""
        if self._parts is None:
            assert self._ticket is not None
            _, self._parts = shared_of(self._ticket)
        return cast("list[Any]", self._parts)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle only the ticket, where there is one."""
        return Lasting, (None if self._ticket else self._parts, self._ticket)


def lasting(parts: list[Any], executor: Executor | None) -> Lasting:
    """Objects for calls on an executor, which must not change; raises as pickle does.

    Processes of this machine are not sent objects again that the previous call shared too.
    """
    return Lasting(parts, executor.ticket_of(parts) if isinstance(executor, ProcessPool) else None)


@dataclass(frozen=True, slots=True)
class _Batch:
    """Items start to stop; losses with a dead worker, and misses of the shared object."""

    start: int
    stop: int
    losses: int = 0
    misses: int = 0


@single_blas_thread
def run(
    work: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Sequence[Item],
    executor: Executor | None = None,
    *,
    batch_size: int | None = None,
    on_result: Callable[[int, Result], None] | None = None,
    is_limited: bool = False,
) -> list[Result]:
    """Results of ``work(shared, item)``, in the order of the items.

    If items carry their own seeds, results are bit for bit the same whatever the executor, the number of
    its workers and the batches: the work sees copies of ``shared`` and of the items restored from pickles,
    in this process too if they can be pickled.

    shared : sent once to each worker.
    executor : ``None`` for this process.
    batch_size : items sent at a time, by default as many as take half a second.
    on_result : called in this process with index and result as results arrive, in any order.
    is_limited : whether a time limit ends the work between two items, by ``TimeIsUpError``. An item in work
    is completed, and its result is reported.

    Batches lost with a worker are repeated by others. Raises what ``work`` or ``on_result`` raised,
    with the item's index as a note, ``WorkersLostError`` if a batch was lost four times, and
    ``ValueError`` for a batch size below 1 or workers with another version of this package; batches
    not done are then cancelled.
    """
    if batch_size is not None and batch_size < 1:
        raise ValueError(f"batch_size: received {batch_size}, accepted: 1 or more")
    if not len(items):
        return []
    with reporting(len(items)) as one_done:

        def tell(index: int, result: Result) -> None:
            one_done()
            if on_result is not None:
                on_result(index, result)

        if executor is None:
            return _run_here(work, shared, items, tell, is_limited)
        return _run_there(work, shared, items, executor, batch_size, tell, is_limited)


def counted(progress: Callable[[int, int], None], total: int) -> Callable[[int, Any], None]:
    """An ``on_result`` that calls ``progress`` with the number of items done and ``total``."""
    numbers = count(1)
    return lambda index, result: progress(next(numbers), total)


def _run_here(
    work: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Sequence[Item],
    tell: Callable[[int, Result], None],
    is_limited: bool,
) -> list[Result]:
    shared = _copied(shared)
    results: list[Result] = []
    for index, item in enumerate(items):
        if is_limited and is_time_up():
            raise _time_is_up(index, len(items))
        try:
            with time_limit(None):  # as in a worker
                result = work(shared, _copied(item))
        except Exception as error:
            error.add_note(_place(index, len(items)))
            raise
        results.append(result)
        tell(index, result)
    return results


def _copied(value: T) -> T:
    """The value as a worker would get it; itself if it cannot be sent."""
    try:
        return cast(T, copied(value))
    except (pickle.PicklingError, AttributeError, TypeError):
        return value


def _place(index: int, n: int) -> str:
    return f"It was raised by the work on item {index} of {n} (counted from 0)."


def _run_there(
    work: Callable[[Shared, Item], Result],
    shared: Shared,
    items: Sequence[Item],
    executor: Executor,
    batch_size: int | None,
    tell: Callable[[int, Result], None],
    is_limited: bool,
) -> list[Result]:
    dumps: Callable[[Any], bytes] = executor.pickled if isinstance(executor, DaskCluster) else pickle.dumps
    pickled = cache(lambda: dumps(shared))
    queue = _Queue(len(items), batch_size)
    results: dict[int, Result] = {}
    pending: dict[Future[Outcome], _Batch] = {}
    with ExitStack() as stack:
        ticket = stack.enter_context(_issued(shared, executor))
        # Workers of a cluster that lack the shared object get it again; any others get it with the batch.
        patience = 1 if isinstance(executor, DaskCluster) else 0
        stack.push(_cancel_on_exception(pending))
        while True:
            late = is_limited and len(results) < len(items) and is_time_up()
            if late:
                for future in [future for future in pending if future.cancel()]:
                    del pending[future]
                if not pending:
                    raise _time_is_up(len(results), len(items))
            workers = workers_of(executor)
            most = 0 if late else workers if is_limited else _AHEAD * workers
            while len(pending) < most and (batch := queue.take(workers, pending.values())):
                packed = dumps([items[i] for i in range(batch.start, batch.stop)])
                sent = replace(ticket, pickled=pickled()) if batch.misses > patience else ticket
                try:
                    pending[executor.submit(work_through, work, sent, packed)] = batch
                except BrokenExecutor as error:
                    queue.lost(batch, error)
                    executor = _usable(executor, stack)
            if not pending:
                return [results[i] for i in range(len(items))]
            done, _ = wait(pending, _LOOK_SECONDS if is_limited else None, return_when=FIRST_COMPLETED)
            for future in sorted(done, key=lambda f: pending[f].start):
                batch = pending.pop(future)
                failure = CancelledError("cancelled") if future.cancelled() else future.exception()
                if failure is not None:
                    if not _is_loss(failure):
                        failure.add_note(
                            f"It was raised while sending items {batch.start} to {batch.stop - 1}."
                        )
                        raise failure
                    queue.lost(batch, failure)
                    executor = _usable(executor, stack)
                    continue
                outcome = future.result()
                if outcome.missing:
                    if isinstance(executor, DaskCluster):
                        executor.deliver(ticket.digest, pickled())
                    queue.missed(batch)
                    continue
                for index, result in enumerate(outcome.results, batch.start):
                    results[index] = result
                    tell(index, result)
                if outcome.error is not None:
                    outcome.error.add_note(_place(batch.start + len(outcome.results), len(items)))
                    raise outcome.error
                queue.done(batch, outcome.seconds)


def _time_is_up(done: int, n: int) -> TimeIsUpError:
    return time_is_up_error(f"{done} of {n} parts of the work were done")


class _Queue:
    """Batches still to be handed out."""

    def __init__(self, n: int, batch_size: int | None) -> None:
        self._n, self._next = n, 0
        self._fixed, self._size = batch_size, 1
        self._again: deque[_Batch] = deque()
        self._suspect: deque[_Batch] = deque()

    def take(self, workers: int, out: Collection[_Batch]) -> _Batch | None:
        """The next batch, None if there is none or it must wait for those in work.

        Lost batches come last, and alone after a second loss, so that none is blamed for another.
        """
        if self._next < self._n:
            per_worker = math.ceil((self._n - self._next) / (_AHEAD * workers))
            start = self._next
            self._next = min(self._n, start + (self._fixed or min(self._size, per_worker)))
            return _Batch(start, self._next)
        if self._again:
            return self._again.popleft()
        return self._suspect.popleft() if self._suspect and not out else None

    def done(self, batch: _Batch, seconds: float) -> None:
        """Adapt the batch size to the duration of a batch."""
        n = batch.stop - batch.start
        fitting = _BATCH_SECONDS * n / max(seconds, 1e-9)
        self._size = max(1, int(min(fitting, _GROWTH * n)))

    def missed(self, batch: _Batch) -> None:
        """Take back a batch whose worker could not get the shared object."""
        self._again.append(replace(batch, misses=batch.misses + 1))

    def lost(self, batch: _Batch, error: BaseException) -> None:
        """Take back a batch whose worker died, or raise ``WorkersLostError``."""
        if batch.losses == _MAX_LOSSES:
            raise WorkersLostError(
                f"items {batch.start} to {batch.stop - 1} of {self._n} (counted from 0) were lost "
                f"{batch.losses + 1} times because their worker died ({type(error).__name__}: {error}); "
                "they may need more memory than there is: try fewer workers, or the executor serial"
            ) from error
        place = self._suspect if batch.losses else self._again
        place.append(replace(batch, losses=batch.losses + 1))


def _is_loss(error: BaseException) -> bool:
    """Whether an error means that a worker died, not that the work failed.

    Dask's error is recognised by name: Dask need not be installed.
    """
    names = {kind.__name__ for kind in type(error).__mro__}
    return isinstance(error, (BrokenExecutor, CancelledError)) or "KilledWorker" in names


def _usable(executor: Executor, stack: ExitStack) -> Executor:
    """The executor, or new processes in place of a caller's broken pool, which is of no more use."""
    if not isinstance(executor, ProcessPoolExecutor):
        return executor
    opened = stack.enter_context(open_executor(None, workers_of(executor)))
    return executor if opened is None else opened


def _cancel_on_exception(pending: dict[Future[Outcome], _Batch]) -> Callable[..., None]:
    def leave(kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            for future in pending:
                future.cancel()

    return leave


@contextmanager
def _issued(shared: Any, executor: Executor) -> Iterator[Ticket]:
    """A ticket by which workers find a shared object, as long as it is needed."""
    if isinstance(executor, DaskCluster):
        pickled = executor.pickled(shared)
        digest = digest_of(pickled)
        executor.deliver(digest, pickled)
        del pickled
        try:
            yield Ticket(digest)
        finally:
            executor.forget(digest)
        return
    with written_ticket(shared) as ticket:
        try:
            yield ticket
        finally:
            forget(ticket.digest)  # threads of this process restored it here
