"""What a plate file may say and this version does not compute: refused, never left aside."""

from __future__ import annotations

from cpam_bayes.errors import PlateFileError
from cpam_bayes.measurement import Specimen
from cpam_bayes.modes import RigidBodyError

__all__ = ["require_paired_list", "require_supported", "solver_failure"]

# Longer side over thickness from which a failure is blamed on the thickness.
_THIN = 300.0


def require_supported(specimen: Specimen, no_mesh: str | None) -> Specimen:
    """Return the specimen, or raise `PlateFileError` with all that cannot be computed yet.

    no_mesh : what to say to a plate with a mesh, None where meshes are computed
    """
    plate, problems = specimen.plate, []
    if plate.mesh is not None and no_mesh is not None:
        problems.append(f"plate.mesh: received {plate.mesh}, {no_mesh}")
    if specimen.air_density is not None:
        problems.append(
            f"environment.air_density_kg_m3: received {specimen.air_density:g}, this version "
            "computes plates in vacuum only; leave air_density_kg_m3 out"
        )
    if plate.layup.n_unknown:
        problems.append(
            f"plate.layup: received {plate.layup.text}, {plate.layup.n_unknown} of its angles are "
            'unknown; a known layup is needed, write the angles for "?"'
        )
    _raise(specimen, problems)
    return specimen


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


def solver_failure(specimen: Specimen, error: RigidBodyError) -> ValueError:
    """Say what a user can do where the solver cannot tell bending from rounding."""
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
