"""The coin test: was a mass stuck to the plate between two lists, how heavy, where? The question `prove`."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.batches.plate_row import local_likelihood
from cpam_bayes.command import PLATE, TIME_LIMIT, Command, option
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import fixed, listed, significant, with_spread
from cpam_bayes.forward_model.labels import labelled_model, list_order
from cpam_bayes.forward_model.preconditions import rectangular_only, require_seed, require_supported
from cpam_bayes.identification.added_mass import (
    AddedMass,
    Finding,
    LoadedPlate,
    Repeatability,
    cells_of,
    detection_limit,
    find_mass,
    loaded_plate,
    predicted_shifts,
)
from cpam_bayes.identification.search import required
from cpam_bayes.plate import Measurement, Plate, PlateLike, Specimen, read_plate
from cpam_bayes.plate.text import decode, parse, read_regular_file
from cpam_bayes.questions.identify.pso import PointResult, identify
from cpam_bayes.render.figures import MEASURED, PREDICTED
from cpam_bayes.render.plate import PLATE as DRAWING
from cpam_bayes.render.plate import plate_figure, plate_section
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Column,
    Drawing,
    Report,
    Rows,
    Section,
    Summary,
    facts,
    plate_keys,
)
from cpam_bayes.result import PlateResult, present, within_time
from cpam_bayes.running import SILENT, Watch

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Coin", "CoinResult", "prove"]

Array = NDArray[Any]
ListLike: TypeAlias = str | os.PathLike[str] | Sequence[float]
"""A further list of the plate: a table, a TOML file with frequencies_hz, or the frequencies in Hz."""

_MOST_LISTS: Final = 50
# Draws of the constants that the first list leaves open.
_DRAWS: Final = 12
# How well plates are weighed and gauged where the file does not say, relative.
_WEIGHED, _THICKNESS, _DENSITY = 0.002, 0.01, 0.01
_GRAM, _MILLIMETRE = 1e3, 1e3
# Probability above which a claim is written as nearly certain.
_SURE: Final = 0.9995
_SEALED_KEYS: Final = ("mass_g", "x_mm", "y_mm")


@dataclass(frozen=True, slots=True)
class Stated:
    """The content of the seal, SI. shifts, sd : (n,) of ln f' - ln f that the first list predicts for it."""

    mass: float
    place: tuple[float, float]
    shifts: Array
    sd: Array


@dataclass(frozen=True, slots=True)
class Coin:
    """One further list. name : of its file; found : what it says; shifts : (n,) ln f' - ln f, measured."""

    name: str
    found: AddedMass
    shifts: Array
    stated: Stated | None

    @property
    def distance(self) -> float | None:
        """From the stated place to the one that was found, or its nearest mirror image, m."""
        if self.stated is None or not self.stated.mass or self.found.finding is not Finding.ADDED:
            return None
        return self.found.distance(*self.stated.place)

    @property
    def is_inside(self) -> bool | None:
        """Whether the 95 % interval holds the stated mass; of a list without one, that none is claimed."""
        if self.stated is None:
            return None
        if not self.stated.mass:
            return self.found.finding is not Finding.ADDED
        low, high = self.found.interval
        return low <= self.stated.mass <= high

    @property
    def shifts_inside(self) -> int | None:
        """Number of shifts within the 95 % intervals that the first list and the seal predict."""
        if self.stated is None:
            return None
        return int(np.sum(np.abs(self.shifts - self.stated.shifts) <= 1.96 * self.stated.sd))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CoinResult(PlateResult):
    """The mass stuck to a plate after its first list, by each further list.

    Attributes
    ----------
    coins : in the order of the lists
    hash : SHA-256 of the sealed file as it was before the answer, "" without one
    detection_limit : mass that is claimed with 95 % probability, kg; None where none is
    point : the identification from the first list
    """

    command: ClassVar[str] = "prove"

    coins: tuple[Coin, ...]
    hash: str
    detection_limit: float | None
    point: PointResult

    @property
    def coverage(self) -> Mapping[str, float] | None:
        """Shares of masses and of shifts inside their 95 % intervals; None without a seal."""
        inside = [coin.is_inside for coin in self.coins if coin.is_inside is not None]
        if not inside:
            return None
        shifts = [(coin.shifts_inside or 0) / len(coin.shifts) for coin in self.coins]
        return {"mass": float(np.mean(inside)), "shifts": float(np.mean(shifts))}


