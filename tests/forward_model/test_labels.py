"""Labels and measured shapes identify the mode of a frequency, even where modes cross, with a probability."""

import itertools
import re
import tomllib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import special_ortho_group

import cpam_bayes as cb
from cpam_bayes.forward_model import labels as labelling
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.labels import LabelError, labelled_model, modal_assurance
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.identification.point import estimate_constants
from cpam_bayes.identification.search import start_of
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Measurement, Specimen, read_specimen
from cpam_bayes.plate.instruments import MeasuredShapes
from tests.plate_file import BAR, refused
from tests.universal import grid, mode_55, nodes_15

TWISTED_FIRST = ("(1,1)", "(0,2)")
BENT_FIRST = ("(0,2)", "(1,1)")
SPARE = 4
TRUTH = np.array([9.34e9, 16e9])  # E2, G12
K = 8
MODES = tuple(Mode(100.0 * (i + 1), "bending", f"({i},0)", 0.0) for i in range(K))
FILE = f"{BAR}[unknowns]\nE1_GPa = [50, 90]\nnu12 = [0.2, 0.45]\n"


def listed(frequencies: Sequence[float], labels: tuple[str, ...], complete: bool = True) -> Measurement:
    return Measurement(np.array(frequencies), 0.0, 0.003, None, labels, complete, scale_sd=0.0)


@pytest.fixture(scope="module")
def plate() -> Specimen:
    """B1, whose twisting and first bending modes cross as G12 grows."""
    specimen = read_specimen("B1").with_exact_sizes()
    return replace(specimen, unknowns=ParameterSet(tuple(specimen.unknowns[n] for n in ("E2", "G12"))))


@pytest.fixture(scope="module")
def model(plate: Specimen) -> ReducedModel:
    return reduced_model(plate, plate.unknowns, 2 + SPARE)


def test_a_labelled_mode_is_followed_through_crossings(plate: Specimen, model: ReducedModel) -> None:
    own = labelled_model(model, listed([60.0, 84.0], TWISTED_FIRST), plate)
    x = plate.unknowns.sample(np.random.default_rng(0), 60)
    x = x[own.admissible(x)]
    found = own.predict(x).frequencies
    for i, one in enumerate(x):
        by_label = {mode.label: mode.frequency for mode in model.full.modes(one)}
        # the reduced model is accurate to 5e-5 where it was trained, to twice that in between
        np.testing.assert_allclose(found[i, :2], [by_label[label] for label in TWISTED_FIRST], rtol=2e-4)
    order = own.order(x)
    assert 0.2 < np.mean(order[:, 0] == 1) < 0.8
    np.testing.assert_array_equal(np.sort(order, axis=1), np.tile(np.arange(6), (len(x), 1)))
    np.testing.assert_array_equal(np.take_along_axis(model.predict(x).frequencies, order, axis=1), found)
    assert np.all(np.diff(found[:, 2:], axis=1) > 0)
    jacobian = own.predict(TRUTH, jacobian=True).jacobian  # derivatives are ordered like their modes
    up, down = (own.predict(TRUTH + np.array([0.0, step])).frequencies[0] for step in (1e7, -1e7))
    # with a step of 6e-4 of G12 the curvature enters squared; rounding of f by 1e-6 Hz gives 1e-13
    np.testing.assert_allclose(jacobian[0, :, 1], (up - down) / 2e7, rtol=1e-5, atol=1e-13)
    assert jacobian[0, 0, 1] > 10 * abs(jacobian[0, 1, 1])  # G12 governs twisting, hardly bending


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize("labels", [TWISTED_FIRST, BENT_FIRST])
def test_labels_decide_between_two_constants_that_give_the_same_list(plate, model, labels, complete) -> None:
    truth = model.full.modes(TRUTH)[:2]  # a plate with its twisting mode above its bending mode
    assert tuple(mode.label for mode in truth) == BENT_FIRST
    crossed = np.array([mode.frequency for mode in truth])
    tested = replace(plate, measurement=listed(crossed, labels, complete))
    begun = start_of(tested, 0, swarm_settings=SwarmSettings(particles=20, iterations=60))
    best = begun.bests[np.argmin(begun.values)]
    predicted = begun.posterior.predict(best[None])[0, :2]
    np.testing.assert_allclose(predicted, crossed, rtol=3e-3)  # one standard deviation of the data
    by_label = {mode.label: mode.frequency for mode in begun.model.full.modes(best)}
    np.testing.assert_allclose([by_label[label] for label in labels], crossed, rtol=3e-3)
    # twisting at 84 instead of 96 Hz: (84 / 96)^2 of the shear modulus
    g12 = (1.0, 0.02) if labels == BENT_FIRST else ((crossed[0] / crossed[1]) ** 2, 0.04)
    assert best[1] / 16e9 == pytest.approx(g12[0], abs=g12[1])
    np.testing.assert_array_equal(begun.posterior.most_probable_pairing(best).mode, [0, 1])


