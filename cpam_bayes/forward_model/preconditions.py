"""What a plate file says beyond what can be computed or believed: refused, or warned of."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.errors import PlateFileError
from cpam_bayes.formatting import significant
from cpam_bayes.mechanics.modes import RigidBodyError
from cpam_bayes.parameters import ParameterSet
from cpam_bayes.plate import Material, Specimen
from cpam_bayes.plate.units import joined_name

MAX_MODES = 100
"""Modes of a plate that are computed at most."""

SUSPICIOUS_RATIO = 3.0
"""Prediction over measurement beyond which a unit in the plate file is suspected."""

# Longer side over thickness from which a failure is blamed on the thickness.
_THIN = 300.0

# Prediction over measurement -> the slips that make it so. A frequency goes as h / sqrt(density) or, of a
# plate that was weighed, as h sqrt(h / mass): what a wrong thickness does differs.
_CURES: Final = (
    (1000.0, "frequencies in kHz for Hz, or sizes in m for mm"),
    (31.6, "a mass in kg for g, a density in g/cm3 for kg/m3, or constants in MPa for GPa"),
    (25.4, "sizes in inches for mm"),
    (10.0, "sizes in cm for mm, or a thickness 10 times too large"),
    (1.0 / (2.0 * math.pi), "frequencies in rad/s for Hz"),
    (1.0 / 10.0, "a thickness 10 times too small, as of cm for mm"),
    (1.0 / 31.6, "constants in TPa for GPa"),
    (1.0 / 1000.0, "frequencies in mHz for Hz, or sizes in um for mm"),
)
_CURES_OF_A_WEIGHED: Final = (
    (1000.0, "frequencies in kHz for Hz"),
    (31.6, "a thickness 10 times too large, a mass in kg for g, or constants in MPa for GPa"),
    (25.4, "sizes in inches for mm"),
    (1.0 / (2.0 * math.pi), "frequencies in rad/s for Hz"),
    (
        1.0 / 31.6,
        "a thickness 10 times too small, as of cm for mm, a mass 1000 times too large, or constants in TPa "
        "for GPa",
    ),
    (1.0 / 1000.0, "frequencies in mHz for Hz"),
)
# How far from it a ratio may be.
_NEAR = 1.35


def require_supported(
    specimen: Specimen, no_mesh: str | None, no_air: str | None = None, *, angles: bool = False
) -> Specimen:
    """Return the specimen, or raise `PlateFileError` with all that cannot be computed yet.

    no_mesh : what to say to a plate with a mesh, None where meshes are computed.
    no_air : what to say to air in the plate file, None where it is part of the model.
    angles : whether some may be unknown, if the list has no labels.
    """
    problems = _not_computed(specimen, no_mesh, no_air)
    problems += _angles_asked(specimen) if angles else _unknown_angles(specimen)
    _raise(specimen, problems)
    return specimen


def require_diagnosable(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if what is wrong with it cannot be asked for."""
    no_mesh = "diagnose computes rectangular plates only; leave mesh out"
    problems = [*_not_computed(specimen, no_mesh), *_named_plies(specimen), *_unknown_angles(specimen)]
    if specimen.measurement is None:
        problems.append("[measurement] is missing, nothing to be compared with the model")
    if not specimen.unknowns.size:
        problems.append("[unknowns] is missing; name the constants that may differ from [material]")
    _raise(specimen, problems)
    return specimen


