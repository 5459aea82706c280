"""The coin test: was a mass stuck to the plate between two lists, how heavy, where? The question `prove`."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Notice
from cpam_bayes.batches.plate_row import local_likelihood
from cpam_bayes.command import PLATE, TIME_LIMIT, Command, option
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import fixed, listed, significant, with_spread
from cpam_bayes.forward_model.labels import labelled_model, list_order
from cpam_bayes.forward_model.preconditions import rectangular_only, require_seed, require_supported
from cpam_bayes.identification.added_mass import (
    LARGEST,
    AddedMass,
    Finding,
    LoadedPlate,
    Repeatability,
    cells_of,
    detection_limit,
    find_masses,
    loaded_plate,
    predicted_shifts,
    spread_of_shifts,
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
# Standard deviations of a 95 % interval.
_WITHIN: Final = 1.96
_SEALED_KEYS: Final = ("mass_g", "x_mm", "y_mm")


@dataclass(frozen=True, slots=True)
class Stated:
    """The content of the seal, SI. shifts, sd : (n,) of ln f' - ln f that the first list predicts for it."""

    mass: float
    place: tuple[float, float]
    shifts: Array
    sd: Array

    def holds(self, shifts: Array) -> Array:
        """Whether shifts (n,) are inside the 95 % intervals, (n,)."""
        return np.asarray(np.abs(shifts - self.shifts) <= _WITHIN * self.sd)


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
        return None if self.stated is None else int(np.sum(self.stated.holds(self.shifts)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CoinResult(PlateResult):
    """The mass stuck to a plate after its first list, by each further list.

    Attributes
    ----------
    coins : in the order of the lists
    hash : SHA-256 of the sealed file as it was before the answer, "" without one
    detection_limit : mass that is claimed with 95 % probability, kg; None where none is
    spread : of several sealed lists, the 95 % interval of the relative repeatability and the bound of the
        error of a shift, as of `spread_of_shifts`
    point : the identification from the first list
    """

    command: ClassVar[str] = "prove"

    coins: tuple[Coin, ...]
    hash: str
    detection_limit: float | None
    spread: tuple[tuple[float, float], float] | None
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
        is compared after the answer; mass_g = 0 is a list without a mass
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
    _require_described(point)
    watch.announce(f"prove {specimen.name}: where a mass gives these shifts")
    rng = np.random.default_rng(seed)
    loaded = _loaded(point, rng)
    whole = cells_of(loaded)
    shifts = [np.log(measurement.frequencies / first.frequencies) for _, measurement in further]
    noises = [_repeatability(first, measurement) for _, measurement in further]
    found = find_masses(loaded, whole, list(zip(shifts, noises, strict=True)), rng)
    coins = [Coin(name, one, d, None) for (name, _), one, d in zip(further, found, shifts, strict=True)]
    level = float(np.median([coin.found.noise for coin in coins]))
    limit = detection_limit(loaded, whole, level, noises[0].rounding, rng)
    if seal:
        coins = [
            replace(coin, stated=_stated(loaded, coin, held, first, measurement))
            for coin, held, (_, measurement) in zip(coins, seal, further, strict=True)
        ]
    spread = None
    stated = [(coin.shifts - coin.stated.shifts, coin.stated.shifts) for coin in coins if coin.stated]
    if len(stated) > 1:
        left, predicted = (np.array(each) for each in zip(*stated, strict=True))
        spread = spread_of_shifts(left, predicted, noises[0].rounding)
    return CoinResult(
        seed=seed,
        notices=(*_given_twice(first, further), *(n for n in point.notices if n.severity == "slip")),
        specimen=specimen,
        air_shifts=point.air_shifts,
        coins=tuple(coins),
        hash=digest,
        detection_limit=limit,
        spread=spread,
        point=point,
    )


def _given_twice(first: Measurement, further: Sequence[tuple[str, Measurement]]) -> Iterator[Notice]:
    """A notice for each list whose frequencies are those of one before it."""
    names = {tuple(first.frequencies): "the first list"}
    for name, measurement in further:
        frequencies = tuple(measurement.frequencies)
        if frequencies in names:
            yield Notice("list_given_twice", "slip", {"name": name, "before": names[frequencies]})
        else:
            names[frequencies] = name


def _require_described(point: PointResult) -> None:
    """The shapes of the modes say where a mass is: of another plate they say nothing."""
    if any(notice.code == "large_misfit" for notice in point.notices):
        off = _percent(point.estimate.rms)
        raise PlateFileError(
            f"{point.specimen.source}: the first list is {off} % off the plate model, whose mode shapes then "
            "cannot tell where a mass is; mend the plate file first: identify names what is likely wrong"
        )


def _content(path: str, accepted: str) -> bytes:
    try:
        return read_regular_file(path, path, accepted)
    except FileNotFoundError:
        raise PlateFileError(f"{path}: no such file, accepted: {accepted}") from None


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
            content = dict(parse(decode(_content(name, "a list"), name), name))
            if "coin" in content:  # its values are not shown
                raise PlateFileError(f"{name}: a sealed file, accepted: a list; give it as --sealed {name}")
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
    """Masses and places of the sealed file, SI, and its SHA-256; what is wrong is said without its values."""
    if sealed is None:
        return (), ""
    source = os.fspath(sealed)
    content = _content(source, "a sealed file")
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
        most = _GRAM * LARGEST * plate.total_mass
        if not (0.0 <= mass <= most and 0.0 <= x <= sides[0] and 0.0 <= y <= sides[1]):
            raise PlateFileError(
                f"{source}: [[coin]] {i}: accepted: 0 to {significant(most, 2)} g, {100.0 * LARGEST:g} % of "
                f"the plate, at a place on the plate of {sides[0]:g} x {sides[1]:g} mm"
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
    inner = np.array(likelihood.information) * np.outer(prior, prior) + unknowns.precision
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
    sides = (plate.length, plate.width)
    return loaded_plate(model, best, draws, order, sides, (plate.total_mass, sd))


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


@dataclass(frozen=True, slots=True)
class _Shifted:
    """One frequency of a sealed list, Hz: without the mass, and as predicted from it with the seal.

    sd : of the prediction, relative. is_inside : whether its 95 % interval holds the measured one
    """

    name: str
    mode: int
    bare: float
    predicted: float
    sd: float
    measured: float
    is_inside: bool


def _shifted(result: CoinResult) -> tuple[_Shifted, ...]:
    """The frequencies of all sealed lists."""
    measurement = result.specimen.measurement
    assert measurement is not None
    return tuple(
        _Shifted(coin.name, i, f, f * np.exp(stated), sd, f * np.exp(d), bool(inside))
        for coin in result.coins
        if coin.stated is not None
        for i, (f, d, stated, sd, inside) in enumerate(
            zip(
                measurement.frequencies,
                coin.shifts,
                coin.stated.shifts,
                coin.stated.sd,
                coin.stated.holds(coin.shifts),
                strict=True,
            ),
            1,
        )
    )


_SHIFT_COLUMNS: Final = (
    Column("list", "list", lambda s: Path(s.name).name),
    Column("mode", "mode", lambda s: s.mode, number=True),
    Column("first, Hz", "first_hz", lambda s: s.bare, "{:.2f}".format, number=True),
    Column("predicted, Hz", None, lambda s: " +- ".join(with_spread(s.predicted, s.predicted * s.sd))),
    Column(None, "predicted_hz", lambda s: s.predicted),
    Column(None, "sd_hz", lambda s: s.predicted * s.sd),
    Column("measured, Hz", "measured_hz", lambda s: s.measured, "{:.2f}".format, number=True),
    Column("in 95 %", "inside", lambda s: s.is_inside, lambda inside: "yes" if inside else "no"),
)


@present.register
def _present(result: CoinResult) -> Report:
    """The mass found, the mass stated, and their agreement."""
    rows = Rows("coins", _COLUMNS, result.coins, lambda c: c.is_inside is False)
    shifts = Rows("shifts", _SHIFT_COLUMNS, _shifted(result), lambda s: not s.is_inside)
    of_seal = (shifts.table("Frequencies that the first list and the seal predict"),) if shifts.rows else ()
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
                *((f"SHA-256 of the seal: {result.hash}",) if result.hash else ()),
            ),
            next_step=""
            if result.hash
            else "seal mass and place in a file before the answer.  --sealed FILE",
            slips=result.slips,
            warnings=result.cautions,
        ),
        sections=(
            Section(
                "Certificate", (facts("Coin test", _certificate(result)), *of_seal), (DRAWING,), folded=False
            ),
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
            "shifts": shifts.records(),
            "repeatability": None if result.spread is None else list(result.spread[0]),
            "shift_error": None if result.spread is None else result.spread[1],
            "warnings": list(result.warnings),
        },
        drawings=(Drawing(DRAWING, partial(_drawn, result), _CAPTION),),
        rows=(rows, shifts),
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
        most = significant(_GRAM * LARGEST * result.specimen.plate.total_mass, 2)
        return f"Neither noise nor a mass of up to {most} g explains the second list: something else changed."
    if found.finding is Finding.NOTHING:
        sealed = "" if stated is None else f"; the seal says {significant(_GRAM * stated.mass, 3)} g"
        return f"Nothing of {significant(_GRAM * found.interval[1], 2)} g or more was added{sealed}."
    shown = f"{_grams(coin)} g"
    if stated is not None:
        off = "" if coin.distance is None else f", {fixed(_MILLIMETRE * coin.distance, 0)} mm off"
        return (
            f"{shown} was found for {significant(_GRAM * stated.mass, 3)} g{off}"
            f"{'' if coin.is_inside else ', outside its 95 % interval'}; {coin.shifts_inside} of "
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
            "1 where the plate's mass, on which its moduli rest, is right."
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
            if coin.distance is not None:
                stated += f", {fixed(_MILLIMETRE * coin.distance, 0)} mm off"
                stated += " up to a mirror image" if coin.found.images else ""
        at = f" at {_where(coin.found.place)} mm" if _is_added(coin) else ""
        unit = "" if coin.found.finding is Finding.OTHER else " g"
        rows.append((Path(coin.name).name, f"{_grams(coin)}{unit}{at}{stated}"))
    limit = result.detection_limit
    rows.append(("detection limit", "none" if limit is None else _limit(limit)))
    if result.spread is not None:
        (low, high), form = result.spread
        rows.append(
            ("repeatability, from the shifts", f"{_percent(low)} to {_percent(high)} % of a frequency")
        )
        rows.append(("error of a shift beyond it", f"at most {_percent(form)} % of the shift"))
    return (*rows, *(("agreement", line) for line in _agreement(result)))


def _percent(value: float) -> str:
    return significant(100.0 * value, 2)


def _computation(result: CoinResult) -> Any:
    noise = _percent(float(np.median([c.found.noise for c in result.coins])))
    fit = _percent(result.point.estimate.rms)
    return facts(
        "Computation",
        (
            ("modes", f"of the plate as identified from the first list, fit {fit} %"),
            ("shifts", "of a disc of 12, 24 or 48 kg/m2, steel of 1.5 to 6 mm; 2 % of each for its form"),
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
            help="masses and places, a [[coin]] for each LIST; its SHA-256 is shown first",
        ),
        TIME_LIMIT,
    ),
)
