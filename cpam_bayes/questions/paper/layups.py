"""Stacking sequences of measured and perturbed lists: by the paper's swarm, and by their posterior.

Noise as in eq. (12) on the root mean square frequency: one standard deviation for all modes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.build import reduced_model
from cpam_bayes.forward_model.model import with_references
from cpam_bayes.forward_model.preconditions import require_sequence
from cpam_bayes.identification.angle_search import AngleSearchProblem, run_swarm, search_parameters
from cpam_bayes.identification.search import required
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.plate import Material, Specimen, angle_grid, builtin, to_user, user_name
from cpam_bayes.printed.repetition import perturbation_sd
from cpam_bayes.printed.tables import PrintedRow, printed_table
from cpam_bayes.questions.paper.rows import Results
from cpam_bayes.questions.sequence import StackingResult, stacking_result
from cpam_bayes.stacking.posterior import sample_mixture, stacking_posterior
from cpam_bayes.stacking.queries import given_layup
from cpam_bayes.stacking.records import RoundSettings, StackingPosterior, StackingSettings
from cpam_bayes.stacking.symmetry import members

Array = NDArray[Any]

# An uninformative list leaves many thousand sequences, 25 ms each for a thick plate. With these settings the
# bits of C1's lists are within 0.02 of those with the usual ones, probabilities of sequences within 9 %.
SHORT_LIST: Final = StackingSettings(
    rounds=RoundSettings(fine_from=1.0), unaccounted=1e-2, max_fitted=2000, listed=50, draws=200
)
# A constant within this fraction of its interval of a bound counts as on it.
_ON_BOUND: Final = 1e-3


def bounds_alone(name: str) -> Specimen:
    """A built-in specimen as in the paper: no prior from reference constants, exact sizes."""
    specimen = builtin(name).with_exact_sizes()
    assert isinstance(specimen.material, Material)
    return replace(specimen, material=replace(specimen.material, known=False))


def layup_case(result: StackingResult) -> dict[str, Any]:
    """What is stored of the posterior over the stacking sequences of a measured list."""
    answer, given = result.answer, result.given
    assert given is not None
    return {
        "enumerated": answer.enumerated,
        "credible_95_count": answer.credible_count,
        "unaccounted": answer.unaccounted,
        "most_probable": {
            "angles_deg": answer.top[0].tolist(),
            "probability": float(answer.probability[0]),
        },
        "printed": {
            "angles_deg": given.angles_deg.tolist(),
            "probability": given.probability,
            "rank": given.rank,
            "log_evidence_below_best": float(answer.log_evidence[0] - given.log_evidence),
        },
    }


def _levels(table: int) -> Iterator[tuple[float, PrintedRow]]:
    """Levels of noise, %, of Tables 10 to 14, with the printed row of each."""
    for row in printed_table(table).rows:
        if row.level_percent is not None:
            yield row.level_percent, row


def _perturbed(measured: Array, level: float, seed: int, groups: int) -> tuple[Array, Array]:
    """Perturbed lists (groups, n) in ascending order, and the noise sd (n,), Hz.

    The first lists do not depend on the number of groups.
    """
    sd = perturbation_sd(measured, 0.01 * level, "rms")
    noise = sd * np.random.default_rng((seed, int(level))).standard_normal((groups, len(measured)))
    return np.sort(np.abs(measured + noise), axis=1), sd


def _ended(
    specimen: Specimen, lists: Array, seeds: Sequence[int | Sequence[int]], swarm: SwarmSettings
) -> tuple[Array, Array]:
    """Angles (n, k), degrees, and constants (n, m), SI, found by a fuzzy swarm on each list (n, n_modes)."""
    measurement, _ = required(specimen)
    model = reduced_model(specimen, search_parameters(specimen), measurement.size)
    grid = angle_grid(specimen.angle_grid_deg)
    fits = (AngleSearchProblem(specimen, model, one, grid) for one in lists)
    swarms = [run_swarm(fit, seed, swarm) for fit, seed in zip(fits, seeds, strict=True)]
    return np.array([grid[s.sequence] for s in swarms]), np.array([s.best for s in swarms])


def searched_without_noise(name: str, seeds: Sequence[int], swarm: SwarmSettings) -> Results:
    """Angles at which fuzzy swarms end on the measured list, for different seeds."""
    specimen = builtin(name, sequence=True)
    measurement, _ = required(specimen)
    lists = np.repeat(measurement.frequencies[None], len(seeds), axis=0)
    return {"angles_deg": _ended(specimen, lists, seeds, swarm)[0].tolist()}


def searched(name: str, table: int, seed: int, groups: int, swarm: SwarmSettings) -> Results:
    """Angles and constants searched together by one fuzzy swarm on each perturbed list, as in the paper."""
    specimen = builtin(name, sequence=True)
    measurement, unknowns = required(specimen)
    width = unknowns.upper - unknowns.lower
    levels = []
    for level, _ in _levels(table):
        lists, _ = _perturbed(measurement.frequencies, level, seed, groups)
        seeds = [(seed, int(level), i + 1) for i in range(groups)]
        angles, constants = _ended(specimen, lists, seeds, swarm)
        from_bound = np.minimum(constants - unknowns.lower, unknowns.upper - constants)
        on_bound = np.mean(from_bound <= _ON_BOUND * width, axis=0)
        mean, sd = constants.mean(axis=0), constants.std(axis=0, ddof=1)
        levels.append(
            {
                "level_percent": level,
                "angles_deg": angles.tolist(),
                "constants": {
                    user_name(constant): {
                        "repetition_mean": to_user(constant, float(mean[i])),
                        "repetition_sd": to_user(constant, float(sd[i])),
                        "on_bound": float(on_bound[i]),
                    }
                    for i, constant in enumerate(unknowns.names)
                },
            }
        )
    return {"groups": groups, "levels": levels}


def weighed(name: str, table: int, seed: int) -> Results:
    """The posterior over all stacking sequences of one perturbed list per level, its noise stated."""
    specimen = bounds_alone(name)
    measurement, _ = required(specimen)
    unlabelled = replace(measurement, relative_std=None, labels=("",) * measurement.size, shapes=None)
    place = specimen.with_unknown_angles().plate.layup.unknown_index
    true = [float(specimen.plate.layup.angles_deg[place == k][0]) for k in range(int(place.max()) + 1)]
    levels = []
    for level, row in _levels(table):
        (noisy,), sd = _perturbed(measurement.frequencies, level, seed, 1)
        noisy_list = replace(unlabelled, frequencies=noisy, frequency_sd=sd)
        # renamed, so that the printed sequence of Table 9(b) is not evaluated too
        one = replace(specimen, name=f"{name}, {row.source}", measurement=noisy_list)
        result = _sequence(one, seed)
        answer, information = result.answer, result.information
        levels.append(
            {
                "level_percent": level,
                "enumerated": answer.enumerated,
                "credible_95_count": answer.credible_count,
                "unaccounted": answer.unaccounted,
                "p_value": result.fit.p_value,
                "most_bits": information.most_bits,
                "bits": (information.most_bits - information.entropy_bits).tolist(),
                "true_probability": _together(answer, true),
                "printed_probability": _together(answer, row.values["angles_deg"].angles_deg),
                "most_probable": {
                    "angles_deg": answer.top[0].tolist(),
                    "probability": float(answer.probability[0] * answer.multiplicity[0]),
                },
                "constants": result.to_dict()["constants"],
            }
        )
    return {"levels": levels}


def _sequence(specimen: Specimen, seed: int) -> StackingResult:
    """The answer of `sequence` with the settings for short lists."""
    one = with_references(require_sequence(specimen.with_unknown_angles()))
    answer = stacking_posterior(one, seed, settings=SHORT_LIST)
    return stacking_result(answer, sample_mixture(answer, seed), None, seed, SHORT_LIST.listed)


def _together(answer: StackingPosterior, angles_deg: Sequence[float]) -> float:
    """Probability of a sequence and all sequences with the same frequencies."""
    given = given_layup(answer, np.array(angles_deg, dtype=float))
    if given.index is not None:
        return given.probability * int(answer.multiplicity[given.index])
    sequence_of_grid = np.searchsorted(answer.grid_deg, given.angles_deg)
    return given.probability * len(members(sequence_of_grid, answer.symmetries))
