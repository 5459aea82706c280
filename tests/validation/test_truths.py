"""Benchmark truths are right and agree with the catalogue's causes, whose forms miss part of real ones."""

import math
import tomllib
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.diagnosis.models import extended_model
from cpam_bayes.effects import CATALOGUE, Effect, PlateFacts, extend, variants
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.mechanics.fem import discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.plate import Specimen
from tests.effects.cases import BY_NAME
from tests.test_studies import saved, script
from validation.independent import elements, lists, true_plate
from validation.independent.forms import FORMS, Bench, RealForm, bench
from validation.independent.true_plate import FLAWS, Mass, Patch, TruePlate, natural_frequencies

CARBON = {"E1": 121.2e9, "E2": 9.34e9, "nu12": 0.23, "G12": 6.25e9}
CROSS_PLY = tuple([0.0, 90.0] * 8 + [90.0, 0.0] * 8)
C1 = TruePlate(0.26, 0.26, 0.0032, 1590.0, "FFFF", CROSS_PLY, CARBON, correction=5 / 6)
A2 = TruePlate(0.25, 0.28, 0.003, 2700.0, "CFFF", (0.0,), {"E1": 69e9, "nu12": 0.33}, correction=5 / 6)
SMALL = replace(C1, mesh=8)  # Coarse: for relations valid on any mesh.


def test_converged_frequencies_of_two_ritz_bases_and_the_shear_stiffness_of_a_metal_are_met() -> None:
    for plate, converged in (  # two independent solvers agree on these to 2e-6; the mesh costs at most 1e-4
        (C1, [100.366, 298.584, 324.574, 360.347, 381.139, 600.611]),
        (A2, [40.9165, 90.673, 240.069, 276.238, 340.704, 566.456]),
    ):
        np.testing.assert_allclose(natural_frequencies(plate, 6), converged, rtol=1e-4)
    c = elements.completed({"E1": 70e9, "nu12": 0.3})  # the shear stiffness of a parabola
    stiffness = elements.laminate_stiffness([(c, 0.0, 0.001), (c, 0.0, 0.001)])
    assert stiffness[7, 7] == pytest.approx(5 / 6 * c["G12"] * 0.002, rel=1e-10)


def test_a_point_mass_and_a_soft_patch_lower_frequencies_and_stiff_springs_hold_as_a_clamp_does() -> None:
    f = natural_frequencies(SMALL, 6)
    heavy = natural_frequencies(replace(SMALL, masses=(Mass(1e-3, 0.24, 0.2),)), 6)
    soft = natural_frequencies(replace(SMALL, patches=(Patch("ellipse", 0.1, 0.1, 0.04, 0.03, 0.3),)), 6)
    assert (heavy < f * (1 + 1e-9)).all()
    assert (soft < f).all()
    held = replace(A2, mesh=8)
    stiff = natural_frequencies(replace(held, turn=1e-7, shift=1e-9), 4)
    np.testing.assert_allclose(stiff, natural_frequencies(held, 4), rtol=2e-5)


def test_sensitivities_are_difference_quotients() -> None:
    plate = replace(SMALL, length=0.3)
    _, slopes = true_plate.sensitivities(plate, ("E1", "G12"), 4)
    for j, name in enumerate(("E1", "G12")):
        of = [replace(plate, constants={**CARBON, name: CARBON[name] * s}) for s in (1.001, 0.999)]
        up, down = (natural_frequencies(changed, 4) for changed in of)
        np.testing.assert_allclose(slopes[:, j], np.log(up / down) / np.log(1.001 / 0.999), atol=1e-5)


FREE, HELD = lists.PLATES[1], lists.PLATES[3]
N = 6
# By intention these agree less: a clamp that slips abruptly, and a mass that is taller than a point.
CAUSES = (
    *("clamp_rotation", "clamp_translation", "soft_clamp", "clamp_length", "support", "thickness", "density"),
    *("length", "width", "taper_x", "taper_y", "skew", "misorientation", "outer_ply_angle"),
    *("inner_ply_angle", "warp", "membrane_stress", "transverse_shear", "shear_ratio", "resin_skin"),
)


def of_package(specimen: Specimen, effect: Effect | None, values: dict[str, float]) -> np.ndarray:
    problem = plate_problem(specimen)
    if effect is not None:
        problem = extend(problem, effect, PlateFacts.of(specimen.plate, specimen.material.isotropic))
    stack = {name: np.array([value]) for name, value in values.items()}
    operator = discretise_sparse(problem, fem_space(problem.edges, problem.nominal, 10, 10), stack)
    k, m = (np.atleast_2d(c) for c in operator.coefficients(stack))
    return np.asarray(solve(operator, k, m, N).frequencies[0])