def require_sequence(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if its sequence cannot be asked for."""
    problems = _not_computed(specimen, "sequence computes rectangular plates only; leave mesh out")
    problems += _named_plies(specimen)
    if not specimen.plate.layup.n_unknown:
        problems.append(
            f'plate.layup: received {specimen.plate.layup.text}, none of its angles is "?"; write "?" for '
            "the unknown ones"
        )
    if specimen.measurement is None:
        problems.append("[measurement] is missing, nothing to tell the sequences apart by")
    problems += _angles_asked(specimen)
    if not specimen.unknowns.size:
        problems.append("[unknowns] is missing, the constants must be free within bounds")
    _raise(specimen, problems)
    return specimen


def _not_computed(specimen: Specimen, no_mesh: str | None, no_air: str | None = None) -> list[str]:
    problems = []
    mesh, air = specimen.plate.mesh, specimen.air_density
    if mesh is not None and no_mesh is not None:
        problems.append(f"plate.mesh: received {mesh}, {no_mesh}")
    if air and mesh is not None and no_mesh is None:
        no_air = "the air about a plate with a mesh is not computed; leave air_density_kg_m3 out"
    if air and no_air is not None:
        problems.append(f"environment.air_density_kg_m3: received {air:g}, {no_air}")
    return problems


def _named_plies(specimen: Specimen) -> list[str]:
    """Why plies of several materials or thicknesses cannot be asked about, if there are some."""
    layup = specimen.plate.layup
    if not layup.kinds:
        return []
    return [
        f"plate.layup: received {layup.text} with tables [[ply]], accepted: equal plies of one material; "
        "`forward`, `identify` and `export` take plies of several"
    ]


def _angles_asked(specimen: Specimen) -> list[str]:
    """Why unknown angles cannot be asked for, if there are some."""
    layup, measurement = specimen.plate.layup, specimen.measurement
    problems: list[str] = []
    if layup.n_unknown and specimen.material.isotropic:
        problems.append(
            f"plate.layup: received {layup.text}, the material is isotropic, which has no ply angles; leave "
            "layup out"
        )
    if layup.n_unknown and measurement is not None and measurement.names_modes:
        problems.append(
            f"measurement.{'shapes' if measurement.shapes else 'labels'}: received beside unknown angles, "
            "which pair frequencies with modes in ascending order; leave them out"
        )
    return problems


def _unknown_angles(specimen: Specimen) -> list[str]:
    layup = specimen.plate.layup
    if not layup.n_unknown:
        return []
    return [
        f"plate.layup: received {layup.text}, unknown angles: {layup.n_unknown}; a known layup is needed, "
        'write the angles for "?", or let `sequence` or `identify --backend pso` find them'
    ]


def require_paired_list(specimen: Specimen) -> Specimen:
    """Return the specimen, or raise `PlateFileError` if its list may lack modes."""
    if specimen.measurement is not None and not specimen.measurement.complete:
        _raise(
            specimen,
            [
                "measurement.complete: received false, this version pairs the first model mode "
                "with the first frequency and so on; use --backend emcee, which sums over all pairings"
            ],
        )
    return specimen


def exchange_warnings(specimen: Specimen) -> tuple[str, ...]:
    """A warning where no frequency tells the two axes of orthotropic plies apart.

    Exchanging them turns every ply by 90 degrees: to other angles, where these are unknown, or to the same
    plate, if it is square with four equal edges.
    """
    plate, unknowns, measurement = specimen.plate, specimen.unknowns, specimen.measurement
    square = plate.length == plate.width and len(set(plate.edges)) == 1
    turnable = square or bool(np.all(plate.layup.unknown_index >= 0))
    labelled = measurement is not None and measurement.names_modes
    if (
        labelled
        or specimen.sensors
        or not turnable
        or not all(_exchangeable(name, part, unknowns) for name, part in specimen.material.parts.items())
    ):
        return ()
    why = "the plate is square with four equal edges" if square else "ply angles are unknown"
    return (
        f"E1 and E2 can change places without a change of any frequency, as {why}: the answer is one of two; "
        f"give them bounds in [unknowns] that do not overlap{', or label the modes' if square else ''}",
    )


def _exchangeable(name: str, material: Material, unknowns: ParameterSet) -> bool:
    """Whether the two axes of a material can change places within the bounds."""
    e1, e2, nu12 = (joined_name(name, constant) for constant in ("E1", "E2", "nu12"))
    if material.symmetry != "orthotropic" or not {e1, e2, nu12} <= set(unknowns.names):
        return False
    first, second = unknowns[e1].prior, unknowns[e2].prior
    return max(first.lower, second.lower) < min(first.upper, second.upper)


def require_choice(name: str, value: object, accepted: Sequence[str]) -> None:
    """Raise ``ValueError`` where an argument is none of the words that are accepted."""
    if value not in accepted:
        raise ValueError(f"{name}: received {value!r}, accepted: {' '.join(accepted)}")


def require_whole(name: str, value: object, low: int, high: int) -> None:
    """Raise ``ValueError`` where an argument is no whole number from ``low`` to ``high``."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise ValueError(f"{name}: received {value!r}, accepted: a whole number from {low} to {high}")


def require_seed(seed: object) -> None:
    """Raise ``ValueError`` where a seed cannot repeat an answer."""
    require_whole("seed", seed, 0, 2**63 - 1)


def require_modes(n_modes: object) -> None:
    """Raise ``ValueError`` where a number of modes is given that is not computed."""
    if n_modes is not None:
        require_whole("n_modes", n_modes, 1, MAX_MODES)


def require_number(name: str, value: object, most: float) -> None:
    """Raise ``ValueError`` where an argument is no number above 0 and at most ``most``."""
    real = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not (real and 0.0 < float(value) <= most):  # type: ignore[arg-type]
        raise ValueError(f"{name}: received {value!r}, accepted: a number above 0 and at most {most:g}")


@contextmanager
def explained_failures(specimen: Specimen) -> Iterator[None]:
    """Say what a user can do where the solver cannot tell bending from rounding.

    Raises ``PlateFileError`` instead of the solver's ``RigidBodyError``.
    """
    try:
        yield
    except RigidBodyError as error:
        raise _solver_failure(specimen, error) from error


def likely_cure(ratio: float, *, weighed: bool) -> str:
    """What slip of units makes predicted frequencies so many times the measured ones.

    weighed : whether the plate file has a mass, and the density follows from it
    """
    cures = _CURES_OF_A_WEIGHED if weighed else _CURES
    likely = [text for value, text in cures if 1.0 / _NEAR < ratio / value < _NEAR]
    if not likely:  # constants may be far from their reference too
        nearest = min(cures, key=lambda cure: abs(math.log(ratio / cure[0])))
        likely = [nearest[1]] if abs(math.log(ratio / nearest[0])) < math.log(2.5) else []
    if not likely:
        return "check the units of sizes, mass or density, constants and frequencies, and the edges"
    return f"the likely slip is {likely[0]}; check the units of the plate file"


def units_warning(ratio: NDArray[np.float64], where: str = "", *, weighed: bool) -> list[str]:
    """A warning where a predicted frequency is not even of the size of the measured one.

    ratio : predicted over measured frequencies.
    weighed : as `likely_cure`
    where : at which constants, with a space before.
    """
    worst = float(ratio[np.argmax(np.abs(np.log(ratio)))])
    if 1 / SUSPICIOUS_RATIO <= worst <= SUSPICIOUS_RATIO:
        return []
    return [
        f"a predicted frequency is {significant(worst, 3)} times the measured one{where}: "
        f"{likely_cure(float(np.median(ratio)), weighed=weighed)}"
    ]


def _solver_failure(specimen: Specimen, error: RigidBodyError) -> ValueError:
    plate = specimen.plate
    ratio = max(plate.length, plate.width) / plate.thickness
    if ratio < _THIN:
        return PlateFileError(
            f"{specimen.source}: the plate solver cannot tell bending from rounding; check [plate] and "
            f"[material] for slips of units ({error})"
        )
    return PlateFileError(
        f"{specimen.source}: plate.thickness_mm: received {plate.thickness * 1e3:g}, 1/{ratio:.0f} "
        f"of the longer side, too thin for the plate solver; check its unit"
    )


def _raise(specimen: Specimen, problems: list[str]) -> None:
    if problems:
        raise PlateFileError(*(f"{specimen.source}: {problem}" for problem in problems))
