"""Plates and lists drawn from priors: sizes, materials, noise, lengths of lists, and the hidden error.

Every list is of a plate of its own. Sizes, density or weight deviate from what the file states as much as a
gauge, a balance and a data sheet do; frequencies deviate from those of the elements as three dimensions do,
by the bias found with bricks for the most similar plate (`studies/16_theory_error.py`). Beside causes of the
catalogue there are real forms of them, combinations that misled earlier versions, and other errors.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.independent import elements, forms, lists
from validation.independent.elements import BucklingError
from validation.independent.lists import FURTHER, NominalPlate, Truth, UnreachableError
from validation.independent.true_plate import (
    FLAWS,
    Mass,
    TruePlate,
    has_plies,
    is_free,
    natural_frequencies,
)

Array = NDArray[np.float64]
Made = tuple[str, Truth]
Maker = Callable[[NominalPlate, np.random.Generator], Made]

BIASES = Path(__file__).parents[2] / "results" / "16_theory_error.json"

# Number of lists of each kind.
CLEAN, ONE, TWO, OF_LIST, BEYOND, FORMER, BY_STRENGTH = 40, 70, 16, 14, 6, 4, 2
# Signal-to-noise ratios of the stress set.
STRENGTHS = (4.0, 8.0, 16.0, 32.0, 100.0)
# Fractions of files that state the repeatability, [material.sd], the mass instead of the density.
_STATED, _KNOWN, _WEIGHED = 2 / 3, 1 / 2, 1 / 2

# Plates

_SIDE, _ASPECT, _SLENDER = (0.15, 0.36), (0.55, 0.95), (40.0, 130.0)
_NOISE, _MODES = (5e-4, 1e-2), (6, 14)
_EDGES = ("FFFF",) * 6 + ("CFFF",) * 3 + ("CFCF", "SSSS")
# Relative standard deviation of the moduli of a file about those of their material.
_OTHER_BATCH = 0.08
# Constants, Pa, and density, kg/m3.
_MATERIALS: dict[str, tuple[dict[str, float], float]] = {
    "carbon": ({"E1": 130e9, "E2": 8.8e9, "nu12": 0.30, "G12": 4.9e9}, 1570.0),
    "glass": ({"E1": 40e9, "E2": 10.0e9, "nu12": 0.27, "G12": 4.0e9}, 1930.0),
    "aluminium": ({"E1": 70e9, "nu12": 0.33}, 2700.0),
}
_KINDS = ("carbon",) * 4 + ("glass",) * 2 + ("aluminium",)
_LAYUPS = {
    "[(0/90)_2]_s": (0.0, 90.0, 0.0, 90.0),
    "[(90/0)_3]_s": (90.0, 0.0, 90.0, 0.0, 90.0, 0.0),
    "[(0/90)_4]_s": (0.0, 90.0) * 4,
    "[0/0/90/0]_s": (0.0, 0.0, 90.0, 0.0),
    "[0_8]": (0.0,) * 4,
    "[0_12]": (0.0,) * 6,
    "[0/45/-45/90]_s": (0.0, 45.0, -45.0, 90.0),
    "[(0/45/-45/90)_2]_s": (0.0, 45.0, -45.0, 90.0) * 2,
}


def plate(rng: np.random.Generator, on: Callable[[TruePlate], bool]) -> NominalPlate:
    """A plate that a laboratory might test, as its file describes it; on : condition on the plate."""
    while True:
        kind = str(rng.choice(_KINDS))
        usual, density = _MATERIALS[kind]
        constants = {n: _six(v * np.exp(_OTHER_BATCH * rng.standard_normal())) for n, v in usual.items()}
        text = "[0]" if kind == "aluminium" else str(rng.choice(list(_LAYUPS)))
        half = _LAYUPS.get(text, ())
        length = round(float(rng.uniform(*_SIDE)), 4)
        width = round(length * float(rng.uniform(*_ASPECT)), 4)
        true = TruePlate(
            length=length,
            width=width,
            thickness=round(width / float(rng.uniform(*_SLENDER)), 5),
            density=_six(density * np.exp(0.01 * rng.standard_normal())),
            edges=str(rng.choice(_EDGES)),
            angles_deg=(*half, *half[::-1]) or (0.0,),
            constants=constants,
        )
        noise = float(np.exp(rng.uniform(*np.log(_NOISE))))
        nominal = NominalPlate(
            name="plate",
            plate=true,
            layup=text,
            material=kind,
            known=bool(rng.random() < _KNOWN),
            n_modes=int(rng.integers(_MODES[0], _MODES[1] + 1)),
            noise=float(f"{noise:.2g}"),
            exact=False,
            weighed=bool(rng.random() < _WEIGHED),
        )
        if on(true):
            return replace(nominal, plate=replace(true, bias=bias(true, nominal.n_modes + FURTHER)))


def _six(value: float) -> float:
    return float(f"{value:.6g}")


@cache
def _measured_biases() -> tuple[tuple[bool, tuple[bool, bool], float, float, Array], ...]:
    """For each plate solved with bricks: clamped or not, kinds of angles, slenderness, E1/G13, and bias."""
    cases = json.loads(BIASES.read_text("utf-8"))["cases"]
    return tuple(
        (
            "C" in c["edges"],
            ("90" in c["layup"], "45" in c["layup"]),
            1.0 / c["h_over_short_side"],
            c["E1_over_G13"],
            np.log([m["bricks_hz"] / m["ritz_hz"] for m in c["modes"]]),
        )
        for c in cases
    )


def bias(true: TruePlate, n_modes: int) -> tuple[float, ...]:
    """Difference of ln f between three dimensions and first-order theory, taken from the most similar bricks.

    Modes beyond theirs get the value of their last. Supports were not computed: zero.
    """
    if "S" in true.edges:
        return (0.0,) * n_modes
    full = elements.completed(true.constants)
    slender, shear = true.width / true.thickness, full["E1"] / full["G13"]
    angles = {abs(a) for a in true.angles_deg}
    kind = "C" in true.edges, (90.0 in angles, bool(angles - {0.0, 90.0}))
    like = [row[2:] for row in _measured_biases() if row[:2] == kind]
    found = min(like, key=lambda r: abs(np.log(r[0] / slender)) + abs(np.log(r[1] / shear)))[2]
    return tuple(float(v) for v in found[np.minimum(np.arange(n_modes), len(found) - 1)])


# Errors that are no cause of the catalogue


def _by_form(
    act: Callable[..., forms.Matrices],
    low: float,
    high: float,
    causes: tuple[str, ...],
    accepted: tuple[str, ...] = (),
    kind: str = "beyond",
) -> Maker:
    """Maker of lists with a form of random size somewhere on the plate."""

    def make(nominal: NominalPlate, rng: np.random.Generator) -> Made:
        true, size = nominal.drawn(rng), float(rng.uniform(low, high))
        place = tuple(float(v) for v in rng.uniform(0.15, 0.85, 2))
        on = forms.bench(true, nominal.n_modes + FURTHER)
        shift = on.solved(act(on, size, place)) - np.log(on.frequencies)
        extra = {"size": size, "place": place}
        return _listed(nominal, true, kind, rng, shift=shift, causes=causes, accepted=accepted, extra=extra)

    return make


def _listed(nominal: NominalPlate, true: TruePlate, kind: str, rng: np.random.Generator, **how: Any) -> Made:
    return lists.listed(nominal, true, kind, {}, rng, stated=is_stated(rng), **how)


def is_stated(rng: np.random.Generator) -> bool:
    """Randomly decide whether a file states the repeatability."""
    return bool(rng.random() < _STATED)


def signed(rng: np.random.Generator, low: float, high: float) -> float:
    """A size from low to high, of either sign."""
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(low, high))


def _loose_core(on: forms.Bench, size: float, place: forms.Place) -> forms.Matrices:
    """The halves slide on each other over an ellipse, where a quarter of the bending stiffness is left."""
    away = (on.mesh.points / on.sides[:, None] - np.array(place)[:, None]) / size
    left = np.ones((len(away[0]), 8, 8))
    left[np.hypot(*away) < 1.0, 3:6, 3:6] = 0.25
    return forms.of_stiffness(on, on.laminate * left)


def _pulled(on: forms.Bench, size: float, place: forms.Place) -> forms.Matrices:
    """A cable acts on the plate as a spring at one place."""
    return forms.padded(np.array([place]), np.ones(1), on, size, place)


def _drifting(on: forms.Bench, size: float, place: forms.Place) -> forms.Matrices:
    """The plies turn along x, from -size to size degrees."""
    turned = np.linspace(-size, size, 25)
    of_ply = elements.completed(on.plate.constants)
    ply = on.plate.thickness / len(on.plate.angles_deg)
    each = np.array(
        [elements.laminate_stiffness([(of_ply, a + t, ply) for a in on.plate.angles_deg]) for t in turned]
    )
    nearest = np.rint(on.mesh.points[0] / on.plate.length * (len(turned) - 1)).astype(int)
    return forms.of_stiffness(on, each[nearest])


_stepped = partial(forms.of_thickness, forms.THICKNESS["step"], 0)


def _warming(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    """The plate softens from the first line to the last as it warms up."""
    n = nominal.n_modes + FURTHER
    drift = signed(rng, 0.003, 0.02)
    shift = drift * np.arange(n) / (nominal.n_modes - 1)
    true = nominal.drawn(rng)
    return _listed(nominal, true, "beyond", rng, shift=shift, causes=("other",), extra={"drift": drift})


def has_bench(true: TruePlate) -> bool:
    """Whether it is free or clamped at x = 0 only, as required by `forms.bench` and bricks with flaws."""
    return true.edges in ("FFFF", "CFFF")


def _any(true: TruePlate) -> bool:
    return True


# Name -> condition on the plate, and maker.
_BEYOND: dict[str, tuple[Callable[[TruePlate], bool], Maker]] = {
    "loose core": (has_bench, _by_form(_loose_core, 0.1, 0.3, ("other",), ("damage",))),
    "two thicknesses": (has_bench, _by_form(_stepped, 0.02, 0.1, ("other",), ("taper_x",))),
    "drifting plies": (
        lambda true: has_bench(true) and has_plies(true),
        _by_form(_drifting, 3.0, 12.0, ("other",), ("misorientation", "outer_ply_angle")),
    ),
    "warming": (_any, _warming),
    "cable": (is_free, _by_form(_pulled, 0.1, 0.3, ("other",), ("support",))),
}

# Errors that misled earlier versions


def _two_accelerometers(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    true = nominal.drawn(rng)
    grams = true.total_mass * np.exp(rng.uniform(np.log(0.01), np.log(0.05), 2))
    places = rng.uniform(0.05, 0.95, (2, 2)) * (true.length, true.width)
    masses = tuple(Mass(float(m), *map(float, at)) for m, at in zip(grams, places, strict=True))
    return _listed(
        nominal,
        true,
        "former: two accelerometers",
        rng,
        changed=replace(true, masses=masses),
        causes=("sensor_mass",),
        accepted=("sensor_mass#2",),
    )


def _ply_missing(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    true = nominal.drawn(rng)
    n = len(true.angles_deg)
    angles = tuple(np.delete(true.angles_deg, int(rng.integers(n))).tolist())
    changed = replace(true, angles_deg=angles, thickness=true.thickness * (n - 1) / n)
    return _listed(
        nominal,
        true,
        "former: a ply missing",
        rng,
        changed=changed,
        causes=("layup",),
        accepted=("thickness",),
    )


def _taped(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    true = nominal.drawn(rng)
    free = [e for e, kind in zip(elements.EDGES, true.edges, strict=True) if kind == "F"]
    strip = (str(rng.choice(free)), true.total_mass * float(rng.uniform(0.01, 0.04)))
    changed = replace(true, strips=(strip,))
    return _listed(nominal, true, "former: tape along an edge", rng, changed=changed, causes=("edge_mass",))


def _both_tapers(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    x, y = (rng.choice((-1.0, 1.0), 2) * rng.uniform(0.03, 0.12, 2)).tolist()
    true = nominal.drawn(rng)
    return _listed(
        nominal,
        true,
        "former: tapered along both sides",
        rng,
        changed=replace(true, taper=(x, y)),
        causes=("taper_x", "taper_y"),
        extra={"size": [x, y]},
    )


def _mass_and_misread(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    true = nominal.drawn(rng)
    mass = FLAWS["sensor_mass"]
    loaded = mass.apply(true, float(rng.uniform(0.01, 0.05)), mass.draw(true, rng))
    f = natural_frequencies(loaded, nominal.n_modes)
    room = np.diff(np.log(np.concatenate([[f[0] / 1.3], f, [f[-1] * 1.3]])))
    for i in rng.permutation(nominal.n_modes):
        sign = float(rng.choice((-1.0, 1.0)))
        by = float(rng.uniform(0.01, 0.03))
        if by < 0.7 * room[i + (sign > 0)] and by > 4.0 * nominal.noise:
            factor = np.where(np.arange(nominal.n_modes) == i, np.exp(sign * by), 1.0)
            return _listed(
                nominal,
                true,
                "former: accelerometer and misread line",
                rng,
                changed=loaded,
                on_list=partial(np.multiply, factor),
                causes=("sensor_mass", "outlier"),
                extra={"frequency": int(i) + 1, "shift": sign * by},
            )
    raise UnreachableError("no frequency can be misread by so much and keep its place")


def _fixed(cause: str, low: float, high: float, kind: str, **aux: Any) -> Maker:
    """Maker of lists with a cause of the catalogue whose size is between low and high."""

    def make(nominal: NominalPlate, rng: np.random.Generator) -> Made:
        flaw = FLAWS[cause]
        size = float(rng.uniform(low, high)) * (float(rng.choice((-1.0, 1.0))) if flaw.two_sided else 1.0)
        return lists.single(
            nominal, cause, None, rng, kind=kind, size=size, aux=aux or None, stated=is_stated(rng)
        )

    return make


def _four_pads(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    pads = [form for form in forms.FORMS if form.cause == "support"]
    act = pads[int(rng.integers(len(pads)))].act
    return _by_form(act, 0.15, 0.35, ("support",), kind="former: four pads")(nominal, rng)


def _smooth(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    kind = "former: smooth error of 1 %"
    return lists.smooth(nominal, None, rng, kind=kind, rms=0.01, stated=is_stated(rng))


_FORMER: dict[str, tuple[Callable[[TruePlate], bool], Maker]] = {
    "two accelerometers": (_any, _two_accelerometers),
    "four pads": (is_free, _four_pads),
    "a ply missing": (has_plies, _ply_missing),
    "tape": (lambda true: "F" in true.edges, _taped),
    "plies turned": (has_plies, _fixed("misorientation", 7.0, 11.0, "former: plies turned by 9 degrees")),
    "smooth": (_any, _smooth),
    "both tapers": (_any, _both_tapers),
    "corner": (
        lambda true: true.edges[2] == "F" and true.edges[3] == "F",
        _fixed("outline", 0.04, 0.1, "former: a missing corner", form="rectangle", x=1.0, y=1.0, ratio=1.0),
    ),
    "mass and misread": (_any, _mass_and_misread),
}

# Others


def _clean(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    return _listed(nominal, nominal.drawn(rng), "clean", rng)


def _one(cause: str, nominal: NominalPlate, rng: np.random.Generator) -> Made:
    return lists.single(nominal, cause, None, rng, kind="prior", stated=is_stated(rng))


def _of_strength(cause: str, ratio: float, nominal: NominalPlate, rng: np.random.Generator) -> Made:
    return lists.single(nominal, cause, ratio, rng, stated=is_stated(rng))


def _two(causes: tuple[str, str], nominal: NominalPlate, rng: np.random.Generator) -> Made:
    """A list with two causes whose sizes are from their priors."""
    true = nominal.drawn(rng)
    hidden = {}
    for cause in causes:
        aux = FLAWS[cause].draw(true, rng)
        hidden[cause] = (FLAWS[cause].prior_size(true, rng), aux)
    try:
        return lists.listed(nominal, true, "two", hidden, rng, stated=is_stated(rng))
    except BucklingError as error:
        raise UnreachableError(str(error)) from None


def _misread(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    return lists.misread(
        nominal, float(np.exp(rng.uniform(np.log(4.0), np.log(60.0)))), rng, stated=is_stated(rng)
    )


def _missed(nominal: NominalPlate, rng: np.random.Generator) -> Made:
    k = int(rng.integers(nominal.n_modes))
    return _listed(nominal, nominal.drawn(rng), "one", rng, missed=[k], causes=("mode_identity",))


def plans() -> Iterator[tuple[str, Callable[[TruePlate], bool], Maker]]:
    """All lists: name, condition on the plate, and maker."""
    for k in range(CLEAN):
        yield f"clean-{k:02d}", _any, _clean
    causes = list(FLAWS)
    for k in range(ONE):
        cause = causes[(7 * k) % len(causes)]
        yield f"prior-{k:02d}-{cause}", FLAWS[cause].applies, partial(_one, cause)
    for k in range(TWO):
        pair = (causes[(5 * k) % len(causes)], causes[(11 * k + 7) % len(causes)])
        if pair[0] != pair[1]:
            yield f"two-{k:02d}", partial(_both_apply, pair), partial(_two, pair)
    for k in range(OF_LIST):
        yield f"list-{k:02d}", _any, _missed if k % 2 else _misread
    for name, (on, make) in _BEYOND.items():
        for k in range(BEYOND):
            yield f"beyond-{name.replace(' ', '-')}-{k}", on, make
    for name, (on, make) in _FORMER.items():
        for k in range(FORMER):
            yield f"former-{name.replace(' ', '-')}-{k}", on, make
    for i, (cause, flaw) in enumerate(FLAWS.items()):
        for k in range(BY_STRENGTH):
            ratio = STRENGTHS[(i + 2 * k) % len(STRENGTHS)]
            yield f"strength-{cause}-{ratio:g}", flaw.applies, partial(_of_strength, cause, ratio)


def _both_apply(pair: tuple[str, str], true: TruePlate) -> bool:
    return all(FLAWS[cause].applies(true) for cause in pair)
