"""Lists drawn from the Ritz models, for studies of marginal likelihoods: they test only the integral."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import SCATTER, PlateCase, comparison_of
from cpam_bayes.diagnosis.evidence.marginal import Tested
from cpam_bayes.diagnosis.evidence.weighing import weigh
from cpam_bayes.diagnosis.hypotheses import OTHER, Hypothesis
from cpam_bayes.inference.log_density import CorrelatedDensity
from cpam_bayes.inference.scores import NormalScores
from cpam_bayes.plate import Material, Measurement, Specimen, builtin, read_plate

Array = NDArray[Any]

CLAMPED = Path(__file__).parents[1] / "data" / "bricks" / "clean_clamped.toml"

SEED = 0
NOISE, RESOLUTION_HZ = 0.002, 0.1
# Plates with the number of modes of their models, whether [material.sd] is kept, and list lengths.
PLATES = (("C1", 10, True, (6, 10)), ("C1", 10, False, (6, 10)), ("clamped", 12, False, (6, 10, 12)))
SIGNALS = (4.0, 8.0, 16.0, 32.0, 100.0)


def listed(number: int) -> tuple[np.random.Generator, dict[str, Any], PlateCase, Hypothesis]:
    """A list by its number: the generator that drew it, its description, its plate and the true hypothesis.

    The truth is none or a cause of the catalogue, with a size from its prior or for a given signal to noise.
    """
    rng = np.random.default_rng([SEED, number])
    name, most, with_sd, lengths = PLATES[number % len(PLATES)]
    n, stated = int(rng.choice(lengths)), bool(rng.random() < 0.5)
    case = plate(name, most, with_sd)
    hidden, size, meant, f = drawn(case, n, rng)
    case = with_frequencies(case, f * (1.0 + NOISE * rng.standard_normal(n)), stated=stated)
    what = {
        "case": number,
        "plate": name,
        "sd": with_sd,
        "modes": n,
        "noise_stated": stated,
        "hidden": hidden.cause,
        "variant": hidden.variant,
        "size": size,
        "meant": meant,
    }
    return rng, what, case, hidden


@cache
def plate(name: str, n: int, with_sd: bool) -> PlateCase:
    """A plate with a placeholder list."""
    specimen: Specimen = read_plate(CLAMPED) if name == "clamped" else builtin(name)
    if not with_sd:
        assert isinstance(specimen.material, Material)
        specimen = replace(specimen, material=replace(specimen.material, sd={}))
    return plate_case(replace(specimen, measurement=a_list(np.arange(1.0, n + 1.0), stated=True)))


def a_list(frequencies: Array, *, stated: bool) -> Measurement:
    """A complete list, with or without its noise stated."""
    labels = ("",) * len(frequencies)
    f = np.sort(np.round(frequencies / RESOLUTION_HZ) * RESOLUTION_HZ)
    return Measurement(f, RESOLUTION_HZ, NOISE if stated else None, None, labels, complete=True)


def with_frequencies(case: PlateCase, f: Array, *, stated: bool) -> PlateCase:
    """The plate with a list of its lowest frequencies."""
    return replace(case, measurement=a_list(f, stated=stated), modes=np.arange(len(f)))


def drawn(case: PlateCase, n: int, rng: np.random.Generator) -> tuple[Hypothesis, float, str, Array]:
    """The hidden hypothesis, its size, how that was chosen, and the frequencies without noise, (n,)."""
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
            alike = comparison.listed.correlation(own.correlation_length or 0.0)
            f = f * np.exp(size * np.linalg.cholesky(alike) @ rng.standard_normal(n))
        if h.listed.spurious is not None:  # the model has the others: a false peak lies anywhere among them
            f = np.sort(np.append(f, rng.uniform(0.7 * f[0], f[-1])))
        return h, size, meant, f


def at_random_place(h: Hypothesis, rng: np.random.Generator) -> Hypothesis:
    """A hypothesis with its effect at a place drawn from its prior; unchanged if it has no place."""
    if not h.effects or not h.effects[0].is_anywhere:
        return h
    effect = h.effects[0]
    fixed = effect.fixed({p.name: p.prior.sample(rng, 1)[0] for p in effect.coordinates})
    return replace(h, effects=(fixed,), parameters=fixed.parameters, variant=fixed.variant)


def size_for(
    case: PlateCase, comparison: CorrelatedDensity, x: Array, column: int, most: float, signal: float
) -> float | None:
    """Smallest size with a given signal to noise; None if ``most`` does not reach it.

    The signal is the shift of ln f minus what the constants imitate within their priors.
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
    # second-order effects grow with the square of the size
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
    """Hypotheses, none first, weighed as in the diagnosis."""
    every = [(h, (0,)) for h in chosen]
    return list(weigh([case], every, scatter=SCATTER, sets=False).tested)
