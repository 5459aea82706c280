"""Plates as their files describe them, frequency lists with something hidden in them, and their truths.

The plates here are for tests; those of the claims benchmark are drawn (`drawn`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.independent.elements import BucklingError
from validation.independent.true_plate import (
    FLAWS,
    Aux,
    TruePlate,
    natural_frequencies,
    sensitivities,
    weight,
)

Array = NDArray[np.float64]

# Plates

# Names of the constants in files, and their units in Pa.
IN_FILE = {"E1": ("E1_GPa", 1e9), "E2": ("E2_GPa", 1e9), "nu12": ("nu12", 1.0), "G12": ("G12_GPa", 1e9)}
# Relative standard deviation of a reference constant, if a file gives one.
REFERENCE_SD = 0.1
# Constants of a plate whose file gives none lie within this fraction of the reference.
SPREAD = 0.15
RESOLUTION_HZ = 0.1
# Relative repeatability of the simulated tests by default.
NOISE = 0.002
# Relative standard deviations of gauged, weighed and data-sheet values.
SIDES_SD, THICKNESS_SD, DENSITY_SD, WEIGHT_SD = 1e-3, 1e-2, 1e-2, 2e-3

_CARBON = {"E1": 125e9, "E2": 9.0e9, "nu12": 0.30, "G12": 5.2e9}
_STIFF_CARBON = {"E1": 140e9, "E2": 8.4e9, "nu12": 0.28, "G12": 4.6e9}
_GLASS = {"E1": 39e9, "E2": 9.5e9, "nu12": 0.27, "G12": 3.9e9}
_ALUMINIUM = {"E1": 70e9, "nu12": 0.33}
_BOUNDS = {
    "carbon": {"E1": (60e9, 220e9), "E2": (4e9, 20e9), "nu12": (0.15, 0.45), "G12": (2e9, 12e9)},
    "glass": {"E1": (18e9, 70e9), "E2": (4e9, 20e9), "nu12": (0.15, 0.45), "G12": (1.8e9, 9e9)},
    "aluminium": {"E1": (50e9, 95e9), "nu12": (0.2, 0.42)},
}


@dataclass(frozen=True, slots=True)
class NominalPlate:
    """A plate as its file describes it.

    plate : with reference constants and without a flaw; its masses are known sensors.
    layup : in the notation of plate files.
    bounds : of the constants, Pa.
    known : whether the file says how accurate the reference constants are.
    n_modes : number in its lists.
    specimen : name of the plate if several files are tests of the same one.
    noise : relative repeatability of its tests.
    exact : whether sizes and density are exactly as stated.
    weighed : whether the file states the mass instead of the density.
    """

    name: str
    plate: TruePlate
    layup: str
    material: str
    known: bool
    n_modes: int
    specimen: str = ""
    noise: float = NOISE
    exact: bool = True
    weighed: bool = False

    @property
    def bounds(self) -> Mapping[str, tuple[float, float]]:
        """Search bounds of the constants, Pa."""
        return _BOUNDS[self.material]

    @property
    def constants(self) -> tuple[str, ...]:
        """Names of the constants."""
        return tuple(self.bounds)

    @property
    def relative_sd(self) -> NDArray[np.float64]:
        """Standard deviation of each constant's prior relative to its reference."""
        if self.known:
            return np.full(len(self.bounds), REFERENCE_SD)
        widths = [(high - low) / self.plate.constants[n] for n, (low, high) in self.bounds.items()]
        return np.asarray(np.array(widths) / np.sqrt(12.0))

    def drawn(self, rng: np.random.Generator) -> TruePlate:
        """The plate with constants drawn about the reference, and sizes about the stated values."""
        constants = {}
        for name, (low, high) in self.bounds.items():
            reference = self.plate.constants[name]
            while True:
                deviation = (
                    REFERENCE_SD * rng.standard_normal() if self.known else rng.uniform(-SPREAD, SPREAD)
                )
                value = reference * (1.0 + deviation)
                if low < value < high:
                    break
            constants[name] = float(value)
        if self.exact:
            return replace(self.plate, constants=constants)
        sd = {"length": SIDES_SD, "width": SIDES_SD, "thickness": THICKNESS_SD, "density": DENSITY_SD}
        sizes = {k: getattr(self.plate, k) * (1.0 + s * rng.standard_normal()) for k, s in sd.items()}
        return replace(self.plate, constants=constants, **sizes)

    def file(
        self,
        frequencies_hz: list[float],
        *,
        stated: float | None,
        complete: bool = True,
        mass: float | None = None,
    ) -> str:
        """The plate file with a list of frequencies.

        stated : relative repeatability, left out if None; mass : kg, in place of the density
        """
        p = self.plate
        lines = [f'name = "{self.name}"']
        lines += [f'specimen = "{self.specimen}"'] if self.specimen else []
        lines += ["", "[plate]"]
        lines += [f"{side}_mm = {1e3 * getattr(p, side):.6g}" for side in ("length", "width", "thickness")]
        lines += [f"density_kg_m3 = {p.density:.6g}" if mass is None else f"mass_g = {1e3 * mass:.5g}"]
        lines += [f'layup = "{self.layup}"', f'edges = "{p.edges}"']
        lines += ["", "[material]"]
        lines += [f"isotropic = {'true' if len(self.bounds) == 2 else 'false'}"]
        lines += [f"{_named(n)} = {_shown(n, p.constants[n])}" for n in self.bounds]
        if self.known:
            lines += ["", "[material.sd]"]
            lines += [f"{_named(n)} = {_shown(n, REFERENCE_SD * p.constants[n])}" for n in self.bounds]
        lines += ["", "[unknowns]"]
        lines += [f"{_named(n)} = [{_shown(n, a)}, {_shown(n, b)}]" for n, (a, b) in self.bounds.items()]
        for sensor in p.masses:
            lines += ["", "[[sensor]]", f"mass_g = {1e3 * sensor.mass:.6g}"]
            lines += [f"x_mm = {1e3 * sensor.x:.6g}", f"y_mm = {1e3 * sensor.y:.6g}"]
        lines += ["", "[measurement]", f"frequencies_hz = [{', '.join(f'{f:.1f}' for f in frequencies_hz)}]"]
        lines += [f"resolution_hz = {RESOLUTION_HZ}"]
        lines += [] if stated is None else [f"relative_std = {stated}"]
        lines += [] if complete else ["complete = false"]
        return "\n".join(lines) + "\n"


