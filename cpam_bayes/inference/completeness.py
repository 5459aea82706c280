"""Checks of a list that is given as complete, and profile likelihoods of the constants."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cpam_bayes.forward_model.labels import list_order
from cpam_bayes.forward_model.model import ForwardModel, Prediction, reference_vector
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.inference.laplace import maximised
from cpam_bayes.inference.optimise import maximise
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.scores import Expansion, NormalScores
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.mechanics.problem import Array
from cpam_bayes.parameters import ParameterSet, Uniform
from cpam_bayes.plate import Specimen

# Log odds above which another pairing is far more probable.
_DOUBTFUL_LOG_ODDS = float(np.log(100.0))
# Draws from the prior, and those of them from which an optimum is sought for each pairing.
_DRAWS, _STARTS = 300, 3
_MAX_STEPS = 25
# Gain in nats below which an optimum is good enough for odds that matter above a hundred.
_FOR_ODDS = 1e-3


@dataclass(frozen=True, slots=True)
class AlternativePairing:
    """A pairing with one transcription error, far more probable than one to one in a complete list.

    missed : number, from 0, of the model's mode that the list seems to lack, or ``None``.
    spurious : number of the frequency that seems to be a false peak, or ``None``.
    log_odds : against one to one.
    x : (n,) parameters where it fits best.
    """

    missed: int | None
    spurious: int | None
    log_odds: float
    x: Array


@dataclass(frozen=True, slots=True)
class TranscriptionError:
    """The transcription error that a complete list seems to have, in terms of the plate.

    missed : the mode that a list seems to lack, at the best fit of the other modes.
    spurious : the frequency that seems to be a false peak, Hz.
    log_odds : against one to one.
    """

    missed: Mode | None
    spurious: float | None
    log_odds: float


def transcription_error(
    specimen: Specimen, posterior: Posterior, model: ReducedModel, best: Array
) -> TranscriptionError | None:
    """The transcription error that a specimen's list seems to have, ``None`` where it seems to have none.

    best : (n,) optimum of the posterior. Lists that may lack modes are not checked.
    """
    if not posterior.measurement.complete:
        return None
    reference = reference_vector(specimen, posterior.model.parameters)
    alternative = alternative_pairing(posterior, best, reference[None])
    if alternative is None:
        return None
    if alternative.spurious is not None:
        return TranscriptionError(
            None, float(posterior.measurement.frequencies[alternative.spurious]), alternative.log_odds
        )
    assert alternative.missed is not None
    x = alternative.x[: model.parameters.size]
    modes = model.full.modes(x)
    return TranscriptionError(modes[list_order(model, x)[alternative.missed]], None, alternative.log_odds)


@dataclass(frozen=True, slots=True)
class _Pairing:
    """A one-to-one pairing of some frequencies with some modes, and its log prior probability."""

    rows: Array
    columns: Array
    price: float
    missed: int | None = None
    spurious: int | None = None


@dataclass(frozen=True, slots=True)
class _Selected:
    """A model restricted to some of its modes."""

    model: ForwardModel
    columns: Array

    @property
    def parameters(self) -> ParameterSet:
        return self.model.parameters

    def predict(self, x: Array, *, jacobian: bool = False) -> Prediction:
        prediction = self.model.predict(x, jacobian=jacobian)
        slope = None if prediction.jacobian is None else prediction.jacobian[:, self.columns]
        return Prediction(prediction.frequencies[:, self.columns], slope)

    def admissible(self, x: Array) -> Array:
        return self.model.admissible(x)


def alternative_pairing(posterior: Posterior, best: Array, others: Array) -> AlternativePairing | None:
    """The most probable single transcription error in a complete list, if it is far more probable than none.

    Compares evidences by Laplace's method of the list paired one to one, with one mode of the model left out,
    and with one frequency left out, with the priors of ``posterior.pairing``. Far more is a factor above 100.
    Labelled frequencies keep their modes.

    best : (n,) optimum of the posterior.
    others : (m, n_plate) further starts. The model must predict one mode more than there are frequencies.
    """
    n_plate = posterior.model.parameters.size
    draws = posterior.model.parameters.sample(np.random.default_rng(0), _DRAWS)
    draws = draws[posterior.model.admissible(draws)]
    x = np.concatenate((best[None, :n_plate], others, draws))
    predicted, always = posterior.predict(x), 1 + len(others)
    none, *alternatives = _pairings(posterior, predicted.shape[1])
    reference = _evidence(posterior, none, x, always, predicted)[0]
    candidates = [(*_evidence(posterior, pairing, x, always, predicted), pairing) for pairing in alternatives]
    if not candidates:
        return None
    log_evidence, x, pairing = max(candidates, key=lambda f: f[0])
    log_odds = log_evidence - reference
    return (
        AlternativePairing(pairing.missed, pairing.spurious, log_odds, x)
        if log_odds > _DOUBTFUL_LOG_ODDS
        else None
    )


def _pairings(posterior: Posterior, n_modes: int) -> Iterator[_Pairing]:
    """The pairing without an error, then every pairing with one."""
    n, prior = posterior.measurement.size, posterior.pairing
    rows = np.arange(n)
    paired = float(np.log1p(-prior.missed))
    yield _Pairing(rows, rows, n * paired)
    free = np.flatnonzero(~posterior.labelled)
    places = np.setdiff1d(np.arange(n_modes), np.flatnonzero(posterior.labelled))
    if len(places) > len(free):
        for k in range(len(free)):
            columns = rows.copy()
            columns[free] = np.delete(places, k)[: len(free)]
            price = n * paired + float(np.log(prior.missed))
            yield _Pairing(rows, columns, price, missed=int(places[k]))
    if n == 1 or prior.spurious == 0.0:
        return
    for k in range(len(free)):
        columns = rows.copy()
        columns[np.delete(free, k)] = places[: len(free) - 1]
        kept = np.delete(rows, free[k])
        price = (n - 1) * paired + float(prior.log_false(n, posterior.span)[free[k]])
        yield _Pairing(kept, columns[kept], price, spurious=int(free[k]))


def _evidence(
    posterior: Posterior, pairing: _Pairing, x: Array, always: int, predicted: Array
) -> tuple[float, Array]:
    """Log evidence of a pairing, its prior included, and its optimum (n,).

    x : (m, n_plate) starts, of which every pairing takes the first ``always``
    """
    paired = _paired(posterior, pairing)
    residuals = predicted[:, pairing.columns] - paired.measurement.frequencies
    misfit = np.sum((residuals / paired.measurement.frequencies) ** 2, axis=1)
    nearest = np.argsort(misfit, kind="stable")[:_STARTS]
    chosen = np.union1d(np.arange(always), nearest)
    starts = x[chosen]
    if paired.noise_is_inferred:
        noise = [paired.noise_model.suggested(residuals[i]) for i in chosen]
        starts = np.column_stack((starts, noise))
    optima = maximised(paired, paired.scores.to_z(starts), _MAX_STEPS, _FOR_ODDS)
    if not len(optima.value):
        return -np.inf, starts[0]
    log_mass = optima.log_mass
    top = int(np.argmax(log_mass))
    return float(log_mass[top]) + pairing.price, paired.scores.to_x(optima.z[top])


def _paired(posterior: Posterior, pairing: _Pairing) -> Posterior:
    """The posterior with rows of the list paired with columns of the model, in order."""
    full_list, noise = posterior.measurement, posterior.noise_model
    unnamed = replace(full_list, labels=("",) * full_list.size, shapes=None)
    measurement = unnamed.of_rows(pairing.rows)
    return replace(
        posterior,
        model=_Selected(posterior.model, pairing.columns),
        measurement=measurement,
        noise_model=replace(
            noise, scale=noise.scale[pairing.rows], solver_error=noise.solver_error[pairing.columns]
        ),
        labelled=np.zeros(len(pairing.rows), dtype=bool),
        alternatives=(),
    )


# Half the 95 % quantile of chi-square with one degree of freedom.
DROP_95 = 1.920729
_GRID = 21
# Margin of the grid beyond the draws, as a fraction of their range, and distance of a bound that is included.
_BEYOND, _NEAR = 0.15, 0.05
# Draws from which starts are chosen.
_CANDIDATES = 4000
# Most restarts of points from their neighbours' optima, gain in nats that counts as better, and gain that a
# step must promise.
_SWEEPS, _BETTER, _PROMISED = 4, 1e-4, 1e-6
_STEPS = 40


@dataclass(frozen=True, slots=True)
class Profile:
    """Profile likelihood of one parameter, SI.

    values : (g,).
    drop : (g,) largest log likelihood of all minus that with the parameter held there, infinite where none
    was found.
    best : the value with the largest likelihood.
    lower, upper : outer ends of the 95 % region, drop <= 1.92, or of the grid where the likelihood does not
    drop so far.
    lower_open, upper_open : whether the end is that of the grid.
    parts : separate intervals of the region.
    """

    name: str
    values: Array
    drop: Array
    best: float
    lower: float
    upper: float
    lower_open: bool
    upper_open: bool
    parts: int


def profile_likelihoods(
    posterior: Posterior, names: tuple[str, ...], draws: Array, log_prob: Array, n_grid: int = _GRID
) -> tuple[Profile, ...]:
    """Profile log likelihood of each of ``names`` on a grid (Raue et al., 2009).

    pl(v) = max over the other parameters of log p(data | p) with p_k = v, within bounds and constraints.
    Priors of ``names`` and uniform ones do not enter; those of the noise and of plate sizes do, over their
    scores. All grid points are optimised together, from the best draws near them and then from the optima of
    their neighbours.

    draws (m, n), log_prob (m,) : of the chains. The grid spans the draws, and the whole search
    interval where the prior is not uniform.
    """
    flat = _without_priors(posterior, names)
    few = np.unique(np.append(np.linspace(0, len(draws) - 1, _CANDIDATES).astype(int), log_prob.argmax()))
    draws = draws[few]
    height = log_prob[few] + flat.parameters.log_prior(draws) - posterior.parameters.log_prior(draws)
    index = [posterior.parameters.names.index(name) for name in names]
    grids = [_grid(posterior, k, draws[:, k], n_grid) for k in index]
    starts = [_starts(draws, height, k, grid) for k, grid in zip(index, grids, strict=True)]
    # the last point has nothing held: it finds the largest likelihood of all
    held = np.append(np.repeat(index, n_grid), -1)
    even = np.array([p.prior.is_range for p in flat.parameters.parameters], dtype=float)
    profiled = _Profiled(flat, even, held)
    u = flat.scores.to_z(np.vstack((*starts, draws[height.argmax()])))
    value = np.full(len(u), -np.inf)
    profiled.maximise_again(np.arange(len(u)), u.copy(), u, value)
    changed = np.ones(len(u), dtype=bool)
    for _ in range(_SWEEPS):
        moved = np.zeros(len(u), dtype=bool)
        for side in (-1, 1):
            moved |= profiled.from_neighbours(u, value, n_grid, side, changed | moved)
        changed = moved
        if not changed.any():
            break
    top = int(value.argmax())
    if top != len(u) - 1:
        profiled.maximise_again(np.array([len(u) - 1]), u[top : top + 1].copy(), u, value)
    best = flat.scores.to_x(u[-1])
    drops = value.max() - value[:-1].reshape(len(names), n_grid)
    return tuple(
        _profile(name, grid, drop, float(best[k]))
        for name, grid, drop, k in zip(names, grids, drops, index, strict=True)
    )


def _without_priors(posterior: Posterior, names: tuple[str, ...]) -> Posterior:
    """The posterior with uniform priors of some parameters between their bounds."""
    parameters = tuple(
        replace(p, prior=Uniform(p.prior.lower, p.prior.upper), coupled=None) if p.name in names else p
        for p in posterior.parameters.parameters
    )
    flat = ParameterSet(parameters, posterior.parameters.fixed)
    return replace(posterior, parameters=flat, scores=NormalScores(flat))


def _grid(posterior: Posterior, k: int, draws: Array, n: int) -> Array:
    prior = posterior.parameters.parameters[k].prior
    if not prior.is_range:
        return np.linspace(prior.lower, prior.upper, n)
    low, high = np.quantile(draws, (0.0005, 0.9995))
    beyond, near = _BEYOND * (high - low), _NEAR * (prior.upper - prior.lower)
    low = prior.lower if low - beyond < prior.lower + near else low - beyond
    high = prior.upper if high + beyond > prior.upper - near else high + beyond
    return np.linspace(low, high, n)


def _starts(draws: Array, height: Array, k: int, grid: Array) -> Array:
    """Starts (g, n): for each grid point the best draw near it, moved onto it."""
    place = np.rint((draws[:, k] - grid[0]) / (grid[1] - grid[0]))
    place = np.clip(place, 0, len(grid) - 1).astype(int)
    order = np.argsort(height, kind="stable")
    best = np.full(len(grid), -1)
    best[place[order]] = order  # the last one written, the best, stays
    filled = np.flatnonzero(best >= 0)
    best = best[filled[np.abs(np.arange(len(grid))[:, None] - filled).argmin(axis=1)]]
    starts: Array = draws[best]
    starts[:, k] = grid
    return starts


@dataclass(frozen=True, slots=True)
class _Profiled:
    """Maximisation of the likelihood with one parameter of each point held.

    even : (n,) 1 for parameters whose priors do not enter, 0 for the others.
    held : (m,) column that is held at each point, -1 for none.
    """

    posterior: Posterior
    even: Array
    held: Array

    def maximise_again(self, which: Array, start: Array, u: Array, value: Array) -> Array:
        """Optimise points from scores (k, n); update ``u`` and ``value``, of all points, where they improved.

        which : (k,) numbers of the points. Returns the numbers of the improved ones.
        """
        scores = self.posterior.scores

        def target(at: Array, rows: Array) -> Expansion:
            expansion = self.posterior.expand(at).without_prior(at, self.even)
            fixed = np.arange(at.shape[1]) == self.held[which[rows], None]
            crossed = fixed[:, :, None] | fixed[:, None, :]
            curvature = np.where(crossed, np.eye(at.shape[1]), expansion.curvature)
            return Expansion(expansion.value, np.where(fixed, 0.0, expansion.gradient), curvature)

        optimum = maximise(target, start, scores.lower, scores.upper, most_steps=_STEPS, promised=_PROMISED)
        higher = optimum.expansion.value > value[which] + _BETTER
        u[which[higher]], value[which[higher]] = optimum.u[higher], optimum.expansion.value[higher]
        return which[higher]

    def from_neighbours(self, u: Array, value: Array, n_grid: int, side: int, changed: Array) -> Array:
        """Restart points from the optima of their neighbours on one side, if these changed.

        Returns a mask (m,) of the points that improved.
        """
        i = np.arange(len(u) - 1)
        to = i[(i % n_grid + side >= 0) & (i % n_grid + side < n_grid)]
        to = to[changed[to + side]]
        moved = np.zeros(len(u), dtype=bool)
        if len(to):
            start = u[to + side].copy()
            start[np.arange(len(to)), self.held[to]] = u[to, self.held[to]]
            moved[self.maximise_again(to, start, u, value)] = True
        return moved


def _profile(name: str, values: Array, drop: Array, best: float) -> Profile:
    """Profile with its 95 % region, ends interpolated in the root of the drop, which is nearly linear."""
    level = np.sqrt(DROP_95)
    root = np.sqrt(np.maximum(drop, 0.0))
    ends = []
    for side in (-1, 1):
        outward = np.flatnonzero(side * (values - best) > 0.0)[::side]
        places, heights = np.append(best, values[outward]), np.append(0.0, root[outward])
        j = int(np.flatnonzero(heights < level)[-1])  # the last one inside
        if j == len(places) - 1:
            ends.append((float(places[-1]), True))
            continue
        fraction = (level - heights[j]) / (heights[j + 1] - heights[j])
        ends.append((float(places[j] + fraction * (places[j + 1] - places[j])), False))
    (lower, lower_open), (upper, upper_open) = ends
    at = int(np.searchsorted(values, best))
    inside = np.insert(root < level, at, True)
    parts = int(np.sum(inside[1:] & ~inside[:-1]) + inside[0])
    return Profile(name, values, drop, best, lower, upper, lower_open, upper_open, parts)
