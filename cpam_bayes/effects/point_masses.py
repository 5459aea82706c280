"""Point masses on the plate: one that the plate file states, and one of unknown size.

A sensor, its cable, a magnet, a repair.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import GRAM, Effect, Place, PlateFacts, one_sided, stacked
from cpam_bayes.mechanics.problem import FIELDS, Array, Atom, Form, PlateState, Problem, Region, Term, Values

# Its centre is never nearer to an edge than this, its foot having a size.
_GRID = (0.05, 0.275, 0.5, 0.725, 0.95)


def add_known_mass(problem: Problem, mass: float, x: float, y: float) -> Problem:
    """The problem with a point mass glued to the surface of the plate at (x, y).

    M += m (u^2 + v^2 + w^2) + m (h / 2)^2 (phi_x^2 + phi_y^2) at the point: the second part is the
    rotary inertia of a mass that sits on the surface, half a thickness off the midplane.

    mass : kg; x, y : m from the corner x = y = 0.
    """
    place = (x / float(problem.nominal.length), y / float(problem.nominal.width))
    return problem.with_terms(_point_mass("known_mass", place, mass))


def _sensor_at(place: Place) -> Effect:
    at = f"at ({place[0]:g}, {place[1]:g})"
    return replace(SENSOR_MASS, change=partial(_with_sensor, place), place=place, variant=at)


def _with_sensor(place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    del facts
    return problem.with_terms(_point_mass("sensor_mass", place, None))


def _point_mass(name: str, place: Place, mass: float | None) -> Term:
    """The term of a mass at a place; mass : kg, None where it is the parameter ``sensor_mass``."""
    forms = tuple(Form(Atom(f), Atom(f), Region("point", point=place)) for f in FIELDS)
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
    parameters=(one_sided("sensor_mass", "kg", 1e-3, shown=GRAM),),
    note="point mass m and its rotary inertia (h / 2)^2 m",
    check="Weigh what is fixed to the plate and state it under [[sensor]], or measure without contact.",
    sign=-1,
    places=tuple((x, y) for x in _GRID for y in _GRID),
    at=_sensor_at,
)
SENSOR_MASS = _sensor_at((0.95, 0.95))
