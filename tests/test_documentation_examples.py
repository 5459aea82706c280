"""The Python examples of the documentation run, and give the values that stand beside them."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import matplotlib
import pytest

from tests.plate_file import MEASURED, PLATE

PROJECT = Path(__file__).parent.parent


def blocks(page: Path) -> list[str]:
    """The contents of the ```python blocks of a page."""
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def run_block(text: str, names: dict[str, Any]) -> None:
    """Run a block; an expression with ``# -> value`` at its end has that value."""
    lines = text.splitlines()
    for statement in ast.parse(text).body:
        source = ast.get_source_segment(text, statement)
        assert source is not None
        if not isinstance(statement, ast.Expr):
            exec(source, names)
            continue
        value = eval(source, names)
        _, _, expected = lines[statement.end_lineno - 1].partition("  # -> ")
        assert not expected or repr(value) == expected, source


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/library.md"])
def test_the_python_examples_of_a_page_run(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(matplotlib, "rcParams", matplotlib.rcParams.copy())
    (tmp_path / "my_plate.toml").write_text(PLATE + MEASURED, encoding="utf-8")
    names: dict[str, Any] = {}
    for block in blocks(PROJECT / page):
        run_block(block, names)
    assert "cb" in names, "the page has examples"


def test_a_value_that_is_not_the_documented_one_fails() -> None:
    run_block("1 + 1  # -> 2\n", {})
    with pytest.raises(AssertionError, match=r"1 \+ 1"):
        run_block("1 + 1  # -> 3\n", {})
