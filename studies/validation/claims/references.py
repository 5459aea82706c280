"""What a user would do instead of a diagnosis.

Simple methods take the residuals of the plain fit, linear in the constants about the truth, and name one
cause or none: the mode that misfits most, the Bayesian information criterion over causes, a likelihood ratio
at 5 %, sparse regression on the signatures (orthogonal matching pursuit). They have the signatures of the
independent elements: shifts of ln f at a grid of sizes and places, solved at the reference constants.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from validation.independent.elements import BucklingError
from validation.independent.lists import FURTHER, Linear, NominalPlate, linear_of
from validation.independent.true_plate import (
    DEGREES_OF_FREEDOM,
    FLAWS,
    Aux,
    TruePlate,
    matrices,
    modes,
    natural_frequencies,
    observed,
)

Array = NDArray[np.float64]
Record = dict[str, Any]

# Signatures

MESH = 8
# Sizes at which a signature is solved, in prior scales.
_SIZES = (0.3, 1.0, 3.0, 10.0)
_PLACES = (0.06, 0.28, 0.5, 0.72, 0.94)
# Half widths of a soft patch, of the sides.
_PATCH = 0.1
# Sizes of the fine grid, in prior scales: 3 % apart, from where nothing shows to where priors end.
_FINE = np.exp(np.arange(np.log(0.02), np.log(40.0), 0.03))


@dataclass(frozen=True, slots=True)
class Signature:
    """Shifts of ln f of a cause at one place: sizes (k,) ascending with 0, shift (k, n_modes)."""

    cause: str
    place: int
    scale: float
    sizes: Array
    shift: Array

    def fine(self) -> tuple[Array, Array, Array]:
        """Sizes on a fine grid, shifts there, and log weights of the prior."""
        both = np.concatenate([-_FINE[::-1], _FINE]) * self.scale
        size = both[(both >= self.sizes[0]) & (both <= self.sizes[-1])]
        curve = PchipInterpolator(np.arcsinh(self.sizes / self.scale), self.shift, axis=0)
        step = np.gradient(size)
        density = (1.0 + (size / self.scale) ** 2 / DEGREES_OF_FREEDOM) ** (-(DEGREES_OF_FREEDOM + 1.0) / 2.0)
        weight = density * step
        return size, np.asarray(curve(np.arcsinh(size / self.scale))), np.log(weight / weight.sum())


@dataclass(frozen=True, slots=True)
class Dictionary:
    """All signatures of a plate at its reference constants, with the modes that they are of."""

    plate: NominalPlate
    signatures: tuple[Signature, ...]
    shapes: Array
    inertia: Any

    def at(self, plate: TruePlate) -> tuple[Linear, NDArray[np.int64]]:
        """The linear plate at other constants, and which reference mode each of its modes is."""
        meshed = replace(plate, mesh=MESH)
        _, shapes = modes(meshed, self.shapes.shape[1])
        overlap = np.abs(self.shapes.T @ (self.inertia @ shapes))
        rows, columns = linear_sum_assignment(-overlap)
        order = np.empty(len(rows), dtype=np.int64)
        order[columns] = rows
        return linear_of(self.plate, plate, mesh=MESH), order


def dictionary_of(nominal: NominalPlate, causes: Collection[str] = tuple(FLAWS)) -> Dictionary:
    """Solve the signatures of a plate, of all causes or of some."""
    bare = replace(nominal.plate, mesh=MESH)
    n = nominal.n_modes + FURTHER
    f, shapes = modes(bare, n)
    ln_f = np.log(observed(bare, f))
    signatures = []
    for cause, flaw in FLAWS.items():
        if cause in causes and flaw.applies(nominal.plate):
            for i, aux in enumerate(_places(cause, nominal.plate)):
                signature = signature_of(bare, cause, aux, ln_f, i)
                if len(signature.sizes) > 2:
                    signatures.append(signature)
    return Dictionary(nominal, tuple(signatures), shapes, matrices(bare)[1])


def signature_of(
    bare: TruePlate, cause: str, aux: Aux, ln_f: Array, place: int, size: float | None = None
) -> Signature:
    """Shifts of a cause at one place; size : one more at which they are solved."""
    flaw = FLAWS[cause]
    scale, most = flaw.scale(bare), flaw.most(bare)
    at = {min(s * scale, most) for s in _SIZES}
    if flaw.two_sided:
        at |= {-s for s in at}
    if size is not None:
        at |= {size, 0.8 * size, 1.25 * size if abs(1.25 * size) <= most else size}
    sizes, shifts = [0.0], [np.zeros(len(ln_f))]
    for value in sorted(at):
        try:
            f = natural_frequencies(flaw.apply(bare, value, aux), len(ln_f))
        except BucklingError:
            continue
        sizes.append(value)
        shifts.append(np.log(f) - ln_f)
    rank = np.argsort(sizes)
    return Signature(cause, place, scale, np.array(sizes)[rank], np.array(shifts)[rank])


def _places(cause: str, plate: TruePlate) -> list[Aux]:
    grid = [{"x": x, "y": y} for x, y in product(_PLACES, _PLACES)]
    if cause == "sensor_mass":
        return list(grid)
    if cause == "damage":
        return [{**at, "form": "ellipse", "half": [_PATCH, _PATCH]} for at in grid]
    if cause == "outline":
        ends = (1.0,) if "C" in plate.edges else (0.0, 1.0)
        corners = [{"x": x, "y": y, "form": "rectangle", "ratio": 1.0} for x, y in product(ends, (0.0, 1.0))]
        inside = (0.25, 0.5, 0.75)
        holes = [{"x": x, "y": y, "form": "ellipse", "ratio": 1.0} for x, y in product(inside, inside)]
        return [*corners, *holes]
    return [{"ratio": 1.0}] if cause == "soft_clamp" else [{}]


def listed_hz(entry: Record) -> Array:
    """The frequencies in a list's file."""
    text = next(line for line in entry["file"].splitlines() if line.startswith("frequencies_hz"))
    return np.array([float(t) for t in text.split("[")[1].rstrip("]").split(",")])


