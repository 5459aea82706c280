"""Laminate stiffness against independent rotations, integrals, published values and invariances."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.integrate import quad_vec

from cpam_bayes.plate.elasticity import complete_constants
from cpam_bayes.plate.laminate import (
    CURVATURE,
    ENERGY_CONSISTENT,
    FIVE_SIXTHS,
    MEMBRANE,
    SHEAR,
    ShearModel,
    flexural_constants,
    laminate_geometry,
    laminate_stiffness,
)
from tests.plates import ANGLE_PLY_16S, CARBON, CROSS_PLY_16S

Constants = Mapping[str, ArrayLike]

# G13 and G23 differ from each other and from G12, so that a mistaken index shows.
PLY: dict[str, float] = CARBON | {"G13": 5.1e9, "G23": 3.0e9}
ISOTROPIC = complete_constants({"E1": 70e9, "nu12": 0.3}, "isotropic")
THICKNESS = 0.0032
UNCORRECTED = ShearModel(1.0)
LAYUPS: dict[str, tuple[float, ...]] = {
    "single": (0.0,),
    "off-axis": (35.0,),
    "cross": (0.0, 90.0),
    "angle": (45.0, -45.0),
    "symmetric-cross": (0.0, 90.0, 90.0, 0.0),
    "odd-symmetric": (20.0, -70.0, 20.0),
    "general": (10.0, -65.0, 40.0, 80.0, -25.0),
    "thirty-two": ANGLE_PLY_16S,
}
layups = pytest.mark.parametrize("layup", LAYUPS.values(), ids=LAYUPS)
shear_models = pytest.mark.parametrize("shear", [ENERGY_CONSISTENT, FIVE_SIXTHS], ids=["energy", "5/6"])


def stiffness(
    layup: ArrayLike,
    constants: Constants = PLY,
    thickness: ArrayLike = THICKNESS,
    shear: ShearModel = ENERGY_CONSISTENT,
) -> np.ndarray:
    return laminate_stiffness(constants, np.asarray(layup), thickness, shear)


def rotated_ply(angle_deg: float, constants: Mapping[str, float] = PLY) -> np.ndarray:
    """Plane-stress stiffness (3, 3) of a turned ply, by matrices that turn stress and strain as tensors."""
    e1, e2, nu12, g12 = (float(constants[name]) for name in ("E1", "E2", "nu12", "G12"))
    compliance = np.array([[1 / e1, -nu12 / e1, 0], [-nu12 / e1, 1 / e2, 0], [0, 0, 1 / g12]])
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.array([[c, s], [-s, c]])  # components along the ply's axes of a vector given in x, y
    pairs = ((0, 0), (1, 1), (0, 1))
    # stress (2, 2) in the ply's axes = turn sigma turn^T, written for the vector (11, 22, 12)
    stress = np.zeros((3, 3))
    for row, (i, j) in enumerate(pairs):
        for column, (k, m) in enumerate(pairs):
            stress[row, column] = turn[i, k] * turn[j, m]
            if k != m:
                stress[row, column] += turn[i, m] * turn[j, k]
    return np.asarray(np.linalg.inv(stress) @ np.linalg.inv(compliance) @ np.linalg.inv(stress).T)


def rotated_shear(angle_deg: float, constants: Mapping[str, float] = PLY) -> np.ndarray:
    """Transverse shear stiffness (2, 2) of a turned ply, order (yz, xz)."""
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.array([[c, -s], [s, c]])  # (gamma_23, gamma_13) from (gamma_yz, gamma_xz)
    return np.asarray(turn.T @ np.diag([float(constants["G23"]), float(constants["G13"])]) @ turn)


def summed(layup: tuple[float, ...], thickness: float = THICKNESS) -> np.ndarray:
    """[A B; B D] by a sum over plies, (6, 6)."""
    z = np.linspace(-thickness / 2, thickness / 2, len(layup) + 1)
    total = np.zeros((6, 6))
    for angle, bottom, top in zip(layup, z[:-1], z[1:], strict=True):
        moments = [(top**k - bottom**k) / k for k in (1, 2, 3)]
        total += np.kron([[moments[0], moments[1]], [moments[1], moments[2]]], rotated_ply(angle))
    return total


def integrated_shear(layup: tuple[float, ...], thickness: float) -> np.ndarray:
    """A_s by adaptive quadrature of the energy of the stresses that equilibrium demands, order (yz, xz).

    Q_x = 1 goes with dM_x/dx = 1 and Q_y = 1 with dM_y/dy = 1, nothing else changing along the plate.
    Then tau_xz(z) = -int d sigma_x / dx and tau_yz(z) = -int d tau_xy / dx from the bottom for Q_x,
    and likewise for Q_y.
    """
    z = np.linspace(-thickness / 2, thickness / 2, len(layup) + 1)
    plies = [rotated_ply(angle) for angle in layup]
    shear_compliance = [np.linalg.inv(rotated_shear(angle)) for angle in layup]
    response = np.linalg.inv(summed(layup, thickness))[:, 3:]  # strains, curvatures of a unit moment

    def ply_at(level: float) -> int:
        return min(int(np.searchsorted(z, level, side="right")) - 1, len(layup) - 1)

    def stress_gradient(level: float) -> np.ndarray:
        """Rows (x, y, xy) of the stresses of unit dM_x and unit dM_y, (3, 2)."""
        strain = response[:3, :2] + level * response[3:, :2]
        return np.asarray(plies[ply_at(level)] @ strain)

    def integral(function: Callable[[float], np.ndarray], top: float) -> np.ndarray:
        inner = [float(level) for level in z[1:-1] if level < top]
        found = quad_vec(function, z[0], top, points=inner, epsrel=1e-12, epsabs=0.0, quadrature="gk15")
        return np.asarray(found[0])

    def energy(level: float) -> np.ndarray:
        flow = integral(stress_gradient, level)
        yz = -np.array([flow[1, 1], flow[2, 0]])  # from Q_y, from Q_x
        xz = -np.array([flow[2, 1], flow[0, 0]])
        tau = np.stack((yz, xz))
        return np.asarray(tau.T @ shear_compliance[ply_at(level)] @ tau)

    return np.asarray(np.linalg.inv(integral(energy, float(z[-1]))))


def block_scales(stiffness: np.ndarray) -> np.ndarray:
    """Root of the largest diagonal entry of its block for every strain: A, B, D and A_s differ in unit."""
    scale = np.sqrt(np.abs(np.diagonal(stiffness)))
    for block in (MEMBRANE, CURVATURE, SHEAR):
        scale[block] = scale[block].max(initial=0.0)
    return np.asarray(scale)


def close(found: np.ndarray, expected: np.ndarray, digits: float = 1e-12) -> None:
    """Equal to rounding of the largest entries, block by block."""
    scale = block_scales(expected)
    np.testing.assert_allclose(
        found / scale[:, None] / scale, expected / scale[:, None] / scale, rtol=0, atol=digits
    )


# A, B, D


@pytest.mark.parametrize("angle", [-90.0, -63.0, -45.0, -10.0, 0.0, 30.0, 45.0, 77.0, 90.0])
def test_a_turned_ply_is_the_turned_tensor(angle: float) -> None:
    found = stiffness((angle,))
    q = rotated_ply(angle)
    expected = np.zeros((8, 8))
    expected[MEMBRANE, MEMBRANE] = q * THICKNESS
    expected[CURVATURE, CURVATURE] = q * THICKNESS**3 / 12
    expected[SHEAR, SHEAR] = rotated_shear(angle) * THICKNESS
    close(stiffness((angle,), shear=UNCORRECTED), expected)
    close(found[:6, :6], expected[:6, :6])


@layups
def test_a_b_and_d_are_the_sums_over_the_plies(layup: tuple[float, ...]) -> None:
    found = stiffness(layup)
    expected = summed(layup)
    close(found[:6, :6], expected)
    assert np.all(found[:6, 6:] == 0.0)
    assert np.all(found[6:, :6] == 0.0)
    np.testing.assert_array_equal(found, found.T)


def test_unidirectional_plate_has_the_constants_of_its_ply() -> None:
    e1, e2, nu12, g12 = CARBON["E1"], CARBON["E2"], CARBON["nu12"], CARBON["G12"]
    over = 1 - nu12**2 * e2 / e1
    q = np.array([[e1 / over, nu12 * e2 / over, 0], [nu12 * e2 / over, e2 / over, 0], [0, 0, g12]])
    found = stiffness((0.0,) * 20)
    close(found[:6, :6], np.kron(np.diag([THICKNESS, THICKNESS**3 / 12]), q))


def test_unsymmetric_cross_ply_couples_by_b11_and_b22_alone() -> None:
    found = stiffness((0.0, 90.0))
    q11, q22 = rotated_ply(0.0)[0, 0], rotated_ply(0.0)[1, 1]
    b11 = THICKNESS**2 / 8 * (q22 - q11)  # the stiff ply is below the midplane
    expected = np.diag([b11, -b11, 0.0])
    np.testing.assert_allclose(found[MEMBRANE, CURVATURE], expected, rtol=0, atol=1e-12 * abs(b11))
    assert b11 < 0


def test_unsymmetric_angle_ply_couples_stretching_with_twisting_alone() -> None:
    found = stiffness((45.0, -45.0))
    q16 = rotated_ply(45.0)[0, 2]
    b16 = -(THICKNESS**2) / 4 * q16
    expected = np.array([[0, 0, b16], [0, 0, b16], [b16, b16, 0]])  # Q16 = Q26 at 45 degrees
    np.testing.assert_allclose(found[MEMBRANE, CURVATURE], expected, rtol=0, atol=1e-12 * abs(b16))
    for block in (MEMBRANE, CURVATURE):
        assert np.abs(found[block, block][:2, 2]).max() < 1e-12 * found[block, block][0, 0]


@pytest.mark.parametrize(
    "layup",
    [CROSS_PLY_16S, ANGLE_PLY_16S, (20.0, -70.0, 20.0), (0.0,)],
    ids=["cross", "angle", "odd", "one"],
)
def test_symmetric_layup_has_no_coupling_at_all(layup: tuple[float, ...]) -> None:
    assert np.all(stiffness(layup)[MEMBRANE, CURVATURE] == 0.0)


# A_s


def test_single_ply_has_five_sixths_of_its_shear_moduli() -> None:
    found = stiffness((0.0,))[SHEAR, SHEAR]
    expected = 5 / 6 * THICKNESS * np.diag([PLY["G23"], PLY["G13"]])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13 * expected.max())


@pytest.mark.parametrize("angle", [90.0, -90.0])
def test_single_ply_across_exchanges_its_shear_moduli(angle: float) -> None:
    found = stiffness((angle,))[SHEAR, SHEAR]
    expected = 5 / 6 * THICKNESS * np.diag([PLY["G13"], PLY["G23"]])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * expected.max())


@pytest.mark.parametrize("layup", [(0.0,), (0.0, 90.0), (30.0, -50.0, 10.0)], ids=["one", "two", "three"])
def test_isotropic_plate_has_five_sixths_however_it_is_cut_into_plies(layup: tuple[float, ...]) -> None:
    found = stiffness(layup, ISOTROPIC)[SHEAR, SHEAR]
    g = float(ISOTROPIC["G12"])
    np.testing.assert_allclose(
        found, 5 / 6 * g * THICKNESS * np.eye(2), rtol=1e-12, atol=1e-12 * g * THICKNESS
    )


@pytest.mark.parametrize(
    "name", ["off-axis", "cross", "angle", "symmetric-cross", "odd-symmetric", "general"]
)
def test_shear_stiffness_is_the_energy_of_the_equilibrium_stresses(name: str) -> None:
    expected = integrated_shear(LAYUPS[name], THICKNESS)
    found = stiffness(LAYUPS[name])[SHEAR, SHEAR]
    # the quadratures ask for 1e-12; their sums and two inversions leave a few digits less
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * expected.max())


@pytest.mark.parametrize(
    ("ratios", "k13", "k23"),
    [((25.0, 0.5, 0.2), 0.6808, 0.6794), ((40.0, 0.6, 0.5), 0.8316, 0.8208)],
    ids=["E1=25", "E1=40"],
)
def test_shear_factors_of_a_120_ply_cross_ply_are_those_of_vlachoutsis(
    ratios: tuple[float, float, float], k13: float, k23: float
) -> None:
    # Vlachoutsis, Int. J. Numer. Meth. Engng 33 (1992), four digits, as quoted in the tests of the
    # package composites. His factors leave Poisson's coupling out, which is below the last digit here.
    e1, g13, g23 = ratios
    constants = {"E1": e1, "E2": 1.0, "nu12": 0.25, "G12": g13, "G13": g13, "G23": g23}
    layup = (0.0, 90.0) * 30 + (90.0, 0.0) * 30
    found, plain = (
        stiffness(layup, constants, 1.0, m)[SHEAR, SHEAR] for m in (ENERGY_CONSISTENT, UNCORRECTED)
    )
    factor = np.diagonal(found) / np.diagonal(plain)
    np.testing.assert_allclose(factor, [k23, k13], rtol=0, atol=5e-5)


def test_shear_stiffness_of_a_carbon_cross_ply_is_rohwers() -> None:
    # Rohwer, DLR-FB 88-14 (1988), as quoted in the tests of the package composites: [0/90]_s of unit
    # thickness, in units of 1 kN/mm: A55 = 2.313 and A44 = 2.521. The first is met to its last digit,
    # the second to 0.17 %, by the rounding of the ply constants that are printed.
    constants = {"E1": 138.0, "E2": 9.3, "nu12": 0.3, "G12": 4.6, "G13": 4.6, "G23": 2.3}
    found = stiffness((0.0, 90.0, 90.0, 0.0), constants, 1.0)[SHEAR, SHEAR]
    assert found[1, 1] == pytest.approx(2.313, abs=5e-4)
    assert found[0, 0] == pytest.approx(2.521, rel=2e-3)
    assert found[0, 1] == pytest.approx(0.0, abs=1e-12)


@layups
def test_shear_stiffness_is_below_that_of_equal_shear_strains(layup: tuple[float, ...]) -> None:
    # int G gamma^2 over the true strains is least for a constant one: int G is an upper bound
    bound = stiffness(layup, shear=UNCORRECTED)[SHEAR, SHEAR]
    found = stiffness(layup)[SHEAR, SHEAR]
    assert np.all(np.linalg.eigvalsh(found) > 0)
    assert np.all(np.linalg.eigvalsh(bound - found) > 0)


# Invariances


@layups
@shear_models
def test_a_quarter_turn_of_the_layup_exchanges_the_axes(layup: tuple[float, ...], shear: ShearModel) -> None:
    turned = stiffness(np.asarray(layup) + 90.0, shear=shear)
    order = np.array([1, 0, 2, 4, 3, 5, 7, 6])
    sign = np.array([1, 1, -1, 1, 1, -1, 1, -1])  # shears change sign, one of the two transverse ones
    expected = stiffness(layup, shear=shear)[np.ix_(order, order)] * sign[:, None] * sign
    close(turned, expected)


@layups
@shear_models
def test_negated_angles_flip_the_terms_16_26_and_45(layup: tuple[float, ...], shear: ShearModel) -> None:
    sign = np.array([1, 1, -1, 1, 1, -1, 1, -1])
    expected = stiffness(layup, shear=shear) * sign[:, None] * sign
    close(stiffness(-np.asarray(layup), shear=shear), expected)


@layups
@shear_models
def test_a_layup_upside_down_flips_the_coupling_alone(layup: tuple[float, ...], shear: ShearModel) -> None:
    sign = np.array([1, 1, 1, -1, -1, -1, 1, 1])
    expected = stiffness(layup, shear=shear) * sign[:, None] * sign
    close(stiffness(layup[::-1], shear=shear), expected)


@layups
@shear_models
def test_splitting_every_ply_changes_nothing(layup: tuple[float, ...], shear: ShearModel) -> None:
    whole = stiffness(layup, shear=shear)
    split = np.repeat(layup, 3)
    close(stiffness(split, shear=shear), whole)
    close(stiffness(split[None], shear=shear)[0], whole)  # a stack of layups does not merge plies


@layups
def test_a_symmetric_layup_is_integrated_over_half_or_over_all_alike(layup: tuple[float, ...]) -> None:
    both = np.array([*layup, *layup[::-1]])
    half = laminate_geometry(both, symmetric=True)
    whole = laminate_geometry(both, symmetric=False)
    assert half.symmetric
    assert not whole.symmetric
    close(
        laminate_stiffness(PLY, half, THICKNESS),
        laminate_stiffness(PLY, whole, THICKNESS),
    )


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_thickness_scales_a_b_d_and_a_s_by_its_powers(factor: float) -> None:
    layup = LAYUPS["general"]
    thin, thick = stiffness(layup), stiffness(layup, thickness=factor * THICKNESS)
    power = np.array([0, 0, 0, 1, 1, 1, 0, 0])
    np.testing.assert_allclose(thick, thin * factor ** (1.0 + power[:, None] + power), rtol=1e-13)


# Derivatives and stacks


@layups
@shear_models
@pytest.mark.parametrize("name", [*PLY, "thickness"])
def test_complex_step_derivative_is_the_difference_quotient(
    layup: tuple[float, ...], shear: ShearModel, name: str
) -> None:
    values = PLY | {"thickness": THICKNESS}

    def at(value: complex) -> np.ndarray:
        own: dict[str, complex] = dict(values) | {name: value}
        return stiffness(layup, own, own.pop("thickness"), shear)

    p = values[name]
    step = 1e-4 * p
    exact = p * at(p + 1e-30j * p).imag / (1e-30 * p)
    slopes = [(at(p + k * step).real - at(p - k * step).real) * p / (2 * k * step) for k in (1, 2)]
    # Richardson's error is of the order (1e-4)^4, rounding 1e-15 / 1e-4: 1e-10 of the block leaves room
    same_slope(exact, (4 * slopes[0] - slopes[1]) / 3, at(p).real)


@pytest.mark.parametrize("ply", range(5))
@shear_models
def test_complex_step_derivative_by_an_angle_is_the_difference_quotient(ply: int, shear: ShearModel) -> None:
    layup = np.array(LAYUPS["general"])

    def at(change: complex) -> np.ndarray:
        return stiffness(layup + change * np.eye(5)[ply], shear=shear)

    exact = at(1e-30j).imag / 1e-30
    slopes = [(at(k * 1e-2) - at(-k * 1e-2)).real / (2 * k * 1e-2) for k in (1, 2)]
    same_slope(exact, (4 * slopes[0] - slopes[1]) / 3, at(0.0).real)


def same_slope(found: np.ndarray, expected: np.ndarray, whole: np.ndarray) -> None:
    """Derivatives equal to 1e-10 of the largest entries of the stiffness, block by block."""
    scale = block_scales(whole)
    found, expected = found / scale[:, None] / scale, expected / scale[:, None] / scale
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)
    assert np.abs(expected).max() > 1e-6, "a derivative that is zero proves nothing"


@shear_models
@pytest.mark.parametrize("symmetric", [True, False])
def test_a_stack_of_layups_and_constants_equals_the_loop(shear: ShearModel, symmetric: bool) -> None:
    rng = np.random.default_rng(5)
    n = 7
    angles = rng.uniform(-90.0, 90.0, size=(n, 4))
    if symmetric:
        angles = np.concatenate((angles, angles[:, ::-1]), axis=1)
    constants = {name: value * rng.uniform(0.8, 1.2, size=n) for name, value in PLY.items()}
    thickness = rng.uniform(0.001, 0.01, size=n)
    stack = laminate_stiffness(constants, angles, thickness, shear)
    assert stack.shape == (n, 8, 8)
    for i in range(n):
        own = {name: value[i] for name, value in constants.items()}
        close(stack[i], stiffness(angles[i], own, thickness[i], shear))


@shear_models
@layups
def test_a_stack_of_constants_on_one_layup_equals_the_loop(
    layup: tuple[float, ...], shear: ShearModel
) -> None:
    rng = np.random.default_rng(6)
    constants = {name: value * rng.uniform(0.8, 1.2, size=(3, 2)) for name, value in PLY.items()}
    stack = laminate_stiffness(constants, laminate_geometry(layup), THICKNESS, shear)
    assert stack.shape == (3, 2, 8, 8)
    for i in np.ndindex(3, 2):
        close(stack[i], stiffness(layup, {name: value[i] for name, value in constants.items()}, shear=shear))


# Engineering constants


def test_flexural_constants_of_an_isotropic_plate_are_its_own() -> None:
    found = flexural_constants(stiffness((0.0,), ISOTROPIC), THICKNESS)
    d = 70e9 * THICKNESS**3 / 12 / (1 - 0.3**2)
    expected = {
        "Ex": 70e9,
        "Ey": 70e9,
        "Gxy": float(ISOTROPIC["G12"]),
        "nuxy": 0.3,
        "D11": d,
        "D22": d,
        "D12": 0.3 * d,
        "D66": 0.35 * d,
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    assert abs(found["D16"]) < 1e-12 * d
    assert abs(found["D26"]) < 1e-12 * d


def test_flexural_constants_of_a_unidirectional_plate_are_its_plys() -> None:
    found = flexural_constants(stiffness((0.0,) * 4), THICKNESS)
    expected = {"Ex": PLY["E1"], "Ey": PLY["E2"], "Gxy": PLY["G12"], "nuxy": PLY["nu12"]}
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-12)


def test_flexural_modulus_of_an_unsymmetric_strip_lets_it_stretch() -> None:
    # without Poisson's effect the neutral axis of [0/90] is the centroid of its two stiffnesses
    constants = PLY | {"nu12": 0.0}
    e1, e2, h = constants["E1"], constants["E2"], THICKNESS
    centre = h / 4 * (e2 - e1) / (e1 + e2)
    steiner = e1 * (h / 4 + centre) ** 2 + e2 * (h / 4 - centre) ** 2
    per_width = (e1 + e2) * (h / 2) ** 3 / 12 + h / 2 * steiner
    found = flexural_constants(stiffness((0.0, 90.0), constants), h)
    assert found["Ex"] == pytest.approx(12 / h**3 * per_width, rel=1e-12)
    assert found["Ey"] == pytest.approx(found["Ex"], rel=1e-12)
