"""Which test tells causes apart: mutual information against quadrature, and predicted data."""

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from cpam_bayes.diagnosis import next_test as further
from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.evidence import weighing
from cpam_bayes.diagnosis.evidence.sampled import sampled_marginal
from cpam_bayes.diagnosis.evidence.weighing import Weighed, marginal_of
from cpam_bayes.diagnosis.hypotheses import DISCREPANCY, OTHER, Claim, Hypothesis, Kind
from cpam_bayes.diagnosis.models import plate_models
from cpam_bayes.diagnosis.next_test import (
    FurtherTest,
    Predict,
    Predicted,
    information,
    next_measurements,
    outlook_of,
)
from cpam_bayes.effects import Effect
from cpam_bayes.effects.effect import either_sign
from cpam_bayes.effects.geometry import DENSITY, THICKNESS
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.plate import Measurement, Sensor
from cpam_bayes.plate.reader import builtin
from tests.diagnosis import toy_plates as toy
from tests.diagnosis.toy_plates import BENT, BUMP, CONSTANTS, DENT, DENTED, F0, NOISE, NOTHING, SD, A, Array
from tests.effects.cases import BY_NAME


def outlook(means: Array, sds: Array, p: Any = (0.5, 0.5), cause_of: Any = (0, 1)) -> further.Outlook:
    """Gaussians of means (k, n) with independent standard deviations (k, n)."""
    covariance = sds[:, :, None] ** 2 * np.eye(means.shape[1])
    return further.Outlook(np.array(p), np.array(cause_of), means, covariance)


def by_quadrature(means: Array, sds: Array, p: Array, cause_of: Array) -> float:
    """Mutual information of a cause and one datum."""
    y = np.linspace((means - 12 * sds).min(), (means + 12 * sds).max(), 200_001)
    density = p * np.exp(-0.5 * ((y[:, None] - means) / sds) ** 2) / sds / np.sqrt(2 * np.pi)
    of_cause = np.stack([density[:, cause_of == c].sum(axis=1) for c in np.unique(cause_of)], axis=1)
    prior = np.array([p[cause_of == c].sum() for c in np.unique(cause_of)])
    total = of_cause.sum(axis=1, keepdims=True)
    ratio = np.log(np.maximum(of_cause, 1e-300) / np.maximum(total * prior, 1e-300))
    return float(np.trapezoid(np.sum(of_cause * ratio, axis=1), y))


# Means and standard deviations of one datum, probabilities, and which cause each belongs to
GAUSSIANS: dict[str, tuple[list[float], list[float], list[float], list[int]]] = {
    **{
        f"{d} apart, {p}": ([0.0, d], [1.0, 1.0], [p, 1.0 - p], [0, 1])
        for d in (0.5, 1.0, 2.0, 4.0)
        for p in (0.5, 0.2)
    },
    "of other widths": ([0.0, 0.0], [1.0, 5.0], [0.5, 0.5], [0, 1]),
    # variants of one cause are not to be told apart
    "variants": ([-3.0, 0.0, 3.0], [1.0, 1.0, 1.0], [0.3, 0.4, 0.3], [0, 1, 0]),
}


@pytest.mark.parametrize("of", GAUSSIANS.values(), ids=GAUSSIANS)
def test_the_information_of_gaussians_is_that_of_quadrature(of: tuple[list[float], ...]) -> None:
    means, sds, p, cause_of = map(np.array, of)
    found, possible, _ = information(outlook(means[:, None], sds[:, None], p, cause_of))
    # 1024 points of a Sobol sequence
    assert found == pytest.approx(by_quadrature(means, sds, p, cause_of), abs=2e-3)
    share = np.bincount(cause_of, p)
    assert possible == pytest.approx(-np.sum(share * np.log(share)), rel=1e-12)


