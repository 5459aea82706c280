"""Evidence by nested sampling with dynesty, an estimator independent of the package's own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.scores import NormalScores
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

# Stands for log 0, which dynesty does not accept.
_NOTHING = -1e300


@single_blas_thread
def nested_of_scores(
    log_likelihood: Callable[[Array], Array],
    scores: NormalScores,
    n: int,
    rng: np.random.Generator,
    *,
    live_points: int = 200,
    batch: int = 32,
) -> tuple[float, float]:
    """Log evidence by nested sampling, and its error, of a likelihood of stacks of parameters (m, n).

    The unit cube is the prior: z = Phi^-1(u), as scores are standard normal. Points above a likelihood are
    drawn along random directions.
    """
    import dynesty

    def batched(z: Array) -> Array:
        values = log_likelihood(scores.to_x(z))
        return np.where(np.isfinite(values), values, _NOTHING)

    lockstep = Lockstep(batched, batch)
    sampler = dynesty.NestedSampler(
        lockstep.value,
        ndtri,
        n,
        nlive=live_points,
        sample="rslice",
        pool=lockstep,
        queue_size=batch,
        rstate=rng,
    )
    sampler.run_nested(dlogz=0.01, print_progress=False)
    return float(sampler.results.logz[-1]), float(sampler.results.logzerr[-1])


def nested_of_density(
    density: CorrelatedDensity, rng: np.random.Generator, *, live_points: int = 200
) -> tuple[float, float]:
    """Log evidence of a density over normal scores, and its error, by nested sampling."""
    return nested_of_scores(
        density.log_likelihood, density.scores, density.parameters.size, rng, live_points=live_points
    )


class Lockstep:
    """A pool for dynesty whose tasks run as threads that wait for one another before values are computed.

    Each task asks for one value after another. When all running tasks have asked, the points are evaluated as
    one stack, in the order of the tasks, so that the answers do not depend on the scheduling of threads.
    """

    def __init__(self, batched: Callable[[Array], Array], size: int) -> None:
        self.batched, self.size = batched, size
        self.local = threading.local()
        self.turn = threading.Lock()
        self.gates: list[threading.Lock] = []  # one a task, opened by its answer
        self.questions: dict[int, Array] = {}
        self.answers: dict[int, float | Exception] = {}
        self.running = 0

    def value(self, point: Array) -> float:
        """The value at one point (n,), requested by a task or outside of any."""
        task = getattr(self.local, "task", None)
        if task is None:
            return float(self.batched(point[None])[0])
        with self.turn:
            self.questions[task] = point
            self._answer_if_all_asked()
        self.gates[task].acquire()
        answer = self.answers.pop(task)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def map(self, function: Callable[[Any], Any], arguments: Iterable[Any]) -> list[Any]:
        """Results of the function for all arguments, in their order."""
        every = list(arguments)
        results: list[Any] = []
        for first in range(0, len(every), self.size):
            results += self._together(function, every[first : first + self.size])
        return results

    def _together(self, function: Callable[[Any], Any], arguments: list[Any]) -> list[Any]:
        results: list[Any] = [None] * len(arguments)
        failures: list[BaseException] = []

        def run(task: int) -> None:
            self.local.task = task
            try:
                results[task] = function(arguments[task])
            except BaseException as failure:  # noqa: BLE001 - raised again below, in the caller's thread
                failures.append(failure)
            finally:
                with self.turn:
                    self.running -= 1
                    self._answer_if_all_asked()

        self.running = len(arguments)
        self.gates = [threading.Lock() for _ in arguments]
        for gate in self.gates:
            gate.acquire()
        threads = [threading.Thread(target=run, args=(i,)) for i in range(len(arguments))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if failures:
            raise failures[0]
        return results

    def _answer_if_all_asked(self) -> None:
        if self.questions and len(self.questions) == self.running:
            tasks = sorted(self.questions)
            try:
                values: list[Any] = self.batched(np.stack([self.questions[t] for t in tasks])).tolist()
            except Exception as failure:  # noqa: BLE001 - raised again by every task that waits
                values = [failure] * len(tasks)
            self.answers.update(zip(tasks, values, strict=True))
            self.questions.clear()
            for task in tasks:
                self.gates[task].release()