@checked
@within_time
def prove(
    plate: PlateLike,
    *lists: ListLike,
    sealed: str | os.PathLike[str] | None = None,
    seed: int = 0,
    watch: Watch = SILENT,
) -> CoinResult:
    """The mass and place of what was stuck to a plate after its first list was measured.

    Parameters
    ----------
    plate : what `read_plate` takes, with the list without the mass
    lists : each with one mass: a table, a TOML file with frequencies_hz, or frequencies in Hz; of the same
        modes as the first list
    sealed : a TOML file with a [[coin]] for each list: mass_g, x_mm, y_mm. Its SHA-256 is shown first, and it
        is opened after the answer; mass_g = 0 is a list without a mass
    watch : display of the progress; none where left out

    Raises
    ------
    ValueError
        If the plate, a list or the seal cannot be read, or the lists are of different lengths.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> with_coin = [101.1, 309.4, 340.5, 361.2, 386.2, 607.6]
    >>> result = cb.prove("C1", with_coin)
    >>> result.coins[0].found.finding.value in ("mass added", "undecided")
    True
    """
    require_seed(seed)
    if not 1 <= len(lists) <= _MOST_LISTS:
        raise ValueError(
            f"lists: received {len(lists) or 'none'}, accepted: one or more, {_MOST_LISTS} at most"
        )
    specimen = require_supported(read_plate(plate), rectangular_only("prove"))
    first, _ = required(specimen)
    _require_complete(specimen, first)
    further = [_list_of(given, specimen, first) for given in lists]
    seal, digest = _seal(sealed, len(lists), specimen.plate)
    if digest:
        watch.announce(f"SHA-256 of the seal: {digest}")
    point = identify(specimen, seed=seed, residuals="relative", watch=watch)
    watch.announce(f"prove {specimen.name}: where a mass gives these shifts")
    rng = np.random.default_rng(seed)
    loaded = _loaded(point, rng)
    whole = cells_of(loaded)
    coins = []
    for name, measurement in further:
        d = np.log(measurement.frequencies / first.frequencies)
        noise = _repeatability(first, measurement)
        coins.append(Coin(name, find_mass(loaded, whole, d, noise, rng), d, None))
    level = float(np.median([coin.found.noise for coin in coins]))
    rounding = _repeatability(first, further[0][1]).rounding
    limit = detection_limit(loaded, whole, level, rounding, rng)
    if seal:
        coins = [
            replace(coin, stated=_stated(loaded, coin, held, first, measurement))
            for coin, held, (_, measurement) in zip(coins, seal, further, strict=True)
        ]
    return CoinResult(
        seed=seed,
        notices=tuple(n for n in point.notices if n.severity == "slip"),
        specimen=specimen,
        air_shifts=point.air_shifts,
        coins=tuple(coins),
        hash=digest,
        detection_limit=limit,
        point=point,
    )


def _require_complete(specimen: Specimen, first: Measurement) -> None:
    if not first.complete:
        raise PlateFileError(
            f"{specimen.source}: measurement.complete is false; prove compares lists mode by mode: "
            "give lists in which no mode is missing, as far as they reach"
        )


