"""Worker processes for the computations of a page, which can be ended at any moment.

A process is kept for the next computation; an ended one is replaced when needed.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, TypeAlias

from cpam_bayes.render.terminal import Clock
from cpam_bayes.running import Described, Progress

Tell: TypeAlias = Callable[..., None]
"""Called with the fraction done, negative if unknown, the current activity, and probabilities so far."""


Task: TypeAlias = Callable[..., Any]
"""A module-level function, called in another process with plain data and ``tell``, a `Tell`.

It raises ``ValueError`` for errors that the user can correct.
"""


class RefusedError(Exception):
    """The problems for which a computation has no answer, one argument each."""

    def __init__(self, *problems: str) -> None:
        super().__init__(*problems)


class Shown:
    """A watch (`cpam_bayes.running`) that reports stages as fractions."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell

    def announce(self, text: str) -> None:
        """Report what begins."""
        self._tell(-1.0, text)

    promise = announce

    @contextmanager
    def stage(
        self, title: str, total: int, described: Described | None = None, counted: str = ""
    ) -> Iterator[Progress]:
        """Report the progress of a stage and its remaining time."""
        clock = Clock(total)

        def tick(done: int, value: float) -> None:
            self._tell(min(done / total, 1.0) if total else -1.0, title + clock.left(done))

        tick(0, 0.0)
        yield Progress(
            tick,
            lambda text: self._tell(-1.0, text),
            lambda shares: self._tell(-1.0, title, shares),
        )


def _serve(pipe: Connection) -> None:
    """Run tasks from the pipe until it is closed."""
    with suppress(AttributeError, OSError):
        os.setsid()  # Ctrl-C at the terminal is for the server, which then ends this process and its children
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task, args = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            said = ("done", task(*args, tell=lambda *said: pipe.send(("progress", said))))
        except (ValueError, RuntimeError) as error:
            said = ("refused", tuple(getattr(error, "problems", (str(error),))))
        pipe.send(said)


class Worker:
    """At most one process, started when first needed.

    patience : seconds that an abandoned task may run on before its process is ended; a process that survives
        keeps its models, which speeds up later short tasks
    """

    def __init__(self, patience: float = 0.0) -> None:
        self._patience = patience
        self._process: Any = None
        self._pipe: Connection | None = None
        self._turn = asyncio.Lock()
        self._given_up: asyncio.Future[tuple[str, Any]] | None = None

    async def run(self, task: Task, *args: Any, tell: Tell = lambda *said: None) -> Any:
        """The result of a task, which is abandoned if this call is cancelled.

        Raises ``RefusedError`` with the problems of the task, or if its process was lost.
        """
        async with self._turn:
            while self._given_up is not None:
                await asyncio.wait({self._given_up}, timeout=max(self._patience, 0.05))
                if self._given_up.done():
                    self._given_up = None
                else:
                    self.stop()
            work = asyncio.ensure_future(self._answered(task, args, tell))
            try:
                kind, said = await asyncio.shield(work)
            except asyncio.CancelledError:
                self._given_up = work
                if not self._patience:
                    self.stop()
                raise
        if kind == "refused":
            raise RefusedError(*said)
        return said

    async def _answered(self, task: Task, args: tuple[Any, ...], tell: Tell) -> tuple[str, Any]:
        try:
            await asyncio.to_thread(self._send, task, args)
            while True:
                assert self._pipe is not None
                kind, said = await asyncio.to_thread(self._pipe.recv)
                if kind != "progress":
                    return kind, said
                if self._given_up is None:
                    tell(*said)
        except (EOFError, OSError):
            self.stop()
            return "refused", ("the computation was lost; change a value to begin again",)

    def _send(self, task: Task, args: tuple[Any, ...]) -> None:
        if self._process is None or not self._process.is_alive():
            context = multiprocessing.get_context("spawn")
            self._pipe, theirs = context.Pipe()
            self._process = context.Process(target=_serve, args=(theirs,), name="cpam-bayes app")
            self._process.start()
            theirs.close()
        assert self._pipe is not None
        self._pipe.send((task, args))

    def stop(self) -> None:
        """End the process and its children."""
        process, self._process = self._process, None
        if process is not None and process.is_alive():
            with suppress(OSError, AttributeError):
                if os.getpgid(process.pid) == process.pid:
                    os.killpg(process.pid, signal.SIGKILL)
            process.kill()


class Pool:
    """Workers shared by the long computations of all visits; a caller waits for a free one."""

    def __init__(self, size: int) -> None:
        self._workers = [Worker() for _ in range(size)]
        self._free: asyncio.Queue[Worker] = asyncio.Queue()
        for worker in self._workers:
            self._free.put_nowait(worker)

    @asynccontextmanager
    async def worker(self) -> AsyncIterator[Worker]:
        """A worker for exclusive use."""
        taken = await self._free.get()
        try:
            yield taken
        finally:
            self._free.put_nowait(taken)

    def stop(self) -> None:
        """End all workers."""
        for worker in self._workers:
            worker.stop()
