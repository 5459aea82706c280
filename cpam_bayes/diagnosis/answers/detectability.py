"""The smallest size of each cause that the lists would have shown, by simulation with a linear oracle."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.answers.linear_oracle import LinearOracle, linear_oracle
from cpam_bayes.diagnosis.answers.shift_lines import ShiftLine, shift_lines
from cpam_bayes.diagnosis.claim import CLEAR, MOST, SURE
from cpam_bayes.diagnosis.evidence.sharing import shared_out
from cpam_bayes.diagnosis.evidence.weighing import Weighed
from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, causes_in
from cpam_bayes.parameters import Parameter
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Probability with which the smallest size would have been claimed.
POWER = 0.95
# Simulated lists, common to all sizes, and the seed of their noise.
_DRAWS, _SEED = 100, 20
# Visible shifts at which sizes are tried, standard deviations of the data: the first and the last; how many
# of them, and how many between the two of these that the answer lies between.
_FIRST_SD, _LAST_SD, _COARSE, _FINE = 2.0, 40.0, 8, 5
# Places of a cause that are tried, of which the median counts; fewer where it may be on one plate or another.
_PLACES = 5
# Shifts of opposite sizes that differ by less than this fraction are the same.
_EVEN = 1e-3


@dataclass(frozen=True, slots=True)
class Detectable:
    """What the lists would have shown of one cause.

    parameter : its size, ``None`` for a cause that has none
    smallest : distance of the size from its null, SI, from which the cause or its class would have been
        claimed with probability `POWER`, of either sign and at the median place; ``None`` where no size would
    probability_of_claim : at that size, or at the best one
    """

    cause: str
    parameter: Parameter | None
    smallest: float | None
    probability_of_claim: float | None


@single_blas_thread
def detectable(
    weighed: Weighed, cases: Sequence[PlateCase] = (), executor: Executor | None = None
) -> tuple[Detectable, ...]:
    """The smallest detectable size of every single cause that was tested, in the order of their probability.

    The lists are simulated at the plain model's optimum with a cause of some size and noise as stated, or
    from the posterior of the repeatability; a claim is made as for the lists themselves, by the evidences of
    all causes (`linear_oracle`). Sizes share the draws of the noise. Incomplete lists are paired as is most
    probable under the plain model.

    cases, executor : the plates, and where the causes are worked on
    """
    weighed = weighed.in_plain_pairing()
    lines = shift_lines(weighed.tested, weighed.none.marginal)
    oracle = linear_oracle(weighed, lines, _DRAWS, np.random.default_rng(_SEED))
    wanted: list[_Sought] = []
    for cause in weighed.by_cause():
        if cause in (NONE, OTHER) or len(causes_in(cause)) > 1:
            continue
        variants = [t.hypothesis for t in weighed.tested if t.hypothesis.cause == cause]
        # a frequency far off is one of another mode: such a variant has no size
        size_of = next((h.parameters[0] for h in variants if h.parameters), None)
        of_plates = len({t.plates for t in weighed.tested if t.hypothesis.cause == cause})
        some = _spread([line for line in lines if line.cause == cause], max(_PLACES // of_plates, 1))
        wanted.append((oracle, cause, size_of, some))
    return tuple(shared_out(_detectable, cases, wanted, executor, common=oracle))


_Sought = tuple[LinearOracle, str, Parameter | None, list[ShiftLine]]


def _detectable(item: _Sought) -> Detectable:
    oracle, cause, size_of, some = item
    by_place = [_worse_sign(oracle, line) for line in some]
    if not by_place:
        return Detectable(cause, size_of, None, None)
    size, power = sorted(by_place)[len(by_place) // 2]
    return Detectable(cause, size_of, size if np.isfinite(size) else None, power)


def _spread(lines: list[ShiftLine], most: int) -> list[ShiftLine]:
    """Some of the lines of a cause, evenly over its places."""
    if len(lines) <= most:
        return lines
    return [lines[i] for i in np.linspace(0, len(lines) - 1, most).round().astype(int)]


def _worse_sign(oracle: LinearOracle, line: ShiftLine) -> tuple[float, float]:
    """The larger of the smallest sizes of both signs, infinite if one of them is not seen, and its power."""
    by_sign = []
    mirrored = np.abs(line.shift[::-1] - line.shift).max() < _EVEN * np.abs(line.shift).max()
    for side in (line.size > 0.0, (line.size < 0.0) & (not mirrored)):
        rows = np.flatnonzero(side)
        rows = rows[np.argsort(np.abs(line.size[rows]), kind="stable")]
        if len(rows) > 1:
            by_sign.append(_smallest(oracle, line.cause, np.abs(line.size[rows]), line.shift[rows]))
    return max(by_sign, key=lambda entry: (entry[0], -entry[1]), default=(np.inf, 0.0))


def _smallest(oracle: LinearOracle, cause: str, size: Array, shift: Array) -> tuple[float, float]:
    """The smallest of sizes (k,), ascending, with shifts (k, n_f) that is claimed with `POWER`; its power."""
    seen = np.maximum.accumulate(np.linalg.norm(shift @ oracle.root.T, axis=1))
    seen += 1e-9 * np.arange(len(seen))
    high = min(_LAST_SD, seen[-1])
    low = max(min(_FIRST_SD, 0.5 * high), seen[0])
    at = np.geomspace(low, high, _COARSE)
    for more in (_FINE, 0):
        place = np.interp(at, seen, np.arange(len(seen)))
        power = _power(oracle, cause, _between(shift, place))
        enough = np.flatnonzero(power >= POWER)
        if not len(enough):
            return np.inf, float(power.max())
        first = int(enough[0])
        if not first or not more:
            break
        at = np.linspace(at[first - 1], at[first], more)
    if first:  # the power grows nearly linearly between the two
        part = (POWER - power[first - 1]) / (power[first] - power[first - 1])
        place = place[first - 1] + part * (place[first] - place[first - 1]) * np.ones(1)
        return float(_between(size, place)[0]), POWER
    return float(_between(size, place)[0]), float(power[0])


def _between(values: Array, place: Array) -> Array:
    """Values (k, ...) at fractional rows (m,), (m, ...)."""
    i = np.minimum(place.astype(int), len(values) - 2)
    part = (place - i).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[i] + part * (values[i + 1] - values[i]))


def _power(oracle: LinearOracle, cause: str, shift: Array) -> Array:
    """Fraction of the simulated lists with shifts (m, n_f) of a cause that claim it or its class, (m,)."""
    log_weight = oracle.log_weights(shift)
    log_weight -= log_weight.max(axis=0)
    members = oracle.alike(shift) | np.array([name == cause for name in oracle.causes])[:, None]
    inside, outside = members[:, None], ~members[:, None]
    weight = np.exp(log_weight)
    claimed = np.where(inside, weight, 0.0)
    if members.sum(axis=0).max() > MOST:
        claimed = -np.partition(-claimed, MOST - 1, axis=0)[:MOST]
    probability = claimed.sum(axis=0) / weight.sum(axis=0)
    log_evidence = log_weight - np.log(oracle.prior)[:, None, None]
    best, outsider = (np.where(of, log_evidence, -np.inf).max(axis=0) for of in (inside, outside))
    return np.asarray(((probability >= SURE) & (best >= outsider + CLEAR)).mean(axis=0))
