"""The posterior over every stacking sequence on the grid, the elastic constants marginalised.

Each stacking sequence is a component of a mixture and has its evidence. Where there are few, every evidence
is computed; where there are many, a surrogate of it is trained first, and it is computed where the
probability is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.deadline import time_limit
from cpam_bayes.forward_model.model import angle_parameters, reference_vector
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS as REDUCTION
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.identification.search import required
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.records import angle_grid
from cpam_bayes.stacking.conditional.posterior import ConditionalPosterior, conditional_posterior
from cpam_bayes.stacking.conditional.starts import scan_library
from cpam_bayes.stacking.enumeration.by_surrogate import by_surrogate
from cpam_bayes.stacking.enumeration.exhaustive import exhaustive
from cpam_bayes.stacking.features import ply_sums
from cpam_bayes.stacking.records import (
    DEFAULT_SETTINGS,
    StackingPosterior,
    StackingProblem,
    StackingSettings,
)
from cpam_bayes.stacking.symmetry.equal_bending import merge_indistinguishable
from cpam_bayes.stacking.symmetry.symmetries import plate_symmetries
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Modes computed beyond those measured where the frequency list may lack some.
_SPARE_MODES = 4
# Constants that optimisations may start from.
_LIBRARY_SIZE = 96
# Fractions of the largest noise at which the two common starts begin.
_START_NOISE = (0.05, 0.3)


@single_blas_thread
def stacking_posterior(
    specimen: Specimen,
    seed: int,
    *,
    settings: StackingSettings = DEFAULT_SETTINGS,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StackingPosterior:
    """The probability of every stacking sequence on the grid of a specimen's unknown angles.

    p(s | f) is proportional to Z_s, the evidence of sequence s: all have the same prior probability.

    progress : is called with the pieces of the enumeration that are done, and with all.

    The result does not depend on the executor. Raises ``ValueError`` if the specimen has no unknown angle,
    no measured frequencies or no unknown constants, or an unsymmetric layup with too many unknown angles
    for every sequence to be computed.
    """
    start = time.perf_counter()
    problem = stacking_problem(specimen, seed, settings=settings, executor=executor, notify=notify)
    rng = np.random.default_rng([seed, 4])
    if problem.sums is None or settings.enumerates(problem.n_sequences):
        result = exhaustive(problem, rng, notify)
    else:
        result = by_surrogate(problem, problem.sums, rng, notify, progress)
    if problem.sums is not None:
        with time_limit(None):  # what is known by now is to be told
            result = merge_indistinguishable(result, problem, problem.sums)
    return replace(result, seconds=time.perf_counter() - start)


def stacking_problem(
    specimen: Specimen,
    seed: int,
    *,
    settings: StackingSettings = DEFAULT_SETTINGS,
    executor: Executor | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> StackingProblem:
    """The problem that ``stacking_posterior`` solves, its reduced model built; raises as that does."""
    measurement, unknowns = required(specimen)
    layup = specimen.plate.layup
    if not layup.n_unknown:
        raise ValueError(f'{specimen.source}: layup {layup.text} has no unknown angle; write "?" for one')
    grid = angle_grid(specimen.angle_grid_deg)
    few = settings.enumerates(len(grid) ** layup.n_unknown)
    sums = None if few and not layup.is_symmetric else ply_sums(layup, grid)
    n_modes = measurement.size + (0 if measurement.complete else _SPARE_MODES)
    parameters = angle_parameters(specimen).union(unknowns)
    model = reduced_model(specimen, parameters, n_modes, notify=notify)
    error = np.asarray(np.hypot(model.full.error, REDUCTION.tolerance))
    conditional = conditional_posterior(model, layup.n_unknown, measurement, error)
    return StackingProblem(
        specimen=specimen,
        conditional=conditional,
        symmetries=plate_symmetries(specimen),
        grid_deg=grid,
        sums=sums,
        starts=common_starts(specimen, conditional),
        library=scan_library(conditional, _LIBRARY_SIZE, np.random.default_rng([seed, 8])),
        settings=settings,
        executor=executor,
    )


def common_starts(specimen: Specimen, conditional: ConditionalPosterior) -> Array:
    """Starts of every optimisation, (2, n): the reference constants with little noise, the middle with much.

    Raises ``ValueError`` if neither meets the constraints (9).
    """
    p, template = conditional.parameters, conditional.template
    n = template.model.parameters.size
    starts = np.empty((2, p.size))
    starts[0, :n] = reference_vector(specimen, template.model.parameters)
    starts[1, :n] = 0.5 * (p.lower[:n] + p.upper[:n])
    if template.noise_is_inferred:
        prior = p.parameters[-1].prior
        starts[:, -1] = np.clip(np.multiply(_START_NOISE, prior.upper), prior.lower, prior.upper)
    inside = np.isfinite(template.log_prior(starts))
    if not inside.any():
        raise ValueError(
            f"{specimen.source}: neither the reference constants nor the middle of [unknowns] meet the "
            "constraints (9); move the bounds"
        )
    return starts[inside][[0, -1]]
