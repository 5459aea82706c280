"""A posterior of one list as the prior of another: the answer of both lists together."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cpam_bayes as cb
from cpam_bayes.answer import Verdict
from cpam_bayes.parameters import ParameterSet
from tests.plate_file import described

EXACT = {"length_mm": 0.0, "width_mm": 0.0, "density_kg_m3": 0.0}
UNKNOWNS = {"E1_GPa": [60.0, 200.0], "E2_GPa": [5.0, 20.0], "nu12": [0.1, 0.5], "G12_GPa": [2.0, 10.0]}
MATERIAL = {"E1_GPa": 120.0, "E2_GPa": 9.0, "nu12": 0.3, "G12_GPa": 5.0, "name": "carbon"}
FIRST: dict[str, Any] = described((300.0, 220.0, 2.0), 1550.0, MATERIAL, layup="[0_8]", unknowns=UNKNOWNS) | {
    "name": "first"
}
# one error of all moduli: they are known far better relative to each other
FIRST["plate"]["sd"] = {**EXACT, "thickness_mm": 0.04}


def listed(plate: dict[str, Any], n: int, rng: np.random.Generator) -> None:
    f = cb.forward(plate, n_modes=n).frequencies
    noisy = np.sort(f * (1.0 + 0.003 * rng.standard_normal(n))).tolist()
    plate["measurement"] = {"frequencies_hz": noisy, "relative_std": 0.003, "frequency_scale_sd": 0.0}


@pytest.mark.slow
def test_the_posterior_of_a_former_plate_as_prior_gives_what_both_lists_give_together(tmp_path: Path) -> None:
    """Sisters without scatter. The former one's thickness is gauged badly, which correlates its moduli.

    The second list tells E1 and G12 well; that E2 is then known too is what the correlations say.
    """
    rng = np.random.default_rng(1)
    first, second = copy.deepcopy(FIRST), copy.deepcopy(FIRST)
    second |= {"name": "second"}
    second["plate"] |= {"edges": "CFFF", "width_mm": 60.0, "sd": {**EXACT, "thickness_mm": 0.0}}
    for plate, n in ((first, 8), (second, 4)):
        listed(plate, n, rng)
    together = cb.identify(first, second, seed=0, scatter=1e-4).constants
    cb.identify(first, seed=0).save(tmp_path)
    second["material"]["posterior"] = str(tmp_path / "posterior.nc")
    after = cb.read_plate(second)
    answers = (cb.identify(after, seed=0).constants, cb.sample(after, seed=0).constants)
    for name, expected in together.items():
        for answer in answers:
            # draws of the former posterior, 600 effective ones or more, and the normal form of its prior
            assert answer[name].value == pytest.approx(expected.value, abs=0.15 * expected.sd), name
            assert answer[name].sd == pytest.approx(expected.sd, rel=0.1), name
            # what the former plate measured counts as measured, what it took from a reference does not
            assert (answer[name].verdict is Verdict.DATA) == (name != "nu12"), name
    independent = tuple(replace(p, coupled=None) for p in after.unknowns.parameters)
    without = replace(after, unknowns=ParameterSet(independent))
    wider = cb.identify(without, seed=0, residuals="whitened").constants["E2"].sd
    assert wider > 2.0 * together["E2"].sd
