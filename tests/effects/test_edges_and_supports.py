"""Strips, missing corners, soft supports, pads: closed forms, places alike, and independent elements."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.sparse import csr_array

from cpam_bayes.effects import Effect, PlateFacts, applicable, extend, scale_of, variants
from cpam_bayes.effects.edges import SOFT_SUPPORT, SUPPORT
from cpam_bayes.effects.geometry import OUTLINE, _cut
from cpam_bayes.effects.masses import EDGE_MASS
from cpam_bayes.mechanics.problem import Problem
from cpam_bayes.plate.layup import parse_layup
from tests.effects.cases import BY_NAME, SUPPORTED, bare, facts, facts_of, frequencies
from tests.plates import plate
from validation.independent import elements, true_plate
from validation.independent.true_plate import Patch, TruePlate, natural_frequencies

# A strip so narrow that it is a beam, h / a = 1 / 300.
ALUMINIUM = {"E1": 70e9, "nu12": 0.0}
LENGTH, WIDTH, HEIGHT, DENSITY = 0.3, 0.02, 1e-3, 2700.0
BEAM_MASS = LENGTH * WIDTH * HEIGHT * DENSITY
RIGIDITY = 70e9 * HEIGHT**3 / 12


def beam(edges: str) -> Problem:
    return plate(LENGTH, WIDTH, HEIGHT, DENSITY, ALUMINIUM, edges=edges)


def first_of_a_beam(b: float) -> float:
    """Hz, of the frequency parameter b of a beam."""
    return float(b**2 / (2 * np.pi) * np.sqrt(RIGIDITY / (DENSITY * HEIGHT)) / LENGTH**2)


def strip(edge: str, of: PlateFacts) -> Effect:
    (found,) = (form for form in variants(EDGE_MASS, of) if form.variant == f"along {edge}")
    return found


# A strip of mass


@pytest.mark.parametrize("share", [0.01, 0.05, 0.3])
def test_a_mass_along_its_tip_lowers_a_cantilever_as_a_tip_mass_does(share: float) -> None:
    b = brentq(
        lambda b: 1 + np.cos(b) * np.cosh(b) + share * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b)),
        0.5,
        1.8752,
    )
    problem = beam("CFFF")
    loaded = extend(problem, strip("x = length", facts_of(problem)), facts_of(problem))
    (found,) = frequencies(loaded, {"edge_mass": share * BEAM_MASS}, n=1, degree=10)
    # the rotary inertia of a tip half a thickness off, (h / a)^2 = 1e-5, and shear
    assert found == pytest.approx(first_of_a_beam(b), rel=2e-4)


def test_a_mass_on_one_edge_adds_its_rigid_body_energy() -> None:
    for edge in ("x = length", "y = width"):
        problem = extend(bare("C1"), strip(edge, facts("C1")), facts("C1"))
        m, n = 4e-3, problem.nominal
        plain, heavy = (problem.coefficients({"edge_mass": np.array([x])}, "mass")[0] for x in (0.0, m))
        added = (heavy - plain)[len(bare("C1").forms("mass")) :]
        turning = m * (float(n.thickness) / 2) ** 2
        np.testing.assert_allclose(added, [m, m, m, turning, turning], rtol=1e-12)


# A corner that is missing


def test_a_strip_without_its_end_is_a_shorter_beam() -> None:
    problem = beam("CFFF")
    whole = replace(OUTLINE, change=partial(_cut, (1.0, 1.0, 1.0)))
    shorter = extend(problem, whole, facts_of(problem))
    # a square as wide as the strip
    cut_off = {"missing_area": 0.99 * WIDTH / LENGTH}
    f, full = (frequencies(p, v, n=1, degree=12) for p, v in ((shorter, cut_off), (problem, {})))
    # a hundredth of the end is left: it weighs 0.07 % of the strip, of which a tip mass counts four times
    assert f[0] / full[0] == pytest.approx((0.3 / 0.28) ** 2, rel=5e-3)


@pytest.mark.parametrize("weighed", [False, True])
def test_a_weighed_plate_keeps_its_mass_without_a_corner(weighed: bool) -> None:
    of = replace(facts("C1"), weighed=weighed)
    (form,) = (form for form in variants(OUTLINE, of) if form.place == (1.0, 1.0, 0.16))
    problem = extend(bare("C1"), form, of)
    missing = 0.5 * form.parameters[0].prior.upper
    share = 0.16**2 * min(of.length, of.width) / max(of.length, of.width)
    w, of_square = (problem.coefficients({"missing_area": np.array([missing])}, "mass")[0][i] for i in (2, 7))
    assert w + share * of_square == pytest.approx((1.0 if weighed else 1.0 - missing) * of.mass, rel=1e-12)


# Where the plate's symmetry makes places equal


@pytest.mark.parametrize(
    ("edges", "layup", "loaded", "mass", "strips", "corners"),
    [
        ("FFFF", None, False, (0.5, 0.5), ["x = length", "y = width"], [(1, 1)]),
        # half a turn alone
        ("FFFF", "[30/-30]_s", False, (0.5, 0.0), ["x = length", "y = width"], [(1, 1), (1, 0)]),
        (
            *("FFFF", None, True, (0.0, 0.0)),
            ["x = length", "y = width", "x = 0", "y = 0"],
            [(1, 1), (1, 0), (0, 1), (0, 0)],
        ),
        ("CFFF", None, False, (0.0, 0.5), ["x = length", "y = width"], [(1, 1)]),
        ("CFFF", None, True, (0.0, 0.0), ["x = length", "y = width", "y = 0"], [(1, 1), (1, 0)]),
        ("CFFF", "[30/-30]_s", False, (0.0, 0.0), ["x = length", "y = width", "y = 0"], [(1, 1), (1, 0)]),
        ("CFFS", None, False, (0.0, 0.0), ["x = length", "y = 0"], [(1, 0)]),
        ("FFCF", None, False, (0.0, 0.5), ["y = width", "x = 0"], [(0, 1)]),
        ("FCFS", None, False, (0.5, 0.0), ["x = length"], []),
        ("FFSC", None, False, (0.0, 0.0), ["x = 0", "y = 0"], [(0, 0)]),
        ("FSFS", None, False, (0.5, 0.5), ["x = length"], []),
        ("SCCS", None, False, (0.0, 0.0), [], []),
    ],
)
def test_places_free_edges_and_corners_that_look_alike_count_once(
    edges: str,
    layup: str | None,
    loaded: bool,
    mass: tuple[float, float],
    strips: list[str],
    corners: list[tuple[int, int]],
) -> None:
    of = replace(facts("C1"), edges=edges, loaded=loaded)
    of = replace(of, layup=parse_layup(layup)) if layup else of
    (anywhere,) = variants(BY_NAME["sensor_mass"], of)
    assert tuple(p.prior.lower for p in anywhere.coordinates[:2]) == mass
    assert {p.prior.upper for p in anywhere.coordinates[:2]} == {1.0}
    assert bool(anywhere.variant) == any(mass)
    carry = variants(EDGE_MASS, of)
    assert [form.variant for form in carry] == [f"along {edge}" for edge in strips]
    assert (EDGE_MASS in applicable(of)) == bool(strips)
    # of the plate's mass: one standard deviation, and at most
    for form, one, most in [(anywhere, 0.01, 0.1), *((form, 0.003, 0.05) for form in carry)]:
        size = form.parameters[0]
        assert (scale_of(size), size.prior.upper) == pytest.approx((one * of.mass, most * of.mass))
    missing = [form.place for form in variants(OUTLINE, of)]
    assert missing == [(*corner, extent) for corner in corners for extent in (0.06, 0.1, 0.16, 0.25)]


def test_edges_that_an_effect_may_act_along_are_marked() -> None:
    assert [form.edges(facts("C1")) for form in variants(EDGE_MASS, facts("C1"))] == [(2, 0), (3, 1)]  # type: ignore[misc]
    assert [form.edges(facts("A2")) for form in variants(EDGE_MASS, facts("A2"))] == [(2,), (3, 1)]  # type: ignore[misc]
    assert SOFT_SUPPORT.edges(facts(SUPPORTED)) == [0, 1, 2, 3]  # type: ignore[misc]


# A simple support that gives


def first_of_a_strip_on_springs(c: float) -> float:
    """Frequency parameter b of a beam on end springs k = pi^4 EI / (2 c a^3), symmetric: its first mode.

    w = cos(b s) + r cosh(b s), s from -1/2 to 1/2: w'' = 0 at the ends, and |EI w'''| = k w there.
    """

    def residual(b: float) -> float:
        half = b / 2
        r = np.cos(half) / np.cosh(half)
        force = b**3 * (np.sin(half) + r * np.sinh(half))
        return float(2 * c / np.pi**4 * force - (np.cos(half) + r * np.cosh(half)))

    return float(brentq(residual, 1e-3, np.pi))


@pytest.mark.parametrize("compliance", [0.01, 0.1, 0.5])
def test_a_strip_on_soft_supports_is_a_beam_on_end_springs(compliance: float) -> None:
    problem = beam("SFSF")
    soft = extend(problem, SOFT_SUPPORT, facts_of(problem))
    (found,) = frequencies(soft, {"support_compliance": compliance}, n=1, degree=10)
    # Poisson's ratio is zero; shear takes (h / a)^2
    assert found == pytest.approx(first_of_a_beam(first_of_a_strip_on_springs(compliance)), rel=2e-4)
    # Rayleigh: the reactions EI (pi / a)^3 of the mode do the work
    if compliance == 0.01:
        rigid = first_of_a_beam(np.pi)
        assert found / rigid - 1 == pytest.approx(-4 * compliance / np.pi**2, rel=0.02)


def test_only_simple_supports_give() -> None:
    for edges, is_supported in (("FFFF", False), ("CFFF", False), ("CFSF", True), ("SSSS", True)):
        of = replace(facts("C1"), edges=edges)
        assert (SOFT_SUPPORT in applicable(of)) == is_supported
    problem = plate(0.3, 0.2, 3e-3, DENSITY, ALUMINIUM, edges="CFSF")
    assert extend(problem, SOFT_SUPPORT, facts_of(problem)).edges == "CFWF"


# Pads

FORMS = variants(SUPPORT, facts("C1"))


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.variant)
def test_every_form_of_a_support_bounces_a_rigid_plate_at_its_frequency(form: Effect) -> None:
    problem = extend(bare("C1"), form, facts("C1"))
    assert problem.supported
    (term,) = (t for t in problem.terms if t.name == "support")
    hertz = np.array([0.0, 10.0, 30.0])
    stiffness = problem.coefficients({"support_frequency": hertz}, "stiffness")[:, -1]
    t, w = np.polynomial.legendre.leggauss(400)
    grid = np.stack(np.meshgrid((t + 1) / 2, (t + 1) / 2), axis=-1).reshape(-1, 2)
    weight = term.forms[0].weight
    share = 1.0 if weight is None else np.outer(w, w).ravel() @ weight(grid) / 4
    found = np.sqrt(stiffness * share / facts("C1").mass) / (2 * np.pi)
    np.testing.assert_allclose(found, hertz, rtol=1e-6)


# Elements of another origin

TRUE = TruePlate(0.26, 0.2, 2e-3, 2700.0, "FFFF", (0.0,), {"E1": 70e9, "nu12": 0.33}, 5 / 6)
N_MODES = 8


def of_true(edges: str = "FFFF") -> Problem:
    return plate(TRUE.length, TRUE.width, TRUE.thickness, TRUE.density, dict(TRUE.constants), edges=edges)


def of_package(effect: Effect, values: dict[str, float], edges: str = "FFFF") -> np.ndarray:
    """Relative shifts of the same plate by Ritz."""
    problem = of_true(edges)
    changed = extend(problem, effect, facts_of(problem))
    f, none = (frequencies(p, v, n=N_MODES, degree=13) for p, v in ((changed, values), (problem, {})))
    return f / none - 1


def of_elements(true: TruePlate) -> np.ndarray:
    """Relative shifts by the independent elements."""
    whole = replace(TRUE, edges=true.edges, mesh=true.mesh)
    return natural_frequencies(true, N_MODES) / natural_frequencies(whole, N_MODES) - 1


@pytest.mark.parametrize("edge", ["x1", "y1"])
def test_a_strip_shifts_as_in_independent_elements(edge: str) -> None:
    m = 0.02 * TRUE.total_mass
    form = strip({"x1": "x = length", "y1": "y = width"}[edge], facts_of(beam("FFFF")))
    found, expected = of_package(form, {"edge_mass": m}), of_elements(replace(TRUE, strips=((edge, m),)))
    assert expected.min() < -0.02
    # the strip has a rotary inertia here, of (h / a)^2; that elements are coarse cancels
    np.testing.assert_allclose(found, expected, atol=3e-4)


def test_a_supported_plate_gives_as_in_independent_elements() -> None:
    c = 0.02
    found = of_package(SOFT_SUPPORT, {"support_compliance": c}, "SSSS")
    expected = of_elements(replace(TRUE, edges="SSSS", shift=2 * c / np.pi**4))
    assert expected.min() < -0.03
    np.testing.assert_allclose(found, expected, atol=5e-4)


@pytest.mark.parametrize("extent", [0.1, 0.16, 0.25])
def test_a_square_cut_off_shifts_as_in_independent_elements(extent: float) -> None:
    side = extent * TRUE.width
    gone = Patch("rectangle", TRUE.length, TRUE.width, side, side, 1.0, gone=True)
    expected = of_elements(replace(TRUE, patches=(gone,), mesh=40))
    (form,) = (f for f in variants(OUTLINE, facts_of(of_true())) if f.place == (1.0, 1.0, extent))
    missing = form.parameters[0].prior.upper
    assert missing == pytest.approx(0.99 * side**2 / (TRUE.length * TRUE.width))
    left = of_package(form, {"missing_area": missing}) - expected
    # products of polynomials do not bend away from what is gone: a part of what the form error counts
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(expected**2))
    assert expected.max() > 0.01


def test_pads_shift_as_square_blocks_do_on_independent_elements() -> None:
    at, frequency, n = 0.25, 30.0, 4
    (form,) = (f for f in FORMS if f"{at:g} of" in f.variant)
    found = of_package(form, {"support_frequency": frequency})
    # blocks of a tenth of the sides, each n x n springs
    reach = 0.05 * (2 * np.arange(n) + 1 - n) / n
    mesh, _ = true_plate._mesh_of(TRUE)
    k, m, held = true_plate.matrices(TRUE)
    spring = (2 * np.pi * frequency) ** 2 * TRUE.total_mass / (4 * n**2)
    places = product((at, 1 - at), (at, 1 - at), reach, reach)
    rows = elements.at_points(mesh, np.array([(x + dx, y + dy) for x, y, dx, dy in places]).T)
    k = k + elements.on_field(mesh, "w", csr_array(spring * (rows.T @ rows)))
    f, _ = elements.frequencies(k, m, held, N_MODES, 6, 100.0)
    expected = f / natural_frequencies(TRUE, N_MODES) - 1
    assert expected.max() > 0.004
    np.testing.assert_allclose(found, expected, atol=0.03 * expected.max())
