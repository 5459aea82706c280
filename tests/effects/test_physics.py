"""Effects against closed forms, against other descriptions of the same plate, and against quadrature."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

import cpam_bayes as cb
from cpam_bayes.diagnosis.models import extended_model, plate_models
from cpam_bayes.effects import CATALOGUE, PlateFacts, add_air, add_known_mass, extend, variants
from cpam_bayes.effects.geometry import SWAPPED_SIDES
from cpam_bayes.effects.masses import PressureJumps, jump_energy
from cpam_bayes.effects.plies import _G
from cpam_bayes.forward_model.model import angle_parameters, plate_problem
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.problem import AREA, Problem
from cpam_bayes.mechanics.ritz import RitzSettings, RitzSpace, ritz_space
from cpam_bayes.plate.edges import FIELDS
from cpam_bayes.plate.reader import builtin
from tests.effects.cases import BY_NAME, bare, facts, facts_of, frequencies, placed, values_at, with_effect
from tests.hybrids import hybrid
from tests.mechanics.test_problem import strains as strains_of_a_flat_plate
from tests.mechanics.test_problem import whole
from tests.plates import CARBON, CROSS_PLY_16S, plate, with_plate

PLY = CARBON | {"G13": 5.1e9, "G23": 3.0e9}


def applied(problem: Problem, name: str, layup: tuple[float, ...] = (0.0,)) -> Problem:
    return extend(problem, placed(BY_NAME[name]), facts_of(problem, layup))


# The same plate, described otherwise


STATED = {"length": 0.26, "width": 0.2, "thickness": 0.003, "density": 1600.0}


@pytest.mark.parametrize("name", STATED)
def test_sizes_thickness_and_density_are_those_of_a_plate_so_stated(name: str) -> None:
    problem = applied(plate(*STATED.values(), PLY, CROSS_PLY_16S), name)
    other = plate(*{**STATED, name: 1.03 * STATED[name]}.values(), PLY, CROSS_PLY_16S)
    for kind in ("stiffness", "mass"):
        found = problem.coefficients({f"{name}_deviation": np.asarray(0.03)}, kind)
        np.testing.assert_allclose(found, other.coefficients({}, kind), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["thickness", "length", "width", "skew", "taper_x", "taper_y", "density"])
def test_a_weighed_plate_keeps_its_mass_where_a_size_is_another_one(name: str) -> None:
    original = plate(*STATED.values(), PLY, CROSS_PLY_16S)
    weighed = replace(facts_of(original, CROSS_PLY_16S), weighed=True)
    effect = placed(BY_NAME[name])
    changed = extend(original, effect, weighed)
    state = changed.state({p.name: np.asarray(0.04) for p in effect.parameters})
    mass = float(state.density * state.thickness * state.area)
    expected = 1.04 if name == "density" else 1.0  # of a weighed plate that is a wrong mass
    assert mass == pytest.approx(expected * 1600.0 * 0.003 * 0.26 * 0.2, rel=1e-12)


def test_clamp_length_is_the_length_across_the_clamp() -> None:
    for edges, longer in (("CFFF", (0.261, 0.2)), ("FFFC", (0.26, 0.201)), ("CFCF", (0.261, 0.2))):
        problem = applied(plate(0.26, 0.2, 0.003, 1600.0, PLY, edges=edges), "clamp_length")
        found = problem.state({"clamp_shift": np.asarray(1e-3)})
        np.testing.assert_allclose((found.length, found.width), longer, rtol=1e-14)


EVERY_PLY = slice(None)


@pytest.mark.parametrize(
    ("effect", "layup", "plies", "turn"),
    [
        ("misorientation", CROSS_PLY_16S, EVERY_PLY, -7.0),
        ("misorientation", (30.0, -60.0, 10.0), EVERY_PLY, 3.0),
        ("outer_ply_angle", CROSS_PLY_16S, [0, 31], 12.0),
        ("inner_ply_angle", CROSS_PLY_16S, [14, 17], 12.0),
    ],
)
def test_turned_plies_are_the_layup_so_written(
    effect: str, layup: tuple[float, ...], plies: slice | list[int], turn: float
) -> None:
    angles = np.array(layup)
    angles[plies] += turn
    original, turned = (
        plate(0.26, 0.2, 0.003, 1600.0, PLY, of, shear=bare("C1").nominal.shear)
        for of in (layup, tuple(angles.tolist()))
    )
    (parameter,) = BY_NAME[effect].parameters
    found = applied(original, effect, layup).state({parameter.name: np.asarray(turn)})
    expected = turned.nominal.stiffness()
    np.testing.assert_allclose(found.stiffness(), expected, rtol=0, atol=1e-12 * expected.max())


@pytest.mark.parametrize(
    ("effect", "turn", "stated", "written"),
    [
        ("outer_ply_angle", 30.0, "[c0_2/g45/g-45/c90]_s", "[c30/c0/g45/g-45/c90/c90/g-45/g45/c0/c30]"),
        ("misorientation", 20.0, "[c0_2/g45/g-45/c90]_s", "[c20_2/g65/g-25/c-70]_s"),
        ("misorientation", 17.0, "[c0/g45/c30]", "[c17/g62/c47]"),
    ],
)
def test_plies_of_a_hybrid_turn_with_their_own_stiffness(
    effect: str, turn: float, stated: str, written: str
) -> None:
    known, turned = (
        cb.read_plate(hybrid(layup=layup, thickness_mm=3.0 if "90" in stated else 0.875))
        for layup in (stated, written)
    )
    problem = extend(plate_problem(known), BY_NAME[effect], PlateFacts.of(known.plate, isotropic=False))
    found = problem.state({BY_NAME[effect].parameters[0].name: np.asarray(turn)}).stiffness()
    np.testing.assert_allclose(found, plate_problem(turned).nominal.stiffness(), rtol=1e-9, atol=1e-3)


def test_the_shear_modulus_of_each_material_of_a_hybrid_is_another_one() -> None:
    specimen = cb.read_plate(hybrid())
    problem = plate_problem(specimen)
    extended = extend(problem, BY_NAME["shear_ratio"], PlateFacts.of(specimen.plate, isotropic=False))
    changed = extended.state({"shear_ratio_deviation": np.asarray(0.1)}).constants
    for name, value in problem.nominal.constants.items():
        assert changed[name] == pytest.approx(value * (1.1 if name.endswith("G13") else 1.0))


def test_stiffness_effects_change_their_own_entries_alone() -> None:
    problem = with_effect("C1", BY_NAME["transverse_shear"])
    plain, changed = bare("C1").state({}).stiffness(), problem.state({"log_shear_factor": np.asarray(0.3)})
    expected = plain.copy()
    expected[6:, 6:] *= np.exp(0.3)
    np.testing.assert_allclose(changed.stiffness(), expected, rtol=1e-14)
    assert bare("C1").state({}).stiffness()[6, 6] == plain[6, 6]  # the bare plate is left alone
    ratio = with_effect("C1", BY_NAME["shear_ratio"]).state({"shear_ratio_deviation": np.asarray(-0.2)})
    assert ratio.constants["G13"] == pytest.approx(0.8 * 6.25e9)
    np.testing.assert_array_equal(ratio.stiffness()[:6, :6], plain[:6, :6])


def test_resin_skin_is_a_thinner_laminate_between_two_resin_plies() -> None:
    h, t = 3.2e-3, 1e-4
    found = with_effect("C1", BY_NAME["resin_skin"]).state({"skin_thickness": np.asarray(t)}).stiffness()
    core = replace(bare("C1").nominal, thickness=np.asarray(h - 2 * t)).stiffness()
    q = 3.5e9 / (1 - 0.35**2)
    assert found[0, 0] == pytest.approx(core[0, 0] + 2 * t * q)
    # parallel axes: each skin has its own inertia and that of its distance from the midplane
    inertia = 2 * (t**3 / 12 + t * ((h - t) / 2) ** 2)
    assert found[3, 3] == pytest.approx(core[3, 3] + inertia * q)
    assert found[5, 5] == pytest.approx(core[5, 5] + inertia * 3.5e9 / 2.7)
    np.testing.assert_allclose(found[6:, 6:], core[6:, 6:], rtol=1e-12)


def test_sensor_mass_is_a_known_mass_of_that_size_and_turns_with_its_radius_about_the_surface() -> None:
    n, m, r = bare("D3").nominal, 2e-3, 4e-3
    point, wide = (
        extend(bare("D3"), BY_NAME["sensor_mass"].at((0.95, 0.275, of)), facts("D3"))  # type: ignore[misc]
        for of in (0.0, r)
    )
    known = add_known_mass(bare("D3"), m, 0.95 * float(n.length), 0.275 * float(n.width))
    found, turning = (p.coefficients({"sensor_mass": np.asarray(m)}, "mass") for p in (point, wide))
    np.testing.assert_allclose(found, known.coefficients({}, "mass"), rtol=1e-14)
    places = [np.array([f.region.point for f in p.forms("mass")]) for p in (point, known)]
    np.testing.assert_allclose(*places, rtol=1e-14)
    inertia = m * (float(n.thickness) ** 2 / 4 + r**2)
    np.testing.assert_allclose(turning[-5:], [m, m, m, inertia, inertia], rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["A2", "D3"])
def test_swapped_sides_are_the_plate_with_its_sides_exchanged(name: str) -> None:
    models, own = plate_models(builtin(name), 6), builtin(name).plate
    (swapped,) = variants(SWAPPED_SIDES, models.facts)
    expected = plate_models(with_plate(name, length=own.width, width=own.length), 6).bare.full
    x = models.samples.x[:1]
    f = extended_model(models, swapped).predict(x).frequencies[0, :6]
    np.testing.assert_allclose(f, expected.predict(x).frequencies[0, :6], rtol=2e-4)
    assert np.abs(f / models.bare.predict(x).frequencies[0, :6] - 1.0).max() > 0.01


def test_plates_that_an_exchange_of_sides_leaves_alike_do_not_have_it() -> None:
    of = replace(facts("C1"), length=0.3)
    assert SWAPPED_SIDES.applies_to(of)
    assert not SWAPPED_SIDES.applies_to(facts("C1"))  # square
    assert not SWAPPED_SIDES.applies_to(replace(of, isotropic=True))
    assert SWAPPED_SIDES.applies_to(replace(of, isotropic=True, edges="CFFF"))


@pytest.mark.parametrize("edges", ["FFFF", "CFFF"])
def test_a_skewed_isotropic_plate_is_the_same_seen_from_its_other_side(edges: str) -> None:
    # the parallelogram of sides a, b mirrored in its bisector has sides b, a
    isotropic = {"E1": 70e9, "nu12": 0.3}
    swapped = {"FFFF": "FFFF", "CFFF": "FCFF"}[edges]
    one = applied(plate(0.3, 0.2, 0.004, 2700.0, isotropic, edges=edges), "skew")
    other = applied(plate(0.2, 0.3, 0.004, 2700.0, isotropic, edges=swapped), "skew")
    f, g = (frequencies(p, {"skew_deg": 15.0}, degree=9) for p in (one, other))
    straight = frequencies(one, {"skew_deg": 0.0}, degree=9)
    np.testing.assert_allclose(f, g, rtol=3e-4)  # bases of nine polynomials err by 1e-4
    assert np.abs(f / straight - 1).max() > 0.01


def test_a_square_turned_to_a_rhombus_has_its_area_in_the_mass() -> None:
    problem = with_effect("C1", BY_NAME["skew"])
    plain, skewed = (problem.coefficients({"skew_deg": np.asarray(s)}, "mass") for s in (0.0, 8.0))
    np.testing.assert_allclose(skewed, np.cos(np.deg2rad(8.0)) * plain, rtol=1e-13)


# Closed forms


# Of a root spring EI / (c L), and of one EI / (c L^3): what is zero at b = (frequency parameter)^(1/2).
ROOTS: dict[str, Callable[[float, float], float]] = {
    "rotation": lambda b, c: (
        1 + np.cos(b) * np.cosh(b) + c * b * (np.cos(b) * np.sinh(b) - np.sin(b) * np.cosh(b))
    ),
    "translation": lambda b, c: (
        1 + np.cos(b) * np.cosh(b) - c * b**3 * (np.cos(b) * np.sinh(b) + np.sin(b) * np.cosh(b))
    ),
}


@pytest.mark.parametrize(
    ("way", "c"), [("rotation", 0.0), ("rotation", 0.02), ("rotation", 0.1), ("translation", 0.01)]
)
def test_a_strip_on_a_spring_has_the_frequency_of_a_beam(way: str, c: float) -> None:
    length, h, e, rho = 0.4, 2e-3, 70e9, 2700.0
    strip = plate(length, 0.02, h, rho, {"E1": e, "nu12": 0.0}, edges="CFFF")
    found = frequencies(applied(strip, f"clamp_{way}"), {f"{way}_compliance": c}, n=1, degree=7)[0]
    b = brentq(ROOTS[way], 1.0, 2.0, args=(c,))
    expected = b**2 / (2 * np.pi * length**2) * np.sqrt(e * h**2 / (12 * rho))
    # the plate's shear and rotary inertia are worth 1e-4, the rigid clamp's own spring 6e-5
    assert found == pytest.approx(expected, rel=5e-4)


def test_rotation_and_translation_of_a_clamp_go_together_and_slip_goes_alone() -> None:
    both = bare("D3")
    for name in ("clamp_rotation", "clamp_translation"):
        both = extend(both, BY_NAME[name], facts("D3"))
    assert both.edges == "EFFF"
    assert both.parameters.names == ("rotation_compliance", "translation_compliance")
    values = {"rotation_compliance": 0.02, "translation_compliance": 0.002}
    alone = [
        frequencies(with_effect("D3", BY_NAME[name]), {p: values[p]}, degree=8)
        for name, p in zip(("clamp_rotation", "clamp_translation"), values, strict=True)
    ]
    assert np.all(frequencies(both, values, degree=8) < np.minimum(*alone) * (1 + 1e-5))
    with pytest.raises(ValueError, match="slip does not go with another"):
        extend(both, BY_NAME["clamp_slip"], facts("D3"))


@pytest.mark.parametrize(("aspect", "expected"), [(1.0, 0.579), (1.5, 0.690), (2.0, 0.757)])
def test_heaving_plate_moves_the_added_mass_of_the_literature(aspect: float, expected: float) -> None:
    # in units of rho pi / 4 short^2 long (Meyerhoff, J. Ship Research 14, 1970)
    t, w = np.polynomial.legendre.leggauss(120)
    points = np.stack(np.meshgrid((t + 1) / 2, (t + 1) / 2, indexing="ij"), axis=-1).reshape(-1, 2)
    moments = np.outer(w / 2, w / 2).ravel() @ PressureJumps(aspect, 1.0)(points)
    assert np.sum(moments**2) / (np.pi / 4 * aspect) == pytest.approx(expected, abs=6e-4)


def test_energy_of_the_potential_jumps_is_symmetric_definite_and_scales_with_length() -> None:
    small, large = jump_energy(0.3, 0.2), jump_energy(0.6, 0.4)
    np.testing.assert_allclose(small, small.T, rtol=0, atol=1e-12 * small.max())
    assert np.linalg.eigvalsh(small)[0] > 0
    np.testing.assert_allclose(large, 2 * small, rtol=0, atol=1e-9 * small.max())


def test_air_of_a_known_density_is_the_effect_at_that_value() -> None:
    known = add_air(bare("C1"), 1.1)
    effect = with_effect("C1", BY_NAME["air"])
    found = effect.coefficients({"air_density": np.asarray(1.1)}, "mass")
    np.testing.assert_array_equal(known.coefficients({}, "mass"), found)


def test_residual_stress_is_in_equilibrium_free_of_edge_loads_and_of_the_stated_size() -> None:
    assert [float(_G(np.array([t]))[0]) for t in (0.0, 1.0)] == [0.0, 0.0]
    assert [float(_G.derivative()(np.array([t]))[0]) for t in (0.0, 1.0)] == [0.0, 0.0]
    a, b = 0.28, 0.25
    problem = applied(plate(a, b, 3e-3, 2700.0, {"E1": 70e9, "nu12": 0.3}), "membrane_stress")
    (term,) = [t for t in problem.terms if t.name == "membrane_stress"]
    c = term.coefficients(problem.nominal, {"residual_stress": np.asarray(1e6)})
    t = np.linspace(0, 1, 401)
    grid = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    # the coefficients hold the area and the two sides that derivatives are divided by
    n_x, n_y, n_xy = (
        q * form.weight(grid).reshape(401, 401) * scale  # type: ignore[misc]
        for q, form, scale in zip(c, term.forms, (a / b, b / a, 1.0), strict=True)
    )
    largest = max(np.abs(n).max() for n in (n_x, n_y, n_xy))
    assert largest / 3e-3 == pytest.approx(1e6, rel=1e-12)
    # N_x,x + N_xy,y = 0 and N_xy,x + N_y,y = 0, by differences of second order
    d = t[1]
    for first, second in ((n_x / a, n_xy / b), (n_xy / a, n_y / b)):
        parts = np.gradient(first, d, axis=0), np.gradient(second, d, axis=1)
        inner = (slice(1, -1), slice(1, -1))
        assert np.abs(parts[0] + parts[1])[inner].max() < 1e-3 * np.abs(parts[0]).max()


def test_loss_tangent_stiffens_by_its_share_of_pi_per_unit_of_log_frequency() -> None:
    observe = BY_NAME["viscoelastic"].observe
    assert observe is not None
    f = np.array([100.0, 100.0 * np.e, 100.0 * np.e**2])
    found = observe(f, {"loss_tangent": np.array([0.01])})[0]
    np.testing.assert_allclose(np.log(found / f), [0.0, 0.01 / np.pi, 0.02 / np.pi], rtol=1e-12, atol=1e-15)


# Energies from the definitions, by quadrature


def strains(problem: Problem, space: RitzSpace, sags: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Generalised strains (n_points, 8, n) of a shallow cap and the points' weights times the area."""
    found, area = strains_of_a_flat_plate(space, problem.nominal)
    rule, sides = space.quadrature(AREA), (float(problem.nominal.length), float(problem.nominal.width))
    start = sum(space.dimension(f) for f in FIELDS[: FIELDS.index("w")])
    w = slice(start, start + space.dimension("w"))
    w_x, w_y = (space.evaluate("w", rule, d) / side for d, side in zip(("x", "y"), sides, strict=True))  # type: ignore[arg-type]
    # w0 = sag_x 4 xi (1 - xi) + sag_y 4 eta (1 - eta)
    slope_x, slope_y = (
        sag * 4 * (1 - 2 * at) / side for sag, at, side in zip(sags, rule.points.T, sides, strict=True)
    )
    found[:, 0, w] += slope_x[:, None] * w_x
    found[:, 1, w] += slope_y[:, None] * w_y
    found[:, 2, w] += slope_x[:, None] * w_y + slope_y[:, None] * w_x
    return found, area