def _list_of(given: ListLike, specimen: Specimen, first: Measurement) -> tuple[str, Measurement]:
    """The name of a further list, and what it says; noise that it does not state is that of the first."""
    if isinstance(given, str | os.PathLike):
        name = os.fspath(given)
        if Path(name).suffix.casefold() == ".toml":
            content = dict(parse(decode(read_regular_file(name, name, "a list"), name), name))
            if "plate" in content:
                found = read_plate(name).measurement
                if found is None:
                    raise PlateFileError(f"{name}: [measurement] is missing, the list with the mass")
                return name, _of_as_many(name, found, first)
            stated = content.get("measurement", content)
        else:
            stated = {"table": str(Path(name).absolute())}
    else:
        name, stated = "list", {"frequencies_hz": [float(f) for f in given]}
    plate = specimen.plate
    stub = {
        "name": name,
        "plate": {
            "length_mm": _MILLIMETRE * plate.length,
            "width_mm": _MILLIMETRE * plate.width,
            "thickness_mm": _MILLIMETRE * plate.thickness,
            "density_kg_m3": plate.density,
            "edges": plate.edges,
        },
        "material": {"isotropic": True, "E1_GPa": 70.0, "nu12": 0.3},
        "measurement": stated,
    }
    found = read_plate(stub).measurement
    assert found is not None
    return name, _of_as_many(name, found, first)


def _of_as_many(name: str, found: Measurement, first: Measurement) -> Measurement:
    if found.size != first.size:
        raise PlateFileError(
            f"{name}: {found.size} frequencies, while the first list has {first.size}; "
            "give the same modes in both"
        )
    unstated = found.relative_std is None and found.frequency_sd is None
    return replace(
        found,
        resolution=found.resolution or first.resolution,
        relative_std=first.relative_std if unstated else found.relative_std,
        frequency_sd=first.frequency_sd if unstated else found.frequency_sd,
    )


def _seal(
    sealed: str | os.PathLike[str] | None, n: int, plate: Plate
) -> tuple[tuple[tuple[float, float, float], ...], str]:
    """Masses and places of the sealed file, SI, and its SHA-256."""
    if sealed is None:
        return (), ""
    source = os.fspath(sealed)
    content = read_regular_file(source, source, "a sealed file")
    coins = parse(decode(content, source), source).get("coin")
    if not isinstance(coins, list) or len(coins) != n:
        count = len(coins) if isinstance(coins, list) else 0
        raise PlateFileError(
            f"{source}: {count} tables [[coin]], accepted: {n}, one for each list, in their order"
        )
    found = []
    sides = (_MILLIMETRE * plate.length, _MILLIMETRE * plate.width)
    for i, coin in enumerate(coins, 1):
        values = [coin.get(key, 0.0 if coin.get("mass_g") == 0 else None) for key in _SEALED_KEYS]
        if any(isinstance(v, bool) or not isinstance(v, int | float) for v in values) or len(coin) > 3:
            raise PlateFileError(
                f"{source}: [[coin]] {i}: accepted: {listed(_SEALED_KEYS, 'and')}, a number each"
            )
        mass, x, y = (float(v) for v in values)
        if not (mass >= 0.0 and 0.0 <= x <= sides[0] and 0.0 <= y <= sides[1]):
            raise PlateFileError(
                f"{source}: [[coin]] {i}: received {mass:g} g at ({x:g}, {y:g}) mm, accepted: 0 g or more "
                f"on the plate of {sides[0]:g} x {sides[1]:g} mm"
            )
        found.append((mass / _GRAM, x / _MILLIMETRE, y / _MILLIMETRE))
    return tuple(found), hashlib.sha256(content).hexdigest()


