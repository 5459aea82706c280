"""Strips, corners, soft supports, pads, masses: closed forms, equivalent places, independent elements."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.sparse import csr_array

import cpam_bayes as cb
from cpam_bayes.diagnosis.places import images_of, laid_on
from cpam_bayes.effects import PlateFacts, applicable, extend, scale_of, variants
from cpam_bayes.effects.edges import SOFT_SUPPORT, SUPPORT
from cpam_bayes.effects.geometry import OUTLINE, _cut
from cpam_bayes.effects.masses import EDGE_MASS
from cpam_bayes.plate.layup import parse_layup
from tests.effects.cases import BY_NAME, SUPPORTED, bare, facts, facts_of, frequencies
from tests.plate_file import SHEET, described
from tests.plates import plate
from validation.independent import elements, true_plate
from validation.independent.true_plate import Mass, Patch, TruePlate, natural_frequencies

ALUMINIUM = {"E1": 70e9, "nu12": 0.0}  # a strip narrow enough to be a beam, h / a = 1 / 300
LENGTH, WIDTH, HEIGHT, DENSITY = 0.3, 0.02, 1e-3, 2700.0
BEAM_MASS = LENGTH * WIDTH * HEIGHT * DENSITY
RIGIDITY = 70e9 * HEIGHT**3 / 12


def beam(edges):
    return plate(LENGTH, WIDTH, HEIGHT, DENSITY, ALUMINIUM, edges=edges)


def first_of_a_beam(b):
    """Frequency, Hz, for the frequency parameter b of a beam."""
    return float(b**2 / (2 * np.pi) * np.sqrt(RIGIDITY / (DENSITY * HEIGHT)) / LENGTH**2)


def strip(edge, of):
    return next(form for form in variants(EDGE_MASS, of) if form.variant == f"along {edge}")


@pytest.mark.parametrize("share", [0.01, 0.05, 0.3])
def test_a_mass_along_its_tip_lowers_a_cantilever_as_a_tip_mass_does(share):
    def residual(b):
        tip = share * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b))
        return float(1 + np.cos(b) * np.cosh(b) + tip)

    problem = beam("CFFF")
    loaded = extend(problem, strip("x = length", facts_of(problem)), facts_of(problem))
    (found,) = frequencies(loaded, {"edge_mass": share * BEAM_MASS}, n=1, degree=10)
    # rotary inertia of a tip half a thickness off, (h / a)^2 = 1e-5, and shear
    assert found == pytest.approx(first_of_a_beam(brentq(residual, 0.5, 1.8752)), rel=2e-4)


@pytest.mark.parametrize("edge", ["x = length", "y = width"])
def test_a_mass_on_one_edge_adds_its_rigid_body_energy(edge):
    problem, m = extend(bare("C1"), strip(edge, facts("C1")), facts("C1")), 4e-3
    plain, heavy = problem.coefficients({"edge_mass": np.array([0.0, m])}, "mass")
    turning = m * (float(problem.nominal.thickness) / 2) ** 2
    added = (heavy - plain)[len(bare("C1").forms("mass")) :]
    np.testing.assert_allclose(added, [m, m, m, turning, turning], rtol=1e-12)


def test_a_strip_without_its_end_is_a_shorter_beam():
    problem = beam("CFFF")
    shorter = extend(problem, replace(OUTLINE, change=partial(_cut, (1.0, 1.0, 1.0))), facts_of(problem))
    cut_off = {"missing_area": 0.99 * WIDTH / LENGTH}  # a square as wide as the strip
    f, full = (frequencies(p, v, n=1, degree=12) for p, v in ((shorter, cut_off), (problem, {})))
    assert f[0] / full[0] == pytest.approx((0.3 / 0.28) ** 2, rel=5e-3)  # 0.07 % of the mass is left there


@pytest.mark.parametrize("weighed", [False, True])
def test_a_weighed_plate_keeps_its_mass_without_a_corner(weighed):
    of = replace(facts("C1"), weighed=weighed)
    (form,) = (form for form in variants(OUTLINE, of) if form.place == (1.0, 1.0, 0.16))
    problem, missing = extend(bare("C1"), form, of), 0.5 * form.parameters[0].prior.upper
    share = 0.16**2 * min(of.length, of.width) / max(of.length, of.width)
    w, of_square = (problem.coefficients({"missing_area": np.array([missing])}, "mass")[0][i] for i in (2, 7))
    assert w + share * of_square == pytest.approx((1.0 if weighed else 1.0 - missing) * of.mass, rel=1e-12)


@pytest.mark.parametrize(
    ("edges", "layup", "loaded", "mass", "strips", "corners"),
    [
        ("FFFF", None, False, (0.5, 0.5), "x = length, y = width", [(1, 1)]),
        # a rotation by 180 degrees only
        ("FFFF", "[30/-30]_s", False, (0.5, 0.0), "x = length, y = width", [(1, 1), (1, 0)]),
        ("FFFF", None, True, (0.0, 0.0), "x = length, y = width, x = 0, y = 0", [*product((1, 0), (1, 0))]),
        ("CFFF", None, False, (0.0, 0.5), "x = length, y = width", [(1, 1)]),
        ("CFFF", None, True, (0.0, 0.0), "x = length, y = width, y = 0", [(1, 1), (1, 0)]),
        ("CFFF", "[30/-30]_s", False, (0.0, 0.0), "x = length, y = width, y = 0", [(1, 1), (1, 0)]),
        ("CFFS", None, False, (0.0, 0.0), "x = length, y = 0", [(1, 0)]),
        ("FFCF", None, False, (0.0, 0.5), "y = width, x = 0", [(0, 1)]),
        ("FCFS", None, False, (0.5, 0.0), "x = length", []),
        ("FFSC", None, False, (0.0, 0.0), "x = 0, y = 0", [(0, 0)]),
        ("FSFS", None, False, (0.5, 0.5), "x = length", []),
        ("SCCS", None, False, (0.0, 0.0), "", []),
    ],
)
def test_places_free_edges_and_corners_that_look_alike_are_one(edges, layup, loaded, mass, strips, corners):
    of = replace(facts("C1"), edges=edges, loaded=loaded)
    of = replace(of, layup=parse_layup(layup)) if layup else of
    (anywhere,) = variants(BY_NAME["sensor_mass"], of)
    assert tuple(p.prior.lower for p in anywhere.coordinates[:2]) == mass
    assert {p.prior.upper for p in anywhere.coordinates[:2]} == {1.0}
    assert bool(anywhere.variant) == any(mass)
    carry = variants(EDGE_MASS, of)
    assert ", ".join(form.variant.removeprefix("along ") for form in carry) == strips
    assert (EDGE_MASS in applicable(of)) == bool(strips)
    # fraction of the plate's mass: one standard deviation, and at most
    for form, one, most in [(anywhere, 0.01, 0.1), *((form, 0.003, 0.05) for form in carry)]:
        size = form.parameters[0]
        assert (scale_of(size), size.prior.upper) == pytest.approx((one * of.mass, most * of.mass))
    missing = [form.place for form in variants(OUTLINE, of)]
    assert missing == [(*corner, extent) for corner in corners for extent in (0.06, 0.1, 0.16, 0.25)]


def test_edges_that_an_effect_may_act_along_are_marked():
    for name, marked in (("C1", [(2, 0), (3, 1)]), ("A2", [(2,), (3, 1)])):
        assert [form.edges(facts(name)) for form in variants(EDGE_MASS, facts(name))] == marked
    assert SOFT_SUPPORT.edges(facts(SUPPORTED)) == [0, 1, 2, 3]


def first_of_a_strip_on_springs(c):
    """Parameter b of the first, symmetric mode of a beam on end springs k = pi^4 EI / (2 c a^3).
    w = cos(b s) + r cosh(b s), s from -1/2 to 1/2: w'' = 0 at the ends, and |EI w'''| = k w there."""

    def residual(b):
        r = np.cos(b / 2) / np.cosh(b / 2)
        force = b**3 * (np.sin(b / 2) + r * np.sinh(b / 2))
        return float(2 * c / np.pi**4 * force - (np.cos(b / 2) + r * np.cosh(b / 2)))

    return float(brentq(residual, 1e-3, np.pi))


@pytest.mark.parametrize("compliance", [0.01, 0.1, 0.5])
def test_a_strip_on_soft_supports_is_a_beam_on_end_springs(compliance):
    problem = beam("SFSF")
    soft = extend(problem, SOFT_SUPPORT, facts_of(problem))
    (found,) = frequencies(soft, {"support_compliance": compliance}, n=1, degree=10)
    # Poisson's ratio is zero; shear contributes (h / a)^2
    assert found == pytest.approx(first_of_a_beam(first_of_a_strip_on_springs(compliance)), rel=2e-4)
    if compliance == 0.01:  # Rayleigh: the reactions EI (pi / a)^3 of the mode do the work
        assert found / first_of_a_beam(np.pi) - 1 == pytest.approx(-4 * compliance / np.pi**2, rel=0.02)


def test_a_clamp_opposite_a_soft_support_stays_a_clamp():
    problem = plate(0.3, 0.2, 3e-3, DENSITY, ALUMINIUM, edges="CFSF")
    assert extend(problem, SOFT_SUPPORT, facts_of(problem)).edges == "CFWF"


FORMS = variants(SUPPORT, facts("C1"))


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.variant)
def test_every_form_of_a_support_bounces_a_rigid_plate_at_its_frequency(form):
    problem = extend(bare("C1"), form, facts("C1"))
    assert problem.supported
    (term,) = (t for t in problem.terms if t.name == "support")
    hertz = np.array([0.0, 10.0, 30.0])
    stiffness = problem.coefficients({"support_frequency": hertz}, "stiffness")[:, -1]
    t, w = np.polynomial.legendre.leggauss(400)
    grid = np.stack(np.meshgrid((t + 1) / 2, (t + 1) / 2), axis=-1).reshape(-1, 2)
    weight = term.forms[0].weight
    share = 1.0 if weight is None else np.outer(w, w).ravel() @ weight(grid) / 4
    np.testing.assert_allclose(np.sqrt(stiffness * share / facts("C1").mass) / (2 * np.pi), hertz, rtol=1e-6)


TRUE = TruePlate(0.26, 0.2, 2e-3, 2700.0, "FFFF", (0.0,), {"E1": 70e9, "nu12": 0.33}, 5 / 6)
N_MODES = 8


def of_true(edges="FFFF"):
    return plate(TRUE.length, TRUE.width, TRUE.thickness, TRUE.density, dict(TRUE.constants), edges=edges)


def of_package(effect, values, edges="FFFF"):
    """Relative shifts by Ritz for the plate of the independent elements."""
    problem = of_true(edges)
    changed = extend(problem, effect, facts_of(problem))
    f, none = (frequencies(p, v, n=N_MODES, degree=13) for p, v in ((changed, values), (problem, {})))
    return f / none - 1


def of_elements(true):
    whole = replace(TRUE, edges=true.edges, mesh=true.mesh)
    return natural_frequencies(true, N_MODES) / natural_frequencies(whole, N_MODES) - 1


@pytest.mark.parametrize("edge", ["x1", "y1"])
def test_a_strip_shifts_as_in_independent_elements(edge):
    m = 0.02 * TRUE.total_mass
    form = strip({"x1": "x = length", "y1": "y = width"}[edge], facts_of(beam("FFFF")))
    found, expected = of_package(form, {"edge_mass": m}), of_elements(replace(TRUE, strips=((edge, m),)))
    assert expected.min() < -0.02
    np.testing.assert_allclose(found, expected, atol=3e-4)  # the strip has a rotary inertia, (h / a)^2


def test_a_supported_plate_gives_as_in_independent_elements():
    c = 0.02
    found = of_package(SOFT_SUPPORT, {"support_compliance": c}, "SSSS")
    expected = of_elements(replace(TRUE, edges="SSSS", shift=2 * c / np.pi**4))
    assert expected.min() < -0.03
    np.testing.assert_allclose(found, expected, atol=5e-4)


@pytest.mark.parametrize("extent", [0.1, 0.16, 0.25])
def test_a_square_cut_off_shifts_as_in_independent_elements(extent):
    side = extent * TRUE.width
    gone = Patch("rectangle", TRUE.length, TRUE.width, side, side, 1.0, gone=True)
    expected = of_elements(replace(TRUE, patches=(gone,), mesh=40))
    (form,) = (f for f in variants(OUTLINE, facts_of(of_true())) if f.place == (1.0, 1.0, extent))
    missing = form.parameters[0].prior.upper
    assert missing == pytest.approx(0.99 * side**2 / (TRUE.length * TRUE.width))
    left = of_package(form, {"missing_area": missing}) - expected
    assert np.sqrt(np.mean(left**2)) < 0.2 * np.sqrt(np.mean(expected**2))  # part of the form error
    assert expected.max() > 0.01


def test_pads_shift_as_square_blocks_do_on_independent_elements():
    at, frequency, n = 0.25, 30.0, 4
    (form,) = (f for f in FORMS if f"{at:g} of" in f.variant)
    found = of_package(form, {"support_frequency": frequency})
    reach = 0.05 * (2 * np.arange(n) + 1 - n) / n  # blocks of a tenth of the sides, n x n springs each
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


# Places of a mass that no frequency tells apart
PLACE = (0.83, 0.62)
METAL = {"E1_GPa": 70.0, "nu12": 0.33}


def specimen(layup, edges, width=200.0):
    constants, of = (SHEET, {"layup": layup}) if layup else ({**METAL, "isotropic": True}, {})
    return cb.read_plate(described((200.0, width, 2.0), 1600.0, constants, edges=edges, **of))


def with_mass(bare, place):
    """Frequencies of independent elements with a mass of 6 g at a place relative to the sides."""
    of, stated = bare.plate, METAL if bare.material.isotropic else SHEET
    angles = tuple(of.layup.angles_deg.tolist())
    constants = {n.removesuffix("_GPa"): v * (1e9 if "GPa" in n else 1.0) for n, v in stated.items()}
    mass = Mass(0.006, place[0] * of.length, place[1] * of.width)
    sides = (of.length, of.width, of.thickness)
    true = TruePlate(*sides, of.density, of.edges, angles, constants, masses=(mass,), mesh=4)
    return natural_frequencies(true, 8)


@pytest.mark.parametrize(
    ("layup", "edges", "width", "number"),
    [
        ("", "FFFF", 150.0, 4),
        ("", "FFFF", 200.0, 8),
        ("", "CCFF", 200.0, 2),
        ("", "CFCF", 200.0, 4),
        ("[45/-45]_s", "FFFF", 200.0, 4),
        ("[45/-45]_s", "FFFF", 150.0, 2),
        ("[0/90]_s", "FFFF", 200.0, 4),
        ("[30/-30]_s", "FFFF", 200.0, 2),
        ("[0/90]_s", "CFFF", 150.0, 2),
        ("[30/-30]_s", "CFFF", 150.0, 1),
    ],
)
def test_images_are_the_places_at_which_a_mass_leaves_the_same_frequencies(layup, edges, width, number):
    bare = specimen(layup, edges, width)
    found = images_of(PLACE, [PlateFacts.of(bare.plate, bare.material.isotropic)])
    assert found[0] == pytest.approx(PLACE)
    assert len(found) == number
    x, y = PLACE
    every = {(u, v) for a, b in ((x, y), (y, x)) for u in (a, 1 - a) for v in (b, 1 - b)}
    own = with_mass(bare, PLACE)
    for image in every:
        there = with_mass(bare, image)
        assert np.allclose(there, own, rtol=1e-6) == any(np.allclose(image, other) for other in found), image


def test_a_known_mass_another_test_and_the_place_itself_leave_fewer_images():
    free, held = (specimen("", edges, 150.0) for edges in ("FFFF", "CFFF"))
    first, second = (PlateFacts.of(p.plate, isotropic=True) for p in (free, held))
    assert len(images_of(PLACE, [PlateFacts.of(free.plate, isotropic=True, loaded=True)])) == 1
    assert images_of(PLACE, [first, second]) == (PLACE, pytest.approx((0.83, 0.38)))
    # next to a line of symmetry the image coincides with the place
    assert images_of((0.83, 0.49), [first], (0.01, 0.03)) == ((0.83, 0.49), pytest.approx((0.17, 0.49)))


def test_draws_are_laid_on_the_optimum_whichever_image_and_of_two_whichever_is_first():
    rng = np.random.default_rng(3)
    two = (BY_NAME["sensor_mass"], BY_NAME["sensor_mass"].again())
    names = [p.name for e in two for p in e.parameters]
    columns = {name: i + 1 for i, name in enumerate(names)}
    optimum = np.array([7.0, 0.006, 0.80, 0.55, 0.004, 0.002, 0.90, 0.95, 0.003])
    true = optimum + 1e-3 * rng.standard_normal((400, 9)) * [1, 0, 1, 1, 0, 0, 1, 1, 0]
    draws = true.copy()
    turned, exchanged = rng.random(400) < 0.5, rng.random(400) < 0.5  # exchange x and y, or the two masses
    draws[np.ix_(turned, [2, 3])] = draws[np.ix_(turned, [3, 2])]
    draws[np.ix_(exchanged, range(1, 9))] = draws[np.ix_(exchanged, [5, 6, 7, 8, 1, 2, 3, 4])]
    facts = [PlateFacts.of(specimen("", "FFFF").plate, isotropic=True)]
    np.testing.assert_allclose(laid_on(draws, optimum, two, columns, facts), true, rtol=1e-12)
    assert draws[turned & ~exchanged, 2].mean() == pytest.approx(0.55, abs=0.01)
