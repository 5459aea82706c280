"""Lists of plates of three-dimensional bricks, drawn from priors, with one thing wrong or nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.calculix.run import CalculixError
from cpam_bayes.plate import Specimen, read_plate
from cpam_bayes.plate.laminate import MaterialSymmetry, complete_constants
from validation.bricks import Flaws, Heat, Mass, Notch, Patch, Springs, extrapolated_frequencies
from validation.independent.drawn import has_bench, is_stated, signed
from validation.independent.lists import FURTHER, IN_FILE, NominalPlate, Truth, UnreachableError, written
from validation.independent.true_plate import TruePlate, has_plies, is_free

Array = NDArray[np.float64]
Made = tuple[str, Truth]
# Causes, other accepted names of them, and the flaws.
Wrong = tuple[tuple[str, ...], tuple[str, ...], Flaws]

# Elements in the plane of the two meshes whose frequencies are extrapolated.
_COARSE, _FINE = 80, 160
_SOFT_CLAMP = ("clamp_rotation", "clamp_translation")


def _nothing(true: TruePlate, rng: np.random.Generator) -> Wrong:
    return (), (), Flaws()


def _mass(true: TruePlate, rng: np.random.Generator) -> Wrong:
    grams = true.total_mass * float(np.exp(rng.uniform(*np.log((0.005, 0.06)))))
    x, y = (rng.uniform(0.04, 0.96, 2) * (true.length, true.width)).tolist()
    return ("sensor_mass",), (), Flaws(masses=(Mass(grams, x, y),))


def _turned(true: TruePlate, rng: np.random.Generator) -> Wrong:
    return ("misorientation",), (), Flaws(turned_deg=signed(rng, 2.0, 9.0))


def _tapered(axis: int, true: TruePlate, rng: np.random.Generator) -> Wrong:
    by = signed(rng, 0.03, 0.15)
    taper = (by, 0.0) if axis == 0 else (0.0, by)
    return (f"taper_{'xy'[axis]}",), (), Flaws(taper=taper)


def _sagging(true: TruePlate, rng: np.random.Generator) -> Wrong:
    x, y = (true.thickness * rng.uniform(0.1, 0.9, 2)).tolist()
    return ("warp",), (), Flaws(sag=(x, y))


def _softer(true: TruePlate, rng: np.random.Generator) -> Wrong:
    sides = np.array([true.length, true.width])
    half = sides * rng.uniform(0.07, 0.18, 2)
    middle = half + (sides - 2.0 * half) * rng.uniform(0.05, 0.95, 2)
    low, high = middle - half, middle + half
    patch = Patch((low[0], high[0]), (low[1], high[1]), float(rng.uniform(0.3, 0.8)))
    return ("damage",), (), Flaws(patch=patch)


def _cut(true: TruePlate, rng: np.random.Generator) -> Wrong:
    x, y = (rng.uniform(0.05, 0.13, 2) * (true.length, true.width)).tolist()
    return ("outline",), (), Flaws(notch=Notch(x, y))


def _soft(true: TruePlate, rng: np.random.Generator) -> Wrong:
    """Springs of compliances E / (k side) and D / (k h side^3), with the mean of both moduli."""
    turn, shift = np.exp(rng.uniform(np.log((0.01, 0.001)), np.log((0.08, 0.008)))).tolist()
    modulus = 0.5 * (true.constants["E1"] + true.constants.get("E2", true.constants["E1"]))
    normal = modulus / (turn * true.length)
    across = modulus * true.thickness**2 / 12.0 / (shift * true.length**3)
    return ("soft_clamp",), _SOFT_CLAMP, Flaws(springs=Springs(normal, normal, across))


def _stressed(true: TruePlate, rng: np.random.Generator) -> Wrong:
    """Thermal strain that is a fraction of a strip's buckling strain, pi^2 h^2 / (3 side^2)."""
    strain = signed(rng, 0.2, 0.6) * np.pi**2 / 3.0 * (true.thickness / true.width) ** 2
    return ("membrane_stress",), (), Flaws(heat=Heat(float(strain)))


