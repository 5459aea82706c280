"""Ensembles sampled in stored rounds until they agree; evidence by importance sampling."""

import errno
from dataclasses import replace
from functools import cache
from pathlib import Path
from shutil import copy, copytree
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from emcee.autocorr import integrated_time
from scipy.signal import lfilter
from scipy.stats import norm

from cpam_bayes.forward_model.model import Prediction
from cpam_bayes.inference import ensemble, sampling
from cpam_bayes.inference.ensemble import EnsembleResult, EnsembleSettings, sample, start_positions
from cpam_bayes.inference.importance import Proposal, Rounds
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.sampling import JUMPS, importance_evidence, sample_posterior, sampled_about
from cpam_bayes.inference.student_mixture import Mixture
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.parameters import TruncatedNormal, Uniform
from cpam_bayes.plate import Measurement
from tests import toy_models
from tests.linear_model import MEAN_HZ, SLOPE_HZ, LinearModel, exact_gaussian, measurement
from tests.toy_models import independent, integral, parameters, two_peaks

SETTINGS = EnsembleSettings(walkers=16, round_steps=100, effective=2000.0, most_steps=6000)
FOUR_ROUNDS = replace(SETTINGS, effective=1e9, most_steps=400)
JUMPING = replace(SETTINGS, effective=4000.0)  # For a chain that decorrelates within a few steps.


def posterior(relative_std: float | None = 0.01) -> Posterior:
    return plate_posterior(LinearModel(), measurement(relative_std), np.zeros(4))


def start(own: Posterior, settings: EnsembleSettings = SETTINGS) -> np.ndarray:
    rng = np.random.default_rng(3)
    swarm = rng.uniform(-1.0, 1.0, size=(20, 2))
    values = -own.log_prob(swarm) if own.parameters.size == 2 else np.arange(20.0)
    n = settings.ensembles * settings.walkers
    return start_positions(own, swarm, values, n, rng).reshape(settings.ensembles, settings.walkers, -1)


def run(store: Path | None = None, settings=FOUR_ROUNDS, proposal=None) -> EnsembleResult:
    return sample(posterior(), start(posterior(), settings), 7, settings, proposal=proposal, store=store)


@cache
def good_proposal() -> Proposal:
    return sampled_about(posterior(), np.array([[0.4, -0.3]]), JUMPS)[0]


def of_kind(jumps: bool) -> tuple[EnsembleSettings, Proposal | None]:
    return (replace(JUMPING, round_steps=50), good_proposal()) if jumps else (FOUR_ROUNDS, None)


@cache
def whole(jumps: bool = False) -> EnsembleResult:
    return run(None, *of_kind(jumps))


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, Path]:
    """A store of each kind of chains, which are the same with an empty store as without one."""
    places = {jumps: tmp_path_factory.mktemp("store") for jumps in (False, True)}
    for jumps, place in places.items():
        found = run(place, *of_kind(jumps))
        np.testing.assert_array_equal(found.chain, whole(jumps).chain)
        assert found.solves == whole(jumps).solves
    return places


def check_moments(found: EnsembleResult, mean: np.ndarray, covariance: np.ndarray) -> None:
    sd, error = np.sqrt(np.diag(covariance)), 4.0 / np.sqrt(found.diagnostics.ess_bulk)
    assert found.status == "converged"
    np.testing.assert_array_less(np.abs(found.draws.mean(axis=0) - mean) / sd, error)
    # the standard error of a covariance is below 1.5 products of standard deviations
    scaled = (np.cov(found.draws.T).reshape(covariance.shape) - covariance) / np.outer(sd, sd)
    np.testing.assert_array_less(np.abs(scaled), 1.5 * error)


# Errors of bad proposals: offset in standard deviations, and factor on the width.
BAD = {"far away": (40.0, 1.0), "off": (4.0, 1.0), "too narrow": (0.0, 0.1), "too wide": (0.0, 30.0)}


