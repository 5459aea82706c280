"""Constants that eq. (9) does not allow are found where the ply is orthotropic, and named where it is not."""

from __future__ import annotations

from typing import Any

import pytest

import cpam_bayes as cb
from tests.plate_file import described

# Spruce, its grain along x, and the same sheet with axis 1 across the grain.
GRAIN_1 = {"E1_GPa": 11.0, "E2_GPa": 0.9, "nu12": 0.53, "G12_GPa": 0.75, "G13_GPa": 0.6, "G23_GPa": 0.1}
GRAIN_2 = GRAIN_1 | {"E1_GPa": 0.9, "E2_GPa": 11.0, "nu12": 0.53 * 0.9 / 11.0, "G13_GPa": 0.1, "G23_GPa": 0.6}
CUT = "nu12 < 0.5, a positive definite stiffness, first of eq. (9)"


def sheet(
    constants: dict[str, float], layup: str, symmetry: str = "orthotropic", **tables: Any
) -> dict[str, Any]:
    material = {"symmetry": symmetry, **constants}
    return described((400.0, 160.0, 3.0), 430.0, material, layup=layup, **tables)


def around(constants: dict[str, float]) -> dict[str, list[float]]:
    bounds = {key: [0.5 * constants[key], 2.0 * constants[key]] for key in ("E1_GPa", "E2_GPa", "G12_GPa")}
    return bounds | {"nu12": [0.0, 0.9]}


@pytest.fixture(scope="module")
def measured() -> dict[str, Any]:
    f = cb.forward(sheet(GRAIN_1, "[0]"), n_modes=8).frequencies
    return {"frequencies_hz": [round(float(v), 2) for v in f], "relative_std": 0.002}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("constants", "layup"), [(GRAIN_1, "[0]"), (GRAIN_2, "[90]")], ids=["along", "across"]
)
def test_the_constants_of_spruce_are_found_in_either_order(
    measured: dict[str, Any], constants: dict[str, float], layup: str
) -> None:
    point = cb.identify(sheet(constants, layup, unknowns=around(constants), measurement=measured))
    assert point.notices == ()
    for constant in point.estimate.constants:
        truth = point.specimen.material.complete()[constant.name]
        # the list has no noise but its rounding, far below the noise that is stated
        assert abs(constant.value - truth) < 0.5 * constant.sd


@pytest.mark.slow
def test_a_constraint_in_the_way_is_named_by_swarm_and_posterior(measured: dict[str, Any]) -> None:
    reference = {key: GRAIN_1[key] for key in ("E1_GPa", "E2_GPa", "G12_GPa")} | {"nu12": 0.4}
    plate = sheet(
        reference, "[0]", "transversely_isotropic", unknowns=around(reference), measurement=measured
    )
    point = cb.identify(plate)
    assert [n.facts["constraint"].text for n in point.notices] == [CUT]
    posterior = cb.sample(plate)
    assert [n.facts["constraint"].text for n in posterior.notices if n.code == "cut_posterior"] == [CUT]
    for document in (point.to_dict(), posterior.to_dict()):
        assert any(CUT in warning for warning in document["warnings"])
