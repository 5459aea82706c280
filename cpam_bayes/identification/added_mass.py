"""Detection of a mass added to a plate between two lists of its frequencies: whether, how heavy, where.

The second list is compared with the first, not with a model: d_i = ln(f'_i / f_i) holds none of the errors
that both lists share. In the modes phi of the plate, of unit modal mass, a mass m at (x, y) gives

    (diag(lambda) - lambda' (I + m U U^T)) q = 0,  U = [u, v, w, r phi_x, r phi_y](x, y),

with r its radius of gyration (Dowell, J. Appl. Mech. 46, 206, 1979) and U the mean over the disc that it
covers: the same to second order in its radius, whether it bends with the plate or not. The lowest modes are
kept; the response of the others to the mass is one vector per field. Places are weighed on a grid that is
refined where they are likely.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import Any, Final

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import chi2

from cpam_bayes.forward_model.local.basis import local_space
from cpam_bayes.forward_model.model import PlateModel
from cpam_bayes.inference.posterior import NOISE_PRIOR
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.problem import rigid_body_count
from cpam_bayes.mechanics.ritz import evaluate_sector
from cpam_bayes.plate.edges import FIELDS
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

CLAIMED: Final = 0.95
"""Least probability of a mass that is reported as added."""
# Relative standard deviation of a shift: a coin neither bends with the plate nor is quite stiff.
_FORM: Final = 0.02
LARGEST: Final = 0.15
"""The largest mass that is sought, over the plate's."""
# Masses over the plate's: log-uniform prior from the least to the largest, and where shifts are computed.
# Between these a shift is linear in ln(1 + 4 m): exact for a squared mode shape of 4, as at a free end.
_LEAST: Final = 5e-4
_NODES: Final = (0.005, 0.012, 0.03, 0.06, 0.1, LARGEST)
_CURVED: Final = 4.0
# Fraction of the largest mass that counts as the end, and probability there from which it may be heavier.
_END, _BEYOND = 0.9, 0.05
# Without a mass: probability that all frequencies changed by one factor, by temperature or the analyser, and
# the standard deviation of its logarithm.
_FACTOR_CHANGED, _FACTOR_SD = 0.1, 0.01
# Least probability of a common factor that is reported.
_FACTOR_SAID: Final = 0.75
# Area over mass of an added mass, m2/kg: mean and standard deviation from steel of 1.5 to 6 mm. A shift is
# linear in it, as the square of the radius is.
_PER_MASS, _PER_MASS_SD = 0.5 * (1 / 12 + 1 / 48), (1 / 12 - 1 / 48) / 12**0.5
_AREAL: Final = (1.0 / (_PER_MASS + _PER_MASS_SD), 1.0 / (_PER_MASS - _PER_MASS_SD))
_STEEL: Final = 7850.0
# Quadrature of the mean over a disc, exact to the fifth degree: points over its radius, and weights.
_RING: Final = np.sqrt(2.0 / 3.0) * np.exp(1j * np.pi / 3.0 * np.arange(6))
_DISC: Final = np.vstack(([0.0, 0.0], np.column_stack((_RING.real, _RING.imag))))
_DISC_WEIGHTS: Final = np.array([2.0] + 6 * [1.0]) / 8.0
# Cells along each side, how often a cell may be divided, most and fewest cells divided at a time, and nats
# below the best beyond which cells are not divided.
_CELLS, _LEVELS, _DIVIDED, _LEAST_DIVIDED, _UNLIKELY = 24, 3, 96, 24, 12.0
# Modes kept beyond those of the list.
_FURTHER: Final = 6
# Polynomials added in each direction.
_DENT: Final = 4
# Masses at which a posterior is integrated, and the share of it that a smaller range may lose.
_FINE, _LOST = 160, 1e-7
# Nodes over which an unstated repeatability is integrated.
_LEVELS_OF_NOISE: Final = 24
_DRAWS: Final = 4000
_TAIL: Final = 0.025
# Bisections for a detection limit, masses at which a list is weighed, and simulated lists for each.
_STEPS, _WEIGHED, _LISTS = 8, 20, 400
# Share of a plate's area that a detection limit leaves out.
_HIDDEN: Final = 0.2
# p-value below which neither a mass nor none explains a list.
_UNEXPLAINED: Final = 1e-3
_ALIKE: Final = 1e-3


