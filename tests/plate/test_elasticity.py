"""Relations between ply constants: eq. (6), (9), (11)."""

import numpy as np
import pytest

from cpam_bayes.plate.elasticity import (
    CONSTRAINTS,
    complete_constants,
    constraint_margins,
    constraint_violations,
    is_admissible,
    through_thickness_poisson,
)

COMPOSITE = "transversely_isotropic"
CARBON = {"E1": 121.2e9, "E2": 9.34e9, "nu12": 0.23, "G12": 6.25e9}


def test_left_out_shear_moduli_follow_eq_6():
    full = complete_constants(CARBON, COMPOSITE)
    nu23 = 0.23 * (1 - 0.23 * 9.34 / 121.2) / (1 - 0.23)
    assert full["G13"] == CARBON["G12"]
    assert full["G23"] == pytest.approx(9.34e9 / (2 * (1 + nu23)), rel=1e-14)


def test_eq_6_gives_the_reference_g23_of_table_9():
    assert float(complete_constants(CARBON, COMPOSITE)["G23"]) == pytest.approx(3.6e9, abs=0.05e9)


def test_given_shear_moduli_are_kept():
    full = complete_constants(CARBON | {"G13": 5e9, "G23": 3e9}, COMPOSITE)
    assert (full["G13"], full["G23"]) == (5e9, 3e9)


def test_isotropic_constants_follow_eq_11_and_the_printed_shear_modulus():
    full = complete_constants({"E1": 69e9, "nu12": 0.33}, "isotropic")
    assert full["E2"] == 69e9
    assert full["G12"] == full["G13"] == full["G23"]
    assert float(full["G12"]) == pytest.approx(25.94e9, abs=0.005e9)


def test_eq_6_and_eq_11_agree_on_an_isotropic_ply():
    nu = 0.3
    constants = {"E1": 7e10, "E2": 7e10, "nu12": nu, "G12": 7e10 / (2 * (1 + nu))}
    full = complete_constants(constants, COMPOSITE)
    assert float(through_thickness_poisson(7e10, 7e10, nu)) == pytest.approx(nu, rel=1e-14)
    assert float(full["G23"]) == pytest.approx(constants["G12"], rel=1e-14)


@pytest.mark.parametrize("symmetry", CONSTRAINTS)
def test_complex_step_derivatives_match_central_differences(symmetry):
    base = {"E1": 121.2, "nu12": 0.23} if symmetry == "isotropic" else {**CARBON, "E1": 121.2e9}
    for name, value in base.items():
        step = 1e-6 * value
        up, down = (complete_constants(base | {name: value + sign * step}, symmetry) for sign in (1, -1))
        exact = complete_constants(base | {name: value + 1e-30j * value}, symmetry)
        for key, derivative in exact.items():
            difference = (up[key] - down[key]) / 2e-6
            # central differences at 1e-6 are good to about 1e-10 of the value
            scale = abs(complex(exact[key]))
            assert complex(derivative).imag / 1e-30 == pytest.approx(difference, abs=1e-9 * scale)


def test_arrays_keep_their_shape():
    E1 = np.linspace(50e9, 150e9, 6).reshape(2, 3)
    constants = CARBON | {"E1": E1}
    assert complete_constants(constants, COMPOSITE)["G23"].shape == (2, 3)
    assert constraint_violations(constants, COMPOSITE).shape == (2, 3, 4)
    assert is_admissible(constants, COMPOSITE).all()


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        ({}, []),
        ({"E2": 130e9}, [3]),
        ({"nu12": 0.6}, [0, 1]),
        ({"E1": 10e9, "E2": 9e9, "nu12": 1.2}, [0, 2]),
        ({"nu12": float("nan")}, [0, 1, 2]),
    ],
)
def test_each_constraint_of_eq_9_is_seen(change, broken):
    found = constraint_violations(CARBON | change, COMPOSITE)
    assert list(np.flatnonzero(found)) == broken


def test_equal_moduli_break_eq_9_only_for_orthotropic_plies():
    assert constraint_violations(CARBON | {"E1": 9.34e9}, COMPOSITE)[3]
    assert not constraint_violations({"E1": 69e9, "nu12": 0.33}, "isotropic").any()


