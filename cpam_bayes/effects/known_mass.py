"""A known mass on the plate: an accelerometer, a magnet, a coin."""

from __future__ import annotations

from functools import partial

import numpy as np

from cpam_bayes.mechanics.problem import Array, Atom, Form, PlateState, Problem, Region, Term, Values


def add_known_mass(problem: Problem, mass: float, x: float, y: float) -> Problem:
    """The problem with a point mass glued to the surface of the plate at (x, y).

    M += m (u^2 + v^2 + w^2) + m (h / 2)^2 (phi_x^2 + phi_y^2) at the point: the second part is the
    rotary inertia of a mass that sits on the surface, half a thickness off the midplane.

    mass : kg; x, y : m from the corner x = y = 0.
    """
    length, width = float(problem.nominal.length), float(problem.nominal.width)
    place = Region("point", point=(x / length, y / width))
    forms = tuple(Form(Atom(f), Atom(f), place) for f in ("u", "v", "w", "phi_x", "phi_y"))
    return problem.with_terms(Term("known_mass", "mass", forms, partial(_coefficients, mass)))


def _coefficients(mass: float, state: PlateState, values: Values) -> Array:
    del values
    rotary = mass * (np.asarray(state.thickness) / 2) ** 2
    return np.stack(np.broadcast_arrays(*[mass + 0.0 * rotary] * 3, *[rotary] * 2), axis=-1)
