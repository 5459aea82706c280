"""Marginal likelihoods by importance sampling about their Laplace approximations, distributed over workers.

Workers hold the plates' models and are sent all else.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from io import BytesIO
from typing import Any, TypeVar

import numpy as np

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence.marginal import Marginal, Tested
from cpam_bayes.diagnosis.hypotheses import NONE
from cpam_bayes.inference.importance import Rounds, importance
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.student_mixture import Weighted, sobol_points
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parallel import Lasting, ProcessPool, lasting, run
from cpam_bayes.running import single_blas_thread

Answer = TypeVar("Answer")

Held = list[Any]


def shared_out(
    work: Callable[..., Answer],
    cases: Sequence[PlateCase],
    items: Sequence[tuple[Any, ...]],
    executor: Executor | None = None,
    *,
    common: Any = None,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Answer]:
    """Results of ``work(*item)`` in the order of the items, bit-identical on any executor.

    Items and answers may contain the models of the plates: a worker is sent these once, and answers refer to
    those of this process. Where something cannot be sent, this process does the work itself.

    work : a function of a module or of a class
    common : what all items share beside the models, sent once
    progress : called with the number of items that are done
    """
    held = _held(cases)
    try:
        call = _Call(work, lasting(held, executor), _packed(held, common))
        pickle.dumps(call)
        held = [common, *held]
        packed = [_packed(held, item) for item in items]
    except (pickle.PicklingError, AttributeError, TypeError):
        return [work(*item) for item in items]
    done: list[int] = []

    def count(index: int, answer: bytes) -> None:
        done.append(index)
        progress(len(done))

    answers = run(_worked, call, packed, executor, batch_size=1, on_result=count)
    return [_unpacked(held, answer) for answer in answers]


def ready(executor: Executor | None) -> None:
    """Let worker processes load what they need while this process has other work."""
    if isinstance(executor, ProcessPool):
        executor.start(_loaded)


def _loaded() -> None:
    """Empty task, after which a worker has loaded this module."""


@dataclass(frozen=True)
class _Call:
    """Data that all items of a call share.

    models : of the plates, the same in most calls of a diagnosis
    common : a pickle of the other shared objects
    """

    work: Callable[..., Any]
    models: Lasting
    common: bytes

    @cached_property
    def held(self) -> Held:
        """Objects that the pickles of items and answers refer to by number."""
        models = self.models.parts
        return [_unpacked(models, self.common), *models]


def _worked(call: _Call, item: bytes) -> bytes:
    return _packed(call.held, call.work(*_unpacked(call.held, item)))


def _held(cases: Sequence[PlateCase]) -> Held:
    """Objects that are not sent with items: models of the plates, and the containers that hold them."""
    held: Held = []
    for case in cases:
        held += [case.models, case.models.bare, case.extended, *case.extended.values()]
        held.append(case.of_another_material)
        for models in case.of_another_material:
            held += [models, models.bare]
    return held


def _packed(held: Held, value: Any) -> bytes:
    """Pickle of a value, in which held objects are numbers."""
    file = BytesIO()
    _Packer(file, held).dump(value)
    return file.getvalue()


def _unpacked(held: Held, packed: bytes) -> Any:
    """Value of a pickle, with the objects held in this process."""
    return _Unpacker(BytesIO(packed), held).load()


class _Packer(pickle.Pickler):
    def __init__(self, file: BytesIO, held: Held) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._number = {id(one): number for number, one in enumerate(held) if one is not None}

    def persistent_id(self, obj: Any) -> int | None:
        return self._number.get(id(obj))


class _Unpacker(pickle.Unpickler):
    def __init__(self, file: BytesIO, held: Held) -> None:
        super().__init__(file)
        self._held = held

    def persistent_load(self, pid: int) -> Any:
        return self._held[pid]


# Models are projected once more, on modes at so many points of the proposal, log2, so that this fraction of
# their frequencies has a relative error below the tolerance.
_LOG2_TRAINING, _TOLERANCE, _FRACTION = 6, 2e-5, 0.98
# Points of most weight at which both log densities are compared, and their largest accepted difference, nats.
_COMPARED, _ALIKE_NATS = 16, 0.05
# Hypotheses within _IN_SIGHT nats of the most probable one are sampled, roughly beyond _NEAR.
_NEAR, _IN_SIGHT = 4.0, 10.0
CLOSE = Rounds(least=2, good=0.5)
ROUGH = Rounds(log2_points=6, most=6, least=2, enough=50.0, steady=0.2, good=0.3)


@single_blas_thread
def sampled_marginal(marginal: Marginal, rounds: Rounds = CLOSE) -> Marginal:
    """Marginal likelihood by importance sampling from the proposal about its optima and nodes."""
    comparison = marginal.comparison
    near = about_optima(marginal)
    sample = _sample(marginal, near, rounds)
    if near is not comparison and not _are_alike(near, comparison, sample):
        sample = _sample(marginal, comparison, rounds)
    if not np.isfinite(sample.log_evidence[0]):
        return marginal
    with np.errstate(divide="ignore"):
        log_weight = np.log(sample.weight[0])
    return replace(
        marginal,
        log_evidence=float(sample.log_evidence[0]),
        error=float(sample.standard_error[0]),
        effective_size=float(sample.effective_size[0]),
        k_hat=float(sample.k_hat[0]),
        draws=comparison.scores.to_x(sample.points[0]),
        log_weight=log_weight,
    )


def about_optima(marginal: Marginal) -> CorrelatedDensity:
    """The comparison with models reduced further, for points of the mixture about the optima."""
    points = sobol_points(marginal.proposal, _LOG2_TRAINING)[0]
    return marginal.comparison.about(points, _TOLERANCE, _FRACTION)


def about_draws(marginal: Marginal) -> CorrelatedDensity:
    """As ``about_optima``, but the marginal's own comparison where that is inaccurate at its draws."""
    near = about_optima(marginal)
    x = marginal.draws[np.argsort(-marginal.log_weight, kind="stable")[:_COMPARED]]
    apart = np.abs(near.log_likelihood(x) - marginal.comparison.log_likelihood(x))
    return near if apart.max() < _ALIKE_NATS else marginal.comparison


