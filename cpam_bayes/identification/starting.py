"""From a plate file to a posterior and the swarm that its ensembles start from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.arguments import checked
from cpam_bayes.forward_model.labels import LabelledModel, labelled_model, spare_modes
from cpam_bayes.forward_model.model import discretisation_error, reference_vector, size_parameters
from cpam_bayes.forward_model.preconditions import explained_failures, require_choice, require_supported
from cpam_bayes.forward_model.reduced import DEFAULT_SETTINGS as REDUCTION
from cpam_bayes.forward_model.reduced import ReducedModel
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.identification.identify import NO_MESH
from cpam_bayes.identification.search import required, search
from cpam_bayes.inference.chains.sampling import swarm_on_posterior
from cpam_bayes.inference.noise import Likelihood
from cpam_bayes.inference.posterior import Posterior, plate_posterior
from cpam_bayes.inference.swarm.pso import SwarmSettings
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.threads import single_blas_thread

Array = NDArray[Any]

# Modes looked at beyond a list that may lack some, and beyond one that says it does not.
_SPARE_MODES, _ONE_MORE = 4, 1


@dataclass(frozen=True, slots=True)
class Start:
    """A posterior and the personal bests of a swarm on it or on its misfit.

    bests : (m, n_plate) the plate's parameters, without the noise; values : (m,) what the swarm
    minimised; solves : its forward solves.
    """

    posterior: Posterior
    model: ReducedModel | LabelledModel
    bests: Array
    values: Array
    solves: int


@checked
@single_blas_thread
def posterior(
    plate: PlateLike, *, likelihood: Likelihood = "relative", degrees_of_freedom: float = np.inf
) -> Posterior:
    """The posterior of the unknowns of a plate, and of its sizes that have a standard deviation.

    The building block for one's own sampler or optimiser: ``log_prob`` takes parameter vectors (m, n) in SI
    units, in the order of ``parameters.names``, and returns (m,). The plate model is converged about the
    reference constants.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns
    likelihood, degrees_of_freedom : of the noise, see `sample`

    Raises
    ------
    ValueError
        If the plate cannot be read, has no measured frequencies or no unknowns.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> posterior = cb.posterior("A1")
    >>> posterior.parameters.names
    ('E1', 'nu12', 'relative_std')
    >>> inside, outside = posterior.log_prob([[67e9, 0.33, 0.01], [300e9, 0.33, 0.01]])
    >>> print(inside > -40, outside)
    True -inf
    """
    require_choice("likelihood", likelihood, get_args(Likelihood))
    specimen = require_supported(read_plate(plate), NO_MESH)
    measurement, unknowns = required(specimen)
    spare = max(_ONE_MORE if measurement.complete else _SPARE_MODES, spare_modes(measurement))
    parameters = unknowns.union(size_parameters(specimen))
    with explained_failures(specimen):
        reduced = reduced_model(specimen, parameters, measurement.size + spare)
    return plate_posterior(
        labelled_model(reduced, measurement, specimen),
        measurement,
        np.hypot(reduced.full.error, REDUCTION.tolerance),
        likelihood=likelihood,
        degrees_of_freedom=degrees_of_freedom,
    )


@single_blas_thread
def start_of(
    specimen: Specimen,
    seed: int,
    *,
    likelihood: Likelihood = "relative",
    degrees_of_freedom: float = np.inf,
    swarm_settings: SwarmSettings | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> Start:
    """The posterior of a specimen's unknowns and of its sizes that have a standard deviation.

    A complete list is first fitted by the paper's swarm with the sizes of the plate file, an
    incomplete one by a swarm on the posterior itself. likelihood, degrees_of_freedom : of the noise,
    as of ``noise_model``. Raises ``ValueError`` as ``identify`` and ``noise_model`` do.
    """
    measurement, unknowns = required(specimen)
    sizes = size_parameters(specimen)
    parameters = unknowns.union(sizes)

    def posterior_on(model: ReducedModel | LabelledModel, error: Array) -> Posterior:
        return plate_posterior(
            model,
            measurement,
            np.hypot(error, REDUCTION.tolerance),
            likelihood=likelihood,
            degrees_of_freedom=degrees_of_freedom,
        )

    if not measurement.complete:
        spare = max(_SPARE_MODES, spare_modes(measurement))
        reduced = reduced_model(specimen, parameters, measurement.size + spare, notify=notify)
        model = labelled_model(reduced, measurement, specimen)
        target = posterior_on(model, reduced.full.error)
        bests, values, solves = swarm_on_posterior(target, seed, swarm_settings or SwarmSettings())
        return Start(target, model, bests, values, solves)
    searched = search(specimen, seed, spare=_ONE_MORE, settings=swarm_settings, notify=notify)
    swarm, model, error = searched.swarm, searched.model, searched.error
    bests = swarm.personal_bests
    if sizes.size:
        nominal = reference_vector(specimen, sizes)
        bests = np.column_stack((bests, np.tile(nominal, (len(bests), 1))))
        centre = None if searched.centre is None else np.append(searched.centre, nominal)
        reduced = reduced_model(specimen, parameters, model.n_modes, centre=centre, notify=notify)
        model = labelled_model(reduced, measurement, specimen)
        error = discretisation_error(reduced.full, np.append(swarm.best, nominal))
    return Start(posterior_on(model, error), model, bests, swarm.personal_values, swarm.evaluations)
