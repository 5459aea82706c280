"""A place where the plate is softer: delamination, impact, dry fibres."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import PERCENT, Effect, Place, PlateFacts, one_sided
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
from cpam_bayes.mechanics.weights import Bell, Product

# Standard deviation of the bell in units of the shorter side.
_RADIUS = 0.05
_GRID = (0.1, 0.3, 0.5, 0.7, 0.9)
# Forms of bending and of transverse shear.
_SOFTENED = np.flatnonzero(LAMINATE_ENTRIES.min(axis=0) >= 3)


def _damage_at(place: Place) -> Effect:
    at = f"at ({place[0]:g}, {place[1]:g})"
    return replace(
        DAMAGE, change=partial(_damaged, place), parameters=DAMAGE.parameters[:1], place=place, variant=at
    )


def _damaged(place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    """D and A_s times 1 - d exp(-r^2 / (2 R^2)), r the distance from the place.

    R is a twentieth of the shorter side; mass and membrane stiffness stay.
    """
    radius = _RADIUS * min(facts.length, facts.width)
    bell = Product(Bell(place[0], radius / facts.length), Bell(place[1], radius / facts.width))
    forms = tuple(replace(LAMINATE_FORMS[q], weight=bell) for q in _SOFTENED)
    return problem.with_terms(Term("damage", "stiffness", forms, _lost))


def _lost(state: PlateState, values: Values) -> Array:
    plain = laminate_coefficients(state, values)[..., _SOFTENED]
    return np.asarray(-np.asarray(values["damage"])[..., None] * plain)


DAMAGE = Effect(
    name="damage",
    title="local damage: delamination, impact, dry fibres",
    family="damage",
    belongs_to="plate",
    parameters=(one_sided("damage", "", 0.2, 0.9, shown=PERCENT),),
    note="D and A_s less by a bell, sd a twentieth of the shorter side",
    check="Tap or C-scan the plate there.",
    sign=-1,
    places=tuple((x, y) for x in _GRID for y in _GRID),
    at=_damage_at,
)
DAMAGE = _damage_at((0.5, 0.5))
