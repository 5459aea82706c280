"""Frequencies of another plate of the same material from a stored posterior: the question `predict`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.arguments import checked
from cpam_bayes.errors import PlateFileError
from cpam_bayes.formatting import listed
from cpam_bayes.forward_model.air_shift import air_shifts
from cpam_bayes.forward_model.model import SIZES, size_parameters
from cpam_bayes.forward_model.preconditions import (
    explained_failures,
    require_modes,
    require_seed,
    require_supported,
    require_whole,
)
from cpam_bayes.forward_model.solve import error_warning, measured_modes
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import PlateLike, Specimen, read_plate, to_user, unit_of, user_name
from cpam_bayes.prediction.stored_posterior import PosteriorLike, StoredPosterior, read_posterior
from cpam_bayes.result import SILENT, PlateResult, Watch
from cpam_bayes.threads import single_blas_thread

__all__ = ["PredictedMode", "PredictionResult", "predict"]

Array = NDArray[Any]

MAX_DRAWS: Final = 20_000
DEFAULT_DRAWS: Final = 1000
_NO_MESH = "predict computes rectangular plates only; leave mesh out"
# Least relative range of a parameter that a model is built over.
_LEAST_RANGE = 1e-6
# A constant that is held at another value than in the posterior is told from this relative difference on.
_SAME = 1e-6
# A size that is measured again may differ by so many standard deviations.
_FAR_SD = 5.0


@dataclass(frozen=True, slots=True)
class PredictedMode:
    """The frequency of one mode over the draws of the posterior.

    mode : frequency (Hz), kind and label at the mean constants
    mean, sd, q025, q975 : of the natural frequency, Hz
    measured_q025, measured_q975 : where a measurement would lie, the noise of the posterior added, Hz
    """

    mode: Mode
    mean: float
    sd: float
    q025: float
    q975: float
    measured_q025: float
    measured_q975: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PredictionResult(PlateResult):
    """Frequencies of a plate, predicted from the posterior of another.

    Attributes
    ----------
    posterior : the draws that were used
    modes : the lowest modes, ascending
    frequencies : (n_draws, n_modes) natural frequencies of the draws, Hz
    shapes : (n_modes, 3, n, n), u, v and w on a regular grid at the mean constants
    error : (n_modes,) estimated relative error of the solver
    sizes_of_posterior : whether the sizes are those of the draws, as of another test of the same plate
    seconds : wall clock
    """

    question: ClassVar[str] = "prediction"
    command: ClassVar[str] = "predict"

    posterior: StoredPosterior
    modes: tuple[PredictedMode, ...]
    frequencies: Array
    shapes: Array
    error: Array
    sizes_of_posterior: bool
    seconds: float


@checked
@single_blas_thread
def predict(
    posterior: PosteriorLike,
    plate: PlateLike,
    n_modes: int | None = None,
    *,
    draws: int = DEFAULT_DRAWS,
    seed: int = 0,
    watch: Watch = SILENT,
) -> PredictionResult:
    """Frequencies of a plate of another size, layup or edges, from the posterior of its material.

    Every draw of the constants is carried through the plate's model: p(f | data) = integral of
    p(f | constants) p(constants | data). Constants that did not vary in the posterior are those of the
    plate's [material]. Sizes with a standard deviation in [plate.sd] vary by it; those of the plate that was
    measured, known by its `specimen`, are the sizes of the draws.

    Parameters
    ----------
    posterior : the path of a ``posterior.nc``, or what `sample` returns
    plate : what `read_plate` takes, or what it returns
    n_modes : number of modes; as many as were measured, or 10, where left out
    draws : draws of the posterior at most, at even distances
    watch : is shown the progress

    Raises
    ------
    ValueError
        If the posterior or the plate cannot be read, or they are of different kinds of material.

    Examples
    --------
    >>> import cpam_bayes as cb
    >>> post = cb.sample("A1", seed=0)
    >>> first = cb.predict(post, "A2", n_modes=1).modes[0]
    >>> print(first.q025 < first.mean < first.q975, first.mode.kind)
    True bending
    """
    require_seed(seed)
    require_modes(n_modes)
    require_whole("draws", draws, 2, MAX_DRAWS)
    specimen = require_supported(read_plate(plate), _NO_MESH)
    stored = read_posterior(posterior).thinned(draws)
    _require_same_kind(specimen, stored)
    watch.announce(f"predict {specimen.name} from {stored.source}: {stored.size} draws")
    with explained_failures(specimen):
        return _predicted(specimen, stored, n_modes or measured_modes(specimen), seed, watch.announce)


def _predicted(
    specimen: Specimen, stored: StoredPosterior, n_modes: int, seed: int, notify: Callable[[str], None]
) -> PredictionResult:
    start = time.perf_counter()
    rng = np.random.default_rng(seed)
    same_name = bool(stored.sizes) and stored.specimen == specimen.specimen
    differing = _differing_sizes(specimen, stored) if same_name else ()
    same_plate = same_name and not differing
    drawn = {name: stored.draws[name] for name in stored.constants}
    drawn |= _sizes(specimen, stored, same_plate, rng)
    possible = specimen.material.admissible(drawn)
    if np.count_nonzero(possible) < 2:
        raise ValueError(
            f"{specimen.source}: no draw of {stored.source} is a material that can be, with the other "
            "constants of [material]; give the ones that were held there"
        )
    parameters = ParameterSet(tuple(_over(name, values) for name, values in drawn.items()))
    x = parameters.vector(drawn)[possible]
    centre = x.mean(axis=0)
    model = reduced_model(specimen, parameters, n_modes, centre=centre, notify=notify)
    f = model.predict(x).frequencies
    described = model.full.modes(centre)
    error = model.full.error
    return PredictionResult(
        seed=seed,
        warnings=(*differing, *_warnings(specimen, stored), *error_warning(error)),
        specimen=specimen,
        air_shifts=air_shifts(specimen),
        posterior=stored,
        modes=_modes(described, f, _measured(f, stored, possible, rng)),
        frequencies=f,
        shapes=model.full.shapes(centre),
        error=error,
        sizes_of_posterior=same_plate,
        seconds=time.perf_counter() - start,
    )


def _differing_sizes(specimen: Specimen, stored: StoredPosterior) -> tuple[str, ...]:
    """Why the plate is not the one that was measured, whose name it has."""
    far = []
    for name, there in stored.outline.items():
        here = float(getattr(specimen.plate, name))
        if abs(here - there) > _FAR_SD * specimen.plate.sd.get(name, 0.0) + _SAME * there:
            far.append(f"{user_name(name)} {to_user(name, here):.5g} instead of {to_user(name, there):.5g}")
    if not far:
        return ()
    return (
        f"{specimen.name} has the name of the plate that was measured and other sizes, {', '.join(far)}: its "
        "sizes are taken from its file; give it a `specimen` of its own",
    )


def _sizes(
    specimen: Specimen, stored: StoredPosterior, same_plate: bool, rng: np.random.Generator
) -> dict[str, Array]:
    """Draws of the plate's sizes that are not known exactly, SI."""
    if same_plate:
        return {name: stored.draws[name] for name in stored.sizes}
    return {p.name: p.prior.sample(rng, stored.size) for p in size_parameters(specimen).parameters}


