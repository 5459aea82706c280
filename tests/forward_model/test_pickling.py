"""A model that went through pickle, as on its way to a worker, predicts the same bit for bit."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cpam_bayes.forward_model.model import (
    PlateModel,
    angle_parameters,
    converged_model,
    size_parameters,
    training_sets,
)
from cpam_bayes.forward_model.store import reduced_model
from cpam_bayes.inference.posterior import plate_posterior
from cpam_bayes.plate import Specimen, read_specimen
from cpam_bayes.plate.records import Sensor


def _sent(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


def _assert_alike(model: PlateModel, other: PlateModel) -> None:
    problem = model.operator.problem
    x = training_sets(problem, 4, np.random.default_rng(0)) if model.parameters.size else np.empty((1, 0))
    mine, theirs = model.predict(x, jacobian=True), other.predict(x, jacobian=True)
    assert np.array_equal(mine.frequencies, theirs.frequencies)
    assert mine.jacobian is not None
    assert theirs.jacobian is not None
    assert np.array_equal(mine.jacobian, theirs.jacobian)
    assert np.array_equal(model.admissible(x), other.admissible(x))


def _with_sensor(specimen: Specimen) -> Specimen:
    return replace(specimen, sensors=(Sensor(mass=1.2e-3, x=0.25, y=0.2),))


def _with_sizes(specimen: Specimen) -> Specimen:
    return replace(specimen, plate=replace(specimen.plate, sd={"thickness": 2e-5, "length": 1e-4}))


@pytest.mark.parametrize(
    "change",
    [lambda s: s, pytest.param(_with_sensor, marks=pytest.mark.slow), _with_sizes],
    ids=["bare", "sensor", "sizes"],
)
def test_a_plate_model_is_the_same_after_pickling(change: Any) -> None:
    specimen = change(read_specimen("C1"))
    parameters = specimen.unknowns.union(size_parameters(specimen)).union(angle_parameters(specimen))
    model = converged_model(specimen, parameters, 3)
    _assert_alike(model, _sent(model))


def test_a_reduced_model_and_its_posterior_are_the_same_after_pickling() -> None:
    specimen = read_specimen("A1")
    assert specimen.measurement is not None
    model = reduced_model(specimen, specimen.unknowns, specimen.measurement.size)
    other = _sent(model)
    _assert_alike(model.full, other.full)
    _assert_alike(model.fast, other.fast)
    posterior = plate_posterior(model, specimen.measurement, model.full.error)
    x = posterior.parameters.sample(np.random.default_rng(0), 50)
    assert np.isfinite(posterior.log_prob(x)).any()
    assert np.array_equal(posterior.log_prob(x), _sent(posterior).log_prob(x))
    plate = x[:, : model.parameters.size]
    assert np.array_equal(model.error(plate), other.error(plate))