@pytest.mark.parametrize("nu", [-0.99, -0.3, 0.0, 0.3, 0.499])
def test_isotropic_poissons_ratios_within_minus_one_and_half_are_admissible(nu):
    assert is_admissible({"E1": 69e9, "nu12": nu}, "isotropic")


@pytest.mark.parametrize("nu", [-1.01, 0.501, 0.9, 1.0])
def test_isotropic_poissons_ratios_outside_minus_one_and_half_are_not(nu):
    assert not is_admissible({"E1": 69e9, "nu12": nu}, "isotropic")


@pytest.mark.parametrize("name", ["E1", "E2", "G12", "G13", "G23"])
def test_a_modulus_that_is_not_positive_is_not_admissible(name):
    constants = CARBON | {"G13": 5e9, "G23": 3e9}
    assert is_admissible(constants, COMPOSITE)
    assert not is_admissible(constants | {name: 0.0}, COMPOSITE)
    assert not is_admissible(constants | {name: -1e9}, COMPOSITE)


@pytest.mark.parametrize(
    ("constants", "symmetry"),
    [
        ({"E1": 1.0}, "isotropic"),
        ({"E1": 1.0, "nu12": 0.3, "E2": 1.0}, "isotropic"),
        ({"E1": 1.0}, COMPOSITE),
        ({"E1": 1.0, "E2": 1.0, "nu12": 0.3}, "orthotropic"),
    ],
)
def test_missing_and_unknown_constants_are_refused(constants, symmetry):
    with pytest.raises(ValueError, match="required"):
        complete_constants(constants, symmetry)


@pytest.mark.parametrize("ratio", [1.01, 1.5, 4.0, 20.0])
def test_the_first_constraint_of_eq_9_is_a_poissons_ratio_below_one_half(ratio):
    below, at, above = (
        constraint_margins({"E1": ratio, "E2": 1.0, "nu12": nu12, "G12": 1.0}, COMPOSITE)[0]
        for nu12 in (0.499, 0.5, 0.501)
    )
    assert below > 0.0 > above
    # zero but for rounding of four products of order one
    assert at == pytest.approx(0.0, abs=1e-14)


FABRIC = {"E1": 60e9, "E2": 60e9, "nu12": 0.05, "G12": 4e9}
SPRUCE = {"E1": 11e9, "E2": 0.9e9, "nu12": 0.51, "G12": 0.8e9}


@pytest.mark.parametrize("constants", [FABRIC, SPRUCE, FABRIC | {"E1": 30e9}])
def test_fabrics_and_wood_are_orthotropic_and_break_eq_9(constants):
    assert is_admissible(constants, "orthotropic")
    assert not is_admissible(constants, COMPOSITE)


def plane_stress_is_positive_definite(constants):
    """By the eigenvalues of the compliance of one ply in plane stress, scaled to a unit diagonal."""
    nu12, ratio = constants["nu12"], constants["E1"] / constants["E2"]
    return bool(np.linalg.eigvalsh([[1.0, -nu12], [-nu12, ratio]])[0] > 0.0)


@pytest.mark.parametrize("ratio", [0.05, 0.5, 1.0, 3.0, 15.0])
def test_an_orthotropic_ply_is_positive_definite_and_no_more_is_asked_of_it(ratio):
    for nu12 in (-4.0, -1.5, -0.9, -0.2, 0.0, 0.2, 0.6, 0.99, 1.7, 4.0):
        constants = {"E1": ratio, "E2": 1.0, "nu12": nu12, "G12": 0.1}
        assert is_admissible(constants, "orthotropic") == plane_stress_is_positive_definite(constants)


def test_left_out_shear_moduli_of_an_orthotropic_ply_are_the_in_plane_one():
    full = complete_constants(FABRIC, "orthotropic")
    assert full["G13"] == full["G23"] == FABRIC["G12"]
    assert complete_constants(FABRIC | {"G23": 3e9}, "orthotropic")["G23"] == 3e9


@pytest.mark.parametrize("symmetry", CONSTRAINTS)
def test_every_constraint_has_its_words(symmetry):
    constants = {"E1": 2.0, "nu12": 0.3} if symmetry == "isotropic" else CARBON
    assert constraint_margins(constants, symmetry).shape == (len(CONSTRAINTS[symmetry]),)
