"""One model for all plates of one geometry: their lists are scaled to the sizes of the first.

Plates of one cut differ by some per cent in thickness and mass. A frequency scales with the sizes as

    f(s) / f(s0) = product over k of (s_k / s0_k)^p_k,    p_k = d log f / d log s_k,

with the powers at the reference constants: for a thin plate p = 1 for the thickness and -1/2 for the density,
apart from shear. The neglected term is of second order, the change of a size times the change of its power
with the constants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.forward_model.model import PlateModel, plate_problem
from cpam_bayes.mechanics.convergence import Tolerance, converge
from cpam_bayes.parameters import Parameter, ParameterSet, Uniform
from cpam_bayes.plate import Specimen

Array = NDArray[Any]

# Largest relative difference of a size within a group: up to it the powers hold to 1e-4 of a frequency.
_SIZES: Final = {"thickness": 0.05, "density": 0.05, "length": 0.01, "width": 0.01}
_RANGE, _BESIDE = 0.1, 0.01
# The powers are accurate to 1e-3, 5e-5 of a frequency at the ends of these ranges.
_TOLERANCE: Final = Tolerance(kept=3e-4, rich=2e-4)


def groups_of(specimens: Sequence[Specimen]) -> list[list[int]]:
    """Indices of plates grouped so that each list can be scaled to the first of its group."""
    groups: list[list[int]] = []
    keys: list[tuple[Any, ...] | None] = []
    for i, specimen in enumerate(specimens):
        key = _geometry(specimen)
        for group, known in zip(groups, keys, strict=True):
            if key is not None and key == known and _are_near(specimen, specimens[group[0]]):
                group.append(i)
                break
        else:
            groups.append([i])
            keys.append(key)
    return groups


def _geometry(specimen: Specimen) -> tuple[Any, ...] | None:
    """Key of all model inputs except sizes; None where the modes of a list are not known in advance."""
    measurement, plate = specimen.measurement, specimen.plate
    if measurement is None or not measurement.complete or measurement.names_modes or plate.mesh is not None:
        return None
    if plate.layup.n_unknown:
        return None
    return (
        tuple(plate.layup.angles_deg),
        plate.layup.kinds,
        plate.edges,
        specimen.material.symmetry,
        tuple(sorted(specimen.material.constants.items())),
        repr(specimen.unknowns),
        tuple(sorted(plate.sd.items())),
        plate.mass is None,
        tuple(repr(s) for s in specimen.sensors),
        specimen.air_density,
        measurement.size,
    )


def _are_near(one: Specimen, other: Specimen) -> bool:
    return all(
        abs(np.log(getattr(one.plate, name) / getattr(other.plate, name))) <= most
        for name, most in _SIZES.items()
    )


def size_powers(specimen: Specimen, n_modes: int) -> Array:
    """d log f / d log s of the lowest modes at the reference constants, (n_modes, 4) as in ``_SIZES``."""
    weighed = replace(specimen, plate=replace(specimen.plate, mass=None))
    values = {name: float(getattr(weighed.plate, name)) for name in _SIZES}
    parameters = ParameterSet(
        tuple(Parameter(n, "", Uniform(v * (1 - _RANGE), v * (1 + _RANGE))) for n, v in values.items())
    )
    problem = plate_problem(weighed, parameters)
    x = np.array([list(values.values())])
    samples = np.concatenate((x, x * (1.0 + _BESIDE)))
    converged = converge(problem, parameters.mapping(samples), n_modes, _TOLERANCE)
    predicted = PlateModel(converged.operator, n_modes, converged.error).predict(x, jacobian=True)
    assert predicted.jacobian is not None
    return np.asarray(predicted.jacobian[0] * x / predicted.frequencies[0][:, None])


def carried(specimen: Specimen, nominal: Specimen, powers: Array) -> Specimen | None:
    """The specimen with the sizes of another one, and its list scaled to them.

    powers : `size_powers` of the other; None where two frequencies would change order
    """
    measurement = specimen.measurement
    assert measurement is not None
    steps = np.log([getattr(nominal.plate, n) / getattr(specimen.plate, n) for n in _SIZES])
    factor = np.exp(powers @ steps)
    f = measurement.frequencies * factor
    if np.any(np.diff(f) < 0.0):
        return None
    sd = measurement.frequency_sd
    moved = replace(
        measurement,
        frequencies=f,
        frequency_sd=None if sd is None else sd * factor,
        resolution=measurement.resolution * float(np.mean(factor)),
    )
    return replace(specimen, plate=nominal.plate, measurement=moved)


def with_shared_sizes(specimens: Sequence[Specimen]) -> tuple[list[Specimen], int]:
    """Plates scaled to the sizes of the first of their geometry, lists included; number of geometries."""
    shared = list(specimens)
    groups = groups_of(specimens)
    count = len(groups)
    for first, *others in groups:
        nominal = specimens[first]
        moving = [k for k in others if specimens[k].plate != nominal.plate]
        if not moving:
            continue
        assert nominal.measurement is not None
        try:
            powers = size_powers(nominal, nominal.measurement.size)
        except ValueError:  # it is said where the plate is computed
            count += len(moving)
            continue
        for k in moving:
            moved = carried(specimens[k], nominal, powers)
            count += moved is None
            shared[k] = moved or specimens[k]
    return shared, count
