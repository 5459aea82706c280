"""Simple methods that a user might apply instead of a diagnosis.

The methods take the residuals of the plain fit, linear in the constants about the truth, and name a cause:
that of the mode with the largest misfit, the best by the Bayesian information criterion or by the likelihood,
or the one or two of a sparse regression on the signatures (orthogonal matching pursuit). They are given the
signatures of the independent elements, shifts of ln f on a grid of sizes and places, solved at the reference
constants, and those of a misread frequency and of a missed mode.

Each reports one number, its statistic, that measures the improvement over no cause, and abstains below a
threshold, which is chosen on other lists for a given rate of wrong claims.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from validation.claims.scoring import RIGHT, WRONG, Scored
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
# Sizes at which a signature is solved, in prior standard deviations.
_SIZES = (0.3, 1.0, 3.0, 10.0)
_PLACES = (0.06, 0.28, 0.5, 0.72, 0.94)
# Half widths of a soft patch, relative to the sides.
_PATCH = 0.1
# Sizes of the fine grid, in prior standard deviations: 3 % apart, from undetectable to the ends of priors.
_FINE = np.exp(np.arange(np.log(0.02), np.log(40.0), 0.03))


@dataclass(frozen=True, slots=True)
class Signature:
    """Shifts of ln f by a cause at one place: sizes (k,) ascending and including 0, shift (k, n_modes)."""

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
    """All signatures of a plate at its reference constants, with the mode shapes."""

    plate: NominalPlate
    signatures: tuple[Signature, ...]
    shapes: Array
    inertia: Any

    def at(self, plate: TruePlate) -> tuple[Linear, NDArray[np.int64]]:
        """The plate linearised at other constants, and the reference mode of each of its modes."""
        meshed = replace(plate, mesh=MESH)
        _, shapes = modes(meshed, self.shapes.shape[1])
        overlap = np.abs(self.shapes.T @ (self.inertia @ shapes))
        rows, columns = linear_sum_assignment(-overlap)
        order = np.empty(len(rows), dtype=np.int64)
        order[columns] = rows
        return linear_of(self.plate, plate, mesh=MESH), order


def dictionary_of(nominal: NominalPlate, causes: Collection[str] = tuple(FLAWS)) -> Dictionary:
    """Solve the signatures of a plate, of all causes or some."""
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
    """Shifts of a cause at one place; size : a further one at which they are solved."""
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
    """Frequencies in a list's file."""
    text = next(line for line in entry["file"].splitlines() if line.startswith("frequencies_hz"))
    return np.array([float(t) for t in text.split("[")[1].rstrip("]").split(",")])


class Plain:
    """A list linearised about the truth: measured and true ln f, and its slopes."""

    def __init__(self, dictionary: Dictionary, entry: Record) -> None:
        truth = entry["truth"]
        nominal = dictionary.plate
        self.true = replace(nominal.plate, constants={**nominal.plate.constants, **truth["constants"]})
        self.linear, self.order = dictionary.at(self.true)
        self.measured = np.log(listed_hz(entry))
        missed = list(truth["missed"]) if not truth["complete"] else []
        self.modes = np.delete(np.arange(len(self.linear.ln_f)), missed)[: nominal.n_modes]

    def errors_of_list(self) -> dict[str, Array]:
        """Shifts of ln f by a frequency misread by 1 %, and by a mode missing in the list, for each mode."""
        n, ln_f = len(self.modes), self.linear.ln_f
        later = [np.delete(np.arange(len(ln_f)), k)[:n] for k in self.modes]
        return {"outlier": 0.01 * np.eye(n), "mode_identity": ln_f[later] - ln_f[self.modes]}


# Simpler methods

# Methods and the units of their statistics.
METHODS = {
    "largest_residual": "sd",
    "BIC": "difference",
    "likelihood_ratio": "of its 5 % point",
    "sparse_regression": "misfit explained",
}
# Repeatability that is assumed if a file states none.
_ASSUMED = 0.003
# Least improvement by a second cause, relative to that by the first.
_SECOND = 0.5
# Number of parameters of a cause (size, place, index of the frequency); one for all others.
_FREE = {"sensor_mass": 3, "damage": 3, "outline": 3, "outlier": 2}
# Sizes of a misread frequency, per cent: 6 % apart.
_MISREAD = np.exp(np.arange(np.log(0.02), np.log(40.0), 0.06))


@dataclass(frozen=True, slots=True)
class Whitened:
    """Residuals of the plain fit and shifts of the causes, projected off the constants and whitened.

    residual : (n,) in noise sd. atoms : by cause, shifts over sizes and places (k, n); one : at one scale.
    """

    residual: Array
    atoms: dict[str, Array]
    one: dict[str, Array]