class Finding(Enum):
    """The verdict on the second list; the values are those of JSON documents."""

    ADDED = "mass added"
    NOTHING = "nothing added"
    OPEN = "undecided"
    OTHER = "changed otherwise"
    """Neither noise nor a mass anywhere, up to `LARGEST`, explains the difference of the lists."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Noise of one list.

    relative : (n,) standard deviations, None where the file states none; rounding : (n,)
    """

    relative: Array | None
    rounding: Array

    def variances(self) -> tuple[Array, Array]:
        """Variances (k, n) of ln f' - ln f at the possible repeatabilities, and their log priors (k,)."""
        if self.relative is not None:
            return (2.0 * (self.relative**2 + self.rounding**2))[None], np.zeros(1)
        level = np.geomspace(NOISE_PRIOR.lower, 0.02, _LEVELS_OF_NOISE)
        log_prior = NOISE_PRIOR.log_density(level) + np.log(level)
        return 2.0 * (level[:, None] ** 2 + self.rounding**2), log_prior - logsumexp(log_prior)


@dataclass(frozen=True, slots=True)
class LoadedPlate:
    """Modes of a plate for its response to an added mass.

    eigenvalues : (k,) of the modes that are kept, rigid-body motions first, (rad/s)^2
    listed : (n,) indices of the listed ones
    fields : points (p, 2) of 0 to 1, radius in m -> (5, p, N) of all N modes, mean over a disc
    every : (N,) eigenvalues of all modes
    scatter : points -> (p, n) mean square change of phi^2 over the constants that the first list leaves open
    sides : m; mass : kg, with its relative standard deviation
    """

    eigenvalues: Array
    listed: Array
    fields: Callable[[Array, float], Array]
    every: Array
    scatter: Callable[[Array], Array]
    sides: tuple[float, float]
    mass: float
    mass_sd: float

    def masses(self) -> Array:
        """Masses (k,), kg, at which shifts are computed, 0 first."""
        return self.mass * np.array([0.0, *_NODES])

    def shifts(self, points: Array, masses: Array, areals: Sequence[float]) -> Array:
        """Shifts ln f' - ln f (p, n_areals, k, n) of the list with masses (k,), kg, at points (p, 2).

        areals : mass of a disc over its area, kg/m2
        """
        out = np.zeros((len(points), len(areals), len(masses), len(self.listed)))
        # a mean over a disc of radius r is a polynomial in r^2
        square = masses / (np.pi * np.array(areals)[:, None])
        largest = float(np.sqrt(square.max()))
        centre, middle, whole = (self.fields(points, largest * part) for part in (0.0, np.sqrt(0.5), 1.0))
        for i, j in np.argwhere(square > 0.0):
            s = square[i, j] / square.max()
            inner = (1.0 - s) * ((1.0 - 2.0 * s) * centre + 4.0 * s * middle)
            fields = inner + s * (2.0 * s - 1.0) * whole
            out[:, i, j] = self._shifts(fields, masses[j], areals[i])
        return out

    def _shifts(self, fields: Array, mass: float, areal: float) -> Array:
        """Shifts ln f' - ln f (p, n) of the list with a mass where the fields of all modes are (5, p, N)."""
        k = len(self.eigenvalues)
        # about its foot, of a disc of steel
        fields[3:] *= np.sqrt(mass / (4.0 * np.pi * areal) + (areal / _STEEL) ** 2 / 3.0)
        fields = np.ascontiguousarray(np.swapaxes(fields, 0, 1))
        low, high = fields[..., :k], fields[..., k:]
        # the modes above respond in w and rotations as at the middle of the list: three modes of unit mass
        above = self.every[k:]
        answer = high[:, 2:] / (above - self.eigenvalues[self.listed].mean())
        each = np.swapaxes(answer, 1, 2)
        inertia, stiffness = answer @ each, (answer * above) @ each
        scale = np.sqrt(np.einsum("paa->pa", inertia)) + 1e-300
        unit = scale[:, :, None] * scale[:, None, :]
        root = np.linalg.inv(np.linalg.cholesky(inertia / unit + 1e-9 * np.eye(3)))
        lam, vectors = np.linalg.eigh(root @ (stiffness / unit) @ np.swapaxes(root, 1, 2))
        lam = np.maximum(lam, above[0])
        answered = np.swapaxes(high @ each, 1, 2) / scale[:, :, None]
        answered = np.swapaxes(vectors, 1, 2) @ root @ answered
        load = np.concatenate((np.swapaxes(low, 1, 2), answered), axis=1)
        values = np.concatenate((np.broadcast_to(self.eigenvalues, (len(load), k)), lam), axis=1)
        # (I + m L L^T)^-1/2 = I + L V ((1 + m s^2)^-1/2 - 1) / s^2 V^T L^T of the singular values s of L
        square, v = np.linalg.eigh(np.swapaxes(load, 1, 2) @ load)
        square = np.maximum(square, 1e-12 * square[:, -1:])
        less = ((1.0 + mass * square) ** -0.5 - 1.0) / square
        turned = load @ v
        w = np.eye(k + 3) + (turned * less[:, None, :]) @ np.swapaxes(turned, 1, 2)
        found = np.linalg.eigvalsh((w * values[:, None, :]) @ w)
        return np.asarray(0.5 * (np.log(found[:, self.listed]) - np.log(values[:, self.listed])))


