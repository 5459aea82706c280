"""The smallest converged Ritz space for a plate, and its remaining error.

A rich space is solved at a few parameter sets. A small one grows where growth pays most until its
frequencies agree with the rich one's, then loses the trial functions that no mode uses. The error
of the small space is measured against the rich one, the error of the rich one against itself
without its highest polynomials.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.mechanics.affine import DenseOperator, restricted
from cpam_bayes.mechanics.dense import discretise, discretise_at
from cpam_bayes.mechanics.modes import RigidBodyError, Spectrum, lowest_frequencies, solve
from cpam_bayes.mechanics.problem import Problem, Values
from cpam_bayes.mechanics.ritz import RitzSettings, RitzSpace, ritz_space
from cpam_bayes.plate.edges import conditions

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Largest relative error allowed of any frequency at the sampled parameter sets.

    kept : of the small space against the rich one.
    rich : of the rich one against itself, with at most ``largest_degree`` polynomials in a direction.
    """

    kept: float
    rich: float
    largest_degree: int = 18


THIN = Tolerance(kept=7e-5, rich=4e-5)
THICK = Tolerance(kept=2e-4, rich=1e-4)
# Thickness over the shorter side from which a plate counts as thick.
_THICK_RATIO = 1 / 40
# Longer side over thickness beyond which double precision is not enough.
_THINNEST = 700.0
# Edge exponentials, from few to many: (exponentials at each edge, whether all bending fields have them).
_UNCOUPLED_LAYERS = ((1, False), (2, False), (3, False))
_COUPLED_LAYERS = ((1, False), (1, True), (2, True), (3, True))
# Fractions of a mode's energy below which trial functions are left out.
_THRESHOLDS = 10.0 ** np.arange(-7.0, -4.0, 0.25)
_MAX_LAYERS = 3
_MAX_CORNER_LAYERS = 3
# Stands for the error of a space in which rounding hides the rigid-body motions of a very thin plate.
_UNUSABLE = 1e9


def default_tolerance(problem: Problem) -> Tolerance:
    """0.01 % in all for a thin plate, 0.03 % for a thick one."""
    nominal = problem.nominal
    thick = nominal.thickness > _THICK_RATIO * min(nominal.length, nominal.width)
    return THICK if thick else THIN


@dataclass(frozen=True, slots=True)
class ConvergedOperator:
    """An operator on a converged space and the relative error of its frequencies.

    error : (n_modes,) estimated relative error, the largest over the sampled parameter sets.
    settings : the basis before trimming.
    keep : the trial functions kept, bool.
    """

    operator: DenseOperator
    error: Array
    settings: RitzSettings
    keep: Array


def converge(
    problem: Problem,
    samples: Values,
    n_modes: int,
    tolerance: Tolerance | None = None,
    allowance: Array | None = None,
) -> ConvergedOperator:
    """The problem on the smallest Ritz space found whose frequencies are converged at all samples.

    samples : parameter values, each (n_samples,), that cover the range of use.
    tolerance : by default that of ``default_tolerance``.
    allowance : (n_samples,) factors by which the error may exceed the tolerance at each sample, by default
    ones; the error returned is that of the samples with the smallest factor. It exceeds the tolerance where
    even the largest space does not meet it. Raises ``ValueError`` where there are too few trial functions
    for the modes.
    """
    tolerance = tolerance or default_tolerance(problem)
    n_samples = _count(samples)
    allowed = (np.ones(n_samples) if allowance is None else allowance)[:, None]
    rich, rich_error, rich_settings = _rich(problem, samples, n_modes, tolerance, allowed)
    settings = _grow(problem, samples, rich, rich_settings, tolerance, allowed)
    space = ritz_space(problem.edges, problem.nominal, settings)
    sampled = discretise_at(problem, space, samples)
    eye = np.eye(len(rich))
    sampled_modes = solve(sampled, eye, eye, _more_modes(n_modes), vectors=True)
    importance, rigid = _importance(sampled, sampled_modes, n_modes), _rigid_functions(space, problem)
    keep, error = (
        np.ones(len(importance), dtype=bool),
        sampled_modes.frequencies[:, :n_modes] / rich - 1.0,
    )
    # a smaller space has a larger error: the highest threshold allowed is found by bisection
    low, high = -1, len(_THRESHOLDS)
    while high - low > 1:
        middle = (low + high) // 2
        candidate = (importance > _THRESHOLDS[middle]) | rigid
        try:
            its_error = solve(restricted(sampled, candidate), eye, eye, n_modes).frequencies / rich - 1.0
        except RigidBodyError:  # of a very thin plate, by rounding
            high = middle
            continue
        if np.max(its_error / allowed) > tolerance.kept:
            high = middle
        else:
            low, keep, error = middle, candidate, its_error
    return ConvergedOperator(
        operator=discretise(problem, space.restricted(keep), samples),
        error=np.maximum(_strictest(error, allowed), 0.0) + _strictest(rich_error, allowed),
        settings=settings,
        keep=keep,
    )


