"""The benchmark of samplers: its peer solves the same plate, and a small run has what it says."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import samplers
from benchmarks.plain_likelihood import cross_ply_stiffness, plain_frequencies
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.plate import read_specimen
from cpam_bayes.plate.laminate import FIVE_SIXTHS
from tests.mechanics.test_convergence import CONVERGED_HZ

# As benchmarks/README.md has them.
KEYS = {
    *("quick", "plate", "mesh", "walkers", "rounds", "load"),
    *("fit", "agreement", "rows", "converged", "targets"),
}
ROW_KEYS = {
    *("sampler", "moves", "walkers", "rounds", "evaluation_s", "autocorrelation_time"),
    *("effective_per_s", "ratio", "ratio_quartiles"),
}


def test_the_plain_solver_has_the_plate_and_its_two_forms_agree() -> None:
    specimen = read_specimen("C1")
    assembling, summing = plain_frequencies(specimen, 6, 8)
    constants = dict(specimen.material.constants)
    # 8 x 8 elements are 0.06 % high; the references have six digits
    np.testing.assert_allclose(assembling(constants), CONVERGED_HZ["C1"], rtol=1e-3)
    np.testing.assert_allclose(summing(constants), assembling(constants), rtol=1e-7)


def test_the_plain_stiffness_is_that_of_the_laminate() -> None:
    specimen = read_specimen("C1")
    plate = specimen.plate
    found = cross_ply_stiffness(plate.layup.angles(np.empty(0)), plate.thickness, specimen.material.constants)
    whole = np.real(plate_problem(specimen, shear=FIVE_SIXTHS).nominal.stiffness())
    expected = [whole[i, j] for i, j in ((3, 3), (3, 4), (4, 4), (5, 5), (6, 6), (7, 7))]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_plies_off_the_axes_are_refused_by_the_plain_solver() -> None:
    with pytest.raises(ValueError, match="accepted: 0 and 90"):
        cross_ply_stiffness(np.array([45.0]), 1e-3, read_specimen("C1").material.constants)


@pytest.mark.slow
def test_a_small_run_of_the_benchmark_has_the_documented_keys() -> None:
    results = samplers.run(quick=True)
    assert set(results) == KEYS
    assert all(set(row) == ROW_KEYS for row in results["rows"])
    ratios = {(row["sampler"], row["moves"]): row["ratio"] for row in results["rows"]}
    assert ratios[samplers.OURS, samplers.JUMPS] == 1.0
    local = (samplers.DE, samplers.STRETCH)
    ours = {(s, m) for s in (samplers.OURS, samplers.OURS_MANY) for m in (samplers.JUMPS, *local)}
    assert set(ratios) == ours | {(s, m) for s in (samplers.ASSEMBLING, samplers.SUMMING) for m in local}
    times = {(row["moves"], row["walkers"]): row["autocorrelation_time"] for row in results["rows"]}
    # three against forty steps on longer chains
    assert all(times[samplers.JUMPS, n] < 0.5 * times[samplers.DE, n] for n in {n for _, n in times})
    assert results["fit"]["solves"] >= 2 * 2500, "two rounds at least"
    for row in results["rows"]:
        per_second = 1.0 / (row["evaluation_s"] * row["autocorrelation_time"])
        # the same numbers, medians taken before or after the division
        assert row["effective_per_s"] == pytest.approx(per_second, rel=1e-6)
    assert not results["targets"], "coarse meshes and short chains reach nothing"
    text = [cell for table in samplers.tables(results) for row in table.rows for cell in row]
    assert samplers.ASSEMBLING in text
