"""Trials of the diagnosis: something is hidden in a simulated list, and the answer is compared with it."""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from cpam_bayes.diagnosis.cases import hypotheses_of
from cpam_bayes.diagnosis.composed import ComposedModel
from cpam_bayes.diagnosis.diagnose import Diagnosis, diagnose_cases
from cpam_bayes.diagnosis.evidence.weighing import Tested
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, causes_in
from cpam_bayes.validation.diagnosis.hiding import Hidden, Trial, hide
from cpam_bayes.validation.diagnosis.oracle import oracle
from cpam_bayes.validation.diagnosis.truths import Bench, Reached

__all__ = ["Record", "Trial", "is_right", "run_trial"]

Array = NDArray[Any]
Record = dict[str, Any]

# Draws that further modes are predicted with, and how often they are measured.
_DRAWS, _REPEATED = 256, 64
# Causes that are kept in a record.
_LISTED = 8


def run_trial(bench: Bench, trial: Trial) -> Record:
    """A trial's record: truth, answer and what it is measured by.

    "reached" is false where the cause cannot be hidden with the ratio; then "most_ratio" and "share" say why.
    """
    start = time.perf_counter()
    rng = trial.rng(bench)
    hidden = hide(bench, trial, rng)
    head: Record = {"trial": asdict(trial)}
    if isinstance(hidden, Reached):
        return head | {"reached": False, "most_ratio": hidden.most, "share": hidden.share}
    known = oracle(hidden.at, hidden.shift, hidden.noise)
    names = tuple(h.cause for h in hidden.causes)
    alike = (known.alike | set(names)) if len(names) == 1 else frozenset(names)
    case = hidden.own.measured(hidden.listed, hidden.noise)
    hypotheses = hypotheses_of([case])
    if trial.lacks:  # a list that says which mode it lacks lacks no other
        hypotheses = [(h, plates) for h, plates in hypotheses if not h.listed.missed]
    if trial.kind == "outside":
        hypotheses = [(h, plates) for h, plates in hypotheses if h.cause not in alike]
    simulated = time.perf_counter()
    processor = time.process_time()
    diagnosis = diagnose_cases([case], hypotheses=hypotheses, gain=False, power=False)
    best = next((c for c in known.probability if c not in (NONE, OTHER)), NONE)
    return head | {
        "reached": True,
        "causes": list(names),
        "variants": [h.variant for h in hidden.causes],
        "sizes": hidden.sizes.tolist(),
        "alike": sorted(alike),
        "oracle": {
            "best": best,
            # what reorders the list is not in its dictionary
            "right": best in alike if hidden.shift.any() else None,
            "none": known.probability.get(NONE, 0.0),
            "class": sum(p for c, p in known.probability.items() if c in alike),
        },
        "answer": _answer(diagnosis),
        "said_alike": _said(diagnosis, names, alike) if len(names) == 1 else None,
        "constants": _constants(hidden, diagnosis),
        "further": _further(hidden, diagnosis),
        "seconds": time.perf_counter() - simulated,
        "processor_seconds": time.process_time() - processor,
        "simulation_seconds": simulated - start,
    }


def _answer(diagnosis: Diagnosis) -> Record:
    ranked = [c for c in diagnosis.causes if c.name not in (NONE, OTHER)]
    singles = [c for c in ranked if len(causes_in(c.name)) == 1]
    by_name = {c.name: c.probability for c in diagnosis.causes}
    # the class of each cause that leads its own class, with the class's probability
    classes = []
    for c in singles:
        members = [c.name, *(m for m in c.indistinguishable_from if len(causes_in(m)) == 1)]
        if by_name[c.name] >= max(by_name[m] for m in members):
            classes.append((sum(by_name[m] for m in members), members))
    probability, members = max(classes, key=lambda k: k[0]) if classes else (0.0, [])
    pair = next((c for c in ranked if len(causes_in(c.name)) > 1), None)
    return {
        "claim": diagnosis.claim.kind,
        "claimed": list(diagnosis.claim.causes),
        "claim_probability": diagnosis.claim.probability,
        "none": by_name[NONE],
        "other": by_name[OTHER],
        "class": members,
        "class_probability": probability,
        "pair": list(causes_in(pair.name)) if pair else [],
        "pair_probability": pair.probability if pair else 0.0,
        "causes": [[c.name, c.variant, c.probability, c.log_bayes_factor] for c in ranked[:_LISTED]],
        "tested": len(diagnosis.weighed.tested),
    }


