"""Effects on the frequencies, not on the plate: the analyser's scale, a loss tangent."""

from __future__ import annotations

import numpy as np

from cpam_bayes.effects.effect import EVEN, PERCENT, Effect, either_sign, one_sided
from cpam_bayes.mechanics.problem import Array, Values


def _scaled(frequencies: Array, values: Values) -> Array:
    """F (1 + s)."""
    return np.asarray(frequencies * (1.0 + np.asarray(values["frequency_deviation"])[..., None]))


def _stiffened(frequencies: Array, values: Values) -> Array:
    """F (f / f_1)^(tan delta / pi): d ln f = (tan delta / pi) ln(f / f_1).

    A material of constant loss tangent stiffens by 2 tan delta / pi per unit of ln f (Kramers and
    Kronig); the constants are those at the first frequency.
    """
    slope = np.asarray(values["loss_tangent"])[..., None] / np.pi
    return np.asarray(frequencies * np.exp(slope * np.log(frequencies / frequencies[..., :1])))


FREQUENCY_SCALE = Effect(
    name="frequency_scale",
    title="analyser with a wrong frequency scale",
    family="size",
    belongs_to="laboratory",
    parameters=(either_sign("frequency_deviation", "", 0.002, 0.1, gross=EVEN, shown=PERCENT),),
    note="all frequencies by one factor, after the plate; stiffer moduli would do the same",
    check="Measure the signal of a calibrated generator.",
    observe=_scaled,
    sign=1,
)
VISCOELASTIC = Effect(
    name="viscoelastic",
    title="stiffness that grows with frequency",
    family="damping",
    belongs_to="material",
    parameters=(one_sided("loss_tangent", "", 0.01, 0.3, gross=0.05),),
    note="d ln f = (tan delta / pi) ln(f / f_1), after the plate",
    check="Measure the modal damping: the loss tangent is twice the damping ratio.",
    observe=_stiffened,
    sign=1,
)
