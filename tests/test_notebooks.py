"""Notebooks are saved with their results, and run from the first cell to the last."""

import importlib.util
from pathlib import Path
from types import ModuleType

import nbformat
import pytest

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.ipynb"))


def runner() -> ModuleType:
    """The script that executes them."""
    spec = importlib.util.spec_from_file_location("execute", FOLDER / "execute.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shapes(notebook: nbformat.NotebookNode) -> list[tuple[str, list[str]]]:
    """Of every code cell, its source and the kinds of its results."""
    return [
        (cell.source, [out.output_type for out in cell.outputs])
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]


def test_there_are_three() -> None:
    assert len(NOTEBOOKS) == 3


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_saved_with_results_figures_and_no_errors(name: str) -> None:
    cells = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4).cells
    outputs = [out for cell in cells if cell.cell_type == "code" for out in cell.outputs]
    assert any("image/png" in out.get("data", {}) for out in outputs)
    assert any("text/html" in out.get("data", {}) for out in outputs)
    assert all(out.output_type != "error" for out in outputs)


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs_and_shows_what_it_is_saved_with(name: str) -> None:
    saved = shapes(nbformat.read(FOLDER / f"{name}.ipynb", as_version=4))
    assert shapes(runner().executed(FOLDER / f"{name}.ipynb")) == saved