@single_blas_thread
def loaded_plate(
    model: PlateModel,
    best: Array,
    draws: Array,
    listed: Array,
    sides: tuple[float, float],
    mass: tuple[float, float],
) -> LoadedPlate:
    """Modes of a plate at its constants (n_parameters,), and their scatter over draws (m, n_parameters).

    listed : (n,) mode of each frequency, from 0. mass : kg, and its relative standard deviation
    """
    model = _richer(model, np.vstack((best, draws)))
    lam, fields = _modes(model, best, sides)
    first = rigid_body_count(model.operator.problem.edges)
    listed = listed + first
    lam[:first] = 0.0
    k = int(listed.max()) + 1 + _FURTHER

    others = [_modes(model, x, sides, listed)[1] for x in draws]

    def scatter(points: Array) -> Array:
        squares = [np.sum(f(points, 0.0)[:3] ** 2, axis=0) for f in others]
        at_best = np.sum(fields(points, 0.0)[:3, :, listed] ** 2, axis=0)
        return np.asarray(np.mean((np.array(squares) - at_best) ** 2, axis=0))

    return LoadedPlate(lam[:k], listed, fields, lam, scatter, sides, *mass)


def _richer(model: PlateModel, samples: Array) -> PlateModel:
    """The plate with more trial functions, which the dent under a mass needs and its own modes do not."""
    if model.basis is None:
        return model
    problem, settings = model.operator.problem, model.basis[0]
    degrees = {name: getattr(settings, name) + _DENT for name in ("degree_x", "degree_y")}
    space = local_space(problem, replace(settings, **degrees))
    return replace(model, operator=discretise(problem, space, problem.parameters.mapping(samples)))


def _modes(
    model: PlateModel, x: Array, sides: tuple[float, float], kept: Array | slice = slice(None)
) -> tuple[Array, Callable[[Array, float], Array]]:
    """All eigenvalues of the space at a parameter vector, ascending, and fields of the modes to keep."""
    operator = model.operator
    stiffness, mass = model.coefficients(np.atleast_2d(x))
    blocks = [block.dense() for block in operator.blocks]
    pairs = [scipy.linalg.eigh(b.stiffness.assemble(stiffness)[0], b.mass.assemble(mass)[0]) for b in blocks]
    values = np.concatenate([lam for lam, _ in pairs])
    order = np.argsort(values, kind="stable")
    sizes = [sector.size for sector in operator.space.sectors]
    starts = np.cumsum([0, *sizes])
    whole = np.zeros((starts[-1], len(values)))
    at = 0
    for block, (lam, vectors) in zip(blocks, pairs, strict=True):
        whole[np.ix_(block.index, range(at, at + len(lam)))] = vectors
        at += len(lam)
    whole = whole[:, order][:, kept]

    def fields(points: Array, radius: float) -> Array:
        disc, weights = (_DISC, _DISC_WEIGHTS) if radius else (np.zeros((1, 2)), np.ones(1))
        # points beyond an edge are moved onto it
        at = np.clip(points[:, None] + radius * disc / np.array(sides), 0.0, 1.0).reshape(-1, 2)
        out = np.zeros((len(FIELDS), len(points), whole.shape[1]))
        for sector, a, b in zip(operator.space.sectors, starts[:-1], starts[1:], strict=True):
            each = evaluate_sector(sector, at, "").reshape(len(points), len(disc), -1)
            out[FIELDS.index(sector.field)] += np.tensordot(each, weights, (1, 0)) @ whole[a:b]
        return out

    return values[order], fields


