"""The example of docs/effects.md is an effect that works, and its tables are those of the catalogue."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cpam_bayes.effects.table import BEGIN, END, catalogue_tables
from tests.effects.cases import elements, ritz

PAGE = (Path(__file__).parents[2] / "docs" / "effects.md").read_text(encoding="utf-8")


def test_the_example_of_an_effect_raises_frequencies_alike_on_both_discretisations() -> None:
    _, _, code = PAGE.partition('```python title="stiffener.py"\n')
    names: dict[str, Any] = {}
    exec(code.partition("```")[0], names)
    f = ritz("C1", names["STIFFENER"], degree=10)
    g = elements("C1", names["STIFFENER"], counts=(24, 48))
    a, b = f[1] / f[0] - 1, g[1] / g[0] - 1
    assert np.all(a > 0)
    assert a.max() > 1e-3
    # elements of half the bell's width
    np.testing.assert_allclose(a, b, atol=2e-4)


def test_the_page_holds_the_tables_of_the_catalogue() -> None:
    """``python -m cpam_bayes.effects.table docs/effects.md`` writes them."""
    assert f"{BEGIN}\n{catalogue_tables()}\n{END}" in PAGE