def _loaded(point: PointResult, rng: np.random.Generator) -> LoadedPlate:
    """The modes of the identified plate, and their scatter over what its list leaves open."""
    estimate, specimen = point.estimate, point.specimen
    measurement, unknowns = required(specimen)
    likelihood = local_likelihood(estimate)
    best = np.array(likelihood.at)
    prior = np.array([unknowns[name].prior.sd for name in likelihood.names])
    # in units of the priors: constants differ by many orders of magnitude
    inner = np.array(likelihood.information) * np.outer(prior, prior) + np.eye(len(prior))
    lam, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    root = vectors / np.sqrt(np.maximum(lam, 1.0))
    draws = best + prior * (rng.standard_normal((4 * _DRAWS, len(best))) @ root.T)
    draws = np.clip(draws, unknowns.lower, unknowns.upper)
    model = estimate.model.full
    draws = draws[model.admissible(draws)][:_DRAWS]
    order = list_order(labelled_model(estimate.model, measurement, specimen), best)[: measurement.size]
    plate = specimen.plate
    if plate.mass is not None:
        sd = plate.sd.get("mass", _WEIGHED * plate.mass) / plate.mass
    else:
        of_density = plate.sd.get("density", _DENSITY * plate.density) / plate.density
        sd = float(
            np.hypot(of_density, plate.sd.get("thickness", _THICKNESS * plate.thickness) / plate.thickness)
        )
    mass = plate.density * plate.length * plate.width * plate.thickness
    return loaded_plate(model, best, draws, order, (plate.length, plate.width), (mass, sd))


def _repeatability(first: Measurement, second: Measurement) -> Repeatability:
    """The repeatability of both lists together, as that of each."""
    stated = [
        m.noise_sd(m.relative_std or 0.0) / m.frequencies
        for m in (first, second)
        if m.relative_std is not None or m.frequency_sd is not None
    ]
    rounding = [m.resolution / np.sqrt(12.0) / m.frequencies for m in (first, second)]
    relative = None if len(stated) < 2 else np.hypot(*stated) / np.sqrt(2.0)
    return Repeatability(relative, np.hypot(*rounding) / np.sqrt(2.0))


def _stated(
    plate: LoadedPlate,
    coin: Coin,
    held: tuple[float, float, float],
    first: Measurement,
    second: Measurement,
) -> Stated:
    mass, *place = held
    noise = _repeatability(first, second)
    relative = np.full(first.size, coin.found.noise) if noise.relative is None else noise.relative
    shifts, sd = predicted_shifts(plate, mass, (place[0], place[1]), relative, noise.rounding)
    return Stated(mass, (place[0], place[1]), shifts, sd)


def _grams(coin: Coin) -> str:
    found = coin.found
    if found.finding is Finding.NOTHING:
        return f"none; less than {significant(_GRAM * found.interval[1], 2)}"
    if found.finding is Finding.OTHER:
        return "no mass explains the list"
    shown = " +- ".join(with_spread(_GRAM * found.mass, _GRAM * found.sd))
    return shown if found.finding is Finding.ADDED else f"perhaps {shown}"


def _where(place: tuple[float, float]) -> str:
    return f"({fixed(_MILLIMETRE * place[0], 0)}, {fixed(_MILLIMETRE * place[1], 0)})"


def _is_added(coin: Coin) -> bool:
    return coin.found.finding is Finding.ADDED


def _if_added(of: Any) -> Any:
    return lambda coin: of(coin.found) if _is_added(coin) else None


_COLUMNS: Final = (
    Column("list", "list", lambda c: Path(c.name).name),
    Column(None, "finding", lambda c: c.found.finding.value),
    Column("found, g", None, _grams),
    Column("at, mm", None, _if_added(lambda f: _where(f.place))),
    Column(
        "within, mm", "radius_mm", _if_added(lambda f: _MILLIMETRE * f.radius), "{:.0f}".format, number=True
    ),
    Column(None, "found_g", _if_added(lambda f: _GRAM * f.mass)),
    Column(None, "sd_g", _if_added(lambda f: _GRAM * f.sd)),
    Column(None, "q025_g", lambda c: _GRAM * c.found.interval[0] if _is_added(c) else 0.0),
    Column(None, "q975_g", lambda c: _GRAM * c.found.interval[1]),
    Column(None, "x_mm", _if_added(lambda f: _MILLIMETRE * f.place[0])),
    Column(None, "y_mm", _if_added(lambda f: _MILLIMETRE * f.place[1])),
    Column(None, "probability", lambda c: c.found.probability),
    Column("stated, g", "stated_g", lambda c: c.stated and _GRAM * c.stated.mass, significant, number=True),
    Column(
        "off, mm",
        "distance_mm",
        lambda c: None if c.distance is None else _MILLIMETRE * c.distance,
        "{:.0f}".format,
        number=True,
    ),
    Column(
        "shifts inside",
        "shifts_inside",
        lambda c: c.shifts_inside,
        number=True,
    ),
    Column(None, "shifts", lambda c: len(c.shifts)),
)


