"""The mixture over sequences: weights by probability, and the right conditional for each."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.parallel import open_executor
from cpam_bayes.stacking.posterior import MixtureSettings, n_sampled_classes, sample_mixture
from cpam_bayes.stacking.posterior import _combined as combined
from cpam_bayes.stacking.queries import given_layup
from cpam_bayes.stacking.symmetry import members
from tests.stacking.cases import SAMPLED, answer, mixture, shortened

pytestmark = pytest.mark.slow

ONE = MixtureSettings(least=2.0)
# chains too short to be good
FEW = replace(ONE.ensembles, walkers=12, round_steps=10, most_steps=10)
SHORT = replace(ONE, ensembles=FEW, rounds=ONE.rounds._replace(log2_points=8, most=1))


def test_the_first_class_is_sampled_by_emcee_and_so_are_those_with_much_of_the_probability() -> None:
    own = answer()
    mass = own.probability * own.multiplicity
    for least, n in ((ONE.least, 1), (float(mass[2]), 3), (0.0, len(own.top))):
        assert n_sampled_classes(own, MixtureSettings(least=least)) == n
    behind = replace(own, probability=np.array([0.1, 0.095, 0.09]), multiplicity=np.array([4, 1, 4]))
    assert n_sampled_classes(behind, MixtureSettings(least=0.1)) == 3, "the third has 0.36"


def test_emcee_and_importance_sampling_agree_on_every_component() -> None:
    found = mixture()
    assert found.converged
    assert len(found.components) == 3
    assert max(c.worst_z for c in found.components) < 4.0  # exceeded once in 600 times
    assert min(c.diagnostics.ess_bulk for c in found.components) >= 400.0
    assert min(c.effective for c in found.components) > 300.0
    one, other = found.components[:2]
    assert replace(one, importance=other.importance).worst_z > 10.0, "a wrong one would be seen"


def test_each_class_has_as_many_draws_as_its_probability_says_and_so_are_the_moments() -> None:
    own, found = answer(), mixture()
    size = len(found.parameters)
    for i, share in enumerate(own.probability * own.multiplicity):
        assert abs(np.sum(found.origin == i) - size * share) <= 1.0 + 1e-6 * size  # systematic resampling
    assert found.emcee_fraction + found.listed_fraction + found.drawn_fraction == pytest.approx(1.0)
    assert found.by_emcee.mean() == pytest.approx(found.emcee_fraction, abs=1.0 / size)
    angles = found.angles_deg[found.origin == 0]  # all images of a class are drawn equally often
    images = own.grid_deg[members(own.components.sequences[0], own.symmetries)]
    share = [np.mean(np.all(angles == image, axis=1)) for image in images]
    assert sum(share) == pytest.approx(1.0)
    np.testing.assert_allclose(share, 1.0 / len(images), atol=2.0 / np.sqrt(len(angles)))  # four sd of 1/2
    weight = (own.probability * own.multiplicity)[: len(found.components)]  # of the weighted components
    of_each = [c.importance for c in found.components]
    mean = np.average([c.mean for c in of_each], axis=0, weights=weight)
    sd = np.sqrt(np.average([c.sd**2 + (c.mean - mean) ** 2 for c in of_each], axis=0, weights=weight))
    # about 900 effective draws of the first class, and as many of importance sampling
    np.testing.assert_allclose(found.parameters.mean(axis=0), mean, atol=4.0 * sd.max() / 20.0, rtol=0.0)
    np.testing.assert_array_less(np.abs(found.parameters.mean(axis=0) - mean) / sd, 0.2)
    np.testing.assert_allclose(found.parameters.std(axis=0), sd, rtol=0.2)


def test_what_is_not_sampled_has_its_importance_draws_where_it_is_listed_and_is_drawn_where_not() -> None:
    whole, own, first_alone = answer(), shortened(1), mixture().components[:1]
    rest = first_alone, None, 4000
    listed, found = (combined(of, *rest, np.random.default_rng(0), 0.0) for of in (whole, own))
    assert listed.listed_fraction == pytest.approx(1.0 - listed.emcee_fraction)
    kept = whole.components.conditionals.draws[1]
    assert all(np.any(np.all(kept == x, axis=1)) for x in listed.parameters[listed.origin == 1])
    rest = 1.0 - float((own.probability * own.multiplicity)[0])
    assert found.drawn_fraction == pytest.approx(rest, rel=1e-9)
    assert found.listed_fraction == 0.0
    unlisted = found.angles_deg[found.origin == -1]
    assert len(unlisted) == pytest.approx(4000 * rest, abs=1.0)
    first = own.grid_deg[members(own.components.sequences[0], own.symmetries)]
    assert not any(np.all(unlisted == image, axis=1).any() for image in first)


def test_a_sequence_that_is_asked_for_is_sampled_too() -> None:
    own = answer()
    found = sample_mixture(own, 0, given=given_layup(own, own.top[2]), settings=SHORT)
    assert (found.given.index, len(found.components), len(found.sampled)) == (2, 1, 2)
    most_probable = sample_mixture(own, 0, settings=replace(SHORT, least=SAMPLED))  # as if most probable
    np.testing.assert_array_equal(found.given.draws, most_probable.components[2].draws)


def test_the_same_seed_gives_the_same_draws_whoever_computes_them() -> None:
    own = answer()
    told: list[tuple[int, int]] = []
    alone = sample_mixture(own, 0, settings=SHORT, progress=lambda done, total: told.append((done, total)))
    n = n_sampled_classes(own, SHORT)
    assert told == [(done, n) for done in range(1, n + 1)]
    with open_executor("processes", 2) as executor:
        shared = sample_mixture(own, 0, settings=SHORT, executor=executor)
    np.testing.assert_array_equal(shared.parameters, alone.parameters)
    np.testing.assert_array_equal(shared.angles_deg, alone.angles_deg)
    assert not np.array_equal(sample_mixture(own, 1, settings=SHORT).parameters, alone.parameters)
