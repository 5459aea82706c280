"""The example of docs/effects.md is an effect that works."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from cpam_bayes.effects import CATALOGUE
from tests.effects.cases import elements, ritz

PAGE = (Path(__file__).parents[2] / "docs" / "effects.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_example_of_an_effect_raises_frequencies_alike_on_both_discretisations() -> None:
    code = PAGE[PAGE.index('        """A stiffener') : PAGE.index("2. One line in")]
    names: dict[str, Any] = {}
    exec(dedent(code), names)
    f = ritz("C1", names["STIFFENER"], degree=10)
    g = elements("C1", names["STIFFENER"], counts=(24, 48))
    a, b = f[1] / f[0] - 1, g[1] / g[0] - 1
    assert np.all(a > 0)
    assert a.max() > 1e-3
    # elements of half the bell's width
    np.testing.assert_allclose(a, b, atol=2e-4)


def test_every_cause_has_a_row_in_the_table_with_its_parameters() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| ")]
    for effect in CATALOGUE:
        own = [row for row in rows if effect.name in row.split("|")[1].replace(",", " ").split()]
        assert len(own) == 1, effect.name
        assert effect.family == own[0].split("|")[2].strip()
        for parameter in effect.parameters:
            assert parameter.name in own[0], parameter.name
