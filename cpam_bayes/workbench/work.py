"""Computations of a page in processes of their own, which can be ended at any moment.

A process is kept for the next computation; one that was ended is replaced when it is needed.
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

from cpam_bayes.running import Described, Progress

__all__ = ["Pool", "RefusedError", "Shown", "Task", "Tell", "Worker"]

Tell: TypeAlias = Callable[[float, str], None]
"""Is told the fraction that is done, negative where not known, and what is being done."""


Task: TypeAlias = Callable[..., Any]
"""A function of a module, called in another process with plain data and ``tell``, a `Tell`.

It raises ``ValueError`` for what the user can mend.
"""


class RefusedError(Exception):
    """A computation's problems, one each, for which there is no answer."""

    def __init__(self, *problems: str) -> None:
        super().__init__(*problems)


class Shown:
    """A watch (`cpam_bayes.running`) whose stages are told as fractions."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell

    def announce(self, text: str) -> None:
        """Tell what begins."""
        self._tell(-1.0, text)

    @contextmanager
    def stage(
        self, title: str, total: int, described: Described | None = None, counted: str = ""
    ) -> Iterator[Progress]:
        """Tell how far one stage is."""
        self._tell(0.0, title)
        yield Progress(
            lambda done, value: self._tell(min(done / total, 1.0) if total else -1.0, title),
            lambda text: self._tell(-1.0, text),
        )


def _serve(pipe: Connection) -> None:
    """Compute what comes down the pipe until it is closed."""
    with suppress(AttributeError, OSError):
        os.setsid()  # Ctrl-C at the terminal is for the server, which then ends this process and its children
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            task, args = pipe.recv()
        except (EOFError, OSError):
            return
        try:
            said = ("done", task(*args, tell=lambda done, text: pipe.send(("progress", (done, text)))))
        except (ValueError, RuntimeError) as error:
            said = ("refused", tuple(getattr(error, "problems", (str(error),))))
        pipe.send(said)


class Worker:
    """One process at most, made when it is first needed."""

    def __init__(self) -> None:
        self._process: Any = None
        self._pipe: Connection | None = None
        self._turn = asyncio.Lock()

    async def run(self, task: Task, *args: Any, tell: Tell = lambda done, text: None) -> Any:
        """The answer of a task; ended with its process if this call is cancelled.

        Raises ``RefusedError`` with what the task refused, or that its process was lost.
        """
        async with self._turn:
            try:
                await asyncio.to_thread(self._send, task, args)
                while True:
                    assert self._pipe is not None
                    kind, said = await asyncio.to_thread(self._pipe.recv)
                    if kind == "done":
                        return said
                    if kind == "refused":
                        raise RefusedError(*said)
                    tell(*said)
            except asyncio.CancelledError:
                self.stop()
                raise
            except (EOFError, OSError):
                self.stop()
                raise RefusedError("the computation was lost; change a value to begin again") from None

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
        """End the process and those that it began."""
        process, self._process = self._process, None
        if process is not None and process.is_alive():
            with suppress(OSError, AttributeError):
                if os.getpgid(process.pid) == process.pid:
                    os.killpg(process.pid, signal.SIGKILL)
            process.kill()


class Pool:
    """Workers that long computations of all visits share; one that finds none free waits."""

    def __init__(self, size: int) -> None:
        self._workers = [Worker() for _ in range(size)]
        self._free: asyncio.Queue[Worker] = asyncio.Queue()
        for worker in self._workers:
            self._free.put_nowait(worker)

    @asynccontextmanager
    async def worker(self) -> AsyncIterator[Worker]:
        """A worker that nobody else uses."""
        taken = await self._free.get()
        try:
            yield taken
        finally:
            self._free.put_nowait(taken)

    def stop(self) -> None:
        """End all."""
        for worker in self._workers:
            worker.stop()
