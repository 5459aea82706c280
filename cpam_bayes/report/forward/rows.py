"""Rows of `forward` that its screen and its document share."""

from __future__ import annotations

from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.plate import Specimen


def constants_with_origin(specimen: Specimen) -> list[tuple[str, float, str]]:
    """Name, value in SI and origin of every constant that the plate has."""
    material = specimen.material
    complete = material.complete()
    if material.isotropic:
        origins = dict.fromkeys(("E1", "nu12"), "plate file") | {"G12": "eq. (11)"}
    else:
        origins = dict.fromkeys(complete, "plate file")
        origins |= {"G13": "G12"} if "G13" not in material.constants else {}
        g23 = "G12" if material.symmetry == "orthotropic" else "eq. (6)"
        origins |= {"G23": g23} if "G23" not in material.constants else {}
    return [(name, float(complete[name]), origin) for name, origin in origins.items()]


def measured_of_modes(result: ForwardResult) -> list[float | None]:
    """The measured frequency of every mode, where the list has no gaps."""
    measurement = result.specimen.measurement
    listed: list[float | None] = []
    if measurement is not None and measurement.complete:
        listed += [float(f) for f in measurement.frequencies[: len(result.modes)]]
    return listed + [None] * (len(result.modes) - len(listed))
