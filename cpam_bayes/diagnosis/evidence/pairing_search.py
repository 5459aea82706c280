"""Search, under the plain model, for the pairings of incomplete lists that carry probability.

An evidence is the sum over all pairings, sum_pi p(pi) Z(h, pi). They are proposed by dynamic programming at
draws of the prior and at optima, first with a large noise, so that errors of the model are not taken for
false peaks, and fitted with their neighbours. The constants of the true pairing lie far from those of a
wrong one: each is fitted from several draws of the prior, and one stack of solves serves all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cpam_bayes.diagnosis.cases import (
    is_incomplete,
    is_open_ended,
    log_sum,
    most_probable,
    neighbours,
    with_missed_modes,
    with_pairing,
)
from cpam_bayes.diagnosis.comparison import PlateCase, comparison_of
from cpam_bayes.diagnosis.hypotheses import NONE, Hypothesis
from cpam_bayes.inference.laplace import SEARCH, prior_draws
from cpam_bayes.inference.log_density import CorrelatedDensity, coarse_misfit, kept_of
from cpam_bayes.inference.optimise import Maxima, maximise, promised_gain
from cpam_bayes.inference.scores import Expansion
from cpam_bayes.mechanics.problem import Array

# Draws from which each pairing is fitted and their steps, fits that go on and their steps.
_FIRST, _FIRST_STEPS, _SECOND, _SECOND_STEPS = 5, 4, 2, 14
# A fit is given up below this factor times the best log density, minus so many nats: with a larger inferred
# noise it would still be far behind. A step gains at most so many times what it promises.
_HOPELESS, _HOPELESS_NATS, _OVERSHOOT = 4.0, 50.0, 2.0
# Scores of an inferred noise at which a fit is evaluated.
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
    plain: CorrelatedDensity, variants: Sequence[CorrelatedDensity], known: Array, sizes: tuple[int, ...] = ()
) -> list[Repairing]:
    """Fits of several pairings with the parameters of one model, without any cause or with one.

    plain : the lists as they are, for the parameters and all modes
    variants : the lists with other pairings, possibly with a frequency left out or misread
    known : (s, n) scores of the model's optima
    sizes : columns of the cause's parameters

    Raises ``RigidBodyError`` where the plate has no modes at an optimum.
    """
    wide, offsets = all_modes(plain)
    index, mask, constant = _indices(plain, variants, offsets)
    listed = np.log(plain.listed.frequencies)
    draws = prior_draws(plain, sizes[0] if sizes else None, SEARCH.log2_draws, 0.0)
    inside, f, _ = wide.predict_inside(plain.scores.to_x(draws))
    draws, log_f = draws[inside], np.log(f)
    starts = []
    for i, m in zip(index, mask, strict=True):
        order = np.argsort(coarse_misfit((listed - log_f[:, i])[:, m]), kind="stable")
        starts.append(np.concatenate((known, draws[order[:_FIRST]])))
    s, n = starts[0].shape
    rows = np.repeat(np.arange(len(variants)), s)
    first = _maximised(plain, wide, np.concatenate(starts), index[rows], mask[rows], _FIRST_STEPS)
    order = np.argsort(-first.expansion.value.reshape(-1, s), axis=1, kind="stable")[:, :_SECOND]
    chosen = (order + s * np.arange(len(variants))[:, None]).ravel()
    rows, there = rows[chosen], first.expansion.of(chosen)
    z = _maximised(plain, wide, first.u[chosen], index[rows], mask[rows], _SECOND_STEPS, there).u
    value = _over_noise(plain, wide, z, index[rows], mask[rows]).reshape(-1, _SECOND)
    z = z.reshape(-1, _SECOND, n)
    fits = []
    for v in range(len(variants)):
        order = np.argsort(-value[v], kind="stable")
        fits.append(Repairing(float(value[v, order[0]] + constant[v]), z[v, order]))
    return fits


def all_modes(plain: CorrelatedDensity) -> tuple[CorrelatedDensity, list[int]]:
    """The comparison with every mode of every plate as if listed, and the offset of each plate's modes."""
    middle = plain.scores.to_x(np.zeros((1, plain.parameters.size)))
    sizes = [len(part.bare.predict(part.plate_vector(middle)).frequencies[0]) for part in plain.model.parts]
    parts = tuple(
        replace(part, modes=np.arange(size), misread=())
        for part, size in zip(plain.model.parts, sizes, strict=True)
    )
    offsets = [0, *np.cumsum(sizes)[:-1].tolist()]
    return replace(plain, model=replace(plain.model, parts=parts)), offsets