@pytest.mark.parametrize("name", ["local moves", "good", *BAD])
def test_chains_have_the_closed_form_however_good_a_proposal_is(name: str) -> None:
    mean, covariance = exact_gaussian(measurement(0.01))
    sd = np.sqrt(np.diag(covariance))
    if name in BAD:
        away, width = BAD[name]
        centre, factor = posterior().scores.to_z(mean + away * sd), np.diag(width * sd)  # dv / dx is about 1
        proposal = Proposal(posterior().scores, Mixture(np.ones(1), centre[None], factor[None], 5.0))
    else:
        proposal = good_proposal() if name == "good" else None
    found = run(settings=JUMPING if proposal else SETTINGS, proposal=proposal)
    check_moments(found, mean, covariance)
    assert found.diagnostics.r_hat <= 1.01
    assert found.solves == found.diagnostics.steps * 2 * 16 + (proposal.solves if proposal else 0)
    # half the steps are jumps, nearly all of them accepted, or hardly any
    assert (found.diagnostics.autocorrelation_time < 5.0) == (name == "good")


def test_chains_that_only_jump_have_the_noise_that_they_infer() -> None:
    """The proposal draws its logarithm: a missing Jacobian would show."""
    f, off = np.array([100.0, 200.0, 300.0]), np.array([2.0, -3.0, 3.0])
    model = toy_models.linear(f, np.array([[10.0], [30.0], [-20.0]]), parameters(a=Uniform(-2.0, 2.0)))
    own = plate_posterior(model, toy_models.listed(f + off, None), np.zeros(3))
    lower, upper = own.parameters.lower[1], own.parameters.upper[1]
    a, s = np.linspace(-1.0, 1.0, 1201), np.geomspace(lower * (1 + 1e-12), upper * (1 - 1e-12), 1500)
    grid = np.stack(np.meshgrid(a, s, indexing="ij"), axis=-1).reshape(-1, 2)
    weight = np.exp(own.log_prob(grid)).reshape(len(a), len(s))
    moments = [np.trapezoid(np.trapezoid(weight, a, axis=0) * s**k, s) for k in range(3)]
    mean, variance = moments[1] / moments[0], moments[2] / moments[0] - (moments[1] / moments[0]) ** 2
    proposal = sampled_about(own, np.array([[0.0, 0.01]]), JUMPS)[0]
    rng, shape = np.random.default_rng(0), (JUMPING.ensembles, JUMPING.walkers)
    begun = np.stack((rng.uniform(-0.2, 0.2, shape), rng.uniform(0.005, 0.03, shape)), axis=-1)
    found = sample(own, begun, 7, replace(JUMPING, jumps=1.0), proposal=proposal)
    check_moments(replace(found, chain=found.chain[..., 1:]), np.array([mean]), np.array([[variance]]))


def test_separate_peaks_have_their_weights_though_all_walkers_start_on_the_lesser() -> None:
    """A dip of fifty nats between them, and one with seven times the mass of the other."""
    own, b = two_peaks(), np.linspace(-2.0, 2.0, 801)
    uneven = parameters(a=TruncatedNormal(0.5, 0.7, -2.0, 2.0), b=Uniform(-2.0, 2.0))
    own = replace(own, model=replace(own.model, parameters=uneven), parameters=uneven)
    right, left = (integral(own, (a, b)) for a in (np.linspace(0.0, 2.0, 801), np.linspace(-2.0, 0.0, 801)))
    weight = 1.0 / (1.0 + np.exp(right - left))
    assert 0.1 < weight < 0.15
    shape = (JUMPING.ensembles, JUMPING.walkers, 2)
    begun = np.random.default_rng(0).normal([-1.0, 1.3], 0.05, shape)
    proposal = sampled_about(own, np.array([[1.0, -0.7]]), JUMPS)[0]
    found = sample(own, begun, 7, JUMPING, proposal=proposal)
    error = np.sqrt(weight * (1.0 - weight) / found.diagnostics.ess_bulk)
    assert np.mean(found.draws[:, 0] < 0.0) == pytest.approx(weight, abs=4.0 * error)
    assert found.status == "converged"


