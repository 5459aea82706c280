"""Point masses on the plate: one that the plate file states, and one of unknown size.

A sensor, its cable, a magnet, a repair.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import (
    GRAM,
    MILLIMETRE,
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
from cpam_bayes.parameters import LogUniform, Parameter

# Of the mass of the plate: one standard deviation, and the heaviest that a point mass describes.
_SCALE, _HEAVIEST = 0.01, 0.1
# Radius of gyration about the surface that a mass is fixed to, m. A cube of side s has s (1/6 + 1/4)^(1/2):
# 3 mm for half a gram to 19 mm for 50 g with the 2 to 5 g/cm3 of accelerometers; less for what is flat.
_GYRATION = LogUniform(1e-3, 20e-3)


def add_known_mass(problem: Problem, mass: float, x: float, y: float) -> Problem:
    """The problem with a point mass glued to the surface of the plate at (x, y).

    M += m (u^2 + v^2 + w^2) + m (h / 2)^2 (phi_x^2 + phi_y^2) at the point: the second part is the
    rotary inertia of a mass that sits on the surface, half a thickness off the midplane.

    mass : kg; x, y : m from the corner x = y = 0.
    """
    place = (x / float(problem.nominal.length), y / float(problem.nominal.width))
    return problem.with_terms(_point_mass("known_mass", place, mass, 0.0))


def _sensor_at(place: Place) -> Effect:
    return replace(
        SENSOR_MASS,
        change=partial(_with_sensor, place),
        parameters=SENSOR_MASS.parameters[:1],
        place=place,
        at=None,
        variant=f"{place_text(place[:2])}, radius of gyration {1e3 * place[2]:.3g} mm",
    )


def _plate_mass(facts: PlateFacts) -> float:
    return facts.mass


def _with_sensor(place: Place, problem: Problem, facts: PlateFacts) -> Problem:
    del facts
    x, y, gyration = place
    return problem.with_terms(_point_mass("sensor_mass", (x, y), None, gyration))


def _point_mass(name: str, place: tuple[float, float], mass: float | None, gyration: float) -> Term:
    """The term of a mass at a place.

    mass : kg, None where it is the parameter ``sensor_mass``
    gyration : radius of gyration about the surface, m
    """
    forms = tuple(Form(Atom(f), Atom(f), Region("point", point=place)) for f in FIELDS)
    return Term(name, "mass", forms, partial(_coefficients, mass, gyration))


def _coefficients(known: float | None, gyration: float, state: PlateState, values: Values) -> Array:
    mass = np.asarray(values["sensor_mass"] if known is None else known)
    rotary = mass * ((np.asarray(state.thickness) / 2) ** 2 + gyration**2)
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
        Parameter("mass_gyration", "m", _GYRATION, _GYRATION.mean, MILLIMETRE),
    ),
    note=(
        "point mass m and its rotary inertia ((h / 2)^2 + r^2) m at any (x, y), radius of gyration r of "
        "1 to 20 mm; 1 sd is 1 % of the plate's mass"
    ),
    check="Weigh what is fixed to the plate and state it under [[sensor]], or measure without contact.",
    change=anywhere,
    size_factor=_plate_mass,
    sign=-1,
    at=_sensor_at,
    local="point",
    smooth=("mass_gyration",),
)
