"""What every cause of the catalogue does to the modes of a plate, and how much of it constants imitate.

python studies/11_effects.py [--quick]
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.effects import Effect, applicable, variants
from cpam_bayes.forward_model.model import reference_vector
from cpam_bayes.plate import Specimen
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from validation.reporting import (
    study_main,
)

Array = NDArray[Any]
Results = dict[str, Any]
HERE = Path(__file__).parent
RESULTS = HERE / "results" / "11_effects.json"

KEYS = {
    "quick": "whether this is the small version",
    "plates": "by plate: its modes' labels and frequencies, and the constants that are projected out",
    "effects": "one a cause: plate, size, relative shift of every mode in %, before and after projection",
}

# The free plate, and the clamped and the supported one for causes that it cannot have.
FREE, CLAMPED, SUPPORTED = "C1", "A2", "C1 SSSS"
# Places of a mass and a flaw, and the index of the misread frequency and the missed mode.
PLACES = {"sensor_mass": (0.95, 0.95, 0.0), "damage": (0.5, 0.5, 0.05)}
LISTED = 2
# Relative size of the misreading.
SLIP = 0.05
# Causes of the quick version, which need no further plate model.
QUICK = ("frequency_scale", "viscoelastic", "mode_identity", "outlier")


def run(quick: bool) -> Results:
    """Shifts at one standard deviation of the catalogue, at the reference constants."""
    plates = {
        name: plate_case(_specimen(name)) for name in ((FREE,) if quick else (FREE, CLAMPED, SUPPORTED))
    }
    every = [e for e in cb.effects.CATALOGUE if not (e.drops_references or e.on_plate)]
    effects = [e for e in every if not quick or e.name in QUICK]
    return {
        "quick": quick,
        "plates": {name: _plate(case) for name, case in plates.items()},
        "effects": [_shifts(plates, effect) for effect in effects],
    }


def _specimen(name: str) -> Specimen:
    specimen = cb.read_plate(name.partition(" ")[0])
    _, _, edges = name.partition(" ")
    return replace(specimen, plate=replace(specimen.plate, edges=edges)) if edges else specimen


def _plate(case: PlateCase) -> dict[str, Any]:
    modes = case.models.bare.full.modes(_reference(case))
    return {
        "labels": [mode.label for mode in modes],
        "frequencies_hz": [mode.frequency for mode in modes],
        "constants": list(case.models.parameters.names),
    }


def _shifts(plates: dict[str, PlateCase], effect: Effect) -> dict[str, Any]:
    plate, case = next((name, c) for name, c in plates.items() if effect in applicable(c.models.facts))
    shift, size, unit = _of_list(case, effect) if effect.pairings else _own(case, effect)
    return {
        "cause": effect.name,
        "family": effect.family,
        "plate": plate,
        "size": size,
        "unit": unit,
        "shift_percent": (100.0 * shift).tolist(),
        "projected_percent": (100.0 * _projected(case, shift)).tolist(),
        "note": effect.note,
    }


def _own(case: PlateCase, effect: Effect) -> tuple[Array, float, str]:
    """Relative shift by an effect on the plate or on its frequencies, with its size and unit as shown."""
    x = _reference(case)
    effect, *_ = variants(effect, case.models.facts)
    if effect.name in PLACES:
        place = dict(zip((p.name for p in effect.coordinates), PLACES[effect.name], strict=False))
        effect = effect.fixed({name: np.asarray(value) for name, value in place.items()})
    parameter, names = effect.parameters[0], [p.name for p in effect.parameters]
    values = [effect.null, effect.scaled(1.0)]
    one = values[1][parameter.name]
    unit, factor = parameter.display
    if effect.observe is not None:
        bare = case.models.bare.predict(x[None]).frequencies[0]
        found = effect.observe(bare, {parameter.name: np.asarray(one)})
        return found / bare - 1.0, factor * one, unit
    model = case.with_effect(effect)
    f = model.predict(np.array([[*x, *(v[name] for name in names)] for v in values])).frequencies
    return f[1] / f[0] - 1.0, factor * one, unit


def _of_list(case: PlateCase, effect: Effect) -> tuple[Array, float, str]:
    """Shift by a misread third frequency, or by a missed third mode: later entries are of the next mode."""
    f = case.models.bare.predict(_reference(case)[None]).frequencies[0]
    if effect.name == "outlier":
        return SLIP * (np.arange(len(f)) == LISTED), 100.0 * SLIP, "%"
    later = np.append(f[1:], np.nan) / f - 1.0
    shift = np.where(np.arange(len(f)) < LISTED, 0.0, later)
    return shift[:-1], float(LISTED + 1), "mode"


def _projected(case: PlateCase, shift: Array) -> Array:
    """Residual of a shift after a least-squares fit of the constants, without any prior."""
    x = _reference(case)[None]
    found = case.models.bare.predict(x, jacobian=True)
    assert found.jacobian is not None
    by_constants = (found.jacobian[0] * x / found.frequencies[0][:, None])[: len(shift)]
    left: Array = shift - by_constants @ np.linalg.lstsq(by_constants, shift)[0]
    return left


def _reference(case: PlateCase) -> Array:
    return reference_vector(case.models.specimen, case.models.parameters)


def show(results: Results) -> None:
    """Print the largest shifts."""
    columns = (
        Heading("cause"),
        Heading("plate"),
        Heading("size", number=True),
        Heading("unit"),
        Heading("largest shift %", number=True),
        Heading("left by the constants %", number=True),
    )
    rows = tuple(
        (
            e["cause"],
            e["plate"],
            f"{e['size']:g}",
            e["unit"],
            *(f"{max(e[key], key=abs):+.3f}" for key in ("shift_percent", "projected_percent")),
        )
        for e in results["effects"]
    )
    print(screen_text((Table("Relative shifts at one standard deviation", columns, rows),), sys.stdout))


def main() -> None:
    study_main(__doc__, run, show, RESULTS)


if __name__ == "__main__":
    main()
