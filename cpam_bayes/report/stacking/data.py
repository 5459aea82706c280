"""The posterior of stacking sequence and constants as arviz InferenceData."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.inference.ensemble import problem_hash
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.report.plates.head import unit_of
from cpam_bayes.stacking.mixture import StackingMixture
from cpam_bayes.stacking.posterior import StackingPosterior
from cpam_bayes.stacking.sequence import StackingResult

__all__ = ["inference_data"]

# arviz writes its own version, into every group.
_LIBRARIES = ("numpy", "scipy", "emcee")
EMCEE, IMPORTANCE = "emcee", "importance sampling"


def inference_data(result: StackingResult) -> Any:
    """The mixture as ``arviz.InferenceData``.

    Groups: posterior, one chain of equally probable draws in no order: the constants by the names and
    units of the plate file, angle_deg over `ply` (the unknown angles from the bottom), component, the draw's
    class in the list (-1: none of it); sample_stats, what each draw was sampled by; constant_data, the list
    itself over `sequence` with probabilities, log evidences and their errors, and the marginals of the
    angles over `ply` and `angle`; observed_data, the measured frequencies over `mode`. Attributes: versions,
    plate, seed, hash of the problem, size of the credible set.
    """
    import warnings

    with warnings.catch_warnings():
        # arviz announces its next version
        warnings.simplefilter("ignore", FutureWarning)
        warnings.simplefilter("ignore", UserWarning)
        return _inference_data(result.answer, result.mixture, result.seed)


def _inference_data(result: StackingPosterior, mixture: StackingMixture, seed: int) -> Any:
    import arviz

    names = result.conditional.parameters.names
    posterior = {
        user_name(name): mixture.parameters[None, :, i] * to_user(name, 1.0) for i, name in enumerate(names)
    }
    frequencies = result.conditional.template.measurement.frequencies
    data = arviz.from_dict(
        posterior={
            **posterior,
            "angle_deg": mixture.angles_deg[None],
            "component": mixture.origin[None],
        },
        sample_stats={"sampled_by": np.where(mixture.by_emcee, EMCEE, IMPORTANCE)[None]},
        observed_data={"frequencies_hz": frequencies},
        constant_data={
            "sequence_angle_deg": result.top,
            "sequence_probability": result.probability,
            "sequence_multiplicity": result.multiplicity,
            "sequence_log_evidence": result.log_evidence,
            "sequence_log_evidence_error": result.log_evidence_error,
            "angle_marginal": result.marginals,
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
            "ply": np.arange(1, result.conditional.n_angles + 1),
            "mode": np.arange(1, len(frequencies) + 1),
            "sequence": np.arange(1, len(result.top) + 1),
            "angle": result.grid_deg,
        },
        attrs=_attributes(result, mixture, seed),
    )
    for name in names:
        data.posterior[user_name(name)].attrs["unit"] = unit_of(name)
    data.posterior["angle_deg"].attrs["unit"] = "deg"
    for group in data.groups():
        data[group].attrs.pop("created_at", None)  # the same seed gives the same file
    return data


def _attributes(result: StackingPosterior, mixture: StackingMixture, seed: int) -> dict[str, Any]:
    own = result.conditional.at(result.top[:1])
    centre = np.array([[p.prior.mean for p in own.parameters.parameters]])
    return {
        "cpam_bayes_version": __version__,
        **{f"{library}_version": version(library) for library in _LIBRARIES},
        "plate": result.specimen.name,
        "source": result.specimen.source,
        "layup": result.specimen.plate.layup.text,
        "seed": seed,
        "problem_hash": problem_hash(own, centre),
        "enumerated": result.enumerated,
        "credible_95_count": result.credible_count,
        "effective_count": result.effective_count,
        "unaccounted_probability": result.unaccounted,
        "log_evidence": result.log_evidence_total,
        "probability_by_emcee": mixture.emcee_fraction,
        "probability_by_importance_sampling": mixture.listed_fraction,
        "probability_by_drawn_sequences": mixture.drawn_fraction,
    }