@dataclass(frozen=True, slots=True)
class RichFrequencies:
    """Frequencies of a rich space and their relative errors, (n_samples, n_modes) Hz and 1."""

    frequencies: Array
    error: Array


def rich_frequencies(
    problem: Problem, samples: Values, n_modes: int, tolerance: Tolerance | None = None
) -> RichFrequencies:
    """The frequencies with which ``converge`` compares, at parameter samples (n_samples,)."""
    allowed = np.ones((_count(samples), 1))
    frequencies, error, _ = _rich(problem, samples, n_modes, tolerance or default_tolerance(problem), allowed)
    return RichFrequencies(frequencies, error)


def _sampled_frequencies(
    problem: Problem, samples: Values, settings: RitzSettings, n_modes: int, near: Array | None = None
) -> Array:
    operator = discretise_at(problem, ritz_space(problem.edges, problem.nominal, settings), samples)
    if near is not None:
        return lowest_frequencies(operator, near, n_modes)[0]
    eye = np.eye(_count(samples))
    return solve(operator, eye, eye, n_modes).frequencies


def _some(samples: Values, which: Array) -> dict[str, Array]:
    return {name: np.atleast_1d(values)[which] for name, values in samples.items()}


def _strictest(error: Array, allowed: Array) -> Array:
    """Largest error (n_samples, n_modes) of the samples with the least allowance, (n_modes,)."""
    return np.asarray(error[allowed[:, 0] == allowed.min()].max(axis=0))


def _count(samples: Values) -> int:
    return int(np.broadcast_shapes(*(np.shape(v) for v in samples.values()), (1,))[0])


def _grow(
    problem: Problem,
    samples: Values,
    reference: Array,
    rich: RitzSettings,
    tolerance: Tolerance,
    allowed: Array,
) -> RitzSettings:
    """Smallest basis found whose error against ``reference`` (n_samples, n_modes) is within tolerance.

    Each step adds two polynomials in x, or two in y, or exponentials, whichever reduces the error of
    the hardest sample most per trial function added.
    """
    n_modes = reference.shape[1]
    start = 7 + int(np.sqrt(n_modes) / 2)
    ladder = _COUPLED_LAYERS if rich.coupled else _UNCOUPLED_LAYERS
    current, level = RitzSettings(start, start, *ladder[0]), 0

    def error(settings: RitzSettings, which: Array) -> Array:
        try:
            frequencies = _sampled_frequencies(problem, _some(samples, which), settings, n_modes)
        except RigidBodyError:
            return np.full(len(which), _UNUSABLE)
        return np.asarray(np.max(frequencies / reference[which] - 1.0, axis=1) / allowed[which, 0])

    everywhere = np.arange(len(reference))
    errors = error(current, everywhere)
    hardest, now = everywhere[[np.argmax(errors)]], float(errors.max())
    while True:
        if now <= tolerance.kept:  # where it was hardest: another sample may be so now
            errors = error(current, everywhere)
            hardest, now = everywhere[[np.argmax(errors)]], float(errors.max())
            if now <= tolerance.kept:
                return current
        choices = []
        if current.degree_x < rich.degree_x:
            choices.append((replace(current, degree_x=current.degree_x + 2), level))
        if current.degree_y < rich.degree_y:
            choices.append((replace(current, degree_y=current.degree_y + 2), level))
        if level + 1 < len(ladder) and ladder[level + 1][0] <= rich.layers:
            layers, coupled = ladder[level + 1]
            choices.append((replace(current, layers=layers, coupled=coupled), level + 1))
        if current.corner_layers < rich.corner_layers:
            more_corner = replace(current, corner_layers=current.corner_layers + 1)
            choices.append((more_corner, level))
        if not choices:
            return rich
        scored = []
        for settings, its_level in choices:
            its_error = max(float(error(settings, hardest)[0]), 1e-9)
            cost = np.log(_basis_size(settings) / _basis_size(current))
            scored.append((np.log(now / its_error) / cost, its_error, settings, its_level))
        _, now, current, level = max(scored, key=lambda s: s[0])


