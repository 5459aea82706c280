"""Errors in a frequency list: modes missed or counted twice, and misread frequencies."""

from __future__ import annotations

from cpam_bayes.effects.effect import PERCENT, Effect, ListChange, ListVariant, either_sign

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
    title="mode missed, counted twice or swapped",
    family="list",
    belongs_to="test",
    parameters=(),
    note="in the pairing with the model's modes",
    check="Compare the measured mode shapes with the computed ones, and label the frequencies.",
    pairings=_pairings,
)
OUTLIER = Effect(
    name="outlier",
    title="misread or mistyped frequency",
    family="list",
    belongs_to="test",
    parameters=(MISREADING,),
    note="one frequency is off, so far perhaps that it stands in another place",
    check="Read that peak again in the measured spectrum.",
    pairings=_misreadings,
)
