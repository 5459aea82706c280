"""Forms of causes on real plates, and what the catalogue's forms miss of them."""

import math
import tomllib
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.diagnosis.cases import plate_case
from cpam_bayes.diagnosis.models import extended_model
from cpam_bayes.effects import CATALOGUE, variants
from tests.effects.cases import BY_NAME
from tests.test_studies import saved, script
from validation.independent.forms import FORMS, Bench, RealForm, bench
from validation.independent.lists import PLATES
from validation.independent.true_plate import natural_frequencies

STUDY = "25_form_errors"
N = 6
FREE, CLAMPED = PLATES[1], PLATES[3]
COARSE = (8, 8)


@lru_cache
def on(clamped: bool) -> Bench:
    return bench((CLAMPED if clamped else FREE).plate, N, COARSE)


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


@pytest.mark.parametrize("nominal", [FREE, CLAMPED], ids=["free", "clamped"])
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