def _basis_size(settings: RitzSettings) -> int:
    """Number of trial functions of a free plate, to compare costs."""
    nx, ny = settings.degree_x, settings.degree_y
    more, corner = 2 * settings.layers, 2 * settings.corner_layers
    in_plane = 2 * (nx + corner) * (ny + corner)
    if settings.coupled:
        return in_plane + 3 * (nx + more) * (ny + more)
    return in_plane + nx * ny + (nx + more) * ny + nx * (ny + more)


def _rich(
    problem: Problem, samples: Values, n_modes: int, tolerance: Tolerance, allowed: Array
) -> tuple[Array, Array, RitzSettings]:
    """Frequencies of a rich space at the samples, their relative errors (n_samples, n_modes), its settings.

    The error is the sum of those of one polynomial fewer in x, one fewer in y and one exponential
    fewer; the space grows where that is too much, with coupled fields first for one sample alone.
    """
    _refuse_too_thin(problem)
    stiffness = np.abs(problem.state(samples).stiffness()).reshape(-1, 8, 8).max(axis=0)
    orthotropic = np.max(stiffness[[0, 3, 1, 4], [2, 5, 2, 5]]) <= 1e-9 * stiffness[3, 3]
    clamped = any(edge.is_clamp for edge in conditions(problem.edges))
    degree = 10 + int(np.sqrt(n_modes))
    settings = RitzSettings(degree, degree, 2, clamped or not orthotropic, 2 if clamped else 0)
    n_samples = _count(samples)
    # where stretching and bending are coupled a solve costs more than an assembly
    one = settings.coupled and n_samples > 1
    which = np.arange(1 if one else n_samples)
    rough = RitzSettings(7, 7, 1, settings.coupled, min(settings.corner_layers, 1))
    near = _first_eigenvalues(problem, samples, rough)
    while True:
        some = _some(samples, which)
        space = ritz_space(problem.edges, problem.nominal, settings)
        masks = [_without_highest(space, axis) for axis in (0, 1)]
        operator = discretise_at(problem, space, some)
        frequencies, *less = lowest_frequencies(operator, near[which], n_modes, masks)
        fewer = replace(
            settings,
            layers=settings.layers - 1,
            corner_layers=max(settings.corner_layers - 1, 0),
        )
        less.append(_sampled_frequencies(problem, some, fewer, n_modes, near[which]))
        error = [np.maximum(f / frequencies - 1.0, 0.0) for f in less]
        wanting = [bool(np.max(e / allowed[which]) > tolerance.rich) for e in error]
        grown = _grown(settings, wanting, tolerance)
        if grown != settings:
            settings = grown
        elif one:
            one, which = False, np.arange(n_samples)
        else:
            return frequencies, np.sum(error, axis=0), settings


def _first_eigenvalues(problem: Problem, samples: Values, settings: RitzSettings) -> Array:
    """Rough lowest eigenvalue of a deformation mode at each sample, (n_samples,)."""
    return np.asarray((2 * np.pi * _sampled_frequencies(problem, samples, settings, 1)[:, 0]) ** 2)