def test_chains_with_a_walker_that_never_moves_have_no_time_and_are_not_converged() -> None:
    chain = np.random.default_rng(0).standard_normal((2, 400, 16, 3))
    settings = replace(SETTINGS, effective=1000.0)
    free = ensemble.diagnose_chains(chain, settings)
    assert free.converged
    assert free.autocorrelation_time < 1.3
    chain[1, 200:, 5, 1] = 0.7
    np.testing.assert_array_equal(np.isfinite(ensemble.integrated_times(chain[1, 200:])), [True, False, True])
    stuck = ensemble.diagnose_chains(chain, settings)
    assert not stuck.converged
    assert (stuck.autocorrelation_time, stuck.burn_in, stuck.ess_bulk) == (400, 200, 2 * 200 * 16 / 400)
    chain[1, 200:, 5] = np.random.default_rng(1).standard_normal((200, 3))  # released before the second half
    chain[1, :200, 5] = 0.0
    assert ensemble.diagnose_chains(chain, settings).autocorrelation_time < 1.3


@pytest.mark.parametrize("steps", [1, 2, 3, 7])
def test_a_few_steps_say_that_nothing_is_known_and_warn_of_nothing(steps: int) -> None:
    found = run(settings=replace(SETTINGS, most_steps=steps, round_steps=steps))
    assert (found.status, found.diagnostics.steps) == ("budget", steps)
    assert found.diagnostics.r_hat > 1.01
    assert found.draws.shape[1] == 2


def test_a_collapsed_swarm_still_gives_walkers_that_span_the_posterior_and_a_noise() -> None:
    swarm = np.tile([0.4, -0.3], (20, 1))
    found = start_positions(posterior(), swarm, np.zeros(20), 60, np.random.default_rng(0))
    _, covariance = exact_gaussian(measurement(0.01))
    ratio = found.std(axis=0) / np.sqrt(np.diag(covariance))
    assert np.all((ratio > 0.6) & (ratio < 1.6))
    assert np.linalg.matrix_rank(found - found.mean(axis=0)) == 2
    own = posterior(None)  # inferred noise is started from the residuals
    walkers = start(own).reshape(-1, 3)
    assert np.all(np.isfinite(own.log_prob(walkers)))
    assert 1e-4 < np.median(walkers[:, 2]) < 0.05


def test_walkers_start_on_both_optima_of_a_swarm_with_duplicates_and_infeasible_particles() -> None:
    own = two_peaks()
    own = replace(own, model=replace(own.model, allowed=lambda x: np.abs(x[:, 0]) > 0.5))
    swarm = np.array([*([[1.0, -0.7]] * 30), [0.1, 0.2], [0.0, 0.0], *([[-1.02, 1.3]] * 5)])
    values = np.concatenate((np.full(30, 1.0), [0.0, np.inf], np.full(5, 2.0)))  # two infeasible particles
    found = start_positions(own, swarm, values, 200, np.random.default_rng(0))
    assert np.all(np.isfinite(own.log_prob(found)))
    # equal peaks: a half within four binomial standard errors, whatever the numbers of particles
    assert np.mean(found[:, 0] < 0.0) == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(200))
    assert len(np.unique(found, axis=0)) == 200
    with pytest.raises(ValueError, match="chains cannot start: no particle"):
        start_positions(own, swarm, np.full(len(swarm), np.inf), 8, np.random.default_rng(0))


class CountedDraws(np.random.Generator):
    draws = 0

    def standard_normal(self, *args: Any, **kwargs: Any) -> Any:
        found = super().standard_normal(*args, **kwargs)
        self.draws += len(found)
        return found


