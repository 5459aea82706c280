"""Effects against closed forms, other descriptions of the same plate and quadrature; steps of a layup."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import cpam_bayes as cb
from cpam_bayes.diagnosis.hypotheses import single_hypotheses
from cpam_bayes.diagnosis.models import extended_model, plate_models
from cpam_bayes.effects import CATALOGUE, PlateFacts, add_air, add_known_mass, extend, variants
from cpam_bayes.effects.geometry import SWAPPED_SIDES
from cpam_bayes.effects.layup import LAYUP, MOST, neighbours
from cpam_bayes.effects.masses import PressureJumps, jump_energy
from cpam_bayes.effects.plies import _G
from cpam_bayes.forward_model.model import angle_parameters, plate_problem
from cpam_bayes.forward_model.reduced import basis_error
from cpam_bayes.mechanics.dense import MATRICES, discretise
from cpam_bayes.mechanics.problem import AREA
from cpam_bayes.mechanics.ritz import RitzSettings, ritz_space
from cpam_bayes.plate.edges import FIELDS
from cpam_bayes.plate.layup import from_angles, parse_layup
from cpam_bayes.plate.reader import builtin
from tests.effects.cases import BY_NAME, bare, facts, facts_of, frequencies, placed, values_at, with_effect
from tests.hybrids import hybrid
from tests.mechanics.test_problem import strains as strains_of_a_flat_plate
from tests.mechanics.test_problem import whole
from tests.plates import CARBON, CROSS_PLY_16S, plate, with_plate
from tests.plates import frequencies as converged

PLY = CARBON | {"G13": 5.1e9, "G23": 3.0e9}


def applied(problem, name, layup=(0.0,)):
    return extend(problem, placed(BY_NAME[name]), facts_of(problem, layup))


def at(name, size):
    (parameter,) = BY_NAME[name].parameters
    return {parameter.name: np.asarray(size)}


STATED = {"length": 0.26, "width": 0.2, "thickness": 0.003, "density": 1600.0}


@pytest.mark.parametrize("name", STATED)
def test_sizes_thickness_and_density_are_those_of_a_plate_so_stated(name):
    problem = applied(plate(*STATED.values(), PLY, CROSS_PLY_16S), name)
    other = plate(*{**STATED, name: 1.03 * STATED[name]}.values(), PLY, CROSS_PLY_16S)
    for kind in MATRICES:
        found = problem.coefficients({f"{name}_deviation": np.asarray(0.03)}, kind)
        np.testing.assert_allclose(found, other.coefficients({}, kind), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["thickness", "length", "width", "skew", "taper_x", "taper_y", "density"])
def test_a_weighed_plate_keeps_its_mass_where_a_size_is_another_one(name):
    original, effect = plate(*STATED.values(), PLY, CROSS_PLY_16S), placed(BY_NAME[name])
    weighed = replace(facts_of(original, CROSS_PLY_16S), weighed=True)
    state = extend(original, effect, weighed).state({p.name: np.asarray(0.04) for p in effect.parameters})
    expected = 1.04 if name == "density" else 1.0  # for a weighed plate that is a wrong mass
    mass = float(state.density * state.thickness * state.area)
    assert mass == pytest.approx(expected * 1600.0 * 0.003 * 0.26 * 0.2, rel=1e-12)


def test_clamp_length_is_the_length_across_the_clamp():
    for edges, longer in (("CFFF", (0.261, 0.2)), ("FFFC", (0.26, 0.201)), ("CFCF", (0.261, 0.2))):
        problem = applied(plate(0.26, 0.2, 0.003, 1600.0, PLY, edges=edges), "clamp_length")
        found = problem.state({"clamp_shift": np.asarray(1e-3)})
        np.testing.assert_allclose((found.length, found.width), longer, rtol=1e-14)


@pytest.mark.parametrize(
    ("effect", "layup", "plies", "turn"),
    [
        ("misorientation", CROSS_PLY_16S, slice(None), -7.0),
        ("misorientation", (30.0, -60.0, 10.0), slice(None), 3.0),
        ("outer_ply_angle", CROSS_PLY_16S, [0, 31], 12.0),
        ("inner_ply_angle", CROSS_PLY_16S, [14, 17], 12.0),
    ],
)
def test_turned_plies_are_the_layup_so_written(effect, layup, plies, turn):
    angles, shear = np.array(layup), bare("C1").nominal.shear
    angles[plies] += turn
    original, turned = (plate(*STATED.values(), PLY, tuple(x), shear=shear) for x in (layup, angles.tolist()))
    found = applied(original, effect, layup).state(at(effect, turn)).stiffness()
    expected = turned.nominal.stiffness()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * expected.max())


@pytest.mark.parametrize(
    ("effect", "turn", "thickness_mm", "stated", "written"),
    [
        ("outer_ply_angle", 30.0, 3.0, "[c0_2/g45/g-45/c90]_s", "[c30/c0/g45/g-45/c90/c90/g-45/g45/c0/c30]"),
        ("misorientation", 20.0, 3.0, "[c0_2/g45/g-45/c90]_s", "[c20_2/g65/g-25/c-70]_s"),
        ("misorientation", 17.0, 0.875, "[c0/g45/c30]", "[c17/g62/c47]"),
    ],
)
def test_plies_of_a_hybrid_turn_with_their_own_stiffness(effect, turn, thickness_mm, stated, written):
    known, turned = (cb.read_plate(hybrid(layup=of, thickness_mm=thickness_mm)) for of in (stated, written))
    problem = extend(plate_problem(known), BY_NAME[effect], PlateFacts.of(known.plate, isotropic=False))
    expected = plate_problem(turned).nominal.stiffness()
    np.testing.assert_allclose(problem.state(at(effect, turn)).stiffness(), expected, rtol=1e-9, atol=1e-3)


def test_stiffness_effects_change_their_own_entries_alone():
    plain = bare("C1").state({}).stiffness()
    changed = with_effect("C1", BY_NAME["transverse_shear"]).state(at("transverse_shear", 0.3))
    expected = plain.copy()
    expected[6:, 6:] *= np.exp(0.3)
    np.testing.assert_allclose(changed.stiffness(), expected, rtol=1e-14)
    assert bare("C1").state({}).stiffness()[6, 6] == plain[6, 6]  # the bare plate is unchanged
    ratio = with_effect("C1", BY_NAME["shear_ratio"]).state(at("shear_ratio", -0.2))
    assert ratio.constants["G13"] == pytest.approx(0.8 * 6.25e9)
    np.testing.assert_array_equal(ratio.stiffness()[:6, :6], plain[:6, :6])
    of = cb.read_plate(hybrid())  # each material of a hybrid has its own shear modulus
    problem = extend(plate_problem(of), BY_NAME["shear_ratio"], PlateFacts.of(of.plate, isotropic=False))
    changed = problem.state(at("shear_ratio", 0.1)).constants
    for name, value in plate_problem(of).nominal.constants.items():
        assert changed[name] == pytest.approx(value * (1.1 if name.endswith("G13") else 1.0))


def test_resin_skin_is_a_thinner_laminate_between_two_resin_plies():
    h, t = 3.2e-3, 1e-4
    found = with_effect("C1", BY_NAME["resin_skin"]).state(at("resin_skin", t)).stiffness()
    core = replace(bare("C1").nominal, thickness=np.asarray(h - 2 * t)).stiffness()
    q = 3.5e9 / (1 - 0.35**2)
    inertia = 2 * (t**3 / 12 + t * ((h - t) / 2) ** 2)  # parallel axes
    for i, added in ((0, 2 * t * q), (3, inertia * q), (5, inertia * 3.5e9 / 2.7)):
        assert found[i, i] == pytest.approx(core[i, i] + added)
    np.testing.assert_allclose(found[6:, 6:], core[6:, 6:], rtol=1e-12)


def test_sensor_mass_is_a_known_mass_of_that_size_and_turns_with_its_radius_about_the_surface():
    n, m, r = bare("D3").nominal, 2e-3, 4e-3
    mass = BY_NAME["sensor_mass"]
    point, wide = (extend(bare("D3"), mass.at((0.95, 0.275, of)), facts("D3")) for of in (0.0, r))
    known = add_known_mass(bare("D3"), m, 0.95 * float(n.length), 0.275 * float(n.width))
    found, turning = (p.coefficients({"sensor_mass": np.asarray(m)}, "mass") for p in (point, wide))
    np.testing.assert_allclose(found, known.coefficients({}, "mass"), rtol=1e-14)
    places = [np.array([f.region.point for f in p.forms("mass")]) for p in (point, known)]
    np.testing.assert_allclose(*places, rtol=1e-14)
    inertia = m * (float(n.thickness) ** 2 / 4 + r**2)
    np.testing.assert_allclose(turning[-5:], [m, m, m, inertia, inertia], rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["A2", "D3"])
def test_swapped_sides_are_the_plate_with_its_sides_exchanged(name):
    models, own = plate_models(builtin(name), 6), builtin(name).plate
    (swapped,) = variants(SWAPPED_SIDES, models.facts)
    expected = plate_models(with_plate(name, length=own.width, width=own.length), 6).bare.full
    x = models.samples.x[:1]
    f = extended_model(models, swapped).predict(x).frequencies[0, :6]
    np.testing.assert_allclose(f, expected.predict(x).frequencies[0, :6], rtol=2e-4)
    assert np.abs(f / models.bare.predict(x).frequencies[0, :6] - 1.0).max() > 0.01


@pytest.mark.parametrize(("edges", "swapped"), [("FFFF", "FFFF"), ("CFFF", "FCFF")])
def test_a_skewed_isotropic_plate_is_the_same_seen_from_its_other_side(edges, swapped):
    of_each = ((0.3, 0.2), edges), ((0.2, 0.3), swapped)  # a parallelogram a, b and its reflection b, a
    plates = (plate(*sides, 0.004, 2700.0, {"E1": 70e9, "nu12": 0.3}, edges=of) for sides, of in of_each)
    one, other = (applied(p, "skew") for p in plates)
    f, g = (frequencies(p, {"skew_deg": 15.0}, degree=9) for p in (one, other))
    np.testing.assert_allclose(f, g, rtol=3e-4)  # bases of nine polynomials err by 1e-4
    assert np.abs(f / frequencies(one, {"skew_deg": 0.0}, degree=9) - 1).max() > 0.01


def test_a_square_turned_to_a_rhombus_has_its_area_in_the_mass():
    problem = with_effect("C1", BY_NAME["skew"])
    plain, skewed = (problem.coefficients({"skew_deg": np.asarray(s)}, "mass") for s in (0.0, 8.0))
    np.testing.assert_allclose(skewed, np.cos(np.deg2rad(8.0)) * plain, rtol=1e-13)


# Springs EI / (c L), EI / (c L^3): at b = (frequency parameter)^(1/2) this plus 1 + cos(b) cosh(b) is zero.
ROOTS = {
    "rotation": lambda b, c: c * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b)),
    "translation": lambda b, c: -c * b**3 * (np.cos(b) * np.sinh(b) + np.sin(b) * np.cosh(b)),
}


@pytest.mark.parametrize(("way", "c"), [*(("rotation", c) for c in (0.0, 0.02, 0.1)), ("translation", 0.01)])
def test_a_strip_on_a_spring_has_the_frequency_of_a_beam(way, c):
    length, h, e, rho = 0.4, 2e-3, 70e9, 2700.0
    strip = plate(length, 0.02, h, rho, {"E1": e, "nu12": 0.0}, edges="CFFF")
    found = frequencies(applied(strip, f"clamp_{way}"), {f"{way}_compliance": c}, n=1, degree=7)[0]
    b = brentq(lambda b: 1 + np.cos(b) * np.cosh(b) + ROOTS[way](b, c), 1.0, 2.0)
    expected = b**2 / (2 * np.pi * length**2) * np.sqrt(e * h**2 / (12 * rho))
    assert found == pytest.approx(expected, rel=5e-4)  # shear, rotary inertia 1e-4; clamp's spring 6e-5


def test_rotation_and_translation_of_a_clamp_go_together_and_slip_goes_alone():
    both, values = bare("D3"), {"rotation_compliance": 0.02, "translation_compliance": 0.002}
    names = ("clamp_rotation", "clamp_translation")
    for name in names:
        both = extend(both, BY_NAME[name], facts("D3"))
    assert (both.edges, both.parameters.names) == ("EFFF", tuple(values))
    plates = (with_effect("D3", BY_NAME[name]) for name in names)
    alone = [frequencies(p, {of: values[of]}, degree=8) for p, of in zip(plates, values, strict=True)]
    assert np.all(frequencies(both, values, degree=8) < np.minimum(*alone) * (1 + 1e-5))
    with pytest.raises(ValueError, match="slip does not go with another"):
        extend(both, BY_NAME["clamp_slip"], facts("D3"))


@pytest.mark.parametrize(("aspect", "expected"), [(1.0, 0.579), (1.5, 0.690), (2.0, 0.757)])
def test_heaving_plate_moves_the_added_mass_of_the_literature(aspect, expected):
    # unit rho pi / 4 short^2 long (Meyerhoff, J. Ship Res. 14, 1970)
    t, w = np.polynomial.legendre.leggauss(120)
    points = np.stack(np.meshgrid((t + 1) / 2, (t + 1) / 2, indexing="ij"), axis=-1).reshape(-1, 2)
    moments = np.outer(w / 2, w / 2).ravel() @ PressureJumps(aspect, 1.0)(points)
    assert np.sum(moments**2) / (np.pi / 4 * aspect) == pytest.approx(expected, abs=6e-4)


def test_energy_of_the_potential_jumps_is_symmetric_definite_and_scales_with_length():
    small, large = jump_energy(0.3, 0.2), jump_energy(0.6, 0.4)
    np.testing.assert_allclose(small, small.T, rtol=0, atol=1e-12 * small.max())
    assert np.linalg.eigvalsh(small)[0] > 0
    np.testing.assert_allclose(large, 2 * small, rtol=0, atol=1e-9 * small.max())


def test_air_of_a_known_density_is_the_effect_at_that_value():
    known = add_air(bare("C1"), 1.1)
    found = with_effect("C1", BY_NAME["air"]).coefficients({"air_density": np.asarray(1.1)}, "mass")
    np.testing.assert_array_equal(known.coefficients({}, "mass"), found)


def test_residual_stress_is_in_equilibrium_free_of_edge_loads_and_of_the_stated_size():
    for at_edges in (_G, _G.derivative()):
        assert at_edges(np.array([0.0, 1.0])).tolist() == [0.0, 0.0]
    a, b = 0.28, 0.25
    problem = applied(plate(a, b, 3e-3, 2700.0, {"E1": 70e9, "nu12": 0.3}), "membrane_stress")
    (term,) = [t for t in problem.terms if t.name == "membrane_stress"]
    c = term.coefficients(problem.nominal, {"residual_stress": np.asarray(1e6)})
    t = np.linspace(0, 1, 401)
    grid = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    each = zip(c, term.forms, (a / b, b / a, 1.0), strict=True)  # including the area and the two sides
    n_x, n_y, n_xy = (q * form.weight(grid).reshape(401, 401) * scale for q, form, scale in each)
    assert max(np.abs(n).max() for n in (n_x, n_y, n_xy)) / 3e-3 == pytest.approx(1e6, rel=1e-12)
    for first, second in ((n_x / a, n_xy / b), (n_xy / a, n_y / b)):  # N_x,x + N_xy,y = 0 = N_xy,x + N_y,y
        along, across = np.gradient(first, t[1], axis=0), np.gradient(second, t[1], axis=1)
        assert np.abs(along + across)[1:-1, 1:-1].max() < 1e-3 * np.abs(along).max()


def test_loss_tangent_stiffens_by_its_share_of_pi_per_unit_of_log_frequency():
    observe = BY_NAME["viscoelastic"].observe
    f = np.array([100.0, 100.0 * np.e, 100.0 * np.e**2])
    found = observe(f, {"loss_tangent": np.array([0.01])})[0]
    np.testing.assert_allclose(np.log(found / f), [0.0, 0.01 / np.pi, 0.02 / np.pi], rtol=1e-12, atol=1e-15)


def strains(problem, space, sags):
    """Generalised strains (n_points, 8, n) of a shallow cap, and the points' weights times the area."""
    found, area = strains_of_a_flat_plate(space, problem.nominal)
    rule, sides = space.quadrature(AREA), (float(problem.nominal.length), float(problem.nominal.width))
    start = sum(space.dimension(f) for f in FIELDS[: FIELDS.index("w")])
    w = slice(start, start + space.dimension("w"))
    w_x, w_y = (space.evaluate("w", rule, d) / side for d, side in zip(("x", "y"), sides, strict=True))
    each = zip(sags, rule.points.T, sides, strict=True)  # w0 = sag_x 4 xi (1 - xi) + sag_y 4 eta (1 - eta)
    slope_x, slope_y = (sag * 4 * (1 - 2 * at) / side for sag, at, side in each)
    found[:, 0, w] += slope_x[:, None] * w_x
    found[:, 1, w] += slope_y[:, None] * w_y
    found[:, 2, w] += slope_x[:, None] * w_y + slope_y[:, None] * w_x
    return found, area


