"""Starts of optimisations: the members of a library that suit a list best."""

from functools import cache

import numpy as np

from cpam_bayes.stacking.conditional.starts import scan_library, scanned_starts
from tests.stacking.cases import TRUE, answer

ANGLES = np.array([TRUE, (60.0, 0.0)])


@cache
def library() -> np.ndarray:
    return scan_library(answer().conditional, 40, np.random.default_rng(0))


def test_a_library_is_within_the_prior() -> None:
    own = answer().conditional
    assert library().shape == (40, own.template.model.parameters.size)
    assert np.all(np.isfinite(own.template.log_prior(library())))


def test_starts_are_within_the_bounds_and_ordered_by_misfit() -> None:
    own = answer().conditional
    starts = scanned_starts(own, ANGLES, library(), 5)
    assert starts.shape == (2, 5, own.parameters.size)
    assert np.all((starts >= own.parameters.lower) & (starts <= own.parameters.upper))
    measured = own.template.measurement.frequencies
    for angles, row in zip(ANGLES, starts, strict=True):
        found = own.at(np.repeat(angles[None], len(row), axis=0)).predict(row)[:, : len(measured)]
        misfit = np.sqrt(np.mean(np.log(measured / found) ** 2, axis=1))
        assert np.all(np.diff(misfit) >= -1e-12)


def test_a_member_counts_with_the_factor_on_its_stiffnesses_that_suits_the_list() -> None:
    own = answer().conditional
    n = own.template.model.parameters.size
    truth = answer().components.fits.x[0, :n]
    angles = answer().top[:1]
    moduli = np.array([name[0] in "EG" for name in own.template.model.parameters.names])
    scaled = np.where(moduli, 0.9 * truth, truth)
    start = scanned_starts(own, angles, scaled[None], 1)[0, 0, :n]
    # all stiffnesses together set the level of all frequencies: the factor brings back the optimum,
    # whose own residuals have a mean of less than the noise of 1 %, 2 % of a stiffness
    np.testing.assert_allclose(start, truth, rtol=0.02)
