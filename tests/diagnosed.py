"""Diagnoses with a known truth, of hypotheses that need no further plate model."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from cpam_bayes.diagnosis.cases import hypotheses_of, plate_case
from cpam_bayes.diagnosis.comparison import PlateCase
from cpam_bayes.diagnosis.diagnose import Diagnosis, diagnose_cases
from cpam_bayes.plate import parse_specimen
from tests.plate_file import MEASURED, PLATE

# Relative noise of the lists, and one draw of it in units of its sd.
NOISE = 0.002
DRAWN = np.array([0.3, -0.8, 0.5, 0.9, -0.6, -0.2])

MISREAD = np.array([1.0, 1.0, 1.05, 1.0, 1.0, 1.0])  # third frequency misread by 5 %, as a factor on the list
CHEAP = frozenset({"none", "other", "viscoelastic", "frequency_scale"})  # causes without further plate models


def diagnosed(cases: Sequence[PlateCase], causes: Sequence[str], *, gain: bool = True) -> Diagnosis:
    """Diagnosis with none, other and these causes only, which act on frequencies or lists."""
    asked = {"none", "other", *causes}
    some = [(h, at) for h, at in hypotheses_of(cases) if h.cause in asked]
    return diagnose_cases(cases, hypotheses=some, sets=False, gain=gain)


def aluminium_case(name: str = "plate 7") -> PlateCase:
    """The plate of the command tests, with its model's list at the reference constants."""
    text = (PLATE + MEASURED).replace('"plate 7"', f'"{name}"')
    text = text.replace("[material]\n", '[material]\nname = "aluminium"\n')
    text += f"relative_std = {NOISE}\n"
    return plate_case(parse_specimen(text, f"{name}.toml"))


def listed(case: PlateCase, factor: np.ndarray, noise: np.ndarray = DRAWN) -> PlateCase:
    """The case with its model's list times (n,) factors, with noise."""
    f = case.models.bare.predict(np.array([[69e9, 0.33]])).frequencies[0, : len(factor)]
    measured = np.round(f * factor * (1.0 + NOISE * noise), 1)
    return replace(case, measurement=replace(case.measurement, frequencies=measured, resolution=0.1))


@cache
def clean() -> Diagnosis:
    return diagnosed([listed(aluminium_case(), np.ones(6))], ["frequency_scale", "viscoelastic"])


@cache
def misread() -> Diagnosis:
    return diagnosed([listed(aluminium_case(), MISREAD)], ["outlier", "viscoelastic", "frequency_scale"])