def _indices(
    plain: CorrelatedDensity, variants: Sequence[CorrelatedDensity], offsets: Sequence[int]
) -> tuple[Array, Array, Array]:
    """Mode of every frequency (v, n_f), mask of those that the model explains, and log constants (v,)."""
    n = len(plain.listed.frequencies)
    index, mask = np.zeros((len(variants), n), dtype=int), np.ones((len(variants), n), dtype=bool)
    constant = np.zeros(len(variants))
    for v, variant in enumerate(variants):
        modes, at = [], 0
        kept = kept_of(plain.listed.frequencies, variant.listed.frequencies)
        places = np.flatnonzero(kept)
        for part, offset in zip(variant.model.parts, offsets, strict=True):
            modes.append(part.modes + offset)
            for i, _ in part.misread:
                mask[v, places[at + i]] = False
            at += len(part.modes)
        index[v, kept] = np.concatenate(modes)
        mask[v] &= kept
        constant[v] = variant.listed.log_constant
    return index, mask, constant


def _maximised(
    plain: CorrelatedDensity,
    wide: CorrelatedDensity,
    z: Array,
    index: Array,
    mask: Array,
    steps: int,
    known: Expansion | None = None,
) -> Maxima:
    """Optima of constants at fixed noise, one pairing per row, from starts z (m, n).

    Rows that cannot come near the best are given up. known : expansion at the starts
    """
    n = plain.parameters.size
    held = np.arange(n) >= plain.model.parameters.size
    best, factor = -np.inf, 1.0 if plain.noise is None else _HOPELESS

    def target(at: Array, rows: Array) -> Expansion:
        m = len(at)
        value, gradient, curvature = np.full(m, -np.inf), np.zeros((m, n)), np.zeros((m, n, n))
        x = plain.scores.to_x(at)
        # pairings share their starts
        distinct, place = np.unique(x, axis=0, return_inverse=True)
        of_distinct, f, slope = wide.predict_inside(distinct, jacobian=True)
        number = np.full(len(distinct), -1)
        number[of_distinct] = np.arange(len(of_distinct))
        solved = number[place.ravel()]
        inside = np.flatnonzero(solved >= 0)
        if len(inside):
            assert slope is not None
            chosen, used = index[rows[inside]], mask[rows[inside]]
            f = np.take_along_axis(f[solved[inside]], chosen, axis=1)
            slope = np.take_along_axis(slope[solved[inside]], chosen[..., None], axis=1)
            slope = plain.residual_slopes(f, slope)
            variance = plain.variance(x[inside])
            r = np.where(used, plain.residuals(f), 0.0)
            value[inside] = -0.5 * np.sum(r**2 / variance, axis=1)
            gradient[inside] = np.einsum("mi,mij->mj", r / variance, slope)
            weighted = np.where(used, 1.0 / np.sqrt(variance), 0.0)[..., None] * slope
            curvature[inside] = np.swapaxes(weighted, 1, 2) @ weighted
        e = plain.scores.with_prior(Expansion(value, gradient, curvature), x, at)
        e.gradient[:, held] = 0.0
        return e

    def hopeless(e: Expansion) -> Array:
        nonlocal best
        best = max(best, float(e.value.max()))
        reach = e.value + _OVERSHOOT * promised_gain(e.gradient, e.curvature)
        return np.asarray(reach < factor * best - _HOPELESS_NATS)

    bound = plain.scores.upper
    return maximise(target, z, -bound, bound, most_steps=steps, promised=1e-2, hopeless=hopeless, known=known)


def _over_noise(
    plain: CorrelatedDensity, wide: CorrelatedDensity, z: Array, index: Array, mask: Array
) -> Array:
    """Log density of each fit at the best amplitude of an inferred noise, (m,)."""
    n_model = plain.model.parameters.size
    f = np.take_along_axis(wide.predict(plain.scores.to_x(z))[0], index, axis=1)
    r2 = np.where(mask, plain.residuals(f) ** 2, 0.0)
    best = np.full(len(z), -np.inf)
    for score in _NOISE_SCORES if plain.parameters.size > n_model else np.zeros(1):
        at = z.copy()
        at[:, n_model:] = score
        variance = plain.variance(plain.scores.to_x(at))
        log_density = -0.5 * r2 / variance - 0.5 * np.where(mask, np.log(2 * np.pi * variance), 0.0)
        best = np.maximum(best, log_density.sum(axis=1) + plain.scores.log_prior(at))
    return best