def test_the_swarm_reports_modes_beside_the_frequencies_that_they_belong_to(plate: Specimen) -> None:
    data = listed([80.0, 84.0], BENT_FIRST)  # too far apart for the bounds of G12: modes remain crossed
    narrow = replace(plate, unknowns=plate.unknowns.fix(G12=16e9), measurement=data)
    found = estimate_constants(narrow, 0, settings=SwarmSettings(particles=10, iterations=30))
    assert [mode.label for mode in found.predicted] == list(BENT_FIRST)
    assert len(found.error) == 2


def test_a_label_that_the_model_does_not_have_is_refused_with_those_that_it_has(plate, model) -> None:
    modes = sorted(model.full.modes(np.array([9.34e9, 6.25e9])), key=lambda mode: mode.frequency)
    said = [r"received '\(7,7\)' for one frequency, no mode", *(re.escape(mode.label) for mode in modes)]
    with pytest.raises(LabelError, match=".*".join(said)):
        labelled_model(model, listed([60.0, 84.0], ("(1,1)", "(7,7)")), plate)


def test_a_label_of_two_modes_names_them_in_ascending_order_and_not_one_of_them() -> None:
    plate = read_specimen("A1")
    model = reduced_model(plate, plate.unknowns, 6 + SPARE)
    f = [114.0, 167.0, 218.0, 289.0, 300.0, 497.0]
    both = "(2,0)+(0,2)"
    own = labelled_model(model, listed(f, ("", both, " (0, 2) + (2,0) ", "", "", "")), plate)
    np.testing.assert_array_equal(own.order(np.array([[69e9, 0.33]]))[0], np.arange(10))
    with pytest.raises(LabelError, match="for one frequency, 2 modes of the model have it"):
        labelled_model(model, listed(f, ("", both, "", "", "", "")), plate)
    with pytest.raises(LabelError, match="for 3 frequencies, 2 modes"):
        labelled_model(model, listed(f, ("", both, both, both, "", "")), plate)


def test_a_list_without_labels_leaves_the_model_alone_and_no_posterior_passes_over_them(plate, model) -> None:
    assert labelled_model(model, listed([60.0, 84.0], ("", "")), plate) is model
    with pytest.raises(ValueError, match="labelled_model"):
        plate_posterior(model, listed([60.0, 84.0], TWISTED_FIRST), np.zeros(6))


def measured(w: np.ndarray) -> MeasuredShapes:
    values = np.zeros((len(w), 3, w.shape[1]), dtype=w.dtype)
    values[:, 2] = w
    return MeasuredShapes(np.arange(w.shape[1]), np.zeros((w.shape[1], 2)), values)


def predicted(w: np.ndarray) -> np.ndarray:
    return np.array(measured(w).values)


@pytest.fixture
def shapes() -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(1).standard_normal((30, K)))[0].T


