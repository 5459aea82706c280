"""What a trial of the diagnosis hides in a simulated list."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.evidence.comparison import Listed
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis
from cpam_bayes.effects.material import MATERIAL
from cpam_bayes.validation.diagnosis.truths import (
    Bench,
    Linear,
    Reached,
    at_random_place,
    brick_frequencies,
    linear,
    parameter_of,
    random_constants,
    size_for,
    true_frequencies,
    variants_of_cause,
)

Array = NDArray[Any]

Kind = Literal["clean", "bricks", "one", "two", "outside", "prior"]

# The constants of a truth lie within this fraction of the reference.
SPREAD = 0.1
# Modes beyond the list that are simulated too.
FURTHER = 2
# Places tried for a cause before it is given up.
_PLACES = 6
# Modes that a list may lack are simulated as well.
_MAX_MISSED = 2


@dataclass(frozen=True, slots=True)
class Trial:
    """One trial, which depends on nothing but this and the bench.

    kind : "clean"; "bricks": clean and simulated in three dimensions; "one" hidden cause; "two" at once;
    "outside": one whose class the dictionary lacks; "prior": truth, size and constants drawn from the
    priors of the diagnosis.
    cause : names of what is hidden.
    ratio : signal to noise of each.
    lacks : whether the list lacks a mode and says which.
    """

    kind: Kind
    cause: tuple[str, ...] = ()
    ratio: float = 0.0
    number: int = 0
    lacks: bool = False
    seed: int = 0

    def rng(self, bench: Bench) -> np.random.Generator:
        """The generator of this trial on a bench."""
        text = f"{asdict(self)!r} on {bench.case.name}, {bench.n_listed} modes"
        return np.random.default_rng([self.seed, zlib.crc32(text.encode())])


@dataclass(frozen=True, slots=True)
class Hidden:
    """A simulated plate.

    causes : what is hidden, with sizes.
    x : constants.
    listed : the list without noise, of ``own``, and
    further : the modes beyond it.
    noise : of the list in units of s.
    shift : (n_listed,) that the dictionary's own model has in the list, in units of s.
    """

    own: Bench
    at: Linear
    causes: tuple[Hypothesis, ...]
    sizes: Array
    listed: Array
    further: Array
    noise: Array
    shift: Array


def hide(bench: Bench, trial: Trial, rng: np.random.Generator) -> Hidden | Reached:
    """A simulated plate with what the trial hides, or why that cannot be."""
    n = bench.n_listed
    if trial.lacks:
        gone = int(rng.integers(n))
        bench = replace(bench, case=replace(bench.case, modes=np.delete(np.arange(n + 1), gone)))
    if trial.kind == "prior":
        causes, x, sizes = _from_priors(bench, bench.singles, rng)
        at = linear(bench, x)
    elif trial.cause == (MATERIAL.name,):
        other = [h for h in bench.singles if h.other_material]
        causes, x, sizes = _from_priors(bench, other, rng)
        at = linear(bench, x)
    else:
        x = random_constants(bench, SPREAD, rng)
        at = linear(bench, x)
        chosen = [_chosen(at, cause, trial.ratio, rng) for cause in trial.cause]
        missing = next((c for c in chosen if isinstance(c, Reached)), None)
        if missing is not None:
            return missing
        causes = tuple(c[0] for c in chosen if not isinstance(c, Reached))
        sizes = np.array([c[1] for c in chosen if not isinstance(c, Reached)])
    n_modes = n + FURTHER + _MAX_MISSED
    if trial.kind == "bricks":
        f = brick_frequencies(bench, x, n_modes)
    else:
        f = true_frequencies(bench, causes, x, sizes, n_modes)
    listed = f[bench.case.modes]
    for h, size in zip(causes, sizes, strict=True):
        if h.listed.missed:
            listed = np.delete(f, h.listed.missed)[:n]
        if h.listed.spurious is not None:
            extra = rng.uniform(0.7 * f[0], f[n - 1])
            listed = np.sort(np.append(listed[: n - 1], extra))
        if h.listed.misread is not None:
            listed = listed.copy()
            listed[h.listed.misread] *= 1.0 + size
    noise = rng.standard_normal(n)
    for h in (h for h in causes if h.cause == OTHER):
        alike = Listed(listed, listed, listed).correlation(h.correlation_length)
        scatter = np.linalg.cholesky(alike) @ rng.standard_normal(n)
        noise = noise + float(sizes[0]) / bench.noise * scatter
    shift = np.zeros(n)
    for h, size in zip(causes, sizes, strict=True):
        if h.parameters and h.cause != OTHER:
            shift = shift + at.shift(h, np.array([size]))[0]
    return Hidden(bench, at, causes, sizes, listed, f[n : n + FURTHER], noise, shift)


def _chosen(
    at: Linear, cause: str, ratio: float, rng: np.random.Generator
) -> tuple[Hypothesis, float] | Reached:
    """A variant of a cause with its size, at a place and of a sign drawn at random."""
    variants = variants_of_cause(at.own, cause)
    weights = np.array([h.prior for h in variants])
    anywhere = any(e.is_anywhere for h in variants for e in h.effects)
    n = _PLACES if anywhere else len(variants)
    order = rng.choice(len(variants), size=n, replace=anywhere, p=weights / weights.sum())
    best = Reached(np.nan, 0.0, 0.0)
    for i in order[:_PLACES]:
        h = at_random_place(variants[i], rng)
        if not h.parameters:
            return h, 0.0
        prior = parameter_of(h).prior
        sign = 1.0 if prior.lower >= 0.0 else float(rng.choice((-1.0, 1.0)))
        for side in (sign, -sign) if prior.lower < 0.0 else (sign,):
            reached = size_for(at, h, ratio, side)
            if reached.usable:
                return h, reached.size
            best = max(best, reached, key=lambda r: r.most)
    return best


def _from_priors(
    bench: Bench, singles: Sequence[Hypothesis], rng: np.random.Generator
) -> tuple[tuple[Hypothesis, ...], Array, Array]:
    """One of these hypotheses, constants and a size drawn from the priors."""
    weights = np.array([h.prior for h in singles])
    h = at_random_place(singles[int(rng.choice(len(singles), p=weights / weights.sum()))], rng)
    models = bench.case.of_other_material() if h.other_material else bench.case.models
    while True:
        x = models.parameters.sample(rng, 1)
        if models.bare.admissible(x)[0]:
            break
    if h.cause == NONE:
        return (), x[0], np.empty(0)
    sizes = np.array([float(parameter_of(h).prior.sample(rng, 1)[0]) if h.parameters else 0.0])
    return (h,), x[0], sizes
