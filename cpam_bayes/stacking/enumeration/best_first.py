"""Every stacking sequence on the grid, by its tabulated log evidence: a list of the best, sums over the rest.

Sequences are taken by their first plies: for each choice of these, all choices of the others at once.
Nothing is sampled. What the table leaves out is counted, and bounded by the table's floor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.stacking.features import PlySums, all_choices
from cpam_bayes.stacking.surrogate.piecewise_linear import PiecewiseLinearSurrogate

Array = NDArray[Any]

# Unknown angles that are taken together.
INNER = 3
# Width of a bin of log evidence, nats, and number of bins below the best.
BIN, BINS = 0.01, 4000


@dataclass(frozen=True, slots=True)
class Enumeration:
    """What it takes to go through all sequences.

    table : log evidence on cells, or ``None`` where ``every`` (n_prefixes, g^n_inner) holds that of every
    sequence.
    reference : log evidence that weights are relative to, about the largest. negation : (n_grid,) the grid
    index of minus each angle where sequences and their mirror images are equally probable, else ``None``.
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
        """Unknown angles taken together."""
        return min(INNER, self.sums.n_unknown)

    @property
    def floor(self) -> float:
        """Log evidence that sequences which were left out do not exceed."""
        return -np.inf if self.table is None else self.table.floor

    @property
    def n_prefixes(self) -> int:
        """Choices of the plies before them."""
        return int(len(self.sums.grid_deg) ** (self.sums.n_unknown - self.n_inner))