SAGS = (4e-3, -2.5e-3)


@pytest.mark.parametrize(
    ("name", "value"), [("taper_x", 0.1), ("taper_y", -0.1), ("damage", 0.3), ("warp", 0.0)]
)
def test_stiffness_with_an_effect_is_the_energy_of_its_strains_by_quadrature(name, value):
    layup = (30.0, -60.0, 10.0)
    problem = plate(0.3, 0.2, 0.02, 1600.0, PLY, layup, "CFFF")
    effect = applied(problem, name, layup)
    space = ritz_space("CFFF", problem.nominal, RitzSettings(5, 5, 1, True))
    values = {effect.parameters.names[0]: value}
    if name == "warp":
        values |= {"sag": np.hypot(*SAGS) / 2**0.5, "sag_direction_deg": np.degrees(np.arctan2(*SAGS[::-1]))}
    stack = {name: np.array([v]) for name, v in values.items()}
    found, _ = whole(discretise(effect, space, stack), stack)
    b, area = strains(problem, space, SAGS if name == "warp" else (0.0, 0.0))
    points = space.quadrature(AREA).points
    stiffness = np.broadcast_to(problem.nominal.stiffness(), (len(points), 8, 8)).copy()
    if name.startswith("taper"):
        s = 2 * points[:, "xy".index(name[-1])] - 1
        stiffness = replace(problem.nominal, thickness=0.02 * (1 + value * s)).stiffness()
    if name == "damage":
        away = (points - 0.5) * np.array([0.3, 0.2])
        bell = 1 - value * np.exp(-np.sum(away**2, axis=1) / (2 * 0.01**2))
        for block in (slice(3, 6), slice(6, 8)):
            stiffness[:, block, block] *= bell[:, None, None]
    expected = np.einsum("p,pin,pij,pjm->nm", area, b, stiffness, b, optimize=True)
    tolerance = 2e-3 if name == "damage" else 1e-11  # the bell is narrow for the rule
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


