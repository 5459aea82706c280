"""Targets of our forward solver, and the values that a run found."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.building import STACK
from benchmarks.cases import Array, Case
from benchmarks.entries import (
    BENDING,
    FULL,
    LAPACK_REDUCED,
    POLYNOMIAL,
    REDUCED,
    REDUCED_DERIVATIVES,
    Entry,
)
from benchmarks.timing import ratio

Times = Mapping[tuple[str, str], Array]

# A full solve against the fastest peer; a reduced one against the fastest library.
_FULL = {"C1": 30.0, "D1": 10.0}
_REDUCED, _REDUCED_ANY_LAYUP, _REDUCED_MASS = 1000.0, 300.0, 200.0
_FULL_ANY_LAYUP_MS = 6.0
_DERIVATIVES = 2.0
_REDUCTION_ERROR = 1e-4
_BUILDING_S, _BUILDING_MIB = 15.0, 1024.0


@dataclass(frozen=True, slots=True)
class Target:
    """One figure. at_least : whether more is better. reach : the target, ``None`` if there is none."""

    case: str
    what: str
    unit: str
    found: float
    reach: float | None
    at_least: bool = False
    against: str = ""

    @property
    def reached(self) -> bool | None:
        """Whether the target is met; ``None`` if there is none."""
        if self.reach is None:
            return None
        return self.found >= self.reach if self.at_least else self.found <= self.reach


def speeds(case: Case, entries: Iterable[Entry], times: Times, accuracy: float) -> Iterator[Target]:
    """Times of a case against those of the accurate peers on its plate.

    entries : of all cases. times : by case and solver, s per parameter set, (rounds,). A case with another
    layup or a mass is compared with the peers on the bare plate, which are as much work for them.
    """
    good = [e for e in entries if e.case == case.plate and e.is_peer and (e.error or 0.0) <= accuracy]
    # First against peers that solve the same five fields, then against all.
    for peers in ([e for e in good if BENDING not in e.solver], good):
        if case.name in _FULL and peers:
            yield _faster(case, FULL, "a full solve", _FULL[case.name], peers, times)
        libraries = [e for e in peers if not e.solver.startswith(POLYNOMIAL)]
        reach = _REDUCED_ANY_LAYUP if case.any_layup else _REDUCED_MASS if case.mass else _REDUCED
        if libraries:
            yield _faster(case, REDUCED, f"a reduced solve in {STACK}", reach, libraries, times)
    if case.any_layup:
        median = 1e3 * float(np.nanmedian(times[case.name, FULL]))
        yield Target(case.name, "a full solve", "ms", median, _FULL_ANY_LAYUP_MS)
    own = times[case.name, REDUCED]
    with_derivatives = ratio(times[case.name, REDUCED_DERIVATIVES], own).median
    yield Target(case.name, "with derivatives", "times reduced", with_derivatives, _DERIVATIVES)
    limit = ratio(own, times[case.name, LAPACK_REDUCED]).median
    yield Target(case.name, "a reduced solve", "times LAPACK", limit, None)


def models(case: str, reduction_error: float, seconds: float, peak_mib: float | None) -> Iterator[Target]:
    """Accuracy and cost of building the reduced model of a case."""
    yield Target(case, "worst error of the reduction", "", reduction_error, _REDUCTION_ERROR)
    yield Target(case, "building the reduced model", "s", seconds, _BUILDING_S)
    if peak_mib is not None:
        yield Target(case, "building the reduced model", "MiB", peak_mib, _BUILDING_MIB)


def _faster(case: Case, solver: str, what: str, reach: float, peers: list[Entry], times: Times) -> Target:
    fastest = min(peers, key=lambda e: float(np.nanmedian(times[e.key])))
    found = ratio(times[fastest.key], times[case.name, solver]).median
    return Target(case.name, what, "times faster", found, reach, at_least=True, against=fastest.solver)