def _said(diagnosis: Diagnosis, names: Sequence[str], alike: frozenset[str]) -> list[list[Any]]:
    """For every cause like the truth whether the diagnosis says that they cannot be distinguished."""
    said = {c.name: set(c.indistinguishable_from) for c in diagnosis.causes}
    truth = names[0]
    if truth not in said:
        return []
    return [[c, c in said[truth]] for c in sorted(alike - {truth}) if c in said]


def _extension(diagnosis: Diagnosis) -> tuple[tuple[Tested, float], ...]:
    """What the leading class of causes, claimed or not, would extend the model by."""
    if diagnosis.members:
        return diagnosis.members
    leading = next((t for t in diagnosis.weighed.tested if t.hypothesis.cause not in (NONE, OTHER)), None)
    return ((leading, 1.0),) if leading is not None else ()


def _constants(hidden: Hidden, diagnosis: Diagnosis) -> list[list[Any]]:
    """By constant: name, truth, mean, sd, 2.5 and 97.5 % quantile, and the sd of its prior.

    The model is the extended one, or the plain one where nothing is claimed.
    """
    parameters = hidden.at.own.case.models.parameters
    fit = diagnosis.extended or diagnosis.baseline
    rows = []
    for p, truth in zip(parameters.parameters, hidden.at.x, strict=True):
        if p.name in fit.constants:
            rows.append([p.name, float(truth), *fit.constants[p.name], float(p.prior.sd)])
    return rows


def _further(hidden: Hidden, diagnosis: Diagnosis) -> Record | None:
    """Log predictive densities of modes beyond the list, by the plain and by the extended model.

    They are means over repeated measurements of these modes.
    """
    if any(h.listed.missed for h in hidden.causes) or not np.array_equal(
        hidden.own.case.modes, np.arange(hidden.own.n_listed)
    ):
        return None  # they are in the list
    rng = np.random.default_rng(zlib.crc32(hidden.listed.tobytes()))
    noise = rng.standard_normal((_REPEATED, len(hidden.further)))
    measured = hidden.further * np.exp(hidden.own.noise * noise)
    plain = _log_score(hidden.own, [(diagnosis.weighed.none, 1.0)], measured)
    members = _extension(diagnosis)
    return {
        "plain": plain,
        "extended": _log_score(hidden.own, members, measured) if members else plain,
        "claimed": bool(diagnosis.members),
    }


def _log_score(bench: Bench, members: Sequence[tuple[Tested, float]], measured: Array) -> float:
    """Mean log density of further frequencies (m, k) under a mixture of fitted hypotheses, per Hz each."""
    beyond = bench.n_listed + np.arange(measured.shape[1])
    terms = []
    for t, weight in members:
        comparison = t.marginal.comparison
        parts = tuple(replace(part, modes=beyond, misread=None) for part in comparison.model.parts)
        x = t.marginal.resampled(_DRAWS)
        f = ComposedModel(comparison.model.parameters, parts).predict(x).frequencies
        error = bench.case.models.error[np.minimum(beyond, len(bench.case.models.error) - 1)]
        variance = (bench.noise**2 + error**2) * f**2 + bench.case.measurement.resolution**2 / 12
        if comparison.discrepancy is not None:
            variance = variance + (x[:, comparison.discrepancy, None] * f) ** 2
        squared = (measured[:, None] - f) ** 2 / variance
        density = -0.5 * np.sum(squared + np.log(2 * np.pi * variance), axis=2)
        terms.append(np.log(weight) + logsumexp(density, axis=1) - np.log(len(x)))
    return float(np.mean(logsumexp(terms, axis=0)))


def is_right(record: Record) -> bool:
    """Whether the leading class of causes is that of the truth."""
    return bool(set(record["answer"]["class"][:1]) & set(record["alike"]))
