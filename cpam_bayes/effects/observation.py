"""What is wrong with the list of frequencies, not with the plate."""

from __future__ import annotations

import numpy as np

from cpam_bayes.effects.effect import Effect, either_sign, one_sided
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
    "frequency_scale",
    "size",
    "observation",
    (either_sign("frequency_deviation", "", 0.002),),
    "an analyser whose clock is off: all frequencies by one factor; stiffer moduli would do the same",
    observe=_scaled,
    stage="frequencies",
    absorbed=True,
)
VISCOELASTIC = Effect(
    "viscoelastic",
    "damping",
    "observation",
    (one_sided("loss_tangent", "", 0.01),),
    "a damped material is stiffer at higher frequencies",
    observe=_stiffened,
    stage="frequencies",
)
MODE_IDENTITY = Effect(
    "mode_identity",
    "list",
    "observation",
    (),
    "a mode is missed, counted twice or swapped: the pairing with the model's modes changes",
    stage="pairing",
)
OUTLIER = Effect(
    "outlier",
    "list",
    "observation",
    (),
    "one frequency is misread or mistyped: its noise has a heavy tail",
    stage="noise",
)
