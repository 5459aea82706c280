"""emcee on this package's log probability beside emcee on a short one written with scikit-fem.

python -m benchmarks.samplers [--quick] [--rounds N] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cpam_bayes as cb
from benchmarks.plain_likelihood import Frequencies, plain_frequencies
from benchmarks.targets import Target
from benchmarks.timing import busy_processes, interleaved, ratio
from cpam_bayes.forward_model.build import forget_models
from cpam_bayes.inference.ensemble import DEFAULT_SETTINGS, integrated_times, moves_of
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.sampling import JUMPS as FIT
from cpam_bayes.inference.sampling import sample_posterior, sampled_about
from cpam_bayes.render.report import Heading, Table, remarks
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]
Results = dict[str, Any]
LogProb = Callable[[Array], Any]
# A sampler and its moves; the moves by name, as arguments of emcee.
Key = tuple[str, str]
Moves = dict[str, Any]

PLATE = "C1"
MESH, QUICK_MESH = 8, 2
# Required ratio of effective samples per second to the plain likelihood.
_REACH = 500.0
# Time limits for a converged posterior of a thin and a thick specimen, models included, s.
_CONVERGED = {"C1": 20.0, "D1": 40.0}
# The package's moves, its local ones alone, and emcee's default.
JUMPS, DE, STRETCH = "jumps and DE", "DE", "stretch"
# Steps of the chains for the autocorrelation times.
_STEPS = {JUMPS: 2000, DE: 4000, STRETCH: 4000}
_QUICK_STEPS = 300
OURS, OURS_MANY = "ours", "ours, many walkers"
# Larger stacks cost less per walker.
_MANY, _QUICK_MANY = 200, 24
ASSEMBLING, SUMMING = "scikit-fem, assembled at a call", "scikit-fem, summed at a call"
# Steps in one repetition; many, because they are fast.
_OUR_STEPS = 40


@dataclass(frozen=True, slots=True)
class Entry:
    """One log probability under one move."""

    sampler: str
    moves: str
    walkers: int
    log_prob: LogProb
    steps: int

    @property
    def key(self) -> Key:
        return self.sampler, self.moves

    @property
    def is_ours(self) -> bool:
        return self.sampler in (OURS, OURS_MANY)


@single_blas_thread
def run(quick: bool = False, rounds: int | None = None) -> Results:
    """Time the steps of all samplers in turn; benchmarks/README.md says what the keys of the results mean."""
    rounds = rounds or (2 if quick else 9)
    mesh = QUICK_MESH if quick else MESH
    walkers, many = (12, _QUICK_MANY) if quick else (DEFAULT_SETTINGS.walkers, _MANY)
    load = [busy_processes()]
    posterior = cb.posterior(cb.read_plate(PLATE).with_exact_sizes())
    settings = replace(DEFAULT_SETTINGS, walkers=walkers, most_steps=400 if quick else 2000)
    found = sample_posterior(posterior, 0, settings=settings)
    draws = found.draws
    best = draws[np.argmax(found.log_prob)]
    used = time.process_time()
    proposal = sampled_about(posterior, best[None], FIT)[0]
    used = time.process_time() - used
    moves = {JUMPS: moves_of(proposal, settings.jumps), DE: moves_of(None, settings.jumps), STRETCH: None}
    entries = _entries(posterior, mesh, walkers, many)
    starts = {e.walkers: _spread(draws, e.walkers) for e in entries}
    tau: dict[tuple[str, int], float] = {}
    for name, n in dict.fromkeys((e.moves, e.walkers) for e in entries):
        steps = _QUICK_STEPS if quick else _STEPS[name]
        tau[name, n] = _autocorrelation_time(posterior, starts[n], moves[name], steps)
    timed = interleaved(
        {e.key: _steps(e, moves[e.moves], starts[e.walkers]) for e in entries},
        rounds,
        budget=2.0 if quick else 60.0,
        clock=time.process_time,
    )
    # seconds per effective sample
    cost = {e.key: timed[e.key] / e.steps / e.walkers * tau[e.moves, e.walkers] for e in entries}
    rows = [_row(e, timed[e.key], cost, tau[e.moves, e.walkers]) for e in entries]
    few = _spread(draws, 6 if quick else 30)
    theirs = {e.sampler: e.log_prob for e in entries if not e.is_ours}
    converged = [] if quick else [_converged(name) for name in _CONVERGED]
    return {
        "quick": quick,
        "plate": PLATE,
        "mesh": mesh,
        "walkers": walkers,
        "rounds": rounds,
        "load": [*load, busy_processes()],
        "fit": {"solves": proposal.solves, "processor_seconds": used},
        "agreement": [_agreement(name, f, posterior, few) for name, f in theirs.items()],
        "rows": rows,
        "converged": converged,
        "targets": [] if quick else [asdict(t) | {"reached": t.reached} for t in _targets(cost, converged)],
    }


def _entries(posterior: Posterior, mesh: int, walkers: int, many: int) -> list[Entry]:
    plain = plain_frequencies(cb.read_plate(PLATE), posterior.measurement.size, mesh)
    theirs = {n: _plain_log_prob(posterior, f) for n, f in zip((ASSEMBLING, SUMMING), plain, strict=True)}
    return [
        *(
            Entry(sampler, moves, n, posterior.log_prob, _OUR_STEPS)
            for sampler, n in ((OURS, walkers), (OURS_MANY, many))
            for moves in (JUMPS, DE, STRETCH)
        ),
        *(Entry(name, moves, walkers, f, 1) for name, f in theirs.items() for moves in (STRETCH, DE)),
    ]


def _spread(draws: Array, n: int) -> Array:
    """Draws spread evenly over the chains, (n, n_parameters)."""
    return np.asarray(draws[np.linspace(0, len(draws) - 1, n).astype(int)])


def _plain_log_prob(posterior: Posterior, frequencies: Frequencies) -> LogProb:
    """Log posterior of one parameter vector: Gaussian likelihood, with the priors of the posterior."""
    own, names = posterior.measurement, posterior.model.parameters.names
    listed = own.frequencies

    def log_prob(x: Array) -> float:
        prior = float(posterior.log_prior(x[None])[0])
        if not np.isfinite(prior):
            return -np.inf
        predicted = frequencies(dict(zip(names, x[:-1], strict=True)))
        variance = (x[-1] * listed) ** 2 + own.resolution**2 / 12
        return prior - 0.5 * float(
            np.sum((listed - predicted) ** 2 / variance + np.log(2 * np.pi * variance))
        )

    return log_prob


def _sampler(log_prob: LogProb, moves: Any, walkers: int, n: int, vectorize: bool) -> Any:
    import emcee

    sampler = emcee.EnsembleSampler(walkers, n, log_prob, moves=moves, vectorize=vectorize)
    sampler.random_state = np.random.RandomState(0).get_state()
    return sampler


def _steps(entry: Entry, moves: Any, start: Array) -> Callable[[], None]:
    """A call that advances a sampler by the entry's number of steps."""
    sampler = _sampler(entry.log_prob, moves, *start.shape, entry.is_ours)
    state: list[Any] = [start]

    def go_on() -> None:
        state[0] = sampler.run_mcmc(state[0], entry.steps, skip_initial_state_check=True)
        sampler.reset()

    return go_on


