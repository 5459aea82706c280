"""Evidences on models of real plates: projected once more, hard to integrate, distributed over workers."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.evidence import sampled as sharing
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal, shared_out
from cpam_bayes.diagnosis.evidence.scan import marginal_of
from cpam_bayes.diagnosis.evidence.weighing import weigh
from cpam_bayes.diagnosis.next_test import next_measurements
from cpam_bayes.inference.student_mixture import sobol_points
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Measurement, builtin, read_plate
from tests.diagnosed import aluminium_case, listed
from tests.plate_file import described
from tests.shared import once_a_run
from validation.evidence_reference import ReferenceSettings, reference_evidence


def test_models_about_a_posterior_have_fewer_vectors_and_the_evidence_and_moments_of_the_whole_ones():
    """The list is nearly that of a tapered plate, under the hypothesis of a taper."""
    plate = aluminium_case().models.specimen
    # bounds only, so that a model has to cover more
    exact = plate_case(replace(plate, material=replace(plate.material, known=False)))
    exact = replace(exact, models=replace(exact.models, tolerances={}))
    case = listed(exact, np.array([1.004, 0.998, 1.002, 0.997, 1.003, 1.001]))
    hypothesis = next(h for h, _ in hypotheses_of([case]) if h.cause == "taper_x")
    tapered = sampled_marginal(marginal_of([case], hypothesis, (0,)))
    whole = tapered.comparison
    training = whole.scores.to_x(sobol_points(tapered.proposal, 6)[0])
    near = replace(whole, model=whole.model.about(training, 2e-5, 0.95, least_size=0))
    models = (c.model.parts[0].changes[0].model for c in (whole, near))
    before, after = (max(block.size for block in model.fast.operator.blocks) for model in models)
    assert after < 0.8 * before
    found, expected = (sampled_marginal(replace(tapered, comparison=c)) for c in (near, whole))
    assert found.log_evidence == pytest.approx(expected.log_evidence, abs=0.02)  # a hundredth of the noise
    mean, sd = expected.moments()
    np.testing.assert_array_less(np.abs(found.moments()[0] - mean), 0.02 * sd)
    # Ritz values of a smaller space are not lower; a few points in the tails of the proposal deviate more
    draws = np.random.default_rng(0).permutation(tapered.resampled(512))
    f, exactly = (c.model.predict(draws[128:]).frequencies for c in (near, whole))
    assert (f / exactly).min() - 1.0 > -1e-9
    assert np.quantile(f / exactly, 0.95) - 1.0 < 1.5 * 2e-5


NOISE, N = 0.002, 10


@once_a_run
def plate():
    waiting = Measurement(np.arange(1.0, N + 1.0), 0.0, NOISE, None, ("",) * N, complete=True)
    return plate_case(replace(builtin("C1"), measurement=waiting))


@pytest.mark.parametrize(
    ("form", "damage", "least"),
    [
        ("bell", (0.6, 0.55, 0.7, 0.13), 100.0),
        ("rectangle", (0.45, 0.89, 0.76, 0.07), 5.0),
        pytest.param("rectangle", (0.45, 0.93, 0.98, 0.18), 5.0, marks=pytest.mark.weekly),
    ],
)
@pytest.mark.slow
def test_a_hidden_damage_is_found_with_a_known_evidence(form, damage, least):
    case = plate()
    hypotheses = hypotheses_of([case])
    (plain,) = (h for h, _ in hypotheses if h.cause == "none")
    (effect,) = (e for h, _ in hypotheses for e in h.effects if e.name == "damage" and e.local == form)
    x = np.concatenate((case.models.samples.x[0], damage))  # a depth, a place and an extent
    f = case.with_effect(effect).predict(x[None]).frequencies[0, :N]
    f = f * (1.0 + NOISE * np.random.default_rng(1).standard_normal(N))
    case = replace(case, measurement=replace(case.measurement, frequencies=np.sort(f)))
    none = marginal_of([case], plain, (0,))
    for hypothesis in (h for h, _ in hypotheses if h.cause == "damage"):
        marginal = sampled_marginal(marginal_of([case], hypothesis, (0,), none=none))
        assert marginal.log_evidence - none.log_evidence > least
        assert marginal.error < 0.3
        if hypothesis.effects[0].local == form:
            mean, sd = marginal.moments()
            at = list(marginal.sizes)
            assert np.all(np.abs(mean[at] - damage) < 3.0 * sd[at])  # a single list: within three sd


# Bricks with an ideal clamp: a clamp that hardly gives is weighed, though its prior's median is a gross one.
CONSTANTS = {"E1_GPa": 126.0, "E2_GPa": 8.7, "nu12": 0.3, "G12_GPa": 4.9}
MATERIAL = {"isotropic": False, **CONSTANTS, "sd": {name: 0.07 * value for name, value in CONSTANTS.items()}}
BOUNDS = {"E1_GPa": [80.0, 200.0], "E2_GPa": [5.0, 16.0], "nu12": [0.15, 0.45], "G12_GPa": [2.5, 10.0]}
MEASURED = [42.2, 81.2, 263.7, 326.6, 616.0, 731.9, 759.9, 792.5, 1126.3, 1311.0]
LISTED = {"frequencies_hz": MEASURED, "resolution_hz": 0.1, "relative_std": 0.002}
TABLES = {"layup": "[0/90]_2s", "edges": "CFFF", "unknowns": BOUNDS, "measurement": LISTED}
CLAMPED = described((262.0, 148.0, 2.4), 1570.0, MATERIAL, **TABLES)
SPRINGS = ("clamp_rotation", "clamp_translation", "soft_clamp")


@pytest.mark.slow
def test_springs_of_a_stiff_clamp_have_the_evidence_of_the_reference():
    case = plate_case(read_plate(CLAMPED))
    chosen = [(h, plates) for h, plates in hypotheses_of([case]) if h.cause in ("none", *SPRINGS)]
    tested = {t.hypothesis.cause: t for t in weigh([case], chosen).tested}
    assert set(tested) == {"none", *SPRINGS}
    settings = ReferenceSettings(draws=1024, nodes=101, log2_points=(12, 13))
    for t in (tested[cause] for cause in SPRINGS):
        slow = reference_evidence(t.marginal.comparison, t.columns, 0, settings)
        assert slow.error < 0.1
        assert t.marginal.log_evidence == pytest.approx(slow.log_evidence, abs=0.3)
        # nearly rigid springs are the plain model, times the prior probability of so small a size of each
        least = len(t.hypothesis.parameters) * np.log(0.05)
        assert t.marginal.log_evidence - tested["none"].marginal.log_evidence > least


# Work on hypotheses: the same with any executor, with the models of this process in every answer

CAUSES = {"none", "other", "thickness", "viscoelastic", "outlier"}


def parts(*item):
    """Arguments as the worker received them, in reverse order."""
    return item[::-1]


def diagnosed_on(executor):
    case = listed(aluminium_case(), np.array([1.0, 1.0, 1.0, 1.03, 1.0, 1.0]))
    some = [(h, at) for h, at in hypotheses_of([case]) if h.cause in CAUSES]
    diagnosis = diagnose_cases([case], hypotheses=some, executor=executor)
    return diagnosis, next_measurements(diagnosis, always=True, executor=executor)


def numbers(diagnosis):
    each = [(t.marginal, t.probability) for t in diagnosis.weighed.tested]
    return [np.array([m.log_evidence, p, *m.moments()[0]]).tobytes() for m, p in each]


@pytest.mark.slow
def test_diagnosis_is_the_same_bit_for_bit_on_workers():
    here, tests_here = diagnosed_on(None)
    with open_executor("processes", 2) as executor:
        there, tests_there = diagnosed_on(executor)
    assert (numbers(here), here.claim, tests_here) == (numbers(there), there.claim, tests_there)
    assert here.detectable == there.detectable
    assert here.gain.held_out.tobytes() == there.gain.held_out.tobytes()


def test_models_of_this_process_come_back():
    case = aluminium_case()
    effect = next(e for h, _ in hypotheses_of([case]) for e in h.effects if e.name == "thickness")
    model, paired = case.with_effect(effect), replace(case, modes=case.modes[::-1])
    with ThreadPoolExecutor(1) as executor:
        (answer,) = shared_out(parts, [case], [(case.models, model, paired, np.arange(3.0))], executor)
    array, back, same_model, same_models = answer
    assert same_model is model
    assert same_models is back.models is case.models
    assert back.extended is case.extended
    np.testing.assert_array_equal(back.modes, paired.modes)
    np.testing.assert_array_equal(array, np.arange(3.0))


def test_what_items_have_in_common_is_sent_once(monkeypatch):
    common, sent, packed = np.arange(50_000.0), [], sharing._packed

    def weighed(held, value):
        sent.append(len(packed(held, value)))
        return packed(held, value)

    monkeypatch.setattr(sharing, "_packed", weighed)
    answers = shared_out(parts, [], [(common, i) for i in range(3)], common=common)
    assert [(number, one is common) for number, one in answers] == [(0, True), (1, True), (2, True)]
    assert sum(size > 1000 for size in sent) == 1


def test_what_cannot_be_sent_is_worked_on_here_progress_is_told_and_errors_are_raised():
    item = (lambda: 7,)
    with pytest.raises((pickle.PicklingError, AttributeError)):
        pickle.dumps(item)
    with ThreadPoolExecutor(1) as executor:
        assert shared_out(parts, [], [item], executor) == [item]
    told = []
    shared_out(parts, [], [(1, 2), (3, 4)], progress=told.append)
    assert told == [1, 2]
    with pytest.raises(ZeroDivisionError):
        shared_out(lambda item: item / 0, [], [(1,)])
