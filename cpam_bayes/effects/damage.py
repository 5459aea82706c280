"""A place where the plate is softer: delamination, impact, dry fibres."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import (
    PERCENT,
    Effect,
    LocalForm,
    Place,
    PlateFacts,
    anywhere,
    coordinate,
    one_sided,
    place_text,
)
from cpam_bayes.mechanics.problem import (
    LAMINATE_ENTRIES,
    LAMINATE_FORMS,
    Array,
    PlateState,
    Problem,
    Term,
    Values,
    laminate_coefficients,
)
from cpam_bayes.mechanics.weights import Bell, Box, Product
from cpam_bayes.parameters import LogUniform, Parameter

# Of the extent over the shorter side: from a spot of a few thicknesses to two thirds of the plate.
_EXTENT = LogUniform(0.03, 0.35)
# Of the stiffness lost: one standard deviation, and the most with which the plate is one piece.
_SCALE, _DEEPEST = 0.2, 0.95
# Forms of bending and of transverse shear.
_SOFTENED = np.flatnonzero(LAMINATE_ENTRIES.min(axis=0) >= 3)


def _damage_at(form: LocalForm, place: Place) -> Effect:
    """The damage of one form at (x, y) with an extent."""
    return replace(
        DAMAGE,
        change=partial(_damaged, form, place),
        parameters=DAMAGE.parameters[:1],
        place=place,
        at=None,
        local=form,
        alternatives=(),
        variant=f"{_WORDS[form]} {place_text(place[:2])}, extent {place[2]:.3g}",
    )


def _damaged(form: LocalForm, place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    """D and A_s times 1 - d g(x, y).

    g is exp(-r^2 / (2 R^2)), r the distance from the place, or 1 in the square |x|, |y| <= R about it; R is
    the extent times the shorter side. Mass and membrane stiffness stay.
    """
    x, y, extent = place
    radius = extent * min(facts.length, facts.width)
    profile = Bell if form == "bell" else Box
    weight = Product(profile(x, radius / facts.length), profile(y, radius / facts.width))
    forms = tuple(replace(LAMINATE_FORMS[q], weight=weight) for q in _SOFTENED)
    return problem.with_terms(Term("damage", "stiffness", forms, _lost))


def _lost(state: PlateState, values: Values) -> Array:
    plain = laminate_coefficients(state, values)[..., _SOFTENED]
    return np.asarray(-np.asarray(values["damage"])[..., None] * plain)


_WORDS: dict[LocalForm, str] = {"bell": "smooth", "rectangle": "with a sharp edge"}

_BELL = Effect(
    name="damage",
    title="local damage (delamination, impact, dry fibres)",
    family="damage",
    belongs_to="plate",
    parameters=(
        one_sided("damage", "", _SCALE, _DEEPEST, shown=PERCENT),
        coordinate("damage_x"),
        coordinate("damage_y"),
        Parameter("damage_extent", "", _EXTENT, _EXTENT.mean, PERCENT),
    ),
    note=(
        "D and A_s less by a bell (extent: its sd) or in a square (extent: half its side) at any (x, y), "
        "of 3 to 35 % of the shorter side; both forms are equally probable"
    ),
    check="Tap or C-scan the plate there.",
    change=anywhere,
    sign=-1,
    at=partial(_damage_at, "bell"),
    local="bell",
    variant=_WORDS["bell"],
)
DAMAGE = replace(
    _BELL,
    alternatives=(
        replace(_BELL, at=partial(_damage_at, "rectangle"), local="rectangle", variant=_WORDS["rectangle"]),
    ),
)
