"""Shifts of the frequencies along the size of a cause, at each of its places, for the linear oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri
from scipy.stats import qmc

from cpam_bayes.diagnosis.evidence.marginal import Marginal
from cpam_bayes.diagnosis.evidence.optima import SIZE_RANGE
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, PAIR
from cpam_bayes.parameters import LogUniform, Uniform

Array = NDArray[Any]

# Scores of the size at which shifts at a place are computed.
_SCORES = np.linspace(-SIZE_RANGE, SIZE_RANGE, 19)
# Scores of a line, between those at which shifts are known, and places at which a cause is taken, log2.
_FINE = 289
_LOG2_PLACES = 4
# Scores by which a second size differs from the first, and weights of a standard normal there.
_OFFSETS = np.array([-1.5, -0.5, 0.0, 0.5, 1.5])


@dataclass(frozen=True, slots=True)
class ShiftLine:
    """What a cause at one place does to the log frequencies at the plain model's optimum.

    log_prior : of the cause and the place
    score : (k,) normal scores of the size
    size : (k,) its distance from the value that gives back the plain model, SI
    shift : (k, n_f)
    """

    cause: str
    log_prior: float
    score: Array
    size: Array
    shift: Array


def shift_lines(tested: Sequence[Tested], none: Marginal) -> tuple[ShiftLine, ...]:
    """Lines of all single hypotheses whose frequencies keep their modes."""
    lines: list[ShiftLine] = []
    for t in tested:
        h = t.hypothesis
        if h.family == PAIR or h.cause in (NONE, OTHER) or not h.parameters or t.shift is None:
            continue
        one = len(h.parameters) == 1
        lines += _line(t, t.shift.scores[:, 0], t.shift.shift) if one else _at_places(t, none)
    return tuple(lines)


def _line(t: Tested, score: Array, shift: Array, log_prior: float = 0.0) -> list[ShiftLine]:
    """A line through the shifts at some scores, smooth in the size itself."""
    prior = t.hypothesis.parameters[0].prior
    x = prior.from_normal(score)
    new = np.diff(x, prepend=-np.inf) > 0.0
    if new.sum() < 2:
        return []
    score, x, shift = score[new], x[new], shift[new]
    fine = np.linspace(score[0], score[-1], _FINE)
    at = np.clip(prior.from_normal(fine), x[0], x[-1])
    log_prior += float(np.log(t.hypothesis.prior))
    curve = PchipInterpolator(x, shift, axis=0)(at)
    return [ShiftLine(t.hypothesis.cause, log_prior, fine, at - _null(t), np.asarray(curve))]


def _null(t: Tested) -> float:
    null = t.hypothesis.parameters[0].null
    return 0.0 if null is None else null


def _at_places(t: Tested, none: Marginal) -> list[ShiftLine]:
    """A line at each of some places or, of two sizes at once, at each of some ratios of them."""
    comparison, parameters = t.marginal.comparison, t.hypothesis.parameters
    further = parameters[1:]
    places = [k for k, p in enumerate(further) if isinstance(p.prior, Uniform | LogUniform)]
    sizes = [k for k in range(len(further)) if k not in places]
    n = 2**_LOG2_PLACES if places else 1
    where = np.zeros((n, len(further)))
    if places:
        where[:, places] = ndtri(qmc.Sobol(len(places), seed=0).random_base2(_LOG2_PLACES))
    offsets = _OFFSETS if sizes else np.zeros(1)
    log_fraction = -0.5 * offsets**2
    log_fraction -= np.log(np.exp(log_fraction).sum())
    plain = comparison.carried(none.comparison, none.best)
    lines: list[ShiftLine] = []
    for place in where:
        for offset, fraction in zip(offsets, log_fraction, strict=True):
            z = np.tile(place, (len(_SCORES), 1))
            z[:, sizes] = _SCORES[:, None] + offset
            x = np.tile(plain, (len(_SCORES), 1))
            x[:, t.columns[0]] = parameters[0].prior.from_normal(_SCORES)
            for k, (p, column) in enumerate(zip(further, t.columns[1:], strict=True)):
                x[:, column] = p.prior.from_normal(z[:, k])
            bare = x[:1].copy()
            for p, column in zip(parameters, t.columns, strict=True):
                if not isinstance(p.prior, Uniform | LogUniform):
                    bare[:, column] = 0.0 if p.null is None else p.null
            inside, f, _ = comparison.predict_inside(np.vstack((bare, x)))
            if len(inside) < 2 or inside[0] != 0:
                continue
            with np.errstate(invalid="ignore", divide="ignore"):
                shift = np.log(f[1:]) - np.log(f[0])
            known = np.isfinite(shift).all(axis=1)
            score = _SCORES[inside[1:] - 1]
            lines += _line(t, score[known], shift[known], float(fraction) - float(np.log(n)))
    return lines
