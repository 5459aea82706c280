"""The probability of every stacking sequence on the grid: the question `sequence`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from cpam_bayes.arguments import checked
from cpam_bayes.deadline import time_limit
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.preconditions import (
    exchange_warnings,
    explained_failures,
    require_seed,
    require_sequence,
    require_whole,
)
from cpam_bayes.forward_model.reachable import require_reachable
from cpam_bayes.forward_model.slips import (
    count_slips,
    misfit_over_noise,
    misfit_slips,
    reference_slips,
    stated_noise_slips,
)
from cpam_bayes.identification.reliance import Reliance, reliances
from cpam_bayes.inference.posterior import NOISE
from cpam_bayes.paper.layups import identified_layups
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.result import SILENT, PlateResult, Watch, within_time
from cpam_bayes.stacking.mixture import StackingMixture, n_sampled_classes, sample_mixture
from cpam_bayes.stacking.posterior import stacking_posterior
from cpam_bayes.stacking.queries.angle_information import AngleInformation, angle_information
from cpam_bayes.stacking.queries.best_fit import BestFit, best_fit
from cpam_bayes.stacking.queries.given_layup import GivenLayup, given_layup
from cpam_bayes.stacking.records import DEFAULT_SETTINGS, StackingPosterior
from cpam_bayes.stacking.warnings import stacking_warnings

# Pieces of the enumeration that progress is shown in.
_PIECES = 64
# Sequences that can be listed.
MAX_LISTED = 2000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class StackingResult(PlateResult):
    """The posterior over stacking sequences, the constants integrated over.

    Attributes
    ----------
    answer : the most probable sequences with their probabilities, marginals of the angles, sums
    mixture : draws of the constants over all sequences
    given : the sequence that the paper prints for a built-in specimen, None for other plates
    fit : the most probable sequence beside the measured frequencies
    information : what the frequencies tell about each ply
    explained : whether noise as stated explains what the most probable sequence leaves of the list
    reliances : intervals that rest on the bounds or the prior of another constant
    top : sequences in the JSON document
    """

    question: ClassVar[str] = "stacking"
    command: ClassVar[str] = "sequence"
    draws: ClassVar[str] = "cpam_bayes.stacking.draws"

    answer: StackingPosterior
    mixture: StackingMixture
    given: GivenLayup | None
    fit: BestFit
    information: AngleInformation
    explained: bool
    reliances: tuple[Reliance, ...]
    top: int

    @property
    def status(self) -> str:
        """Either "converged", as all chains of the constants have, or "not converged"."""
        return "converged" if self.mixture.converged else "not converged"

    @property
    def most_probable(self) -> Specimen:
        """The specimen with the most probable angles."""
        return _most_probable(self.answer)


@checked
@within_time
def sequence(
    plate: PlateLike,
    *,
    seed: int = 0,
    top: int = 100,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> StackingResult:
    """The posterior over every stacking sequence on the grid of the unknown angles, all equal a priori.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns, with "?" in its layup; built-in specimens take the
        unknown angles of Table 9(b)
    top : most probable sequences to list
    executor, workers : "serial", in this process; "processes", as many as cores or ``workers``, which needs
        the call under ``if __name__ == "__main__":`` in a script; or a Dask cluster, see
        `cpam_bayes.parallel.open_executor`. The answer is the same
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the plate cannot be read, has no unknown angle, no measured frequencies or no unknowns.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> plate = {
    ...     "name": "two unknown angles",
    ...     "plate": {
    ...         "length_mm": 260, "width_mm": 190, "thickness_mm": 3.2,
    ...         "density_kg_m3": 1590, "layup": "[?/?]_s", "edges": "FFFF",
    ...     },
    ...     "material": {
    ...         "isotropic": False, "E1_GPa": 121.2, "E2_GPa": 9.34, "nu12": 0.23, "G12_GPa": 6.25,
    ...     },
    ...     "unknowns": {
    ...         "E1_GPa": [80, 160], "E2_GPa": [5, 20], "nu12": [0.15, 0.4], "G12_GPa": [4, 10],
    ...         "angle_grid_deg": 30,
    ...     },
    ...     "measurement": {
    ...         "frequencies_hz": [154.4, 286.9, 402.8, 414.4, 574.5, 749.3], "relative_std": 0.01,
    ...     },
    ... }
    >>> result = cb.sequence(plate, executor="serial")
    >>> result.answer.top[0].tolist(), int(result.answer.multiplicity[0])
    ([-30.0, 60.0], 2)
    """
    require_seed(seed)
    require_whole("top", top, 1, MAX_LISTED)
    specimen = require_sequence(read_plate(plate).with_unknown_angles())
    require_reachable(specimen)
    settings = replace(DEFAULT_SETTINGS, listed=max(DEFAULT_SETTINGS.listed, top))
    with open_executor(executor, workers) as pool:
        with (
            explained_failures(specimen),
            watch.stage(f"sequence {specimen.name}", _PIECES, lambda done: "of the pieces") as shown,
        ):
            answer = stacking_posterior(
                specimen,
                seed,
                settings=settings,
                executor=pool,
                notify=shown.notify,
                progress=lambda done, _: shown.tick(done, float(done)),
            )
        with time_limit(None):  # one sequence, even if time is up
            given = _printed(answer)
        classes = n_sampled_classes(answer) + (given is not None)
        with watch.stage("constants by emcee", classes, lambda done: "a class each") as shown:
            mixture = sample_mixture(
                answer,
                seed,
                given=given,
                executor=pool,
                progress=lambda done, _: shown.tick(done, float(done)),
            )
    with time_limit(None):
        return stacking_result(answer, mixture, given, seed, top)


def stacking_result(
    answer: StackingPosterior, mixture: StackingMixture, given: GivenLayup | None, seed: int, top: int
) -> StackingResult:
    """The posterior over stacking sequences with what is shown beside it, and its warnings."""
    specimen, fit = answer.specimen, best_fit(answer)
    slips = _slips(specimen, fit)
    measurement = answer.conditional.template.measurement
    return StackingResult(
        seed=seed,
        slips=slips,
        warnings=(*slips, *stacking_warnings(answer, mixture, fit), *exchange_warnings(specimen)),
        reached_goal=mixture.converged,
        specimen=specimen,
        air_shifts=air_shifts(_most_probable(answer)),
        answer=answer,
        mixture=mixture,
        given=given,
        fit=fit,
        information=angle_information(specimen.plate.layup, answer.marginals),
        explained=misfit_over_noise(measurement, fit.residual, specimen.unknowns.size) == 1.0,
        reliances=_reliances(answer, mixture),
        top=top,
    )


def _reliances(answer: StackingPosterior, mixture: StackingMixture) -> tuple[Reliance, ...]:
    """Of the constants over all sequences."""
    parameters = answer.conditional.parameters
    kept = [i for i, name in enumerate(parameters.names) if name != NOISE]
    names = [parameters.names[i] for i in kept]
    covariance = np.atleast_2d(np.cov(mixture.parameters[:, kept].T))
    return reliances(names, covariance, np.array([parameters[name].prior.sd for name in names]))


def _slips(specimen: Specimen, fit: BestFit) -> tuple[str, ...]:
    """What most likely ruins the answer."""
    residual = np.asarray(fit.residual)[np.isfinite(fit.residual)]
    misfit = float(np.sqrt(np.mean(residual**2))) if residual.size else 0.0
    measurement = specimen.measurement
    assert measurement is not None
    return (
        *stated_noise_slips(measurement),
        *count_slips(measurement.size, specimen.unknowns.size),
        *misfit_slips(misfit),
        *reference_slips(specimen),
    )


def _printed(answer: StackingPosterior) -> GivenLayup | None:
    """What Table 9(b) prints for a built-in specimen."""
    name = answer.specimen.name
    printed = identified_layups().get(name)
    if printed is None or answer.specimen.source != f"built-in {name}":
        return None
    return given_layup(answer, np.array(printed.angles_deg, dtype=float))


def _most_probable(answer: StackingPosterior) -> Specimen:
    """The specimen with the most probable angles."""
    plate = answer.specimen.plate
    return replace(answer.specimen, plate=replace(plate, layup=plate.layup.with_angles(answer.top[0])))
