"""Rows of `forward` that its screen and its document share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from cpam_bayes.forward_model.labels import modes_of_labels
from cpam_bayes.forward_model.mode_shapes.assurance import ShapePairing
from cpam_bayes.forward_model.solve import ForwardResult
from cpam_bayes.mechanics.shapes import Mode
from cpam_bayes.plate import Material, Specimen
from cpam_bayes.plate.units import joined_name


def constants_with_origin(specimen: Specimen) -> list[tuple[str, float, str]]:
    """Name, value in SI and origin of every constant that the plate has."""
    return [
        (joined_name(of, name), value, origin)
        for of, part in specimen.material.parts.items()
        for name, value, origin in _of_material(part)
    ]


def _of_material(material: Material) -> list[tuple[str, float, str]]:
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
    """A measured frequency beside a mode, Hz; by : its shape, its label, or its place in the list."""

    hz: float
    by: Literal["shape", "label", "order"]


def measured_of_modes(
    specimen: Specimen, modes: Sequence[Mode], by_shape: ShapePairing | None = None
) -> list[MeasuredFrequency | None]:
    """The measured frequency of every mode, by shape or label, the others in order.

    Those of a list with gaps stand beside a mode by shape or label alone.

    by_shape : what measured shapes say of these modes; where this is not known, they are beside none
    """
    found: list[MeasuredFrequency | None] = [None] * len(modes)
    measurement = specimen.measurement
    if measurement is None or (measurement.shapes is not None and by_shape is None):
        return found
    known = modes_of_labels(measurement.labels, modes)
    if by_shape is not None:
        known = {i: int(j) for i, j in enumerate(by_shape.modes) if j >= 0}
    for i, j in known.items():
        hz = float(measurement.frequencies[i])
        found[j] = MeasuredFrequency(hz, "label" if by_shape is None else "shape")
    if not measurement.complete:
        return found
    left = (j for j, taken in enumerate(found) if taken is None)
    plain = (
        f
        for i, (f, label) in enumerate(zip(measurement.frequencies, measurement.labels, strict=True))
        if not label and i not in known
    )
    for j, f in zip([*left], plain, strict=False):
        found[j] = MeasuredFrequency(float(f), "order")
    return found


def list_is_paired(result: ForwardResult) -> bool:
    """Whether measured frequencies stand beside modes: by shape or label, or in a list without gaps."""
    measurement = result.specimen.measurement
    if measurement is None or measurement.complete:
        return True
    return all(measurement.labels) if result.by_shape is None else bool((result.by_shape.modes >= 0).all())