def _is_clamped(true: TruePlate) -> bool:
    return true.edges == "CFFF"


def _of_plies(true: TruePlate) -> bool:
    return has_bench(true) and has_plies(true)


# Kind -> number of lists, condition on the plate, and the flaw.
KINDS: dict[
    str, tuple[int, Callable[[TruePlate], bool], Callable[[TruePlate, np.random.Generator], Wrong]]
] = {
    "clean": (10, has_bench, _nothing),
    "mass": (6, has_bench, _mass),
    "turned": (3, _of_plies, _turned),
    "taper-x": (2, has_bench, partial(_tapered, 0)),
    "taper-y": (2, has_bench, partial(_tapered, 1)),
    "warp": (3, is_free, _sagging),
    "patch": (3, has_bench, _softer),
    "corner": (3, has_bench, _cut),
    "soft-clamp": (3, _is_clamped, _soft),
    "stress": (2, is_free, _stressed),
    "missed": (3, has_bench, _nothing),
}


def plans() -> Iterator[
    tuple[str, Callable[[TruePlate], bool], Callable[[NominalPlate, np.random.Generator], Made]]
]:
    """All lists: name, condition on the plate, and maker."""
    for name, (number, on, what) in KINDS.items():
        for k in range(number):
            yield f"bricks-{name}-{k}", on, partial(_made, name, what)


def _made(
    name: str,
    what: Callable[[TruePlate, np.random.Generator], Wrong],
    nominal: NominalPlate,
    rng: np.random.Generator,
) -> Made:
    nominal = replace(nominal, plate=replace(nominal.plate, bias=()), weighed=False)
    true = nominal.drawn(rng)
    causes, accepted, flaws = what(true, rng)
    missed = (int(rng.integers(nominal.n_modes)),) if name == "missed" else ()
    truth = Truth(
        kind="bricks",
        plate=nominal.name,
        causes=("mode_identity",) if missed else causes,
        accepted=accepted,
        sizes={},
        aux={},
        ratio=None,
        constants={n: float(true.constants[n]) for n in nominal.constants},
        true_hz=(),
        stated=is_stated(rng),
        complete=True,
        missed=missed,
        known=nominal.known,
        noise=nominal.noise,
        extra={"flaws": repr(flaws)},
    )
    return written(nominal, frequencies(nominal, true, flaws), truth, rng)


def specimen_of(nominal: NominalPlate, true: TruePlate) -> tuple[Specimen, dict[str, float]]:
    """The true plate without a flaw, and all its constants, Pa."""
    size = {f"{side}_mm": 1e3 * getattr(true, side) for side in ("length", "width", "thickness")}
    named = {IN_FILE[name]: value for name, value in true.constants.items()}
    kind: MaterialSymmetry = "isotropic" if nominal.material == "aluminium" else "transversely_isotropic"
    specimen = read_plate(
        {
            "name": "bricks",
            "plate": {
                **size,
                "density_kg_m3": true.density,
                "layup": nominal.layup,
                "edges": true.edges,
            },
            "material": {
                "isotropic": kind == "isotropic",
                **{key: value / unit for (key, unit), value in named.items()},
            },
        }
    )
    whole = complete_constants(dict(true.constants), kind)
    return specimen, {name: float(value) for name, value in whole.items()}


def frequencies(nominal: NominalPlate, true: TruePlate, flaws: Flaws) -> Array:
    """Frequencies of the bricks, extrapolated from two meshes, of the list and FURTHER modes, Hz."""
    specimen, constants = specimen_of(nominal, true)
    n = nominal.n_modes + FURTHER
    try:
        return extrapolated_frequencies(specimen, constants, n, flaws, _COARSE, _FINE)
    except CalculixError as error:
        raise UnreachableError(str(error)) from None
