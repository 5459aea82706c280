"""Laminate stiffness of one and several materials, and the constants that a symmetry allows."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import ArrayLike
from scipy.integrate import quad_vec

from cpam_bayes.plate import laminate
from cpam_bayes.plate.laminate import SHEAR, complete_constants, laminate_geometry, laminate_stiffness
from tests.plates import ANGLE_PLY_16S, CARBON, GLASS

# G12, G13, G23 differ: a wrong index shows
PLY = CARBON | {"G13": 5.1e9, "G23": 3.0e9}
ISOTROPIC = complete_constants({"E1": 70e9, "nu12": 0.3}, "isotropic")
THICKNESS = 0.0032
COMPOSITE = "transversely_isotropic"
UNCORRECTED = laminate.ShearModel(1.0)
LAYUPS = {
    "single": (0.0,),
    "off-axis": (35.0,),
    "cross": (0.0, 90.0),
    "angle": (45.0, -45.0),
    "symmetric-cross": (0.0, 90.0, 90.0, 0.0),
    "odd-symmetric": (20.0, -70.0, 20.0),
    "general": (10.0, -65.0, 40.0, 80.0, -25.0),
    "thirty-two": ANGLE_PLY_16S,
}
shear_models = pytest.mark.parametrize(
    "shear", [laminate.ENERGY_CONSISTENT, laminate.FIVE_SIXTHS], ids=["energy", "5/6"]
)
VLACHOUTSIS = [(25.0, 0.5, 0.2, 0.6808, 0.6794), (40.0, 0.6, 0.5, 0.8316, 0.8208)]
FABRIC = {"E1": 60e9, "E2": 60e9, "nu12": 0.05, "G12": 4e9}


def stiffness(
    layup: ArrayLike,
    constants: Mapping[str, ArrayLike] = PLY,
    thickness: ArrayLike = THICKNESS,
    shear: laminate.ShearModel = laminate.ENERGY_CONSISTENT,
) -> np.ndarray:
    return laminate_stiffness(constants, np.asarray(layup), thickness, shear)


def rotated_ply(angle_deg: float, constants: Mapping[str, float] = PLY) -> np.ndarray:
    """Plane-stress stiffness (3, 3) of a rotated ply, as a fourth-order tensor."""
    e1, e2, nu12, g12 = (float(constants[name]) for name in ("E1", "E2", "nu12", "G12"))
    compliance = np.array([[1 / e1, -nu12 / e1, 0], [-nu12 / e1, 1 / e2, 0], [0, 0, 1 / g12]])
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.array([[c, s], [-s, c]])  # components in the ply's axes of a vector in x, y
    place = np.array([[0, 2], [2, 1]])  # index of each pair of axes among 11, 22, 12
    tensor = np.linalg.inv(compliance)[place[:, :, None, None], place]
    turned = np.einsum("ia,jb,kc,ld,ijkl->abcd", turn, turn, turn, turn, tensor)
    first, second = [0, 1, 0], [0, 1, 1]
    return np.asarray(turned[first, second][:, first, second])


def rotated_shear(angle_deg: float, constants: Mapping[str, float] = PLY) -> np.ndarray:
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.array([[c, -s], [s, c]])  # (gamma_23, gamma_13) from (gamma_yz, gamma_xz)
    return np.asarray(turn.T @ np.diag([constants["G23"], constants["G13"]]) @ turn)


def interfaces(layup: Sequence[float], heights: Sequence[float] = ()) -> np.ndarray:
    return THICKNESS * (np.cumsum([0.0, *(heights or np.full(len(layup), 1.0 / len(layup)))]) - 0.5)


def summed(
    layup: Sequence[float], heights: Sequence[float] = (), constants: Sequence[Mapping[str, float]] = ()
) -> np.ndarray:
    """[A B 0; B D 0; 0 0 A_s] by a sum over plies, A_s without a shear factor, (8, 8)."""
    total = np.zeros((8, 8))
    z = interfaces(layup, heights)
    for angle, ply, bottom, top in zip(layup, constants or [PLY] * len(layup), z[:-1], z[1:], strict=True):
        moments = [(top**k - bottom**k) / k for k in (1, 2, 3)]
        total[:6, :6] += np.kron([moments[:2], moments[1:]], rotated_ply(angle, ply))
        total[SHEAR, SHEAR] += rotated_shear(angle, ply) * moments[0]
    return total


def integrated_shear(layup: tuple[float, ...]) -> np.ndarray:
    """A_s by adaptive quadrature of the energy of the equilibrium stresses, order (yz, xz).
    Q_x = 1 implies dM_x/dx = 1 and Q_y = 1 implies dM_y/dy = 1, with nothing else varying along the plate.
    Then tau_xz(z) = -int d sigma_x / dx and tau_yz(z) = -int d tau_xy / dx from the bottom for Q_x, and
    likewise for Q_y."""
    z = interfaces(layup)
    plies = [rotated_ply(angle) for angle in layup]
    shear_compliance = [np.linalg.inv(rotated_shear(angle)) for angle in layup]
    response = np.linalg.inv(summed(layup)[:6, :6])[:, 3:]  # strains and curvatures due to a unit moment

    def ply_at(level: float) -> int:
        return min(int(np.searchsorted(z, level, side="right")) - 1, len(layup) - 1)

    def stress_gradient(level: float) -> np.ndarray:
        """Rows (x, y, xy) of the stresses due to unit dM_x and unit dM_y, (3, 2)."""
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
    """Root of the largest diagonal entry of each strain's block: A, B, D and A_s differ in unit."""
    scale = np.sqrt(np.abs(np.diagonal(stiffness)))
    for block in (laminate.MEMBRANE, laminate.CURVATURE, SHEAR):
        scale[block] = scale[block].max(initial=0.0)
    return np.asarray(scale)