Cases = tuple[PlateCase, ...]

# Draws of the prior, log2, relative noises at which they propose pairings, and number that propose.
_LOG2_DRAWS, _COARSE_NOISE, _PROPOSING = 10, (0.03, 0.01), 8
# Relative noise that covers the errors of the plain model.
_FORGIVING = 0.01
# Rounds of fitting pairings and proposing others, and number of best ones that propose.
_ROUNDS, _LEADING = 5, 3
# Pairings within so many nats of the best are kept, at most so many; number from which others start.
_NEAR_NATS, _MOST, _SEEDS = 12.0, 8, 2


@dataclass(frozen=True, slots=True)
class PairedLists:
    """One pairing of all lists.

    cases : the plates with it
    z : (s, n) scores of the plain parameters where fits of it ended; ``None`` where nothing was sought
    value : log posterior density of the plain model there
    """

    cases: Cases
    z: Array | None = None
    value: float = 0.0

    @property
    def key(self) -> bytes:
        """Key that equal pairings have in common."""
        return key_of(self.cases)


def key_of(cases: Sequence[PlateCase]) -> bytes:
    """Key of the pairings of the lists."""
    return b"".join(np.asarray(case.modes, dtype=np.int64).tobytes() for case in cases)


def plain_pairings(
    cases: Sequence[PlateCase], scatter: float
) -> tuple[tuple[PairedLists, ...], tuple[PairedLists, ...]]:
    """Pairings summed in the plain model's evidence, and those with which other hypotheses start.

    The latter are the best of the plain model, as it is and with a noise that covers its errors. Of several
    lists one is varied at a time.
    """
    incomplete = [i for i, case in enumerate(cases) if is_incomplete(case)]
    at = PairedLists(tuple(cases))
    forgiven = at
    kept: dict[bytes, PairedLists] = {}
    seeds: dict[bytes, PairedLists] = {}
    for i in incomplete:
        rough = _sought(forgiven.cases, i, scatter, _FORGIVING, ())
        fine = _sought(at.cases, i, scatter, 0.0, [p.cases[i].modes for p in rough[:_MOST]])
        near = [p for p in fine[:_MOST] if p.value > fine[0].value - _NEAR_NATS]
        at, forgiven = fine[0], rough[0]
        kept = {p.key: p for p in (*near, *(_and(p, i, at) for p in kept.values()))}
        seeds = {p.key: p for p in (*near[:1], *rough[:_SEEDS], *(_and(p, i, at) for p in seeds.values()))}
    return tuple(kept.values()) or (at,), tuple(seeds.values()) or (at,)


def _and(p: PairedLists, i: int, best: PairedLists) -> PairedLists:
    """A pairing with that of the i-th list replaced by the best one."""
    return replace(p, cases=(*p.cases[:i], best.cases[i], *p.cases[i + 1 :]))


def in_order(cases: Sequence[PlateCase]) -> Cases:
    """The plates with a mode for every frequency of an incomplete list, none false."""
    # a false peak gets an arbitrary mode
    return tuple(with_pairing(c, np.maximum(c.modes, 0)) if is_incomplete(c) else c for c in cases)


def pairing_at(
    cases: Sequence[PlateCase],
    hypothesis: dict[int, Hypothesis] | Hypothesis,
    i: int,
    x: Array,
    scatter: float,
) -> Cases:
    """The lists with the most probable pairing of the i-th one at parameters x (n,) of a hypothesis."""
    whole = comparison_of(in_order(cases), hypothesis, scatter=scatter)
    every = _EveryMode.of(whole, i, cases)
    predicted = every.predict(x[None])[0]
    modes = most_probable(cases[i], predicted, every.sigma(x[None])[0])
    return _with(cases, i, with_missed_modes(with_pairing(cases[i], modes), predicted))


def recounted(
    cases: Sequence[PlateCase], hypothesis: dict[int, Hypothesis] | Hypothesis, x: Array, scatter: float
) -> Cases:
    """Plates with the missed modes above their last paired one recounted at parameters x (n,)."""
    open_ended = [i for i, case in enumerate(cases) if is_open_ended(case)]
    if not open_ended:
        return tuple(cases)
    whole = comparison_of(in_order(cases), hypothesis, scatter=scatter)
    for i in open_ended:
        cases = _with(
            cases, i, with_missed_modes(cases[i], _EveryMode.of(whole, i, cases).predict(x[None])[0])
        )
    return tuple(cases)