def paired(w: np.ndarray, of: np.ndarray) -> labelling.ShapePairing:
    return labelling.pair_by_assurance(measured(w), predicted(of), MODES[: len(of)])


def test_assurance_is_the_squared_cosine_of_the_angle_between_shapes_of_any_scale_and_phase(shapes):
    turned = np.array([2.0, -0.3, 1j, np.exp(0.7j)])[:, None] * shapes[:4]
    np.testing.assert_allclose(modal_assurance(measured(turned), predicted(shapes)), np.eye(4, K), atol=1e-14)
    at = np.radians(25.0)
    between = np.cos(at) * shapes[0] + np.sin(at) * shapes[1]
    found = modal_assurance(measured(between[None]), predicted(shapes))[0]
    np.testing.assert_allclose(found[:2], [np.cos(at) ** 2, np.sin(at) ** 2])


def test_directions_that_were_not_measured_are_left_out_and_modes_in_the_plane_are_like_none(shapes):
    of_model = predicted(shapes)
    of_model[0, 0], of_model[0, 2] = of_model[0, 2], 0.0  # an in-plane mode
    of_model[1, 0] = 0.4 * of_model[1, 2]  # a mode with motion in both, seen along z
    found = modal_assurance(measured(shapes), of_model)
    assert np.all(found[:, 0] == 0.0)
    assert found[1, 1] == pytest.approx(1.0)


def test_shapes_halfway_between_two_modes_leave_both_pairings_equal_and_one_like_none_has_none(shapes):
    first, second = shapes[2] + shapes[3], shapes[2] - shapes[3]
    found = paired(np.stack((shapes[0], first, second)), shapes)
    assert found.fixed.tolist() == [True, False, False]
    assert sorted(one.modes.tolist() for one in found.assignments) == [[0, 2, 3], [0, 3, 2]]
    np.testing.assert_allclose(found.probability[1:, 2:4], 0.5)
    strange = np.random.default_rng(3).standard_normal(30)  # a shape like no mode gets none
    strange -= shapes.T @ (shapes @ strange)
    found = paired(np.stack((shapes[1], strange)), shapes)
    assert found.modes.tolist() == [1, -1]
    assert np.all(found.probability[1] == 0.0)


def test_the_weight_of_a_pairing_is_that_of_its_assurances_with_the_directions_that_nodes_tell_apart(shapes):
    """Against all permutations, with (0.02 + 1 - MAC)^(-(d - 1)/2) and d = 8 orthogonal shapes."""
    rotation = np.linalg.qr(2.0 * np.eye(3) + special_ortho_group(3, seed=4).rvs())[0]
    found = paired(np.vstack((rotation @ shapes[:3], shapes[5:7])), shapes)
    assert found.directions == pytest.approx(K)
    weight = (1.02 - found.assurance) ** (-0.5 * (K - 1)) * (found.assurance >= 0.3)  # below 0.3: no mode
    p = np.zeros((5, K))
    for modes in itertools.permutations(range(K), 5):
        rows = np.arange(5), list(modes)
        p[rows] += np.prod(weight[rows])
    np.testing.assert_allclose(found.probability, p / p[0].sum(), atol=2e-3)  # improbable pairings left out


def test_stated_probabilities_are_those_of_being_right(shapes):
    """Randomly mixed pairs of shapes, with errors of the usual size in the model's directions."""
    rng = np.random.default_rng(5)
    stated, right = np.zeros(400), np.zeros(400)
    for i in range(400):
        error = rng.standard_normal((2, K)) @ shapes * np.sqrt(0.02 / K)
        truth = rng.permutation(2)[0]
        angle = rng.uniform(-0.25, 0.25) * np.pi + 0.5 * np.pi * truth
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        found = paired(turn @ shapes[:2] + error, shapes)
        stated[i], right[i] = found.probability[0].max(), found.modes[0] == truth
    assert np.sum(stated < 0.99) > 50
    # the mean stated probability is at most the fraction that is right: 3 standard errors of 400 trials
    assert np.mean(stated) <= np.mean(right) + 3.0 * np.std(right) / np.sqrt(len(right))


