"""Functions and records for parallel tests, which worker processes import from here."""

from __future__ import annotations

import fcntl
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.parallel import Lasting
from cpam_bayes.parallel import executors as worker


def append(path: str, text: str) -> None:
    with open(path, "a") as file:
        file.write(f"{text}\n")


def lines(path: Path) -> list[str]:
    return path.read_text().split() if path.exists() else []


@dataclass(frozen=True)
class Counted:
    """A shared object that logs the process each time it is restored."""

    value: Any
    log: str

    def __reduce__(self) -> tuple[Callable[..., Counted], tuple[Any, str]]:
        return _restored, (self.value, self.log)


def _restored(value: Any, log: str) -> Counted:
    append(log, str(os.getpid()))
    return Counted(value, log)


def noisy_norm(matrix: np.ndarray, seed: int) -> float:
    """A number that depends on every bit of a matrix and of a random stream."""
    return float(np.linalg.norm(matrix @ np.random.default_rng(seed).normal(size=matrix.shape[1])))


def item_of(shared: Counted, item: int) -> int:
    return item


def square_or_kill(shared: tuple[int, str], item: int) -> int:
    """Kill the worker in the middle of one item: always, or with a flag file only the first time."""
    place, flag = shared
    if item == place and not (flag and os.path.exists(flag)):
        if flag:
            Path(flag).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


class OddError(Exception):
    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} {second}")


def fail_at(shared: tuple[int, str, str], item: int) -> int:
    """Fail at one item; all later items wait at a gate."""
    place, log, gate = shared
    append(log, str(item))
    if item == place:
        raise LookupError(f"no luck with {item}")
    if item > place:
        with open(gate) as opened:
            fcntl.flock(opened, fcntl.LOCK_SH)
    return item


def fail_oddly(shared: None, item: int) -> int:
    raise OddError("odd", "indeed")


def blas_threads(shared: np.ndarray, item: int) -> int:
    return max(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")


def sums_of_kept(shared: np.ndarray, item: int) -> list[float]:
    return [float(np.sum(found.shared)) for found in worker._restored.values()]


def log_probabilities(shared: tuple[Posterior, Counted, str], seed: int) -> np.ndarray:
    """Log posterior at draws from the prior, then the process id; a flag makes the worker die once."""
    posterior, _, flag = shared
    if flag:
        square_or_kill((5, flag), seed)
    x = posterior.parameters.sample(np.random.default_rng(seed), 50)
    return np.append(posterior.log_prob(x), os.getpid())


def of_lasting(call: tuple[Lasting, int], item: int) -> tuple[Any, int]:
    objects, of_call = call
    return [part.value for part in objects.parts], of_call + item
