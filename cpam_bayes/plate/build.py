"""From a valid plate file to records in SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.parameters import Parameter, ParameterSet, Prior, TruncatedNormal, Uniform
from cpam_bayes.plate.constants import CONSTANT_KEYS, symmetry_of
from cpam_bayes.plate.layup import Layup, PlyKind, parse_layup
from cpam_bayes.plate.plies import ply_kinds
from cpam_bayes.plate.records import Hybrid, Material, Measurement, Plate, Sensor, Specimen
from cpam_bayes.plate.schema import (
    ConstantsModel,
    HybridUnknownsModel,
    MaterialModel,
    MeasurementModel,
    NormalModel,
    PlateFile,
    PlateModel,
    SensorModel,
    UnknownsModel,
)
from cpam_bayes.plate.units import USER_UNITS, joined_name, to_si

# The angles of an isotropic plate's plies change nothing.
_ISOTROPIC_LAYUP = "[0]"


def build_specimen(
    file: PlateFile, source: str, directory: Path | None, measured: Mapping[str, Any]
) -> Specimen:
    """The records of a file that passed every check; measured : fields of `Measurement` from another file."""
    kinds = ply_kinds(file.model_dump(exclude_none=True)) or {}
    sequence_layup = file.plate.sequence_layup
    return Specimen(
        name=file.name,
        specimen=file.specimen or file.name,
        source=source,
        plate=_plate(file.plate, kinds, directory),
        material=_materials(file.material),
        unknowns=_unknowns(file.unknowns),
        angle_grid_deg=float(file.unknowns.angle_grid_deg),
        air_density=file.environment.air_density_kg_m3,
        sensors=tuple(_sensor(sensor) for sensor in file.sensor),
        measurement=None if file.measurement is None else _measurement(file.measurement, measured),
        notes=tuple(file.notes),
        sequence_layup=None if sequence_layup is None else parse_layup(sequence_layup, kinds),
    )


def _plate(model: PlateModel, kinds: Mapping[str, PlyKind], directory: Path | None) -> Plate:
    length = to_si("length_mm", model.length_mm)
    width = to_si("width_mm", model.width_mm)
    thickness = to_si("thickness_mm", model.thickness_mm)
    mass = None if model.mass_g is None else to_si("mass_g", model.mass_g)
    layup = parse_layup(model.layup or _ISOTROPIC_LAYUP, kinds)
    if mass is not None:
        density = mass / (length * width * thickness)
    elif model.density_kg_m3 is not None:
        density = float(model.density_kg_m3)
    else:
        density = _mean_density(layup)
    return Plate(
        length=length,
        width=width,
        thickness=thickness,
        density=density,
        mass=mass,
        layup=layup,
        edges=model.edges,
        sd={} if model.sd is None else _in_si(model.sd.model_dump(exclude_none=True)),
        mesh=None if model.mesh is None else (directory or Path()) / model.mesh,
    )


def _mean_density(layup: Layup) -> float:
    """Mass of the plies over their thickness, kg/m3."""
    mass = sum((kind.density or 0.0) * kind.thickness for kind in layup.kinds)
    return mass / sum(kind.thickness for kind in layup.kinds)


def _materials(model: MaterialModel | dict[str, MaterialModel]) -> Material | Hybrid:
    if isinstance(model, MaterialModel):
        return _material(model)
    return Hybrid({name: _material(part) for name, part in model.items()})


def _material(model: MaterialModel) -> Material:
    given = model.model_dump(exclude_none=True)
    symmetry = symmetry_of(given)
    assert symmetry is not None
    return Material(
        symmetry=symmetry,
        constants=_in_si({key: value for key, value in given.items() if key in CONSTANT_KEYS}),
        sd={} if model.sd is None else _in_si(model.sd.model_dump(exclude_none=True)),
        name=model.name,
    )


def _unknowns(model: UnknownsModel | HybridUnknownsModel) -> ParameterSet:
    if isinstance(model, UnknownsModel):
        return ParameterSet(_parameters(model, ""))
    parts = (model.__pydantic_extra__ or {}).items()
    return ParameterSet(tuple(p for material, part in parts for p in _parameters(part, material)))


def _parameters(model: ConstantsModel, material: str) -> tuple[Parameter, ...]:
    parameters = []
    for user in type(model).model_fields:
        prior = getattr(model, user)
        if user in USER_UNITS and prior is not None:
            name, factor = USER_UNITS[user]
            unit = "Pa" if factor != 1.0 else ""
            parameters.append(Parameter(joined_name(material, name), unit, _prior(user, prior)))
    return tuple(parameters)


def _prior(user: str, model: list[float] | NormalModel) -> Prior:
    if isinstance(model, NormalModel):
        lower, upper = (to_si(user, bound) for bound in model.bounds)
        return TruncatedNormal(to_si(user, model.mean), to_si(user, model.sd), lower, upper)
    lower, upper = (to_si(user, bound) for bound in model)
    return Uniform(lower, upper)


def _sensor(model: SensorModel) -> Sensor:
    return Sensor(to_si("mass_g", model.mass_g), to_si("x_mm", model.x_mm), to_si("y_mm", model.y_mm))


def _measurement(model: MeasurementModel, measured: Mapping[str, Any]) -> Measurement:
    sd, listed = model.frequency_sd_hz, model.frequencies_hz or []
    of_pairing = {name: getattr(model, name) for name in ("missed_probability", "false_peaks")}
    stated: dict[str, Any] = {name: float(v) for name, v in of_pairing.items() if v is not None}
    given = Measurement(
        frequencies=np.array(listed, dtype=float),
        resolution=float(model.resolution_hz),
        relative_std=model.relative_std,
        frequency_sd=None if sd is None else np.array(sd, dtype=float),
        labels=tuple(model.labels or ("",) * len(listed)),
        complete=model.complete,
    )
    return replace(given, **stated, **measured)


def _in_si(values: dict[str, float]) -> dict[str, float]:
    return {USER_UNITS[user][0]: to_si(user, value) for user, value in values.items()}
