"""Which test tells causes apart: mutual information against quadrature, and predicted data."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from cpam_bayes.diagnosis import next_test as further
from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.evidence.weighing import Weighed
from cpam_bayes.diagnosis.hypotheses import Claim, Hypothesis
from cpam_bayes.diagnosis.models import plate_models
from cpam_bayes.diagnosis.next_test import FurtherTest, Predicted, information, next_measurements, outlook_of
from cpam_bayes.effects.effect import either_sign
from cpam_bayes.effects.geometry import DENSITY, THICKNESS
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.plate import Measurement, Sensor
from cpam_bayes.plate.reader import builtin
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import BENT, BUMP, CONSTANTS, DENT, DENTED, F0, NOISE, NOTHING, SD, A
from tests.effects.cases import BY_NAME
from tests.plates import with_plate


def outlook(means, sds, p=(0.5, 0.5), cause_of=(0, 1)):
    covariance = np.square(sds)[:, :, None] * np.eye(np.shape(means)[1])
    return further.Outlook(np.array(p), np.array(cause_of), np.array(means), covariance)


def by_quadrature(means, sds, p, cause_of):
    y = np.linspace((means - 12 * sds).min(), (means + 12 * sds).max(), 200_001)
    density = p * norm.pdf(y[:, None], means, sds)
    of_cause = np.stack([density[:, cause_of == c].sum(axis=1) for c in np.unique(cause_of)], axis=1)
    independent = of_cause.sum(axis=1, keepdims=True) * np.bincount(cause_of, p)
    ratio = np.log(np.maximum(of_cause, 1e-300) / np.maximum(independent, 1e-300))
    return float(np.trapezoid(np.sum(of_cause * ratio, axis=1), y))


# mean, sd, probability and cause
APART = [(d, p) for d in (0.5, 1.0, 2.0, 4.0) for p in (0.5, 0.2)]
GAUSSIANS = {
    **{f"{d} apart, {p}": ([0.0, d], [1.0, 1.0], [p, 1.0 - p], [0, 1]) for d, p in APART},
    "of other widths": ([0.0, 0.0], [1.0, 5.0], [0.5, 0.5], [0, 1]),
    "variants": ([-3.0, 0.0, 3.0], [1.0, 1.0, 1.0], [0.3, 0.4, 0.3], [0, 1, 0]),  # variants of one cause
}


@pytest.mark.parametrize("of", GAUSSIANS.values(), ids=GAUSSIANS)
def test_the_information_of_gaussians_is_that_of_quadrature(of):
    means, sds, p, cause_of = map(np.array, of)
    found, possible, _ = information(outlook(means[:, None], sds[:, None], p, cause_of))
    assert found == pytest.approx(by_quadrature(means, sds, p, cause_of), abs=2e-3)  # 1024 Sobol points
    share = np.bincount(cause_of, p)
    assert possible == pytest.approx(-np.sum(share * np.log(share)), rel=1e-12)


def test_correlated_data_are_taken_as_such():
    rotation = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    plain = outlook([[0.0, 0.0, 0.0], [2.0, 0.5, 0.0]], np.tile([1.0, 0.2, 3.0], (2, 1)))
    covariance = np.einsum("ab,kbc,dc->kad", rotation, plain.covariance, rotation)
    turned = replace(plain, mean=plain.mean @ rotation.T, covariance=covariance)
    assert information(turned)[0] == pytest.approx(information(plain)[0], abs=3e-3)  # two Sobol sequences


def test_the_probability_of_a_decision_is_that_of_a_likelihood_ratio():
    d = 3.0
    _, _, decided = information(outlook([[0.0], [d]], np.ones((2, 1))), 12)
    # the log ratio d (y - d / 2) under the right cause is normal with mean d^2 / 2, sd d
    assert decided == pytest.approx(norm.cdf((d**2 / 2 - np.log(9.0)) / d), abs=2e-3)


def plate(shift, noise=NOISE):
    f = F0 * (1.0 + A @ [0.03, -0.04] + shift)
    return toy.case(toy.a_list(f, noise), [(BENT, toy.straight(BUMP)), (DENTED, toy.straight(DENT))])


def made(of, own, probability=0.5):
    tested = toy.with_evidence(own, of, probability)
    return replace(tested, marginal=sampled_marginal(tested.marginal))


def test_leading_causes_are_six_at_most_with_all_their_probability():
    def found(*p):
        tested = tuple(weighing.Tested(Hypothesis(c, c), (0,), None, value) for c, value in p)
        return [(t.hypothesis.cause, t.probability) for t in further.leading_hypotheses(Weighed(tested, ()))]

    assert found(("a", 0.6), ("b", 0.395), ("c", 0.005)) == [("a", 0.6), ("b", 0.395)]
    assert [c for c, _ in found(*((c, 0.12) for c in "abcdefgh"))] == list("abcdef")
    many = found(("none", 0.2), *(("a", 0.032) for _ in range(25)))  # ten places of a mass represent all
    assert len(many) == 10
    assert sum(p for c, p in many if c == "a") == pytest.approx(0.8)
    assert dict(many)["none"] == pytest.approx(0.2)


def test_the_outlook_has_the_moments_of_the_draws_and_the_noise_of_the_list():
    own = plate(0.01 * BUMP)
    t, direction = made(toy.hypothesis(BENT), own), np.array([1.0, 2.0])

    def predict(t):
        size = t.marginal.draws[:, t.columns[0]]
        return Predicted(100.0 * (1.0 + size[:, None] * direction), np.diag([0.0, 1e-6]))

    found = outlook_of([t], own, predict)
    mean, sd = t.marginal.moments()
    relative = sd[2] * direction / (1.0 + mean[2] * direction)
    expected = np.outer(relative, relative) + np.diag([NOISE**2, NOISE**2 + 1e-6])
    np.testing.assert_allclose(found.mean, 1.0)
    np.testing.assert_allclose(found.covariance[0], expected, rtol=1e-9)


@pytest.mark.parametrize("as_now", [True, False])
def test_what_nothing_explains_widens_the_data_of_the_same_plate_alone(as_now):
    own = plate(0.02 * BUMP, None)
    t = made(toy.ANYTHING, own)
    comparison = t.marginal.comparison
    columns = [comparison.noise, comparison.discrepancy]
    noise, discrepancy = np.exp(t.marginal.log_weight) @ t.marginal.draws[:, columns] ** 2
    data = Predicted(np.full((512, 1), 200.0), np.zeros((1, 1)), as_now=as_now)
    found = outlook_of([t], own, lambda t: data)
    assert found.covariance[0, 0, 0] == pytest.approx(noise + as_now * discrepancy, rel=1e-9)


def test_a_sister_plate_has_other_constants_and_not_the_flaw():
    own, scatter = plate(0.03 * BUMP), 0.03
    t = made(toy.hypothesis(BENT), own)
    quiet = replace(own, measurement=replace(own.measurement, relative_std=0.001))
    found = outlook_of([t], quiet, lambda t: further._sister(t, 0, own, scatter))
    f = own.measurement.frequencies
    slope = np.column_stack((A, BUMP)) * F0[:, None] / (NOISE * f)[:, None]
    posterior = np.linalg.inv(slope.T @ slope + np.diag(1.0 / np.array([SD, SD, 0.02]) ** 2))
    centre = np.array([1.0, 1.0, 0.0]) + posterior @ slope.T @ ((f - F0) / (NOISE * f))
    relative = A / (1.0 + A @ (centre[:2] - 1.0))[:, None]
    spread = posterior[:2, :2] + np.diag((scatter * centre[:2]) ** 2)
    expected = relative @ spread @ relative.T + 0.001**2 * np.eye(8)
    # 512 weighted points of a posterior much narrower than the scatter
    np.testing.assert_allclose(found.covariance[0], expected, rtol=0.05, atol=0.01 * expected.max())
    plain = made(NOTHING, plate(0.0 * BUMP))  # without the flaw, a plate of the same constants
    y, same = (further._sister(each, 0, own, scatter).y.mean(axis=0) for each in (t, plain))
    np.testing.assert_allclose(y, same, rtol=0.005)


def test_weighing_and_gauging_see_a_thicker_plate():
    # a linear toy is valid over a tolerance, not over gross errors
    tolerance = replace(THICKNESS, parameters=(either_sign("thickness_deviation", "", 0.01),))
    own, specimen = plate(0.02 * BUMP), builtin("C1")
    thick = toy.plate_model(shift=toy.straight(BUMP), parameter=tolerance.parameters[0])
    own.extended[tolerance.name, tolerance.variant] = thick
    # with the sizes of a real plate
    own = replace(own, models=replace(own.models, problem=plate_problem(specimen, CONSTANTS)))
    t, plain = made(toy.hypothesis(tolerance), own), made(NOTHING, own)
    thicker, of = 1.0 + t.marginal.draws[:, t.columns], specimen.plate
    expected = np.array([of.density * of.thickness * of.area, of.thickness]) * thicker
    np.testing.assert_allclose(further._weighing(t, 0, own).y, expected, rtol=1e-12)
    found = outlook_of([plain, t], own, lambda t: further._weighing(t, 0, own))
    noise = np.diag([further.WEIGHED**2, further.GAUGED**2])
    np.testing.assert_allclose(found.covariance[0], noise, atol=1e-15)
    assert information(found)[0] == pytest.approx(np.log(2.0), abs=0.01)  # 2 % compared with 0.1 and 0.3 %


@pytest.mark.parametrize(
    ("mass", "sd", "asked"),
    [
        (None, {}, ("mass", "thickness")),
        (0.34, {}, ("mass", "thickness")),  # usually known to 0.2 and 1 %
        (0.34, {"mass": 0.34 * further.WEIGHED}, ("thickness",)),
        (0.34, {"thickness": 1e-6}, ("mass",)),
        (None, {"thickness": 1e-6, "density": 1.0}, ("mass",)),
        (0.34, {"mass": 1e-4, "thickness": 1e-6}, ()),
    ],
)
def test_what_the_file_states_as_well_is_not_to_be_measured(mass, sd, asked):
    own, specimen = plate(0.02 * BUMP), with_plate("C1", mass=mass, sd=sd)
    models = replace(own.models, specimen=specimen, problem=plate_problem(specimen, CONSTANTS))
    own = replace(own, models=models)
    tests = {test.name: test for test in further.further_tests([own], 0, 3, 0.02)}
    assert ("weighing" in tests) == bool(asked)
    if asked:
        said = tests["weighing"].description
        assert ("weighing" in said, "gauging" in said) == ("mass" in asked, "thickness" in asked)
        assert tests["weighing"].prepare()(made(NOTHING, own)).y.shape[1] == len(asked)


@pytest.mark.parametrize(
    ("kind", "beside", "asked"),
    [
        *((kind, {}, True) for kind in ("class", "pair", "other", "undecided")),
        ("none", {}, False),
        ("named", {}, False),
        ("named", {"warp": 0.7}, True),  # what else acts beside a named cause is not settled
    ],
)
def test_tests_are_ranked_by_what_they_tell_and_none_is_asked_without_need(kind, beside, asked, monkeypatch):
    own, hypotheses = plate(0.008 * BUMP), (toy.hypothesis(BENT), toy.hypothesis(DENTED), NOTHING)
    causes, probability = [h.cause for h in hypotheses], np.array([0.5, 0.3, 0.2])

    def telling(name, by):
        """A test whose data differ by this much between the causes."""

        def predict(t):
            y = 100.0 * (1.0 + by * causes.index(t.hypothesis.cause))
            return Predicted(np.full((512, 1), y), np.zeros((1, 1)))

        return FurtherTest(name, name, lambda: predict)

    tests = [telling(*of) for of in (("useless", 0.0), ("sharp", 0.05), ("vague", 0.002))]
    monkeypatch.setattr(further, "further_tests", lambda *_: tests)
    weighed = Weighed(tuple(map(made, hypotheses, [own] * 3, probability)), ())
    diagnosis = SimpleNamespace(claim=Claim(kind, (), 0.95), weighed=weighed, cases=(own,), beside=beside)
    found = next_measurements(diagnosis, always=True)
    assert next_measurements(diagnosis) == (found if asked else ())
    assert [c.name for c in found] == ["sharp", "vague", "useless"]
    possible = -np.sum(probability * np.log(probability))
    assert found[0].possible == pytest.approx(possible)
    assert found[0].information == pytest.approx(possible, abs=1e-6)
    assert (found[0].decided, found[2].decided) == (1.0, 0.0)
    assert 0.0 < found[1].information < 0.5 * possible
    assert found[2].information == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("edges", "places"),
    [
        ("FFFF", [("mass_at_corner", (0.95, 0.95)), ("mass_at_centre", (0.5, 0.5))]),
        ("CFFF", [("mass_at_corner", (0.95, 0.95)), ("mass_at_centre", (0.5, 0.5))]),
        ("FFCF", [("mass_at_corner", (0.05, 0.95)), ("mass_at_centre", (0.5, 0.5))]),
        ("SSSS", [("mass_at_centre", (0.5, 0.5))]),
    ],
)
def test_known_masses_go_where_the_plate_is_free(edges, places):
    assert [(name, at) for name, _, at in further.places(edges)] == places


def with_own_list(name, effect, size):
    def a_list_of(f):
        return Measurement(f[:4], 0.0, 0.002, None, ("",) * 4, complete=True)

    own = builtin(name)
    found = plate_case(replace(own, measurement=a_list_of(own.measurement.frequencies)))
    x = np.array([*(p.prior.mean for p in found.models.parameters.parameters), size])
    return replace(found, measurement=a_list_of(found.with_effect(effect).predict(x[None]).frequencies[0]))


def assert_predicts(found, model, t, modes=slice(0, 4)):
    """Check that the data of a test are those of a model at all draws."""
    weight = np.exp(t.marginal.log_weight)
    mean = weight @ found.y
    sd = np.sqrt(weight @ (found.y - mean) ** 2 + np.diag(found.missing) * mean**2)
    f = model.predict(t.marginal.draws[:, : model.parameters.size]).frequencies[:, modes]
    expected = weight @ f
    spread = np.sqrt(weight @ (f - expected) ** 2)
    np.testing.assert_allclose(mean, expected, rtol=3e-4)  # a tenth of the noise, and of the spread
    np.testing.assert_allclose(sd, spread, rtol=0.1, atol=3e-4 * expected.min())


@pytest.mark.slow
def test_a_clamp_acts_on_the_clamped_plate_and_not_on_the_one_that_hangs():
    effect = BY_NAME["clamp_rotation"]  # its clamp rotates a little
    own = with_own_list("A2", effect, 0.03)
    t, specimen = made(toy.hypothesis(effect), own), own.models.specimen
    as_it_is = further._under_test(t, 0, own.models, own.models.bare.full, np.arange(4))
    assert_predicts(as_it_is, own.with_effect(effect), t)
    tests = {test.name: test for test in further.further_tests([own], 0, 3, 0.02)}
    hung = plate_models(replace(specimen, plate=replace(specimen.plate, edges="FFFF")), 4)
    assert_predicts(tests["edge_condition"].prepare()(t), hung.bare, t)


@pytest.mark.slow
def test_a_loaded_plate_and_its_further_modes_are_predicted_as_by_models_of_their_own():
    own = with_own_list("A1", THICKNESS, 0.02)
    t, specimen = made(NOTHING, own), own.models.specimen
    tests = {test.name: test for test in further.further_tests([own], 0, 3, 0.02)}
    masses = ["mass_at_corner", "mass_at_centre"]
    assert list(tests) == ["edge_condition", "more_modes", *masses, "sister_plate", "weighing"]
    of = specimen.plate
    sensor = Sensor(0.02 * of.density * of.thickness * of.area, 0.95 * of.length, 0.95 * of.width)
    loaded = plate_models(replace(specimen, sensors=(sensor,)), 4)
    assert_predicts(tests["mass_at_corner"].prepare()(t), loaded.bare, t)
    bigger = plate_models(specimen, 4 + further.MORE_MODES)
    assert_predicts(tests["more_modes"].prepare()(t), bigger.bare, t, slice(4, 8))


@pytest.mark.slow
def test_thickness_and_density_that_the_constants_absorb_are_told_apart_by_weighing():
    own = with_own_list("A1", THICKNESS, 0.02)
    some = toy.of_one(NOTHING, *(toy.hypothesis(e, 0.25) for e in (THICKNESS, DENSITY)))
    diagnosis = diagnose_cases([own], hypotheses=some, sets=False, gain=False, power=False)
    said = []
    found = next_measurements(diagnosis, always=True, notify=said.append)
    assert len(found) == 6
    assert found[0].name == "weighing"
    assert found[0].information > 3.0 * max(c.information for c in found[1:])  # the others scale alike
    assert all(0.0 <= c.information <= c.possible + 1e-9 and 0.0 <= c.decided <= 1.0 for c in found)
    assert [c.information for c in found] == sorted((c.information for c in found), reverse=True)
    assert found == next_measurements(diagnosis, always=True)
    assert "predicting 6 further tests" in said


@pytest.mark.slow
def test_further_tests_of_a_cause_without_a_size_are_ranked():
    own = plate_case(builtin("C1"))
    first = {h.cause: (replace(h, prior=0.3), at) for h, at in hypotheses_of([own])}
    each = [first[name] for name in ("none", "other", "layup")]
    diagnosis = diagnose_cases([own], hypotheses=each, sets=False, gain=False, power=False)
    found = next_measurements(diagnosis, always=True)
    assert len(found) == 6
    assert found[0].information > 0.0
