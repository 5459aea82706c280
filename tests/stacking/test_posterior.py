"""The posterior over stacking sequences, against brute force and against independent evidences."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import cpam_bayes as cb
from cpam_bayes.forward_model import model as forward_model
from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import angle_parameters, converged_model, reference_vector, training_sets
from cpam_bayes.forward_model.reduced import focused
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.inference.sampling import importance_evidence as known_evidence
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import Specimen, builtin, read_plate
from cpam_bayes.stacking import conditional
from cpam_bayes.stacking import posterior as stacking
from cpam_bayes.stacking.conditional import conditional_posterior, fit_conditionals, importance_evidence
from cpam_bayes.stacking.evaluation import NEAR
from cpam_bayes.stacking.posterior import common_starts, stacking_posterior, stacking_problem
from cpam_bayes.stacking.queries import given_layup
from cpam_bayes.stacking.records import DEFAULT_SETTINGS, StackingPosterior, StackingSettings
from cpam_bayes.stacking.search import noisier_seeds
from cpam_bayes.stacking.symmetry import all_sequences, classes, members
from cpam_bayes.stacking.training import TrainingSettings
from tests.hybrids import hybrid
from tests.plate_file import SHEET, described
from tests.stacking.cases import TRUE, listed, unknown_plate, with_layup

QUICK = StackingSettings(draws=50, listed=72, log2_points=7)


@pytest.fixture(scope="module")
def specimen() -> Specimen:
    return listed("[(?/?)_2]_s", 15.0)


@pytest.fixture(scope="module")
def answer(specimen: Specimen) -> StackingPosterior:
    return stacking_posterior(specimen, 0, settings=QUICK)


def distribution(answer: StackingPosterior) -> dict[tuple[float, ...], float]:
    """Probability of every listed sequence and its images, here only mirror images."""
    found = {}
    for angles, p in zip(answer.top, answer.probability, strict=True):
        found[tuple(angles)] = float(p)
        found[tuple(np.where(angles == 90.0, 90.0, -angles) + 0.0)] = float(p)
    return found


@pytest.mark.slow
def test_a_symmetric_sequence_of_an_unsymmetric_laminate_has_its_common_errors() -> None:
    """In the space of all sequences it lacks functions for stretching."""
    for layup, angles in (("[?/?/0]", (0.0, 0.0)), ("[?/?/0]", (45.0, 0.0)), ("[?/0_3]", (0.0,))):
        own = replace(unknown_plate(layup, step=45.0), measurement=builtin("C1").measurement)
        full = converged_model(own, angle_parameters(own).union(own.unknowns), 6)
        model: Any = SimpleNamespace(full=full, n_modes=6, parameters=full.parameters)
        constants = reference_vector(own, own.unknowns)
        errors = stacking._in_common(own, model, np.array(angles), constants)
        # for a thin plate thickness and density, 1 % each, shift all modes by 1 and 0.5 %
        np.testing.assert_allclose(np.linalg.norm(errors, axis=0), np.hypot(0.01, 0.005), rtol=0.2)


def test_errors_in_common_are_those_of_modes_that_cross_on_the_way_to_the_list() -> None:
    """Two modes cross between the reference and the plate, and sides are known to 1 %."""
    asked = described((310.0, 228.0, 3.1), 0.0, SHEET, layup="[0_2/?/0]_s")
    asked["plate"] |= {"mass_g": 340.7, "sd": {"length_mm": 3.1, "width_mm": 2.28, "thickness_mm": 0.02}}
    del asked["plate"]["density_kg_m3"]
    asked["unknowns"] = {"E1_GPa": [80.0, 200.0], "E2_GPa": [5.0, 16.0], "nu12": [0.15, 0.45]}
    asked["unknowns"] |= {"G12_GPa": [2.5, 10.0], "angle_grid_deg": 30}
    f = [80.2, 146.3, 218.6, 310.2, 347.8, 403.6, 467.7, 475.4]
    own = read_plate({**asked, "measurement": {"frequencies_hz": f, "relative_std": 0.002}})
    of_sequences = stacking_problem(own, 0).conditional
    found = of_sequences.common.powers * of_sequences.common.sd[:, None]
    at = np.array([[132e9, 9.1e9, 0.31, 4.8e9], [136.2e9, 8.9e9, 0.3, 4.64e9]])
    reference, list_ = (stacking._in_common(own, of_sequences.model, np.zeros(1), x) for x in at)
    expected = list_.T @ list_
    scale = np.abs(expected).max()
    assert np.abs(found.T @ found - expected).max() < 0.05 * scale
    assert np.abs(reference.T @ reference - expected).max() > 0.3 * scale


@pytest.mark.slow
def test_probabilities_add_up_and_marginals_are_those_of_the_sequences(answer: StackingPosterior) -> None:
    assert answer.enumerated == 12**2
    assert answer.classes is not None
    assert answer.unaccounted <= DEFAULT_SETTINGS.unaccounted
    np.testing.assert_allclose(answer.marginals.sum(axis=1), 1.0, rtol=1e-12)
    assert np.all(np.diff(answer.probability) <= 0.0)
    assert float(np.sum(answer.probability * answer.multiplicity)) <= 1.0 + 1e-12
    whole = distribution(answer)
    left = 1.0 - sum(whole.values())
    for j, angles in enumerate(answer.marginals):
        for angle, found in zip(answer.grid_deg, angles, strict=True):
            own = sum(p for s, p in whole.items() if s[j] == angle)
            assert own - 1e-9 <= found <= own + left + 1e-9


@pytest.mark.slow
def test_what_is_given_up_is_out_of_sight(specimen: Specimen, answer: StackingPosterior) -> None:
    listed = answer.classes_of(every := all_sequences(len(answer.grid_deg), 2)) >= 0
    assert 0.1 < listed.mean() < 0.9
    own, best = answer.conditional, answer.components.fits.x[:3]
    starts = np.concatenate((common_starts(specimen, own), best))
    given_up = classes(every[~listed], answer.symmetries).representative
    assert len(given_up) < 0.6 * np.sum(~listed), "one of each pair of mirror images"
    unseen = fit_conditionals(own, answer.grid_deg[given_up], starts).log_evidence
    assert unseen.max() < answer.log_evidence[0] - NEAR
    assert np.all(answer.log_evidence > answer.log_evidence[0] - NEAR)


def of_both_angles(specimen: Specimen) -> conditional.ConditionalPosterior:
    model = reduced_model(specimen, angle_parameters(specimen).union(specimen.unknowns), 6)
    return conditional_posterior(model, 2, specimen.measurement, np.full(6, 1e-4))


@pytest.mark.slow
@pytest.mark.parametrize("relative_std", [pytest.param(0.01, marks=pytest.mark.weekly), None])
def test_the_evidence_of_a_sequence_is_that_of_the_known_layup(relative_std: float | None) -> None:
    specimen = listed("[(?/?)_2]_s", 15.0, TRUE, relative_std)
    own = of_both_angles(specimen)
    start = np.concatenate((reference_vector(specimen, specimen.unknowns), [0.01] * (relative_std is None)))
    angles = np.array([TRUE, (45.0, 0.0)])
    found = importance_evidence(own, angles, fit_conditionals(own, angles, start[None]), 12)
    for i, row in enumerate(angles):
        known = with_layup(specimen, specimen.plate.layup.with_angles(row))
        of_known = reduced_model(known, known.unknowns, 6)
        posterior = plate_posterior(of_known, specimen.measurement, np.full(6, 1e-4))
        exact = known_evidence(posterior, start[None])
        tolerance = 4 * np.hypot(exact.standard_error, found.error[i]) + 0.02  # models differ by 1e-4 of f
        assert found.log_evidence[i] == pytest.approx(exact.log_evidence, abs=tolerance)


# few, treated like many
TRAINING = TrainingSettings(initial=60, each_round=40, max_size=160, log2_points=5)
FORCED = replace(QUICK, exhaustive=0, training=TRAINING)


@pytest.fixture(scope="module")
def surrogate(specimen: Specimen) -> StackingPosterior:
    return stacking_posterior(specimen, 0, settings=FORCED)


@pytest.mark.slow
def test_the_surrogate_gives_what_brute_force_gives_with_any_number_of_workers(specimen, answer, surrogate):
    assert surrogate.check is not None
    assert answer.check is None
    p, q = distribution(answer), distribution(surrogate)
    assert 0.5 * sum(abs(p.get(s, 0.0) - q.get(s, 0.0)) for s in set(p) | set(q)) <= 0.01  # all 72 classes
    np.testing.assert_allclose(surrogate.marginals, answer.marginals, atol=0.01)
    assert surrogate.log_evidence_total == pytest.approx(answer.log_evidence_total, abs=0.02)
    assert surrogate.unaccounted <= DEFAULT_SETTINGS.unaccounted
    with open_executor(None, 2) as executor:
        again = stacking_posterior(specimen, 0, settings=FORCED, executor=executor)
    np.testing.assert_array_equal(again.probability, surrogate.probability)
    np.testing.assert_array_equal(again.marginals, surrogate.marginals)
    np.testing.assert_array_equal(again.drawn.conditionals.draws, surrogate.drawn.conditionals.draws)


@pytest.mark.slow
@pytest.mark.weekly
@pytest.mark.parametrize("relative_std", [0.01, None])
def test_of_1296_sequences_pruned_and_by_surrogate_the_distribution_is_that_of_brute_force(relative_std):
    specimen = listed("[(?/?)_2]_s", 5.0, TRUE, relative_std)
    every = replace(QUICK, listed=700, log2_points=6)
    training = TrainingSettings(initial=100, each_round=60, max_size=340, log2_points=6)
    pruned = replace(every, exhaustive=0, training=training, listed=20)
    exact = stacking_posterior(specimen, 0, settings=every)
    found = stacking_posterior(specimen, 0, settings=pruned)
    p, q = distribution(exact), distribution(found)
    assert sum(p.values()) == pytest.approx(1.0, abs=1e-9)
    # listed ones by their probability, and the rest as a whole
    distance = sum(abs(p[s] - q[s]) for s in q) + abs(sum(q.values()) - sum(p[s] for s in q))
    assert 0.5 * distance <= 0.01
    assert 0.5 * np.abs(found.marginals - exact.marginals).sum(axis=1).max() <= 0.01
    error = float(np.median(exact.log_evidence_error[:20]))  # shared points, shared errors
    assert found.log_evidence_total == pytest.approx(exact.log_evidence_total, abs=1.5 * error)
    assert found.credible_count == pytest.approx(exact.credible_count, abs=2 + 0.03 * exact.credible_count)
    assert found.effective_count == pytest.approx(exact.effective_count, rel=0.03)


@pytest.mark.slow
def test_of_a_hybrid_the_sequence_and_a_modulus_of_each_material_are_found() -> None:
    # glass within carbon, its plies at 45 and -45 degrees; off 0 and 90 a mirror image is indistinguishable
    truth, asked = hybrid(), hybrid(layup="[c0_2/g?/g?/c90]_s")
    f = cb.forward(truth, n_modes=8).frequencies
    of_each = {"carbon": {"E1_GPa": [80.0, 200.0]}, "glass": {"E1_GPa": [20.0, 80.0]}}
    asked["unknowns"] = {"angle_grid_deg": 45.0, **of_each}
    asked["measurement"] = {"frequencies_hz": [round(float(v), 2) for v in f], "relative_std": 0.002}
    answer = stacking_posterior(read_plate(asked), 0, settings=QUICK)
    assert answer.enumerated == 4**2
    found = given_layup(answer, np.array([45.0, -45.0]))
    assert found.index == 0
    assert found.probability * answer.multiplicity[0] > 0.999
    assert found.fits.x[0, :2] / 1e9 == pytest.approx([121.2, 40.1], rel=2e-3)


@pytest.mark.slow
@pytest.mark.weekly
def test_the_truth_is_among_the_few_sequences_that_are_good_with_more_noise() -> None:
    layup, truth, step = "[(?/?/?)_2]_s", (30.0, -60.0, 10.0), 10.0
    few = TrainingSettings(initial=60, exploration_rounds=3, each_round=40, max_size=180, log2_points=4)
    settings = replace(QUICK, exhaustive=0, training=few)
    # so thin that the error of theory leaves the peak as narrow as the noise does
    problem = stacking_problem(listed(layup, step, truth, 0.0003, 0.0008), 0, settings=settings)
    true = members(np.searchsorted(problem.grid_deg, truth), problem.symmetries)
    for seed in (0, 1):
        seeds = noisier_seeds(problem, problem.sums, np.random.default_rng(seed), lambda text: None)
        assert any(np.any(np.all(true == one, axis=1)) for one in seeds)
        assert len(seeds) < 20  # among 5832 sequences, of which 180 are evaluated
    noisy = stacking_problem(listed(layup, step, truth), 0, settings=settings)
    assert noisier_seeds(noisy, problem.sums, np.random.default_rng(0), lambda text: None) is None


ROUGH = {"thickness_mm": 0.06, "density_kg_m3": 0.0, "length_mm": 0.0, "width_mm": 0.0}  # a rough thickness


def test_a_thickness_that_is_known_roughly_counts_in_the_evidence() -> None:
    """One frequency of a narrow strip along the fibres, f ~ h E1^0.5: one Gaussian."""
    e1_sd, noise, listed_hz = 4.0, 0.002, 222.0
    strip = described((300.0, 20.0, 2.1), 1409.0, {**SHEET, "sd": {"E1_GPa": e1_sd}}, layup="[?_2/0_2]_s")
    strip["unknowns"] = {"E1_GPa": [60.0, 220.0], "angle_grid_deg": 90.0}
    strip["measurement"] = {"frequencies_hz": [listed_hz], "relative_std": noise}
    strip["plate"]["sd"] = ROUGH
    answer = stacking_posterior(forward_model.with_references(read_plate(strip)), 0)
    (first,) = np.flatnonzero(answer.top[:, 0] == 0.0)
    along = {**strip, "plate": {**strip["plate"], "layup": "[0_8]"}}
    away = np.log(listed_hz / float(cb.forward(along, n_modes=1).frequencies[0]))
    spread = np.hypot(noise, np.hypot(ROUGH["thickness_mm"] / 2.1, 0.5 * e1_sd / 132.0))
    expected = norm.logpdf(away / spread) - np.log(spread * listed_hz)
    assert answer.log_evidence[first] == pytest.approx(expected, abs=0.1)
    assert away**2 / (2.0 * (noise**2 + (0.5 * e1_sd / 132.0) ** 2)) > 2.0  # the stated thickness costs this


@pytest.mark.slow
@pytest.mark.weekly
def test_probabilities_of_layups_are_right_where_a_thickness_is_known_to_3_percent() -> None:
    """Layup, constants and thickness drawn from their priors: no probability near one is wrong."""
    rng, scores = np.random.default_rng(78), []
    known_to = {"E1_GPa": 1.32, "E2_GPa": 0.091, "G12_GPa": 0.048}
    unknowns = {"E1_GPa": [100, 160], "E2_GPa": [6, 13], "G12_GPa": [3, 7], "angle_grid_deg": 5.0}
    for _ in range(20):
        angle, h = abs(float(rng.choice(np.arange(-85.0, 91.0, 5.0)))), 2.0 + 0.06 * rng.standard_normal()
        true = {name: v + known_to.get(name, 0.0) * rng.standard_normal() for name, v in SHEET.items()}
        plate = described((300.0, 120.0, h), 1500.0, true, layup=f"[{angle:g}_2/0_2]_s")
        f = cb.forward(plate, n_modes=3).frequencies * (1.0 + 0.003 * rng.standard_normal(3))
        stated = described((300.0, 120.0, 2.0), 1500.0, {**SHEET, "sd": known_to}, layup="[?_2/0_2]_s")
        stated["unknowns"] = unknowns
        stated["measurement"] = {"frequencies_hz": np.sort(f).round(3).tolist(), "relative_std": 0.003}
        stated["plate"]["sd"] = ROUGH
        answer = stacking_posterior(forward_model.with_references(read_plate(stated)), 0)
        same = np.abs(answer.top[:, 0]) == angle
        scores.append(np.log(max(float(np.sum((answer.probability * answer.multiplicity)[same])), 1e-12)))
    assert np.mean(scores) > -0.4


def test_a_focus_within_a_tolerance_for_most_frequencies_has_fewer_vectors(specimen: Specimen) -> None:
    own = of_both_angles(specimen)
    x = training_sets(own.model.full.operator.problem, 100, np.random.default_rng(0))
    every, most = (focused(own.model, x, 2e-3, share) for share in (1.0, 0.9))
    assert max(b.size for b in most.fast.operator.blocks) < max(b.size for b in every.fast.operator.blocks)
    exact = own.model.predict(x).frequencies
    assert np.max(every.predict(x).frequencies / exact - 1.0) <= 2e-3
    off = most.predict(x).frequencies / exact - 1.0
    assert np.mean(off <= 2e-3) >= 0.85  # 0.9 per block; sorted among the blocks they may swap places
    assert np.max(off) > 2e-3


@pytest.mark.slow
@pytest.mark.weekly
def test_unsure_evidences_are_those_of_the_whole_model_on_bases_of_their_own(specimen, monkeypatch) -> None:
    own, angles = of_both_angles(specimen), np.array([TRUE, (45.0, 15.0), (-75.0, 0.0)])
    fits = fit_conditionals(own, angles, common_starts(specimen, own))
    sizes: list[int] = []

    def counted(model: Any, x: np.ndarray, tolerance: float) -> Any:
        found = focused(model, x, tolerance)
        sizes.append(sum(b.size for b in found.fast.operator.blocks))
        return found

    monkeypatch.setattr(conditional, "focused", counted)
    unsure = conditional.RefinementSettings(unsure=0.0)
    whole = importance_evidence(own, angles, fits, settings=replace(unsure, large=1000))
    assert not sizes
    narrow = importance_evidence(own, angles, fits, settings=replace(unsure, large=1))
    assert len(sizes) == 2 * len(angles), "each sequence, at either number of points"
    assert max(sizes) < 0.7 * sum(b.size for b in own.model.fast.operator.blocks)
    # an error of a frequency, in noise standard deviations, is multiplied by the misfit in these
    misfit = np.sqrt(2.0 * (whole.log_evidence.max() - whole.log_evidence))
    assert np.all(np.abs(narrow.log_evidence - whole.log_evidence) < 0.01 * np.maximum(misfit, 1.0))
    np.testing.assert_allclose(narrow.mean, whole.mean, rtol=0.01)


def test_a_known_layup_is_refused() -> None:
    with pytest.raises(ValueError, match="no unknown angle"):
        stacking_posterior(builtin("C1"), 0)
