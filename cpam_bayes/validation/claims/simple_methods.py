"""What a user would do instead of a diagnosis, on the same lists with the same signatures.

Each takes the plain fit's residuals, linear in the constants, and names one cause or none: the mode that
misfits most, the Bayesian information criterion over causes, a likelihood ratio at 5 %, sparse regression on
the signatures (orthogonal matching pursuit).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cpam_bayes.validation.claims.oracle import Plain
from cpam_bayes.validation.independent.dictionary import Dictionary
from cpam_bayes.validation.independent.lists import NOISE

Array = NDArray[np.float64]
Record = dict[str, Any]

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
    noise = NOISE if entry["truth"]["stated"] else _ASSUMED
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
