"""Evidence three ways: importance sampling, nested sampling, Laplace; and moments beside emcee's.

python studies/06_evidence.py [--quick]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import cpam_bayes as cb
from cpam_bayes.inference.ensemble import EnsembleResult, EnsembleSettings
from cpam_bayes.inference.laplace import approximate, find_optima
from cpam_bayes.inference.posterior import Posterior
from cpam_bayes.inference.proposal import AdaptationSettings
from cpam_bayes.inference.sampling import Evidence, EvidenceSettings, evidence_of, importance_evidence
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.render.report import Heading, Table
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.running import single_blas_thread
from validation.nested import NestedEvidence, nested_evidence
from validation.reporting import (
    study_main,
)

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "specimens": "one a plate: log evidence by method; mean and sd of each parameter by method; agreement",
}

PLATES = ("B1", "C1", "D1")
SEED = 0
# Differences in standard errors that count as agreement: of an evidence, and of the worst of some thirty
# means and standard deviations of a plate, one in thirty of which worsts lies beyond by chance.
EVIDENCE_AGREES, MOMENTS_AGREE = 3.0, 3.5


class Effort(NamedTuple):
    ensembles: EnsembleSettings
    swarm: SwarmSettings
    evidence: EvidenceSettings
    nested_runs: int
    live_points: int


FULL = Effort(EnsembleSettings(effective=4000.0), SwarmSettings(), EvidenceSettings(), 5, 200)
SMALL = Effort(
    EnsembleSettings(walkers=16, round_steps=300, effective=200.0, most_steps=600),
    SwarmSettings(particles=10, iterations=10),
    EvidenceSettings(draws=4000, adaptation=AdaptationSettings(rounds=3, draws=1000)),
    2,
    40,
)


@single_blas_thread
def run(quick: bool) -> dict[str, Any]:
    """All plates; quick: A1 with little effort."""
    plates, effort = (("A1",), SMALL) if quick else (PLATES, FULL)
    return {"quick": quick, "specimens": [_examined(name, effort) for name in plates]}


class Moments(NamedTuple):
    """Means and standard deviations of the parameters and their standard errors, (n,) each."""

    mean: np.ndarray
    sd: np.ndarray
    mean_error: np.ndarray
    sd_error: np.ndarray


def _examined(name: str, effort: Effort) -> dict[str, Any]:
    sampled = cb.sample(name, seed=SEED, settings=effort.ensembles, swarm_settings=effort.swarm)
    posterior, chains = sampled.posterior, sampled.result
    none = np.empty((0, posterior.parameters.size))
    alone, alone_seconds = _timed(
        lambda: importance_evidence(posterior, none, SEED, settings=effort.evidence)
    )
    from_chains, from_chains_seconds = _timed(
        lambda: evidence_of(posterior, chains, SEED, settings=effort.evidence)
    )
    nested, nested_seconds = _timed(
        lambda: nested_evidence(posterior, SEED, runs=effort.nested_runs, live_points=effort.live_points)
    )
    moments = {
        "importance": _weighted(alone),
        "emcee": _of_chains(chains),
        "nested": Moments(nested.mean, nested.sd, nested.mean_error, nested.sd_error),
    }
    difference = alone.log_evidence - nested.log_evidence
    evidence_z = float(difference / np.hypot(alone.standard_error, nested.standard_error))
    worst_z = _worst(moments)
    return {
        "plate": name,
        "log_evidence": {
            "importance": _value(alone, alone_seconds),
            "importance from chains": _value(from_chains, from_chains_seconds),
            "nested": _nested(nested, nested_seconds),
            **_laplace(posterior),
        },
        "emcee": {
            "effective": chains.diagnostics.ess_bulk,
            "r_hat": chains.diagnostics.r_hat,
            "status": chains.status,
            "seconds": sampled.seconds_sampling,
        },
        "parameters": [_parameter(posterior, i, moments) for i in range(posterior.parameters.size)],
        "evidence_z": evidence_z,
        "worst_z": worst_z,
        "agrees": abs(evidence_z) <= EVIDENCE_AGREES and worst_z <= MOMENTS_AGREE,
    }


def _timed(work: Any) -> tuple[Any, float]:
    begin = time.perf_counter()
    found = work()
    return found, time.perf_counter() - begin


def _value(found: Evidence, seconds: float) -> dict[str, Any]:
    return {
        "value": found.log_evidence,
        "error": found.standard_error,
        "effective": found.effective_size,
        "k_hat": found.k_hat,
        "status": found.status,
        "solves": found.solves,
        "seconds": seconds,
    }


def _nested(found: NestedEvidence, seconds: float) -> dict[str, Any]:
    return {
        "value": found.log_evidence,
        "error": found.standard_error,
        "solves": found.calls,
        "seconds": seconds,
    }


def _laplace(posterior: Posterior) -> dict[str, Any]:
    """Sums over the optima of the Gaussian approximations with either Hessian and of the Student-t's."""
    none = np.empty((0, posterior.parameters.size))
    optima = find_optima(posterior, none, np.random.default_rng(SEED))
    kinds = {
        "Laplace, Gauss-Newton": ("gauss-newton", np.inf),
        "Laplace, exact Hessian": ("exact", np.inf),
        "Laplace, Student-t": ("exact", 5.0),
    }
    found = {}
    for kind, (hessian, freedom) in kinds.items():
        each = [approximate(posterior, o, hessian, freedom).log_evidence for o in optima]
        found[kind] = {"value": float(np.logaddexp.reduce(each)), "optima": len(optima)}
    return found


