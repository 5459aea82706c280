"""Ensembles against a posterior in closed form; their start; their store."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.inference.ensemble import (
    EnsembleResult,
    EnsembleSettings,
    StoreError,
    sample,
    start_positions,
)
from cpam_bayes.inference.laplace import optimise
from cpam_bayes.posterior import Posterior, plate_posterior
from tests.linear_model import LinearModel, exact_gaussian, measurement

SETTINGS = EnsembleSettings(walkers=16, round_steps=200, effective=6000.0, most_steps=6000)
ROOT = Path(__file__).parents[2]


def posterior(relative_std: float | None = 0.01) -> Posterior:
    return plate_posterior(LinearModel(), measurement(relative_std), np.zeros(4))


def start(own: Posterior, settings: EnsembleSettings = SETTINGS) -> np.ndarray:
    rng = np.random.default_rng(3)
    swarm = rng.uniform(-1.0, 1.0, size=(20, 2))
    values = -own.log_prob(swarm) if own.parameters.size == 2 else np.arange(20.0)
    n = settings.ensembles * settings.walkers
    return start_positions(own, swarm, values, n, rng).reshape(settings.ensembles, settings.walkers, -1)


def run(store: Path | None = None, settings: EnsembleSettings = SETTINGS) -> EnsembleResult:
    own = posterior()
    return sample(own, start(own, settings), 7, settings, store=store)


def test_means_and_covariance_are_those_of_the_closed_form() -> None:
    found = run()
    mean, covariance = exact_gaussian(measurement(0.01))
    sd = np.sqrt(np.diag(covariance))
    # four Monte Carlo standard errors at the effective number of samples
    error = 4.0 / np.sqrt(found.diagnostics.ess_bulk)
    assert found.status == "converged"
    assert found.diagnostics.r_hat <= 1.01
    np.testing.assert_array_less(np.abs(found.draws.mean(axis=0) - mean) / sd, error)
    np.testing.assert_allclose(np.cov(found.draws.T), covariance, atol=error * 2 * sd.max() ** 2)


def test_optimum_and_covariance_of_a_linear_model_are_exact() -> None:
    mean, covariance = exact_gaussian(measurement(0.01))
    found = optimise(posterior(), np.array([1.0, 1.0]))
    np.testing.assert_allclose(found.optimum, mean, atol=2e-3 * np.sqrt(covariance.max()))
    # the picture adds the variance of the uniform priors, 4^2 / 12, which hardly counts here
    np.testing.assert_allclose(
        np.linalg.inv(found.covariance), np.linalg.inv(covariance) + 12 / 16 * np.eye(2), rtol=1e-8
    )


def test_a_collapsed_swarm_still_gives_walkers_that_span_the_posterior() -> None:
    own = posterior()
    swarm = np.tile([0.4, -0.3], (20, 1))
    found = start_positions(own, swarm, np.zeros(20), 60, np.random.default_rng(0))
    _, covariance = exact_gaussian(measurement(0.01))
    ratio = found.std(axis=0) / np.sqrt(np.diag(covariance))
    assert np.all((ratio > 0.6) & (ratio < 1.6))
    assert np.linalg.matrix_rank(found - found.mean(axis=0)) == 2


def test_infeasible_particles_start_nothing() -> None:
    own = posterior()
    never = np.full(20, np.inf)
    with pytest.raises(ValueError, match="chains cannot start: no particle"):
        start_positions(own, np.zeros((20, 2)), never, 8, np.random.default_rng(0))


def test_noise_that_is_inferred_is_started_from_the_residuals() -> None:
    own = posterior(None)
    walkers = start(own).reshape(-1, 3)
    assert np.all(np.isfinite(own.log_prob(walkers)))
    assert 1e-4 < np.median(walkers[:, 2]) < 0.05


def test_a_budget_ends_the_sampling_and_the_status_says_so() -> None:
    found = run(settings=replace(SETTINGS, most_steps=200))
    assert found.status == "budget"
    assert not found.diagnostics.converged
    assert found.diagnostics.steps == 200


def test_the_same_seed_gives_the_same_chain_bit_for_bit(tmp_path: Path) -> None:
    whole = run()
    np.testing.assert_array_equal(run(tmp_path / "store").chain, whole.chain)


@pytest.mark.parametrize("kept", [0, 1, 2])
def test_a_store_with_some_rounds_goes_on_bit_for_bit(tmp_path: Path, kept: int) -> None:
    whole = run(tmp_path)
    rounds = sorted(tmp_path.glob("round_*.h5"))
    assert len(rounds) > 2
    for path in rounds[kept:]:
        path.unlink()
    np.testing.assert_array_equal(run(tmp_path).chain, whole.chain)


def test_a_run_that_is_killed_goes_on_bit_for_bit(tmp_path: Path) -> None:
    script = (
        "import os, sys; from pathlib import Path; import tests.inference.test_ensemble as t\n"
        "from cpam_bayes.inference.ensemble import sample\n"
        "own = t.posterior(); rounds = []\n"
        "def die(diagnostics):\n"
        "    rounds.append(diagnostics)\n"
        "    if len(rounds) == 2: os.kill(os.getpid(), 9)\n"
        "sample(own, t.start(own), 7, t.SETTINGS, store=Path(sys.argv[1]), progress=die)\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    killed = subprocess.run(command, cwd=ROOT, check=False, capture_output=True)
    assert killed.returncode == -9, killed.stderr.decode()
    assert len(list(tmp_path.glob("round_*.h5"))) == 2
    np.testing.assert_array_equal(run(tmp_path).chain, run().chain)


def test_a_store_of_another_problem_is_refused_and_left_alone(tmp_path: Path) -> None:
    run(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    own = posterior(0.02)
    with pytest.raises(StoreError, match="holds another problem"):
        sample(own, start(own), 7, SETTINGS, store=tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


@pytest.mark.parametrize("content", [b"", b"no HDF5 at all", None], ids=["empty", "foreign", "truncated"])
def test_a_damaged_store_is_refused_with_its_name(tmp_path: Path, content: bytes | None) -> None:
    run(tmp_path)
    first = tmp_path / "round_0000.h5"
    first.write_bytes(first.read_bytes()[:500] if content is None else content)
    with pytest.raises(StoreError, match=r"round_0000\.h5: is damaged"):
        run(tmp_path)


def test_a_store_that_is_a_file_is_refused(tmp_path: Path) -> None:
    place = tmp_path / "file"
    place.write_text("")
    with pytest.raises(StoreError, match="cannot be made"):
        run(place)


FULL_DISK = """
import resource, sys
from pathlib import Path
import tests.inference.test_ensemble as t
from cpam_bayes.inference.ensemble import sample
own, rounds = t.posterior(), []
def fill(diagnostics):
    rounds.append(diagnostics)
    if len(rounds) == 2:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
