"""Small reduced bases for the posteriors of sequences: of the whole box, and of where the mass is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.inference.focus import focused
from cpam_bayes.inference.sequence_evaluation import Evaluated
from cpam_bayes.inference.sequence_evidence import SequencePosterior
from cpam_bayes.model import training_sets

Array = NDArray[Any]

# A first basis for the whole box: parameter sets that it is made from, and its relative error.
_BOX_SETS, _BOX_ERROR = 400, 1e-3
# The basis about the posterior: how far below the best, nats, a sequence belongs to it; sets; error.
NEAR, _NEAR_SETS, _NEAR_ERROR = 18.0, 800, 1e-4
# Both errors are at most these shares of the noise, where that is given.
_BOX_SHARE, _NEAR_SHARE = 0.3, 0.05


def roughly(own: SequencePosterior, rng: np.random.Generator) -> SequencePosterior:
    """The posterior on a small basis for the whole box, which says where the mass is."""
    box = training_sets(own.model.full.operator.problem, _BOX_SETS, rng)
    return replace(own, model=focused(own.model, box, _tolerance(own, _BOX_ERROR, _BOX_SHARE)))


def about(
    own: SequencePosterior, grid_deg: Array, data: Evaluated, rng: np.random.Generator
) -> SequencePosterior:
    """The posterior on a basis that is made for the sequences near the top and their constants."""
    some = np.flatnonzero(data.log_evidence > data.log_evidence.max() - NEAR)
    draws = data.conditionals.draws[some][..., : own.template.model.parameters.size]
    angles = np.repeat(grid_deg[data.sequences[some]], draws.shape[1], axis=0)
    x = np.column_stack((angles, draws.reshape(len(angles), -1)))
    x = x[rng.permutation(len(x))[:_NEAR_SETS]]
    return replace(own, model=focused(own.model, x, _tolerance(own, _NEAR_ERROR, _NEAR_SHARE)))


def _tolerance(own: SequencePosterior, error: float, share: float) -> float:
    """Relative error that a basis may have: the given one, or a share of the noise where that is less."""
    if own.template.noise_is_inferred:
        return error
    f, i = own.template.measurement.frequencies, np.arange(own.template.measurement.size)
    x = 0.5 * (own.parameters.lower + own.parameters.upper)
    sd = own.template.noise(x[None], f[None])[0, i, i]
    return min(error, share * float(np.min(sd / f)))