def close(found: np.ndarray, expected: np.ndarray, digits: float = 1e-12) -> None:
    scale = block_scales(expected)[:, None] * block_scales(expected)
    assert_allclose(found / scale, expected / scale, rtol=0, atol=digits)


@pytest.mark.parametrize("layup", LAYUPS.values(), ids=LAYUPS)
def test_stiffness_is_the_sum_over_plies_without_coupling_by_symmetry(layup: tuple[float, ...]) -> None:
    found, expected = stiffness(layup), summed(layup)
    close(found[:6, :6], expected[:6, :6])
    assert np.all(found[:6, 6:] == 0.0)
    np.testing.assert_array_equal(found, found.T)
    assert np.all(found[laminate.MEMBRANE, laminate.CURVATURE] == 0.0) == (layup == layup[::-1])
    close(stiffness(layup, shear=UNCORRECTED), expected)
    close(stiffness(layup, shear=laminate.FIVE_SIXTHS)[SHEAR, SHEAR], expected[SHEAR, SHEAR] * 5 / 6)


@pytest.mark.parametrize("name", [name for name in LAYUPS if name != "thirty-two"])
def test_shear_stiffness_is_the_energy_of_the_equilibrium_stresses(name: str) -> None:
    expected = integrated_shear(LAYUPS[name])
    # the quadratures ask for 1e-12; their sums and two inversions lose a few digits
    assert_allclose(stiffness(LAYUPS[name])[SHEAR, SHEAR], expected, rtol=0, atol=1e-10 * expected.max())


