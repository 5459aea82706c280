"""Length and width exchanged: the plate that it gives, and the plates that do not have it."""

from dataclasses import replace

import numpy as np
import pytest

from cpam_bayes.diagnosis.models import extended_model, plate_models
from cpam_bayes.effects import variants
from cpam_bayes.effects.geometry import SWAPPED_SIDES
from cpam_bayes.plate.reader import builtin
from tests.effects.cases import facts


@pytest.mark.parametrize("name", ["A2", "D3"])
def test_it_is_the_plate_with_its_sides_exchanged(name: str) -> None:
    specimen = builtin(name)
    models = plate_models(specimen, 6)
    (own,) = variants(SWAPPED_SIDES, models.facts)
    plate = specimen.plate
    other = replace(specimen, plate=replace(plate, length=plate.width, width=plate.length))
    expected = plate_models(other, 6).bare.full
    model = extended_model(models, own)
    x = models.samples.x[:1]
    f = model.predict(x).frequencies[0, :6]
    np.testing.assert_allclose(f, expected.predict(x).frequencies[0, :6], rtol=2e-4)
    assert np.abs(f / models.bare.predict(x).frequencies[0, :6] - 1.0).max() > 0.01


def test_plates_that_it_leaves_alike_do_not_have_it() -> None:
    of = replace(facts("C1"), length=0.3)
    assert SWAPPED_SIDES.applies_to(of)
    assert not SWAPPED_SIDES.applies_to(facts("C1"))  # square
    assert not SWAPPED_SIDES.applies_to(replace(of, isotropic=True))
    assert SWAPPED_SIDES.applies_to(replace(of, isotropic=True, edges="CFFF"))
    assert not SWAPPED_SIDES.applies_to(replace(of, loaded=True))


def test_between_equal_edges_the_layup_turned_is_said_beside() -> None:
    of = replace(facts("C1"), length=0.3)
    said = [variants(SWAPPED_SIDES, replace(of, edges=edges))[0].title for edges in ("FFFF", "CFFF")]
    assert ["turned by 90 degrees" in title for title in said] == [True, False]
