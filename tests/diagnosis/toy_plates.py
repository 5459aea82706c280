"""Minimal plates for the tests of the diagnosis, with evidences in closed form."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.evidence.marginal import Tested
from cpam_bayes.diagnosis.evidence.scan import marginal_of
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, NONE, OTHER, Hypothesis, go_together, set_scales
from cpam_bayes.diagnosis.hypotheses import together as at_once
from cpam_bayes.diagnosis.models import PlateModels
from cpam_bayes.effects import Effect, ListChange, PlateFacts
from cpam_bayes.effects.effect import MISREADING, PERCENT
from cpam_bayes.parameters import Parameter, ParameterSet, ScaledStudentT, TruncatedNormal
from cpam_bayes.plate import Measurement
from cpam_bayes.plate.reader import builtin
from tests.toy_models import ToyModel

# Frequencies at the prior means, Hz, and relative shifts per relative change of a constant.
F0 = np.array([100.0, 180.0, 240.0, 310.0, 420.0, 500.0, 640.0, 700.0])
A = np.array([[0.5, 0.0, 0.4, 0.1, 0.25, 0.45, 0.3, 0.2], [0.0, 0.5, 0.1, 0.4, 0.25, 0.05, 0.2, 0.3]]).T
_FAR = 8.0  # truncation so far out that the normal prior is complete to 1e-15
SD = 0.05  # two constants near 1, known to 5 %
# Relative noise of a list, and one draw of it in units of its sd.
NOISE = 0.002
SCATTER = np.array([1.0, -0.5, 0.3, 1.2, -1.0, 0.2, 0.9, -1.4])
_KNOWN = TruncatedNormal(1.0, SD, 1.0 - _FAR * SD, 1.0 + _FAR * SD)
CONSTANTS = ParameterSet((Parameter("E1", "", _KNOWN), Parameter("G12", "", _KNOWN)))
# Shifts by two causes, by mode, that the constants cannot imitate.
BUMP = np.array([0.0, 1.0, 0.0, -1.0, 0.5, 0.0, -0.5, 1.0])
DENT = np.array([1.0, 0.0, -1.0, 0.5, 0.0, 1.0, 0.0, -0.5])


def whole_normal(sd):
    return TruncatedNormal(0.0, sd, -_FAR * sd, _FAR * sd)


def plate_model(shift=None, parameter=None):
    """Model ln f = ln F0 + A (c - 1) + g(t); ``shift`` gives g and its derivative, (m,) -> (m, n) each."""

    def function(x):
        g, dg = (0.0, None) if shift is None else shift(x[:, 2])
        f = F0 * np.exp((x[:, :2] - 1.0) @ A.T + g)
        slope = np.broadcast_to(A, (len(x), *A.shape))
        return f, f[..., None] * (slope if dg is None else np.concatenate((slope, dg[..., None]), axis=2))

    return ToyModel(CONSTANTS if parameter is None else CONSTANTS.union(ParameterSet((parameter,))), function)


def straight(direction):
    return lambda t: (t[:, None] * direction, np.broadcast_to(direction, (len(t), len(direction))))


def even(direction):
    return lambda t: (t[:, None] ** 2 * direction, 2.0 * t[:, None] * direction)


def cause(name, prior, *, is_even=False, excludes=()):
    size = Parameter(f"size of {name}", "", prior, null=0.0, shown=PERCENT)
    said = {"title": f"a plate that is {name}", "note": "a toy", "check": "Look at it."}
    acts = {"change": lambda problem, facts: problem, "even": is_even, "excludes": excludes}
    return Effect(name=name, family=name, belongs_to="plate", parameters=(size,), **said, **acts)


def hypothesis(e, prior=0.1):
    return Hypothesis(e.name, e.family, e.variant, (e,), parameters=e.parameters, prior=prior)


def of_one(*hypotheses):
    return [(h, (0,)) for h in hypotheses]


def with_evidence(own, of, probability=0.0):
    return Tested(of, (0,), marginal_of([own], of, (0,)), probability)


def misread(i, prior=0.01):
    change, text = ListChange(misread=(i,)), f"frequency {i + 1}"
    return Hypothesis("outlier", "list", text, listed=change, parameters=(MISREADING,), prior=prior)


def with_slip(i, size):
    return np.where(np.arange(len(F0)) == i, size, 0.0)


NOTHING = Hypothesis(NONE, NONE, prior=0.5)
ANYTHING = Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.06, correlation_length=0.0)
BENT, TWIN, DENTED, STIFF = (cause(name, whole_normal(0.02)) for name in ("bent", "twin", "dented", "stiff"))
WARP = cause("warp", ScaledStudentT(0.1, 4.0, -0.8, 0.8), is_even=True)
HEAVY = cause("heavy", ScaledStudentT(0.02, 4.0, 0.0, 0.16))
# Shifts by the causes: "twin" is nearly "bent", and "stiff" is in the span of the constants.
SHIFTS = {"bent": straight(BUMP), "twin": straight(BUMP + 0.02 * DENT), "dented": straight(DENT)}
SHIFTS |= {"warp": even(DENT), "stiff": straight(A @ [0.5, 0.5]), "heavy": straight(-np.abs(DENT))}


def measured(shift=0.0, noise=NOISE):
    """Frequencies for constants 3 % above and 4 % below their means, shifted, with a draw of noise."""
    return np.asarray(F0 * np.exp(A @ [0.03, -0.04] + shift) * (1.0 + noise * SCATTER))


def a_list(f, relative, resolution=0.0):
    return Measurement(np.asarray(f, float), resolution, relative, None, ("",) * len(f), complete=True)


def case(measurement, effects=(), *, name="toy", specimen=""):
    """A plate with its list, and models of its possible effects."""
    named = {"name": name, "specimen": specimen or name}
    of = replace(builtin("A1"), **named, unknowns=CONSTANTS, measurement=measurement)
    facts, zeros, unused = PlateFacts.of(of.plate, isotropic=True), np.zeros(len(F0)), (None,) * 4
    models = PlateModels(of, facts, CONSTANTS, *unused, zeros, len(F0), zeros, {}, plate_model(), name)
    extended = {(e.name, e.variant): plate_model(shift, e.parameters[0]) for e, shift in effects}
    return PlateCase(models, measurement, np.arange(measurement.size), extended)


def with_causes(f, *effects, relative=NOISE, name="toy"):
    return case(a_list(f, relative), [(e, SHIFTS[e.name]) for e in effects], name=name)


def log_normal_density(f, mean, covariance):
    """Log density of a list with logarithms normal about ln(mean); covariance of f ln(f / mean), Hz^2."""
    away, log_det = f * np.log(f / mean), np.linalg.slogdet(2 * np.pi * covariance)[1]
    return float(-0.5 * away @ np.linalg.solve(covariance, away) - 0.5 * log_det)


def exact_log_evidence(f, sigma, *causes, modes=None):
    """Log evidence of the toy plate, priors and sizes of causes normal; modes : by default the first."""
    at = np.arange(len(f)) if modes is None else modes
    slope = np.column_stack([SD * A[at], *(sd * d[at] for d, sd in causes)]) * f[:, None]
    return log_normal_density(f, F0[at], slope @ slope.T + np.diag(sigma**2))


def differences(function, x, step=1e-06):
    """Central differences, (k, n), of a function (m, n) -> (m, k) at one point (n,)."""
    h = step * np.eye(len(x))
    return (function(x + h) - function(x - h)).T / (2 * step)


def pairs_of(causes, singles):
    """Pairs of causes that can act together, with priors from those of ``singles``."""
    scales = set_scales(singles)
    return tuple(at_once(both, scales) for both in combinations(causes, 2) if go_together(*both))
