"""Point masses on the plate: one that the plate file states, and one of unknown size.

A sensor, its cable, a magnet, a repair.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import (
    GRAM,
    Effect,
    Place,
    PlateFacts,
    anywhere,
    coordinate,
    one_sided,
    place_text,
    stacked,
)
from cpam_bayes.mechanics.problem import FIELDS, Array, Atom, Form, PlateState, Problem, Region, Term, Values

# Of the mass of the plate: one standard deviation, and the heaviest that a point mass describes.
_SCALE, _HEAVIEST = 0.01, 0.1


def add_known_mass(problem: Problem, mass: float, x: float, y: float) -> Problem:
    """The problem with a point mass glued to the surface of the plate at (x, y).

    M += m (u^2 + v^2 + w^2) + m (h / 2)^2 (phi_x^2 + phi_y^2) at the point: the second part is the
    rotary inertia of a mass that sits on the surface, half a thickness off the midplane.

    mass : kg; x, y : m from the corner x = y = 0.
    """
    place = (x / float(problem.nominal.length), y / float(problem.nominal.width))
    return problem.with_terms(_point_mass("known_mass", place, mass))


def _sensor_at(place: Place) -> Effect:
    return replace(
        SENSOR_MASS,
        change=partial(_with_sensor, place),
        parameters=SENSOR_MASS.parameters[:1],
        place=place,
        at=None,
        variant=place_text(place),
    )


def _plate_mass(facts: PlateFacts) -> float:
    return facts.mass


def _with_sensor(place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    del facts
    return problem.with_terms(_point_mass("sensor_mass", place, None))


def _point_mass(name: str, place: Place, mass: float | None) -> Term:
    """The term of a mass at a place; mass : kg, None where it is the parameter ``sensor_mass``."""
    forms = tuple(Form(Atom(f), Atom(f), Region("point", point=(place[0], place[1]))) for f in FIELDS)
    return Term(name, "mass", forms, partial(_coefficients, mass))


def _coefficients(known: float | None, state: PlateState, values: Values) -> Array:
    mass = np.asarray(values["sensor_mass"] if known is None else known)
    rotary = mass * (np.asarray(state.thickness) / 2) ** 2
    return stacked(*[mass + 0.0 * rotary] * 3, *[rotary] * 2)


SENSOR_MASS = Effect(
    name="sensor_mass",
    title="accelerometer or other added mass",
    family="mass",
    belongs_to="plate",
    # of a plate of one kilogram
    parameters=(
        one_sided("sensor_mass", "kg", _SCALE, _HEAVIEST, shown=GRAM),
        coordinate("mass_x"),
        coordinate("mass_y"),
    ),
    note="point mass m and its rotary inertia (h / 2)^2 m at any (x, y); 1 sd is 1 % of the plate's mass",
    check="Weigh what is fixed to the plate and state it under [[sensor]], or measure without contact.",
    change=anywhere,
    size_factor=_plate_mass,
    sign=-1,
    at=_sensor_at,
    local="point",
)