@present.register
def _present(result: CoinResult) -> Report:
    """The mass found, the mass stated, and their agreement."""
    rows = Rows("coins", _COLUMNS, result.coins, lambda c: c.is_inside is False)
    limit = result.detection_limit
    return Report(
        summary=Summary(
            title=f"prove {result.title}",
            headline=_headline(result),
            tables=(rows.table("Lists after the first"),),
            lines=(
                *_agreement(result),
                "Detection limit here: "
                + ("no mass is found with 95 % probability." if limit is None else f"{_limit(limit)}."),
                *(("No list tells a place from its mirror images.",) if _has_images(result) else ()),
            ),
            next_step=""
            if result.hash
            else "seal mass and place in a file before the answer.  --sealed FILE",
            slips=result.slips,
            warnings=result.cautions,
        ),
        sections=(
            Section("Certificate", (facts("Coin test", _certificate(result)),), (DRAWING,), folded=False),
            replace(plate_section(result.specimen, result.air_shifts), figures=()),
            Section(COMPUTATION, (_computation(result),)),
        ),
        document={
            **plate_keys(result.command, result.seed, result.specimen),
            "hash": result.hash or None,
            "coins": [
                {**record, "hash": result.hash or None, "images_mm": _images(coin)}
                for record, coin in zip(rows.records(), result.coins, strict=True)
            ],
            "detection_limit_g": None if limit is None else _GRAM * limit,
            "coverage": result.coverage,
            "warnings": list(result.warnings),
        },
        drawings=(Drawing(DRAWING, partial(_drawn, result), _CAPTION),),
        rows=(rows,),
    )


def _limit(limit: float) -> str:
    return f"{significant(_GRAM * limit, 2)} g"


def _has_images(result: CoinResult) -> bool:
    return any(_is_added(coin) and coin.found.images for coin in result.coins)


def _images(coin: Coin) -> list[list[float]]:
    places = coin.found.images if _is_added(coin) else ()
    return [[_MILLIMETRE * x, _MILLIMETRE * y] for x, y in places]


def _headline(result: CoinResult) -> str:
    if len(result.coins) > 1:
        claimed = sum(_is_added(coin) for coin in result.coins)
        said = f"A mass was found in {claimed} of {len(result.coins)} lists"
        inside = [coin.is_inside for coin in result.coins if coin.is_inside is not None]
        more = f"; {sum(inside)} of {len(inside)} answers hold the sealed mass" if inside else ""
        return f"{said}{more}."
    (coin,) = result.coins
    found, stated = coin.found, coin.stated
    if found.finding is Finding.OTHER:
        return "The lists differ by more than noise and a mass explain: something else changed."
    if found.finding is Finding.NOTHING:
        sealed = "" if stated is None else f"; the seal says {significant(_GRAM * stated.mass, 3)} g"
        return f"Nothing of {significant(_GRAM * found.interval[1], 2)} g or more was added{sealed}."
    shown = f"{_grams(coin)} g"
    if stated is not None:
        off = "" if coin.distance is None else f", {fixed(_MILLIMETRE * coin.distance, 0)} mm off"
        return (
            f"{shown} was found for {significant(_GRAM * stated.mass, 3)} g{off}; {coin.shifts_inside} of "
            f"{len(coin.shifts)} shifts lie inside their 95 % intervals."
        )
    sure = "> 0.999" if found.probability > _SURE else fixed(found.probability, 3)
    return f"{shown} was added at {_where(found.place)} mm (probability {sure})."