@dataclass(frozen=True, slots=True)
class PartialSums:
    """Sums over the sequences of some prefixes, listed ones left out; weights exp(log evidence - reference).

    prefixes : (p,) their numbers; mass : (p,) weight of each, mirror images included; inner : (n_inner,
    n_grid) marginal weights of the last plies. count, weight : (BINS,) sequences and their weight by log
    evidence below ``reference + 5``. entropy : sum of weight * (log evidence - reference). listed : (b, k)
    grid indices, log_evidence : (b,), times : (b,) 2 for those that stand for their mirror images as well.
    kept, left_out : all sequences in cells of the table and outside.
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


def prefix_digits(enumeration: Enumeration, prefixes: Array) -> Array:
    """Grid indices (p, k - n_inner) of prefixes by number."""
    g, n = len(enumeration.sums.grid_deg), enumeration.sums.n_unknown - enumeration.n_inner
    place = g ** np.arange(n - 1, -1, -1, dtype=np.int64)
    return np.asarray(prefixes[:, None] // place % g)


def prefixes_to_visit(enumeration: Enumeration) -> Array:
    """Numbers of the prefixes that stand for all: of two mirror images the first."""
    every = np.arange(enumeration.n_prefixes)
    if enumeration.negation is None or enumeration.n_prefixes == 1:
        return every
    return every[every <= _mirrored(enumeration, every)]


def _mirrored(enumeration: Enumeration, prefixes: Array) -> Array:
    assert enumeration.negation is not None
    g, n = len(enumeration.sums.grid_deg), enumeration.sums.n_unknown - enumeration.n_inner
    place = g ** np.arange(n - 1, -1, -1, dtype=np.int64)
    return np.asarray(enumeration.negation[prefix_digits(enumeration, prefixes)] @ place)


def enumerate_prefixes(enumeration: Enumeration, prefixes: Array) -> PartialSums:
    """All sequences that begin with some prefixes (p,)."""
    g, n_inner = len(enumeration.sums.grid_deg), enumeration.n_inner
    inner_v, inner_q = _inner_sums(enumeration)
    digits = prefix_digits(enumeration, prefixes)
    outer_v, outer_q = _outer_sums(enumeration, digits)
    twice = np.ones(len(prefixes), dtype=np.int64)
    if enumeration.negation is not None and enumeration.n_prefixes > 1:
        twice = np.where(_mirrored(enumeration, prefixes) == prefixes, 1, 2)
    mass = np.zeros(len(prefixes))
    inner = np.zeros(g**n_inner)
    count, weight = np.zeros(BINS, dtype=np.int64), np.zeros(BINS)
    kept, entropy = 0, 0.0
    listed: list[Array] = [np.empty((0, enumeration.sums.n_unknown), dtype=np.int16)]
    values: list[Array] = [np.empty(0)]
    times_listed: list[Array] = [np.empty(0, dtype=np.int64)]
    for p, times in enumerate(twice):
        rows, log_evidence = _one_prefix(
            enumeration, int(prefixes[p]), inner_v, inner_q, outer_v[p], outer_q[p]
        )
        kept += int(times) * len(rows)
        high = log_evidence >= enumeration.threshold
        if high.any():
            listed.append(_sequences(enumeration, digits[p], rows[high]).astype(np.int16))
            values.append(log_evidence[high])
            times_listed.append(np.full(len(values[-1]), times))
            rows, log_evidence = rows[~high], log_evidence[~high]
        below = log_evidence - enumeration.reference
        w = np.exp(below)
        mass[p] = times * w.sum()
        inner[rows] += times * w
        entropy += float(times * (w @ below))
        bins = bin_of(below)
        count += times * np.bincount(bins, minlength=BINS)
        weight += times * np.bincount(bins, w, minlength=BINS)
    total = int(twice.sum()) * g**n_inner
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
        left_out=total - kept,
    )


def combined(pieces: Sequence[PartialSums]) -> PartialSums:
    """The sums and lists of several pieces as one."""
    return PartialSums(
        prefixes=np.concatenate([p.prefixes for p in pieces]),
        mass=np.concatenate([p.mass for p in pieces]),
        inner=np.sum([p.inner for p in pieces], axis=0),
        count=np.sum([p.count for p in pieces], axis=0),
        weight=np.sum([p.weight for p in pieces], axis=0),
        entropy=sum(p.entropy for p in pieces),
        listed=np.concatenate([p.listed for p in pieces]),
        log_evidence=np.concatenate([p.log_evidence for p in pieces]),
        times=np.concatenate([p.times for p in pieces]),
        kept=sum(p.kept for p in pieces),
        left_out=sum(p.left_out for p in pieces),
    )


def bin_of(below: Array) -> Array:
    """The bin of log evidences relative to the reference (m,)."""
    return np.asarray(np.clip(((5.0 - below) / BIN).astype(np.int64), 0, BINS - 1))


def values_of_prefix(enumeration: Enumeration, prefix: int) -> tuple[Array, Array]:
    """Sequences (m, k) of one prefix that are summed, not listed, and their log evidence (m,)."""
    inner_v, inner_q = _inner_sums(enumeration)
    digits = prefix_digits(enumeration, np.array([prefix]))
    outer_v, outer_q = _outer_sums(enumeration, digits)
    rows, log_evidence = _one_prefix(enumeration, prefix, inner_v, inner_q, outer_v[0], outer_q[0])
    low = log_evidence < enumeration.threshold
    return _sequences(enumeration, digits[0], rows[low]), log_evidence[low]


def _one_prefix(
    enumeration: Enumeration, prefix: int, inner_v: Array, inner_q: Array, outer_v: Array, outer_q: Array
) -> tuple[Array, Array]:
    """Inner choices that are kept (m,), and their log evidence (m,)."""
    table = enumeration.table
    if table is None:
        assert enumeration.every is not None
        return np.arange(enumeration.every.shape[1]), enumeration.every[prefix]
    leaf = table.rows(inner_v, outer_v)
    rows = np.flatnonzero(leaf >= 0)
    v = inner_v[:, rows].T + outer_v.astype(np.float32)
    q = inner_q[:, rows].T + outer_q.astype(np.float32)
    return rows, table.values(leaf[rows], v, q)


def _inner_sums(enumeration: Enumeration) -> tuple[Array, Array]:
    """Sums of all choices of the inner plies, (4, g^n_inner) and (n_q, g^n_inner)."""
    log_evidence = []
    for table in (enumeration.sums.first, enumeration.sums.rest):
        total = all_choices(table[enumeration.sums.n_unknown - enumeration.n_inner :])
        log_evidence.append(np.ascontiguousarray(total.T, dtype=np.float32))
    return log_evidence[0], log_evidence[1]


def _outer_sums(enumeration: Enumeration, digits: Array) -> tuple[Array, Array]:
    log_evidence = []
    for table in (enumeration.sums.first, enumeration.sums.rest):
        total = np.zeros((len(digits), table.shape[2]))
        for j in range(digits.shape[1]):
            total += table[j][digits[:, j]]
        log_evidence.append(total)
    return log_evidence[0], log_evidence[1]


def _sequences(enumeration: Enumeration, outer: Array, rows: Array) -> Array:
    """Grid indices (m, k) of the inner choices ``rows`` (m,) of one prefix."""
    place = len(enumeration.sums.grid_deg) ** np.arange(enumeration.n_inner - 1, -1, -1)
    return np.column_stack(
        (np.tile(outer, (len(rows), 1)), rows[:, None] // place % len(enumeration.sums.grid_deg))
    )