@dataclass(frozen=True, slots=True)
class Cells:
    """Rectangles of a plate with the shifts by a mass at their centre.

    centre : (p, 2) of 0 to 1; half : (p,) half their sides over the plate's
    shifts, slopes : (p, n_masses, n), at the mean area of a mass, and per standard deviation of it
    scatter : (p, n) as of `LoadedPlate`
    """

    centre: Array
    half: Array
    shifts: Array
    slopes: Array
    scatter: Array

    def chosen(self, at: Array) -> Cells:
        """Cells at some rows."""
        return Cells(*(getattr(self, name)[at] for name in self.__slots__))

    def joined(self, other: Cells, keep: Array) -> Cells:
        """The cells with ``keep`` (p,), and others."""
        kept = self.chosen(keep)
        pairs = ((getattr(kept, name), getattr(other, name)) for name in self.__slots__)
        return Cells(*(np.concatenate(pair) for pair in pairs))


def _cells(plate: LoadedPlate, centre: Array, half: Array) -> Cells:
    return Cells(centre, half, *_shifts_and_slopes(plate, centre, plate.masses()), plate.scatter(centre))


def _shifts_and_slopes(plate: LoadedPlate, points: Array, masses: Array) -> tuple[Array, Array]:
    """Shifts at the mean area of a mass, and their change per standard deviation of it."""
    wide, narrow = np.moveaxis(plate.shifts(points, masses, _AREAL), 1, 0)
    return 0.5 * (wide + narrow), 0.5 * (wide - narrow)


@single_blas_thread
def cells_of(plate: LoadedPlate) -> Cells:
    """Cells of the whole plate, with which the search of every list begins."""
    middle = (np.arange(_CELLS) + 0.5) / _CELLS
    centre = np.stack(np.meshgrid(middle, middle, indexing="ij"), axis=-1).reshape(-1, 2)
    return _cells(plate, centre, np.full(len(centre), 0.5 / _CELLS))


def _log_likelihoods(d: Array, shift: Array, slope: Array, extra: Array, variances: Array) -> Iterator[Array]:
    """Log likelihood (...) of differences (n,) at shifts (..., n), for each noise (k, n).

    slope : (..., n) standard deviation of the shifts by one unknown size, which all have in common
    extra : (..., n) further variances of each
    """
    away, slope, extra = (np.ascontiguousarray(np.moveaxis(a, -1, 0)) for a in (d - shift, slope, extra))
    for variance in variances:
        squares, along, total, product = (np.full(shift.shape[:-1], start) for start in (0.0, 0.0, 1.0, 1.0))
        for of_mode, common, more, by_noise in zip(away, slope, extra, variance, strict=True):
            weight = 1.0 / (more + by_noise)
            weighted = weight * common
            squares += weight * of_mode**2
            along += weighted * of_mode
            total += weighted * common
            product *= by_noise * weight
        product = np.log(np.maximum(product, 1e-300)) - np.log(total)
        yield -0.5 * (squares - along**2 / total - product + np.sum(np.log(2.0 * np.pi * variance)))


def _log_likelihood(d: Array, noise: tuple[Array, Array]) -> Array:
    """Log likelihood (k,) of differences (n,) where no mass was added, for each noise, with its prior."""
    none = np.zeros_like(d)
    return np.array(list(_log_likelihoods(d, none, none, none, noise[0]))) + noise[1]


def _without(d: Array, noise: tuple[Array, Array]) -> Array:
    """Log evidence (k,) of differences (n,) without a mass, for each noise, with its prior."""
    weight = 1.0 / noise[0]
    return _log_likelihood(d, noise) + _or_factor(weight @ d, weight.sum(axis=1))


