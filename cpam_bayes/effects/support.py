"""The foam that a free plate lies on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cpam_bayes.effects.effect import Effect, PlateFacts, one_sided
from cpam_bayes.mechanics.problem import Array, Atom, Form, PlateState, Problem, Term, Values

# First frequency of the plate that the catalogue's size is given for, Hz.
_TYPICAL = 80.0


def _support(problem: Problem, facts: PlateFacts) -> Problem:
    """K += k integral of w^2, k = (2 pi f_r)^2 rho h: f^2 becomes f^2 + f_r^2."""
    del facts

    form = Form(Atom("w"), Atom("w"))
    supported = replace(problem, supported=True)
    return supported.with_terms(Term("support", "stiffness", (form,), _foam))


def _foam(state: PlateState, values: Values) -> Array:
    omega = 2 * np.pi * np.asarray(values["support_frequency"])
    return np.asarray(omega**2 * state.density * state.thickness * state.area)[..., None]


def _is_free(facts: PlateFacts) -> bool:
    return facts.edges == "FFFF"


def _per_first_frequency(facts: PlateFacts) -> float:
    """A tenth of the first frequency, as modal tests ask of a suspension, and half of it at most."""
    return (facts.first_frequency or _TYPICAL) / _TYPICAL


SUPPORT = Effect(
    name="support",
    title="suspension or foam under a free plate",
    family="surroundings",
    belongs_to="plate",
    parameters=(one_sided("support_frequency", "Hz", 8.0, 40.0),),
    note="f^2 + f_r^2, free plates only: the lowest modes rise most",
    check="Measure the frequency at which the plate bounces on its support, or support it more softly.",
    change=_support,
    applies_to=_is_free,
    size_factor=_per_first_frequency,
    sign=1,
    even=True,
)
