"""A list that no constants within the bounds come near is refused before any work, with the likely cure."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.errors import PlateFileError
from cpam_bayes.formatting import listed, significant
from cpam_bayes.forward_model.model import NO_PARAMETERS, plate_problem, reference_constants
from cpam_bayes.forward_model.preconditions import likely_cure
from cpam_bayes.mechanics.dense import discretise
from cpam_bayes.mechanics.modes import RigidBodyError, solve
from cpam_bayes.mechanics.spaces.ritz import RitzSettings, ritz_space
from cpam_bayes.plate import Specimen, unit_of
from cpam_bayes.threads import single_blas_thread

__all__ = ["require_reachable"]

Array = NDArray[np.float64]

# A list this many times outside what the bounds reach is refused; one that may lack its first modes, or
# whose labels say which modes it holds, only where it is further away.
_UNREACHABLE, _UNREACHABLE_WITH_GAPS = 3.0, 30.0
# A first frequency so many times below the lowest within the bounds is none of the plate; of unknown angles,
# which have bounds of their own, only the lowest of one layup is known.
_BELOW_ALL, _BELOW_ALL_OF_UNKNOWN_ANGLES = 3.0, 10.0
# Frequencies to a few percent, which is plenty here.
_SETTINGS: Final = RitzSettings(9, 9)


@single_blas_thread
def require_reachable(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if no constants come near its frequencies, or the first.

    Compared are the medians over the list of the logarithms of measured and predicted frequencies, these
    with all unknown moduli at their lower bounds and at their upper ones. Not asked of a mesh, and where
    bending cannot be told from rounding, which others say.
    """
    measurement = specimen.measurement
    if measurement is None or specimen.plate.mesh is not None:
        return specimen
    n = measurement.size
    try:
        reference = _frequencies(specimen, reference_constants(specimen), n)
        low, high = (_frequencies(specimen, _at_bounds(specimen, end), n) for end in ("lower", "upper"))
    except (RigidBodyError, np.linalg.LinAlgError):
        return specimen
    above = float(np.exp(np.median(np.log(low / measurement.frequencies))))
    below = float(np.exp(np.median(np.log(measurement.frequencies / high))))
    with_gaps = not measurement.complete or measurement.names_modes
    limit = _UNREACHABLE_WITH_GAPS if with_gaps else _UNREACHABLE
    if max(above, below) <= limit:
        _require_no_motion_of_the_support(specimen, float(low[0]))
        return specimen
    ratio = float(np.exp(np.median(np.log(reference / measurement.frequencies))))
    span = [significant(float(v), 3) for v in (reference[0], reference[-1])]
    given = [f"{float(v):.6g}" for v in (measurement.frequencies[0], measurement.frequencies[-1])]
    raise PlateFileError(
        f"{specimen.source}: measurement.frequencies_hz: received {' to '.join(dict.fromkeys(given))} Hz, "
        f"where the plate with the constants of [material] has {' to '.join(dict.fromkeys(span))} Hz, "
        f"{significant(ratio, 3)} times as much, and no constants within [unknowns] come near: "
        f"{likely_cure(ratio, weighed=specimen.plate.mass is not None)}"
    )


def _require_no_motion_of_the_support(specimen: Specimen, lowest: float) -> None:
    """Raise `PlateFileError` if the first frequencies are far below any that bends the plate.

    lowest : Hz, the first frequency with all moduli at their lower bounds
    """
    assert specimen.measurement is not None
    f = specimen.measurement.frequencies
    unknown = bool(specimen.plate.layup.n_unknown)
    too_low = f[f < lowest / (_BELOW_ALL_OF_UNKNOWN_ANGLES if unknown else _BELOW_ALL)]
    if not too_low.size:
        return
    n = too_low.size
    many, are, them = (
        (f"the first {n} frequencies", "are", "them") if n > 1 else ("the first frequency", "is", "it")
    )
    received = listed([f"{value:.6g}" for value in too_low], "and")
    motion = "motion of the plate as a rigid body on its support" if "F" in specimen.plate.edges else "hum"
    raise PlateFileError(
        f"{specimen.source}: measurement.frequencies_hz: received {received} Hz, "
        f"where no constants within [unknowns] give this plate a frequency below "
        f"{significant(lowest, 3)} Hz: {many} of the list {are} most likely "
        f"{motion}, which is no mode of the plate; leave {them} out"
    )


def _at_bounds(specimen: Specimen, end: str) -> dict[str, float]:
    """Reference constants with the unknown moduli at one end of their bounds."""
    constants = reference_constants(specimen)
    for name in specimen.unknowns.names:
        if unit_of(name):
            constants[name] = float(getattr(specimen.unknowns[name].prior, end))
    return constants


def _frequencies(specimen: Specimen, constants: dict[str, float], n: int) -> Array:
    """The lowest frequencies of the plate with given constants, roughly, (n,) Hz."""
    material = specimen.material.with_constants(constants)
    layup = specimen.plate.layup
    if layup.n_unknown:
        evenly = np.linspace(-90.0, 90.0, layup.n_unknown + 1)[1:]
        layup = layup.with_angles(evenly)
    plain = replace(specimen, material=material, plate=replace(specimen.plate, layup=layup))
    problem = plate_problem(plain, NO_PARAMETERS)
    operator = discretise(problem, ritz_space(problem.edges, problem.nominal, _SETTINGS), {})
    return np.asarray(solve(operator, *operator.coefficients({}), n).frequencies[0])