def _or_factor(along: Array, total: Array) -> Array:
    """Gain in the log evidence of no mass where all frequencies may have changed by one factor.

    along, total : sums over the differences of d / variance and 1 / variance
    """
    of_factor = 0.5 * (
        _FACTOR_SD**2 * along**2 / (1.0 + _FACTOR_SD**2 * total) - np.log1p(_FACTOR_SD**2 * total)
    )
    return np.asarray(np.logaddexp(np.log(1.0 - _FACTOR_CHANGED), np.log(_FACTOR_CHANGED) + of_factor))


def _between(plate: LoadedPlate, cells: Cells, masses: Array) -> tuple[Array, Array, Array]:
    """Shifts interpolated at masses (k,), their slopes, and their further variances, (p, k, n) each."""
    nodes = plate.masses()
    right = np.clip(np.searchsorted(nodes, masses), 1, len(nodes) - 1)
    of_node, of_mass = (np.log1p(_CURVED * m / plate.mass) for m in (nodes, masses))
    part = ((of_mass - of_node[right - 1]) / (of_node[right] - of_node[right - 1]))[:, None]
    shift, slope = ((1.0 - part) * a[:, right - 1] + part * a[:, right] for a in (cells.shifts, cells.slopes))
    open_ = 0.25 * masses[:, None] ** 2 * cells.scatter[:, None, :]
    return shift, slope, (_FORM * shift) ** 2 + open_


def _weighed(
    plate: LoadedPlate, cells: Cells, d: Array, noise: tuple[Array, Array], masses: Array
) -> tuple[Array, Array]:
    """Log of posterior times evidence, by cell and mass (k,), and by noise.

    masses : equally spaced in their logarithms
    """
    step = np.log(masses[1] / masses[0]) / np.log(LARGEST / _LEAST)
    log_prior = np.log(4.0 * cells.half**2 * step)[:, None]
    shifted = _between(plate, cells, masses)
    log_weight, of_noise = np.array(-np.inf), []
    for each, log_noise in zip(_log_likelihoods(d, *shifted, noise[0]), noise[1], strict=True):
        each += log_prior + log_noise
        of_noise.append(logsumexp(each))
        log_weight = np.logaddexp(log_weight, each)
    return log_weight, np.array(of_noise)


@dataclass(frozen=True, slots=True)
class AddedMass:
    """The mass inferred from the second list.

    probability : that a mass was added; log_bayes_factor : of one against none
    p_value : of the residual differences with the best mass, or with none
    mass, sd, interval : kg, 95 %; without a mass, what may be there at most
    place : m; radius : about it or one of its images, containing the mass with 95 % probability, m
    images : other places that no list distinguishes from it, m
    draws : (n, 3) of mass and place, SI
    noise : relative repeatability of one list
    """

    finding: Finding
    probability: float
    log_bayes_factor: float
    p_value: float
    mass: float
    sd: float
    interval: tuple[float, float]
    place: tuple[float, float]
    radius: float
    images: tuple[tuple[float, float], ...]
    draws: Array
    noise: float

    def distance(self, x: float, y: float) -> float:
        """Distance of a point from the place or the nearest of its images, m."""
        return min(float(np.hypot(x - a, y - b)) for a, b in (self.place, *self.images))


@single_blas_thread
def find_masses(
    plate: LoadedPlate,
    whole: Cells,
    lists: Sequence[tuple[Array, Repeatability]],
    rng: np.random.Generator,
) -> list[AddedMass]:
    """Added mass in each of several lists, from its differences d = ln f' - ln f (n,) from the first list.

    An unstated repeatability is one for all lists: the others inform the prior of each.

    whole : as of `cells_of`
    """
    noises = [repeatability.variances() for _, repeatability in lists]
    refined = [_refined(plate, whole, d, noise) for (d, _), noise in zip(lists, noises, strict=True)]
    inferred = [i for i, (_, repeatability) in enumerate(lists) if repeatability.relative is None]
    said = {}
    for i in inferred:
        d, level = lists[i][0], (noises[i][0], np.zeros(len(noises[i][0])))
        _, _, of_mass = _masses(plate, refined[i], d, level)
        said[i] = np.logaddexp(_without(d, level), of_mass)
    found = []
    for i, (d, repeatability) in enumerate(lists):
        variance, log_prior = noises[i]
        if i in said:
            others = [said[j] for j in inferred if j != i]
            log_prior = log_prior + np.sum(others, axis=0) / _common(len(others))
            log_prior -= logsumexp(log_prior)
            likely = said[i] + log_prior > np.max(said[i] + log_prior) - _UNLIKELY
            variance, log_prior = variance[likely], log_prior[likely]
        is_stated = repeatability.relative is not None
        found.append(_found(plate, whole, refined[i], d, (variance, log_prior), is_stated, rng))
    return found


