"""Simulation-based calibration: its statistics, its store, posteriors and sets that must pass it."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, kstest

from cpam_bayes import calibration
from cpam_bayes.calibration import N_DRAWS, Experiment, calibrate, coverage, rank_statistics, repeat
from cpam_bayes.inference.ensemble import EnsembleSettings, StoreError
from cpam_bayes.inference.posterior import NOISE_PRIOR
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parallel import open_executor
from tests.linear_model import LinearModel
from validation import draw_store, sequences
from validation.draw_store import DrawStore, stored_calibration

N_RANKS = N_DRAWS + 1
# Short chains for a short test; the full study has longer ones.
BRIEF = EnsembleSettings(walkers=16, round_steps=160, r_hat=1.1, effective=99.0, most_steps=1600, lengths=5.0)


@dataclass(frozen=True)
class LinearSource:
    solver_error: float = 1e-4

    def __call__(self) -> calibration.Nature:
        return calibration.Nature(LinearModel(), np.full(4, self.solver_error))


LINEAR = Experiment(LinearSource(), 0.5, None, 5, BRIEF, SwarmSettings(particles=12, iterations=40))


def gaussian_ranks(n: int, rng: np.random.Generator, sd: float = 1.0, shift: float = 0.0) -> np.ndarray:
    """Ranks (n, 1) of truths among draws of a Gaussian posterior with a wrong sd and mean."""
    centre = rng.standard_normal((n, 1))
    truth = centre + rng.standard_normal((n, 1))
    draws = centre + shift + sd * rng.standard_normal((n, N_DRAWS))
    return np.sum(draws < truth, axis=1, keepdims=True)


def statistics(ranks: np.ndarray, simulations: int = 4000) -> calibration.RankStatistics:
    return rank_statistics(ranks, N_RANKS, np.random.default_rng(0), simulations=simulations)


def test_uniform_ranks_are_refused_as_often_as_the_level_says_and_those_of_wrong_posteriors_are() -> None:
    rng = np.random.default_rng(1)
    found = [statistics(gaussian_ranks(200, rng), simulations=300).parameters[0] for _ in range(200)]
    p = np.array([(one.chi_square_p, one.ecdf_p) for one in found])
    refused = np.sum(p < 0.05, axis=0)  # 200 tables at the level of 5 %: 10 rejected, sd 3.1
    low, high = binom.ppf((0.001, 0.999), 200, 0.05)
    assert np.all((refused >= low) & (refused <= high))
    for sd, shift in ((0.8, 0.0), (1.2, 0.0), (1.0, 0.25), (1.0, -0.25)):  # wrong by a fifth
        own = statistics(gaussian_ranks(500, np.random.default_rng(2), sd, shift))
        assert own.parameters[0].corrected_p < 0.01
        cumulative = own.parameters[0].cumulative[:-1]
        assert np.any((cumulative < own.ecdf_band.lower) | (cumulative > own.ecdf_band.upper))


def test_bands_hold_uniform_counts_simultaneously() -> None:
    rng = np.random.default_rng(3)
    band = rank_statistics(rng.integers(0, N_RANKS, (300, 1)), N_RANKS, rng)
    counts = rng.multinomial(300, np.full(N_RANKS, 1 / N_RANKS), size=2000)
    cumulative, bins = np.cumsum(counts, axis=1)[:, :-1], counts.reshape(2000, 20, 5).sum(axis=2)
    for rows, own in ((cumulative, band.ecdf_band), (bins, band.histogram_band)):
        held = np.mean(np.all((rows >= own.lower) & (rows <= own.upper), axis=1))
        assert 0.93 < held < 0.985  # accurate to 0.006; counts are integers, so it may cover more


def test_holm_multiplies_the_smallest_by_the_number_and_never_falls() -> None:
    for p, corrected in (([0.04, 0.01, 0.03], [0.06, 0.03, 0.06]), ([0.9, 0.5], [1.0, 1.0])):
        np.testing.assert_allclose(calibration.holm(np.array(p)), corrected)


def test_coverage_counts_intervals_that_hold_the_truth() -> None:
    below = (np.arange(1000) + 0.5) / 1000
    assert [c.share for c in coverage(below)] == pytest.approx([0.5, 0.8, 0.95])
    assert coverage(below)[2].standard_error == pytest.approx(np.sqrt(0.95 * 0.05 / 1000))
    narrow = coverage(np.clip(0.5 + 1.5 * (below - 0.5), 0.0, 1.0))
    assert narrow[0].share == pytest.approx(1 / 3, abs=1e-3)


def test_ranks_out_of_range_and_uneven_bins_are_refused() -> None:
    for rank, bins in ((100, 20), (-1, 20), (5, 30)):
        with pytest.raises(ValueError, match="accepted"):
            rank_statistics(np.array([[rank]]), N_RANKS, np.random.default_rng(0), n_bins=bins)


def test_spread_draws_come_from_all_walkers_and_all_steps() -> None:
    chain = np.arange(2 * 300 * 10.0).reshape(2, 300, 10, 1)
    found = calibration.spread_draws(chain, N_DRAWS, np.random.default_rng(0))[:, 0]
    ensemble, rest = np.divmod(found, 3000)
    step, walker = np.divmod(rest, 10)
    assert len(set(zip(ensemble, walker, strict=True))) == 20
    np.testing.assert_array_equal(step, ((np.arange(N_DRAWS) + 0.5) * 300 / N_DRAWS).astype(int))


def test_truths_follow_the_prior_and_lists_the_noise_model() -> None:
    own = replace(LINEAR, source=LinearSource(0.002))
    nature, rng = own.source(), np.random.default_rng(7)
    drawn = [calibration.simulate(own, nature, rng) for _ in range(1500)]
    truth = np.array([t for t, _ in drawn])
    assert kstest(truth[:, 0], "uniform", args=(-2, 4)).pvalue > 0.01
    cdf = np.searchsorted(np.sort(NOISE_PRIOR.sample(np.random.default_rng(8), 200_000)), truth[:, 2]) / 2e5
    assert kstest(cdf, "uniform").pvalue > 0.01
    f = LinearModel().predict(truth[:, :2]).frequencies
    sd = np.sqrt((truth[:, 2:] * f) ** 2 + 0.5**2 / 12 + (0.002 * f) ** 2)
    z = (np.array([m.frequencies for _, m in drawn]) - f) / sd
    assert kstest(z.ravel(), "norm").pvalue > 0.01


def check(found: tuple[calibration.Repetition, ...]) -> None:
    ranks, below = np.array([r.ranks for r in found]), np.array([r.below for r in found])
    own = rank_statistics(ranks, N_RANKS, np.random.default_rng(0), n_bins=10)
    assert min(p.corrected_p for p in own.parameters) > 0.01
    for column in below.T:
        for c in coverage(column):
            assert abs(c.share - c.level) <= 3.3 * c.standard_error + 1e-9  # all fifteen in 98.6 of 100
    assert np.sqrt(np.mean((ranks / N_DRAWS - below) ** 2)) < 0.07  # a rank has an sd of at most 5


@pytest.mark.slow
@pytest.mark.weekly
def test_sampled_posteriors_of_a_linear_model_are_calibrated() -> None:
    with open_executor("processes", 2) as pool:
        found = calibrate(LINEAR, 120, executor=pool)
    check(found)
    assert found[5] == repeat(LINEAR, 5), "processes give the same bit for bit"


@pytest.mark.slow
@pytest.mark.weekly
def test_sampled_posteriors_of_a_thin_plate_are_calibrated() -> None:
    own = Experiment(calibration.PlateSource("C1", 6), 1.0, None, 1, BRIEF)
    assert calibration.parameter_names(own) == ("E1", "E2", "nu12", "G12", "relative_std")
    with open_executor(None, None) as pool:
        check(calibrate(own, 40, executor=pool))


FASTEST = EnsembleSettings(walkers=8, round_steps=40, r_hat=9.0, effective=1.0, most_steps=40, lengths=0.1)
FAST = replace(LINEAR, seed=3, settings=FASTEST, swarm=SwarmSettings(particles=6, iterations=5))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "store.jsonl"


@pytest.mark.slow
def test_repetitions_are_the_same_bit_for_bit_whoever_computes_them(path: Path) -> None:
    alone = calibrate(FAST, 7)
    assert [r.number for r in alone] == list(range(7))
    with ThreadPoolExecutor(1) as pool:
        assert calibrate(FAST, 7, executor=pool, batch_size=3) == alone
    assert stored_calibration(FAST, 7, path) == alone
    assert calibrate(replace(FAST, seed=4), 2)[0] != alone[0], "another seed, other lists"
    assert repeat(FAST, 5) == alone[5]  # a repetition depends only on its number


@pytest.mark.parametrize("cut", [1, 60, 400])
def test_a_killed_run_goes_on_from_its_last_whole_line(path: Path, cut: int, monkeypatch) -> None:
    lines = {}

    def count(done: int) -> None:
        lines[done] = len(path.read_bytes().splitlines())

    whole = stored_calibration(FAST, 5, path, progress=count)
    assert lines == {n: n + 1 for n in range(1, 6)}, "a repetition has its line as soon as it is there"
    content = path.read_bytes()
    path.write_bytes(content[:-cut])  # the last record and perhaps the one before are torn
    computed = []
    monkeypatch.setattr(calibration, "repeat", lambda own, i: computed.append(i) or repeat(own, i))
    assert stored_calibration(FAST, 5, path) == whole
    assert 0 < len(computed) < 5
    assert sorted(path.read_bytes().splitlines()) == sorted(content.splitlines())
    computed.clear()
    assert stored_calibration(FAST, 6, path)[:5] == whole
    assert computed == [5], "more repetitions of the same experiment join the store"


def test_a_store_of_another_experiment_or_other_code_is_refused_and_left_alone(path, monkeypatch) -> None:
    stored_calibration(FAST, 2, path)
    before = path.read_bytes()
    others: list[dict[str, Any]] = [{"seed": 4}, {"relative_std": 0.01}, {"resolution": 1.0}]
    others += [{"settings": replace(FASTEST, walkers=10)}, {"source": LinearSource(0.01)}]
    for other in others:
        with pytest.raises(StoreError, match="holds another problem"):
            stored_calibration(replace(FAST, **other), 2, path)
    monkeypatch.setattr(draw_store, "fingerprint", lambda module: "0123456789ab")
    with pytest.raises(StoreError, match=r"holds another problem \(code, plate"):
        stored_calibration(FAST, 2, path)
    assert path.read_bytes() == before


@pytest.mark.parametrize("content", [b"not JSON\nat all\n", b"no line", b"[1, 2]\n", b'{"other": 1}\n'])
def test_a_file_that_is_no_store_is_refused_and_left_alone(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"store\.jsonl: is damaged or no store"):
        stored_calibration(FAST, 1, path)
    with pytest.raises(StoreError, match="cannot be used"):
        stored_calibration(FAST, 1, path / "store.jsonl")
    assert path.read_bytes() == content


def test_a_store_begun_without_checksums_goes_on_without_them(path: Path) -> None:
    path.write_text('{"problem": "a"}\n{"number": 0}\n', encoding="utf-8")
    DrawStore.open(path, "a").append({"number": 1})
    assert DrawStore.open(path, "a").records == ({"number": 0}, {"number": 1})


@pytest.mark.parametrize("line", [0, 1, 2])
def test_a_changed_digit_before_the_end_of_a_store_is_found(path: Path, line: int) -> None:
    store = DrawStore.open(path, "0" * 8)
    for i in range(3):
        store.append({"number": i, "value": 12.5})
    lines = path.read_bytes().splitlines(keepends=True)
    lines[line] = lines[line].replace(b"0" * 8, b"0" * 7 + b"1").replace(b"12.5", b"13.5")
    path.write_bytes(b"".join(lines))
    with pytest.raises(StoreError, match="is damaged"):
        DrawStore.open(path, "0" * 8)
    assert path.read_bytes() == b"".join(lines)


SINGLE, SIZE = np.array([0.3, 0.1, 0.1, 0.05]), np.array([2, 1, 2, 2])


def test_the_place_is_the_probability_of_what_comes_before() -> None:
    assert sequences.randomised_place(SINGLE, SIZE, 0, 0.0) == 0.0  # 1 and 2 share a place
    for true, u, place in ((0, 1.0, 0.6), (1, 0.5, 0.75), (2, 0.5, 0.75), (3, 1.0, 1.0)):
        assert sequences.randomised_place(SINGLE, SIZE, true, u) == pytest.approx(place)


@pytest.mark.parametrize(("power", "number", "seed"), [(1, 4000, 0), (3, 300, 1)])
def test_places_of_draws_are_uniform_and_those_of_too_sure_ones_do_not_pass(power, number, seed) -> None:
    rng = np.random.default_rng(seed)
    stated = (SINGLE * SIZE) ** power / np.sum((SINGLE * SIZE) ** power)
    true = rng.choice(4, size=number, p=SINGLE * SIZE)
    places = [sequences.randomised_place(stated / SIZE, SIZE, int(i), rng.uniform()) for i in true]
    trials = tuple(sequences.Trial(i, (0.0,), p, 0.5, 1, 1, 0.0) for i, p in enumerate(places))
    found = sequences.summarised(trials)
    assert found.passes == (power == 1)
    assert (found.p_uniform > 0.01) if power == 1 else (found.z < 0.0)


def test_a_plate_has_its_own_unknown_angles_or_those_of_a_layup_that_stand_at_their_places() -> None:
    own = sequences.with_unknown_layup("C1", None, 30.0)
    assert (own.angle_grid_deg, own.plate.layup.n_unknown) == (30.0, 4)
    # C1 is [(0/90)_8]_s
    for layup, angles in (("[(?/?)_8]_s", [0.0, 90.0]), ("[0/?/?/90/(0/90)_6]_s", [90.0, 0.0])):
        found = sequences.with_unknown_layup("C1", layup, 30.0)
        assert (found.angle_grid_deg, found.plate.layup.n_unknown) == (30.0, 2)
        np.testing.assert_array_equal(sequences.known_angles(found), angles)