def _sample(marginal: Marginal, comparison: CorrelatedDensity, rounds: Rounds) -> Weighted:
    def log_density(z: Array) -> Array:
        return comparison.log_density(z[0])[None]

    return importance(log_density, marginal.proposal, rounds, comparison.expand)[0]


def _are_alike(near: CorrelatedDensity, comparison: CorrelatedDensity, sample: Weighted) -> bool:
    """Whether two comparisons have the same log density at the points of most weight."""
    z = sample.points[0][np.argsort(-sample.weight[0], kind="stable")[:_COMPARED]]
    return bool(np.abs(near.log_density(z) - comparison.log_density(z)).max() < _ALIKE_NATS)


def sampled_near_the_best(
    tested: Sequence[Tested], cases: Sequence[PlateCase], executor: Executor | None = None
) -> list[Tested] | None:
    """Hypotheses with those near the best importance-sampled; ``None`` if all of these already were."""
    best = max(t.log_weight for t in tested)
    rounds = [_rounds_of(t, best) for t in tested]
    items = [(t, each) for t, each in zip(tested, rounds, strict=True) if each is not None]
    if not items:
        return None
    sampled = iter(shared_out(_sampled, cases, items, executor))
    return [t if each is None else next(sampled) for t, each in zip(tested, rounds, strict=True)]


def _sampled(t: Tested, rounds: Rounds) -> Tested:
    return replace(t, marginal=sampled_marginal(t.marginal, rounds))


def _rounds_of(t: Tested, best: float) -> Rounds | None:
    """Sampling rounds for a hypothesis by its distance from the best; None leaves it as it is."""
    if t.marginal.is_sampled or t.log_weight < best - _IN_SIGHT:
        return None
    is_near = t.log_weight >= best - _NEAR
    if t.hypothesis.has_leftover:
        return ROUGH if is_near else None
    return CLOSE if is_near or t.hypothesis.cause == NONE else ROUGH