@pytest.mark.parametrize(("e1", "g13", "g23", "k13", "k23"), VLACHOUTSIS)
def test_shear_factors_of_a_120_ply_cross_ply_are_those_of_vlachoutsis(e1, g13, g23, k13, k23) -> None:
    # Vlachoutsis, Int. J. Numer. Meth. Engng 33 (1992), four digits, as quoted in the tests of the package
    # composites. His factors omit Poisson's coupling, which is below the last digit here.
    constants = {"E1": e1, "E2": 1.0, "nu12": 0.25, "G12": g13, "G13": g13, "G23": g23}
    layup = (0.0, 90.0) * 30 + (90.0, 0.0) * 30
    both = (stiffness(layup, constants, 1.0, model) for model in (laminate.ENERGY_CONSISTENT, UNCORRECTED))
    found, plain = (np.diagonal(one[SHEAR, SHEAR]) for one in both)
    assert_allclose(found / plain, [k23, k13], rtol=0, atol=5e-5)


@pytest.mark.parametrize("layup", [LAYUPS["symmetric-cross"], LAYUPS["general"]])
@shear_models
@pytest.mark.parametrize("name", [*PLY, "thickness"])
def test_complex_step_derivative_is_the_difference_quotient(layup, shear, name: str) -> None:
    values = PLY | {"thickness": THICKNESS}

    def at(value: complex) -> np.ndarray:
        own = values | {name: value}
        return stiffness(layup, own, own.pop("thickness"), shear)

    p = values[name]
    step = 1e-4 * p
    exact = p * at(p + 1e-30j * p).imag / (1e-30 * p)
    slopes = [(at(p + k * step).real - at(p - k * step).real) * p / (2 * k * step) for k in (1, 2)]
    expected = (4 * slopes[0] - slopes[1]) / 3  # Richardson: (1e-4)^4, rounding 1e-15 / 1e-4
    scale = block_scales(at(p).real)
    assert np.all(np.abs(exact - expected) <= 1e-10 * scale[:, None] * scale)
    assert np.abs(expected / scale[:, None] / scale).max() > 1e-6, "a derivative that is zero proves nothing"


@shear_models
@pytest.mark.parametrize("symmetric", [True, False])
def test_a_stack_of_layups_and_constants_equals_the_loop(shear: laminate.ShearModel, symmetric: bool) -> None:
    rng = np.random.default_rng(5)
    angles = rng.uniform(-90.0, 90.0, size=(7, 4))
    if symmetric:
        angles = np.concatenate((angles, angles[:, ::-1]), axis=1)
    constants = {name: value * rng.uniform(0.8, 1.2, size=7) for name, value in PLY.items()}
    thickness = rng.uniform(0.001, 0.01, size=7)
    stack = laminate_stiffness(constants, angles, thickness, shear)
    assert stack.shape == (7, 8, 8)
    for i in range(7):
        own = {name: value[i] for name, value in constants.items()}
        close(stack[i], stiffness(angles[i], own, thickness[i], shear))


def test_flexural_constants_of_one_material_are_its_own() -> None:
    found = laminate.flexural_constants(stiffness((0.0,), ISOTROPIC), THICKNESS)
    d = 70e9 * THICKNESS**3 / 12 / (1 - 0.3**2)
    rigidity = {"D11": d, "D22": d, "D12": 0.3 * d, "D66": 0.35 * d}
    expected = {"Ex": 70e9, "Ey": 70e9, "Gxy": float(ISOTROPIC["G12"]), "nuxy": 0.3, **rigidity}
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    assert max(abs(found["D16"]), abs(found["D26"])) < 1e-12 * d
    plies = laminate.flexural_constants(stiffness((0.0,) * 4), THICKNESS)
    expected = {"Ex": PLY["E1"], "Ey": PLY["E2"], "Gxy": PLY["G12"], "nuxy": PLY["nu12"]}
    assert {name: plies[name] for name in expected} == pytest.approx(expected, rel=1e-12)


