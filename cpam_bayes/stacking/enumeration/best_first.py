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
from cpam_bayes.stacking.surrogate.piecewise_linear import EvidenceTable

Array = NDArray[Any]

# Unknown angles that are taken together.
INNER = 3
# Width of a bin of log evidence, nats, and number of bins below the best.
BIN, BINS = 0.01, 4000


@dataclass(frozen=True, slots=True)
class Enumerator:
    """What it takes to go through all sequences.

    table : log evidence on cells, or ``None`` where ``every`` (n_prefixes, g^n_inner) holds that of every
    sequence.
    reference : log evidence that weights are relative to, about the largest. negation : (n_grid,) the grid
    index of minus each angle where sequences and their mirror images are equally probable, else ``None``.
    threshold : sequences with this log evidence or more are listed one by one, the others are summed.
    """

    table: EvidenceTable | None
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
class Piece:
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


def prefix_digits(own: Enumerator, prefixes: Array) -> Array:
    """Grid indices (p, k - n_inner) of prefixes by number."""
    g, n = len(own.sums.grid_deg), own.sums.n_unknown - own.n_inner
    place = g ** np.arange(n - 1, -1, -1, dtype=np.int64)
    return np.asarray(prefixes[:, None] // place % g)


def prefixes_to_visit(own: Enumerator) -> Array:
    """Numbers of the prefixes that stand for all: of two mirror images the first."""
    every = np.arange(own.n_prefixes)
    if own.negation is None or own.n_prefixes == 1:
        return every
    return every[every <= _mirrored(own, every)]


def _mirrored(own: Enumerator, prefixes: Array) -> Array:
    assert own.negation is not None
    g, n = len(own.sums.grid_deg), own.sums.n_unknown - own.n_inner
    place = g ** np.arange(n - 1, -1, -1, dtype=np.int64)
    return np.asarray(own.negation[prefix_digits(own, prefixes)] @ place)


def enumerate_prefixes(own: Enumerator, prefixes: Array) -> Piece:
    """All sequences that begin with some prefixes (p,)."""
    g, n_inner = len(own.sums.grid_deg), own.n_inner
    inner_v, inner_q = _inner_sums(own)
    digits = prefix_digits(own, prefixes)
    outer_v, outer_q = _outer_sums(own, digits)
    twice = np.ones(len(prefixes), dtype=np.int64)
    if own.negation is not None and own.n_prefixes > 1:
        twice = np.where(_mirrored(own, prefixes) == prefixes, 1, 2)
    mass = np.zeros(len(prefixes))
    inner = np.zeros(g**n_inner)
    count, weight = np.zeros(BINS, dtype=np.int64), np.zeros(BINS)
    kept, entropy = 0, 0.0
    listed: list[Array] = [np.empty((0, own.sums.n_unknown), dtype=np.int16)]
    values: list[Array] = [np.empty(0)]
    times_listed: list[Array] = [np.empty(0, dtype=np.int64)]
    for p, times in enumerate(twice):
        rows, found = _one_prefix(own, int(prefixes[p]), inner_v, inner_q, outer_v[p], outer_q[p])
        kept += int(times) * len(rows)
        high = found >= own.threshold
        if high.any():
            listed.append(_sequences(own, digits[p], rows[high]).astype(np.int16))
            values.append(found[high])
            times_listed.append(np.full(len(values[-1]), times))
            rows, found = rows[~high], found[~high]
        below = found - own.reference
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
    return Piece(
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


def together(pieces: Sequence[Piece]) -> Piece:
    """The sums and lists of several pieces as one."""
    return Piece(
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


def values_of_prefix(own: Enumerator, prefix: int) -> tuple[Array, Array]:
    """Sequences (m, k) of one prefix that are summed, not listed, and their log evidence (m,)."""
    inner_v, inner_q = _inner_sums(own)
    digits = prefix_digits(own, np.array([prefix]))
    outer_v, outer_q = _outer_sums(own, digits)
    rows, found = _one_prefix(own, prefix, inner_v, inner_q, outer_v[0], outer_q[0])
    low = found < own.threshold
    return _sequences(own, digits[0], rows[low]), found[low]


def _one_prefix(
    own: Enumerator, prefix: int, inner_v: Array, inner_q: Array, outer_v: Array, outer_q: Array
) -> tuple[Array, Array]:
    """Inner choices that are kept (m,), and their log evidence (m,)."""
    table = own.table
    if table is None:
        assert own.every is not None
        return np.arange(own.every.shape[1]), own.every[prefix]
    leaf = table.rows(inner_v, outer_v)
    rows = np.flatnonzero(leaf >= 0)
    v = inner_v[:, rows].T + outer_v.astype(np.float32)
    q = inner_q[:, rows].T + outer_q.astype(np.float32)
    return rows, table.values(leaf[rows], v, q)


def _inner_sums(own: Enumerator) -> tuple[Array, Array]:
    """Sums of all choices of the inner plies, (4, g^n_inner) and (n_q, g^n_inner)."""
    found = []
    for table in (own.sums.first, own.sums.rest):
        total = all_choices(table[own.sums.n_unknown - own.n_inner :])
        found.append(np.ascontiguousarray(total.T, dtype=np.float32))
    return found[0], found[1]


def _outer_sums(own: Enumerator, digits: Array) -> tuple[Array, Array]:
    found = []
    for table in (own.sums.first, own.sums.rest):
        total = np.zeros((len(digits), table.shape[2]))
        for j in range(digits.shape[1]):
            total += table[j][digits[:, j]]
        found.append(total)
    return found[0], found[1]


def _sequences(own: Enumerator, outer: Array, rows: Array) -> Array:
    """Grid indices (m, k) of the inner choices ``rows`` (m,) of one prefix."""
    place = len(own.sums.grid_deg) ** np.arange(own.n_inner - 1, -1, -1)
    return np.column_stack((np.tile(outer, (len(rows), 1)), rows[:, None] // place % len(own.sums.grid_deg)))