def _refined(plate: LoadedPlate, whole: Cells, d: Array, noise: tuple[Array, Array]) -> Cells:
    """Cells that may contain the mass, small where it is likely."""
    masses = np.geomspace(_LEAST * plate.mass, LARGEST * plate.mass, 60)

    def weighed(cells: Cells) -> Array:
        return np.asarray(logsumexp(_weighed(plate, cells, d, noise, masses)[0], axis=1))

    cells, log_weight = whole, weighed(whole)
    for _ in range(_LEVELS):
        density = log_weight - 2.0 * np.log(cells.half)
        order = np.argsort(-density)[:_DIVIDED]
        likely = density[order] > density.max() - _UNLIKELY
        likely[:_LEAST_DIVIDED] = True
        # where even the best places are as good as all others, smaller cells add nothing
        if likely.all() and len(order) == _DIVIDED and density[order[-1]] > density.max() - 2.0:
            break
        chosen = order[likely]
        quarter = 0.5 * cells.half[chosen]
        corners = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
        centre = (cells.centre[chosen][:, None] + quarter[:, None, None] * corners).reshape(-1, 2)
        divided = _cells(plate, centre, np.repeat(quarter, 4))
        keep = np.ones(len(cells.half), dtype=bool)
        keep[chosen] = False
        cells = cells.joined(divided, keep)
        log_weight = np.concatenate((log_weight[keep], weighed(divided)))
    return cells.chosen(log_weight > log_weight.max() + np.log(_LOST))


