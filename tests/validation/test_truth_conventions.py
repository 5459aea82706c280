"""A cause of the benchmark's truths is the effect of the same name: size, sign and reference agree."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.effects import Effect, PlateFacts, extend
from cpam_bayes.forward_model.model import plate_problem
from cpam_bayes.mechanics.fem import discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import solve
from cpam_bayes.plate import Specimen
from tests.effects.cases import BY_NAME
from validation.independent import lists
from validation.independent.true_plate import FLAWS, TruePlate, natural_frequencies

FREE, CLAMPED = lists.TUNING[1], lists.TUNING[3]
N = 6
# Each with the names of its sizes in the catalogue. A clamp that slips ends abruptly in the truth and fades
# in the catalogue, and a truth's mass is taller than a point: these agree less by intention.
CAUSES: dict[str, dict[str, float]] = {
    "clamp_rotation": {"rotation_compliance": 1.0},
    "clamp_translation": {"translation_compliance": 1.0},
    "soft_clamp": {"soft_rotation_compliance": 0.02, "soft_translation_compliance": 0.002},
    "clamp_length": {"clamp_shift": 1.0},
    "support": {"support_frequency": 1.0},
    "thickness": {"thickness_deviation": 1.0},
    "density": {"density_deviation": 1.0},
    "length": {"length_deviation": 1.0},
    "width": {"width_deviation": 1.0},
    "taper_x": {"taper_x": 1.0},
    "taper_y": {"taper_y": 1.0},
    "skew": {"skew_deg": 1.0},
    "misorientation": {"misorientation_deg": 1.0},
    "outer_ply_angle": {"outer_ply_deg": 1.0},
    "inner_ply_angle": {"inner_ply_deg": 1.0},
    "warp": {"sag": 1.0},
    "membrane_stress": {"residual_stress": 1.0},
    "transverse_shear": {"log_shear_factor": 1.0},
    "shear_ratio": {"shear_ratio_deviation": 1.0},
    "resin_skin": {"skin_thickness": 1.0},
}


def read(own: lists.NominalPlate, folder: Path) -> Specimen:
    path = folder / f"{own.name}.toml"
    path.write_text(own.file([100.0 + 50 * i for i in range(own.n_modes)], stated=None), "utf-8")
    return cb.read_plate(str(path))


def of_package(specimen: Specimen, effect: Effect | None, values: dict[str, float]) -> np.ndarray:
    problem = plate_problem(specimen)
    if effect is not None:
        problem = extend(problem, effect, PlateFacts.of(specimen.plate, specimen.material.isotropic))
    stack = {name: np.array([value]) for name, value in values.items()}
    operator = discretise_sparse(problem, fem_space(problem.edges, problem.nominal, 10, 10), stack)
    k, m = (np.atleast_2d(c) for c in operator.coefficients(stack))
    return np.asarray(solve(operator, k, m, N).frequencies[0])


def shifted(plate: TruePlate, cause: str, size: float) -> np.ndarray:
    flaw, plate = FLAWS[cause], replace(plate, mesh=10)
    return natural_frequencies(flaw.apply(plate, size, {"ratio": 1.0}), N) / natural_frequencies(plate, N)


@pytest.mark.parametrize("cause", CAUSES)
def test_a_hidden_cause_shifts_as_the_effect_of_its_name(cause: str, tmp_path: Path) -> None:
    own = CLAMPED if FLAWS[cause].applies(CLAMPED.plate) else FREE
    size = 3.0 * FLAWS[cause].scale(own.plate)
    values = BY_NAME[cause].null | {name: factor * size for name, factor in CAUSES[cause].items()}
    specimen = read(own, tmp_path)
    expected = of_package(specimen, BY_NAME[cause], values) / of_package(specimen, None, {})
    # two coarse meshes: shifts of up to 27 %
    np.testing.assert_allclose(shifted(own.plate, cause, size), expected, atol=1e-3)
