"""Effects on a frequency list instead of the plate: missed modes, misread values, scale, loss tangent."""

from __future__ import annotations

import numpy as np

from cpam_bayes.effects.effect import EVEN, PERCENT, Effect, ListChange, ListVariant, either_sign, one_sided
from cpam_bayes.mechanics.problem import Array, Values

# Relative error of a misread frequency.
MISREADING = either_sign("misreading", "", 0.05, end=0.6, shown=PERCENT)
# Fractions of the prior: two modes missed, of the errors of pairing; a frequency in another's place.
_TWO_MISSED, _MOVED = 0.1, 0.1


def _pairings(n: int, complete: bool) -> tuple[ListVariant, ...]:
    """One mode missed, one false peak, two modes missed; an incomplete list misses modes in any case."""
    if not complete:
        return ()
    once = [(ListChange(missed=(k,)), f"mode {k + 1} missed") for k in range(n)]
    once += [(ListChange(spurious=i), f"frequency {i + 1} false") for i in range(n)]
    twice = [
        (ListChange(missed=(j, k)), f"modes {j + 1} and {k + 1} missed")
        for j in range(n + 1)
        for k in range(j + 1, n + 1)
    ]
    single = (ListVariant(*entry, (1.0 - _TWO_MISSED) / len(once)) for entry in once)
    return (*single, *(ListVariant(*entry, _TWO_MISSED / len(twice)) for entry in twice))


def _misreadings(n: int, complete: bool) -> tuple[ListVariant, ...]:
    """One frequency that is misread and keeps its place, or that a transcription error moves to another.

    A list is sorted: a frequency that is typed far off stands where another mode would, and says nothing.
    """
    moved = [
        (ListChange(missed=(k,), spurious=i), f"gross, frequency {i + 1} is mode {k + 1}")
        for k in range(n)
        for i in range(n)
        if i != k and complete
    ]
    gross = _MOVED if moved else 0.0
    in_place = [ListVariant(ListChange(misread=i), f"frequency {i + 1}", (1.0 - gross) / n) for i in range(n)]
    return (*in_place, *(ListVariant(*entry, gross / len(moved)) for entry in moved))


MODE_IDENTITY = Effect(
    name="mode_identity",
    title="missed, extra or swapped mode",
    family="list",
    belongs_to="test",
    parameters=(),
    note="in the pairing with the model's modes",
    check="Compare the measured mode shapes with the computed ones, and label the frequencies.",
    pairings=_pairings,
)
OUTLIER = Effect(
    name="outlier",
    title="misread frequency",
    family="list",
    belongs_to="test",
    parameters=(MISREADING,),
    note="one frequency is off, so far perhaps that it stands in another place",
    check="Read that peak again in the measured spectrum.",
    pairings=_misreadings,
)


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
    title="wrong frequency scale",
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
    title="frequency-dependent stiffness",
    family="damping",
    belongs_to="material",
    parameters=(one_sided("loss_tangent", "", 0.01, 0.3, gross=0.05),),
    note="d ln f = (tan delta / pi) ln(f / f_1), after the plate",
    check="Measure the modal damping: the loss tangent is twice the damping ratio.",
    observe=_stiffened,
    sign=1,
)