def test_correlated_data_are_taken_as_such() -> None:
    rotation = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    means = np.array([[0.0, 0.0, 0.0], [2.0, 0.5, 0.0]])
    plain = outlook(means, np.tile([1.0, 0.2, 3.0], (2, 1)))
    covariance = np.einsum("ab,kbc,dc->kad", rotation, plain.covariance, rotation)
    turned = replace(plain, mean=plain.mean @ rotation.T, covariance=covariance)
    # two Sobol sequences of the same integral
    assert information(turned)[0] == pytest.approx(information(plain)[0], abs=3e-3)


def test_the_probability_of_a_decision_is_that_of_a_likelihood_ratio() -> None:
    d = 3.0
    _, _, decided = information(outlook(np.array([[0.0], [d]]), np.ones((2, 1))), 12)
    # log ratio d (y - d / 2) under the right cause is normal, mean d^2 / 2, sd d
    assert decided == pytest.approx(norm.cdf((d**2 / 2 - np.log(9.0)) / d), abs=2e-3)


# On toy plates


def plate(shift: Array, noise: float | None = NOISE) -> PlateCase:
    f = F0 * (1.0 + A @ [0.03, -0.04] + shift)
    return toy.case(toy.a_list(f, noise), [(BENT, toy.straight(BUMP)), (DENTED, toy.straight(DENT))])


def made(of: Hypothesis, own: PlateCase, probability: float = 0.5) -> weighing.Tested:
    marginal = sampled_marginal(marginal_of([own], of, (0,)))
    return weighing.Tested(of, (0,), marginal, probability)


def test_leading_causes_are_six_at_most_with_all_their_probability() -> None:
    def found(*p: tuple[str, float]) -> list[tuple[str, float]]:
        none: Any = None
        tested = tuple(weighing.Tested(Hypothesis(c, c), (0,), none, value) for c, value in p)
        leading = further.leading_hypotheses(Weighed(tested, ()))
        return [(t.hypothesis.cause, t.probability) for t in leading]

    assert found(("a", 0.6), ("b", 0.395), ("c", 0.005)) == [("a", 0.6), ("b", 0.395)]
    assert [c for c, _ in found(*((c, 0.12) for c in "abcdefgh"))] == list("abcdef")
    # ten of the places where a mass may be stand for all of them, beside none
    many = found(("none", 0.2), *(("a", 0.032) for _ in range(25)))
    assert len(many) == 10
    assert sum(p for c, p in many if c == "a") == pytest.approx(0.8)
    assert dict(many)["none"] == pytest.approx(0.2)


def test_the_outlook_has_the_moments_of_the_draws_and_the_noise_of_the_list() -> None:
    own = plate(0.01 * BUMP)
    t = made(toy.hypothesis(BENT), own)
    direction = np.array([1.0, 2.0])

    def predict(t: weighing.Tested) -> Predicted:
        size = t.marginal.draws[:, t.columns[0]]
        return Predicted(100.0 * (1.0 + size[:, None] * direction), np.diag([0.0, 1e-6]))

    found = outlook_of([t], own, predict)
    mean, sd = t.marginal.moments()
    relative = sd[2] * direction / (1.0 + mean[2] * direction)
    expected = np.outer(relative, relative) + np.diag([NOISE**2, NOISE**2 + 1e-6])
    np.testing.assert_allclose(found.mean, 1.0)
    np.testing.assert_allclose(found.covariance[0], expected, rtol=1e-9)


def test_what_nothing_explains_widens_the_data_of_the_same_plate_alone() -> None:
    own = plate(0.02 * BUMP, None)
    t = made(Hypothesis(OTHER, OTHER, parameters=(DISCREPANCY,), prior=0.06, correlation_length=0.0), own)
    weight = np.exp(t.marginal.log_weight)
    comparison = t.marginal.comparison
    square = {c: weight @ t.marginal.draws[:, c] ** 2 for c in (comparison.noise, comparison.discrepancy)}
    for as_now in (True, False):
        data = Predicted(np.full((512, 1), 200.0), np.zeros((1, 1)), as_now=as_now)
        found = outlook_of([t], own, lambda t, data=data: data)  # type: ignore[misc]
        expected = square[comparison.noise] + as_now * square[comparison.discrepancy]
        assert found.covariance[0, 0, 0] == pytest.approx(expected, rel=1e-9)