SAGS = (4e-3, -2.5e-3)


@pytest.mark.parametrize("name", ["taper_x", "taper_y", "damage", "warp"])
def test_stiffness_with_an_effect_is_the_energy_of_its_strains_by_quadrature(name: str) -> None:
    layup = (30.0, -60.0, 10.0)
    problem = plate(0.3, 0.2, 0.02, 1600.0, PLY, layup, "CFFF")
    effect = applied(problem, name, layup)
    space = ritz_space("CFFF", problem.nominal, RitzSettings(5, 5, 1, True))
    value = {"taper_x": 0.1, "taper_y": -0.1, "damage": 0.3, "warp": 0.0}[name]
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
        local = replace(problem.nominal, thickness=0.02 * (1 + value * s))
        stiffness = local.stiffness()
    if name == "damage":
        away = (points - 0.5) * np.array([0.3, 0.2])
        bell = 1 - value * np.exp(-np.sum(away**2, axis=1) / (2 * 0.01**2))
        stiffness[:, 3:6, 3:6] *= bell[:, None, None]
        stiffness[:, 6:, 6:] *= bell[:, None, None]
    expected = np.einsum("p,pin,pij,pjm->nm", area, b, stiffness, b, optimize=True)
    # both integrate polynomials exactly; the bell is narrow for the rule that is compared with
    tolerance = 2e-3 if name == "damage" else 1e-11
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.abs(expected).max())


