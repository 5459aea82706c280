"""Small reduced bases for the posteriors of sequences: for the whole box, where the mass is, for one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.focused import focused
from cpam_bayes.forward_model.model import training_sets
from cpam_bayes.stacking.conditional.evaluation import Evaluated
from cpam_bayes.stacking.conditional.posterior import ConditionalPosterior

Array = NDArray[Any]

# A first basis for the whole box: parameter sets that it is made from, and its relative error.
_BOX_SETS, _BOX_ERROR = 400, 5e-3
# The basis about the posterior: how far below the best, nats, a sequence belongs to it; sets; error.
NEAR, _NEAR_SETS, _NEAR_ERROR = 18.0, 800, 2e-3
# Share of the frequencies that the errors are those of, where the noise, relative, is so large: few sets at
# the rim of a wide posterior, which weigh little, would take as many vectors as all others.
_MOST, _NOISY = 0.98, 8e-3
# Both errors are at most these shares of the noise, as far as it is known.
_BOX_SHARE, _NEAR_SHARE = 0.3, 0.05
# The basis for one sequence and all constants: sets, the least and the largest relative error, and the share
# of the noise that it is between them.
_SEQUENCE_SETS, _SEQUENCE_ERRORS, _SEQUENCE_SHARE = 300, (2e-5, 2e-4), 0.02
# Share of the draws whose noise may be less than the one that counts where it is inferred.
_LEAST_NOISE = 0.01


def roughly(conditional: ConditionalPosterior, rng: np.random.Generator) -> ConditionalPosterior:
    """The posterior on a small basis for the whole box, which says where the mass is."""
    box = training_sets(conditional.model.full.operator.problem, _BOX_SETS, rng)
    noise = np.inf
    if not conditional.template.noise_is_inferred:
        middle = 0.5 * (conditional.parameters.lower + conditional.parameters.upper)
        noise = conditional.least_noise(middle[None])
    return replace(
        conditional, model=focused(conditional.model, box, min(_BOX_ERROR, _BOX_SHARE * noise), _share(noise))
    )


def about(
    conditional: ConditionalPosterior, grid_deg: Array, data: Evaluated, rng: np.random.Generator
) -> ConditionalPosterior:
    """The posterior on a basis that is made for the sequences near the top and their constants."""
    some = np.flatnonzero(data.log_evidence > data.log_evidence.max() - NEAR)
    draws = data.conditionals.draws[some]
    angles = np.repeat(grid_deg[data.sequences[some]], draws.shape[1], axis=0)
    draws = draws.reshape(len(angles), -1)
    rows = rng.permutation(len(draws))[:_NEAR_SETS]
    angles, draws = angles[rows], draws[rows]
    noise = float(np.quantile(conditional.relative_noise(draws).min(axis=1), _LEAST_NOISE))
    x = np.column_stack((angles, draws[:, : conditional.template.model.parameters.size]))
    return replace(
        conditional, model=focused(conditional.model, x, min(_NEAR_ERROR, _NEAR_SHARE * noise), _share(noise))
    )


def of_sequence(conditional: ConditionalPosterior, angles_deg: Array, noise: float) -> ConditionalPosterior:
    """The posterior on a basis for one sequence (k,), wherever its constants are in their box.

    Constants alone change a mode far less than the angles do: a third of the vectors says as much.

    noise : least standard deviation of a frequency, relative.
    """
    sets = training_sets(conditional.model.full.operator.problem, _SEQUENCE_SETS, np.random.default_rng(0))
    sets[:, : conditional.n_angles] = angles_deg
    error = float(np.clip(_SEQUENCE_SHARE * noise, *_SEQUENCE_ERRORS))
    return replace(conditional, model=focused(conditional.model, sets, error))


def _share(noise: float) -> float:
    return _MOST if noise >= _NOISY else 1.0