def test_effects_compose_in_either_order():
    values = {"misorientation_deg": 3.0, "residual_stress": 5e5, "thickness_deviation": 0.02}
    names, found = ("misorientation", "membrane_stress", "thickness"), []
    for order in (names, names[::-1]):
        problem = bare("C1")
        for name in order:
            problem = extend(problem, BY_NAME[name], facts("C1"))
        found.append(frequencies(problem, values, degree=8))
    np.testing.assert_allclose(*found, rtol=1e-7)
    assert set(problem.parameters.names) == set(values)


def test_every_effect_works_with_an_unknown_layup():
    specimen = builtin("C1", sequence=True)
    problem = plate_problem(specimen, angle_parameters(specimen))
    its_facts = PlateFacts.of(specimen.plate, isotropic=False)
    angles = {name: np.array([10.0, 20.0]) for name in problem.parameters.names}
    for effect in (placed(e) for e in CATALOGUE if e.change is not None and e.applies_to(its_facts)):
        extended = extend(problem, effect, its_facts)
        for kind in MATRICES:
            c = extended.coefficients(angles | values_at(effect, (0.0, 1.0)), kind)
            assert np.all(np.isfinite(c))
            assert c.shape[-1] == len(extended.forms(kind))
        if effect.name == "outer_ply_angle":
            turned = {name: a[:1] for name, a in angles.items()} | {"outer_ply_deg": np.array([0.0, 5.0])}
            assert not np.allclose(*extended.coefficients(turned, "stiffness"))