def _over(name: str, values: Array) -> Parameter:
    """A parameter over the range of its draws."""
    low, high = float(values.min()), float(values.max())
    room = _LEAST_RANGE * max(abs(low), abs(high))
    return Parameter(name, SIZES.get(name, ""), Uniform(low - room, high + room))


def _measured(f: Array, stored: StoredPosterior, possible: Array, rng: np.random.Generator) -> Array:
    """Frequencies (n_draws, n_modes) as they would be measured with the noise of the posterior, Hz."""
    z = rng.standard_normal(f.shape)
    if "absolute_sd" in stored.draws:
        return np.asarray(f + stored.draws["absolute_sd"][possible, None] * z)
    relative = stored.draws.get("relative_std")
    level = (stored.repeatability or 0.0) if relative is None else relative[possible, None]
    return np.asarray(f * (1.0 + level * z))


def _modes(described: tuple[Mode, ...], f: Array, measured: Array) -> tuple[PredictedMode, ...]:
    mean, sd = f.mean(axis=0), f.std(axis=0, ddof=1)
    low, high = np.quantile(f, (0.025, 0.975), axis=0)
    lower, upper = np.quantile(measured, (0.025, 0.975), axis=0)
    columns = (mean, sd, low, high, lower, upper)
    return tuple(
        PredictedMode(mode, *(float(column[k]) for column in columns)) for k, mode in enumerate(described)
    )


def _require_same_kind(specimen: Specimen, stored: StoredPosterior) -> None:
    """Refuse a plate whose material is of another kind than that of the posterior."""
    symmetry = specimen.material.symmetry
    foreign = [name for name in stored.constants if name not in specimen.material.constants]
    foreign = [name for name in foreign if name not in ("G13", "G23") or symmetry == "isotropic"]
    other = bool(stored.symmetry) and stored.symmetry != symmetry
    if not (other or foreign):
        return
    of = stored.symmetry or f"with {listed(stored.constants, 'and')}"
    raise PlateFileError(
        f"{specimen.source}: the material is {symmetry}, that of {stored.source} is {of}; a posterior says "
        "nothing of another kind of material: give [material] the same symmetry"
    )


def _warnings(specimen: Specimen, stored: StoredPosterior) -> list[str]:
    """Constants that were held at other values than this plate has."""
    values = specimen.material.complete()
    differing = [
        f"{name} {to_user(name, value):.5g} there and {to_user(name, float(values[name])):.5g} "
        f"{unit_of(name)} here".replace("  ", " ")
        for name, value in stored.held.items()
        if abs(float(values[name]) / value - 1.0) > _SAME
    ]
    if not differing:
        return []
    return [
        f"constants that the posterior held fixed have other values in the plate file: "
        f"{listed(differing, 'and')}; the draws were fitted with those there"
    ]
