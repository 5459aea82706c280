"""Time and memory of a command of this package in a process of its own with an empty cache."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

# Interval between samples of a process and its workers, s.
_LOOK = 0.1
_PAGE = os.sysconf("SC_PAGE_SIZE") / 2**30 if hasattr(os, "sysconf") else 0.0


@dataclass(frozen=True, slots=True)
class Wait:
    """Cost and outcome of a command.

    Parameters
    ----------
    seconds : float
        Wall clock; the limit if the command was stopped there.
    processor_seconds : float or None
        Of the process and its workers; ``None`` if it was stopped.
    peak_gib : float
        Largest resident memory of the process and its workers together; pages that they share are counted
        once for each.
    exit_status : int or None
        ``None`` if it was stopped at the limit.
    document : dict or None
        Its output with ``--json``.
    """

    seconds: float
    processor_seconds: float | None
    peak_gib: float
    exit_status: int | None
    document: dict[str, Any] | None


def waited(
    module: str, arguments: Sequence[str], tree: Path, limit: float, *, inside: Path | None = None
) -> Wait:
    """Run ``python -m module`` of a tree with an empty cache, for ``limit`` seconds at most.

    inside : working directory, an empty one if ``None``
    """
    with tempfile.TemporaryDirectory() as folder:
        cache, working = (Path(folder) / name for name in ("cache", "working"))
        cache.mkdir()
        working.mkdir()
        environment = {
            **os.environ,
            "PYTHONPATH": str(tree.resolve()),
            "CPAM_BAYES_CACHE": str(cache),
            # files that a stopped command leaves behind go with the folder
            "TMPDIR": folder,
        }
        with (Path(folder) / "printed").open("w+b") as printed:
            start = time.perf_counter()
            process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=inside or working,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            try:
                status, processor, peak = _watched(process, start + limit)
            finally:
                _stop(process)
            seconds = time.perf_counter() - start
            document = _document(printed) if status is not None else None
    return Wait(seconds if status is not None else limit, processor, peak, status, document)


def _watched(process: subprocess.Popen[bytes], end: float) -> tuple[int | None, float | None, float]:
    """Exit status, processor time and largest memory; no status if the time was up."""
    peak = 0.0
    while True:
        found, raw, usage = os.wait4(process.pid, os.WNOHANG)
        if found:
            process.returncode = os.waitstatus_to_exitcode(raw)
            # of the largest process alone: the memory of a process too short for the samples
            largest = usage.ru_maxrss / (2**20 if sys.platform != "darwin" else 2**30)
            return process.returncode, usage.ru_utime + usage.ru_stime, max(peak, largest)
        if time.perf_counter() > end:
            return None, None, peak
        peak = max(peak, sum(map(_resident_gib, _of_session(process.pid))))
        time.sleep(_LOOK)


def _stop(process: subprocess.Popen[bytes]) -> None:
    """Kill what is left of a process and its workers, all in a session of their own."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    if process.returncode is None:
        process.wait()


def _of_session(session: int) -> list[int]:
    """Process ids of a session; the stat file has pid (name) state parent group session ..., see proc(5)."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError, IndexError):
            if int(stat.read_text("utf-8", "replace").rpartition(")")[2].split()[3]) == session:
                found.append(int(stat.parent.name))
    return found


def _resident_gib(pid: int) -> float:
    with suppress(OSError, IndexError):
        return int(Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]) * _PAGE
    return 0.0


def _document(printed: IO[bytes]) -> dict[str, Any] | None:
    printed.seek(0)
    with suppress(ValueError):
        found = json.loads(printed.read())
        return found if isinstance(found, dict) else None
    return None