def _autocorrelation_time(posterior: Posterior, start: Array, moves: Any, steps: int) -> float:
    """Autocorrelation time of the slowest parameter, in steps, from a chain on our log probability.

    It depends on the posterior, the moves and the number of walkers, not on who computes the density.
    """
    sampler = _sampler(posterior.log_prob, moves, *start.shape, True)
    sampler.run_mcmc(start, steps, skip_initial_state_check=True)
    return float(np.max(integrated_times(sampler.get_chain())))


def _row(entry: Entry, times: Array, cost: dict[Key, Array], tau: float) -> Results:
    to_ours = ratio(cost[entry.key], cost[OURS, JUMPS])
    return {
        "sampler": entry.sampler,
        "moves": entry.moves,
        "walkers": entry.walkers,
        "rounds": int(np.isfinite(times).sum()),
        "evaluation_s": float(np.nanmedian(times)) / entry.steps / entry.walkers,
        "autocorrelation_time": tau,
        "effective_per_s": float(1.0 / np.nanmedian(cost[entry.key])),
        "ratio": to_ours.median,
        "ratio_quartiles": [to_ours.low, to_ours.high],
    }


def _agreement(name: str, log_prob: LogProb, posterior: Posterior, draws: Array) -> Results:
    """Largest difference of two log probabilities over draws, up to a constant."""
    difference = np.array([log_prob(x) for x in draws]) - posterior.log_prob(draws)
    return {
        "sampler": name,
        "draws": len(draws),
        "largest_difference": float(np.abs(difference - difference.mean()).max()),
    }


