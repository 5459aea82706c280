"""Evidence by nested sampling with dynesty: a second estimator that shares nothing with the first."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from cpam_bayes.inference.derivatives import coordinates, log_density
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

# Bounds that are infinite are cut so many standard deviations of the prior from its mean.
_REACH = 10.0
# Stands for log 0, which dynesty does not take.
_NOTHING = -1e300
# Simulated shrinkages of the prior volume, which say how uncertain a run's moments are.
_RESAMPLINGS = 40


@dataclass(frozen=True, slots=True)
class NestedEvidence:
    """What independent runs of nested sampling say of a posterior.

    standard_error : of log_evidence.
    mean, sd : (n,) of the parameters, mean_error, sd_error : (n,) their standard errors. An error is the
    larger of what the runs say of themselves and of their scatter.
    calls : of the log probability.
    """

    log_evidence: float
    standard_error: float
    mean: Array
    sd: Array
    mean_error: Array
    sd_error: Array
    calls: int


@dataclass(frozen=True, slots=True)
class _Run:
    """One run: log evidence with its error, moments (2, n) with theirs, calls."""

    log_evidence: float
    error: float
    moments: Array
    moments_error: Array
    calls: int


@single_blas_thread
def nested_evidence(
    posterior: Posterior, seed: int, *, runs: int = 5, live_points: int = 200, batch: int = 24
) -> NestedEvidence:
    """The evidence of a posterior by static nested sampling (Skilling, 2006; Speagle, 2020).

    The unit cube is the box of the bounds (log-spaced for the amplitude of the noise), the prior's density
    is part of the likelihood. New points come from random slices. ``batch`` of them advance side by
    side, so that the log probability is asked for stacks. Several small runs rather than a large one: on
    B1 evidences scatter up to twice as widely as a run says. Needs the extra ``audit``.
    """
    results = [_run(posterior, np.random.default_rng([seed, 5, r]), live_points, batch) for r in range(runs)]
    moments = np.stack([run.moments for run in results])
    values = np.array([run.log_evidence for run in results])
    moments_error = _error(moments, np.stack([run.moments_error for run in results]))
    return NestedEvidence(
        log_evidence=float(values.mean()),
        standard_error=float(_error(values, np.array([run.error for run in results]))),
        mean=moments[:, 0].mean(axis=0),
        sd=moments[:, 1].mean(axis=0),
        mean_error=moments_error[0],
        sd_error=moments_error[1],
        calls=sum(run.calls for run in results),
    )


def _error(values: Array, errors: Array) -> Array:
    """Standard error of the mean over runs, (runs, ...) -> (...)."""
    within = np.sqrt(np.mean(errors**2, axis=0))
    scatter = values.std(axis=0, ddof=1) if len(values) > 1 else within
    return np.asarray(np.maximum(within, scatter) / np.sqrt(len(values)))


def _run(posterior: Posterior, rng: np.random.Generator, live_points: int, batch: int) -> _Run:
    from dynesty.utils import resample_run

    axes = coordinates(posterior)
    parameters = posterior.parameters
    centre = axes.to_u(np.array([p.prior.mean for p in parameters.parameters]))
    lower = np.where(axes.logged, axes.lower, np.maximum(axes.lower, centre - _REACH))
    upper = np.where(axes.logged, axes.upper, np.minimum(axes.upper, centre + _REACH))
    width = upper - lower

    def batched(u: Array) -> Array:
        values = log_density(posterior, axes, u) + np.log(width).sum()
        return np.where(np.isfinite(values), values, _NOTHING)

    results = _sampled(batched, lambda cube: lower + width * cube, parameters.size, rng, live_points, batch)
    again = [resample_run(results, rstate=rng) for _ in range(_RESAMPLINGS)]
    spread = [_moments(axes.to_x(r.samples), r.logwt) for r in again]
    return _Run(
        log_evidence=float(results.logz[-1]),
        error=float(results.logzerr[-1]),
        moments=_moments(axes.to_x(results.samples), results.logwt),
        moments_error=np.std(spread, axis=0),
        calls=int(np.sum(results.ncall)),
    )


def _sampled(
    batched: Callable[[Array], Array],
    from_cube: Callable[[Array], Array],
    n: int,
    rng: np.random.Generator,
    live_points: int,
    batch: int,
) -> Any:
    """What dynesty says of a likelihood of stacks of points (m, n) that are drawn from the unit cube."""
    import dynesty

    lockstep = Lockstep(batched, batch)
    sampler = dynesty.NestedSampler(
        lockstep.value,
        from_cube,
        n,
        nlive=live_points,
        sample="rslice",
        pool=lockstep,
        queue_size=batch,
        rstate=rng,
    )
    sampler.run_nested(dlogz=0.01, print_progress=False)
    return sampler.results


@single_blas_thread
def nested_of_density(
    density: LogDensity, rng: np.random.Generator, *, live_points: int = 200, batch: int = 32
) -> tuple[float, float]:
    """The log evidence of a log density over normal scores, and its error by nested sampling itself.

    The cube is the prior: z = Phi^-1(u), by which scores are standard normal.
    """

    def batched(z: Array) -> Array:
        values = density.log_likelihood(density.scores.to_x(z))
        return np.where(np.isfinite(values), values, _NOTHING)

    results = _sampled(batched, ndtri, density.parameters.size, rng, live_points, batch)
    return float(results.logz[-1]), float(results.logzerr[-1])


def _moments(x: Array, log_weight: Array) -> Array:
    """Mean and sd of weighted points (m, n), (2, n)."""
    w = np.exp(log_weight - log_weight.max())
    w /= w.sum()
    mean = w @ x
    return np.stack((mean, np.sqrt(w @ (x - mean) ** 2)))


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
