"""The draws of stacking sequence and constants, for arviz."""

from __future__ import annotations

from typing import Any

import numpy as np

from cpam_bayes.inference.chains.arviz_data import arviz_data, by_user_name
from cpam_bayes.stacking.sequence import StackingResult

EMCEE, IMPORTANCE = "emcee", "importance sampling"


def inference_data(result: StackingResult) -> Any:
    """The mixture as ``arviz.InferenceData``.

    Groups: posterior, one chain of equally probable draws in no order: the constants by the names and
    units of the plate file, angle_deg over `ply` (the unknown angles from the bottom), component, the draw's
    class in the list (-1: none of it); sample_stats, what each draw was sampled by; constant_data, the list
    itself over `sequence` with probabilities, log evidences and their errors, and the marginals of the
    angles over `ply` and `angle`; observed_data, the measured frequencies over `mode`. Attributes: command,
    versions, plate, seed, hash of the problem, size of the credible set.
    """
    answer, mixture = result.answer, result.mixture
    names = answer.conditional.parameters.names
    frequencies = answer.conditional.template.measurement.frequencies
    data = arviz_data(
        result.command,
        result.specimen,
        result.seed,
        answer.conditional.at(answer.top[:1]),
        {
            "layup": result.specimen.plate.layup.text,
            "enumerated": answer.enumerated,
            "credible_95_count": answer.credible_count,
            "effective_count": answer.effective_count,
            "unaccounted_probability": answer.unaccounted,
            "log_evidence": answer.log_evidence_total,
            "probability_by_emcee": mixture.emcee_fraction,
            "probability_by_importance_sampling": mixture.listed_fraction,
            "probability_by_drawn_sequences": mixture.drawn_fraction,
        },
        posterior={
            **by_user_name(names, mixture.parameters[None]),
            "angle_deg": mixture.angles_deg[None],
            "component": mixture.origin[None],
        },
        sample_stats={"sampled_by": np.where(mixture.by_emcee, EMCEE, IMPORTANCE)[None]},
        observed_data={"frequencies_hz": frequencies},
        constant_data={
            "sequence_angle_deg": answer.top,
            "sequence_probability": answer.probability,
            "sequence_multiplicity": answer.multiplicity,
            "sequence_log_evidence": answer.log_evidence,
            "sequence_log_evidence_error": answer.log_evidence_error,
            "angle_marginal": answer.marginals,
        },
        dims={
            "angle_deg": ["ply"],
            "frequencies_hz": ["mode"],
            "sequence_angle_deg": ["sequence", "ply"],
            "angle_marginal": ["ply", "angle"],
            **{
                f"sequence_{what}": ["sequence"]
                for what in ("probability", "multiplicity", "log_evidence", "log_evidence_error")
            },
        },
        coords={
            "ply": np.arange(1, answer.conditional.n_angles + 1),
            "mode": np.arange(1, len(frequencies) + 1),
            "sequence": np.arange(1, len(answer.top) + 1),
            "angle": answer.grid_deg,
        },
    )
    data.posterior["angle_deg"].attrs["unit"] = "deg"
    return data
