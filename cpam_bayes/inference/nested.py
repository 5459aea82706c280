"""Evidence by nested sampling with dynesty: a second estimator that shares nothing with the first."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.expansion import coordinates, log_density
from cpam_bayes.posterior import Posterior
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Bounds that are infinite are cut so many standard deviations of the prior from its mean.
_REACH = 10.0
# Stands for log 0, which dynesty does not take.
_NOTHING = -1e300


@dataclass(frozen=True, slots=True)
class NestedEvidence:
    """What nested sampling says of a posterior.

    standard_error : of log_evidence, by dynesty. mean, sd : (n,) of the parameters, with their standard
    errors mean_error (n,) and sd_error (n,), from simulated shrinkages of the prior volume. calls : of the
    log probability.
    """

    log_evidence: float
    standard_error: float
    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array
    calls: int


@single_blas_thread
def nested_evidence(
    posterior: Posterior, seed: int, *, live_points: int = 500, batch: int = 24, method: str = "rwalk"
) -> NestedEvidence:
    """The evidence of a posterior by static nested sampling (Skilling, 2006; Speagle, 2020).

    The unit cube is the box of the bounds (log-spaced for the amplitude of the noise), the prior's density
    is part of the likelihood. ``batch`` proposals advance side by side, so that the log probability is
    asked for stacks. method : how dynesty draws new points, "rwalk", "unif", "rslice". Needs the
    extra ``audit``.
    """
    import dynesty
    from dynesty.utils import resample_run

    axes = coordinates(posterior)
    parameters = posterior.parameters
    centre = axes.to_u(np.array([p.prior.mean for p in parameters.parameters]))
    lower, upper = np.maximum(axes.lower, centre - _REACH), np.minimum(axes.upper, centre + _REACH)
    lower, upper = (np.where(axes.logged, a, b) for a, b in ((axes.lower, lower), (axes.upper, upper)))
    width = upper - lower

    def batched(u: Array) -> Array:
        found = log_density(posterior, axes, u) + np.log(width).sum()
        return np.where(np.isfinite(found), found, _NOTHING)

    lockstep = Lockstep(batched, batch)
    sampler = dynesty.NestedSampler(
        lockstep.value,
        lambda cube: lower + width * cube,
        parameters.size,
        nlive=live_points,
        sample=method,
        pool=lockstep,
        queue_size=batch,
        rstate=np.random.default_rng([seed, 5]),
    )
    sampler.run_nested(dlogz=0.01, print_progress=False)
    results = sampler.results
    x = axes.to_x(results.samples)
    mean, sd = _moments(x, results.logwt)
    rng = np.random.default_rng([seed, 6])
    again = [resample_run(results, rstate=rng) for _ in range(40)]
    spread = [_moments(axes.to_x(r.samples), r.logwt) for r in again]
    return NestedEvidence(
        log_evidence=float(results.logz[-1]),
        standard_error=float(results.logzerr[-1]),
        mean=mean,
        sd=sd,
        mean_error=np.std([s[0] for s in spread], axis=0),
        sd_error=np.std([s[1] for s in spread], axis=0),
        calls=int(np.sum(results.ncall)),
    )


def _moments(x: Array, log_weight: Array) -> tuple[Array, Array]:
    w = np.exp(log_weight - log_weight.max())
    w /= w.sum()
    mean = w @ x
    return mean, np.sqrt(w @ (x - mean) ** 2)


class Lockstep:
    """A pool for dynesty whose tasks run as threads that wait for one another to ask for values.

    Each task asks for one value after another. When all tasks that still run have asked, the questions are
    answered as one stack, in the order of the tasks: the answers do not depend on how threads are
    scheduled.
    """

    def __init__(self, batched: Callable[[Array], Array], size: int) -> None:
        self.batched, self.size = batched, size
        self.local = threading.local()
        self.turn = threading.Condition()
        self.questions: dict[int, Array] = {}
        self.answers: dict[int, float | Exception] = {}
        self.running = 0

    def value(self, point: Array) -> float:
        """The value at one point (n,), asked by a task or, outside of them, by itself."""
        task = getattr(self.local, "task", None)
        if task is None:
            return float(self.batched(point[None])[0])
        with self.turn:
            self.questions[task] = point
            self._answer_if_all_asked()
            self.turn.wait_for(lambda: task in self.answers)
            answer = self.answers.pop(task)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def map(self, function: Callable[[Any], Any], arguments: Iterable[Any]) -> list[Any]:
        """The function of every argument, in their order."""
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
            self.turn.notify_all()
