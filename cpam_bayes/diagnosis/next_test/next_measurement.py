"""Which further test would tell the causes apart best: the information of its data about the cause."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtri
from scipy.stats import qmc

from cpam_bayes.diagnosis.diagnose import Diagnosis
from cpam_bayes.diagnosis.evidence.sharing import shared_out
from cpam_bayes.diagnosis.evidence.weighing import Tested, Weighed
from cpam_bayes.diagnosis.fitting import SCATTER, PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER
from cpam_bayes.diagnosis.next_test.further_tests import Predict, further_tests
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Causes that tests are to tell apart: until they have so much probability, so many at most, in so many
# variants at most.
_ENOUGH, _MOST_CAUSES, _MOST_VARIANTS = 0.99, 6, 10
# Simulated data, log2, of each hypothesis; probability from which a cause counts as identified.
_LOG2_DATA, _IDENTIFIED = 10, 0.9


@dataclass(frozen=True, slots=True)
class Candidate:
    """A further test.

    information : expected of its data about the cause, nats (mutual information)
    possible : the most that data can say, the entropy of the cause, nats
    decided : probability that the right cause is above 0.9 afterwards
    """

    name: str
    description: str
    information: float
    possible: float
    decided: float


@dataclass(frozen=True, slots=True)
class Outlook:
    """Data of a test as k hypotheses predict them, each a Gaussian.

    probability : (k,)
    cause : (k,) number of the cause that a hypothesis is a variant of
    mean : (k, n)
    covariance : (k, n, n), noise included
    """

    probability: Array
    cause: Array
    mean: Array
    covariance: Array


@single_blas_thread
def next_measurements(
    diagnosis: Diagnosis,
    *,
    always: bool = False,
    noise: float | None = None,
    scatter: float = SCATTER,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> tuple[Candidate, ...]:
    """Tests of the plate that the leading cause is about, the most informative first.

    Another edge condition, four more modes, a known mass at a corner and at the centre, a sister plate of
    the same material, weighing and gauging. always : also where nothing is wrong or the cause is named.
    noise : relative standard deviation of a frequency in them; left out, that of the list or, where it was
    inferred, what each hypothesis says of it. Every hypothesis predicts the data from its own posterior.
    executor : where that is done.
    """
    if _is_settled(diagnosis) and not always:
        return ()
    leading = leading_hypotheses(diagnosis.weighed)
    if len({t.hypothesis.cause for t in leading}) < 2:
        return ()
    about = next((t.plates[0] for t in leading if t.hypothesis.cause not in (NONE, OTHER)), 0)
    last = max(int(t.marginal.comparison.model.parts[about].modes.max()) for t in leading)
    tests = further_tests(diagnosis.cases, about, last, scatter)
    notify(f"predicting {len(tests)} further tests")
    asked = _Asked(diagnosis.cases, about, last, scatter, noise, leading)
    items = [(asked, number) for number in range(len(tests))]
    predicted = shared_out(_candidate, diagnosis.cases, items, executor, common=asked)
    candidates = []
    for test, candidate in zip(tests, predicted, strict=True):
        if candidate is None:
            notify(
                f"{test.description}: a cause leaves a plate that cannot be told from a rigid body; left out"
            )
        else:
            candidates.append(candidate)
    return tuple(sorted(candidates, key=lambda c: -c.information))


def _is_settled(diagnosis: Diagnosis) -> bool:
    """Whether no causes are left to tell apart: none, or one, and nothing open beside it."""
    claim = diagnosis.claim
    alone = claim.probability - diagnosis.probability_beside
    return claim.kind == NONE or (claim.kind == "named" and alone >= _IDENTIFIED)


@dataclass(frozen=True, slots=True)
class _Asked:
    """What tests that could follow are predicted from, as in `further_tests` and `outlook_of`."""

    cases: Sequence[PlateCase]
    about: int
    last_mode: int
    scatter: float
    noise: float | None
    leading: tuple[Tested, ...]


def _candidate(item: tuple[_Asked, int]) -> Candidate | None:
    """What the test of some number would tell, ``None`` where it cannot be predicted."""
    asked, number = item
    test = further_tests(asked.cases, asked.about, asked.last_mode, asked.scatter)[number]
    try:
        outlook = outlook_of(asked.leading, asked.cases[asked.about], test.prepare(), asked.noise)
    except RigidBodyError:
        return None
    return Candidate(test.name, test.description, *information(outlook))


def leading_hypotheses(weighed: Weighed) -> tuple[Tested, ...]:
    """The best variants of the most probable causes, which carry the whole probability of these.

    Causes are taken until they hold 99 %, six at most, with ten variants in all at most.
    """
    causes: dict[str, float] = {}
    for name, p in weighed.by_cause().items():
        if sum(causes.values()) >= _ENOUGH or len(causes) == _MOST_CAUSES:
            break
        causes[name] = p
    of_these = [t for t in weighed.tested if t.hypothesis.cause in causes]
    best = [next(t for t in of_these if t.hypothesis.cause == name) for name in causes]
    chosen = {
        id(t) for t in [*best, *(t for t in of_these if all(t is not b for b in best))][:_MOST_VARIANTS]
    }
    kept = [t for t in of_these if id(t) in chosen]
    held = {name: sum(t.probability for t in kept if t.hypothesis.cause == name) for name in causes}
    whole = [
        replace(t, probability=t.probability * causes[t.hypothesis.cause] / held[t.hypothesis.cause])
        for t in kept
        if held[t.hypothesis.cause] > 0.0
    ]
    return tuple(sorted(whole, key=lambda t: -t.probability))


def information(outlook: Outlook, log2_data: int = _LOG2_DATA) -> tuple[float, float, float]:
    """Mutual information of cause and data, the entropy of the cause, and how probably it is identified.

    I = H(C) - E H(C | y), by data y drawn from every hypothesis, from one scrambled Sobol sequence. The cause
    is identified where the one that is true has a probability above 0.9.
    """
    n_data = outlook.mean.shape[1]
    p = outlook.probability / outlook.probability.sum()
    of_cause = (outlook.cause[:, None] == np.unique(outlook.cause)).astype(float)  # (k, n_causes)
    uniform = qmc.Sobol(n_data, rng=np.random.default_rng(0)).random_base2(log2_data)
    normal = ndtri(np.clip(uniform, 1e-12, 1 - 1e-12))
    factor = np.linalg.cholesky(outlook.covariance)
    y = outlook.mean[:, None] + normal @ np.swapaxes(factor, 1, 2)  # (k, draws, n)
    back = np.linalg.inv(factor)
    log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    z = np.einsum("jab,kdjb->kdja", back, y[:, :, None] - outlook.mean)
    log_joint = np.log(p) - log_det - 0.5 * np.sum(z**2, axis=-1)  # (k, draws, k)
    after = np.exp(log_joint - logsumexp(log_joint, axis=-1, keepdims=True)) @ of_cause
    possible = _entropy(p @ of_cause)
    left = float(p @ _entropies(after).mean(axis=1))
    right = np.take_along_axis(after, of_cause.argmax(axis=1)[:, None, None], axis=-1)[..., 0]
    decided = float(p @ (right > _IDENTIFIED).mean(axis=1))
    return max(possible - left, 0.0), possible, decided


def _entropies(p: Array) -> Array:
    return np.asarray(-np.sum(p * np.log(np.maximum(p, 1e-300)), axis=-1))


def _entropy(p: Array) -> float:
    return float(_entropies(p))


def outlook_of(leading: Sequence[Tested], case: PlateCase, predict: Predict, noise: float | None) -> Outlook:
    """The data of a test under each hypothesis, as relative deviations from what the first one predicts."""
    means, covariances = [], []
    unit: Array | None = None
    for t in leading:
        prediction = predict(t)
        weight = np.exp(t.marginal.log_weight)
        weight /= weight.sum()
        if unit is None:
            unit = np.asarray(weight @ prediction.y)
        y = prediction.y / unit
        mean = weight @ y
        if prediction.noise is not None:
            noise_variance = prediction.noise**2
        else:
            noise_variance = _noise(t, case, unit, noise, prediction.as_now)
        spread = (y - mean).T @ ((y - mean) * weight[:, None])
        covariances.append(spread + np.diag(noise_variance) + prediction.missing)
        means.append(mean)
    causes = list(dict.fromkeys(t.hypothesis.cause for t in leading))
    return Outlook(
        np.array([t.probability for t in leading]),
        np.array([causes.index(t.hypothesis.cause) for t in leading]),
        np.stack(means),
        np.stack(covariances),
    )


def _noise(t: Tested, case: PlateCase, f: Array, noise: float | None, as_now: bool) -> Array:
    """Relative variance of frequencies (n,) beyond the spread of the draws."""
    comparison, measurement = t.marginal.comparison, case.measurement
    weight = np.exp(t.marginal.log_weight)
    weight /= weight.sum()
    if noise is not None:
        variance = noise**2
    elif measurement.frequency_sd is not None:
        variance = float(np.mean((measurement.frequency_sd / measurement.frequencies) ** 2))
    elif measurement.relative_std is not None:
        variance = measurement.relative_std**2
    else:
        # of all lists, where there are several: a further test is like any of them
        inferred = [c for c in comparison.amplitudes if c >= 0]
        variance = float(np.mean(weight @ t.marginal.draws[:, inferred] ** 2))
    if comparison.discrepancy is not None and as_now:
        variance += float(weight @ t.marginal.draws[:, comparison.discrepancy] ** 2)
    variance += float(np.mean(case.models.error**2))
    return np.asarray(variance + measurement.resolution**2 / 12 / f**2)
