"""Truths of benchmarks are right and have causes as in the catalogue, whose forms miss some of real ones."""

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
from validation.independent import elements, lists
from validation.independent.forms import FORMS, Bench, RealForm, bench
from validation.independent.true_plate import (
    FLAWS,
    Mass,
    Patch,
    TruePlate,
    natural_frequencies,
    sensitivities,
    weight,
)

CARBON = {"E1": 121.2e9, "E2": 9.34e9, "nu12": 0.23, "G12": 6.25e9}
CROSS_PLY = tuple([0.0, 90.0] * 8 + [90.0, 0.0] * 8)
C1 = TruePlate(0.26, 0.26, 0.0032, 1590.0, "FFFF", CROSS_PLY, CARBON, correction=5 / 6)
A2 = TruePlate(0.25, 0.28, 0.003, 2700.0, "CFFF", (0.0,), {"E1": 69e9, "nu12": 0.33}, correction=5 / 6)
# Coarse: for relations that hold on any mesh.
SMALL = replace(C1, mesh=8)


@pytest.mark.parametrize(
    ("plate", "converged"),
    [
        (C1, [100.366, 298.584, 324.574, 360.347, 381.139, 600.611]),
        (A2, [40.9165, 90.673, 240.069, 276.238, 340.704, 566.456]),
    ],
    ids=["C1", "A2"],
)
def test_converged_frequencies_of_two_ritz_bases_are_met(plate: TruePlate, converged: list[float]) -> None:
    # two solvers that are no part of the package agree on these to 2e-6; the mesh costs 1e-4 at most
    np.testing.assert_allclose(natural_frequencies(plate, 6), converged, rtol=1e-4)


def test_two_plies_of_one_metal_have_the_shear_stiffness_of_its_parabola() -> None:
    c = elements.completed({"E1": 70e9, "nu12": 0.3})
    stiffness = elements.laminate_stiffness([(c, 0.0, 0.001), (c, 0.0, 0.001)])
    assert stiffness[7, 7] == pytest.approx(5 / 6 * c["G12"] * 0.002, rel=1e-10)


def test_a_point_mass_lowers_by_its_kinetic_energy_and_a_soft_patch_by_its_strain_energy() -> None:
    f = natural_frequencies(SMALL, 6)
    heavy = natural_frequencies(replace(SMALL, masses=(Mass(1e-3, 0.24, 0.2),)), 6)
    soft = natural_frequencies(replace(SMALL, patches=(Patch("ellipse", 0.1, 0.1, 0.04, 0.03, 0.3),)), 6)
    assert (heavy < f * (1 + 1e-9)).all()
    assert (soft < f).all()


def test_sensitivities_are_difference_quotients() -> None:
    plate = replace(SMALL, length=0.3)
    _, slopes = sensitivities(plate, ("E1", "G12"), 4)
    for j, name in enumerate(("E1", "G12")):
        up, down = (
            natural_frequencies(replace(plate, constants={**CARBON, name: CARBON[name] * s}), 4)
            for s in (1.001, 0.999)
        )
        np.testing.assert_allclose(slopes[:, j], np.log(up / down) / np.log(1.001 / 0.999), atol=1e-5)


def test_stiff_springs_hold_as_a_clamp_does() -> None:
    held = replace(A2, mesh=8)
    np.testing.assert_allclose(
        natural_frequencies(replace(held, turn=1e-7, shift=1e-9), 4), natural_frequencies(held, 4), rtol=2e-5
    )