def test_a_sister_plate_has_other_constants_and_not_the_flaw() -> None:
    own = plate(0.03 * BUMP)
    t = made(toy.hypothesis(BENT), own)
    scatter = 0.03
    quiet = replace(own, measurement=replace(own.measurement, relative_std=0.001))
    found = outlook_of([t], quiet, lambda t: further._sister(t, 0, own, scatter))
    f = own.measurement.frequencies
    slope = np.column_stack((A, BUMP)) * F0[:, None] / (NOISE * f)[:, None]
    posterior = np.linalg.inv(slope.T @ slope + np.diag(1.0 / np.array([SD, SD, 0.02]) ** 2))
    centre = np.array([1.0, 1.0, 0.0]) + posterior @ slope.T @ ((f - F0) / (NOISE * f))
    predicted = F0 * (1.0 + A @ (centre[:2] - 1.0))
    relative = A * F0[:, None] / predicted[:, None]
    spread = posterior[:2, :2] + np.diag((scatter * centre[:2]) ** 2)
    expected = relative @ spread @ relative.T + 0.001**2 * np.eye(8)
    # 512 weighted points of a posterior much narrower than the scatter
    np.testing.assert_allclose(found.covariance[0], expected, rtol=0.05, atol=0.01 * expected.max())
    t_none = made(NOTHING, plate(0.0 * BUMP))
    y = further._sister(t, 0, own, scatter).y.mean(axis=0)
    # less the flaw, a plate of the same constants
    np.testing.assert_allclose(y, further._sister(t_none, 0, own, scatter).y.mean(axis=0), rtol=0.005)


def test_weighing_and_gauging_see_a_thicker_plate() -> None:
    own = plate(0.02 * BUMP)
    # a linear toy holds over a tolerance, not over gross errors
    tolerance = replace(THICKNESS, parameters=(either_sign("thickness_deviation", "", 0.01),))
    thick = toy.plate_model(shift=toy.straight(BUMP), parameter=tolerance.parameters[0])
    own.extended[tolerance.name, tolerance.variant] = thick  # type: ignore[assignment]
    # its sizes are those of a real plate
    specimen = builtin("C1")
    own = replace(own, models=replace(own.models, problem=plate_problem(specimen, CONSTANTS)))
    t, plain = made(toy.hypothesis(tolerance), own), made(NOTHING, own)
    predicted = further._weighing(t, 0, own)
    thicker = 1.0 + t.marginal.draws[:, t.columns[0]]
    of = specimen.plate
    stated = np.array([of.density * of.thickness * of.area, of.thickness])
    np.testing.assert_allclose(predicted.y, stated * thicker[:, None], rtol=1e-12)
    found = outlook_of([plain, t], own, lambda t: further._weighing(t, 0, own))
    noise = np.diag([further.WEIGHED**2, further.GAUGED**2])
    np.testing.assert_allclose(found.covariance[0], noise, atol=1e-15)
    # 2 % beside 0.1 and 0.3 %
    assert information(found)[0] == pytest.approx(np.log(2.0), abs=0.01)


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
def test_what_the_file_states_as_well_is_not_to_be_measured(
    mass: float | None, sd: dict[str, float], asked: tuple[str, ...]
) -> None:
    own = plate(0.02 * BUMP)
    specimen = replace(builtin("C1"), plate=replace(builtin("C1").plate, mass=mass, sd=sd))
    own = replace(
        own, models=replace(own.models, specimen=specimen, problem=plate_problem(specimen, CONSTANTS))
    )
    tests = {test.name: test for test in further.further_tests([own], 0, 3, 0.02)}
    assert ("weighing" in tests) == bool(asked)
    if asked:
        said = tests["weighing"].description
        assert ("weighing" in said, "gauging" in said) == ("mass" in asked, "thickness" in asked)
        assert tests["weighing"].prepare()(made(NOTHING, own)).y.shape[1] == len(asked)


