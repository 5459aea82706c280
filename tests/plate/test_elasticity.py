"""Relations between ply constants: eq. (6), (9), (11)."""

import numpy as np
import pytest

from cpam_bayes.plate.elasticity import (
    complete_constants,
    constraint_violations,
    is_admissible,
    through_thickness_poisson,
)

CARBON = {"E1": 121.2e9, "E2": 9.34e9, "nu12": 0.23, "G12": 6.25e9}


def test_left_out_shear_moduli_follow_eq_6():
    full = complete_constants(CARBON, isotropic=False)
    nu23 = 0.23 * (1 - 0.23 * 9.34 / 121.2) / (1 - 0.23)
    assert full["G13"] == CARBON["G12"]
    assert full["G23"] == pytest.approx(9.34e9 / (2 * (1 + nu23)), rel=1e-14)


def test_eq_6_gives_the_reference_g23_of_table_9():
    assert float(complete_constants(CARBON, False)["G23"]) == pytest.approx(3.6e9, abs=0.05e9)


def test_given_shear_moduli_are_kept():
    full = complete_constants(CARBON | {"G13": 5e9, "G23": 3e9}, isotropic=False)
    assert (full["G13"], full["G23"]) == (5e9, 3e9)


def test_isotropic_constants_follow_eq_11_and_the_printed_shear_modulus():
    full = complete_constants({"E1": 69e9, "nu12": 0.33}, isotropic=True)
    assert full["E2"] == 69e9
    assert full["G12"] == full["G13"] == full["G23"]
    assert float(full["G12"]) == pytest.approx(25.94e9, abs=0.005e9)


def test_eq_6_and_eq_11_agree_on_an_isotropic_ply():
    nu = 0.3
    constants = {"E1": 7e10, "E2": 7e10, "nu12": nu, "G12": 7e10 / (2 * (1 + nu))}
    full = complete_constants(constants, isotropic=False)
    assert float(through_thickness_poisson(7e10, 7e10, nu)) == pytest.approx(nu, rel=1e-14)
    assert float(full["G23"]) == pytest.approx(constants["G12"], rel=1e-14)


@pytest.mark.parametrize("isotropic", [False, True])
def test_complex_step_derivatives_match_central_differences(isotropic):
    base = {"E1": 121.2, "nu12": 0.23} if isotropic else {**CARBON, "E1": 121.2e9}
    for name, value in base.items():
        step = 1e-6 * value
        up, down = (complete_constants(base | {name: value + sign * step}, isotropic) for sign in (1, -1))
        exact = complete_constants(base | {name: value + 1e-30j * value}, isotropic)
        for key, derivative in exact.items():
            difference = (up[key] - down[key]) / 2e-6
            # central differences at 1e-6 are good to about 1e-10 of the value
            scale = abs(complex(exact[key]))
            assert complex(derivative).imag / 1e-30 == pytest.approx(difference, abs=1e-9 * scale)


def test_arrays_keep_their_shape():
    E1 = np.linspace(50e9, 150e9, 6).reshape(2, 3)
    constants = CARBON | {"E1": E1}
    assert complete_constants(constants, False)["G23"].shape == (2, 3)
    assert constraint_violations(constants, False).shape == (2, 3, 4)
    assert is_admissible(constants, False).all()


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
    found = constraint_violations(CARBON | change, isotropic=False)
    assert list(np.flatnonzero(found)) == broken


def test_equal_moduli_break_eq_9_only_for_orthotropic_plies():
    assert constraint_violations(CARBON | {"E1": 9.34e9}, False)[3]
    assert not constraint_violations({"E1": 69e9, "nu12": 0.33}, True).any()


@pytest.mark.parametrize("nu", [-0.99, -0.3, 0.0, 0.3, 0.499])
def test_isotropic_poissons_ratios_within_minus_one_and_half_are_admissible(nu):
    assert is_admissible({"E1": 69e9, "nu12": nu}, True)


@pytest.mark.parametrize("nu", [-1.01, 0.501, 0.9, 1.0])
def test_isotropic_poissons_ratios_outside_minus_one_and_half_are_not(nu):
    assert not is_admissible({"E1": 69e9, "nu12": nu}, True)


@pytest.mark.parametrize("name", ["E1", "E2", "G12", "G13", "G23"])
def test_a_modulus_that_is_not_positive_is_not_admissible(name):
    constants = CARBON | {"G13": 5e9, "G23": 3e9}
    assert is_admissible(constants, False)
    assert not is_admissible(constants | {name: 0.0}, False)
    assert not is_admissible(constants | {name: -1e9}, False)


@pytest.mark.parametrize(
    ("constants", "isotropic"),
    [({"E1": 1.0}, True), ({"E1": 1.0, "nu12": 0.3, "E2": 1.0}, True), ({"E1": 1.0}, False)],
)
def test_missing_and_unknown_constants_are_refused(constants, isotropic):
    with pytest.raises(ValueError, match="required"):
        complete_constants(constants, isotropic)
