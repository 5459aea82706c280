"""Joint identification of several lists: tests of one plate, or plates of one material, share constants."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Constant, Notice, Reliance
from cpam_bayes.forward_model.labels import list_order
from cpam_bayes.forward_model.model import constant_parameters, discretisation_error, plate_problem
from cpam_bayes.forward_model.reduced import ReducedModel, basis_error
from cpam_bayes.forward_model.three_dimensions import theory_bias
from cpam_bayes.identification.density import lists_density, optima_about, sampled
from cpam_bayes.identification.point import reliances, sampled_constants
from cpam_bayes.identification.search import MOST_SWARMS, required, search, shifted
from cpam_bayes.inference.swarm import SwarmSettings
from cpam_bayes.mechanics.modes import Mode
from cpam_bayes.plate import Measurement, Specimen
from cpam_bayes.plate.laminate import flexural_constants
from cpam_bayes.running import single_blas_thread

Array = NDArray[Any]

# Passes of an optimisation: the second evaluates covariances where the first one ended.
_PASSES = 2
# Relative start of an inferred noise.
_USUAL_NOISE = 0.002
# Optima this far below the best log density are not reported.
_DEPTH = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class ListFit:
    """One list of a joint identification.

    constants : (n,) of its specimen at the best optimum, SI
    predicted : one mode for each measured frequency
    rms, alone : root mean square of the relative residuals, here and at the constants that fit this list best
    noise : relative; stated, or at the best optimum where it is inferred
    misfit : factor by which the stated noise was widened, 1 where it explains the list
    error : (n_f,) relative error of the solver there
    laminate : flexural stiffness and constants, SI
    """

    specimen: Specimen
    constants: Array
    predicted: tuple[Mode, ...]
    rms: float
    alone: float
    noise: float
    noise_is_inferred: bool
    misfit: float
    error: Array
    laminate: Mapping[str, float]

    @property
    def measurement(self) -> Measurement:
        """The measured list."""
        return required(self.specimen)[0]


@dataclass(frozen=True, slots=True, eq=False)
class JointEstimate:
    """The constants that several lists share.

    constants : posterior moments and quantiles of the material's constants, SI
    covariance : (n, n) of them
    fits : of the lists, in their order
    optima : (k, n) constants at all optima that carry weight, the best one first
    log_density : (k,) of these
    scatter : relative standard deviation of a constant from specimen to specimen
    effective : number of equally probable draws
    solves : forward solves of the swarms
    """

    constants: tuple[Constant, ...]
    covariance: Array
    fits: tuple[ListFit, ...]
    optima: Array
    log_density: Array
    reliances: tuple[Reliance, ...]
    scatter: float
    effective: float
    solves: int
    seconds: float

    @property
    def n_specimens(self) -> int:
        """Number of specimens, each of which may be under several tests."""
        return len({fit.specimen.specimen for fit in self.fits})


@single_blas_thread
def estimate_jointly(
    specimens: Sequence[Specimen],
    seed: int,
    *,
    scatter: float,
    swarms: int = MOST_SWARMS,
    settings: SwarmSettings | None = None,
    progress: Callable[[int, float], None] | None = None,
    notify: Callable[[str], None] = lambda text: None,
) -> JointEstimate:
    """Constants from several lists, with the priors of the first one.

    Swarms search each list; from their optima derivatives optimise over all lists together.

    specimens : of one material and with the same unknowns, see `require_joint`
    scatter : relative standard deviation of a constant from specimen to specimen
    """
    start, settings = time.perf_counter(), settings or SwarmSettings()
    unknowns = constant_parameters(specimens[0])
    lists: list[tuple[Specimen, ReducedModel]] = []
    at, starts, solves = [], [], 0
    for i, of_file in enumerate(specimens):
        specimen = replace(of_file, unknowns=unknowns)
        found = search(
            specimen,
            seed,
            swarms=swarms,
            settings=settings,
            residual="whitened",
            bias=theory_bias(specimen),
            progress=shifted(progress, i * swarms * settings.iterations),
            notify=notify,
        )
        lists.append((specimen, found.model))
        at.append(found.optima[0].x)
        starts += [optimum.x for optimum in found.optima]
        solves += found.swarm.evaluations
    alone = []
    for (specimen, model), x in zip(lists, at, strict=True):
        f = required(specimen)[0].frequencies
        alone.append(_rms(model.full.predict(x[None]).frequencies[0, list_order(model, x)[: len(f)]], f))
    n, seeds, own = unknowns.size, np.array(starts), np.array(at)
    for _ in range(_PASSES):
        density, misfit = lists_density(lists, own, scatter)
        optima = optima_about(density, seeds, _USUAL_NOISE)
        x = density.scores.to_x(optima.z)
        own = np.concatenate([part.plate_vector(x[:1]) for part in density.model.parts])
        seeds = x[:, :n]
    draws = sampled(density, optima, n)
    relied_on = reliances(unknowns.names, draws.covariance, unknowns.prior_sd)
    kept = optima.value > optima.value[0] - _DEPTH
    amplitudes = [math.nan if column < 0 else float(x[0, column]) for column in density.amplitudes]
    each = zip(lists, own, amplitudes, misfit.tolist(), alone, strict=True)
    return JointEstimate(
        constants=sampled_constants(lists[0][0], draws, relied_on, explained=bool(np.all(misfit == 1.0))),
        covariance=draws.covariance,
        fits=tuple(_fit(*of, *each_list) for of, *each_list in each),
        optima=seeds[kept],
        log_density=optima.value[kept],
        reliances=relied_on,
        scatter=scatter,
        effective=draws.effective,
        solves=solves,
        seconds=time.perf_counter() - start,
    )


def _rms(predicted: Array, measured: Array) -> float:
    """Root mean square of the relative residuals of frequencies (n_f,)."""
    return float(np.sqrt(np.mean((predicted / measured - 1.0) ** 2)))


def _fit(
    specimen: Specimen, model: ReducedModel, constants: Array, amplitude: float, misfit: float, alone: float
) -> ListFit:
    """Fit of a specimen's list at its constants (n,); amplitude : of the noise, nan where it is stated."""
    measurement, unknowns = required(specimen)
    order = list_order(model, constants)[: measurement.size]
    modes = model.full.modes(constants)
    predicted = tuple(modes[j] for j in order)
    error = discretisation_error(model.full, constants) + basis_error(model, constants)[0]
    inferred = math.isfinite(amplitude)
    stated = measurement.noise_sd(measurement.relative_std or 0.0) / measurement.frequencies
    state = plate_problem(specimen, unknowns).state(unknowns.mapping(constants))
    return ListFit(
        specimen=specimen,
        constants=constants,
        predicted=predicted,
        rms=_rms(np.array([mode.frequency for mode in predicted]), measurement.frequencies),
        alone=alone,
        noise=amplitude if inferred else float(np.mean(stated)),
        noise_is_inferred=inferred,
        misfit=misfit,
        error=error[order],
        laminate=flexural_constants(np.real(state.stiffness()), float(state.thickness)),
    )