def test_flexural_modulus_of_an_unsymmetric_strip_lets_it_stretch() -> None:
    constants = PLY | {"nu12": 0.0}  # nu = 0: the neutral axis of [0/90] is the stiffness centroid
    e1, e2, h = constants["E1"], constants["E2"], THICKNESS
    centre = h / 4 * (e2 - e1) / (e1 + e2)
    steiner = e1 * (h / 4 + centre) ** 2 + e2 * (h / 4 - centre) ** 2
    per_width = (e1 + e2) * (h / 2) ** 3 / 12 + h / 2 * steiner
    found = laminate.flexural_constants(stiffness((0.0, 90.0), constants), h)
    assert found["Ex"] == pytest.approx(12 / h**3 * per_width, rel=1e-12)
    assert found["Ey"] == pytest.approx(found["Ex"], rel=1e-12)


def named(**materials: dict[str, float]) -> dict[str, np.ndarray]:
    of = {n: complete_constants(c, COMPOSITE if "E2" in c else "isotropic") for n, c in materials.items()}
    return {f"{name}.{key}": value for name, constants in of.items() for key, value in constants.items()}


def stack(thickness: list[float], material: list[int], names: tuple[str, ...]) -> laminate.PlyStack:
    z = np.cumsum([0.0, *thickness]) / np.sum(thickness) - 0.5
    return laminate.PlyStack(z, np.array(material), np.ones(len(material)), names)


