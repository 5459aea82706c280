"""Effects on plates of several materials: what acts on one material of a plain plate acts on each."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import cpam_bayes as cb
from cpam_bayes.effects import PlateFacts, extend
from cpam_bayes.effects.plies import MISORIENTATION, OUTER_PLY_ANGLE, SHEAR_RATIO, rotated
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.plate.laminate import laminate_geometry
from tests.hybrids import HYBRID, hybrid


@pytest.mark.parametrize("layup", ["[c0_2/g45/g-45/c90]_s", "[c0/g45/c30]"])
def test_a_turned_hybrid_is_that_of_turned_plies(layup: str) -> None:
    known = cb.read_plate(hybrid(layup=layup, thickness_mm=3.0 if "_s" in layup else 0.875)).plate.layup
    found = rotated(laminate_geometry(known.angles_deg, plies=known.plies), np.asarray(17.0))
    expected = laminate_geometry(known.angles_deg + 17.0, plies=known.plies)
    for name in ("in_plane", "coupling", "flexural", "ply", "first"):
        assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)


def test_the_shear_modulus_of_each_material_is_another_one() -> None:
    specimen = cb.read_plate(HYBRID)
    facts = PlateFacts.of(specimen.plate, specimen.material.isotropic)
    bare = plate_problem(specimen)
    problem = extend(bare, SHEAR_RATIO, facts)
    changed = problem.state({SHEAR_RATIO.parameters[0].name: np.asarray(0.1)}).constants
    for name, value in bare.nominal.constants.items():
        assert changed[name] == pytest.approx(value * (1.1 if name.endswith("G13") else 1.0))


def test_the_outer_plies_of_a_hybrid_turn_with_their_own_stiffness() -> None:
    specimen = cb.read_plate(HYBRID)
    facts = PlateFacts.of(specimen.plate, specimen.material.isotropic)
    turned = extend(plate_problem(specimen), OUTER_PLY_ANGLE, facts)
    state = turned.state({OUTER_PLY_ANGLE.parameters[0].name: np.asarray(30.0)})
    written = plate_problem(cb.read_plate(hybrid(layup="[c30/c0/g45/g-45/c90/c90/g-45/g45/c0/c30]")))
    assert_allclose(state.stiffness(), written.nominal.stiffness(), rtol=1e-9, atol=1e-3)
    whole = extend(plate_problem(specimen), MISORIENTATION, facts)
    state = whole.state({MISORIENTATION.parameters[0].name: np.asarray(20.0)})
    written = plate_problem(cb.read_plate(hybrid(layup="[c20_2/g65/g-25/c-70]_s")))
    assert_allclose(state.stiffness(), written.nominal.stiffness(), rtol=1e-9, atol=1e-3)