def test_nodes_that_do_not_tell_modes_apart_are_refused(shapes):
    few = np.linalg.qr(np.random.default_rng(2).standard_normal((3, 3)))[0]
    same = np.repeat(few[:1], K, axis=0) + 0.01 * np.random.default_rng(0).standard_normal((K, 3))
    with pytest.raises(labelling.AmbiguousShapesError, match="accepted: shapes at more nodes"):
        paired(same, same)


@pytest.fixture(scope="module")
def of_four(plate: Specimen) -> ReducedModel:
    return reduced_model(plate, plate.unknowns, 4)


@pytest.fixture(scope="module")
def tested(plate: Specimen, of_four: ReducedModel) -> Specimen:
    """The plate with frequencies and shapes of its crossed modes at 5 x 4 nodes, with errors of 5 %."""
    points = grid(plate.plate.length, plate.plate.width)
    shapes = of_four.full.shapes_at(TRUTH, points / (plate.plate.length, plate.plate.width))[:2]
    noise = np.random.default_rng(0).standard_normal(shapes.shape)
    shapes = shapes + 0.05 * shapes.std(axis=(1, 2), keepdims=True) * noise
    shapes[:, :2] = 0.0
    frequencies = np.array([mode.frequency for mode in of_four.full.modes(TRUTH)[:2]])
    at = MeasuredShapes(np.arange(len(points)), points, shapes)
    return replace(plate, measurement=Measurement(frequencies, 0.0, 0.003, None, ("", ""), True, shapes=at))


def with_values(specimen: Specimen, values: np.ndarray) -> Specimen:
    shapes = replace(specimen.measurement.shapes, values=values)
    return replace(specimen, measurement=replace(specimen.measurement, shapes=shapes))


def test_shapes_replace_labels_where_modes_have_crossed(tested, of_four):
    own = labelled_model(of_four, tested.measurement, tested)
    by_label = labelled_model(of_four, replace(tested.measurement, shapes=None, labels=BENT_FIRST), tested)
    assert own.alternatives == ()
    x = tested.unknowns.sample(np.random.default_rng(0), 20)
    np.testing.assert_array_equal(own.predict(x).frequencies, by_label.predict(x).frequencies)


@pytest.fixture(scope="module")
def unsure(tested: Specimen) -> Specimen:
    """The plate with shapes almost halfway between the two modes."""
    first, second = (v / np.linalg.norm(v) for v in tested.measurement.shapes.values)
    return with_values(tested, np.stack((first + 0.97 * second, second - 0.97 * first)))


def posterior_of(specimen: Specimen, of_four: ReducedModel, complete: bool = True) -> Posterior:
    measurement = replace(specimen.measurement, complete=complete)
    own = labelled_model(of_four, measurement, specimen)
    return plate_posterior(own, measurement, np.zeros(of_four.n_modes))


@pytest.mark.parametrize("complete", [True, False])
def test_the_likelihood_is_the_sum_over_pairings_with_the_gradient_of_differences(unsure, of_four, complete):
    posterior = posterior_of(unsure, of_four, complete)
    assert len(posterior.alternatives) == 2
    measurement, total = unsure.measurement, 0.0
    x = np.array([[9.34e9, 15e9]])
    for one in posterior.model.by_shape.assignments:
        labels = tuple(posterior.model.by_shape.candidates[j].label for j in one.modes)
        known = replace(measurement, shapes=None, labels=labels, complete=complete)
        fixed = plate_posterior(labelled_model(of_four, known, unsure), known, np.zeros(of_four.n_modes))
        total += np.exp(one.log_probability + fixed.log_likelihood(x)[0])
    assert posterior.log_likelihood(x)[0] == pytest.approx(np.log(total), rel=1e-10)
    x = np.array([9.4e9, 13.3e9])  # where both pairings matter
    step = np.diag(1e-4 * x)  # rounding is 1e-5 of the derivative, a tenth of that of 1e-5
    up, down = (posterior.log_likelihood(x + s * step) for s in (1, -1))
    gradient = posterior.expand_likelihood(x[None]).gradient[0]
    np.testing.assert_allclose(gradient, (up - down) / (2e-4 * x), rtol=1e-4)