@pytest.mark.parametrize("cause", CAUSES)
def test_a_hidden_cause_shifts_and_is_stated_as_the_effect_of_its_name(cause: str) -> None:
    factors = (0.02, 0.002) if cause == "soft_clamp" else (1.0,)
    own = HELD if FLAWS[cause].applies(HELD.plate) else FREE
    size = 3.0 * FLAWS[cause].scale(own.plate)
    sizes = {s.name: factor for s, factor in zip(BY_NAME[cause].sizes, factors, strict=True)}
    values = BY_NAME[cause].null | {name: factor * size for name, factor in sizes.items()}
    listed = [100.0 + 50 * i for i in range(own.n_modes)]
    specimen = cb.read_plate(tomllib.loads(own.file(listed, stated=None)))
    expected = of_package(specimen, BY_NAME[cause], values) / of_package(specimen, None, {})
    bare = replace(own.plate, mesh=10)
    flawed = FLAWS[cause].apply(bare, size, {"ratio": 1.0})
    shifts = natural_frequencies(flawed, N) / natural_frequencies(bare, N)
    np.testing.assert_allclose(shifts, expected, atol=1e-3)  # two coarse meshes: shifts of up to 27 %
    assert abs(FLAWS[cause].stated(-3.0, {"ratio": 1.0}, 1.0)) == pytest.approx(3.0 * factors[0])


def test_an_added_mass_and_a_missing_corner_are_stated_as_what_they_weigh() -> None:
    aux = {"x": 1.0, "y": 0.0, "form": "rectangle", "ratio": 2.0}
    loaded = FLAWS["sensor_mass"].apply(SMALL, 0.03, aux)
    assert FLAWS["sensor_mass"].stated(0.03, aux, SMALL.total_mass) == pytest.approx(loaded.masses[0].mass)
    fine = replace(SMALL, mesh=40)  # points of the quadrature near the cut are in or out
    cut = FLAWS["outline"].apply(fine, 0.25, {**aux, "ratio": 1.0})
    missing = 1.0 - true_plate.weight(cut) / true_plate.weight(fine)
    assert FLAWS["outline"].stated(0.25, aux, 1.0) == pytest.approx(missing, rel=0.02)


STUDY, COARSE = "25_form_errors", (8, 8)


@lru_cache
def on(clamped: bool) -> Bench:
    return bench((HELD if clamped else FREE).plate, N, COARSE)


def test_the_catalogue_holds_the_form_errors_of_the_study_rounded_up_and_all_forms_are_measured() -> None:
    measured = {row["cause"]: math.ceil(100.0 * row["rms"]) / 100.0 for row in saved(STUDY)["effects"]}
    for cause in ("taper_x", "taper_y", "warp"):  # these causes specify their form
        assert measured.pop(cause) > 0.3
    for effect in CATALOGUE:
        assert effect.form_error == measured.get(effect.name, 0.0), effect.name
    found = {(case["cause"], case["form"]) for case in saved(STUDY)["cases"]}
    assert found == {(form.cause, form.name) for form in FORMS}


@pytest.mark.parametrize("nominal", [FREE, HELD], ids=["free", "clamped"])
def test_a_plate_without_a_flaw_is_that_of_the_truths(nominal) -> None:
    expected = natural_frequencies(replace(nominal.plate, mesh=8), N)
    np.testing.assert_allclose(bench(nominal.plate, N, COARSE).frequencies, expected, rtol=1e-8)


UNTAPED = {f"{form.cause}, {form.name}": form for form in FORMS if "tape" not in form.name}  # tape stiffens


@pytest.mark.parametrize("form", UNTAPED.values(), ids=UNTAPED)
def test_a_form_of_no_size_is_no_flaw_and_one_of_a_size_is(form: RealForm) -> None:
    plate, place = on(form.cause == "soft_clamp" or form.cause.startswith("clamp_")), form.places[0]
    bare = np.log(plate.frequencies)
    # a clamp's rigid edges are represented by springs with compliances of 1e-6 of a side
    np.testing.assert_allclose(plate.solved(form.act(plate, 0.0, place)), bare, atol=2e-5)
    assert np.max(np.abs(plate.solved(form.act(plate, form.sizes[-1], place)) - bare)) > 1e-3


@pytest.mark.parametrize("cause", ["taper_x", "taper_y", "sensor_mass"])
def test_a_form_weighs_what_it_says(cause: str) -> None:
    plate = on(False)
    moved = np.repeat([0.0, 0.0, 1.0, 0.0, 0.0], plate.mesh.n)
    for form in (f for f in FORMS if f.cause == cause):
        _, m, _ = form.act(plate, form.sizes[0], form.places[0])
        share = form.sizes[0] if cause == "sensor_mass" else 0.0
        expected = (1.0 + share) * plate.plate.total_mass
        assert moved @ (m @ moved) == pytest.approx(expected, rel=5e-3), form.name  # a coarsely sampled step


def test_the_catalogues_own_form_is_not_missed_and_its_size_is_found() -> None:
    study = script("studies", STUDY)
    nominal = replace(FREE, n_modes=study.N_MODES)
    plate = bench(nominal.plate, study.N_MODES)
    text = nominal.file(plate.frequencies.tolist(), stated=study.NOISE)
    case = plate_case(cb.read_plate(tomllib.loads(text)))
    (own,) = variants(BY_NAME["taper_x"], case.models.facts)
    model = extended_model(case.models, own)
    tapered = replace(nominal.plate, taper=(0.1, 0.0), mesh=16)
    shift = np.log(natural_frequencies(tapered, study.N_MODES) / plate.frequencies)
    held, free = study._left(case, own, model, shift, (0.5, 0.5))
    assert free <= held < 0.01 * np.sqrt(np.mean(shift**2))  # 5e-4 apart, with shifts of 2 %