FREE, HELD = lists.PLATES[1], lists.PLATES[3]
N = 6
# Each with the names of its sizes in the catalogue. A clamp that slips ends abruptly in the truth and fades
# in the catalogue, and a truth's mass is taller than a point: these agree less by intention.
CAUSES: dict[str, dict[str, float]] = {
    "clamp_rotation": {"rotation_compliance": 1.0},
    "clamp_translation": {"translation_compliance": 1.0},
    "soft_clamp": {"soft_rotation_compliance": 0.02, "soft_translation_compliance": 0.002},
    "clamp_length": {"clamp_shift": 1.0},
    "support": {"support_frequency": 1.0},
    "thickness": {"thickness_deviation": 1.0},
    "density": {"density_deviation": 1.0},
    "length": {"length_deviation": 1.0},
    "width": {"width_deviation": 1.0},
    "taper_x": {"taper_x": 1.0},
    "taper_y": {"taper_y": 1.0},
    "skew": {"skew_deg": 1.0},
    "misorientation": {"misorientation_deg": 1.0},
    "outer_ply_angle": {"outer_ply_deg": 1.0},
    "inner_ply_angle": {"inner_ply_deg": 1.0},
    "warp": {"sag": 1.0},
    "membrane_stress": {"residual_stress": 1.0},
    "transverse_shear": {"log_shear_factor": 1.0},
    "shear_ratio": {"shear_ratio_deviation": 1.0},
    "resin_skin": {"skin_thickness": 1.0},
}


def of_package(specimen: Specimen, effect: Effect | None, values: dict[str, float]) -> np.ndarray:
    problem = plate_problem(specimen)
    if effect is not None:
        problem = extend(problem, effect, PlateFacts.of(specimen.plate, specimen.material.isotropic))
    stack = {name: np.array([value]) for name, value in values.items()}
    operator = discretise_sparse(problem, fem_space(problem.edges, problem.nominal, 10, 10), stack)
    k, m = (np.atleast_2d(c) for c in operator.coefficients(stack))
    return np.asarray(solve(operator, k, m, N).frequencies[0])


def shifted(plate: TruePlate, cause: str, size: float) -> np.ndarray:
    flaw, plate = FLAWS[cause], replace(plate, mesh=10)
    return natural_frequencies(flaw.apply(plate, size, {"ratio": 1.0}), N) / natural_frequencies(plate, N)


@pytest.mark.parametrize("cause", CAUSES)
def test_a_hidden_cause_shifts_and_is_stated_as_the_effect_of_its_name(cause: str) -> None:
    own = HELD if FLAWS[cause].applies(HELD.plate) else FREE
    size = 3.0 * FLAWS[cause].scale(own.plate)
    values = BY_NAME[cause].null | {name: factor * size for name, factor in CAUSES[cause].items()}
    listed = [100.0 + 50 * i for i in range(own.n_modes)]
    specimen = cb.read_plate(tomllib.loads(own.file(listed, stated=None)))
    expected = of_package(specimen, BY_NAME[cause], values) / of_package(specimen, None, {})
    # two coarse meshes: shifts of up to 27 %
    np.testing.assert_allclose(shifted(own.plate, cause, size), expected, atol=1e-3)
    stated = FLAWS[cause].stated(-3.0, {"ratio": 1.0}, 1.0)
    assert stated is not None
    assert abs(stated) == pytest.approx(3.0 * CAUSES[cause][BY_NAME[cause].sizes[0].name])


def test_an_added_mass_and_a_missing_corner_are_stated_as_what_they_weigh() -> None:
    aux = {"x": 1.0, "y": 0.0, "form": "rectangle", "ratio": 2.0}
    loaded = FLAWS["sensor_mass"].apply(SMALL, 0.03, aux)
    assert FLAWS["sensor_mass"].stated(0.03, aux, SMALL.total_mass) == pytest.approx(loaded.masses[0].mass)
    # points of the rule beside the cut are in or out
    fine = replace(SMALL, mesh=40)
    cut = FLAWS["outline"].apply(fine, 0.25, {**aux, "ratio": 1.0})
    assert FLAWS["outline"].stated(0.25, aux, 1.0) == pytest.approx(
        1.0 - weight(cut) / weight(fine), rel=0.02
    )


# Forms of causes on real plates, and what the catalogue's forms miss of them