def whitened(dictionary: Dictionary, entry: Record) -> Whitened:
    """Whitened residuals and shifts of a list: constants at least squares, causes on a grid of sizes."""
    plain = Plain(dictionary, entry)
    noise = entry["truth"]["noise"] if entry["truth"]["stated"] else _ASSUMED
    slope = plain.linear.slope[plain.modes] / noise
    basis, values, _ = np.linalg.svd(slope, full_matrices=False)
    # priors of the constants: a constant that its prior determines is not free
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
    for cause, shifts in plain.errors_of_list().items():
        atoms[cause] = one[cause] = [shifts @ less / noise]
    # a frequency may be misread by any amount
    atoms["outlier"] = [size * one["outlier"][0] for size in np.concatenate([-_MISREAD, _MISREAD])]
    return Whitened(
        residual,
        {c: np.concatenate(v) for c, v in atoms.items()},
        {c: np.concatenate(v) for c, v in one.items()},
    )


def answers(dictionary: Dictionary, entry: Record) -> dict[str, Record]:
    """Answers of the methods, each with its statistic, in the keys of a diagnosis without a probability."""
    seen = whitened(dictionary, entry)
    found = (_largest_residual(seen), _criterion(seen), _likelihood_ratio(seen), _matching_pursuit(seen))
    return {method: _answer(*named) for method, named in zip(METHODS, found, strict=True)}


# Causes, and the statistic of their improvement over none.
_Named = tuple[list[str], float]


def _answer(causes: list[str], statistic: float) -> Record:
    claim = {"claim": ("named", "pair")[len(causes) - 1], "causes": causes, "probability": 1.0}
    return {**claim, "statistic": statistic, "constants": {}, "baseline": {}}


def _misfit(seen: Whitened) -> float:
    return float(seen.residual @ seen.residual)


def _misfits(seen: Whitened) -> dict[str, float]:
    return {c: float(((seen.residual - a) ** 2).sum(axis=1).min()) for c, a in seen.atoms.items()}


def _largest_residual(seen: Whitened) -> _Named:
    """The cause that shifts the worst mode most relative to others; a misread frequency would always win."""
    i = int(np.argmax(np.abs(seen.residual)))
    part = {c: float(np.abs(a[:, i]).max()) for c, a in _directions(seen).items() if c != "outlier"}
    return [max(part, key=lambda c: part[c])], float(abs(seen.residual[i]))


def _criterion(seen: Whitened) -> _Named:
    n = len(seen.residual)
    score = {c: m + _free(c) * float(np.log(n)) for c, m in _misfits(seen).items()}
    best = min(score, key=lambda c: score[c])
    return [best], _misfit(seen) - score[best]


def _likelihood_ratio(seen: Whitened) -> _Named:
    misfit = _misfits(seen)
    best = min(misfit, key=lambda c: misfit[c])
    return [best], (_misfit(seen) - misfit[best]) / float(chi2.ppf(0.95, _free(best)))


def _matching_pursuit(seen: Whitened) -> _Named:
    directions = _directions(seen)
    left = seen.residual
    chosen: list[str] = []
    columns: list[Array] = []
    gains: list[float] = []
    for _ in range(2):
        along = {c: np.abs(d @ left) for c, d in directions.items() if c not in chosen}
        best = max(along, key=lambda c: float(along[c].max()))
        columns.append(directions[best][int(np.argmax(along[best]))])
        a = np.array(columns).T
        after = seen.residual - a @ np.linalg.lstsq(a, seen.residual, rcond=None)[0]
        gain = float(left @ left - after @ after)
        if gains and gain < _SECOND * gains[0]:
            break
        chosen.append(best)
        gains.append(gain)
        left = after
    return chosen, sum(gains)


def _directions(seen: Whitened) -> dict[str, Array]:
    """Shifts by the causes at one scale, normalised to length 1."""
    return {c: a / np.maximum(np.linalg.norm(a, axis=1), 1e-12)[:, None] for c, a in seen.one.items()}


def _free(cause: str) -> int:
    return _FREE.get(cause, 1)


# Thresholds


def threshold(records: Sequence[Scored], statistics: Mapping[str, float], rate: tuple[int, int]) -> Record:
    """Least statistic from which a method may claim, and its claims on these lists.

    records : scores if it always claims. statistics : by list. rate : (allowed wrong claims, number of
    lists); if even the surest claims are wrong too often it always abstains, and the threshold is None
    """
    wrong, of = rate
    for least in sorted({statistics[r["id"]] for r in records}):
        claimed = [r["category"] for r in records if statistics[r["id"]] >= least]
        if claimed.count(WRONG) * of <= wrong * len(records):
            return _at(least, records, claimed)
    return _at(None, records, [])


def _at(least: float | None, records: Sequence[Scored], claimed: Sequence[str]) -> Record:
    counted = {category: claimed.count(category) for category in (RIGHT, WRONG)}
    return {"threshold": least, "lists": len(records), **counted}


def abstaining(answers: Mapping[str, Record], least: float | None) -> dict[str, Record]:
    """Answers of a method by list, "none" if its statistic is below its threshold; None: always."""
    nothing = {"claim": "none", "causes": []}
    return {
        name: answer if least is not None and answer["statistic"] >= least else {**answer, **nothing}
        for name, answer in answers.items()
    }
