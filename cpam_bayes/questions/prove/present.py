"""The report of the coin test: screen, certificate, document, drawing."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from cpam_bayes.formatting import fixed, listed, significant, with_spread
from cpam_bayes.identification.added_mass import LARGEST, Finding
from cpam_bayes.questions.prove.result import Coin, CoinResult
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
    facts,
    plate_keys,
)
from cpam_bayes.result import present

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_GRAM, _MILLIMETRE = 1e3, 1e3
# Probability above which a claim is reported as nearly certain.
_SURE: Final = 0.9995


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


def _if_added(of: Any) -> Any:
    return lambda coin: of(coin.found) if coin.is_added else None


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
    Column(None, "q025_g", lambda c: _GRAM * c.found.interval[0] if c.is_added else 0.0),
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
    """One frequency of a sealed list, Hz: without the mass, as predicted with the sealed mass, as measured.

    sd : of the prediction, relative. is_inside : whether its 95 % interval holds the measured frequency
    """

    name: str
    mode: int
    bare: float
    predicted: float
    sd: float
    measured: float
    is_inside: bool


def _shifted(result: CoinResult) -> tuple[_Shifted, ...]:
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
    rows = Rows("coins", _COLUMNS, result.coins, lambda c: c.is_inside is False)
    shifts = Rows("shifts", _SHIFT_COLUMNS, _shifted(result), lambda s: not s.is_inside)
    of_seal = (shifts.table("Frequencies predicted from the first list and the seal"),) if shifts.rows else ()
    limit = result.detection_limit
    return Report(
        summary=result.screen(
            headline=_headline(result),
            tables=(rows.table("Lists after the first"),),
            lines=(
                *_agreement(result),
                "Detection limit here: "
                + ("no mass is found with 95 % probability." if limit is None else f"{_limit(limit)}."),
                *_mirrored(result),
                *((f"SHA-256 of the seal: {result.hash}",) if result.hash else ()),
            ),
            next_step="" if result.hash else "seal mass and place in a file first.  --sealed FILE",
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


def _mirrored(result: CoinResult) -> tuple[str, ...]:
    """Sentence on the mirror-image places, which no list distinguishes from the one found."""
    several = [coin for coin in result.coins if coin.is_added and coin.found.images]
    if not several:
        return ()
    places = f" {_or_images(several[0])}" if len(result.coins) == 1 else "; see the certificate"
    return (f"No list tells a place from its mirror images{':' * (len(result.coins) == 1)}{places}.",)


def _or_images(coin: Coin) -> str:
    return f"{listed([_where(place) for place in _in_order(coin.found.images)], 'or')} mm"


def _in_order(places: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Places from left to right, of those one above another from below."""
    return sorted(places, key=lambda place: [round(_MILLIMETRE * along) for along in place])


def _images(coin: Coin) -> list[list[float]]:
    places = _in_order(coin.found.images) if coin.is_added else ()
    return [[_MILLIMETRE * x, _MILLIMETRE * y] for x, y in places]


def _headline(result: CoinResult) -> str:
    if len(result.coins) > 1:
        claimed = sum(coin.is_added for coin in result.coins)
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
        sealed = "" if stated is None else f"; the seal says {_sealed(coin)}"
        return f"No mass of {significant(_GRAM * found.interval[1], 2)} g or more was added{sealed}."
    shown = f"{_grams(coin)} g"
    if stated is not None:
        return f"{_found_for(coin)}; {_inside(coin)}."
    sure = "> 0.999" if found.probability > _SURE else fixed(found.probability, 3)
    return f"{shown} was added at {_where(found.place)} mm (probability {sure})."


def _agreement(result: CoinResult) -> tuple[str, ...]:
    """Agreement over several lists: coverage, and found / stated mass, a check of mass and sizes."""
    known = [c for c in result.coins if c.stated is not None and c.stated.mass and c.is_added]
    coverage = result.coverage
    if coverage is None or len(result.coins) < 2:
        return ()
    said = [f"{100 * coverage['shifts']:.0f} % of the shifts lie inside their 95 % intervals."]
    if known:
        ratio = np.array([c.found.mass / c.stated.mass for c in known if c.stated])
        weight = np.array([(c.stated.mass / c.found.sd) ** 2 for c in known if c.stated])
        mean, sd = float(weight @ ratio / weight.sum()), float(weight.sum() ** -0.5)
        said.append(
            f"Found / sealed mass: {' +- '.join(with_spread(mean, sd))}; "
            "1 if the plate's mass, which scales its moduli, is right."
        )
    return tuple(said)