STUDY = "25_form_errors"
COARSE = (8, 8)


@lru_cache
def on(clamped: bool) -> Bench:
    return bench((HELD if clamped else FREE).plate, N, COARSE)


def of(form: RealForm) -> Bench:
    return on(form.cause in ("clamp_slip", "clamp_rotation", "clamp_translation", "soft_clamp"))


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_the_catalogue_holds_the_form_errors_of_the_study_rounded_up(effect) -> None:
    measured = {row["cause"]: math.ceil(100.0 * row["rms"]) / 100.0 for row in saved(STUDY)["effects"]}
    # a step or a parabola is no taper, and another saddle no warp: these causes name their form
    for cause in ("taper_x", "taper_y", "warp"):
        assert measured.pop(cause) > 0.3
    assert effect.form_error == measured.get(effect.name, 0.0)


def test_every_cause_with_real_forms_is_measured() -> None:
    found = {(case["cause"], case["form"]) for case in saved(STUDY)["cases"]}
    assert found == {(form.cause, form.name) for form in FORMS}


@pytest.mark.parametrize("nominal", [FREE, HELD], ids=["free", "clamped"])
def test_a_plate_without_a_flaw_is_that_of_the_truths(nominal) -> None:
    mesh = 8
    expected = natural_frequencies(replace(nominal.plate, mesh=mesh), N)
    np.testing.assert_allclose(bench(nominal.plate, N, (mesh, mesh)).frequencies, expected, rtol=1e-8)


# tape stiffens the plate, whatever it holds
@pytest.mark.parametrize(
    "form", [f for f in FORMS if "tape" not in f.name], ids=lambda form: f"{form.cause}, {form.name}"
)
def test_a_form_of_no_size_is_no_flaw_and_one_of_a_size_is(form: RealForm) -> None:
    plate, place = of(form), form.places[0]
    bare = np.log(plate.frequencies)
    # a clamp's springs stand for what is held: they are 1e-6 of a side soft
    np.testing.assert_allclose(plate.solved(form.act(plate, 0.0, place)), bare, atol=2e-5)
    assert np.max(np.abs(plate.solved(form.act(plate, form.sizes[-1], place)) - bare)) > 1e-3


@pytest.mark.parametrize("cause", ["taper_x", "taper_y", "sensor_mass"])
def test_a_form_weighs_what_it_says(cause: str) -> None:
    plate = on(False)
    moved = np.zeros(5 * plate.mesh.n)
    moved[2 * plate.mesh.n : 3 * plate.mesh.n] = 1.0
    for form in (f for f in FORMS if f.cause == cause):
        _, m, _ = form.act(plate, form.sizes[0], form.places[0])
        share = form.sizes[0] if cause == "sensor_mass" else 0.0
        # a step is sampled by the points of the rule, an eighth of a side apart at most
        assert moved @ (m @ moved) == pytest.approx((1.0 + share) * plate.plate.total_mass, rel=5e-3), (
            form.name
        )


def test_the_catalogues_own_form_is_not_missed_and_its_size_is_found() -> None:
    study = script("studies", STUDY)
    nominal = replace(FREE, n_modes=study.N_MODES)
    plate = bench(nominal.plate, study.N_MODES)
    case = plate_case(
        cb.read_plate(tomllib.loads(nominal.file(plate.frequencies.tolist(), stated=study.NOISE)))
    )
    (own,) = variants(BY_NAME["taper_x"], case.models.facts)
    model = extended_model(case.models, own)
    tapered = replace(nominal.plate, taper=(0.1, 0.0), mesh=16)
    shift = np.log(natural_frequencies(tapered, study.N_MODES) / plate.frequencies)
    held, free = study._left(case, own, model, shift, (0.5, 0.5))
    rms = np.sqrt(np.mean(shift**2))
    # the two discretisations agree to 5e-4 on the tenth mode, of shifts of 2 %
    assert free <= held < 0.01 * rms