@shear_models
@pytest.mark.parametrize("angles", [[0, 45, 90, 90, 45, 0], [0, 30, -60, 90], [0, 0, 20, 90, 15, 15]])
def test_two_equal_materials_are_one(angles: list[float], shear: laminate.ShearModel) -> None:
    plain = laminate_stiffness(complete_constants(CARBON, COMPOSITE), angles, THICKNESS, shear)
    plies = stack([1.0] * len(angles), [i % 2 for i in range(len(angles) // 2)] * 2, ("a", "b"))
    geometry = laminate_geometry(angles, plies=plies)
    close(laminate_stiffness(named(a=CARBON, b=CARBON), geometry, THICKNESS, shear), plain)


def test_a_hybrid_is_the_sum_over_its_plies() -> None:
    layup, heights, owner = [0.0, 90.0, 30.0], [0.4, 0.25, 0.35], [0, 1, 0]
    geometry = laminate_geometry(layup, plies=stack(heights, owner, ("c", "g")))
    glass = {name: float(value) for name, value in complete_constants(GLASS, COMPOSITE).items()}
    found = laminate_stiffness(named(c=PLY, g=GLASS), geometry, THICKNESS, UNCORRECTED)
    close(found, summed(layup, heights, [PLY, glass, PLY]))


def test_a_soft_core_between_thin_faces_carries_all_the_shear() -> None:
    """A_s of a sandwich tends to G d^2 / c; d between the middles of the faces, c the core (Allen, 1969)."""
    face, core = {"E1": 70e9, "nu12": 0.3}, {"E1": 2.6e7, "nu12": 0.3}
    t = 0.01
    geometry = laminate_geometry([0.0] * 3, plies=stack([t, 1 - 2 * t, t], [0, 1, 0], ("f", "c")))
    shear = laminate_stiffness(named(f=face, c=core), geometry, 1.0)[6:, 6:]
    expected = 1e7 * (1 - t) ** 2 / (1 - 2 * t)
    assert_allclose(shear, expected * np.eye(2), rtol=2e-3, atol=1e-6 * expected)


@pytest.mark.parametrize("angles", [[0, 45, 45, 0], [0, 45, 90, -30]])
def test_first_order_of_a_hybrid_is_its_complex_step(angles: list[float]) -> None:
    plies = stack([2.0, 1.0, 1.0, 2.0], [0, 1, 1, 0], ("a", "b"))
    constants = named(a=CARBON, b=GLASS)
    names = ["a.E1", "a.nu12", "a.G23", "b.E2", "b.G12", "b.G13"]
    along = {name: constants[name] * (1.0 + 1e-25j * np.eye(7)[i]) for i, name in enumerate(names)}
    h = THICKNESS * (1.0 + 1e-25j * np.eye(7)[6])
    found = laminate.first_order_stiffness({**constants, **along}, laminate_geometry(angles, plies=plies), h)
    # a stack of layups has no closed form
    expected = laminate_stiffness({**constants, **along}, laminate_geometry([angles], plies=plies), h)
    for part in (np.real, np.imag):
        size = np.abs(part(expected)).max(axis=(1, 2), keepdims=True)
        assert np.all(size > 0.0)
        assert np.all(np.abs(part(found) - part(expected)) <= 1e-12 * size)


def test_left_out_constants_follow_eq_6_and_11_or_the_in_plane_one_given_ones_stay_and_others_are_refused():
    full = complete_constants(CARBON, COMPOSITE)
    nu23 = 0.23 * (1 - 0.23 * 9.34 / 121.2) / (1 - 0.23)
    assert full["G13"] == CARBON["G12"]
    assert full["G23"] == pytest.approx(9.34e9 / (2 * (1 + nu23)), rel=1e-14)
    woven = complete_constants(FABRIC, "orthotropic")
    assert woven["G13"] == woven["G23"] == FABRIC["G12"]
    for constants, symmetry in ((CARBON, COMPOSITE), (FABRIC, "orthotropic")):
        given = complete_constants(constants | {"G13": 5e9, "G23": 3e9}, symmetry)
        assert (given["G13"], given["G23"]) == (5e9, 3e9)
    metal = complete_constants({"E1": 69e9, "nu12": 0.33}, "isotropic")
    assert metal["E2"] == 69e9
    assert metal["G12"] == metal["G13"] == metal["G23"] == pytest.approx(25.94e9, abs=0.005e9)  # eq. (11)
    for names, symmetry in (("E1 nu12 E2", "isotropic"), ("E1", "isotropic"), ("E1 E2 nu12", "orthotropic")):
        with pytest.raises(ValueError, match="required"):
            complete_constants(dict.fromkeys(names.split(), 0.3), symmetry)


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        *(({}, []), ({"E2": 130e9}, [3]), ({"E1": 9.34e9}, [3]), ({"nu12": 0.6}, [0, 1])),
        *(({"E1": 10e9, "E2": 9e9, "nu12": 1.2}, [0, 2]), ({"nu12": float("nan")}, [0, 1, 2])),
    ],
)
def test_each_constraint_of_eq_9_is_seen(change, broken):
    assert list(np.flatnonzero(laminate.constraint_violations(CARBON | change, COMPOSITE))) == broken


def test_moduli_are_positive_and_isotropic_poissons_ratios_within_minus_one_and_half():
    for nu in (-1.01, -0.99, 0.0, 0.499, 0.501, 1.0):
        assert laminate.is_admissible({"E1": 69e9, "nu12": nu}, "isotropic") == (-1.0 < nu < 0.5)
    constants = CARBON | {"G13": 5e9, "G23": 3e9}
    assert laminate.is_admissible(constants, COMPOSITE)
    for name in ("E1", "E2", "G12", "G13", "G23"):
        assert not laminate.is_admissible(constants | {name: 0.0}, COMPOSITE)
        assert not laminate.is_admissible(constants | {name: -1e9}, COMPOSITE)


@pytest.mark.parametrize("ratio", [0.05, 0.5, 1.0, 3.0, 15.0])
def test_an_orthotropic_ply_is_positive_definite_and_no_more_is_asked_of_it(ratio):
    for nu12 in (-4.0, -1.5, -0.9, -0.2, 0.0, 0.2, 0.6, 0.99, 1.7, 4.0):
        compliance = [[1.0, -nu12], [-nu12, ratio]]  # plane-stress compliance, first entry scaled to one
        constants = {"E1": ratio, "E2": 1.0, "nu12": nu12, "G12": 0.1}
        assert laminate.is_admissible(constants, "orthotropic") == (np.linalg.eigvalsh(compliance)[0] > 0.0)
