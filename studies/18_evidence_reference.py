"""Are the marginal likelihoods of the diagnosis those of a slow and independent reference?

python studies/18_evidence_reference.py [--quick] [--cases N] [--minutes M]

Lists are drawn from the Ritz models themselves: it is the integral that is tested. Each has a cause of the
catalogue or none, with a size from its prior or at signal to noise 4 to 100. None, the true hypothesis and
two others chosen at random are weighed as the diagnosis does and by the reference of
studies/validation/evidence_reference.py. Runs go on from the saved cases, --minutes ends one early.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import SCATTER, PlateCase, comparison_of
from cpam_bayes.diagnosis.evidence.marginal import Tested
from cpam_bayes.diagnosis.evidence.weighing import weigh
from cpam_bayes.diagnosis.hypotheses import NONE, OTHER, Hypothesis
from cpam_bayes.inference.derivatives import NormalScores
from cpam_bayes.inference.log_density import LogDensity
from cpam_bayes.plate import Measurement, Specimen, builtin, read_plate
from validation.evidence_reference import ReferenceSettings, reference_evidence
from validation.reporting import case_by_case

Array = NDArray[Any]
Results = dict[str, Any]

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"
CLAMPED = Path(__file__).parent / "data" / "bricks" / "clean_clamped.toml"

KEYS = {
    "quick": "whether this is the small version",
    "summary": "hypotheses compared near the best and far from it, and how far both ways differ",
    "cases": "one each: plate, modes, noise, what is hidden, hypotheses with both log evidences",
}

SEED = 0
NOISE, RESOLUTION_HZ = 0.002, 0.1
# Plates with the frequencies that their models have, whether [material.sd] is kept, and list lengths.
PLATES = (("C1", 10, True, (6, 10)), ("C1", 10, False, (6, 10)), ("clamped", 12, False, (6, 10, 12)))
CASES, QUICK_CASES = 200, 2
SIGNALS = (4.0, 8.0, 16.0, 32.0, 100.0)
# A hypothesis this far below the best is hopeless: the quick way may only be too low there.
NEAR_NATS = 8.0
AGREED_NATS = 0.3
# This far below the best the reference goes about the joint optima only.
HOPELESS_NATS = 30.0
# The grid and the draws of the reference here, and in the small version.
SETTINGS = ReferenceSettings(draws=768, nodes=61, log2_points=(11, 14))
QUICK = ReferenceSettings(draws=512, nodes=41, log2_points=(11, 13))


@cache
def plate(name: str, n: int, with_sd: bool) -> PlateCase:
    """A plate with a list that stands in for those to be drawn."""
    specimen: Specimen = read_plate(CLAMPED) if name == "clamped" else builtin(name)
    if not with_sd:
        specimen = replace(specimen, material=replace(specimen.material, sd={}))
    return plate_case(replace(specimen, measurement=a_list(np.arange(1.0, n + 1.0), stated=True)))


def a_list(frequencies: Array, *, stated: bool) -> Measurement:
    """A complete list, its noise stated or left out."""
    labels = ("",) * len(frequencies)
    f = np.sort(np.round(frequencies / RESOLUTION_HZ) * RESOLUTION_HZ)
    return Measurement(f, RESOLUTION_HZ, NOISE if stated else None, None, labels, complete=True)


def with_frequencies(case: PlateCase, f: Array, *, stated: bool) -> PlateCase:
    """The plate with a list of its lowest frequencies."""
    return replace(case, measurement=a_list(f, stated=stated), modes=np.arange(len(f)))


def drawn(case: PlateCase, n: int, rng: np.random.Generator) -> tuple[Hypothesis, float, str, Array]:
    """What is hidden, its size, how large it was meant to be, and the frequencies without noise, (n,)."""
    case = with_frequencies(case, np.arange(1.0, n + 1.0), stated=True)
    singles = [h for h, _ in hypotheses_of([case])]
    causes = sorted({h.cause for h in singles})
    while True:
        cause = causes[int(rng.integers(len(causes)))]
        variants = [h for h in singles if h.cause == cause]
        h = variants[int(rng.integers(len(variants)))]
        own = at_random_place(h, rng)
        comparison = comparison_of([case], own)
        x = comparison.scores.to_x(rng.standard_normal((1, comparison.parameters.size)))
        if not comparison.model.admissible(x)[0]:
            continue
        size, meant = 0.0, "prior"
        if own.parameters:
            column = comparison.parameters.names.index(own.parameters[0].name)
            signal = rng.choice((0.0, *SIGNALS))
            if signal and cause != OTHER and len(own.parameters) == 1:
                prior = own.parameters[0].prior
                side = 1.0 if prior.lower >= 0.0 else float(rng.choice((-1.0, 1.0)))
                most = prior.upper if side > 0.0 else prior.lower
                reached = size_for(case, comparison, x[0], column, most, float(signal))
                if reached is not None:
                    x[0, column], meant = reached, f"signal to noise {signal:g}"
            size = float(x[0, column])
        if not comparison.model.admissible(x)[0]:
            continue
        f = comparison.predict(x)[0][0]
        if cause == OTHER:
            alike = comparison.listed.correlation(own.correlation_length)
            f = f * np.exp(size * np.linalg.cholesky(alike) @ rng.standard_normal(n))
        if h.listed.spurious is not None:  # the model has the others: a false peak lies anywhere among them
            f = np.sort(np.append(f, rng.uniform(0.7 * f[0], f[-1])))
        return h, size, meant, f


def at_random_place(h: Hypothesis, rng: np.random.Generator) -> Hypothesis:
    """A hypothesis with its effect at a place drawn from its prior; itself where it has none."""
    if not h.effects or not h.effects[0].is_anywhere:
        return h
    effect = h.effects[0]
    fixed = effect.fixed({p.name: p.prior.sample(rng, 1)[0] for p in effect.coordinates})
    return replace(h, effects=(fixed,), parameters=fixed.parameters, variant=fixed.variant)


def size_for(
    case: PlateCase, comparison: LogDensity, x: Array, column: int, most: float, signal: float
) -> float | None:
    """The smallest size with a signal to noise; None where it is not reached by ``most``.

    The signal is the shift of ln f less what the constants imitate within their priors.
    x : (n,) parameters; column : of the size.
    """
    scores = NormalScores(case.models.parameters)
    constants = x[None, : case.models.parameters.size]
    plain = case.models.bare.predict(constants, jacobian=True)
    assert plain.jacobian is not None
    z = scores.to_z(constants)
    slope = plain.jacobian[0] / plain.frequencies[0][:, None] * scores.slope(scores.to_x(z), z)[0]
    a = slope[case.modes] / NOISE
    values, vectors = np.linalg.eigh(np.eye(len(a)) + a @ a.T)
    # effects of second order grow as squares
    sizes = most * np.linspace(0.0, 1.0, 97) ** 2
    at = np.tile(x, (len(sizes), 1))
    at[:, column] = sizes
    shift = np.log(comparison.predict(at)[0] / plain.frequencies[0][case.modes]) / NOISE
    highest = np.maximum.accumulate(np.linalg.norm(shift @ vectors / np.sqrt(values), axis=1))
    if highest[-1] < signal:
        return None
    i = int(np.argmax(highest >= signal))
    part = (signal - highest[i - 1]) / (highest[i] - highest[i - 1])
    return float(sizes[i - 1] + part * (sizes[i] - sizes[i - 1]))


def weighed(case: PlateCase, chosen: list[Hypothesis]) -> list[Tested]:
    """Hypotheses, none first, as the diagnosis weighs them."""
    every = [(h, (0,)) for h in chosen]
    return list(weigh([case], every, scatter=SCATTER, pairs=False).tested)


def run_case(number: int, *, quick: bool) -> Results:
    """One list, weighed both ways."""
    rng = np.random.default_rng([SEED, number])
    name, most, with_sd, lengths = PLATES[number % len(PLATES)]
    n, stated = int(rng.choice(lengths)), bool(rng.random() < 0.5)
    case = plate(name, most, with_sd)
    hidden, size, meant, f = drawn(case, n, rng)
    case = with_frequencies(case, f * (1.0 + NOISE * rng.standard_normal(n)), stated=stated)
    singles = [h for h, _ in hypotheses_of([case])]
    others = [h for h in singles if h.cause not in (NONE, hidden.cause)]
    causes = sorted({h.cause for h in others})
    chosen = [singles[0]] + ([hidden] if hidden.cause != NONE else [])
    for cause in rng.choice(causes, size=2, replace=False):
        variants = [h for h in others if h.cause == cause]
        chosen.append(variants[int(rng.integers(len(variants)))])
    begin = time.process_time()
    tested = weighed(case, chosen)
    fast = time.process_time() - begin
    rows, begin, best = [], time.process_time(), -np.inf
    settings = QUICK if quick else SETTINGS
    for t in tested:
        marginal, least = t.marginal, best - HOPELESS_NATS
        slow = reference_evidence(marginal.comparison, marginal.sizes, number, settings, hopeless=least)
        best = max(best, slow.log_evidence)
        rows.append(
            {
                "cause": t.hypothesis.cause,
                "variant": t.hypothesis.variant,
                "fast": round(marginal.log_evidence, 4),
                "slow": round(slow.log_evidence, 4),
                "slow_error": round(slow.error, 4),
                "slow_k_hat": round(min(slow.k_hat, 99.0), 2),
                "optima": slow.optima,
                "log_prior": round(float(np.log(t.hypothesis.prior)), 3),
                "sampled": marginal.is_sampled,
            }
        )
    return {
        "case": number,
        "plate": name,
        "sd": with_sd,
        "modes": n,
        "noise_stated": stated,
        "hidden": hidden.cause,
        "variant": hidden.variant,
        "size": size,
        "meant": meant,
        "seconds_fast": round(fast, 2),
        "seconds_slow": round(time.process_time() - begin, 2),
        "hypotheses": rows,
    }


def summary(cases: list[Results]) -> Results:
    """How far both ways differ, over hypotheses near the best and over the others."""
    near, far, doubtful, revived = [], [], 0, 0
    for case in cases:
        best = max(row["slow"] for row in case["hypotheses"])
        best_fast = max(row["fast"] for row in case["hypotheses"])
        for row in case["hypotheses"]:
            difference = row["fast"] - row["slow"]
            if row["slow_error"] > 0.1 or row["slow_k_hat"] > 0.7:
                doubtful += 1
            elif row["slow"] > best - NEAR_NATS:
                near.append(difference)
            else:
                far.append(difference)
                revived += row["fast"] > best_fast - NEAR_NATS
    q = (0.0, 0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99, 1.0)
    return {
        "cases": len(cases),
        "near": len(near),
        "near_agreed": int(np.sum(np.abs(near) <= AGREED_NATS)),
        "near_quantiles": np.round(np.quantile(near, q), 3).tolist() if near else [],
        "far": len(far),
        "far_not_too_high": int(np.sum(np.array(far) <= AGREED_NATS)),
        "far_no_longer_hopeless": int(revived),
        "reference_doubtful": doubtful,
    }


def run(quick: bool, cases: int = CASES, minutes: float = np.inf, path: Path | None = None) -> Results:
    """The cases that are saved at a path and those that are not, saved one by one."""
    numbers = range(QUICK_CASES if quick else cases)
    return case_by_case(
        numbers,
        partial(run_case, quick=quick),
        partial(as_results, quick=quick),
        minutes=minutes,
        path=path,
        say=_say,
    )


def as_results(rows: list[Results], *, quick: bool) -> Results:
    """What is saved of cases by their numbers."""
    return {"quick": quick, "summary": summary(rows), "cases": rows}


def _say(c: Results) -> None:
    print(c["case"], c["plate"], c["modes"], c["hidden"], c["meant"], c["seconds_fast"], c["seconds_slow"])
    for row in c["hypotheses"]:
        text = f"{row['fast']:10.2f} {row['slow']:10.2f} +- {row['slow_error']:.2f}"
        print(f"   {row['fast'] - row['slow']:8.2f} {text} {row['cause']} {row['variant']}", flush=True)


def main() -> None:
    """Run the cases that are not saved yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--quick", action="store_true", help="two lists against a smaller reference, not saved"
    )
    parser.add_argument("--cases", type=int, default=CASES, help="lists in all")
    parser.add_argument("--minutes", type=float, default=np.inf, help="no further list is begun after these")
    options = parser.parse_args()
    found = run(options.quick, options.cases, options.minutes, None if options.quick else RESULTS)
    print(found["summary"])


if __name__ == "__main__":
    main()
