"""The paper's repetition on perturbed frequencies beside the posterior: the question `sensitivity`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, get_args

from cpam_bayes.arguments import checked
from cpam_bayes.errors import PlateFileError
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.preconditions import (
    explained_failures,
    require_choice,
    require_modes,
    require_number,
    require_seed,
    require_supported,
    require_whole,
)
from cpam_bayes.forward_model.reachable import require_reachable
from cpam_bayes.forward_model.slips import reference_slips, stated_noise_slips
from cpam_bayes.forward_model.solve import measured_modes
from cpam_bayes.inference.chains.ensemble import EnsembleSettings
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.paper import PerturbationTable, perturbation_table
from cpam_bayes.parallel import open_executor
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.repetition.perturbation import INTERPRETATIONS, Interpretation
from cpam_bayes.repetition.study import ENSEMBLE_SETTINGS, ListSource, Sensitivity, model_list, noise_study
from cpam_bayes.repetition.warnings import printed_table, sensitivity_warnings
from cpam_bayes.result import SILENT, PlateResult, Watch, within_time

MAX_LEVEL = 0.5
"""Largest level of noise, as a fraction."""
_NO_MESH = "sensitivity computes rectangular plates only; leave mesh out"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SensitivityResult(PlateResult):
    """Inversions of perturbed frequencies beside one posterior, by level of noise.

    Attributes
    ----------
    study : all levels and interpretations of eq. (12)
    table : the paper's table for a built-in specimen, None for other plates
    """

    question: ClassVar[str] = "repetition"
    command: ClassVar[str] = "sensitivity"

    study: Sensitivity
    table: PerturbationTable | None

    @property
    def status(self) -> str:
        """Either "converged", as the chains of all posteriors have, or "budget"."""
        return "converged" if self.reached_goal else "budget"


@checked
@within_time
def sensitivity(
    plate: PlateLike,
    *,
    seed: int = 0,
    levels: Sequence[float] = (0.01, 0.05, 0.1),
    groups: int = 10,
    readings: Interpretation | Sequence[Interpretation] = INTERPRETATIONS,
    source: ListSource = "model",
    n_modes: int | None = None,
    settings: SwarmSettings | None = None,
    chains: EnsembleSettings = ENSEMBLE_SETTINGS,
    executor: str = "serial",
    workers: int | None = None,
    watch: Watch = SILENT,
) -> SensitivityResult:
    """The paper's noise study, section 7.4: constants from perturbed frequencies, beside a posterior.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns
    levels : of noise, as fractions, above 0 and at most 0.5
    groups : perturbed frequency lists at each level
    readings : interpretations of eq. (12): noise as a fraction of each frequency ("relative"), or of the
        root mean square frequency ("rms")
    source : what is perturbed: the frequencies of the "model" at the reference constants, or the "measured"
    n_modes : number of modes with ``source="model"``; as many as were measured, or 10, where left out
    settings : of the swarms
    chains : of the ensembles
    executor, workers : "serial", in this process; "processes", as many as cores or ``workers``, which needs
        the call under ``if __name__ == "__main__":`` in a script; or a Dask cluster, see
        `cpam_bayes.parallel.open_executor`. The answer is the same
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the plate cannot be read, has no unknowns, or measured frequencies are asked for that are missing
        or may lack modes.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> result = cb.sensitivity("A1", levels=[0.01], groups=3, readings=["rms"], executor="serial")
    >>> (cell,) = result.study.cells
    >>> result.status, cell.repetition.constants.shape
    ('converged', (3, 2))
    """
    require_seed(seed)
    require_modes(n_modes)
    require_choice("source", source, get_args(ListSource))
    readings = (readings,) if isinstance(readings, str) else tuple(readings)
    for reading in readings or ("",):
        require_choice("readings", reading, INTERPRETATIONS)
    levels = tuple(levels)
    for level in levels or (0.0,):
        require_number("levels, as fractions", level, MAX_LEVEL)
    require_whole("groups", groups, 2, 1000)
    specimen = require_supported(read_plate(plate), _NO_MESH)
    if not specimen.unknowns.size:
        raise PlateFileError(f"{specimen.source}: [unknowns] is missing, nothing to identify")
    if source == "measured":
        _require_complete(specimen)
        require_reachable(specimen)
        if n_modes is not None:
            raise ValueError(f"--modes: received {n_modes}, accepted: with --list model only")
    total = len(levels) * len(readings) * (groups + 1)

    def described(done: float) -> str:
        return "posteriors first, then inversions" if done < total else "done"

    with (
        watch.stage(f"sensitivity {specimen.name}", total, described) as shown,
        open_executor(executor, workers) as pool,
        explained_failures(specimen),
    ):
        if source == "model":
            specimen = model_list(specimen, n_modes or measured_modes(specimen), shown.notify)
        study = noise_study(
            specimen,
            seed,
            source=source,
            levels=levels,
            groups=groups,
            readings=readings,
            swarm_settings=settings,
            chains=chains,
            executor=pool,
            notify=shown.notify,
            progress=lambda done, _: shown.tick(done, float(done)),
        )
    stated = () if specimen.measurement is None else stated_noise_slips(specimen.measurement)
    slips = (*stated, *reference_slips(specimen))
    return SensitivityResult(
        seed=seed,
        slips=slips,
        warnings=(*slips, *sensitivity_warnings(study)),
        reached_goal=all(cell.posterior.converged for cell in study.cells),
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        study=study,
        table=printed_table(study, perturbation_table(specimen.name)),
    )


def _require_complete(specimen: Specimen) -> None:
    if specimen.measurement is None:
        raise PlateFileError(f"{specimen.source}: [measurement] is missing, which --list measured needs")
    if not specimen.measurement.complete:
        raise PlateFileError(
            f"{specimen.source}: measurement.complete: received false, --list measured adds noise to a list "
            "without gaps only; use --list model"
        )
