"""What is hidden in the lists of the benchmark: causes as they are on real plates, of any size and place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cpam_bayes.validation.independent.true_plate import Mass, Patch, TruePlate

# Degrees of freedom of the Student-t priors of sizes.
DEGREES_OF_FREEDOM = 4.0
# An accelerometer's radius of gyration, m.
_GYRATION = 4e-3
Aux = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Flaw:
    """A cause and how it is put on a plate.

    scale : one standard deviation of its size by the physics of effects, in its unit, on a plate.
    most : the physical limit.
    apply : plate, size, what else was drawn -> plate.
    draw : what else is drawn: places, forms.
    two_sided : whether the size has either sign.
    applies : to which plates.
    """

    cause: str
    scale: Callable[[TruePlate], float]
    most: Callable[[TruePlate], float]
    apply: Callable[[TruePlate, float, Aux], TruePlate]
    two_sided: bool = True
    draw: Callable[[TruePlate, np.random.Generator], Aux] = lambda plate, rng: {}
    applies: Callable[[TruePlate], bool] = lambda plate: True

    def prior_size(self, plate: TruePlate, rng: np.random.Generator) -> float:
        """A size drawn from the prior, within the physical limit."""
        while True:
            size = float(self.scale(plate) * rng.standard_t(DEGREES_OF_FREEDOM))
            size = size if self.two_sided else abs(size)
            if abs(size) <= self.most(plate):
                return size


def _fixed(value: float) -> Callable[[TruePlate], float]:
    return lambda plate: value


def _is_clamped(plate: TruePlate) -> bool:
    return "C" in plate.edges


def _is_free(plate: TruePlate) -> bool:
    return "C" not in plate.edges


def _has_plies(plate: TruePlate) -> bool:
    return len(plate.angles_deg) > 1


def _is_cross_ply(plate: TruePlate) -> bool:
    return len(set(plate.angles_deg)) > 1


def _turned(plate: TruePlate, size: float, at: tuple[int, ...]) -> TruePlate:
    angles = tuple(a + size if i in at else a for i, a in enumerate(plate.angles_deg))
    return replace(plate, angles_deg=angles)


def _outer(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return _turned(plate, size, (0, len(plate.angles_deg) - 1))


def _inner(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    middle = len(plate.angles_deg) // 2
    return _turned(plate, size, (middle - 2, middle + 1))


def _anywhere(plate: TruePlate, rng: np.random.Generator) -> Aux:
    x, y = rng.uniform(0.02, 0.98, 2)
    return {"x": float(x), "y": float(y)}


def _loaded(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    m = size * plate.total_mass
    mass = Mass(m, aux["x"] * plate.length, aux["y"] * plate.width, m * _GYRATION**2)
    return replace(plate, masses=(*plate.masses, mass))


def _patch(plate: TruePlate, rng: np.random.Generator) -> Aux:
    """A patch of any form and extent: from a twentieth to a quarter of the sides, half widths."""
    half = np.exp(rng.uniform(np.log(0.05), np.log(0.25), 2))
    form = str(rng.choice(["rectangle", "ellipse", "smooth"]))
    if form == "smooth":
        half = half / 2.0
    x, y = rng.uniform(0.05, 0.95, 2)
    return {"form": form, "x": float(x), "y": float(y), "half": [float(h) for h in half]}


def _softer(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    half = [h * side for h, side in zip(aux["half"], (plate.length, plate.width), strict=True)]
    patch = Patch(aux["form"], aux["x"] * plate.length, aux["y"] * plate.width, half[0], half[1], size)
    return replace(plate, patches=(*plate.patches, patch))


def _cut(plate: TruePlate, rng: np.random.Generator) -> Aux:
    """A hole, or a free corner cut off; the ratio of its widths."""
    ratio = float(np.exp(rng.uniform(-0.5, 0.5)))
    if rng.random() < 0.5:
        x, y = rng.uniform(0.15, 0.85, 2)
        return {"form": "ellipse", "x": float(x), "y": float(y), "ratio": ratio}
    x = 1.0 if _is_clamped(plate) else float(rng.integers(2))
    return {"form": "rectangle", "x": x, "y": float(rng.integers(2)), "ratio": ratio}


def _without(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    """A part whose half widths are this fraction of the sides is gone."""
    half_x, half_y = size * plate.length * aux["ratio"], size * plate.width / aux["ratio"]
    gap = Patch(aux["form"], aux["x"] * plate.length, aux["y"] * plate.width, half_x, half_y, 1.0, gone=True)
    return replace(plate, patches=(*plate.patches, gap))


def _soft(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return replace(plate, turn=0.02 * size * aux["ratio"], shift=0.002 * size / aux["ratio"])


def _ratio(plate: TruePlate, rng: np.random.Generator) -> Aux:
    return {"ratio": float(np.exp(rng.uniform(-0.8, 0.8)))}


def _number(name: str) -> Callable[[TruePlate, float, Aux], TruePlate]:
    def apply(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
        changed: dict[str, Any] = {name: size}
        return replace(plate, **changed)

    return apply


def _scaled(name: str) -> Callable[[TruePlate, float, Aux], TruePlate]:
    return lambda plate, size, aux: replace(plate, **{name: getattr(plate, name) * (1.0 + size)})


def _longer(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return replace(plate, length=plate.length + size)


def _tapered(axis: int) -> Callable[[TruePlate, float, Aux], TruePlate]:
    return lambda plate, size, aux: replace(plate, taper=(size, 0.0) if axis == 0 else (0.0, size))


def _all_turned(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    return _turned(plate, size, tuple(range(len(plate.angles_deg))))


def _other_ratio(plate: TruePlate, size: float, aux: Aux) -> TruePlate:
    given = plate.constants.get("G13", plate.constants["G12"])
    return replace(plate, constants={**plate.constants, "G13": given * (1.0 + size)})


FLAWS: dict[str, Flaw] = {
    flaw.cause: flaw
    for flaw in (
        Flaw("clamp_rotation", _fixed(0.02), _fixed(1.0), _number("turn"), False, applies=_is_clamped),
        Flaw("clamp_translation", _fixed(0.002), _fixed(0.05), _number("shift"), False, applies=_is_clamped),
        Flaw("soft_clamp", _fixed(1.0), _fixed(20.0), _soft, False, _ratio, _is_clamped),
        Flaw("clamp_slip", _fixed(0.05), _fixed(0.3), _number("loose"), False, applies=_is_clamped),
        Flaw("clamp_length", _fixed(5e-4), _fixed(0.015), _longer, applies=_is_clamped),
        Flaw("sensor_mass", _fixed(0.01), _fixed(0.1), _loaded, False, _anywhere),
        Flaw("support", _fixed(8.0), _fixed(25.0), _number("foundation_hz"), False, applies=_is_free),
        Flaw("thickness", _fixed(0.01), _fixed(0.3), _scaled("thickness")),
        Flaw("density", _fixed(0.01), _fixed(0.4), _scaled("density")),
        Flaw("length", _fixed(0.002), _fixed(0.1), _scaled("length")),
        Flaw("width", _fixed(0.002), _fixed(0.1), _scaled("width")),
        Flaw("frequency_scale", _fixed(0.002), _fixed(0.02), _number("scale")),
        Flaw("taper_x", _fixed(0.03), _fixed(0.3), _tapered(0)),
        Flaw("taper_y", _fixed(0.03), _fixed(0.3), _tapered(1)),
        Flaw("skew", _fixed(1.0), _fixed(10.0), _number("skew_deg"), applies=_is_free),
        Flaw("misorientation", _fixed(2.0), _fixed(45.0), _all_turned, applies=_has_plies),
        Flaw("outer_ply_angle", _fixed(5.0), _fixed(45.0), _outer, applies=_has_plies),
        Flaw("inner_ply_angle", _fixed(20.0), _fixed(90.0), _inner, applies=_is_cross_ply),
        Flaw("warp", _fixed(5e-4), lambda p: 3.0 * p.thickness, _number("sag")),
        Flaw("membrane_stress", _fixed(3e5), _fixed(6e6), _number("stress")),
        Flaw("transverse_shear", _fixed(0.3), _fixed(1.5), _number("log_shear")),
        Flaw("shear_ratio", _fixed(0.25), _fixed(0.8), _other_ratio, applies=_has_plies),
        Flaw("damage", _fixed(0.2), _fixed(0.9), _softer, False, _patch),
        Flaw("outline", _fixed(0.03), _fixed(0.15), _without, False, _cut),
        Flaw(
            "resin_skin",
            _fixed(5e-5),
            _fixed(2.5e-4),
            lambda plate, size, aux: replace(plate, skins=(size, size)),
            False,
            applies=_has_plies,
        ),
        Flaw("viscoelastic", _fixed(0.01), _fixed(0.08), _number("tan_delta"), False),
    )
}