# Two at once


def test_effects_compose_in_either_order() -> None:
    names = ("misorientation", "membrane_stress", "thickness")
    values = {"misorientation_deg": 3.0, "residual_stress": 5e5, "thickness_deviation": 0.02}
    found = []
    for order in (names, names[::-1]):
        problem = bare("C1")
        for name in order:
            problem = extend(problem, BY_NAME[name], facts("C1"))
        found.append(frequencies(problem, values, degree=8))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-7)
    assert set(problem.parameters.names) == set(values)


def test_every_effect_works_with_an_unknown_layup() -> None:
    specimen = builtin("C1", sequence=True)
    problem = plate_problem(specimen, angle_parameters(specimen))
    its_facts = PlateFacts.of(specimen.plate, isotropic=False)
    angles = {name: np.array([10.0, 20.0]) for name in problem.parameters.names}
    for effect in CATALOGUE:
        if effect.change is None or not effect.applies_to(its_facts):
            continue
        effect = placed(effect)
        extended = extend(problem, effect, its_facts)
        for kind in ("stiffness", "mass"):
            c = extended.coefficients(angles | values_at(effect, (0.0, 1.0)), kind)
            assert np.all(np.isfinite(c))
            assert c.shape[-1] == len(extended.forms(kind))
        if effect.name == "outer_ply_angle":
            turned = {name: a[:1] for name, a in angles.items()} | {"outer_ply_deg": np.array([0.0, 5.0])}
            assert not np.allclose(*extended.coefficients(turned, "stiffness"))
