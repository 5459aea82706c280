"""Processes of their own for what a page computes, which can be ended at any moment.

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

from cpam_bayes.render.terminal import Clock
from cpam_bayes.running import Described, Progress

Tell: TypeAlias = Callable[..., None]
"""Is told the fraction that is done, negative where not known, what is being done, and shares so far."""


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

    promise = announce

    @contextmanager
    def stage(
        self, title: str, total: int, described: Described | None = None, counted: str = ""
    ) -> Iterator[Progress]:
        """Tell how far one stage is, and how long the rest takes."""
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
            said = ("done", task(*args, tell=lambda *said: pipe.send(("progress", said))))
        except (ValueError, RuntimeError) as error:
            said = ("refused", tuple(getattr(error, "problems", (str(error),))))
        pipe.send(said)


class Worker:
    """One process at most, made when it is first needed.

    patience : seconds for which a task that was given up may go on before its process is ended; a process
        that stays has its models, so that short work is answered sooner after a short wait
    """

    def __init__(self, patience: float = 0.0) -> None:
        self._patience = patience
        self._process: Any = None
        self._pipe: Connection | None = None
        self._turn = asyncio.Lock()
        self._given_up: asyncio.Future[tuple[str, Any]] | None = None

    async def run(self, task: Task, *args: Any, tell: Tell = lambda *said: None) -> Any:
        """The answer of a task, which is given up if this call is cancelled.

        Raises ``RefusedError`` with what the task refused, or that its process was lost.
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
