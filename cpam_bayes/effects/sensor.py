"""A mass of unknown size at a given place: a sensor, its cable, a repair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cpam_bayes.effects.effect import GRAM, Effect, Place, PlateFacts, one_sided, stacked
from cpam_bayes.mechanics.problem import FIELDS, Array, Atom, Form, PlateState, Problem, Region, Term, Values

# Its centre is never nearer to an edge than this, its foot having a size.
_GRID = (0.05, 0.275, 0.5, 0.725, 0.95)


def _sensor_at(place: Place) -> Effect:
    forms = tuple(Form(Atom(f), Atom(f), Region("point", point=place)) for f in FIELDS)

    def change(problem: Problem, facts: PlateFacts) -> Problem:
        """M += m (u^2 + v^2 + w^2) + m (h / 2)^2 (phi_x^2 + phi_y^2) at the place, as a known mass."""
        del facts

        return problem.with_terms(Term("sensor_mass", "mass", forms, _mass_coefficients))

    return replace(SENSOR_MASS, change=change, place=place, variant=f"at ({place[0]:g}, {place[1]:g})")


def _mass_coefficients(state: PlateState, values: Values) -> Array:
    mass = np.asarray(values["sensor_mass"])
    rotary = mass * (np.asarray(state.thickness) / 2) ** 2
    return stacked(*[mass] * 3, *[rotary] * 2)


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
