"""The question `prove`, the coin test: mass and place of a coin stuck to the plate between two lists."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Final

import numpy as np

from cpam_bayes.command import PLATE, TIME_LIMIT, Command, option
from cpam_bayes.errors import PlateFileError, checked
from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.labels import labelled_model, list_order
from cpam_bayes.forward_model.preconditions import rectangular_only, require_seed, require_supported
from cpam_bayes.identification.added_mass import (
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
from cpam_bayes.plate import Measurement, PlateLike, read_plate
from cpam_bayes.questions.identify.pso import PointResult, identify
from cpam_bayes.questions.prove import present as present  # how it is shown
from cpam_bayes.questions.prove.lists import ListLike, given_twice, list_of, require_complete, seal_of
from cpam_bayes.questions.prove.result import Coin, CoinResult, Stated
from cpam_bayes.result import within_time
from cpam_bayes.running import SILENT, Watch

__all__ = ["Coin", "CoinResult", "prove"]

_MOST_LISTS: Final = 50
# Draws of the constants, over what the first list leaves undetermined.
_DRAWS: Final = 12
# Relative sd of plate mass, thickness and density where the file states none.
_WEIGHED, _THICKNESS, _DENSITY = 0.002, 0.01, 0.01


@checked
@within_time
def prove(
    plate: PlateLike,
    *lists: ListLike,
    sealed: str | os.PathLike[str] | None = None,
    seed: int = 0,
    watch: Watch = SILENT,
) -> CoinResult:
    """The mass stuck to a plate after its first list was measured, and its place.

    Parameters
    ----------
    plate : as for `read_plate`, with the list measured without the mass
    lists : one per mass: a table, a TOML file with frequencies_hz, or frequencies in Hz; of the same modes as
        the first list
    sealed : a TOML file with a [[coin]] for each list: mass_g, x_mm, y_mm; mass_g = 0 for a list without a
        mass. Its SHA-256 is shown first; the masses are compared after the answer
    watch : progress display; none if left out

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
    require_complete(specimen, first)
    further = [list_of(given, specimen, first) for given in lists]
    seal, digest = seal_of(sealed, len(lists), specimen.plate)
    if digest:
        watch.promise(f"SHA-256 of the seal: {digest}")
    point = identify(specimen, seed=seed, watch=watch)
    _require_described(point)
    watch.announce(f"prove {specimen.name}: where a mass gives these shifts")
    loaded = _loaded(point)
    whole, rng = cells_of(loaded), np.random.default_rng(seed)
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
        notices=(*given_twice(first, further), *(n for n in point.notices if n.severity == "slip")),
        specimen=specimen,
        air_shifts=point.air_shifts,
        coins=tuple(coins),
        hash=digest,
        detection_limit=limit,
        spread=spread,
        point=point,
    )


def _require_described(point: PointResult) -> None:
    """Refuse a plate that the model does not describe: only its own mode shapes locate a mass."""
    if any(notice.code == "large_misfit" for notice in point.notices):
        off = significant(100.0 * point.estimate.rms, 2)
        raise PlateFileError(
            f"{point.specimen.source}: the first list is {off} % off the plate model, whose mode shapes then "
            "cannot locate a mass; correct the plate file first: identify names the likely error"
        )


def _loaded(point: PointResult) -> LoadedPlate:
    """The modes of the identified plate, with their scatter over the draws of the constants."""
    estimate, specimen = point.estimate, point.specimen
    measurement, _ = required(specimen)
    assert estimate.draws is not None
    best, model = estimate.optima[0].x, estimate.model.full
    order = list_order(labelled_model(estimate.model, measurement, specimen), best)[: measurement.size]
    plate = specimen.plate
    if plate.mass is not None:
        sd = plate.sd.get("mass", _WEIGHED * plate.mass) / plate.mass
    else:
        of_density = plate.sd.get("density", _DENSITY * plate.density) / plate.density
        sd = float(
            np.hypot(of_density, plate.sd.get("thickness", _THICKNESS * plate.thickness) / plate.thickness)
        )
    sides, mass = (plate.length, plate.width), (plate.total_mass, sd)
    return loaded_plate(model, best, estimate.draws.even(_DRAWS), order, sides, mass)


def _repeatability(first: Measurement, second: Measurement) -> Repeatability:
    """Root mean square of the repeatabilities of both lists, used for each."""
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