def _weighted(found: Evidence) -> Moments:
    weights = np.exp(found.log_weights)[:, None]
    away = found.draws - found.mean
    mean_error = np.sqrt(np.sum((weights * away) ** 2, axis=0))
    sd_error = np.sqrt(np.sum((weights * (away**2 - found.sd**2)) ** 2, axis=0)) / (2 * found.sd)
    return Moments(found.mean, found.sd, mean_error, sd_error)


def _of_chains(result: EnsembleResult) -> Moments:
    draws, effective = result.draws, result.diagnostics.ess_bulk
    mean, sd = draws.mean(axis=0), draws.std(axis=0)
    kurtosis = np.mean(((draws - mean) / sd) ** 4, axis=0)
    return Moments(mean, sd, sd / np.sqrt(effective), sd * np.sqrt((kurtosis - 1) / (4 * effective)))


def _parameter(posterior: Posterior, i: int, moments: dict[str, Moments]) -> dict[str, Any]:
    name = posterior.parameters.names[i]
    return {
        "name": user_name(name),
        **{
            method: {
                "mean": to_user(name, float(m.mean[i])),
                "sd": to_user(name, float(m.sd[i])),
                "mean_error": to_user(name, float(m.mean_error[i])),
                "sd_error": to_user(name, float(m.sd_error[i])),
            }
            for method, m in moments.items()
        },
    }


def _worst(moments: dict[str, Moments]) -> float:
    """Largest difference of a mean or an sd between two methods, in combined standard errors."""
    return max(
        float(np.max(np.abs(a - b) / np.hypot(its, others)))
        for one, other in combinations(moments.values(), 2)
        for a, b, its, others in (
            (one.mean, other.mean, one.mean_error, other.mean_error),
            (one.sd, other.sd, one.sd_error, other.sd_error),
        )
    )


# Output


def show(results: dict[str, Any]) -> None:
    """Print the results as tables."""
    evidence = ("plate", "method", "log evidence", "error", "effective", "k-hat", "solves", "s")
    moments = ("plate", "parameter", "method", "mean", "error", "sd", "error of sd")
    agreement = ("plate", "evidence, z", "moments, worst z", "agrees")
    specimens = results["specimens"]
    tables = (
        Table(f"Log evidence, seed {SEED}", _columns(evidence), _evidence_rows(specimens)),
        Table("Means and standard deviations", _columns(moments), _moment_rows(specimens)),
        Table("Agreement", _columns(agreement), _agreement_rows(specimens)),
    )
    print(screen_text(tables, sys.stdout))


_TEXT = {"plate", "method", "parameter", "agrees"}
Rows = tuple[tuple[str, ...], ...]


def _columns(headings: Sequence[str]) -> tuple[Heading, ...]:
    return tuple(Heading(heading, heading not in _TEXT) for heading in headings)


def _evidence_rows(specimens: list[dict[str, Any]]) -> Rows:
    forms = {"error": ".3f", "effective": ".0f", "k_hat": ".2f", "solves": "d", "seconds": ".1f"}
    return tuple(
        (
            s["plate"],
            method,
            f"{e['value']:.3f}",
            *(format(e[key], form) if key in e else "-" for key, form in forms.items()),
        )
        for s in specimens
        for method, e in s["log_evidence"].items()
    )


def _moment_rows(specimens: list[dict[str, Any]]) -> Rows:
    return tuple(
        (
            s["plate"],
            p["name"],
            method,
            *(f"{p[method][key]:.4g}" for key in ("mean", "mean_error", "sd", "sd_error")),
        )
        for s in specimens
        for p in s["parameters"]
        for method in ("importance", "emcee", "nested")
    )


def _agreement_rows(specimens: list[dict[str, Any]]) -> Rows:
    return tuple(
        (s["plate"], f"{s['evidence_z']:+.1f}", f"{s['worst_z']:.1f}", "yes" if s["agrees"] else "NO")
        for s in specimens
    )


def main() -> None:
    study_main(__doc__, run, show, RESULTS)


if __name__ == "__main__":
    main()