def _sealed(coin: Coin) -> str:
    assert coin.stated is not None
    return f"{significant(_GRAM * coin.stated.mass, 3)} g" if coin.stated.mass else "no mass"


def _found_for(coin: Coin) -> str:
    """What was found, beside what was sealed."""
    found = coin.found.finding
    shown = f"{_grams(coin)} g"
    if found is Finding.OTHER:
        shown = "no mass that explains the list"
    elif found is Finding.NOTHING:
        shown = f"no mass of {significant(_GRAM * coin.found.interval[1], 2)} g or more"
    off = "" if coin.distance is None else f", {fixed(_MILLIMETRE * coin.distance, 0)} mm off"
    outside = "" if coin.is_inside else ", outside its 95 % interval"
    return f"{shown} was found, {_sealed(coin)} sealed{off}{outside}"


def _inside(coin: Coin) -> str:
    """Number of shifts that agree with the prediction from the first list and the seal."""
    return f"{coin.shifts_inside} of {len(coin.shifts)} shifts lie inside their 95 % intervals"


def _certificate(result: CoinResult) -> tuple[tuple[str, str], ...]:
    """The certificate: label and sentence, one pair for each list."""
    limit = result.detection_limit
    shown = "none" if limit is None else _limit(limit)
    rows = [("plate", result.specimen.name)]
    if result.hash:
        rows.append(("SHA-256 of the seal, shown before the answer", result.hash))
    laboratory = dict(result.specimen.certificate).get("laboratory")
    where = f"In this laboratory{f' ({laboratory})' if laboratory else ''}, on this plate"
    for coin in result.coins:
        at = ""
        if coin.is_added:
            images = f", or a mirror image: {_or_images(coin)}" if coin.found.images else ""
            at = f" Found at {_where(coin.found.place)} mm{images}."
        if coin.stated is None:
            unit = "" if coin.found.finding is Finding.OTHER else " g"
            rows.append((Path(coin.name).name, f"{_grams(coin)}{unit}.{at}"))
            continue
        if coin.stated.mass:
            at += f" Sealed at {_where(coin.stated.place)} mm."
        said = f"{where}, {_found_for(coin)}; {_inside(coin)}; detection limit here {shown}."
        rows.append((Path(coin.name).name, f"{said}{at}"))
    rows.append(("detection limit", shown))
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
            ("shifts", "of a disc of 12 to 48 kg/m2, steel of 1.5 to 6 mm; 2 % of each for its shape"),
            ("repeatability", f"{noise} % of a frequency in each list"),
            ("prior", "0.5 for no mass; else log-uniform, 0.05 to 15 % of the plate's mass"),
            ("detection limit", "claimed in 95 % of simulated lists, except on the fifth of the plate where "
             "a mass shows least"),
        ),
    )  # fmt: skip


_CAPTION: Final = Caption(
    "Dots: possible places of each mass, mirror images included. Crosses: sealed places.",
    "The plate with the places that the lists allow for each mass, and the sealed ones.",
)


def _drawn(result: CoinResult) -> Figure:
    def overlay(axes: Axes, _: int) -> None:
        for coin in result.coins:
            if not coin.is_added:
                continue
            x, y = _MILLIMETRE * coin.found.draws[::8, 1:].T
            axes.plot(x, y, ".", color=PREDICTED, markersize=1.5, alpha=0.4, rasterized=True)
            if coin.stated is not None and coin.stated.mass:
                at = (_MILLIMETRE * v for v in coin.stated.place)
                axes.plot(*at, "x", color=MEASURED, markersize=8, markeredgewidth=2)

    return plate_figure((result.specimen,), overlay)