def _named(constant: str) -> str:
    return IN_FILE[constant][0]


def _shown(constant: str, value: float) -> str:
    return f"{value / IN_FILE[constant][1]:.6g}"


def _of(
    name: str,
    size_mm: tuple[float, float, float],
    layup: tuple[str, tuple[float, ...]],
    material: str,
    constants: Mapping[str, float],
    density: float,
    edges: str = "FFFF",
    *,
    known: bool,
    n_modes: int,
) -> NominalPlate:
    a, b, h = (1e-3 * s for s in size_mm)
    plate = TruePlate(a, b, h, density, edges, layup[1], constants)
    return NominalPlate(name, plate, layup[0], material, known, n_modes)


def _symmetric(text: str, half: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    return text, (*half, *half[::-1])


_CROSS_8 = _symmetric("[(0/90)_2]_s", (0.0, 90.0) * 2)
_CROSS_16 = _symmetric("[(0/90)_4]_s", (0.0, 90.0) * 4)
_CROSS_OUT_90 = _symmetric("[(90/0)_3]_s", (90.0, 0.0) * 3)
_QUASI_8 = _symmetric("[0/45/-45/90]_s", (0.0, 45.0, -45.0, 90.0))
_QUASI_16 = _symmetric("[(0/45/-45/90)_2]_s", (0.0, 45.0, -45.0, 90.0) * 2)
_METAL = ("[0]", (0.0,))


def _one_way(n: int) -> tuple[str, tuple[float, ...]]:
    return f"[0_{n}]", (0.0,) * n


PLATES = (
    _of("T1", (270, 270, 3.1), _CROSS_16, "carbon", _CARBON, 1570, known=True, n_modes=6),
    _of("T2", (310, 205, 2.3), _CROSS_OUT_90, "carbon", _STIFF_CARBON, 1600, known=False, n_modes=12),
    _of("T3", (225, 165, 2.1), _one_way(12), "carbon", _CARBON, 1555, known=True, n_modes=10),
    _of("T4", (240, 150, 2.8), _CROSS_8, "glass", _GLASS, 1950, "CFFF", known=True, n_modes=10),
    _of("T5", (255, 190, 2.0), _QUASI_16, "carbon", _STIFF_CARBON, 1590, known=True, n_modes=12),
    _of("T6", (260, 215, 2.5), _METAL, "aluminium", _ALUMINIUM, 2710, "CFFF", known=True, n_modes=10),
)

# Lists

# Number of modes beyond the list, some of which may replace missed ones.
FURTHER = 3
# Mesh for finding a size; the list itself is solved on the finer one.
_SEARCH_MESH = 10
_TOLERANCE, _STEPS = 0.05, 9
# Correlation length of the smooth discrepancy, in ln f.
_CORRELATION = (0.4, 1.2)
# A part of a compound cause below this many standard deviations is invisible.
_UNSEEN = 2.0
# Two causes are hidden together only if the cosine of their visible signatures is below this.
_MOST_ALIKE = 0.9


class UnreachableError(ValueError):
    """Error raised if a cause cannot reach the required signal to noise within its physical limit."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Content hidden in a list.

    causes : names; "other" for a smooth discrepancy; empty for a clean list.
    accepted : other names of the same physical thing on this plate.
    sizes, aux : for each cause, in the units of its flaw, and its place or form.
    ratio : signal to noise of each cause, None if it was not prescribed.
    constants : of the plate, in the units of files.
    true_hz : listed modes, without noise.
    reference_hz : of the same plate without the causes, with FURTHER additional modes.
    """

    kind: str
    plate: str
    causes: tuple[str, ...]
    accepted: tuple[str, ...]
    sizes: dict[str, float]
    aux: dict[str, Aux]
    ratio: float | None
    constants: dict[str, float]
    true_hz: tuple[float, ...]
    stated: bool
    complete: bool
    missed: tuple[int, ...] = ()
    known: bool = True
    noise: float = NOISE
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Linear:
    """ln f of the unflawed truth for more than n modes, and slopes over the constants' prior scores."""

    ln_f: Array
    slope: Array
    n: int
    noise: float

    def visible(self, shift: Array) -> Array:
        """A shift of the first n modes minus what the constants imitate within their priors, in sd."""
        a = self.slope[: self.n] / self.noise
        inner = np.eye(self.n) - a @ np.linalg.solve(a.T @ a + np.eye(a.shape[1]), a.T)
        values, vectors = np.linalg.eigh(inner)
        root = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ vectors.T
        return np.asarray(root @ shift[: self.n] / self.noise)


def linear_of(nominal: NominalPlate, plate: TruePlate, mesh: int = _SEARCH_MESH) -> Linear:
    """The plate linearised about its true constants."""
    names = nominal.constants
    ln_f, slope = sensitivities(replace(plate, mesh=mesh), names, nominal.n_modes + FURTHER)
    over = np.array([nominal.plate.constants[n] / plate.constants[n] for n in names])
    return Linear(ln_f, slope * over * nominal.relative_sd, nominal.n_modes, nominal.noise)


def size_for(
    linear: Linear, plate: TruePlate, cause: str, aux: Aux, ratio: float, sign: float
) -> tuple[float, Array]:
    """Size at which a cause has a signal to noise, and its visible shift; raises UnreachableError if none."""
    flaw = FLAWS[cause]
    coarse = replace(plate, mesh=_SEARCH_MESH)
    most = flaw.most(plate)

    def seen(size: float) -> tuple[float, Array]:
        try:
            f = natural_frequencies(flaw.apply(coarse, sign * size, aux), linear.n + FURTHER)
        except BucklingError:
            return np.inf, np.zeros(linear.n)
        visible = linear.visible(np.log(f) - linear.ln_f)
        return float(np.linalg.norm(visible)), visible

    tried: list[tuple[float, float]] = []
    size = min(flaw.scale(plate), most)
    for _ in range(_STEPS):
        norm, visible = seen(size)
        if abs(norm / ratio - 1.0) < _TOLERANCE:
            return sign * size, visible
        tried.append((size, norm))
        below = max((t for t in tried if t[1] < ratio), default=None)
        above = min((t for t in tried if t[1] >= ratio), default=None)
        if below is not None and below[0] >= most:
            break
        if below is None or above is None or not np.isfinite(above[1]):
            growth = np.clip(ratio / max(norm, 1e-9), 0.1, 6.0) if np.isfinite(norm) else 0.3
            size = float(min(size * growth, most))
            if above is not None and below is not None:
                size = float(np.sqrt(above[0] * below[0]))
        else:
            low, high = (np.log(t) for t in ((below[0], max(below[1], 1e-9)), above))
            part = np.clip((np.log(ratio) - low[1]) / max(high[1] - low[1], 1e-9), 0.05, 0.95)
            size = float(np.exp(low[0] + part * (high[0] - low[0])))
    # a hole grows by whole points of the quadrature: the nearest size will do
    size, norm = min(tried, key=lambda t: abs(np.log(max(t[1], 1e-9) / ratio)))
    if not 0.8 < norm / ratio < 1.25:
        raise UnreachableError(f"{cause} reaches {norm:.3g} times the noise of {ratio:g}")
    return sign * size, seen(size)[1]


def single(
    nominal: NominalPlate,
    cause: str,
    ratio: float | None,
    rng: np.random.Generator,
    *,
    kind: str = "one",
    aux: Aux | None = None,
    size: float | None = None,
    **how: Any,
) -> tuple[str, Truth]:
    """A list with one cause; ratio None: its size is given, or drawn from the prior."""
    plate = nominal.drawn(rng)
    flaw = FLAWS[cause]
    extra: dict[str, Any] = {}
    if ratio is None:
        aux = flaw.draw(plate, rng) if aux is None else aux
        size = flaw.prior_size(plate, rng) if size is None else size
        try:
            flawed = flaw.apply(plate, size, aux)
            natural_frequencies(replace(flawed, mesh=_SEARCH_MESH), 2)
        except BucklingError as error:
            raise UnreachableError(str(error)) from None
    else:
        linear = linear_of(nominal, plate)
        for attempt in range(4):
            place = flaw.draw(plate, rng) if aux is None else aux
            sign = float(rng.choice((-1.0, 1.0))) if flaw.two_sided else 1.0
            try:
                size, _ = size_for(linear, plate, cause, place, ratio, sign)
                aux = place
                break
            except UnreachableError:
                if attempt == 3:
                    raise
    if size is None or aux is None:
        raise ValueError(f"{cause}: a size and a place are needed")
    return listed(nominal, plate, kind, {cause: (size, aux)}, rng, ratio=ratio, extra=extra, **how)


def pair(
    nominal: NominalPlate, causes: tuple[str, str], ratio: float, rng: np.random.Generator, **how: Any
) -> tuple[str, Truth]:
    """A list with two causes of equal signal to noise whose signatures differ."""
    plate = nominal.drawn(rng)
    linear = linear_of(nominal, plate)
    for _ in range(4):
        hidden: dict[str, tuple[float, Aux]] = {}
        seen = []
        for cause in causes:
            flaw = FLAWS[cause]
            aux = flaw.draw(plate, rng)
            sign = float(rng.choice((-1.0, 1.0))) if flaw.two_sided else 1.0
            size, visible = size_for(linear, plate, cause, aux, ratio, sign)
            hidden[cause] = (size, aux)
            seen.append(visible / np.linalg.norm(visible))
        if abs(float(seen[0] @ seen[1])) < _MOST_ALIKE:
            return listed(nominal, plate, "two", hidden, rng, ratio=ratio, **how)
    raise UnreachableError(f"{causes[0]} and {causes[1]} look alike wherever they are")


def listed(
    nominal: NominalPlate,
    plate: TruePlate,
    kind: str,
    flaws: dict[str, tuple[float, Aux]],
    rng: np.random.Generator,
    *,
    ratio: float | None = None,
    stated: bool = True,
    missed: Sequence[int] = (),
    complete: bool = True,
    on_list: Callable[[Array], Array] | None = None,
    causes: tuple[str, ...] | None = None,
    accepted: tuple[str, ...] = (),
    extra: dict[str, Any] | None = None,
    changed: TruePlate | None = None,
    shift: Array | None = None,
) -> tuple[str, Truth]:
    """The file of a list and its truth.

    missed : modes that the laboratory did not see. complete : as stated in the file.
    on_list : further errors of the list. causes : if other than the names of the flaws.
    accepted : other names of the error. changed : the plate with changes that no flaw describes.
    shift : of ln f, for the list and FURTHER modes, by errors outside the plate model.
    """
    flawed = plate if changed is None else changed
    for cause, (size, aux) in flaws.items():
        flawed = FLAWS[cause].apply(flawed, size, aux)
    every = natural_frequencies(flawed, nominal.n_modes + FURTHER)
    if shift is not None:
        every = np.sort(every * np.exp(shift))
    extra = dict(extra or {})
    if flaws or changed is not None or shift is not None:
        shift = np.log(every / natural_frequencies(plate, len(every)))
        norm = np.linalg.norm(linear_of(nominal, plate).visible(shift))
        extra |= {
            "signal_to_noise": round(float(norm), 2),
            "largest_shift_percent": round(100 * float(np.abs(shift).max()), 3),
        }
    accepted = (*accepted, *same_thing(nominal, plate, flaws))
    mass = None
    if nominal.weighed:
        # a wrong density becomes a wrong weight
        mass = weight(plate if "density" in flaws else flawed) * (1.0 + WEIGHT_SD * rng.standard_normal())
    names = tuple(flaws) if causes is None else causes
    hidden = Truth(
        kind=kind,
        plate=nominal.name,
        causes=names,
        accepted=tuple(sorted(set(accepted))),
        sizes={cause: float(size) for cause, (size, _) in flaws.items()},
        aux={cause: aux for cause, (_, aux) in flaws.items() if aux},
        ratio=None if ratio is None else float(ratio),
        constants={n: float(plate.constants[n]) for n in nominal.constants},
        true_hz=(),
        stated=stated,
        complete=complete,
        missed=tuple(int(k) for k in missed),
        known=nominal.known,
        noise=nominal.noise,
        extra=extra,
    )
    return written(nominal, every, hidden, rng, on_list=on_list, mass=mass)


def written(
    nominal: NominalPlate,
    every: Array,
    truth: Truth,
    rng: np.random.Generator,
    *,
    on_list: Callable[[Array], Array] | None = None,
    mass: float | None = None,
) -> tuple[str, Truth]:
    """File and truth of a list, from true frequencies of FURTHER modes more than it has."""
    f = np.delete(every, list(truth.missed))[: nominal.n_modes]
    true_hz = f if on_list is None else on_list(f)
    noisy = true_hz * (1.0 + nominal.noise * rng.standard_normal(len(f)))
    noisy = noisy if on_list is not None else np.sort(noisy)
    stated = nominal.noise if truth.stated else None
    text = nominal.file([float(v) for v in noisy], stated=stated, complete=truth.complete, mass=mass)
    return text, replace(truth, true_hz=tuple(float(v) for v in np.round(true_hz, 3)))


def same_thing(
    nominal: NominalPlate, plate: TruePlate, flaws: dict[str, tuple[float, Aux]]
) -> tuple[str, ...]:
    """Other names of the hidden causes.

    A soft clamp is rotation and translation at once, so each of these is a soft clamp without the other; a
    soft clamp of which one part alone is below two standard deviations is the other part. The free length of
    a plate clamped along x only is its length. If all plies of one direction turn and the layup has no other
    direction, the plate is turned as a whole.
    """
    names = [_same_as(nominal, plate, cause, size, aux) for cause, (size, aux) in flaws.items()]
    return tuple(sorted({name for own in names for name in own}))


def _same_as(nominal: NominalPlate, plate: TruePlate, cause: str, size: float, aux: Aux) -> tuple[str, ...]:
    if cause in ("clamp_rotation", "clamp_translation"):
        return ("soft_clamp",)
    if cause in ("length", "clamp_length") and plate.edges in ("CFFF", "CFCF"):
        return ("clamp_length" if cause == "length" else "length",)
    if cause == "soft_clamp":
        linear = linear_of(nominal, plate)
        soft = FLAWS[cause].apply(replace(plate, mesh=_SEARCH_MESH), size, aux)
        names = []
        for name, alone in (
            ("clamp_rotation", replace(soft, shift=0.0)),
            ("clamp_translation", replace(soft, turn=0.0)),
        ):
            both, one = (np.log(natural_frequencies(p, linear.n + FURTHER)) for p in (soft, alone))
            if np.linalg.norm(linear.visible(both - one)) < _UNSEEN:
                names.append(name)
        return tuple(names)
    return ()


def smooth(
    nominal: NominalPlate,
    ratio: float | None,
    rng: np.random.Generator,
    *,
    kind: str = "smooth",
    rms: float = math.nan,
    **how: Any,
) -> tuple[str, Truth]:
    """A list whose frequencies deviate by a smooth function of ln f that no cause explains.

    ratio : signal to noise; None: the function has the given rms
    """
    plate = nominal.drawn(rng)
    linear = linear_of(nominal, plate)
    x = linear.ln_f[: nominal.n_modes]
    length = float(np.exp(rng.uniform(*np.log(_CORRELATION))))
    covariance = np.exp(-0.5 * ((x[:, None] - x) / length) ** 2) + 1e-10 * np.eye(len(x))
    shift = np.linalg.cholesky(covariance) @ rng.standard_normal(len(x))
    if ratio is None:
        shift *= rms / np.sqrt(np.mean(shift**2))
    else:
        shift *= ratio / np.linalg.norm(linear.visible(shift))
    return listed(
        nominal,
        plate,
        kind,
        {},
        rng,
        ratio=ratio,
        on_list=lambda f: np.sort(f * np.exp(shift)),
        causes=("other",),
        extra={"correlation_length": length, "shift_percent": [round(100 * float(s), 3) for s in shift]},
        **how,
    )


def misread(nominal: NominalPlate, ratio: float, rng: np.random.Generator, **how: Any) -> tuple[str, Truth]:
    """A list with one misread frequency that keeps its rank."""
    plate = nominal.drawn(rng)
    linear = linear_of(nominal, plate)
    n = nominal.n_modes
    for i in rng.permutation(n):
        unit = np.zeros(n)
        unit[i] = 1.0
        shift = float(rng.choice((-1.0, 1.0)) * ratio / np.linalg.norm(linear.visible(unit)))
        ln_f = linear.ln_f[:n] + shift * unit
        if abs(shift) < 0.4 and (np.diff(ln_f) > 4 * nominal.noise).all():
            return listed(
                nominal,
                plate,
                how.pop("kind", "one"),
                {},
                rng,
                ratio=ratio,
                on_list=lambda f, i=i, s=shift: f * np.where(np.arange(len(f)) == i, np.exp(s), 1.0),  # type: ignore[misc]
                causes=("outlier",),
                extra={"frequency": int(i) + 1, "shift_percent": round(100 * shift, 3)},
                **how,
            )
    raise UnreachableError("no frequency can be misread by so much and keep its place")
