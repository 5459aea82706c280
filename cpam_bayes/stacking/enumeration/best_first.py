"""All stacking sequences on the grid by the surrogate of their evidence: the best listed, the rest summed.

Sequences are taken by their first plies, the prefix: for each prefix all choices of the other plies at once.
Nothing is sampled. Sequences outside the surrogate's cells are counted, and bounded by its lower bound.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.features import PlySums, all_choices
from cpam_bayes.stacking.surrogate.piecewise_linear import PiecewiseLinearSurrogate

Array = NDArray[Any]

# Unknown angles behind a prefix, whose choices are taken together.
INNER = 3
# Width of a bin of log evidence, nats, and number of bins.
BIN, BINS = 0.01, 4000
# Log evidence above the reference at which the bins begin, nats.
BINS_BEGIN = 5.0


@dataclass(frozen=True, slots=True)
class Enumeration:
    """The log evidence of all sequences, and which of them are to be listed.

    table : log evidence on cells; ``None`` where ``every`` (n_prefixes, g^n_inner) holds that of every
    sequence.
    sums : over the plies.
    reference : log evidence that weights are relative to, about the largest.
    negation : (n_grid,) grid index of minus each angle where sequences and their mirror images are equally
    probable, else ``None``.
    threshold : sequences with this log evidence or more are listed one by one, the others are summed.
    """

    table: PiecewiseLinearSurrogate | None
    sums: PlySums
    reference: float
    negation: Array | None
    threshold: float
    every: Array | None = None

    @property
    def n_inner(self) -> int:
        """Unknown angles behind a prefix."""
        return min(INNER, self.sums.n_unknown)

    @property
    def n_prefixes(self) -> int:
        """Number of prefixes."""
        return int(len(self.sums.grid_deg) ** (self.sums.n_unknown - self.n_inner))

    @property
    def lower_bound(self) -> float:
        """Log evidence that sequences outside the cells do not exceed."""
        return -np.inf if self.table is None else self.table.lower_bound


@dataclass(frozen=True, slots=True)
class PartialSums:
    """Sums over the sequences of some prefixes without those listed; weights exp(log evidence - reference).

    prefixes : (p,) their numbers.
    mass : (p,) weight of each, mirror images included.
    inner : (n_inner, n_grid) marginal weights of the last plies.
    count, weight : (BINS,) sequences and their weight by log evidence below ``reference + BINS_BEGIN``.
    entropy : sum of weight * (log evidence - reference).
    listed : (b, k) grid indices.
    log_evidence : (b,) of those listed.
    times : (b,) 2 for those that stand for their mirror images as well, else 1.
    kept, left_out : all sequences inside and outside the cells.
    """

    prefixes: Array
    mass: Array
    inner: Array
    count: Array
    weight: Array
    entropy: float
    listed: Array
    log_evidence: Array
    times: Array
    kept: int
    left_out: int


def place_values(base: int, digits: int) -> Array:
    """What each digit of a number counts, the first most, (digits,)."""
    return np.asarray(base ** np.arange(digits - 1, -1, -1, dtype=np.int64))


def prefixes_to_visit(enumeration: Enumeration) -> Array:
    """Numbers of the prefixes that stand for all: the first of two mirror images."""
    every = np.arange(enumeration.n_prefixes)
    return every[every <= _mirror_images(enumeration, every)]


def enumerate_prefixes(enumeration: Enumeration, prefixes: Array) -> PartialSums:
    """All sequences that begin with some prefixes (p,)."""
    g, n_inner, k = len(enumeration.sums.grid_deg), enumeration.n_inner, enumeration.sums.n_unknown
    times = np.ones(len(prefixes), dtype=np.int64)
    if enumeration.negation is not None and enumeration.n_prefixes > 1:
        times = np.where(_mirror_images(enumeration, prefixes) == prefixes, 1, 2)
    mass, inner = np.zeros(len(prefixes)), np.zeros(g**n_inner)
    count, weight = np.zeros(BINS, dtype=np.int64), np.zeros(BINS)
    kept, entropy = 0, 0.0
    listed: list[Array] = [np.empty((0, k), dtype=np.int16)]
    values: list[Array] = [np.empty(0)]
    times_listed: list[Array] = [np.empty(0, dtype=np.int64)]
    for p, (digits, rows, log_evidence) in enumerate(_values(enumeration, prefixes)):
        kept += int(times[p]) * len(rows)
        high = log_evidence >= enumeration.threshold
        if high.any():
            listed.append(_sequences(g, n_inner, digits, rows[high]).astype(np.int16))
            values.append(log_evidence[high])
            times_listed.append(np.full(len(values[-1]), times[p]))
            rows, log_evidence = rows[~high], log_evidence[~high]
        relative = log_evidence - enumeration.reference
        w = np.exp(relative)
        mass[p] = times[p] * w.sum()
        inner[rows] += times[p] * w
        entropy += float(times[p] * (w @ relative))
        bins = np.clip(((BINS_BEGIN - relative) / BIN).astype(np.int64), 0, BINS - 1)
        count += times[p] * np.bincount(bins, minlength=BINS)
        weight += times[p] * np.bincount(bins, w, minlength=BINS)
    marginal = inner.reshape((g,) * n_inner)
    by_ply = np.stack([marginal.sum(axis=tuple(i for i in range(n_inner) if i != j)) for j in range(n_inner)])
    return PartialSums(
        prefixes=prefixes,
        mass=mass,
        inner=by_ply,
        count=count,
        weight=weight,
        entropy=entropy,
        listed=np.concatenate(listed),
        log_evidence=np.concatenate(values),
        times=np.concatenate(times_listed),
        kept=kept,
        left_out=int(times.sum()) * g**n_inner - kept,
    )


def combined(parts: Sequence[PartialSums]) -> PartialSums:
    """The sums and lists of several parts as one."""
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("prefixes", "mass", "listed", "log_evidence", "times")
    }
    added: dict[str, Any] = {
        name: sum(getattr(part, name) for part in parts)
        for name in ("inner", "count", "weight", "entropy", "kept", "left_out")
    }
    return PartialSums(**joined, **added)


def values_of_prefix(enumeration: Enumeration, prefix: int) -> tuple[Array, Array]:
    """Sequences (m, k) of one prefix that are summed, not listed, and their log evidence (m,)."""
    digits, rows, log_evidence = next(_values(enumeration, np.array([prefix])))
    low = log_evidence < enumeration.threshold
    sequences = _sequences(len(enumeration.sums.grid_deg), enumeration.n_inner, digits, rows[low])
    return sequences, log_evidence[low]


def _values(enumeration: Enumeration, prefixes: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Of each prefix its grid indices, the inner choices inside cells (m,) and their log evidence (m,)."""
    table, n_outer = enumeration.table, enumeration.sums.n_unknown - enumeration.n_inner
    digits = _prefix_digits(enumeration, prefixes)
    if table is None:
        assert enumeration.every is not None
        inner = np.arange(enumeration.every.shape[1])
        yield from ((digits[p], inner, enumeration.every[prefix]) for p, prefix in enumerate(prefixes))
        return
    both = enumeration.sums.both
    total = all_choices(both[n_outer:]).astype(np.float32)
    v, sums = np.ascontiguousarray(total[:, :4].T), np.column_stack((np.ones_like(total[:, 0]), total))
    outer = np.zeros((len(digits), 1 + both.shape[2]))
    for j in range(n_outer):
        outer[:, 1:] += both[j][digits[:, j]]
    for p in range(len(prefixes)):
        leaf = table.rows(v, outer[p, 1:5])
        rows = np.flatnonzero(leaf >= 0)
        yield digits[p], rows, table.values(leaf[rows], sums[rows] + outer[p].astype(np.float32))


def _prefix_digits(enumeration: Enumeration, prefixes: Array) -> Array:
    """Grid indices (p, k - n_inner) of prefixes by number."""
    g = len(enumeration.sums.grid_deg)
    return np.asarray(
        prefixes[:, None] // place_values(g, enumeration.sums.n_unknown - enumeration.n_inner) % g
    )


def _mirror_images(enumeration: Enumeration, prefixes: Array) -> Array:
    """Numbers of the mirror images of prefixes (p,), themselves where mirror images are not equal, (p,)."""
    if enumeration.negation is None:
        return prefixes
    digits = _prefix_digits(enumeration, prefixes)
    place = place_values(len(enumeration.sums.grid_deg), digits.shape[1])
    return np.asarray(enumeration.negation[digits] @ place)


def _sequences(n_grid: int, n_inner: int, outer: Array, rows: Array) -> Array:
    """Grid indices (m, k) of the inner choices ``rows`` (m,) of one prefix."""
    inner = rows[:, None] // place_values(n_grid, n_inner) % n_grid
    return np.column_stack((np.tile(outer, (len(rows), 1)), inner))