def _converged(name: str) -> Results:
    """Run an identification to a converged posterior, its models built afresh."""
    forget_models()
    start, used = time.perf_counter(), time.process_time()
    found = cb.sample(name).result
    seconds, processor = time.perf_counter() - start, time.process_time() - used
    own = found.diagnostics
    return {
        "plate": name,
        "status": found.status,
        "seconds": seconds,
        "processor_seconds": processor,
        "r_hat": own.r_hat,
        "ess_bulk": own.ess_bulk,
        "effective_per_s": own.ess_bulk / seconds,
        "effective_per_processor_s": own.ess_bulk / processor,
    }


def _targets(cost: dict[Key, Array], converged: list[Results]) -> list[Target]:
    found = [
        Target(
            case=PLATE,
            what=f"effective samples a second, {ours}",
            unit="times",
            found=ratio(cost[theirs, moves], cost[ours, JUMPS]).median,
            # a user's page as it would be: emcee's default moves
            reach=_REACH if moves == STRETCH else None,
            at_least=True,
            against=f"{theirs}, {moves} moves",
        )
        for ours in (OURS, OURS_MANY)
        for theirs in (ASSEMBLING, SUMMING)
        for moves in (STRETCH, DE)
    ]
    for one in converged:
        seconds = one["processor_seconds"]
        reach = _CONVERGED[one["plate"]] if one["status"] == "converged" else None
        found.append(Target(one["plate"], "converged posterior, processor's time", "s", seconds, reach))
    return found


def tables(results: Results) -> tuple[Table, ...]:
    """Tables of the results of ``run``."""
    rows = tuple(
        (
            row["sampler"],
            row["moves"],
            str(row["walkers"]),
            f"{1e3 * row['evaluation_s']:.3g}",
            f"{row['autocorrelation_time']:.0f}",
            f"{row['effective_per_s']:.3g}",
            f"{row['ratio']:.3g}",
            "{:.3g} to {:.3g}".format(*row["ratio_quartiles"]),
        )
        for row in results["rows"]
    )
    headings = ("walkers", "evaluation, ms", "autocorrelation", "effective/s", "times ours", "quartiles")
    columns = (
        Heading("log probability"),
        Heading("moves"),
        *(Heading(heading, True) for heading in headings),
    )
    title = f"emcee on {results['plate']}, processor's time, medians of {results['rounds']} rounds"
    agreement = tuple(
        f"{a['sampler']}: log probabilities differ by at most {a['largest_difference']:.2g} over "
        f"{a['draws']} draws, {results['mesh']} x {results['mesh']} elements"
        for a in results["agreement"]
    )
    fit = "{solves} forward solves, {processor_seconds:.2f} s of the processor".format(**results["fit"])
    converged = tuple(
        f"{c['plate']}: {c['status']} in {c['seconds']:.1f} s ({c['processor_seconds']:.1f} s of the "
        f"processor), R-hat {c['r_hat']:.4f}, {c['ess_bulk']:.0f} effective samples, "
        f"{c['effective_per_processor_s']:.0f} a second of the processor"
        for c in results["converged"]
    )
    targets = tuple(
        f"{t['case']}, {t['what']}: {t['found']:.3g} {t['unit']}"
        + (f" against {t['against']}" if t["against"] else "")
        + (f" ({'reaches' if t['reached'] else 'misses'} {t['reach']:g})" if t["reach"] else "")
        for t in results["targets"]
    )
    return (
        Table(title, columns, rows),
        remarks("Same posterior", agreement),
        remarks("Fit of the proposal, once before the chains and not in the table", (fit,)),
        remarks("Converged posteriors, models built in them", converged),
        remarks("Figures to reach", targets),
    )


def main() -> None:
    """Run the benchmark, print its tables and save its results if asked."""
    parser = argparse.ArgumentParser(description="Time emcee on our log probability and on a plain one.")
    parser.add_argument("--quick", action="store_true", help="a coarse mesh and few steps: does it run")
    parser.add_argument("--rounds", type=int, help="repetitions of every sampler, 9 if left out")
    parser.add_argument("--json", type=Path, metavar="FILE", help="save the results")
    given = parser.parse_args()
    results = run(given.quick, given.rounds)
    print(screen_text(tables(results), sys.stdout))
    if given.json is not None:
        given.json.parent.mkdir(parents=True, exist_ok=True)
        given.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