def _refuse_too_thin(problem: Problem) -> None:
    """Refuse a plate whose bending stiffness is lost in the rounding of its shear stiffness.

    The eigenvalues of K span (a / h)^4. At 1/500 frequencies still agree to 1e-6 with a solution
    that eliminates the rotations first; at 1/1000 they are wrong in the third digit.
    """
    nominal = problem.nominal
    ratio = float(np.real(max(nominal.length, nominal.width) / nominal.thickness))
    if ratio > _THINNEST:
        raise RigidBodyError(
            f"the thickness is 1/{ratio:.0f} of the longer side; from 1/{_THINNEST:.0f} on this solver "
            "cannot tell bending from rounding"
        )


def _grown(settings: RitzSettings, wanting: list[bool], tolerance: Tolerance) -> RitzSettings:
    """Settings with more polynomials in x or y, or exponentials, where wanting; or the same."""
    degree_x, degree_y = (
        min(n + 3, max(tolerance.largest_degree, n)) if more else n
        for n, more in zip((settings.degree_x, settings.degree_y), wanting[:2], strict=True)
    )
    layers, corner_layers = settings.layers, settings.corner_layers
    if wanting[2]:
        layers = min(layers + 1, _MAX_LAYERS)
        corner_layers = min(corner_layers + 1, _MAX_CORNER_LAYERS) if corner_layers else 0
    return replace(
        settings,
        degree_x=degree_x,
        degree_y=degree_y,
        layers=layers,
        corner_layers=corner_layers,
    )


def _without_highest(space: RitzSpace, axis: int) -> Array:
    """Mask of the trial functions without the highest polynomial of their family."""
    return np.concatenate([s.pairs[:, axis] < (s.x, s.y)[axis].size - 1 for s in space.sectors])


def _more_modes(n_modes: int) -> int:
    """Number of modes to solve, so as to see in-plane ones that other constants bring into range."""
    return 2 * n_modes + 4


def _importance(operator: DenseOperator, spectrum: Spectrum, n_modes: int) -> Array:
    """Largest fraction of a mode's energy that a trial function carries, (n_functions,).

    c_i^2 (K_ii - lambda M_ii) / lambda: to first order the increase of lambda if function i is left out.
    Modes beyond the first n_modes count where they are purely in-plane: these move past the bending
    modes when the constants change.
    """
    fraction = np.zeros(sum(b.size for b in operator.blocks))
    n_in_plane = operator.space.dimension("u") + operator.space.dimension("v")
    assert spectrum.vectors is not None
    for b, block in enumerate(operator.blocks):
        k, m = block.diagonals()
        in_plane = block.index.max() < n_in_plane
        for i, n in zip(*np.nonzero(spectrum.block == b), strict=True):
            if n >= n_modes and not in_plane:
                continue
            c = spectrum.vectors[b][i, :, spectrum.column[i, n]]
            lam = spectrum.eigenvalues[i, n]
            energy = c * c * np.abs(k[i] - lam * m[i]) / lam
            fraction[block.index] = np.maximum(fraction[block.index], energy)
    return fraction


def _rigid_functions(space: RitzSpace, problem: Problem) -> Array:
    """Mask of the trial functions of which rigid-body motions are made."""
    motions = {"u": ((0, 0), (0, 1)), "v": ((0, 0), (1, 0)), "w": ((0, 0), (1, 0), (0, 1))}
    (x, wx), (y, wy) = space.x_grid, space.y_grid
    masks = []
    for s in space.sectors:
        fx, fy = s.x.evaluate(x, False), s.y.evaluate(y, False)
        content = np.zeros((s.x.size, s.y.size))
        further = tuple(powers for field, powers in problem.rigid_content if field == s.field)
        for i, j in motions.get(s.field, ((0, 0),)) + further:
            content = np.maximum(content, np.abs(np.outer(fx.T @ (wx * x**i), fy.T @ (wy * y**j))))
        masks.append(content[s.pairs[:, 0], s.pairs[:, 1]] > 1e-9)
    return np.concatenate(masks)
