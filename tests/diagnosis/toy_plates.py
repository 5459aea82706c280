"""Plates of a few lines for the tests of the diagnosis: their evidences are known in closed form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.hypotheses import Hypothesis, go_together, pair_scale, paired
from cpam_bayes.diagnosis.models import PlateModels
from cpam_bayes.effects import Effect, PlateFacts
from cpam_bayes.effects.effect import PERCENT
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.parameters import Parameter, ParameterSet, TruncatedNormal
from cpam_bayes.plate import Measurement
from cpam_bayes.plate.reader import builtin
from cpam_bayes.priors import Prior
from tests.toy_models import ToyModel

Array = NDArray[Any]

# Frequencies at the prior means, Hz, and relative shifts by a constant's relative deviation.
F0 = np.array([100.0, 180.0, 240.0, 310.0, 420.0, 500.0, 640.0, 700.0])
A = np.array(
    [[0.5, 0.0], [0.0, 0.5], [0.4, 0.1], [0.1, 0.4], [0.25, 0.25], [0.45, 0.05], [0.3, 0.2], [0.2, 0.3]]
)
# A cut so far out that the normal prior is whole to 1e-15.
_FAR = 8.0
# Two constants near 1, known to 5 %.
SD = 0.05
# Relative noise of a list, and one draw of it in its units.
NOISE = 0.002
SCATTER = np.array([1.0, -0.5, 0.3, 1.2, -1.0, 0.2, 0.9, -1.4])
CONSTANTS = ParameterSet(
    tuple(
        Parameter(name, "", TruncatedNormal(1.0, SD, 1.0 - _FAR * SD, 1.0 + _FAR * SD))
        for name in ("E1", "G12")
    )
)
# Shifts of two causes, by mode, that the constants cannot imitate.
BUMP = np.array([0.0, 1.0, 0.0, -1.0, 0.5, 0.0, -0.5, 1.0])
DENT = np.array([1.0, 0.0, -1.0, 0.5, 0.0, 1.0, 0.0, -0.5])


def whole_normal(sd: float, mean: float = 0.0) -> TruncatedNormal:
    """A normal prior whose cuts do not matter."""
    return TruncatedNormal(mean, sd, mean - _FAR * sd, mean + _FAR * sd)


def plate_model(
    n: int = len(F0),
    shift: Callable[[Array], tuple[Array, Array]] | None = None,
    parameter: Parameter | None = None,
    constants: ParameterSet = CONSTANTS,
) -> ToyModel:
    """f = F0 (1 + A (c - 1) + g(t)) with g and its derivative by ``shift``: (m,) -> (m, n) each."""

    def function(x: Array) -> tuple[Array, Array]:
        relative = 1.0 + (x[:, :2] - 1.0) @ A[:n].T
        slope = np.broadcast_to(A[:n], (len(x), n, 2))
        if shift is not None:
            g, dg = shift(x[:, 2])
            relative = relative + g[:, :n]
            slope = np.concatenate((slope, dg[:, :n, None]), axis=2)
        return F0[:n] * relative, F0[:n, None] * slope

    own = constants if parameter is None else constants.union(ParameterSet((parameter,)))
    return ToyModel(own, function)


def straight(direction: Array) -> Callable[[Array], tuple[Array, Array]]:
    """Relative shifts direction * t."""
    return lambda t: (t[:, None] * direction, np.broadcast_to(direction, (len(t), len(direction))))


def even(direction: Array) -> Callable[[Array], tuple[Array, Array]]:
    """Relative shifts direction * t^2."""
    return lambda t: (t[:, None] ** 2 * direction, 2.0 * t[:, None] * direction)


def cause(name: str, prior: Prior, *, is_even: bool = False, excludes: tuple[str, ...] = ()) -> Effect:
    """An effect of one parameter."""
    return Effect(
        name=name,
        title=f"a plate that is {name}",
        family=name,
        belongs_to="plate",
        parameters=(Parameter(f"size of {name}", "", prior, null=0.0, shown=PERCENT),),
        note="a toy",
        check="Look at it.",
        change=lambda problem, facts: problem,
        even=is_even,
        excludes=excludes,
    )


def hypothesis(effect: Effect, prior: float) -> Hypothesis:
    return Hypothesis(
        effect.name, effect.family, effect.variant, (effect,), parameters=effect.parameters, prior=prior
    )


def a_list(f: Array, relative: float | None, resolution: float = 0.0) -> Measurement:
    return Measurement(np.asarray(f, float), resolution, relative, None, ("",) * len(f), complete=True)


def case(
    measurement: Measurement,
    effects: Sequence[tuple[Effect, Callable[[Array], tuple[Array, Array]]]] = (),
    *,
    name: str = "toy",
    specimen: str = "",
    n_modes: int = len(F0),
) -> PlateCase:
    """A plate with its list, and the models of what it may have."""
    of = replace(
        builtin("A1"), name=name, specimen=specimen or name, unknowns=CONSTANTS, measurement=measurement
    )
    unused: Any = None
    models = PlateModels(
        of,
        PlateFacts.of(of.plate, isotropic=True),
        CONSTANTS,
        unused,
        unused,
        unused,
        unused,
        np.zeros(n_modes),
        n_modes,
        np.zeros(n_modes),
        plate_model(n_modes),  # type: ignore[arg-type]
        name,
    )
    extended: dict[Any, Any] = {
        (e.name, e.variant): plate_model(n_modes, shift, e.parameters[0]) for e, shift in effects
    }
    return PlateCase(models, measurement, np.arange(measurement.size), extended)


def log_normal_density(x: Array, mean: Array, covariance: Array) -> float:
    away = x - mean
    return float(
        -0.5 * away @ np.linalg.solve(covariance, away) - 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    )


def exact_log_evidence(
    f: Array, sigma: Array, *causes: tuple[Array, float], mean: Array | None = None
) -> float:
    """Of the linear plate with normal priors and shifts direction * t, t normal with a standard deviation."""
    n = len(f)
    slope = np.column_stack([SD * A[:n], *(sd * d[:n] for d, sd in causes)]) * F0[:n, None]
    centre = F0[:n] if mean is None else mean
    return log_normal_density(f, centre, slope @ slope.T + np.diag(sigma**2))


def differences(function: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Central differences of a function (m, n) -> (m, k) at one point (n,), (k, n)."""
    h = step * np.eye(len(x))
    return np.stack(
        [(function((x + d)[None])[0] - function((x - d)[None])[0]) / (2 * step) for d in h], axis=-1
    )


def at_prior_means(comparison: LogDensity) -> Array:
    return np.array([p.prior.mean for p in comparison.parameters.parameters])


def pairs_of(causes: Sequence[Hypothesis], singles: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Two at a time of some causes that can act together, with their priors among ``singles``."""
    scale = pair_scale(singles)
    return tuple(paired(a, b, scale) for a, b in combinations(causes, 2) if go_together(a, b))