def _masses(
    plate: LoadedPlate, cells: Cells, d: Array, noise: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Masses (k,) that carry the posterior, and `_weighed` at them."""
    low, high = _LEAST * plate.mass, LARGEST * plate.mass
    while True:
        masses = np.geomspace(low, high, _FINE)
        log_weight, of_noise = _weighed(plate, cells, d, noise, masses)
        of_mass = logsumexp(log_weight, axis=0)
        share = np.exp(of_mass - logsumexp(of_mass))
        carrying = np.flatnonzero(share > _LOST)
        first, last = max(carrying[0] - 1, 0), min(carrying[-1] + 1, _FINE - 1)
        if last - first > _FINE // 3:
            return masses, log_weight, of_noise
        low, high = masses[first], masses[last]


def _found(
    plate: LoadedPlate,
    whole: Cells,
    cells: Cells,
    d: Array,
    noise: tuple[Array, Array],
    is_stated: bool,
    rng: np.random.Generator,
) -> AddedMass:
    of_none = _without(d, noise)
    none = float(logsumexp(of_none))
    masses, log_weight, of_mass = _masses(plate, cells, d, noise)
    evidence = float(logsumexp(log_weight))
    probability = float(1.0 / (1.0 + np.exp(np.clip(none - evidence, -700, 700))))
    # by noise alone
    of_noise = float(np.exp(logsumexp(_log_likelihood(d, noise)) - none)) * (1.0 - _FACTOR_CHANGED)
    of_noise *= 1.0 - probability
    best = np.array(np.unravel_index(int(np.argmax(log_weight)), log_weight.shape))
    shift, slope, extra = (v[0, 0] for v in _between(plate, cells.chosen(best[:1]), masses[best[1:]]))
    of_level = np.logaddexp(of_mass, of_none)
    variance = np.exp(np.exp(of_level - logsumexp(of_level)) @ np.log(noise[0]))
    p_value = 1.0
    if is_stated:
        covariance = np.diag(variance + extra) + np.outer(slope, slope)
        left = min((d - shift) @ np.linalg.solve(covariance, d - shift), np.sum(d**2 / variance))
        p_value = float(chi2.sf(left, len(d)))
    draws = _drawn(plate, cells, log_weight, masses, rng)
    place, radius, images = _place(plate, whole, draws, cells.centre[best[0]])
    mass, finding = draws[:, 0], Finding.OPEN
    if p_value < _UNEXPLAINED:
        finding = Finding.OTHER
    elif probability >= CLAIMED:
        is_heavier = np.mean(mass > _END * LARGEST * plate.mass) > _BEYOND
        finding = Finding.OTHER if is_heavier else Finding.ADDED
    elif of_noise >= 0.5:
        finding = Finding.NOTHING
    elif 1.0 - probability - of_noise >= _FACTOR_SAID:
        finding = Finding.OTHER
    return AddedMass(
        finding,
        probability,
        evidence - none,
        p_value,
        float(mass.mean()),
        float(mass.std()),
        (float(np.quantile(mass, _TAIL)), float(np.quantile(mass, 1.0 - _TAIL))),
        place,
        radius,
        images,
        draws,
        float(np.sqrt(0.5 * variance.mean())),
    )


def _drawn(
    plate: LoadedPlate, cells: Cells, log_weight: Array, masses: Array, rng: np.random.Generator
) -> Array:
    """Draws (n, 3) of mass and place, SI: a cell and a mass, uniform within the cell."""
    weight = np.exp(log_weight - log_weight.max()).ravel()
    chosen = rng.choice(len(weight), _DRAWS, p=weight / weight.sum())
    cell, at = np.unravel_index(chosen, log_weight.shape)
    within = rng.uniform(-1.0, 1.0, (_DRAWS, 3))
    place = (cells.centre[cell] + within[:, :2] * cells.half[cell][:, None]) * plate.sides
    step = 0.5 * np.log(masses[1] / masses[0])
    # the list gives the mass as a fraction of the plate's
    log_mass = np.log(masses[at]) + step * within[:, 2] + plate.mass_sd * rng.standard_normal(_DRAWS)
    return np.column_stack((np.exp(log_mass), place))


def _place(
    plate: LoadedPlate, whole: Cells, draws: Array, best: Array
) -> tuple[tuple[float, float], float, tuple[tuple[float, float], ...]]:
    """Mean place of the draws, all laid on the image of the best one, its radius, and its images."""
    sides = np.array(plate.sides)
    images = symmetries(plate, whole)
    folded = np.array([image(draws[:, 1:] / sides) * sides for image in images])
    distance = np.linalg.norm(folded - best * sides, axis=-1)
    laid = folded[np.argmin(distance, axis=0), range(len(draws))]
    near = np.quantile(np.linalg.norm(laid - best * sides, axis=1), 0.5)
    close = np.linalg.norm(laid - best * sides, axis=1) <= 3.0 * near
    middle = laid[close].mean(axis=0)
    radius = float(np.quantile(np.linalg.norm(laid - middle, axis=1), 1.0 - 2 * _TAIL))
    # an image within the uncertainty of the place is the place itself
    others: list[tuple[float, float]] = []
    for image in images[1:]:
        at = image((middle / sides)[None])[0] * sides
        if all(np.hypot(*(at - np.array(known))) > radius for known in (tuple(middle), *others)):
            others.append((float(at[0]), float(at[1])))
    # of indistinguishable places the one furthest along x, then y, whatever rounding prefers
    every = [(float(middle[0]), float(middle[1])), *others]
    place = max(every, key=lambda at: (round(at[0] / sides[0], 3), round(at[1] / sides[1], 3)))
    return place, radius, tuple(at for at in every if at is not place)


def symmetries(plate: LoadedPlate, whole: Cells) -> list[Callable[[Array], Array]]:
    """Maps of places (p, 2) of 0 to 1 to places that no list distinguishes from them, the identity first."""
    field = whole.shifts[:, 1].reshape(_CELLS, _CELLS, -1)
    largest = np.abs(field).max()
    found: list[Callable[[Array], Array]] = []
    square = abs(plate.sides[0] / plate.sides[1] - 1.0) < _ALIKE
    for turned in (False, True) if square else (False,):
        for flip_x, flip_y in ((0, 0), (1, 0), (0, 1), (1, 1)):
            other = np.swapaxes(field, 0, 1) if turned else field
            other = other[:: -1 if flip_x else 1, :: -1 if flip_y else 1]
            if np.abs(other - field).max() < _ALIKE * largest:
                found.append(partial(_mapped, turned, np.array([flip_x, flip_y])))
    return found


def _mapped(turned: bool, flip: Array, places: Array) -> Array:
    moved = np.where(flip > 0, 1.0 - places, places)
    return moved[:, ::-1] if turned else moved


def predicted_shifts(
    plate: LoadedPlate, mass: float, place: tuple[float, float], noise: Array, rounding: Array
) -> tuple[Array, Array]:
    """Mean and standard deviation (n,) of ln f' - ln f of a list with a known mass, kg, at a place in m.

    noise, rounding : (n,) relative, of one list
    """
    point = np.array([place]) / plate.sides
    shift, slope = (v[0, 0] for v in _shifts_and_slopes(plate, point, np.array([mass])))
    variance = 2.0 * (noise**2 + rounding**2) + slope**2 + (0.5 * mass) ** 2 * plate.scatter(point)[0]
    return shift, np.sqrt(variance + (_FORM**2 + plate.mass_sd**2) * shift**2)


def spread_of_shifts(left: Array, shifts: Array, rounding: Array) -> tuple[tuple[float, float], float]:
    """Repeatability of a list and relative error of a shift, from lists with known masses.

    left : (l, n), measured less predicted ln f' - ln f of lists that share a first one, of variance
        2 (s^2 + rounding^2) + (k shift)^2
    shifts : (l, n) predicted; rounding : (n,) relative, of one list

    Returns the 95 % interval of s, with a log-uniform prior, and the 95 % upper limit of k, with a uniform
    prior up to one half.
    """
    s, k = np.geomspace(NOISE_PRIOR.lower, 0.05, 120), np.linspace(0.0, 0.5, 101)
    log_likelihood = np.zeros((len(s), len(k)))
    for r, shift, fixed in zip(left.ravel(), shifts.ravel(), np.tile(rounding, len(left)), strict=True):
        variance = 2.0 * (s[:, None] ** 2 + fixed**2) + (k * shift) ** 2
        log_likelihood -= 0.5 * (r**2 / variance + np.log(variance))
    weight = np.exp((log_likelihood - log_likelihood.max()) / _common(len(left)))
    of_s, of_k = (np.cumsum(weight.sum(axis)) / weight.sum() for axis in (1, 0))
    low, high = np.interp((_TAIL, 1.0 - _TAIL), of_s, s)
    return (float(low), float(high)), float(np.interp(1.0 - 2 * _TAIL, of_k, k))


def _common(n_lists: int) -> float:
    """Variance of the slope of a log likelihood of differences, over that of independent lists.

    Differences from one first list have a correlation of one half.
    """
    return 1.0 + max(n_lists - 1, 0) / 4.0


@single_blas_thread
def detection_limit(
    plate: LoadedPlate, whole: Cells, noise: float, rounding: Array, rng: np.random.Generator
) -> float | None:
    """Smallest mass, kg, that is claimed with 95 % probability; None if there is none.

    Over the places of the first grid except the fifth of them where a mass shows least, beside a clamp for
    instance; the repeatability is taken as known.
    """
    sd = np.sqrt(2.0 * (noise**2 + rounding**2))
    grid = np.geomspace(_LEAST, LARGEST, _WEIGHED) * plate.mass
    white = (_between(plate, whole, grid)[0] / sd).reshape(-1, len(sd))
    half = 0.5 * np.sum(white**2, axis=1)
    scatter = rng.standard_normal((_LISTS, len(sd)))
    shown = np.argsort(half.reshape(len(whole.half), -1)[:, -1])[int(_HIDDEN * len(whole.half)) :]
    where = rng.choice(shown, _LISTS)
    odds = np.log(CLAIMED / (1.0 - CLAIMED))

    def claimed(mass: float) -> bool:
        d = _between(plate, whole, np.array([mass]))[0][where, 0] / sd + scatter
        log_bayes = (
            logsumexp(white @ d.T - half[:, None], axis=0)
            - np.log(len(half))
            - _or_factor(d @ (1.0 / sd), np.array(np.sum(sd**-2.0)))
        )
        return bool(np.mean(log_bayes >= odds) >= 1.0 - 2 * _TAIL)

    low, high = _LEAST * plate.mass, LARGEST * plate.mass
    if not claimed(high):
        return None
    for _ in range(_STEPS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if claimed(middle) else (middle, high)
    return high
