"""Work for workers: functions and records that other processes import from here."""

from __future__ import annotations

import fcntl
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.parallel import Lasting
from cpam_bayes.parallel import executors as worker


def append(path: str, text: str) -> None:
    """Add a line in one piece, whoever else writes."""
    handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(handle, f"{text}\n".encode())
    os.close(handle)


def lines(path: Path) -> list[str]:
    return path.read_text().split() if path.exists() else []


def first_time(path: str) -> bool:
    """Whether nobody has asked this before, in any process."""
    try:
        os.close(os.open(path, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return False
    return True


@dataclass(frozen=True)
class Counted:
    """A shared object that leaves a line with the process each time it is restored."""

    value: Any
    log: str

    def __reduce__(self) -> tuple[Callable[..., Counted], tuple[Any, str]]:
        return _restored, (self.value, self.log)


def _restored(value: Any, log: str) -> Counted:
    append(log, str(os.getpid()))
    return Counted(value, log)


def noisy_norm(matrix: np.ndarray, seed: int) -> float:
    """Something that depends on every bit of a matrix and of a stream of random numbers."""
    return float(np.linalg.norm(matrix @ np.random.default_rng(seed).normal(size=matrix.shape[1])))


def process_of_counted(shared: Counted, item: int) -> tuple[int, int]:
    return item, os.getpid()


def meeting(shared: Counted, item: int) -> tuple[int, int]:
    """Items 0 and 1 wait for each other at a pipe with a name: two workers must take them."""
    if item < 2:
        with open(shared.value, "rw"[item]):
            pass
    return process_of_counted(shared, item)


def square_or_kill_once(flag: str, item: int) -> int:
    """The worker is killed in the middle of item 7, the first time."""
    if item == 7 and first_time(flag):
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


def square_or_kill_always(shared: int, item: int) -> int:
    if item == shared:
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


class OddError(Exception):
    """An error that pickles and cannot be restored."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} {second}")


def fail_at(shared: tuple[int, str], item: int) -> int:
    place, log = shared
    append(log, str(item))
    if item == place:
        raise LookupError(f"no luck with {item}")
    return item


@contextmanager
def held_back(path: Path) -> Iterator[str]:
    """A gate that nobody passes within the block, in any process."""
    with open(path, "w") as gate:
        fcntl.flock(gate, fcntl.LOCK_EX)
        yield str(path)


def fail_at_gate(shared: tuple[int, str, str], item: int) -> int:
    """As ``fail_at``; what comes after the failing item waits at a gate, however late that one is."""
    place, log, gate = shared
    found = fail_at((place, log), item)
    if item > place:
        with open(gate) as opened:
            fcntl.flock(opened, fcntl.LOCK_SH)
    return found


def fail_oddly(shared: None, item: int) -> int:
    raise OddError("odd", "indeed")


def blas_threads(shared: np.ndarray, item: int) -> int:
    return max(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")


def sums_of_kept(shared: np.ndarray, item: int) -> list[float]:
    """The sums of all shared objects that this worker holds."""
    return [float(np.sum(found.shared)) for found in worker._restored.values()]


def draw(shared: None, item: np.random.Generator) -> float:
    return float(item.normal())


def column_sum(shared: np.ndarray, item: np.ndarray) -> np.ndarray:
    return shared @ item


@dataclass(frozen=True)
class Evaluation:
    """A posterior, and a flag if a worker is to be killed in the middle."""

    posterior: Posterior
    counted: Counted
    flag: str = ""


def log_probabilities(shared: Evaluation, seed: int) -> np.ndarray:
    """Log posterior at parameter vectors drawn from the prior, then the process that computed it."""
    if shared.flag and seed == 5 and first_time(shared.flag):
        os.kill(os.getpid(), signal.SIGKILL)
    x = shared.posterior.parameters.sample(np.random.default_rng(seed), 50)
    return np.append(shared.posterior.log_prob(x), os.getpid())


def of_lasting(call: tuple[Lasting, int], item: int) -> tuple[Any, int]:
    """What the call shares, with the item."""
    objects, of_call = call
    return [part.value for part in objects.parts], of_call + item
