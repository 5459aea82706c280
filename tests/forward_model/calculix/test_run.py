"""CalculiX through files against converged first-order shear deformation theory."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cpam_bayes.forward_model.calculix.deck import Element
from cpam_bayes.forward_model.calculix.run import CalculixError, run_deck, solve_modes
from cpam_bayes.forward_model.model import NO_PARAMETERS, converged_model, reference_constants
from cpam_bayes.plate import Sensor
from cpam_bayes.plate.layup import parse_layup
from tests.plates import with_plate

pytestmark = pytest.mark.needs_ccx
SLOW = pytest.mark.slow


# Bricks do not share the theory's assumptions. On thin plates the two differ only by the error of the mesh,
# 0.02 %. On thick cross-plies both contribute: a mesh of half the size lowers the highest modes by 0.05 %,
# and 0.08 % remains as the theory's own error. Clamped faces also hold the thickness, which the theory
# ignores: 0.03 to 0.04 % for aluminium with any mesh. CalculiX expands each shell to one brick through the
# thickness, without a shear correction: right to 0.15 % on thin plates, up to 0.8 % high on thick ones.
@pytest.mark.parametrize(
    ("element", "name", "changes", "n_modes", "tolerance"),
    [
        ("brick", "A2", {"edges": "FFFF"}, 6, 3e-4),
        ("brick", "A2", {"edges": "SSSS"}, 6, 5e-4),
        ("brick", "A2", {"edges": "CFFF"}, 6, 6e-4),
        ("brick", "C2", {"layup": parse_layup("[0/90]")}, 6, 5e-4),
        pytest.param("brick", "C1", {}, 6, 4e-4, marks=[SLOW, pytest.mark.weekly]),
        pytest.param("brick", "D2", {}, 10, 1.5e-3, marks=[SLOW, pytest.mark.weekly]),
        pytest.param("brick", "D3", {}, 10, 1.7e-3, marks=[SLOW, pytest.mark.weekly]),
        *(("shell", name, {}, 6, 1.5e-3) for name in ("C1", "C4", "A2")),
        ("shell", "D3", {}, 10, 8e-3),
    ],
)
def test_both_elements_agree_with_energy_consistent_shear(
    element: Element, name: str, changes: dict[str, object], n_modes: int, tolerance: float
) -> None:
    specimen = with_plate(name, **changes)
    found = solve_modes(specimen, reference_constants(specimen), n_modes, element=element)
    expected = converged_model(specimen, NO_PARAMETERS, n_modes).modes(np.empty(0))
    assert_allclose(found.frequencies, [mode.frequency for mode in expected], rtol=tolerance)
    assert [(m.kind, m.label) for m in found.modes] == [(m.kind, m.label) for m in expected]


@pytest.mark.parametrize("element", ["shell", "brick"])
@pytest.mark.parametrize("edges", ["SFFF", "SFSF", "SSFF"])  # others are tested above
def test_the_rigid_body_count_is_that_of_the_edges(edges: str, element: Element) -> None:
    specimen = with_plate("B1", edges=edges)  # `solve_modes` refuses eigenvalues that imply another number.
    found = solve_modes(specimen, reference_constants(specimen), 3, element=element, in_plane=36).frequencies
    assert np.all(found > 1.0)


@pytest.mark.parametrize("element", ["shell", "brick"])
def test_a_small_known_mass_lowers_each_frequency_as_rayleigh_says(element: Element) -> None:
    mass, x, y = 0.2e-3, 0.25, 0.28  # d ln f = - m |phi|^2 / (2 M), phi of the bare plate, unit mean square
    bare = with_plate("A2", edges="FFFF")
    loaded = replace(bare, sensors=(Sensor(mass, x, y),))
    plate, known = bare.plate, reference_constants(bare)
    before, after = (solve_modes(s, known, 4, element=element, in_plane=100) for s in (bare, loaded))
    weight = np.ones(before.shapes.shape[-1])
    weight[[0, -1]] = 0.5
    weight /= weight.sum()
    mean_square = np.einsum("mfij,i,j->m", before.shapes**2, weight, weight)
    at_corner = (before.shapes[:, :, -1, -1] ** 2).sum(axis=1)
    expected = -mass * at_corner / mean_square / (2 * plate.density * plate.thickness * plate.area)
    assert_allclose(np.log(after.frequencies / before.frequencies), expected, rtol=0.04)  # shapes err by 2 %


def test_a_deck_that_calculix_cannot_read_shows_its_words() -> None:
    with pytest.raises(CalculixError, match="CalculiX"):
        run_deck("*NODE\n1, 0, 0, 0\n*ELEMENT, TYPE=C3D20R\n1, 1, 2\n*STEP\n*FREQUENCY\n1\n*END STEP\n")
