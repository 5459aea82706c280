"""Plates with effects on Ritz and finite elements, for the tests of effects."""

from functools import lru_cache

import numpy as np

from cpam_bayes.effects import CATALOGUE, PlateFacts, extend, variants
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.fem import discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate.layup import from_angles
from cpam_bayes.plate.reader import builtin
from tests.plates import with_plate

MODES = {"C1": 6, "A2": 6, "D3": 10}
# C1 with four simply supported edges, which is not built in
SUPPORTED = "C1 supported"
BY_NAME = {effect.name: effect for effect in CATALOGUE}


def specimen_of(name):
    return with_plate("C1", edges="SSSS") if name == SUPPORTED else builtin(name)


@lru_cache
def facts(name):
    specimen = specimen_of(name)
    return PlateFacts.of(specimen.plate, specimen.material.isotropic)


def facts_of(problem, layup=(0.0,)):
    n = problem.nominal
    size = (float(n.length), float(n.width), float(n.thickness))
    return PlateFacts(*size, from_angles(layup), problem.edges, isotropic=False, mass=1.0)


PLACES = {"sensor_mass": (0.95, 0.95, 0.0), "damage": (0.5, 0.5, 0.05)}  # places of such effects


def placed(effect):
    if not effect.is_anywhere:
        return effect
    at = zip((p.name for p in effect.coordinates), PLACES[effect.name], strict=True)
    return effect.fixed({name: np.asarray(value) for name, value in at})


def form(name, effect):
    return placed(variants(effect, facts(name))[0])


@lru_cache
def bare(name):
    return plate_problem(specimen_of(name))


def with_effect(name, effect):
    return extend(bare(name), effect, facts(name)) if effect.change else bare(name)


def values_at(effect, sds):
    """Values of the parameters at multiples of the catalogue's standard deviation, (len(sds),) each."""
    return {key: np.array([effect.scaled(s)[key] for s in sds]) for key in effect.null}


def ritz_operator(problem, values, degree):
    held = problem.edges != "FFFF"
    settings = RitzSettings(degree, degree, 2, held, 2 if held else 0)
    return discretise(problem, ritz_space(problem.edges, problem.nominal, settings), values)


def frequencies(problem, values, n=6, degree=9):
    stack = {name: np.array([value]) for name, value in values.items()}
    return _solved(ritz_operator(problem, stack, degree), stack, n)[0]


def ritz(name, effect, sds=(0.0, 1.0), degree=13):
    """Ritz frequencies (len(sds), n_modes) of a plate with an effect, or (1, n) of the bare plate."""
    problem, values = (with_effect(name, effect), values_at(effect, sds)) if effect else (bare(name), {})
    return _solved(ritz_operator(problem, values, degree), values, MODES.get(name, 6), effect)


def elements(name, effect, sds=(0.0, 1.0), counts=(None, None), n_modes=None):
    problem, values = with_effect(name, effect), values_at(effect, sds)
    space = fem_space(problem.edges, problem.nominal, *counts)
    return _solved(discretise_sparse(problem, space, values), values, n_modes or MODES.get(name, 6), effect)


def _solved(operator, values, n_modes, effect=None):
    found = [np.atleast_2d(c) for c in operator.coefficients(values)]
    m = max(len(c) for c in found)
    stiffness, mass = (np.broadcast_to(c, (m, c.shape[-1])) for c in found)
    f = solve(operator, stiffness, mass, n_modes).frequencies
    if effect is None or effect.observe is None:
        return f
    return effect.observe(np.broadcast_to(f, (len(next(iter(values.values()))), n_modes)), values)
