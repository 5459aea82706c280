"""Plates of a few lines for the tests of the diagnosis: their evidences are known in closed form."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.hypotheses import (
    DISCREPANCY,
    NONE,
    OTHER,
    Hypothesis,
    go_together,
    set_scales,
    together,
)
from cpam_bayes.diagnosis.models import PlateModels
from cpam_bayes.effects import Effect, ListChange, PlateFacts
from cpam_bayes.effects.effect import MISREADING, PERCENT
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT, TruncatedNormal
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
    """ln f = ln F0 + A (c - 1) + g(t) with g and its derivative by ``shift``: (m,) -> (m, n) each."""

    def function(x: Array) -> tuple[Array, Array]:
        relative = (x[:, :2] - 1.0) @ A[:n].T
        slope = np.broadcast_to(A[:n], (len(x), n, 2))
        if shift is not None:
            g, dg = shift(x[:, 2])
            relative = relative + g[:, :n]
            slope = np.concatenate((slope, dg[:, :n, None]), axis=2)
        f = F0[:n] * np.exp(relative)
        return f, f[..., None] * slope

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


def hypothesis(effect: Effect, prior: float = 0.1) -> Hypothesis:
    return Hypothesis(
        effect.name, effect.family, effect.variant, (effect,), parameters=effect.parameters, prior=prior
    )


def of_one(*hypotheses: Hypothesis) -> list[tuple[Hypothesis, tuple[int, ...]]]:
    """Hypotheses about the first plate."""
    return [(h, (0,)) for h in hypotheses]


def misread(i: int, prior: float = 0.01) -> Hypothesis:
    return Hypothesis(
        "outlier",
        "list",
        f"frequency {i + 1}",
        listed=ListChange(misread=(i,)),
        parameters=(MISREADING,),
        prior=prior,
    )


def with_slip(i: int, size: float) -> Array:
    """Relative shifts by one frequency that is misread."""
    return np.where(np.arange(len(F0)) == i, size, 0.0)


NOTHING = Hypothesis(NONE, NONE, prior=0.5)
ANYTHING = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.06, correlation_length=0.0)
BENT, TWIN, DENTED, STIFF = (cause(name, whole_normal(0.02)) for name in ("bent", "twin", "dented", "stiff"))
WARP = cause("warp", ScaledStudentT(0.1, 4.0, -0.8, 0.8), is_even=True)
HEAVY = cause("heavy", ScaledStudentT(0.02, 4.0, 0.0, 0.16))
# How they shift the modes: the twin as bent does, nearly, and stiff as constants do.
SHIFTS = {
    "bent": straight(BUMP),
    "twin": straight(BUMP + 0.02 * DENT),
    "dented": straight(DENT),
    "warp": even(DENT),
    "stiff": straight(A @ [0.5, 0.5]),
    "heavy": straight(-np.abs(DENT)),
}


def measured(shift: Array | float = 0.0, noise: float = NOISE) -> Array:
    """Frequencies of constants 3 % above and 4 % below their means, shifted, with a draw of noise."""
    return np.asarray(F0 * np.exp(A @ [0.03, -0.04] + shift) * (1.0 + noise * SCATTER))


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
    facts, zeros = PlateFacts.of(of.plate, isotropic=True), np.zeros(n_modes)
    model: Any = plate_model(n_modes)
    models = PlateModels(
        of, facts, CONSTANTS, unused, unused, unused, unused, zeros, n_modes, zeros, {}, model, name
    )
    extended: dict[Any, Any] = {
        (e.name, e.variant): plate_model(n_modes, shift, e.parameters[0]) for e, shift in effects
    }
    return PlateCase(models, measurement, np.arange(measurement.size), extended)


def with_causes(f: Array, *effects: Effect, relative: float | None = NOISE, name: str = "toy") -> PlateCase:
    """A plate with a list, which may have some of the causes above."""
    return case(a_list(f, relative), [(e, SHIFTS[e.name]) for e in effects], name=name)


def log_normal_density(f: Array, mean: Array, covariance: Array) -> float:
    """Of a list whose logarithms are normal about those of ``mean``; covariance of f ln(f / mean), Hz^2."""
    away = f * np.log(f / mean)
    log_det = np.linalg.slogdet(2 * np.pi * covariance)[1]
    return float(-0.5 * away @ np.linalg.solve(covariance, away) - 0.5 * log_det)


def exact_log_evidence(f: Array, sigma: Array, *causes: tuple[Array, float]) -> float:
    """Of the toy plate with normal priors and shifts direction * t, t normal with a standard deviation."""
    n = len(f)
    slope = np.column_stack([SD * A[:n], *(sd * d[:n] for d, sd in causes)]) * f[:, None]
    return log_normal_density(f, F0[:n], slope @ slope.T + np.diag(sigma**2))


def differences(function: Callable[[Array], Array], x: Array, step: float = 1e-6) -> Array:
    """Central differences of a function (m, n) -> (m, k) at one point (n,), (k, n)."""
    h = step * np.eye(len(x))
    return np.stack(
        [(function((x + d)[None])[0] - function((x - d)[None])[0]) / (2 * step) for d in h], axis=-1
    )


def pairs_of(causes: Sequence[Hypothesis], singles: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Two at a time of some causes that can act together, with their priors among ``singles``."""
    scales = set_scales(singles)
    return tuple(together(both, scales) for both in combinations(causes, 2) if go_together(*both))
