"""What a claim is measured by: an oracle, and what a user would do instead of a diagnosis.

All have the signatures of the independent elements: shifts of ln f at a grid of sizes and places, solved once
a plate at its reference constants.

The oracle weighs the causes and priors of the diagnosis by exact evidences of the plate linear in its
constants, about the truth; the true constants, the true signature and place of the cause and the pairing of
an incomplete list are known to it. A method that has to find these can claim no more, so a share of right
claims is counted where the oracle claims.

Simpler methods take the residuals of the plain fit, linear in the constants, and name one cause or none: the
mode that misfits most, the Bayesian information criterion over causes, a likelihood ratio at 5 %, sparse
regression on the signatures (orthogonal matching pursuit).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.optimize import linear_sum_assignment
from scipy.special import logsumexp
from scipy.stats import chi2

from validation.independent.elements import BucklingError
from validation.independent.lists import FURTHER, NOISE, RESOLUTION_HZ, Linear, NominalPlate, linear_of
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


# The oracle

P_NONE, P_OTHER, P_PAIR = 0.5, 0.05, 0.02
SURE, CLEAR, ALIKE, MOST = 0.9, 3.0, 0.95, 6
# Repeatabilities that a file leaves out: log-normal about 0.3 %, cut at 1 %.
_LEVELS = np.exp(np.linspace(np.log(5e-4), np.log(1e-2), 10))
_MEDIAN, _SPREAD = 3e-3, 0.6
# Discrepancy: amplitudes, correlation lengths in ln f, and its white part.
_AMPLITUDES = np.exp(np.linspace(np.log(1e-3), np.log(0.1), 24))
_LENGTHS, _WHITE = (0.4, 0.7, 1.2), 0.2
_AMPLITUDE = 0.01
_MISREADING = 0.05
_FAMILIES = {
    "clamp": ("clamp_rotation", "clamp_translation", "soft_clamp", "clamp_slip", "clamp_length"),
    "mass": ("sensor_mass",),
    "surroundings": ("support",),
    "size": ("thickness", "density", "length", "width", "frequency_scale"),
    "shape": ("taper_x", "taper_y", "skew", "warp", "outline"),
    "layup": ("misorientation", "outer_ply_angle", "inner_ply_angle"),
    "stress": ("membrane_stress",),
    "stiffness": ("transverse_shear", "shear_ratio", "resin_skin"),
    "damage": ("damage",),
    "damping": ("viscoelastic",),
    "list": ("mode_identity", "outlier"),
    "material": ("material",),
}


def listed_hz(entry: Record) -> Array:
    """The frequencies in a list's file."""
    text = next(line for line in entry["file"].splitlines() if line.startswith("frequencies_hz"))
    return np.array([float(t) for t in text.split("[")[1].rstrip("]").split(",")])