def test_walkers_about_an_optimum_in_a_corner_of_the_bounds_are_drawn_once_each() -> None:
    """With ten bounds one draw in a thousand of a Gaussian lies inside, of a correlated one hardly any."""
    far = replace(measurement(0.01), frequencies=MEAN_HZ + SLOPE_HZ @ np.array([4.0, -4.0]))
    own, rng = plate_posterior(LinearModel(), far, np.zeros(4)), CountedDraws(np.random.PCG64(0))
    found = start_positions(own, np.array([[2.0, -2.0]]), np.zeros(1), 40, rng)
    assert rng.draws == 40
    assert np.all(np.isfinite(own.log_prob(found)))
    assert np.linalg.matrix_rank(found - found.mean(axis=0)) == 2


@pytest.mark.parametrize("width", [1.0, 1e-4], ids=["a half", "a sliver"])
def test_walkers_beside_a_constraint_satisfy_it_and_span_what_is_left(width: float) -> None:
    own = independent((3.0, 7.0))

    def allowed(x: np.ndarray) -> np.ndarray:
        left = 0.8 - x.sum(axis=1)
        return (left > 0.0) & (left < width)

    beside = replace(own, model=replace(own.model, allowed=allowed))
    inside = np.array([[0.2, 0.6 - 0.5 * min(width, 0.01)]])
    found = start_positions(beside, inside, np.zeros(1), 60, np.random.default_rng(0))
    assert np.all(np.isfinite(beside.log_prob(found)))
    assert np.linalg.matrix_rank(found - found.mean(axis=0), tol=1e-9) == 2


def test_an_interrupted_call_prints_nothing(capfd, monkeypatch) -> None:
    """emcee prints all parameters of a call that ends in an exception, even in an interrupt."""
    own, predict, calls = posterior(), LinearModel.predict, []
    walkers = start(own)

    def interrupted(self: LinearModel, x: np.ndarray, *, jacobian: bool = False) -> Prediction:
        calls.append(len(x))
        if len(calls) > 5:
            raise KeyboardInterrupt
        return predict(self, x, jacobian=jacobian)

    monkeypatch.setattr(LinearModel, "predict", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sample(own, walkers, 7, SETTINGS)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kept", [1, 2])
@pytest.mark.parametrize("jumps", [False, True], ids=["local moves", "jumps"])
def test_a_store_with_some_rounds_goes_on_bit_for_bit(stored, tmp_path: Path, jumps: bool, kept: int) -> None:
    rounds = sorted(stored[jumps].glob("round_*.arrays"))
    assert len(rounds) > 2
    for path in rounds[:kept]:
        copy(path, tmp_path)
    again = run(tmp_path, *of_kind(jumps))
    np.testing.assert_array_equal(again.chain, whole(jumps).chain)
    assert again.solves == whole(jumps).solves


def test_two_runs_on_one_store_at_once_have_the_chain_of_one_alone(tmp_path: Path) -> None:
    own, others = posterior(), []

    def another(diagnostics: object) -> None:
        if not others:  # the other begins after the first round of this one, and overtakes it
            others.append(run(tmp_path))

    found = sample(own, start(own), 7, FOUR_ROUNDS, store=tmp_path, progress=another)
    np.testing.assert_array_equal(found.chain, whole().chain)
    np.testing.assert_array_equal(others[0].chain, whole().chain)
    assert {path.suffix for path in tmp_path.iterdir()} == {".arrays"}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_store_of_another_problem_is_refused_and_left_alone(tmp_path: Path) -> None:
    settings, proposal = replace(JUMPING, most_steps=100), good_proposal()
    run(tmp_path, settings, proposal)
    before, walkers = contents(tmp_path), start(posterior(), settings)
    wider = replace(proposal, mixture=replace(proposal.mixture, factor=1.01 * proposal.mixture.factor))
    others = [(0.02, settings, proposal), (0.01, settings, None), (0.01, settings, wider)]
    others.append((0.01, replace(settings, jumps=0.4), proposal))
    for noise, chosen, by in others:
        with pytest.raises(ensemble.StoreError, match="holds another problem"):
            sample(posterior(noise), walkers, 7, chosen, proposal=by, store=tmp_path)
        assert contents(tmp_path) == before


def test_a_damaged_round_is_set_aside_named_once_and_sampled_again_bit_for_bit(
    stored, tmp_path, caplog
) -> None:
    store = copytree(stored[False], tmp_path / "store")
    second = store / "round_0001.arrays"
    damaged = second.read_bytes()[:500]
    second.write_bytes(damaged)
    np.testing.assert_array_equal(run(store).chain, whole().chain)
    (said,) = caplog.messages
    assert said.startswith(f"{second} was damaged: it is set aside as round_0001.arrays.damaged")
    assert second.with_name("round_0001.arrays.damaged").read_bytes() == damaged
    second.write_bytes((store / "round_0000.arrays").read_bytes())  # nor a round in place of another
    np.testing.assert_array_equal(run(store).chain, whole().chain)


def test_rounds_of_an_earlier_version_are_refused_and_left_alone_and_so_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "round_0000.h5").write_bytes(b"hours of work")
    with pytest.raises(ensemble.StoreError, match=r"rounds of an earlier version \(round_0000\.h5 and on\)"):
        run(tmp_path)
    assert contents(tmp_path) == {"round_0000.h5": b"hours of work"}
    with pytest.raises(ensemble.StoreError, match="cannot be made"):
        run(tmp_path / "round_0000.h5")


