"""Pairings of a frequency list with other modes, all of them fitted at once on one model.

A missed mode moves all frequencies above it by several per cent, and the constants of the true pairing lie
far from those of the wrong one. Every pairing is therefore fitted from several draws of the prior; one stack
of solves serves all of them, and only those that explain the list nearly as well as the best go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.evidence.comparison import Comparison, kept_of
from cpam_bayes.diagnosis.evidence.optima import LOG2_DRAWS, coarse_misfit, prior_draws
from cpam_bayes.inference.derivatives import Expansion
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.standard_normal import MAX_SCORE

Array = NDArray[Any]

# Draws that each pairing is fitted from, those that go on, and the steps of both rounds.
_FIRST, _FIRST_STEPS, _SECOND, _SECOND_STEPS = 5, 4, 2, 14
# Scores of an inferred noise at which a fit is valued.
_NOISE_SCORES = np.linspace(-2.5, 2.5, 9)


@dataclass(frozen=True, slots=True)
class Repairing:
    """The fit of one pairing.

    log_density : largest log posterior density, the misreading of a frequency left out
    z : (s, n) scores of the model's parameters where fits ended, the better one first
    """

    log_density: float
    z: Array


def repairings(
    plain: Comparison, variants: Sequence[Comparison], known: Array, sizes: tuple[int, ...] = ()
) -> list[Repairing]:
    """Fits of pairings that have the parameters of a model, without any cause or with one.

    plain : the lists as they are, for the parameters and all modes
    variants : the lists paired otherwise, one frequency left out or misread perhaps
    known : (s, n) scores of the model's optima
    sizes : columns of the cause's parameters

    Raises ``RigidBodyError`` where the plate has no modes at an optimum.
    """
    wide, offsets = all_modes(plain)
    index, mask, constant = _indices(plain, variants, offsets)
    listed = np.log(plain.listed.frequencies)
    n_model = plain.model.parameters.size
    draws = prior_draws(plain, sizes, LOG2_DRAWS)
    draws[:, n_model:] = 0.0
    inside, f, _ = wide.predict_inside(plain.scores.to_x(draws))
    draws, log_f = draws[inside], np.log(f)
    starts = []
    for i, m in zip(index, mask, strict=True):
        order = np.argsort(coarse_misfit((listed - log_f[:, i])[:, m]), kind="stable")
        starts.append(np.concatenate((known, draws[order[:_FIRST]])))
    s, n = starts[0].shape
    rows = np.repeat(np.arange(len(variants)), s)
    z, value = _maximised(plain, wide, np.concatenate(starts), index[rows], mask[rows], _FIRST_STEPS)
    order = np.argsort(-value.reshape(-1, s), axis=1, kind="stable")[:, :_SECOND]
    begin = np.take_along_axis(z.reshape(-1, s, n), order[..., None], axis=1).reshape(-1, n)
    rows = np.repeat(np.arange(len(variants)), _SECOND)
    z, value = _maximised(plain, wide, begin, index[rows], mask[rows], _SECOND_STEPS)
    value = _over_noise(plain, wide, z, index[rows], mask[rows]).reshape(-1, _SECOND)
    z = z.reshape(-1, _SECOND, n)
    fits = []
    for v in range(len(variants)):
        order = np.argsort(-value[v], kind="stable")
        fits.append(Repairing(float(value[v, order[0]] + constant[v]), z[v, order]))
    return fits


def all_modes(plain: Comparison) -> tuple[Comparison, list[int]]:
    """The comparison with every mode of every plate as if it were listed, and where each plate's begin."""
    sizes = [
        len(part.bare.predict(_middle(plain, i)).frequencies[0]) for i, part in enumerate(plain.model.parts)
    ]
    parts = tuple(
        replace(part, modes=np.arange(size), misread=None)
        for part, size in zip(plain.model.parts, sizes, strict=True)
    )
    offsets = [0, *np.cumsum(sizes)[:-1].tolist()]
    return replace(plain, model=replace(plain.model, parts=parts)), offsets


def _middle(plain: Comparison, i: int) -> Array:
    x = plain.scores.to_x(np.zeros((1, plain.parameters.size)))
    return plain.model.parts[i].plate_vector(x)


def _indices(
    plain: Comparison, variants: Sequence[Comparison], offsets: Sequence[int]
) -> tuple[Array, Array, Array]:
    """Mode of every frequency (v, n_f), whether the model explains it, and log constants (v,)."""
    n = len(plain.listed.frequencies)
    index, mask = np.zeros((len(variants), n), dtype=int), np.ones((len(variants), n), dtype=bool)
    constant = np.zeros(len(variants))
    for v, variant in enumerate(variants):
        modes, at = [], 0
        kept = kept_of(plain.listed.frequencies, variant.listed.frequencies)
        places = np.flatnonzero(kept)
        for part, offset in zip(variant.model.parts, offsets, strict=True):
            modes.append(part.modes + offset)
            if part.misread is not None:
                mask[v, places[at + part.misread[0]]] = False
            at += len(part.modes)
        index[v, kept] = np.concatenate(modes)
        mask[v] &= kept
        constant[v] = variant.listed.log_constant
    return index, mask, constant


def _maximised(
    plain: Comparison, wide: Comparison, z: Array, index: Array, mask: Array, steps: int
) -> tuple[Array, Array]:
    """Optima of constants at held noise, one pairing a row."""
    n = plain.parameters.size
    held = np.arange(n) >= plain.model.parameters.size

    def target(at: Array, rows: Array) -> Expansion:
        m = len(at)
        value, gradient, curvature = np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n))
        x = plain.scores.to_x(at)
        inside, f, slope = wide.predict_inside(x, jacobian=True)
        if len(inside):
            assert slope is not None
            chosen, used = index[rows[inside]], mask[rows[inside]]
            f = np.take_along_axis(f, chosen, axis=1)
            slope = np.take_along_axis(slope, chosen[..., None], axis=1)
            variance = plain.variance(x[inside])
            r = np.where(used, plain.listed.frequencies - f, 0.0)
            value[inside] = -0.5 * np.sum(r**2 / variance, axis=1)
            gradient[inside] = np.einsum("mi,mij->mj", r / variance, slope)
            weighted = np.where(used, 1.0 / np.sqrt(variance), 0.0)[..., None] * slope
            curvature[inside] = np.swapaxes(weighted, 1, 2) @ weighted
        e = plain.scores.with_prior(Expansion(value, gradient, curvature), x, at)
        e.gradient[:, held] = 0.0
        return e

    bound = np.full(n, MAX_SCORE)
    maxima = maximise(target, z, -bound, bound, most_steps=steps, promised=1e-2)
    return maxima.u, np.where(np.isfinite(maxima.expansion.value), maxima.expansion.value, -1e300)


def _over_noise(plain: Comparison, wide: Comparison, z: Array, index: Array, mask: Array) -> Array:
    """Log density of each fit at the best amplitude of an inferred noise, (m,)."""
    n_model = plain.model.parameters.size
    f = np.take_along_axis(wide.predict(plain.scores.to_x(z))[0], index, axis=1)
    r2 = np.where(mask, (plain.listed.frequencies - f) ** 2, 0.0)
    best = np.full(len(z), -np.inf)
    for score in _NOISE_SCORES if plain.parameters.size > n_model else np.zeros(1):
        at = z.copy()
        at[:, n_model:] = score
        variance = plain.variance(plain.scores.to_x(at))
        log_density = -0.5 * r2 / variance - 0.5 * np.where(mask, np.log(2 * np.pi * variance), 0.0)
        best = np.maximum(best, log_density.sum(axis=1) + plain.scores.log_prior(at))
    return best