def steps(text):
    layup = parse_layup(text)
    return {s.text: tuple(layup.angles_deg[s.order(layup.n_plies)].tolist()) for s in neighbours(layup)}


def step(of, text):
    return next(e for e in variants(LAYUP, of) if e.variant == text)


def test_neighbours_of_short_layups_are_those_found_by_hand():
    # with ply 1 missing and turned over, it is the one without the third
    missing = {"ply 1 missing": (90, 0), "ply 2 missing": (0, 0), "plies 1 and 3 missing": (90,)}
    assert steps("[0/90/0]") == {**missing, "plies 1 and 2 exchanged": (90, 0, 0)}
    assert steps("[0/90]") == {"ply 1 missing": (90,), "ply 2 missing": (0,)}
    one = {"ply 1 missing": (90, 90, 0), "ply 2 missing": (0, 90, 0)}
    two = {"plies 1 and 4 missing": (90, 90), "plies 2 and 3 missing": (0, 0)}
    exchanged = {"plies 1 and 2 exchanged": (90, 0, 90, 0)}
    exchanged["plies 1 and 2, 3 and 4 exchanged"] = (90, 0, 0, 90)
    assert steps("[0/90]_s") == one | two | exchanged
    missing = {f"ply {i} missing" for i in (1, 2, 3)}  # the upper half is no mirror image of the lower
    assert set(steps("[0/90/45]")) == missing | {"plies 1 and 2 exchanged", "plies 2 and 3 exchanged"}