@pytest.mark.parametrize(
    ("kind", "beside", "is_asked"),
    [
        *((kind, {}, True) for kind in ("class", "pair", "other", "undecided")),
        ("none", {}, False),
        ("named", {}, False),
        # what acts beside a named cause is not settled
        ("named", {"warp": 0.7}, True),
    ],
)
def test_tests_are_ranked_by_what_they_tell_and_nothing_is_asked_where_all_is_settled(
    kind: Kind, beside: Mapping[str, float], is_asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = plate(0.008 * BUMP)
    probability = {toy.hypothesis(BENT): 0.5, toy.hypothesis(DENTED): 0.3, NOTHING: 0.2}
    causes = [h.cause for h in probability]

    def tells(by: float) -> Predict:
        """Data that tell the causes apart by so much."""

        def predict(t: weighing.Tested) -> Predicted:
            y = 100.0 * (1.0 + by * causes.index(t.hypothesis.cause))
            return Predicted(np.full((512, 1), y), np.zeros((1, 1)))

        return predict

    tests = [
        FurtherTest(name, name, lambda by=by: tells(by))  # type: ignore[misc]
        for name, by in (("useless", 0.0), ("sharp", 0.05), ("vague", 0.002))
    ]
    monkeypatch.setattr(further, "further_tests", lambda *_: tests)
    weighed = Weighed(tuple(made(h, own, p) for h, p in probability.items()), ())
    claim = Claim(kind, (), 0.95)
    diagnosis: Any = SimpleNamespace(claim=claim, weighed=weighed, cases=(own,), beside=beside)
    found = next_measurements(diagnosis, always=True)
    assert next_measurements(diagnosis) == (found if is_asked else ())
    assert [c.name for c in found] == ["sharp", "vague", "useless"]
    possible = -sum(p * np.log(p) for p in probability.values())
    assert found[0].possible == pytest.approx(possible)
    assert found[0].information == pytest.approx(possible, abs=1e-6)
    assert (found[0].decided, found[2].decided) == (1.0, 0.0)
    assert 0.0 < found[1].information < 0.5 * possible
    assert found[2].information == pytest.approx(0.0, abs=1e-9)


def test_known_masses_go_where_the_plate_is_free() -> None:
    assert [(name, at) for name, _, at in further.places("FFFF")] == [
        ("mass_at_corner", (0.95, 0.95)),
        ("mass_at_centre", (0.5, 0.5)),
    ]
    assert further.places("CFFF")[0][2] == (0.95, 0.95)
    assert further.places("FFCF")[0][2] == (0.05, 0.95)
    assert [name for name, _, _ in further.places("SSSS")] == ["mass_at_centre"]


# On real plates


def with_own_list(name: str, effect: Effect, size: float, n: int = 4) -> PlateCase:
    """A plate with a list of its own model."""

    def a_list_of(f: Array) -> Measurement:
        return Measurement(f[:n], 0.0, 0.002, None, ("",) * n, complete=True)

    own = builtin(name)
    assert own.measurement is not None
    found = plate_case(replace(own, measurement=a_list_of(own.measurement.frequencies)))
    x = np.array([*(p.prior.mean for p in found.models.parameters.parameters), size])
    f = found.with_effect(effect).predict(x[None]).frequencies[0]
    return replace(found, measurement=a_list_of(f))


def assert_predicts(found: Predicted, model: Any, t: weighing.Tested, modes: slice = slice(0, 4)) -> None:
    """The data of a test are those of a model at all draws."""
    weight = np.exp(t.marginal.log_weight)
    mean = weight @ found.y
    sd = np.sqrt(weight @ (found.y - mean) ** 2 + np.diag(found.missing) * mean**2)
    f = model.predict(t.marginal.draws[:, : model.parameters.size]).frequencies[:, modes]
    expected = weight @ f
    # a tenth of a measurement's noise, and of the spread
    np.testing.assert_allclose(mean, expected, rtol=3e-4)
    np.testing.assert_allclose(
        sd, np.sqrt(weight @ (f - expected) ** 2), rtol=0.1, atol=3e-4 * expected.min()
    )


@pytest.mark.slow
def test_a_clamp_acts_on_the_clamped_plate_and_not_on_the_one_that_hangs() -> None:
    # its clamp turns a little
    effect = BY_NAME["clamp_rotation"]
    own = with_own_list("A2", effect, 0.03)
    t = made(toy.hypothesis(effect), own)
    as_it_is = further._under_test(t, 0, own.models, own.models.bare.full, np.arange(4))
    assert_predicts(as_it_is, own.with_effect(effect), t)
    tests = {test.name: test for test in further.further_tests([own], 0, 3, 0.02)}
    plate = own.models.specimen.plate
    hung = plate_models(replace(own.models.specimen, plate=replace(plate, edges="FFFF")), 4)
    assert_predicts(tests["edge_condition"].prepare()(t), hung.bare, t)


@pytest.mark.slow
def test_a_loaded_plate_and_its_further_modes_are_predicted_as_by_models_of_their_own() -> None:
    own = with_own_list("A1", THICKNESS, 0.02)
    t = made(NOTHING, own)
    tests = {test.name: test for test in further.further_tests([own], 0, 3, 0.02)}
    masses = ["mass_at_corner", "mass_at_centre"]
    assert list(tests) == ["edge_condition", "more_modes", *masses, "sister_plate", "weighing"]
    specimen = own.models.specimen
    plate = specimen.plate
    mass = 0.02 * plate.density * plate.thickness * plate.area
    sensor = Sensor(mass, 0.95 * plate.length, 0.95 * plate.width)
    loaded = plate_models(replace(specimen, sensors=(sensor,)), 4)
    assert_predicts(tests["mass_at_corner"].prepare()(t), loaded.bare, t)
    bigger = plate_models(specimen, 4 + further.MORE_MODES)
    assert_predicts(tests["more_modes"].prepare()(t), bigger.bare, t, slice(4, 8))


@pytest.mark.slow
def test_thickness_and_density_that_the_constants_absorb_are_told_apart_by_weighing() -> None:
    own = with_own_list("A1", THICKNESS, 0.02)
    some = toy.of_one(NOTHING, *(toy.hypothesis(e, 0.25) for e in (THICKNESS, DENSITY)))
    diagnosis = diagnose_cases([own], hypotheses=some, sets=False, gain=False, power=False)
    said: list[str] = []
    found = next_measurements(diagnosis, always=True, notify=said.append)
    assert len(found) == 6
    assert found[0].name == "weighing"
    # frequencies of any plate of the same size scale alike with both
    assert found[0].information > 3.0 * max(c.information for c in found[1:])
    assert all(0.0 <= c.information <= c.possible + 1e-9 and 0.0 <= c.decided <= 1.0 for c in found)
    assert [c.information for c in found] == sorted((c.information for c in found), reverse=True)
    assert found == next_measurements(diagnosis, always=True)
    assert "predicting 6 further tests" in said


@pytest.mark.slow
def test_further_tests_of_a_cause_without_a_size_are_ranked() -> None:
    own = plate_case(builtin("C1"))
    first = {h.cause: (replace(h, prior=0.3), at) for h, at in hypotheses_of([own])}
    each = [first[name] for name in ("none", "other", "layup")]
    diagnosis = diagnose_cases([own], hypotheses=each, sets=False, gain=False, power=False)
    found = next_measurements(diagnosis, always=True)
    assert len(found) == 6
    assert found[0].information > 0.0