found = sample(own, t.start(own), 7, t.SETTINGS, store=Path(sys.argv[1]), progress=fill)
print(found.status, len(rounds), found.chain.shape[1] + found.diagnostics.burn_in, found.not_stored)
"""


def test_on_a_full_disk_rounds_are_kept_sampling_goes_on_and_the_result_says_so(tmp_path: Path) -> None:
    whole = run()
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    status, rounds, steps, not_stored = done.stdout.strip().split(" ", 3)
    assert status == "converged"
    assert int(steps) == whole.diagnostics.steps == int(rounds) * SETTINGS.round_steps
    assert "round_0002.h5: cannot be written (File too large); 2 rounds before it are kept" in not_stored
    assert sorted(p.name for p in tmp_path.iterdir()) == ["round_0000.h5", "round_0001.h5"]
    # with room again the same problem goes on from there
    np.testing.assert_array_equal(run(tmp_path).chain, whole.chain)


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), RuntimeError("cannot close")])
def test_whatever_the_failure_of_a_write_nothing_sampled_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail(self: Path, target: Path) -> None:
        raise error

    monkeypatch.setattr(Path, "replace", fail)
    found = run(tmp_path)
    assert found.not_stored is not None
    assert "round_0000.h5: cannot be written" in found.not_stored
    assert list(tmp_path.iterdir()) == []
    np.testing.assert_array_equal(found.chain, run().chain)


def test_a_stored_run_says_nothing_of_the_store(tmp_path: Path) -> None:
    assert run(tmp_path).not_stored is None