def test_the_most_probable_pairing_follows_the_frequencies_where_shapes_leave_it_open(unsure, of_four):
    posterior = posterior_of(unsure, of_four)
    crossed = posterior.most_probable_pairing(TRUTH)
    assert sorted(crossed.mode.tolist()) == [0, 1]
    assert crossed.log_probability == pytest.approx(0.0, abs=1e-3)
    predicted_hz = posterior.predict(TRUTH[None])[0, crossed.mode]
    np.testing.assert_allclose(predicted_hz, unsure.measurement.frequencies, rtol=1e-3)


def test_shapes_like_no_mode_are_refused_with_what_to_check(tested, of_four):
    strange = np.zeros((2, 3, 20))
    strange[:, 2, 0] = 1.0
    specimen = with_values(tested, strange)
    with pytest.raises(LabelError, match=r"like one of the first 4 modes.*check the edges, the layup"):
        labelled_model(of_four, specimen.measurement, specimen)


def test_predicted_modes_written_as_a_universal_file_are_read_back_as_their_own(run, tmp_path):
    plate = tmp_path / "bar.toml"
    plate.write_text(FILE, encoding="utf-8")
    to_uff = ("export", plate, "--to", "uff", "--out", tmp_path / "modes.unv")
    refused(run(*to_uff, "--element", "brick"), "with --to ccx only")
    status, out, err = run(*to_uff, "--modes", "5")
    assert (status, err) == (0, "")
    assert "5 predicted modes" in " ".join(out.split())  # the path before it may break the line
    plate.write_text(f'{FILE}[measurement]\nshapes = "modes.unv"\n', encoding="utf-8")
    result = cb.forward(plate)
    computed = cb.forward(tomllib.loads(FILE), n_modes=5)
    # frequencies are written with six digits
    np.testing.assert_allclose(result.specimen.measurement.frequencies, computed.frequencies, rtol=1e-5)
    assert result.by_shape.modes.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(np.diag(result.by_shape.assurance), 1.0, atol=1e-5)
    document = result.to_dict()
    assert [one["label"] for one in document["shapes"]] == [m.label for m in computed.modes]
    assert [mode["paired_by"] for mode in document["modes"][:6]] == ["shape"] * 5 + [None]
    assert set(result.figures()) == {"handling", "modes", "modal_assurance", "plate"}
    assert "Modal assurance at the reference constants" in result.summary(verbose=True)


def test_modes_are_written_at_the_nodes_of_measured_shapes(tmp_path):
    points = grid(200.0, 100.0)
    shape = np.stack((*np.zeros((2, 20)), (points[:, 0] - 100) * (points[:, 1] - 50)))
    numbers = [100 + 3 * i for i in range(20)]
    content = nodes_15(points - (100, 50), numbers) + mode_55(331.0, shape, nodes=numbers)
    (tmp_path / "measured.unv").write_text(content)
    plate = tmp_path / "bar.toml"
    plate.write_text(f'{FILE}[measurement]\nshapes = "measured.unv"\n', encoding="utf-8")
    result = cb.export(plate, tmp_path / "predicted.unv", to="uff", n_modes=3)
    assert result.shapes.nodes.tolist() == numbers
    plate.write_text(f'{FILE}[measurement]\nshapes = "predicted.unv"\n', encoding="utf-8")
    again = cb.read_plate(plate).measurement
    assert again.shapes.nodes.tolist() == numbers
    np.testing.assert_allclose(again.shapes.points, 1e-3 * points, rtol=2e-6)  # written with six digits
