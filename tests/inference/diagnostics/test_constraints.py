"""A constraint that cuts a posterior is found, and one that it does not reach is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from cpam_bayes.inference.diagnostics.constraints import (
    cut_warnings,
    cutting_constraints,
    limiting_constraints,
)
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Material
from cpam_bayes.plate.elasticity import CONSTRAINTS

CARBON = {"E1": 121e9, "E2": 9.3e9, "nu12": 0.3, "G12": 6e9}
N_DRAWS = 4000


def cut_normal(beyond: float) -> np.ndarray:
    """Draws above 0 of a normal density that has a fraction ``beyond`` of it below."""
    mean = -truncnorm.ppf(beyond, -np.inf, np.inf)
    return truncnorm.rvs(-mean, np.inf, loc=mean, size=N_DRAWS, random_state=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("beyond", "cuts"), [(0.9, True), (0.5, True), (0.1, True), (0.01, False), (1e-3, False)]
)
def test_a_constraint_cuts_where_a_part_of_the_density_would_lie_beyond(beyond: float, cuts: bool) -> None:
    found = cutting_constraints(cut_normal(beyond)[:, None], CONSTRAINTS["orthotropic"])
    assert bool(found) == cuts


def test_wide_margins_are_no_cut() -> None:
    # E1 / E2 - 1 of wide priors has an sd as large as its mean, and no draw near 0
    ratio = np.random.default_rng(1).lognormal(2.5, 0.7, size=N_DRAWS) + 2.0
    draws = {"E1": 9.3e9 * ratio}
    assert cut_warnings(Material("transversely_isotropic", CARBON, {}, None), draws) == ()


@pytest.mark.parametrize(
    ("symmetry", "draws", "said"),
    [
        ("transversely_isotropic", {"nu12": 0.5 - 0.02 * cut_normal(0.3)}, "nu12 < 0.5"),
        ("transversely_isotropic", {"E1": 9.3e9 + 1e9 * cut_normal(0.3)}, "E1 > E2, fourth of eq. (9)"),
        ("orthotropic", {"nu12": 0.5 - 0.02 * cut_normal(0.3)}, None),
        ("orthotropic", {"E1": 9.3e9 + 1e9 * cut_normal(0.3)}, None),
        ("orthotropic", {"nu12": (121 / 9.3) ** 0.5 - 0.1 * cut_normal(0.3)}, "|nu12| < sqrt(E1/E2)"),
        ("isotropic", {"nu12": 0.5 - 0.02 * cut_normal(0.3)}, "-1 < nu12 < 0.5"),
    ],
)
def test_the_constraint_that_cuts_is_named(symmetry, draws, said) -> None:
    constants = {k: CARBON[k] for k in ("E1", "nu12")} if symmetry == "isotropic" else CARBON
    warnings = cut_warnings(Material(symmetry, constants, {}, None), draws)
    assert [said in w for w in warnings] == [True] * (said is not None)
    # where another symmetry would help, it is named
    assert all(('symmetry = "orthotropic"' in w) == ("eq. (9)" in w) for w in warnings)


@pytest.mark.parametrize(
    ("nu12", "limits"), [(0.4999, True), (0.4, False), (0.2, False)], ids=["on it", "off it", "on a bound"]
)
def test_an_optimum_on_a_constraint_is_found(nu12: float, limits: bool) -> None:
    unknowns = ParameterSet(
        (
            Parameter("E1", "Pa", Uniform(50e9, 200e9)),
            Parameter("nu12", "", Uniform(0.2, 0.6)),
        )
    )
    material = Material("transversely_isotropic", CARBON, {}, None)
    found = limiting_constraints(material, unknowns, np.array([121e9, nu12]))
    assert bool(found) == limits


@pytest.mark.parametrize("symmetry", ["transversely_isotropic", "orthotropic"])
def test_a_shear_modulus_alone_is_cut_by_nothing(symmetry) -> None:
    material = Material(symmetry, CARBON, {}, None)
    unknowns = ParameterSet((Parameter("G12", "Pa", Uniform(1e9, 9e9)),))
    assert limiting_constraints(material, unknowns, np.array([6e9])) == ()
    assert cut_warnings(material, {"G12": 6e9 + 1e8 * cut_normal(0.5)}) == ()