def test_a_long_layup_has_those_neighbours_whose_bending_differs_most():
    layup = parse_layup("[(0/90)_8]_s")
    every = neighbours(layup, 1000)
    assert len(every) > len(neighbours(layup)) == MOST
    assert neighbours(layup) == every[:MOST]
    assert every[0].text == "plies 1 and 32 missing"  # the outermost plies matter most, inner ones hardly
    assert {i for s in every[-8:] for i in (*s.missing, *s.exchanged)} <= set(range(10, 22))


def test_all_forms_are_equally_probable():
    forms = [h for h in single_hypotheses(facts("C1"), 8, complete=True) if h.cause == "layup"]
    assert len(forms) == len(neighbours(facts("C1").layup))
    assert len({h.prior for h in forms}) == 1


@pytest.mark.parametrize(
    ("stated", "text"),
    [
        ("[(0/90)_2]_s", "plies 2 and 7 missing"),
        ("[(0/90)_2]_s", "plies 1 and 2, 7 and 8 exchanged"),
        ("[0/45/-45/90]_s", "plies 1 and 2, 7 and 8 exchanged"),
        ("[0/90/45]", "ply 2 missing"),  # stretching and bending couple in the space of an unsymmetric plate
        ("[0/90/45]", "plies 1 and 2 exchanged"),
    ],
)
def test_a_form_is_the_plate_read_with_that_layup(stated, text):
    specimen = with_plate("C1", layup=parse_layup(stated))
    of = PlateFacts.of(specimen.plate, isotropic=False)
    found = pickle.loads(pickle.dumps(extend(plate_problem(specimen), step(of, text), of)))
    expected = plate_problem(with_plate("C1", layup=from_angles(steps(stated)[text])))
    for kind in MATRICES:
        c = expected.coefficients({}, kind)
        np.testing.assert_allclose(found.coefficients({}, kind), c, rtol=0, atol=1e-12 * np.abs(c).max())
        assert found.forms(kind) == expected.forms(kind)