def _sought(
    cases: Cases, i: int, scatter: float, forgiven: float, first: Sequence[Array]
) -> list[PairedLists]:
    """Fitted pairings of the i-th list, the most probable first; forgiven : added relative noise."""
    nothing = Hypothesis(NONE, NONE)
    plain = _forgiving(comparison_of(in_order(cases), nothing, scatter=scatter), forgiven)
    every = _EveryMode.of(plain, i, cases)
    known = np.zeros((1, plain.parameters.size))
    proposed = [*first, *_from_draws(every, cases[i])]
    fitted: dict[bytes, PairedLists] = {}
    for _ in range(_ROUNDS):
        new: dict[bytes, Cases] = {}
        for modes in proposed:
            trial = _with(cases, i, with_pairing(cases[i], modes))
            if key_of(trial) not in fitted and np.isfinite(trial[i].log_pairing) and np.any(modes >= 0):
                new[key_of(trial)] = trial
        if not new:
            break
        variants = [_forgiving(comparison_of(c, nothing, scatter=scatter), forgiven) for c in new.values()]
        for (key, trial), fit in zip(new.items(), repairings(plain, variants, known), strict=True):
            again = trial
            if is_open_ended(trial[i]):
                predicted = every.predict(plain.scores.to_x(fit.z[:1]))[0]
                again = _with(trial, i, with_missed_modes(trial[i], predicted))
            value = fit.log_density + again[i].log_pairing - trial[i].log_pairing
            fitted[key] = PairedLists(again, fit.z, value)
        best = sorted(fitted.values(), key=lambda p: -p.value)
        proposed = neighbours(best[0].cases[i])
        known = best[0].z if best[0].z is not None else known
        for p in best[:_LEADING]:
            assert p.z is not None
            x = plain.scores.to_x(p.z)
            at_fits = zip(every.predict(x), every.sigma(x), strict=True)
            proposed += [most_probable(cases[i], f, sigma) for f, sigma in at_fits]
    return sorted(fitted.values(), key=lambda p: -p.value)


def _from_draws(every: _EveryMode, case: PlateCase) -> list[Array]:
    """Most probable pairings at draws of the prior, with a large noise."""
    plain = every.listed
    x = plain.scores.to_x(prior_draws(plain, None, _LOG2_DRAWS, SEARCH.first_noise))
    predicted = every.predict(x[plain.model.admissible(x)])
    proposed = []
    for noise in _COARSE_NOISE:
        best = np.argsort(-log_sum(case, predicted, noise), kind="stable")[:_PROPOSING]
        sigma = noise * case.measurement.frequencies
        proposed += [most_probable(case, predicted[k], sigma) for k in best]
    return proposed


@dataclass(frozen=True, slots=True)
class _EveryMode:
    """All modes of one plate of a comparison, and the noise of its list.

    listed, wide : the comparison with the listed modes, and with all modes
    modes, frequencies : slices of the plate among those of all plates
    """

    listed: CorrelatedDensity
    wide: CorrelatedDensity
    modes: slice
    frequencies: slice

    @staticmethod
    def of(comparison: CorrelatedDensity, i: int, cases: Sequence[PlateCase]) -> _EveryMode:
        """The modes of the i-th plate."""
        wide, offsets = all_modes(comparison)
        last = offsets[i] + len(wide.model.parts[i].modes)
        first = sum(case.measurement.size for case in cases[:i])
        frequencies = slice(first, first + cases[i].measurement.size)
        return _EveryMode(comparison, wide, slice(offsets[i], last), frequencies)

    def predict(self, x: Array) -> Array:
        """Frequencies (m, k) of all modes at parameters (m, n), Hz."""
        return self.wide.predict(x)[0][:, self.modes]

    def sigma(self, x: Array) -> Array:
        """Standard deviations of the listed frequencies at parameters (m, n), (m, n_f) Hz."""
        return np.asarray(np.sqrt(self.listed.variance(x))[:, self.frequencies])


def _forgiving(comparison: CorrelatedDensity, relative: float) -> CorrelatedDensity:
    listed = comparison.listed
    variance = listed.variance + (relative * listed.frequencies) ** 2
    return replace(comparison, listed=replace(listed, variance=variance))


def _with(cases: Sequence[PlateCase], i: int, case: PlateCase) -> Cases:
    return (*cases[:i], case, *cases[i + 1 :])
