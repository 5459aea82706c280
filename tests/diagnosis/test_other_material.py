"""A plate whose reference constants are those of something else: the paper's C3 is one by its list."""

from __future__ import annotations

import numpy as np
import pytest

from cpam_bayes.diagnosis.cases import plate_case, with_list
from cpam_bayes.diagnosis.diagnose import diagnose_cases
from cpam_bayes.diagnosis.hypotheses import PAIR, single_hypotheses
from cpam_bayes.diagnosis.models import diagnosis_parameters
from cpam_bayes.effects import PlateFacts
from cpam_bayes.effects.plies import MATERIAL
from cpam_bayes.plate import Measurement, Specimen, builtin
from tests.diagnosis.toy_plates import pairs_of

NOISE = 0.003


def facts(specimen: Specimen, *, has_references: bool = True) -> PlateFacts:
    return PlateFacts.of(specimen.plate, specimen.material.isotropic, has_references=has_references)


def test_only_the_search_bounds_are_left_of_the_constants() -> None:
    specimen = builtin("C2")
    wide = diagnosis_parameters(specimen, other_material=True)
    assert wide.names == specimen.unknowns.names
    assert [p.prior for p in wide.parameters] == [p.prior for p in specimen.unknowns.parameters]
    assert wide.parameters[0].prior != diagnosis_parameters(specimen).parameters[0].prior


def test_it_is_as_probable_as_another_slip_of_the_pen_and_pairs_with_nothing() -> None:
    found = single_hypotheses(facts(builtin("C2")), 6, complete=True)
    material = next(h for h in found if h.cause == MATERIAL.name)
    assert material.other_material
    alone = next(h for h in found if h.cause == "viscoelastic")  # the one cause of its family
    assert material.prior == pytest.approx(0.1 * alone.prior)
    assert all(MATERIAL.name not in p.causes for p in pairs_of((*found[2:6], material), found))
    assert all(h.family != PAIR for h in found)
    without = single_hypotheses(facts(builtin("C2"), has_references=False), 6, complete=True)
    assert MATERIAL.name not in {h.cause for h in without}


@pytest.mark.slow
def test_constants_far_from_their_reference_are_another_material() -> None:
    """E1 down by half, E2 twice as large: no wrong size does that to a cross-ply plate."""
    case = plate_case(builtin("C2"))
    wide = case.of_other_material()
    n = case.measurement.size
    rng = np.random.default_rng(4)

    def listed(x: np.ndarray) -> Measurement:
        f = wide.bare.predict(x[None]).frequencies[0, :n] * (1.0 + NOISE * rng.standard_normal(n))
        return Measurement(f, 0.0, NOISE, None, ("",) * n, complete=True)

    reference = np.array([p.prior.mean for p in case.models.parameters.parameters])
    far = reference * np.array([0.5, 2.0, 1.0, 1.6])
    found = diagnose_cases([with_list(case, listed(far))], gain=False)
    assert found.claim.kind == "named"
    assert found.claim.causes == (MATERIAL.name,)
    assert found.extended is not None
    mean, sd, _, _ = found.extended.constants["E1"]
    assert mean == pytest.approx(far[0], abs=3.0 * sd)
    assert sd < 0.1 * far[0]
    near = diagnose_cases([with_list(case, listed(reference))], gain=False)
    assert near.claim.kind == "none"
    assert {c.name: c.probability for c in near.causes}[MATERIAL.name] < 0.01
