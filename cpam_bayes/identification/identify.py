"""Constants of a plate, and unknown ply angles, as a point estimate: the question `identify`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Final, TypeVar

import numpy as np

from cpam_bayes.arguments import checked
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.labels import labelled_model
from cpam_bayes.forward_model.preconditions import (
    exchange_warnings,
    explained_failures,
    require_choice,
    require_paired_list,
    require_seed,
    require_supported,
)
from cpam_bayes.forward_model.reachable import require_reachable
from cpam_bayes.forward_model.slips import (
    common_factor_slips,
    count_slips,
    misfit_slips,
    noise_slips,
    reference_slips,
    stated_noise_slips,
)
from cpam_bayes.identification.angle_search import AngleSearchResult, search_angles
from cpam_bayes.identification.frequency_rows import FrequencyRow
from cpam_bayes.identification.point import PointEstimate, estimate_constants
from cpam_bayes.identification.search import MOST_SWARMS, Optimum, Residual, required
from cpam_bayes.identification.verdicts import MISFIT
from cpam_bayes.identification.warnings import point_warnings
from cpam_bayes.inference.swarm.pso import SwarmResult
from cpam_bayes.inference.swarm.settings import SwarmSettings
from cpam_bayes.plate import PlateLike, Specimen, read_plate
from cpam_bayes.result import SILENT, PlateResult, Watch, within_time

__all__ = ["NO_MESH", "PointResult", "identify"]

Estimate = TypeVar("Estimate")

NO_MESH: Final = (
    "identify computes rectangular plates only; leave mesh out, or compute this plate's frequencies "
    "from its reference constants: forward --solver fem"
)
_RESIDUALS: Final = ("absolute", "relative")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PointResult(PlateResult):
    """Point estimates of the constants by the particle swarm.

    Attributes
    ----------
    specimen : with the angles that were found, where some were unknown
    estimate : the constants with their linearised standard deviations, the fit, the swarm
    residual : what was minimised, "absolute" or "relative" differences of frequencies
    angles : the search of the unknown angles, None where all were known
    """

    question: ClassVar[str] = "identification"
    command: ClassVar[str] = "identify"

    estimate: PointEstimate
    residual: Residual
    angles: AngleSearchResult | None = None

    @property
    def status(self) -> str:
        """Whether two swarms found the best optimum, "converged", or not, "budget".

        A single swarm has converged when its particles agree. Where angles were unknown, their search has to
        have converged too.
        """
        return self._decisive.status

    @property
    def message(self) -> str:
        """The status in a sentence."""
        return self._decisive.message

    @property
    def _decisive(self) -> SwarmResult:
        """The search that the status is of."""
        constants = self.estimate.swarm
        return constants if self.angles is None or constants.status != "converged" else self.angles.swarm

    @property
    def constants(self) -> dict[str, float]:
        """Name -> point estimate, Pa or dimensionless."""
        return {c.name: c.value for c in self.estimate.constants}

    @property
    def optima(self) -> tuple[tuple[Optimum, dict[str, float]], ...]:
        """The best optimum and those that the noise does not tell from it, with their constants, SI."""
        names = [c.name for c in self.estimate.constants]
        return tuple((o, dict(zip(names, o.x.tolist(), strict=True))) for o in self.estimate.optima)

    def rms_of_optima(self) -> list[float]:
        """Root mean square of the relative residuals at every optimum."""
        if len(self.optima) < 2:
            return [self.estimate.rms] * len(self.optima)
        measurement, _ = required(self.specimen)
        model = labelled_model(self.estimate.model, measurement, self.specimen)
        predicted = model.predict(np.array([optimum.x for optimum, _ in self.optima])).frequencies
        residuals = predicted / measurement.frequencies - 1.0
        return [float(rms) for rms in np.sqrt(np.mean(residuals**2, axis=1))]

    @property
    def frequencies(self) -> tuple[FrequencyRow, ...]:
        """Measured and predicted frequencies, one row each."""
        measurement, _ = required(self.specimen)
        return tuple(
            FrequencyRow(float(f), mode.frequency, mode.frequency / float(f) - 1.0, mode.kind, mode.label)
            for f, mode in zip(measurement.frequencies, self.estimate.predicted, strict=True)
        )


@checked
@within_time
def identify(
    plate: PlateLike,
    *,
    seed: int = 0,
    residual: Residual = "absolute",
    swarms: int = MOST_SWARMS,
    settings: SwarmSettings | None = None,
    watch: Watch = SILENT,
) -> PointResult:
    """Elastic constants of a plate by particle swarms, eq. (1), (2) and (7), polished by derivatives.

    A single swarm may agree on a wrong optimum. Swarms are therefore run until two of them have found the
    best optimum of all; the others that the noise does not tell from it are listed. Unknown ply angles are
    searched with the constants by fuzzy swarms, eq. (3) to (5), in the same way, and then kept.

    Parameters
    ----------
    plate : what `read_plate` takes, or what it returns
    residual : what is minimised: squared "absolute" differences of frequencies in Hz, or "relative" ones
    swarms : swarms at most, three at least; 1 is the paper's single swarm as it ends, not polished
    settings : particles, iterations and weights of each swarm
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the plate cannot be read, has no measured frequencies or no unknowns, may lack modes
        (``complete = false``), or if no particle of the initial swarm is feasible.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> point = cb.identify("A1", seed=0)
    >>> point.status, round(point.constants["E1"] / 1e9)
    ('converged', 67)
    """
    require_seed(seed)
    require_choice("residual", residual, _RESIDUALS)
    if swarms < 1:
        raise ValueError(f"swarms: received {swarms}, accepted: 1 or more")
    specimen = require_paired_list(require_supported(read_plate(plate), NO_MESH, angles=True))
    measurement, _ = required(specimen)
    require_reachable(specimen)
    settings = settings or SwarmSettings()
    unit, factor = ("%", 100.0) if residual == "relative" else ("Hz", 1.0)

    def described(value: float) -> str:
        return f"rms misfit {factor * math.sqrt(value / measurement.size):.4g} {unit}"

    def watched(search: Callable[..., Estimate], of: Specimen, title: str, total: int) -> Estimate:
        with watch.stage(f"{title} {of.name}", total, described) as shown:
            return search(
                of, seed, settings=settings, residual=residual, progress=shown.tick, notify=shown.notify
            )

    exchange = exchange_warnings(specimen)
    angles: AngleSearchResult | None = None
    with explained_failures(specimen):
        if specimen.plate.layup.n_unknown:
            search = partial(search_angles, swarms=swarms)
            angles = watched(search, specimen, "angles of", swarms * settings.iterations)
            specimen = angles.known
        estimate = watched(
            partial(estimate_constants, swarms=swarms), specimen, "identify", swarms * settings.iterations
        )
    misfit = estimate.noise if estimate.noise_is_inferred else estimate.rms
    n, k = len(estimate.predicted), len(estimate.constants)
    unsure = () if angles is None or angles.swarm.status != "budget" else (angles.swarm.message,)
    residuals = np.array([mode.frequency for mode in estimate.predicted]) / measurement.frequencies - 1.0
    excess = misfit_slips(misfit) or noise_slips(measurement, residuals, k)
    determined = {
        c.name: (c.value, c.sd)
        for c in estimate.constants
        if c.verdict in ("determined by the data", MISFIT) and not c.elsewhere
    }
    slips = (
        *stated_noise_slips(measurement),
        *count_slips(n, k),
        *excess,
        *common_factor_slips(specimen, determined),
        *reference_slips(specimen),
    )
    return PointResult(
        seed=seed,
        warnings=(*slips, *unsure, *point_warnings(estimate, residual), *exchange),
        slips=slips,
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        estimate=estimate,
        residual=residual,
        angles=angles,
    )