class Plain:
    """A list about the truth: ln f measured and true, its slopes, and the noise that it may have."""

    def __init__(self, dictionary: Dictionary, entry: Record) -> None:
        truth = entry["truth"]
        nominal = dictionary.plate
        self.true = replace(nominal.plate, constants={**nominal.plate.constants, **truth["constants"]})
        self.linear, self.order = dictionary.at(self.true)
        self.measured = np.log(listed_hz(entry))
        self.missed = list(truth["missed"]) if not truth["complete"] else []
        self.modes = np.delete(np.arange(len(self.linear.ln_f)), self.missed)[: nominal.n_modes]
        rounding = RESOLUTION_HZ / np.sqrt(12.0) / np.exp(self.measured)
        levels = np.array([NOISE]) if truth["stated"] else _LEVELS
        self.variances = [level**2 + rounding**2 for level in levels]
        weight = np.zeros(1)
        if len(levels) > 1:
            weight = -0.5 * (np.log(levels / _MEDIAN) / _SPREAD) ** 2
        self.log_weight = weight - logsumexp(weight)
        reference = np.array([nominal.plate.constants[n] for n in nominal.constants])
        true_values = np.array([self.true.constants[n] for n in nominal.constants])
        # where the file trusts the reference, the prior's centre is off by these scores
        self.offset = (
            (reference - true_values) / (reference * nominal.relative_sd)
            if nominal.known
            else 0.0 * reference
        )
        self.wide = np.array([nominal.bounds[n][1] - nominal.bounds[n][0] for n in nominal.constants]) / (
            np.sqrt(12.0) * reference * nominal.relative_sd
        )

    def visible(self, shift: Array) -> Array:
        """A shift of the listed modes less what the constants imitate, in standard deviations."""
        listed = replace(self.linear, slope=self.linear.slope[self.modes], n=len(self.modes))
        return listed.visible(shift)

    def visible_misfit(self, shift: Array) -> Array:
        """Squared norm of what is left of the residual after each of shifts (k, n)."""
        left = self.measured - self.linear.ln_f[self.modes] - shift
        return np.asarray((self.visible(left.T) ** 2).sum(axis=0))

    def log_evidence(
        self,
        shift: Array,
        log_prior: Array,
        modes: Array | None = None,
        extra: Array | None = None,
        wide: bool = False,
    ) -> float:
        """Log evidence of shifts (k, n) with weights.

        modes : of the list. extra : (n, n) covariance that is added. wide : constants known by bounds alone.
        """
        at = self.modes if modes is None else modes
        slope = self.linear.slope[at] * (self.wide if wide else 1.0)
        centre = np.zeros(len(at)) if wide else slope @ self.offset
        residual = self.measured - self.linear.ln_f[at] - centre - np.atleast_2d(shift)
        total = []
        for variance, log_weight in zip(self.variances, self.log_weight, strict=True):
            covariance = np.diag(variance) + slope @ slope.T
            if extra is not None:
                covariance = covariance + extra
            root = np.linalg.cholesky(covariance)
            scaled = np.linalg.solve(root, residual.T)
            log_l = -0.5 * (scaled**2).sum(axis=0) - np.log(np.diag(root)).sum()
            total.append(log_weight + logsumexp(log_l + log_prior))
        return float(logsumexp(total)) - 0.5 * len(at) * float(np.log(2.0 * np.pi))


def weighed(dictionary: Dictionary, entry: Record) -> tuple[dict[str, float], dict[str, frozenset[str]]]:
    """Log evidence of each cause, none and other with it, and which causes look like each."""
    plain = Plain(dictionary, entry)
    truth = entry["truth"]
    n = len(plain.modes)
    zero = np.zeros((1, n)), np.zeros(1)
    log_e: dict[str, float] = {"none": plain.log_evidence(*zero)}
    log_e["other"] = _other(plain)
    by_cause: dict[str, list[float]] = defaultdict(list)
    seen: dict[str, Array] = {}
    curves = [(s, plain.order) for s in dictionary.signatures if s.cause not in truth["sizes"] or s.place > 0]
    bare = replace(plain.true, mesh=MESH)
    same = np.arange(len(plain.order))
    exact = {}
    for cause, size in truth["sizes"].items():
        exact[cause] = signature_of(bare, cause, truth["aux"].get(cause, {}), plain.linear.ln_f, 0, size)
        curves.append((exact[cause], same))
    best: dict[str, float] = {}
    for signature, order in curves:
        _, shift, log_prior = signature.fine()
        listed = shift[:, order][:, plain.modes]
        value = plain.log_evidence(listed, log_prior)
        by_cause[signature.cause].append(value)
        if value > best.get(signature.cause, -np.inf):
            best[signature.cause] = value
            likely = plain.visible_misfit(listed)
            seen[signature.cause] = plain.visible(listed[int(np.argmin(likely))])
    for cause, values in by_cause.items():
        log_e[cause] = float(logsumexp(values) - np.log(len(values)))
    log_e |= _of_list(plain, complete=truth["complete"])
    if dictionary.plate.known:
        log_e["material"] = plain.log_evidence(*zero, wide=True)
    if len(exact) == 2:
        log_e[" + ".join(exact)] = _both(plain, [exact[c] for c in exact])
    return log_e, _alike(seen)


