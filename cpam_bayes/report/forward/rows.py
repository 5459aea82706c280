"""Rows of `forward` that its screen and its document share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cpam_bayes.forward_model.labels import modes_of_labels
from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.mechanics.shapes import Mode
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


@dataclass(frozen=True, slots=True)
class MeasuredFrequency:
    """A measured frequency beside a mode, Hz; by_label : by its label, or else by its place in the list."""

    hz: float
    by_label: bool


def measured_of_modes(specimen: Specimen, modes: Sequence[Mode]) -> list[MeasuredFrequency | None]:
    """The measured frequency of every mode: by its label, the others in order where the list has no gaps."""
    found: list[MeasuredFrequency | None] = [None] * len(modes)
    measurement = specimen.measurement
    if measurement is None:
        return found
    for i, j in modes_of_labels(measurement.labels, modes).items():
        found[j] = MeasuredFrequency(float(measurement.frequencies[i]), by_label=True)
    if not measurement.complete:
        return found
    left = (j for j, taken in enumerate(found) if taken is None)
    plain = (f for f, label in zip(measurement.frequencies, measurement.labels, strict=True) if not label)
    for j, f in zip([*left], plain, strict=False):
        found[j] = MeasuredFrequency(float(f), by_label=False)
    return found


def list_is_paired(result: ForwardResult) -> bool:
    """Whether measured frequencies stand beside modes: by labels, or in a list without gaps."""
    measurement = result.specimen.measurement
    return measurement is None or measurement.complete or all(measurement.labels)
