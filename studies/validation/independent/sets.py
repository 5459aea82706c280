"""The sets of the claims benchmark: for tuning, for the final figures, and the rows of known failures.

They differ in seeds and in plates. Every list depends on its set and its name alone. The order is random, so
that any first part of a set is a fair sample of it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.independent import lists
from validation.independent.lists import NominalPlate, Truth, UnreachableError
from validation.independent.true_plate import FLAWS, TruePlate, modes, natural_frequencies

Array = NDArray[np.float64]
Made = tuple[str, Truth]

RATIOS = (4.0, 8.0, 16.0, 32.0, 100.0)
# Pairs of causes that a laboratory may well have at once.
PAIRS = (
    ("sensor_mass", "warp"),
    ("taper_x", "membrane_stress"),
    ("misorientation", "sensor_mass"),
    ("sensor_mass", "damage"),
    ("clamp_rotation", "sensor_mass"),
    ("skew", "sensor_mass"),
    ("taper_y", "misorientation"),
    ("clamp_translation", "warp"),
    ("soft_clamp", "taper_y"),
)
# Shares of lists whose file states no repeatability.
_UNSTATED = 1 / 3
# Two modes coincide within this fraction of their frequency.
_COINCIDE = 2e-3
# Lists of each row of known failures.
PER_ROW = 20


@dataclass(frozen=True, slots=True)
class Plan:
    """One list to be made: its name, the plates it may be of, and how."""

    name: str
    plates: tuple[NominalPlate, ...]
    make: Callable[[NominalPlate, np.random.Generator], Made]


@dataclass(frozen=True, slots=True)
class BenchmarkSet:
    """A set: its plates, its seed and how many lists of each kind."""

    name: str
    seed: int
    plates: tuple[NominalPlate, ...]
    clean: int = 0
    prior: int = 0
    smooth: int = 0
    two: int = 0
    incomplete: int = 0
    coincident: int = 0
    per_cell: int = 0
    rows: int = 0


SETS = {
    "tuning": BenchmarkSet(
        "tuning", 101, lists.TUNING, clean=24, prior=16, smooth=12, two=10, incomplete=10, coincident=4,
        per_cell=1,
    ),
    "final": BenchmarkSet(
        "final", 2027, lists.FINAL, clean=40, prior=30, smooth=20, two=16, incomplete=16, coincident=6,
        per_cell=1,
    ),
    "rows": BenchmarkSet("rows", 733, lists.ROWS, rows=PER_ROW),
}  # fmt: skip


def made(benchmark: BenchmarkSet) -> Iterator[dict[str, Any]]:
    """The lists of a set, one record each: id, file and truth; those out of reach with the reason."""
    plans = planned(benchmark)
    order = np.random.default_rng(benchmark.seed).permutation(len(plans))
    for i in order:
        yield make(benchmark, plans[i])


def make(benchmark: BenchmarkSet, plan: Plan) -> dict[str, Any]:
    """One list: on the first of its plates, in random order, on which it can be."""
    rng = np.random.default_rng([benchmark.seed, zlib.crc32(plan.name.encode())])
    why = ""
    for k in rng.permutation(len(plan.plates)):
        try:
            text, truth = plan.make(plan.plates[k], rng)
        except UnreachableError as error:
            why = str(error)
            continue
        return {"id": plan.name, "set": benchmark.name, "file": text, "truth": asdict(truth)}
    return {"id": plan.name, "set": benchmark.name, "unreachable": why}


def planned(benchmark: BenchmarkSet) -> list[Plan]:
    """All lists of a set."""
    plans = [*_clean(benchmark), *_single(benchmark), *_others(benchmark)]
    if benchmark.rows:
        plans += [plan for k in range(benchmark.rows) for plan in _rows(benchmark.plates, k)]
    return plans


def line_of(record: dict[str, Any]) -> str:
    """A record as a line of JSON, numbers in six digits."""
    return json.dumps(_short(record), allow_nan=False) + "\n"


def _short(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {k: _short(v) for k, v in value.items()}
    return [_short(v) for v in value] if isinstance(value, list | tuple) else value


def _stated(rng: np.random.Generator) -> bool:
    return bool(rng.random() > _UNSTATED)


def _clean(benchmark: BenchmarkSet) -> Iterator[Plan]:
    def make_clean(plate: NominalPlate, rng: np.random.Generator) -> Made:
        return lists.listed(plate, plate.drawn(rng), "clean", {}, rng, stated=_stated(rng))

    for k in range(benchmark.clean):
        yield Plan(f"clean-{k:02d}", (benchmark.plates[k % len(benchmark.plates)],), make_clean)
    for k in range(benchmark.coincident):
        yield Plan(f"coincident-{k:02d}", benchmark.plates, _coincident)


def _single(benchmark: BenchmarkSet) -> Iterator[Plan]:
    """Each cause at each signal to noise; list errors and another material, too."""
    for k in range(benchmark.per_cell):
        for cause, flaw in FLAWS.items():
            on = tuple(p for p in benchmark.plates if flaw.applies(p.plate))
            for ratio in RATIOS:

                def one(p: NominalPlate, g: np.random.Generator, c: str = cause, r: float = ratio) -> Made:
                    return lists.single(p, c, r, g, stated=_stated(g))

                yield Plan(f"{cause}-{ratio:g}-{k}", on, one)
        for ratio in RATIOS:

            def wrong(p: NominalPlate, g: np.random.Generator, r: float = ratio) -> Made:
                return lists.misread(p, r, g, stated=_stated(g))

            yield Plan(f"outlier-{ratio:g}-{k}", benchmark.plates, wrong)
        for i in range(4):
            yield Plan(f"mode_identity-{k}-{i}", benchmark.plates, _missed)
        for i in range(2):
            yield Plan(f"material-{k}-{i}", tuple(p for p in benchmark.plates if p.known), _other_material)


def _others(benchmark: BenchmarkSet) -> Iterator[Plan]:
    for k in range(benchmark.prior):
        cause = list(FLAWS)[(7 * k) % len(FLAWS)]
        on = tuple(p for p in benchmark.plates if FLAWS[cause].applies(p.plate))

        def prior(p: NominalPlate, g: np.random.Generator, c: str = cause) -> Made:
            return lists.single(p, c, None, g, kind="prior", stated=_stated(g))

        yield Plan(f"prior-{k:02d}-{cause}", on, prior)
    for k in range(benchmark.smooth):

        def smooth(p: NominalPlate, g: np.random.Generator, r: float = (8.0, 16.0, 32.0)[k % 3]) -> Made:
            return lists.smooth(p, r, g, stated=_stated(g))

        yield Plan(f"smooth-{k:02d}", (benchmark.plates[k % len(benchmark.plates)],), smooth)
    for k in range(benchmark.two):
        both = PAIRS[k % len(PAIRS)]
        on = tuple(p for p in benchmark.plates if all(FLAWS[c].applies(p.plate) for c in both))

        def two(
            p: NominalPlate,
            g: np.random.Generator,
            c: tuple[str, str] = both,
            r: float = (8.0, 16.0, 32.0)[k % 3],
        ) -> Made:
            return lists.pair(p, c, r, g, stated=_stated(g))

        yield Plan(f"two-{k:02d}", on, two)
    for k in range(benchmark.incomplete):
        yield Plan(f"incomplete-{k:02d}", benchmark.plates, _incomplete(k))


def _incomplete(k: int) -> Callable[[NominalPlate, np.random.Generator], Made]:
    """Incomplete lists that say so: every second one is of a plate with a cause at 16 times the noise."""

    def make_incomplete(plate: NominalPlate, rng: np.random.Generator) -> Made:
        missed = sorted(int(i) for i in rng.choice(plate.n_modes, size=1 + k % 2, replace=False))
        how: dict[str, Any] = {"missed": missed, "complete": False, "stated": _stated(rng)}
        if k % 2:
            return lists.listed(plate, plate.drawn(rng), "incomplete, clean", {}, rng, **how)
        cause = str(rng.choice(["sensor_mass", "warp", "taper_y", "membrane_stress"]))
        return lists.single(plate, cause, 16.0, rng, kind="incomplete", **how)

    return make_incomplete


def _missed(plate: NominalPlate, rng: np.random.Generator) -> Made:
    """A mode that the laboratory did not see and does not know of."""
    k = int(rng.integers(plate.n_modes))
    return lists.listed(
        plate, plate.drawn(rng), "one", {}, rng, missed=[k], causes=("mode_identity",), stated=_stated(rng)
    )


def _other_material(plate: NominalPlate, rng: np.random.Generator) -> Made:
    """Two constants 4 to 8 standard deviations from the reference that the file trusts."""
    constants = dict(plate.drawn(rng).constants)
    moved = rng.choice(len(plate.constants), size=min(2, len(constants)), replace=False)
    for i in moved:
        name = plate.constants[int(i)]
        low, high = plate.bounds[name]
        step = float(rng.choice((-1.0, 1.0)) * rng.uniform(4.0, 8.0)) * lists.REFERENCE_SD
        value = plate.plate.constants[name] * (1.0 + step)
        constants[name] = float(np.clip(value, low * 1.02, high * 0.98))
    other = replace(plate.plate, constants=constants)
    return lists.listed(plate, other, "one", {}, rng, causes=("material",), stated=_stated(rng))


def _coincident(plate: NominalPlate, rng: np.random.Generator) -> Made:
    """A clean list in which two modes of other shapes nearly coincide: a constant is moved until they do."""
    for _ in range(6):
        drawn = plate.drawn(rng)
        for name in (n for n in plate.constants if n != "nu12"):
            coincident = _meeting(plate, drawn, name)
            if coincident is not None:
                return lists.listed(plate, coincident, "coincident", {}, rng, stated=_stated(rng))
    raise UnreachableError(f"no two modes of {plate.name} meet within the constants' range")


def _meeting(plate: NominalPlate, drawn: TruePlate, name: str) -> TruePlate | None:
    """The plate with a constant at which two of its modes exchange places."""
    coarse = replace(drawn, mesh=8)
    values = drawn.constants[name] * np.linspace(0.88, 1.12, 7)
    low, high = plate.bounds[name]

    def at(value: float) -> TruePlate:
        return replace(coarse, constants={**drawn.constants, name: float(value)})

    gaps = []
    for value in values:
        f = natural_frequencies(at(value), plate.n_modes)
        gaps.append(np.diff(np.log(f)))
    smallest = np.array(gaps)
    inner = smallest[1:-1]
    dips = (inner < smallest[:-2]) & (inner < smallest[2:]) & (inner < 0.02)
    for i, j in zip(*np.nonzero(dips), strict=True):
        a, b = float(values[i]), float(values[i + 2])
        best = _golden(lambda v, j=j: float(np.diff(np.log(modes(at(v), plate.n_modes)[0]))[j]), a, b)  # type: ignore[misc]
        if best[1] < _COINCIDE and low < best[0] < high:
            return replace(drawn, constants={**drawn.constants, name: best[0]})
    return None


def _golden(function: Callable[[float], float], a: float, b: float, steps: int = 12) -> tuple[float, float]:
    """The minimum of a function between a and b by golden sections."""
    ratio = (np.sqrt(5.0) - 1.0) / 2.0
    c, d = b - ratio * (b - a), a + ratio * (b - a)
    fc, fd = function(c), function(d)
    for _ in range(steps):
        if fc < fd:
            b, d, fd = d, c, fc
            c = b - ratio * (b - a)
            fc = function(c)
        else:
            a, c, fc = c, d, fd
            d = a + ratio * (b - a)
            fd = function(d)
    return (c, fc) if fc < fd else (d, fd)


def _rows(plates: Sequence[NominalPlate], k: int) -> Iterator[Plan]:
    """The rows of known failures; plates: one of plies of one direction, one clamped, one square."""
    one_way, clamped, square = plates

    def row(name: str, on: Sequence[NominalPlate], make_one: Callable[..., Made]) -> Plan:
        return Plan(f"{name}-{k:02d}", (on[k % len(on)],), make_one)

    def sized(cause: str, low: float, high: float, *, signed: bool) -> Callable[..., Made]:
        def make_one(p: NominalPlate, g: np.random.Generator) -> Made:
            size = float(g.uniform(low, high)) * (float(g.choice((-1.0, 1.0))) if signed else 1.0)
            stated = bool(k // 2 % 2)
            return lists.single(p, cause, None, g, kind="row", size=size, stated=stated)

        return make_one

    def corner(p: NominalPlate, g: np.random.Generator) -> Made:
        """2 to 5 grams at a corner or anywhere."""
        grams = float(g.uniform(2e-3, 5e-3))
        aux = None
        if k % 2:
            aux = {"x": float(g.choice((0.03, 0.97))), "y": float(g.choice((0.03, 0.97)))}
        size = grams / p.plate.total_mass
        return lists.single(p, "sensor_mass", None, g, kind="row", size=size, aux=aux)

    def smooth(p: NominalPlate, g: np.random.Generator) -> Made:
        return lists.smooth(p, 8.0, g, stated=bool(k // 2 % 2))

    def missed(p: NominalPlate, g: np.random.Generator) -> Made:
        return _missed(p, g)

    yield row("accelerometer", (one_way, clamped), sized("sensor_mass", 0.01, 0.05, signed=False))
    yield row("plies-turned", (one_way,), sized("misorientation", 4.0, 15.0, signed=True))
    yield row("missed-mode", (one_way, clamped, square), missed)
    yield row("grams-off-grid", (one_way, square), corner)
    yield row("large-stress", (one_way, square), sized("membrane_stress", 1.0e6, 3.0e6, signed=True))
    yield row("softer-patch", (one_way, clamped), sized("damage", 0.3, 0.8, signed=False))
    yield row("soft-clamp", (clamped,), sized("soft_clamp", 1.0, 10.0, signed=False))
    yield row("tapered", (clamped, one_way), sized("taper_x", 0.05, 0.25, signed=True))
    yield row("smooth", (one_way, clamped, square), smooth)
    yield Plan(f"coincident-{k:02d}", tuple(plates), _coincident)