def test_plies_of_a_hybrid_keep_their_materials_and_the_plate_its_thickness_and_mass():
    specimen = cb.read_plate(hybrid())
    layup, of = specimen.plate.layup, PlateFacts.of(specimen.plate, isotropic=False)
    for step, own in zip(neighbours(layup), variants(LAYUP, of), strict=True):
        order = step.order(layup.n_plies)
        read = from_angles(layup.angles_deg[order].tolist())
        read = replace(read, kinds=tuple(layup.kinds[i] for i in order))
        if not read.is_symmetric:
            continue
        state = extend(plate_problem(specimen), own, of).state({})
        expected = plate_problem(replace(specimen, plate=replace(specimen.plate, layup=read))).nominal
        k = expected.stiffness()
        np.testing.assert_allclose(state.stiffness(), k, rtol=0, atol=1e-12 * k.max())
        assert (state.thickness, state.density) == (specimen.plate.thickness, specimen.plate.density)
        np.testing.assert_allclose(state.plies.mass_moments, expected.plies.mass_moments, atol=1e-12)


@pytest.mark.parametrize(
    ("stated", "edges", "most"),
    [
        ("[(0/90)_4]_s", "CFFF", 1e-3),
        ("[0/90/0]", "FFFF", 0.04),
        pytest.param("[0/45/-45/90]_s", "FFFF", 0.07, marks=pytest.mark.slow),
        pytest.param("[0/60/-60]_s", "FFFF", 0.13, marks=pytest.mark.slow),
    ],
)
def test_reduced_bending_errs_by_a_small_part_of_the_shift_on_an_unsymmetric_neighbour(stated, edges, most):
    """Compared with the coupled plate on a space with functions for stretching."""
    angles = tuple(parse_layup(stated).angles_deg.tolist())
    unsymmetric = {text: laid for text, laid in steps(stated).items() if laid != laid[::-1]}
    laid_up = (angles, *list(unsymmetric.values())[:3])
    problem, *others = (plate(0.26, 0.2, 2e-3, 1600.0, PLY, laid, edges) for laid in laid_up)
    of, bare = facts_of(problem, angles), converged(problem, 6)
    for text, other in zip(unsymmetric, others, strict=False):
        coupled, reduced = converged(other, 6), converged(extend(problem, step(of, text), of), 6)
        error, shift = (np.abs(f / coupled - 1.0).max() for f in (reduced, bare))
        assert error < most * shift, text


def test_all_forms_of_a_plate_are_one_reduced_model_that_is_built_once():
    models, built = plate_models(builtin("C1"), 6), list[str]()
    rng = np.random.default_rng(0)
    for own in variants(LAYUP, models.facts)[::12]:
        reduced = extended_model(models, own, built.append)
        x = reduced.parameters.sample(rng, 40)
        x = x[reduced.admissible(x)][:4]
        assert reduced.parameters == models.bare.parameters
        assert basis_error(reduced, x).max() < 2.0 * models.bare.tolerance  # twice the basis's tolerance
        moved = reduced.predict(x, jacobian=True)
        assert not np.allclose(moved.frequencies, models.bare.predict(x).frequencies, rtol=1e-3)
        step = 1e-5 * np.diag(x[0])
        up, down = (reduced.predict(x[0] + s * step).frequencies for s in (1.0, -1.0))
        quotients = (up - down).T / 2e-5
        np.testing.assert_allclose(moved.jacobian[0] * x[0], quotients, rtol=1e-4, atol=1e-4 * up.max())
    assert built == ["building layup"]