class Plain:
    """A list about the truth: ln f measured and true, and its slopes."""

    def __init__(self, dictionary: Dictionary, entry: Record) -> None:
        truth = entry["truth"]
        nominal = dictionary.plate
        self.true = replace(nominal.plate, constants={**nominal.plate.constants, **truth["constants"]})
        self.linear, self.order = dictionary.at(self.true)
        self.measured = np.log(listed_hz(entry))
        missed = list(truth["missed"]) if not truth["complete"] else []
        self.modes = np.delete(np.arange(len(self.linear.ln_f)), missed)[: nominal.n_modes]


# Simpler methods

METHODS = ("largest_residual", "BIC", "likelihood_ratio", "sparse_regression")
# Repeatability that is assumed where a file states none.
_ASSUMED = 0.003
# Residuals of a mode that are looked into, standard deviations.
_LARGE = 3.0
_ATOMS = 2
# Parameters of a cause: its size, and its place.
_AT_A_PLACE = ("sensor_mass", "damage", "outline")


@dataclass(frozen=True, slots=True)
class Whitened:
    """Residuals of the plain fit and shifts of the causes, both less what the constants take up.

    residual : (n,) in noise. atoms : by cause, its shifts over sizes and places (k, n); one : at one scale.
    """

    residual: Array
    atoms: dict[str, Array]
    one: dict[str, Array]
    degrees: int


