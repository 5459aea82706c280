"""Stiffness of laminates of several materials and ply thicknesses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cpam_bayes.plate.elasticity import complete_constants
from cpam_bayes.plate.laminate import (
    ENERGY_CONSISTENT,
    FIVE_SIXTHS,
    PlyStack,
    ShearModel,
    laminate_geometry,
    laminate_stiffness,
    reduced_stiffness,
)
from tests.plates import CARBON, GLASS

H = 3e-3


def named(**materials: dict[str, float]) -> dict[str, np.ndarray]:
    """All constants of materials by their full names."""
    symmetry = {name: "transversely_isotropic" if "E2" in c else "isotropic" for name, c in materials.items()}
    return {
        f"{name}.{key}": value
        for name, constants in materials.items()
        for key, value in complete_constants(constants, symmetry[name]).items()  # type: ignore[arg-type]
    }


def stack(thickness: list[float], material: list[int], names: tuple[str, ...]) -> PlyStack:
    heights = np.array(thickness) / np.sum(thickness)
    z = np.concatenate(([0.0], np.cumsum(heights))) - 0.5
    return PlyStack(z, np.array(material), np.ones(len(material)), names)


@pytest.mark.parametrize("shear", [ENERGY_CONSISTENT, FIVE_SIXTHS])
@pytest.mark.parametrize("angles", [[0, 45, 90, 90, 45, 0], [0, 30, -60, 90], [0, 0, 20, 90, 15, 15]])
def test_two_equal_materials_are_one(angles: list[float], shear: ShearModel) -> None:
    plain = laminate_stiffness(complete_constants(CARBON, "transversely_isotropic"), angles, H, shear)
    plies = stack([1.0] * len(angles), [i % 2 for i in range(len(angles) // 2)] * 2, ("a", "b"))
    geometry = laminate_geometry(angles, plies=plies)
    both = laminate_stiffness(named(a=CARBON, b=CARBON), geometry, H, shear)
    assert_allclose(both, plain, rtol=1e-12, atol=1e-12 * np.abs(plain).max())


@pytest.mark.parametrize("angles", [[0, 45, 45, 0], [0, 45, 90, -30]])
def test_a_thick_ply_is_two_thin_ones(angles: list[float]) -> None:
    constants = named(a=CARBON, b=GLASS)
    thick = laminate_geometry(angles, plies=stack([2.0, 1.0, 1.0, 2.0], [0, 1, 1, 0], ("a", "b")))
    twice = [angles[i] for i in (0, 0, 1, 2, 3, 3)]
    thin = laminate_geometry(twice, plies=stack([1.0] * 6, [0, 0, 1, 1, 0, 0], ("a", "b")))
    first, second = (laminate_stiffness(constants, g, H) for g in (thick, thin))
    assert_allclose(first, second, rtol=1e-12, atol=1e-12 * np.abs(first).max())


def test_bending_stiffness_of_two_layers_is_that_of_a_bimetal() -> None:
    steel, aluminium = {"E1": 210e9, "nu12": 0.3}, {"E1": 70e9, "nu12": 0.3}
    t1, t2 = 1e-3, 2e-3
    geometry = laminate_geometry([0.0, 0.0], plies=stack([t1, t2], [0, 1], ("s", "a")))
    k = laminate_stiffness(named(s=steel, a=aluminium), geometry, t1 + t2)
    q1, q2 = (c["E1"] / (1 - 0.09) for c in (steel, aluminium))
    # Timoshenko, Analysis of bi-metal thermostats (1925): about the neutral axis
    expected = (q1 * t1**3 + q2 * t2**3) / 12 + q1 * t1 * q2 * t2 / (q1 * t1 + q2 * t2) * ((t1 + t2) / 2) ** 2
    a, b, d = k[0, 0], k[0, 3], k[3, 3]
    assert_allclose(d - b * b / a, expected, rtol=1e-3)  # the two layers have nu in common: exact but for A12
    assert_allclose(a, q1 * t1 + q2 * t2, rtol=1e-13)
    assert_allclose(b, q1 * t1 * (-t2 / 2) + q2 * t2 * (t1 / 2), rtol=1e-12)


def test_extension_and_bending_are_sums_over_the_plies() -> None:
    heights, owner = [0.4, 0.25, 0.35], [0, 1, 0]
    geometry = laminate_geometry([0.0, 90.0, 0.0], plies=stack(heights, owner, ("c", "g")))
    k = laminate_stiffness(named(c=CARBON, g=GLASS), geometry, H)
    z = H * (np.concatenate(([0.0], np.cumsum(heights))) - 0.5)
    q = [
        reduced_stiffness(complete_constants(c, "transversely_isotropic"))[[0, 2]]
        for c in (CARBON, GLASS, CARBON)
    ]
    along_x = np.array([q[0][0], q[1][1], q[2][0]])
    for (i, j), power in (((0, 0), 1), ((0, 3), 2), ((3, 3), 3)):
        assert_allclose(k[i, j], along_x @ np.diff(z**power) / power, rtol=1e-12)


def test_a_stack_of_layups_has_the_stiffness_of_each() -> None:
    plies = stack([1.0, 2.0, 0.5], [0, 1, 0], ("a", "b"))
    constants = named(a=CARBON, b=GLASS)
    layups = np.array([[0.0, 45.0, 90.0], [30.0, -30.0, 0.0]])
    together = laminate_stiffness(constants, laminate_geometry(layups, plies=plies, symmetric=False), H)
    for k, angles in zip(together, layups, strict=True):
        one = laminate_stiffness(constants, laminate_geometry(angles, plies=plies), H)
        assert_allclose(k, one, rtol=1e-12, atol=1e-12 * np.abs(one).max())


def test_a_soft_core_between_thin_faces_carries_all_the_shear() -> None:
    """A_s of a sandwich tends to G d^2 / c, d between the middles of the faces, c the core (Allen, 1969)."""
    face, core = {"E1": 70e9, "nu12": 0.3}, {"E1": 2.6e7, "nu12": 0.3}
    t = 0.01
    geometry = laminate_geometry([0.0] * 3, plies=stack([t, 1 - 2 * t, t], [0, 1, 0], ("f", "c")))
    shear = laminate_stiffness(named(f=face, c=core), geometry, 1.0)[6:, 6:]
    expected = 1e7 * (1 - t) ** 2 / (1 - 2 * t)
    assert_allclose(shear, expected * np.eye(2), rtol=2e-3, atol=1e-6 * expected)


def test_constants_of_one_material_may_vary_and_of_the_other_not() -> None:
    constants = named(a=CARBON, b=GLASS)
    e1 = np.array([100e9, 120e9, 140e9])
    plies = stack([1.0, 2.0, 1.0], [0, 1, 0], ("a", "b"))
    geometry = laminate_geometry([0.0, 45.0, 0.0], plies=plies)
    together = laminate_stiffness({**constants, "a.E1": e1}, geometry, H)
    for k, value in zip(together, e1, strict=True):
        one = laminate_stiffness({**constants, "a.E1": np.asarray(value)}, geometry, H)
        assert_allclose(k, one, rtol=1e-13, atol=1e-13 * np.abs(one).max())
