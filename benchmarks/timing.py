"""Timing of several calls side by side: interleaved repetitions, medians and ratios."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Key = TypeVar("Key", bound=Hashable)
Call = Callable[[], Any]

# Shortest repetition, s: a faster call is repeated within it.
_SHORTEST = 0.01
# A call that has used this much time, s, sits out the remaining rounds.
_BUDGET = 3.0


def busy_processes() -> float | None:
    """Number of runnable processes, averaged over one minute; ``None`` if the system does not report it."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


@dataclass(frozen=True, slots=True)
class Ratio:
    """Median and quartiles of the ratio of two times, round by round."""

    median: float
    low: float
    high: float


def interleaved(
    calls: Mapping[Key, Call],
    rounds: int,
    *,
    shortest: float = _SHORTEST,
    budget: float = _BUDGET,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[Key, NDArray[np.float64]]:
    """Seconds of each call in each round, (rounds,), nan where it sat out.

    Each call is made once first, to warm up and to find out how long it takes. The order of the calls
    is reversed from one round to the next, so that a change in the machine's load favours none.
    clock : ``time.process_time`` leaves out the time of other programs, for calls that start none.
    """
    repeats: dict[Key, int] = {}
    spent: dict[Key, float] = {}
    for name, call in calls.items():
        spent[name] = _seconds(call, 1, clock)
        repeats[name] = max(1, int(np.ceil(shortest / max(spent[name], 1e-7))))
    times = {name: np.full(rounds, np.nan) for name in calls}
    for i in range(rounds):
        names = list(calls) if i % 2 == 0 else list(calls)[::-1]
        for name in names:
            if i > 0 and spent[name] > budget:
                continue
            whole = _seconds(calls[name], repeats[name], clock)
            spent[name] += whole
            times[name][i] = whole / repeats[name]
    return times


def ratio(times: NDArray[np.float64], to: NDArray[np.float64]) -> Ratio:
    """Ratio of two series of times over the rounds that both have."""
    both = np.isfinite(times) & np.isfinite(to)
    low, median, high = np.quantile(times[both] / to[both], (0.25, 0.5, 0.75))
    return Ratio(float(median), float(low), float(high))


def _seconds(call: Call, repeats: int, clock: Callable[[], float]) -> float:
    start = clock()
    for _ in range(repeats):
        call()
    return clock() - start
