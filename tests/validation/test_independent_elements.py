"""The elements that make the truths of benchmarks are right, and share no physics with the package."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from validation.independent import elements
from validation.independent.true_plate import (
    Mass,
    Patch,
    TruePlate,
    natural_frequencies,
    sensitivities,
)

CARBON = {"E1": 121.2e9, "E2": 9.34e9, "nu12": 0.23, "G12": 6.25e9}
CROSS_PLY = tuple([0.0, 90.0] * 8 + [90.0, 0.0] * 8)
C1 = TruePlate(0.26, 0.26, 0.0032, 1590.0, "FFFF", CROSS_PLY, CARBON, correction=5 / 6)
A2 = TruePlate(0.25, 0.28, 0.003, 2700.0, "CFFF", (0.0,), {"E1": 69e9, "nu12": 0.33}, correction=5 / 6)
# Coarse: for relations that hold on any mesh.
SMALL = replace(C1, mesh=8)


@pytest.mark.parametrize(
    ("plate", "converged"),
    [
        (C1, [100.366, 298.584, 324.574, 360.347, 381.139, 600.611]),
        (A2, [40.9165, 90.673, 240.069, 276.238, 340.704, 566.456]),
    ],
    ids=["C1", "A2"],
)
def test_converged_frequencies_of_two_ritz_bases_are_met(plate: TruePlate, converged: list[float]) -> None:
    # two solvers that are no part of the package agree on these to 2e-6; the mesh costs 1e-4 at most
    np.testing.assert_allclose(natural_frequencies(plate, 6), converged, rtol=1e-4)


def test_two_plies_of_one_metal_have_the_shear_stiffness_of_its_parabola() -> None:
    c = elements.completed({"E1": 70e9, "nu12": 0.3})
    stiffness = elements.laminate_stiffness([(c, 0.0, 0.001), (c, 0.0, 0.001)])
    assert stiffness[7, 7] == pytest.approx(5 / 6 * c["G12"] * 0.002, rel=1e-10)


def test_a_point_mass_lowers_by_its_kinetic_energy_and_a_soft_patch_by_its_strain_energy() -> None:
    f = natural_frequencies(SMALL, 6)
    heavy = natural_frequencies(replace(SMALL, masses=(Mass(1e-3, 0.24, 0.2),)), 6)
    soft = natural_frequencies(replace(SMALL, patches=(Patch("ellipse", 0.1, 0.1, 0.04, 0.03, 0.3),)), 6)
    assert (heavy < f * (1 + 1e-9)).all()
    assert (soft < f).all()


def test_all_plies_turned_by_a_right_angle_are_the_plate_seen_from_its_other_side() -> None:
    other = replace(SMALL, angles_deg=tuple(a + 90.0 for a in CROSS_PLY))
    turned = replace(SMALL, width=0.2, length=0.26)
    np.testing.assert_allclose(
        natural_frequencies(replace(other, length=0.2), 4), natural_frequencies(turned, 4), rtol=2e-6
    )


def test_sensitivities_are_difference_quotients() -> None:
    plate = replace(SMALL, length=0.3)
    _, slopes = sensitivities(plate, ("E1", "G12"), 4)
    for j, name in enumerate(("E1", "G12")):
        up, down = (
            natural_frequencies(replace(plate, constants={**CARBON, name: CARBON[name] * s}), 4)
            for s in (1.001, 0.999)
        )
        np.testing.assert_allclose(slopes[:, j], np.log(up / down) / np.log(1.001 / 0.999), atol=1e-5)


def test_stiff_springs_hold_as_a_clamp_does() -> None:
    held = replace(A2, mesh=8)
    np.testing.assert_allclose(
        natural_frequencies(replace(held, turn=1e-7, shift=1e-9), 4), natural_frequencies(held, 4), rtol=2e-5
    )


def test_no_line_of_the_truths_is_the_packages_own_physics() -> None:
    folder = Path(elements.__file__).parent
    for path in folder.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(n.startswith("cpam_bayes") for n in names), path.name
            assert all(n.startswith("validation.independent") for n in names if "validation" in n), path.name