def whitened(dictionary: Dictionary, entry: Record) -> Whitened:
    """The list as the methods see it: constants at least squares, causes at a grid of sizes."""
    plain = Plain(dictionary, entry)
    noise = entry["truth"]["noise"] if entry["truth"]["stated"] else _ASSUMED
    slope = plain.linear.slope[plain.modes] / noise
    basis, values, _ = np.linalg.svd(slope, full_matrices=False)
    # priors of the constants: what they hold firmly is not free
    keep = basis * (values / np.sqrt(values**2 + 1.0))
    less = np.eye(len(plain.modes)) - keep @ keep.T
    residual = less @ (plain.measured - plain.linear.ln_f[plain.modes]) / noise
    atoms: dict[str, list[Array]] = {}
    one: dict[str, list[Array]] = {}
    for s in dictionary.signatures:
        size, shift, _ = s.fine()
        seen = shift[:, plain.order][:, plain.modes] @ less / noise
        atoms.setdefault(s.cause, []).append(seen[::2])
        one.setdefault(s.cause, []).append(seen[[int(np.argmin(np.abs(size - s.scale)))]])
    return Whitened(
        residual,
        {c: np.concatenate(v) for c, v in atoms.items()},
        {c: np.concatenate(v) for c, v in one.items()},
        max(len(plain.modes) - slope.shape[1], 1),
    )


def answers(dictionary: Dictionary, entry: Record) -> dict[str, Record]:
    """The answer of each method in the keys of a diagnosis; they have no probability."""
    seen = whitened(dictionary, entry)
    causes_by_method = {
        "largest_residual": _largest_residual(seen),
        "BIC": _criterion(seen),
        "likelihood_ratio": _likelihood_ratio(seen),
        "sparse_regression": _matching_pursuit(seen),
    }
    return {m: _answer(causes) for m, causes in causes_by_method.items()}


def _answer(causes: list[str]) -> Record:
    kind = ("none", "named", "pair")[len(causes)]
    return {"claim": kind, "causes": causes, "probability": 1.0, "constants": {}, "baseline": {}}


def _misfits(seen: Whitened) -> dict[str, float]:
    return {c: float(((seen.residual - a) ** 2).sum(axis=1).min()) for c, a in seen.atoms.items()}


def _largest_residual(seen: Whitened) -> list[str]:
    i = int(np.argmax(np.abs(seen.residual)))
    if abs(seen.residual[i]) < _LARGE:
        return []
    part = {
        c: float((np.abs(a[:, i]) / np.maximum(np.linalg.norm(a, axis=1), 1e-12)).max())
        for c, a in seen.one.items()
    }
    return [max(part, key=lambda c: part[c])]


def _criterion(seen: Whitened) -> list[str]:
    n = len(seen.residual)
    score = {c: m + _free(c) * np.log(n) for c, m in _misfits(seen).items()}
    best = min(score, key=lambda c: score[c])
    return [best] if score[best] < float(seen.residual @ seen.residual) else []


def _likelihood_ratio(seen: Whitened) -> list[str]:
    misfit = _misfits(seen)
    best = min(misfit, key=lambda c: misfit[c])
    gained = float(seen.residual @ seen.residual) - misfit[best]
    return [best] if gained > chi2.ppf(0.95, _free(best)) else []


def _matching_pursuit(seen: Whitened) -> list[str]:
    residual = seen.residual
    chosen: list[str] = []
    columns: list[Array] = []
    limit = chi2.ppf(0.95, seen.degrees)
    while len(chosen) < _ATOMS and float(residual @ residual) > limit:
        unit = {c: a / np.maximum(np.linalg.norm(a, axis=1), 1e-12)[:, None] for c, a in seen.one.items()}
        along = {c: np.abs(u @ residual) for c, u in unit.items() if c not in chosen}
        best = max(along, key=lambda c: float(along[c].max()))
        columns.append(unit[best][int(np.argmax(along[best]))])
        chosen.append(best)
        a = np.array(columns).T
        residual = seen.residual - a @ np.linalg.lstsq(a, seen.residual, rcond=None)[0]
    return chosen


def _free(cause: str) -> int:
    return 3 if cause in _AT_A_PLACE else 1
