"""The plates that are timed, and the frequencies with which every solver is compared."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import cpam_bayes as cb
from cpam_bayes.forward_model.model import angle_parameters, plate_problem
from cpam_bayes.mechanics.convergence import Tolerance, rich_frequencies
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Sensor, Specimen
from cpam_bayes.plate.laminate import ENERGY_CONSISTENT, FIVE_SIXTHS, ShearModel

Array = NDArray[np.float64]

# Frequencies on which independent solvers agree with A_s = 5/6 of the ply moduli, Hz.
REFERENCE = {
    "C1": (100.366, 298.584, 324.574, 360.347, 381.139, 600.611),
    "D1": (
        *(1351.155, 3015.301, 3150.239, 4044.149, 4055.798),
        *(6775.498, 8143.114, 8273.099, 8849.348, 9154.067),
    ),
}
# Relative accuracy to which they are known.
_REFERENCE_DIGITS = 1e-5
_RICH = Tolerance(kept=1e-5, rich=3e-6, largest_degree=30)


@dataclass(frozen=True, slots=True)
class Case:
    """A plate, its number of modes and what varies in it.

    any_layup : all ply angles are unknown. mass : kg, in the corner x = length, y = width.
    """

    name: str
    plate: str
    n_modes: int
    any_layup: bool = False
    mass: float = 0.0

    @property
    def is_bare(self) -> bool:
        """Whether it is a plate of the paper as it stands, which the other solvers are given too."""
        return self.name == self.plate

    def specimen(self) -> Specimen:
        """The specimen, with unknown angles if any layup is to be solved."""
        found = cb.read_plate(self.plate)
        if self.any_layup:
            found = found.with_unknown_angles()
        if not self.mass:
            return found
        corner = Sensor(self.mass, found.plate.length, found.plate.width)
        return replace(found, sensors=(*found.sensors, corner))

    def known(self) -> Specimen:
        """The specimen with the paper's layup."""
        return replace(self, any_layup=False).specimen()


CASES = (
    Case("C1", "C1", 6),
    Case("D1", "D1", 10),
    Case("C1, any layup", "C1", 6, any_layup=True),
    Case("C1, mass in a corner", "C1", 6, mass=0.005),
)


@dataclass(frozen=True, slots=True)
class Converged:
    """Frequencies of a rich space, (n_modes,) Hz, and their largest relative error.

    energy_consistent, five_sixths : by the derivation of the transverse shear stiffness from the plies.
    """

    energy_consistent: Array
    five_sixths: Array
    error: float


def converged(case: Case) -> Converged:
    """Converged frequencies of the reference plate.

    Raises ``RuntimeError`` where they differ from those on which independent solvers agree.
    """
    consistent, consistent_error = _rich(case, ENERGY_CONSISTENT)
    uniform, uniform_error = _rich(case, FIVE_SIXTHS)
    if case.name in REFERENCE:
        distance = worst_error(uniform, np.array(REFERENCE[case.name]))
        if distance > _REFERENCE_DIGITS:
            raise RuntimeError(
                f"{case.name}: our converged frequencies are {distance:.1e} off the reference ones, "
                f"accepted: {_REFERENCE_DIGITS:.0e}"
            )
    return Converged(consistent, uniform, max(consistent_error, uniform_error))


def _rich(case: Case, shear: ShearModel) -> tuple[Array, float]:
    found = rich_frequencies(plate_problem(case.known(), shear=shear), {}, case.n_modes, _RICH)
    return found.frequencies[0], float(found.error.max())


def worst_error(frequencies: Array, reference: Array) -> float:
    """Largest relative difference of two lists of frequencies."""
    return float(np.max(np.abs(frequencies / reference - 1.0)))


def parameters(specimen: Specimen) -> ParameterSet:
    """All unknowns of a specimen: its constants and its angles."""
    return specimen.unknowns.union(angle_parameters(specimen))


def reference_vector(case: Case) -> Array:
    """Parameter vector of the plate as the paper gives it."""
    specimen, known = case.specimen(), case.known().plate.layup
    values: dict[str, Any] = dict(specimen.material.complete())
    layup = specimen.plate.layup
    for k, name in enumerate(layup.unknown_names):
        values[name] = known.angles_deg[np.argmax(layup.unknown_index == k)]
    return np.asarray(parameters(specimen).vector(values), dtype=float)