def _agreement(result: CoinResult) -> tuple[str, ...]:
    """Agreement of several coins: coverage, and found over stated masses, a check of weight and sizes."""
    known = [c for c in result.coins if c.stated is not None and c.stated.mass and _is_added(c)]
    coverage = result.coverage
    if coverage is None or len(result.coins) < 2:
        return ()
    said = [f"{100 * coverage['shifts']:.0f} % of the shifts lie inside their 95 % intervals."]
    if known:
        ratio = np.array([c.found.mass / c.stated.mass for c in known if c.stated])
        weight = np.array([(c.stated.mass / c.found.sd) ** 2 for c in known if c.stated])
        mean, sd = float(weight @ ratio / weight.sum()), float(weight.sum() ** -0.5)
        said.append(
            f"Found over sealed masses: {' +- '.join(with_spread(mean, sd))}; "
            "1 where the plate's mass is right."
        )
    return tuple(said)


def _certificate(result: CoinResult) -> tuple[tuple[str, str], ...]:
    rows = [("plate", result.specimen.name), ("answer", _headline(result))]
    if result.hash:
        rows.append(("SHA-256 of the seal, shown before the answer", result.hash))
    for coin in result.coins:
        stated = ""
        if coin.stated is not None:
            stated = (
                f"; sealed: {significant(_GRAM * coin.stated.mass, 3)} g at {_where(coin.stated.place)} mm"
            )
        at = f" at {_where(coin.found.place)} mm" if _is_added(coin) else ""
        rows.append((Path(coin.name).name, f"{_grams(coin)} g{at}{stated}"))
    limit = result.detection_limit
    rows.append(("detection limit", "none" if limit is None else _limit(limit)))
    return tuple(rows)


def _computation(result: CoinResult) -> Any:
    noise = significant(100.0 * float(np.median([c.found.noise for c in result.coins])), 2)
    fit = significant(100.0 * result.point.estimate.rms, 2)
    return facts(
        "Computation",
        (
            ("modes", f"of the plate as identified from the first list, fit {fit} %"),
            ("shifts", "of a point mass, radius of gyration 2.5 to 8.5 mm; 2 % of each for its form"),
            ("repeatability", f"{noise} % of a frequency in each list"),
            ("prior", "0.5 for nothing; else 0.05 to 15 % of the plate's mass, even in its logarithm"),
            ("detection limit", "claimed in 95 % of simulated lists, but for the fifth of the plate where a "
             "mass shows least"),
        ),
    )  # fmt: skip


_CAPTION: Final = Caption(
    "Dots: where each mass may be, among them its mirror images. Crosses: what the seal says.",
    "The plate with the places that the lists allow for each mass, and the sealed ones.",
)


def _drawn(result: CoinResult) -> Figure:
    def overlay(axes: Axes, _: int) -> None:
        for coin in result.coins:
            if not _is_added(coin):
                continue
            x, y = _MILLIMETRE * coin.found.draws[::8, 1:].T
            axes.plot(x, y, ".", color=PREDICTED, markersize=1.5, alpha=0.4, rasterized=True)
            if coin.stated is not None and coin.stated.mass:
                at = (_MILLIMETRE * v for v in coin.stated.place)
                axes.plot(*at, "x", color=MEASURED, markersize=8, markeredgewidth=2)

    return plate_figure((result.specimen,), overlay)


COMMAND: Final = Command(
    prove,
    (
        PLATE,
        option(
            "lists",
            nargs="+",
            metavar="LIST",
            help="table or TOML file of the plate's frequencies with a mass on it",
        ),
        option(
            "--sealed",
            metavar="FILE",
            help="masses and places, a [[coin]] for each LIST: its SHA-256 is shown first, it is opened last",
        ),
        TIME_LIMIT,
    ),
)