def test_on_a_full_disk_rounds_are_kept_sampling_goes_on_and_it_is_said(tmp_path: Path, monkeypatch) -> None:
    own, rounds = posterior(), []

    def full(path: Path, arrays: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def fill(diagnostics: ensemble.Diagnostics) -> None:
        rounds.append(diagnostics)
        if len(rounds) == 2:
            monkeypatch.setattr(ensemble, "write_arrays", full)

    found = sample(own, start(own), 7, FOUR_ROUNDS, store=tmp_path, progress=fill)
    assert (found.status, len(rounds), rounds[-1].steps) == ("budget", 4, 400)
    np.testing.assert_array_equal(found.chain, whole().chain)
    said = "round_0002.arrays: cannot be written (No space left on device); 2 rounds before it are kept"
    assert said in str(found.not_stored)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["round_0000.arrays", "round_0001.arrays"]
    monkeypatch.undo()  # with space again the same problem continues from there
    np.testing.assert_array_equal(run(tmp_path).chain, whole().chain)


def autoregressive(time: float, steps: int, seed: int) -> np.ndarray:
    """x_(k+1) = factor x_k + noise for a hundred walkers, from its stationary density, (steps, 100, 1)."""
    factor, noise = (time - 1.0) / (time + 1.0), np.random.default_rng(seed).standard_normal((steps, 100, 1))
    noise[1:] *= np.sqrt(1.0 - factor**2)
    return lfilter([1.0], [1.0, -factor], noise, axis=0)


@pytest.mark.parametrize("time", [1.0, 3.0, 6.0, 30.0])
def test_the_time_of_an_autoregressive_chain_is_found(time: float) -> None:
    found = [ensemble.integrated_times(autoregressive(time, int(50 * time), seed))[0] for seed in range(8)]
    error = np.sqrt(20.0 / (50 * 100 * len(found)))  # Sokal's error of one: sqrt(20 tau / draws)
    assert np.mean(found) == pytest.approx(time, rel=4.0 * error + 0.06)


def test_a_chain_of_eight_times_is_long_enough_where_means_of_single_walkers_lose_half() -> None:
    chains = [autoregressive(6.0, 50, seed) for seed in range(8)]
    assert np.mean([ensemble.integrated_times(c)[0] for c in chains]) == pytest.approx(6.0, rel=0.2)
    assert np.mean([integrated_time(c, tol=0, quiet=True)[0] for c in chains]) < 3.6


FEWER = sampling.EVIDENCE._replace(log2_points=9, enough=2500.0, steady=0.02)


def sampled(own: Posterior, rounds: Rounds = FEWER) -> sampling.Evidence:
    return importance_evidence(own, np.empty((0, own.parameters.size)), rounds)


def agrees(found: sampling.Evidence, expected: float, near: float = 0.0) -> None:
    """Check an evidence within four standard errors, which must be small."""
    assert found.status == "reliable"
    assert found.k_hat < 0.7
    assert found.standard_error < 0.05
    assert found.log_evidence == pytest.approx(expected, abs=4.0 * found.standard_error + near)


@pytest.mark.parametrize("off", [-1.0, -5.0, -20.0])
def test_evidence_and_moments_of_a_gaussian_cut_at_a_bound_are_the_closed_form(off: float) -> None:
    """The optimum lies on a bound, up to 20 standard deviations from where it would lie without."""
    own = independent((off, 5.0))
    exact = norm.logsf(-off) + np.log(norm.cdf(5) - norm.cdf(-5)) + 2 * np.log(0.1)
    agrees(sampled(own), exact)
    found = sampled_about(own, np.empty((0, 2)), FEWER)[1]
    x, weight, effective = own.scores.to_x(found.points[0])[:, 0], found.weight[0], found.effective_size[0]
    assert effective > 0.3 * len(x)
    ratio = np.exp(norm.logpdf(off) - norm.logsf(-off))
    mean, sd = 0.1 * (ratio + off), 0.1 * np.sqrt(1.0 - off * ratio - ratio**2)
    near = 4.0 / np.sqrt(effective)
    assert weight @ x == pytest.approx(mean, abs=near * sd)
    own_sd = np.sqrt(weight @ (x - weight @ x) ** 2)  # twice the error for an exponential
    assert own_sd == pytest.approx(sd, abs=(1.0 if off == -1.0 else 2.0) * near * sd)
    assert np.all((x >= 0.0) & (x <= 1.0))


WIDE = np.linspace(-2.0, 2.0, 801)


def known(case: str) -> tuple[Posterior, float, float]:
    """A posterior, its log evidence, and the accuracy of a quadrature for that."""
    if case == "Student-t noise":  # and a normal prior without bounds
        model = LinearModel(parameters(a=Uniform(-2.0, 2.0), b=TruncatedNormal(-0.2, 0.1, -np.inf, np.inf)))
        own = plate_posterior(model, measurement(0.02), np.zeros(4), degrees_of_freedom=4.0)
        return own, integral(own, (WIDE, np.linspace(-0.9, 0.5, 281))), 1e-3
    if case == "a missing mode":
        kept = measurement(None).frequencies[[0, 1, 3]]
        gaps = Measurement(kept, 0.0, 0.01, None, ("",) * 3, complete=False)
        own = plate_posterior(LinearModel(), gaps, np.zeros(4))
        return own, integral(own, (WIDE, WIDE)), 0.01  # it jumps where a mode leaves the list's range
    if case == "crossing modes":
        own = toy_models.crossing()
        return own, integral(own, (np.linspace(-1.0, 1.0, 1001),) * 2), 5e-3
    if case == "inferred noise":
        own = plate_posterior(LinearModel(), measurement(None), np.zeros(4))
        return own, toy_models.integral_over_noise(own), 2e-3  # steps leave 1e-3; noise below 1e-4 is omitted
    own = independent((5.0, 5.0))  # truncated by constraints without being normalised again
    half = replace(own, model=replace(own.model, allowed=lambda x: x[:, 0] > x[:, 1]))
    return half, 2 * np.log(0.1 * (norm.cdf(5) - norm.cdf(-5))) + np.log(0.5), 0.0


@pytest.mark.parametrize(
    "case", ["Student-t noise", "a missing mode", "crossing modes", "inferred noise", "constraints"]
)
def test_evidence_is_that_of_a_quadrature(case: str) -> None:
    own, *exact = known(case)
    agrees(sampled(own), *exact)


def test_errors_of_a_dozen_posteriors_are_no_larger_than_they_say() -> None:
    """Gaussians truncated at a bound, with evidences in closed form."""
    rounds, off = Rounds(log2_points=7, most=4), np.linspace(-2.0, 1.0, 12)
    found = [sampled(independent((o, 5.0)), rounds) for o in off]
    exact = norm.logsf(-off) + np.log(norm.cdf(5) - norm.cdf(-5)) + 2 * np.log(0.1)
    z = (np.array([f.log_evidence for f in found]) - exact) / [f.standard_error for f in found]
    assert np.sqrt(np.mean(z**2)) < 1.5  # stated for independent points, not Sobol's
    assert np.abs(z).max() < 4.0


def test_evidence_of_chains_counts_both_peaks_also_where_they_miss_one(monkeypatch) -> None:
    own, ensembles = two_peaks(), EnsembleSettings(walkers=16, round_steps=100, most_steps=100)
    result = sample_posterior(own, 0, settings=ensembles, swarm_settings=SwarmSettings(10, 20))
    right = np.abs(result.chain[..., :1]) * np.array([1.0, 0.0]) + result.chain * np.array([0.0, 1.0])
    expected = integral(own, (WIDE, WIDE))
    for chain in (result.chain, right):
        agrees(sampling.evidence_of(own, replace(result, chain=chain)), expected, near=1e-3)
    monkeypatch.setattr(sampling, "POLISHED", replace(sampling.POLISHED, log2_draws=0))  # no prior draws
    chain = np.tile([[1.0, -0.7], [-1.0, 1.3]], (1, 10, EnsembleSettings().walkers // 2, 1))
    held: Any = SimpleNamespace(draws=chain.reshape(-1, 2), log_prob=np.zeros(chain.shape[:3]))
    agrees(sampling.evidence_of(own, held), expected, near=1e-3)


def test_an_evidence_on_a_narrow_basis_is_that_on_the_whole_one_once_draws_are_reweighted() -> None:
    whole, narrow = posterior(0.02), posterior(0.022)
    ensembles = EnsembleSettings(walkers=16, round_steps=200, most_steps=400)
    chains = sample_posterior(narrow, 0, settings=ensembles, swarm_settings=SwarmSettings(10, 20))
    found, expected = sampled(narrow), sampled(whole)
    assert abs(found.log_evidence - expected.log_evidence) > 0.1
    weighed = sampling.reweighted(found, whole, narrow, chains, 0)
    # a thousand draws whose weights scatter by a few per cent
    assert weighed.log_evidence == pytest.approx(expected.log_evidence, abs=0.02)
    assert 0.8 < weighed.exact_fraction < 0.999
    assert found.standard_error < weighed.standard_error < 0.02
    assert sampling.reweighted(found, narrow, narrow, chains, 0) is found


def test_a_proposal_that_cannot_follow_is_not_called_reliable() -> None:
    """A comb of spikes: forty narrow optima, of which a few components find some."""

    def comb(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = x.T
        f = np.stack((100.0 + 30.0 * np.sin(40.0 * a), 200.0 + 30.0 * np.sin(40.0 * b)), axis=1)
        slope = np.zeros((len(x), 2, 2))
        slope[:, 0, 0], slope[:, 1, 1] = 1200.0 * np.cos(40.0 * a), 1200.0 * np.cos(40.0 * b)
        return f, slope

    data = toy_models.listed(np.array([100.0, 200.0]), np.full(2, 0.05))
    own = plate_posterior(toy_models.ToyModel(LinearModel().parameters, comb), data, np.zeros(2))
    assert sampled(own, Rounds(log2_points=9, most=4)).status == "unreliable"
