"""Hadamard's conditions made concrete: against closed forms."""

import math
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.printed.tables import printed_table
from cpam_bayes.questions.paper.work import (
    Task,
    hadamard,
    rounding_percent,
    simulation_errors,
    well_posed,
)
from tests.plate_file import described

REFERENCE_GPA = 70.0


def isotropic(frequencies: list[float], **unknowns: list[float]) -> dict[str, Any]:
    material = {"isotropic": True, "E1_GPa": REFERENCE_GPA, "nu12": 0.33}
    tables = {"unknowns": unknowns, "measurement": {"frequencies_hz": frequencies}}
    return described((300.0, 200.0, 2.0), 2700.0, material, **tables)


@pytest.fixture(scope="module")
def frequencies() -> list[float]:
    plate = isotropic([100.0], E1_GPa=[50.0, 90.0])
    return [float(f) for f in cb.forward(plate, n_modes=6).frequencies]


def test_frequencies_grow_as_the_root_of_the_modulus(frequencies: list[float]) -> None:
    """d ln f / d ln E = 1/2 for all n modes: sd(ln E) = 2 / sqrt(n) times the noise."""
    off = [f * (1.0 + 0.01 * (-1) ** i) for i, f in enumerate(frequencies)]
    answer = well_posed(cb.identify(isotropic(off, E1_GPa=[50.0, 90.0]), residuals="relative"))
    assert answer["percent_per_percent"]["E1_GPa"] == pytest.approx(2.0 / math.sqrt(6.0), rel=1e-4)
    assert (answer["rank"], answer["condition"], answer["optima"]) == (1, pytest.approx(1.0), 1)
    # +-1 % about one modulus: sqrt(6 0.01^2 / 5), to the second order in 0.01
    assert answer["left_percent"] == pytest.approx(math.sqrt(6.0 / 5.0), rel=1e-3)


def test_two_constants_that_all_frequencies_see_alike_are_ill_conditioned(frequencies: list[float]) -> None:
    """The amplification of the modulus grows when Poisson's ratio is unknown beside it."""
    alone = well_posed(cb.identify(isotropic(frequencies, E1_GPa=[50.0, 90.0])))
    both = well_posed(cb.identify(isotropic(frequencies, E1_GPa=[50.0, 90.0], nu12=[0.1, 0.45])))
    assert both["rank"] == 2
    assert both["condition"] > 2.0
    assert both["percent_per_percent"]["E1_GPa"] > alone["percent_per_percent"]["E1_GPa"]


def test_existence_needs_a_misfit_within_the_repeatability_and_uniqueness_one_optimum() -> None:
    posed = {"frequencies": 6, "unknowns": 4, "left_percent": 0.5, "rank": 4, "condition": 10.0, "optima": 1}

    def found(layups: int | None = None, rounding: float = 0.0, **change: Any) -> Any:
        known = {**posed, "percent_per_percent": {}, **change}
        return hadamard(Task("constants", "C1", "as built in", 9, 0), known, layups, 0.9, rounding)

    assert found()["exists"]
    assert found()["unique"]
    assert not found(left_percent=1.0)["exists"]
    # sqrt(0.9^2 + 0.5^2) = 1.03
    assert found(left_percent=1.0, rounding=0.5)["exists"]
    assert not found(left_percent=1.1, rounding=0.5)["exists"]
    assert found(left_percent=None)["exists"] is None
    assert not any(one["unique"] for one in (found(rank=3), found(optima=2), found(layups=3130)))


def test_the_rounding_of_a_list_is_that_of_uniform_errors_of_its_last_digit() -> None:
    measured = cb.read_plate("A2").measurement
    assert measured.resolution == 1.0
    errors = np.random.default_rng(1).uniform(-0.5, 0.5, (20000, measured.size)) / measured.frequencies
    assert rounding_percent("A2") == pytest.approx(100.0 * np.sqrt(np.mean(errors**2)), rel=0.01)


def test_the_printed_simulation_is_held_against_the_measured_list() -> None:
    answer = {
        "plain_rms_percent": 1.0,
        "claim": "named",
        "sentence": "Plate not flat (probability 0.95).",
        "causes": ["warp"],
        "sizes": {"sag": {"mean": 1.0, "sd": 0.1, "unit": "mm"}},
        "probability": 0.95,
        "extended_rms_percent": 0.2,
        "log_bayes_factor": 8.0,
        "held_out": 5.0,
        "held_out_se": 1.0,
        "frequency_ratio": 1.0,
        "scaled_rms_percent": 1.0,
    }
    (error,) = simulation_errors(5, {"plates": {"A1": answer}})
    printed = np.array([float(v.text) for v in printed_table(5).row("A1", "ABAQUS").values.values()])
    measured = cb.read_plate("A1").measurement
    off = printed / measured.frequencies - 1.0
    assert error["printed_rms_percent"] == pytest.approx(100.0 * float(np.sqrt(np.mean(off**2))))
    assert error["causes"] == ["warp"]
    assert list(simulation_errors(9, {"plates": {"A1": answer}})) == []
