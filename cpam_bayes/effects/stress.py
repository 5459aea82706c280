"""Residual membrane stress, as curing or machining leaves it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from cpam_bayes.effects.effect import EVEN, MEGAPASCAL, Effect, PlateFacts, either_sign, stacked
from cpam_bayes.mechanics.problem import Array, Atom, Form, PlateState, Problem, StateFunction, Term, Values
from cpam_bayes.mechanics.weights import Polynomial, Product

# g(s) = (1 - s^2)^2: it and its slope vanish at both ends, so that no edge carries load.
_G = Polynomial((1.0, 0.0, -2.0, 0.0, 1.0))
# Largest value of N_x a unit of F0 4 / b^2: g(0) g''(1).
_PEAK = 8.0
# Stresses that a plate is held to carry flat, in min(sqrt(D11 D22), 4 D66) / (h b^2) with b the shorter side:
# the 17 built-in plates buckle between -70 and -44 and above 82.
_LEAST, _MOST = -35.0, 65.0


def _membrane_stress(problem: Problem, facts: PlateFacts) -> Problem:
    """K += integral of grad w . N grad w with N of the Airy function F = F0 g(s_x) g(s_y).

    N_x = F,yy, N_y = F,xx, N_xy = -F,xy are in equilibrium with free edges; F0 gives max |N| / h the
    value of the parameter (Timoshenko and Woinowsky-Krieger, Theory of Plates and Shells, section 90).
    """
    del facts
    problem = replace(problem, admissible=partial(_unbuckled, problem.state, problem.admissible))
    first, second = _G.derivative(), _G.derivative(2)
    w_x, w_y = Atom("w", "x"), Atom("w", "y")
    forms = (
        Form(w_x, w_x, weight=Product(_G, second)),
        Form(w_y, w_y, weight=Product(second, _G)),
        Form(w_x, w_y, weight=Product(first, first)),
    )

    return problem.with_terms(Term("membrane_stress", "stiffness", forms, _stress_coefficients))


def _unbuckled(plate: StateFunction, admissible: Callable[[Values], Array], values: Values) -> Array:
    """Whether the plate stays flat under the stress: beyond, its frequencies are those of another shape."""
    state, stress = plate(values), np.real(values["residual_stress"])
    d = np.real(state.stiffness())
    a, b = np.real(state.length), np.real(state.width)
    bending = np.sqrt(d[..., 3, 3] * d[..., 4, 4])
    rigidity = np.minimum(bending, 4.0 * d[..., 5, 5]) / (np.real(state.thickness) * np.minimum(a, b) ** 2)
    return np.asarray(admissible(values) & (stress > _LEAST * rigidity) & (stress < _MOST * rigidity))


def _stress_coefficients(state: PlateState, values: Values) -> Array:
    a, b = np.asarray(state.length), np.asarray(state.width)
    # N_x and N_y are largest in the middle of the longer edges, N_xy is smaller anywhere
    shorter = np.where(np.real(a) < np.real(b), a, b)
    f0 = np.asarray(values["residual_stress"]) * state.thickness * shorter**2 / (4.0 * _PEAK)
    # d2/dy2 = 4/b^2 d2/ds2; (w,x)^2 = (1/a d/dxi)^2; area a b
    normal = f0 * 4.0 / (a * b)
    return stacked(normal, normal, -normal)


MEMBRANE_STRESS = Effect(
    name="membrane_stress",
    title="residual stress",
    family="stress",
    belongs_to="plate",
    parameters=(either_sign("residual_stress", "Pa", 0.3e6, 10e6, gross=EVEN, shown=MEGAPASCAL),),
    note="integral of grad w . N grad w, N from (1 - x^2)^2 (1 - y^2)^2 with max abs N / h given: "
    "raises some modes and lowers others",
    check="Measure again after annealing, or cut the plate and gauge the strain that this releases.",
    change=_membrane_stress,
)
