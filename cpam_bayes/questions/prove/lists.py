"""Input of `prove`: the further lists and the seal."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeAlias

from cpam_bayes.answer import Notice
from cpam_bayes.errors import PlateFileError
from cpam_bayes.formatting import listed, significant
from cpam_bayes.identification.added_mass import LARGEST
from cpam_bayes.plate import Measurement, Plate, Specimen, read_plate
from cpam_bayes.plate.text import decode, parse, read_regular_file

ListLike: TypeAlias = str | os.PathLike[str] | Sequence[float]
"""A further list of the plate: a table, a TOML file with frequencies_hz, or the frequencies in Hz."""

_GRAM, _MILLIMETRE = 1e3, 1e3
_SEALED_KEYS: Final = ("mass_g", "x_mm", "y_mm")


def given_twice(first: Measurement, further: Sequence[tuple[str, Measurement]]) -> Iterator[Notice]:
    """Notices for lists whose frequencies repeat those of an earlier list."""
    names = {tuple(first.frequencies): "the first list"}
    for name, measurement in further:
        frequencies = tuple(measurement.frequencies)
        if frequencies in names:
            yield Notice("list_given_twice", "slip", {"name": name, "before": names[frequencies]})
        else:
            names[frequencies] = name


def _content(path: str, accepted: str) -> bytes:
    try:
        return read_regular_file(path, path, accepted)
    except FileNotFoundError:
        raise PlateFileError(f"{path}: no such file, accepted: {accepted}") from None


def require_complete(specimen: Specimen, first: Measurement) -> None:
    """Refuse a first list that may lack modes."""
    if not first.complete:
        raise PlateFileError(
            f"{specimen.source}: measurement.complete is false; prove compares lists mode by mode: "
            "give lists without gaps"
        )


def list_of(given: ListLike, specimen: Specimen, first: Measurement) -> tuple[str, Measurement]:
    """Name and content of a further list; noise that it does not state is that of the first list."""
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


def seal_of(
    sealed: str | os.PathLike[str] | None, n: int, plate: Plate
) -> tuple[tuple[tuple[float, float, float], ...], str]:
    """Masses and places in the sealed file, SI, and its SHA-256; errors do not reveal its values."""
    if sealed is None:
        return (), ""
    source = os.fspath(sealed)
    content = _content(source, "a sealed file")
    coins = parse(decode(content, source), source, is_sealed=True).get("coin")
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