def require_joint(specimens: Sequence[Specimen]) -> None:
    """Raise ``ValueError`` for plates with different materials or unknowns, or with unknown angles."""
    require_one_material(specimens)
    first = specimens[0]
    for other in specimens:
        if other.plate.layup.n_unknown:
            raise ValueError(
                f"{other.source}: layup {other.plate.layup.text}: received unknown angles, accepted: known "
                "layups where several plates are identified together; identify this plate alone"
            )
        if set(other.unknowns.names) != set(first.unknowns.names):
            raise ValueError(
                f"{other.source}: unknowns: received {', '.join(other.unknowns.names)}, accepted: "
                f"{', '.join(first.unknowns.names)} as in {first.source}; plates identified together "
                "have the same [unknowns]"
            )


def prior_notices(specimens: Sequence[Specimen]) -> tuple[Notice, ...]:
    """Notice if the files give different priors of a constant, of which the first file's holds."""
    first, *others = [constant_parameters(specimen) for specimen in specimens]
    names = tuple(n for n in first.names if any(o[n].prior != first[n].prior for o in others))
    facts = {"names": names, "taken": specimens[0].name}
    return (Notice("differing_priors", facts=facts),) if names else ()


def require_one_material(specimens: Sequence[Specimen]) -> None:
    """Raise ``ValueError`` for plates that cannot share their constants, or of which two are the same."""
    names = [s.name for s in specimens]
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise ValueError(
            f"PLATE: received {twice} twice, accepted: plates of different names; one list counts once"
        )
    first = specimens[0]
    for other in specimens[1:]:
        same = other.material.name == first.material.name
        if not (same and other.material.symmetry == first.material.symmetry):
            raise ValueError(
                f"{other.source}: material {other.material.name or 'not named'}, while {first.name} has "
                f"{first.material.name or 'none named'}; plates that are taken together share their "
                "constants: give plates of one material, with the same material.name"
            )
    for i, other in enumerate(specimens):
        tested = next((s for s in specimens[:i] if s.specimen == other.specimen), None)
        if tested is not None and _sizes(tested) != _sizes(other):
            raise ValueError(
                f"{other.source}: specimen {other.specimen} has other sizes, density or layup than in "
                f"{tested.source}; files of one specimen are tests of one plate: give them the same [plate] "
                "but for the edges, or names of their own to the specimens"
            )


def _sizes(specimen: Specimen) -> tuple[float | str, ...]:
    """Sizes that are the same in all tests of a plate."""
    plate = specimen.plate
    return (plate.length, plate.width, plate.thickness, plate.density, plate.layup.text)