def claim(log_evidence: dict[str, float], alike: dict[str, frozenset[str]]) -> Record:
    """The oracle's claim by the rules of the diagnosis, in the keys of its answers."""
    log_p = {c: v + np.log(p) for c, v, p in _with_priors(log_evidence)}
    whole = logsumexp(list(log_p.values()))
    p = {c: float(np.exp(v - whole)) for c, v in log_p.items()}
    answer: Record = {"claim": "undecided", "causes": [], "probability": max(p.values())}
    singles = sorted((c for c in p if c not in ("none", "other") and " + " not in c), key=lambda c: -p[c])
    members = [c for c in singles if c == singles[0] or c in alike.get(singles[0], frozenset())]
    together = sum(p[c] for c in members)
    outside = max(v for c, v in log_evidence.items() if c not in members)
    pair = next((c for c in p if " + " in c), None)
    if p["none"] >= P_NONE:
        answer |= {"claim": "none", "probability": p["none"]}
    elif together >= SURE and max(log_evidence[c] for c in members) >= outside + CLEAR:
        named = p[singles[0]] >= SURE
        answer |= {
            "claim": "named" if named else "class",
            "causes": members[:1] if named else members[:MOST],
            "probability": p[singles[0]] if named else together,
        }
    elif pair is not None and p[pair] >= SURE:
        answer |= {"claim": "pair", "causes": pair.split(" + "), "probability": p[pair]}
    elif p["other"] >= SURE:
        answer |= {"claim": "other", "probability": p["other"]}
    ranked = sorted(p, key=lambda c: -p[c])[:6]
    return answer | {"hypotheses": [{"cause": c, "probability": p[c]} for c in ranked]}


def _with_priors(log_evidence: dict[str, float]) -> list[tuple[str, float, float]]:
    present = {f: [c for c in causes if c in log_evidence] for f, causes in _FAMILIES.items()}
    present = {f: causes for f, causes in present.items() if causes}
    whole = (1.0 - P_NONE - P_OTHER - P_PAIR) / len(present)
    prior = {c: whole / len(causes) for causes in present.values() for c in causes}
    count = sum(len(c) for c in present.values())
    prior |= {"none": P_NONE, "other": P_OTHER}
    pair = P_PAIR / (0.5 * count * (count - 1))
    return [(c, v, prior.get(c, pair)) for c, v in log_evidence.items()]


def _other(plain: Plain) -> float:
    """A discrepancy that is smooth over ln f plus a white part, over its amplitude and length."""
    x = plain.linear.ln_f[plain.modes]
    weight = (1.0 + (_AMPLITUDES / _AMPLITUDE) ** 2 / 4.0) ** -2.5 * _AMPLITUDES
    log_weight = np.log(weight / weight.sum() / len(_LENGTHS))
    total = []
    for length in _LENGTHS:
        kernel = (1.0 - _WHITE) * np.exp(-0.5 * ((x[:, None] - x) / length) ** 2) + _WHITE * np.eye(len(x))
        for amplitude, lw in zip(_AMPLITUDES, log_weight, strict=True):
            total.append(
                lw + plain.log_evidence(np.zeros((1, len(x))), np.zeros(1), extra=amplitude**2 * kernel)
            )
    return float(logsumexp(total))


def _of_list(plain: Plain, *, complete: bool) -> dict[str, float]:
    """One mode missed or one false frequency, and one frequency misread."""
    n = len(plain.modes)
    sizes = np.concatenate([-np.geomspace(0.5, 1e-3, 60), np.geomspace(1e-3, 0.5, 60)])
    weight = (1.0 + (sizes / _MISREADING) ** 2 / 4.0) ** -2.5 * np.abs(sizes)
    log_prior = np.log(weight / weight.sum())
    misread = [plain.log_evidence(np.outer(sizes, np.eye(n)[i]), log_prior) for i in range(n)]
    out = {"outlier": float(logsumexp(misread) - np.log(n))}
    if complete:
        zero = np.zeros((1, n)), np.zeros(1)
        every = np.arange(n + 1)
        missed = [plain.log_evidence(*zero, modes=np.delete(every, k)) for k in range(n)]
        out["mode_identity"] = float(logsumexp(missed) - np.log(2.0 * n))
    return out


def _both(plain: Plain, signatures: list[Any]) -> float:
    """Two causes with their own signatures, shifts added."""
    grids = []
    for s in signatures:
        _, shift, log_prior = s.fine()
        grids.append((shift[::3][:, plain.modes], log_prior[::3] - logsumexp(log_prior[::3])))
    (a, log_a), (b, log_b) = grids
    shift = (a[:, None] + b[None]).reshape(-1, a.shape[1])
    return plain.log_evidence(shift, (log_a[:, None] + log_b).ravel())


def _alike(seen: dict[str, Array]) -> dict[str, frozenset[str]]:
    unit = {c: v / np.linalg.norm(v) for c, v in seen.items() if np.linalg.norm(v) > 0.0}
    return {
        a: frozenset(b for b, w in unit.items() if b != a and abs(float(v @ w)) > ALIKE)
        for a, v in unit.items()
    }


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
