"""Nothing outside cpam_bayes/effects knows an effect, a parameter of one, or a family by its name."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import cpam_bayes
from cpam_bayes.effects import CATALOGUE
from cpam_bayes.forward_model.model import SIZES

PACKAGE = Path(cpam_bayes.__file__).parent
NAMES = {e.name for e in CATALOGUE} | {p.name for e in CATALOGUE for p in e.parameters}
FAMILIES = {e.family for e in CATALOGUE}
# Words of the plate file, which name its numbers and tables where no effect is meant.
PLATE_WORDS = {*SIZES, "air", "air_density", "frequency_scale", "layup", "material", "outline"}
# Truths that are made without the catalogue, and their scores, name what they hide: they may not ask it.
VALIDATION = PACKAGE.parent / "studies" / "validation"
TRUTHS = [path for folder in ("independent", "claims") for path in sorted((VALIDATION / folder).glob("*.py"))]
MODULES = [p for p in sorted(PACKAGE.rglob("*.py")) if "effects" not in p.relative_to(PACKAGE).parts]


def strings(source: str) -> Iterator[str]:
    """All string literals that are no docstrings."""
    tree = ast.parse(source)
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docstrings = {
        id(n.body[0].value) for n in ast.walk(tree) if isinstance(n, documented) and _has_docstring(n)
    }  # type: ignore[attr-defined]
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


def _has_docstring(node: ast.Module | ast.ClassDef | ast.FunctionDef) -> bool:
    return ast.get_docstring(node) is not None


def known(source: str, names: set[str]) -> set[str]:
    return names & set(strings(source))


def test_a_name_is_seen_in_comparisons_tuples_and_keys() -> None:
    source = 'x == "warp"\ny in ("skew", 1)\nz = {"damage": 2}\nmatch z:\n    case "outlier":\n        pass\n'
    assert known(source, NAMES) == {"warp", "skew", "damage", "outlier"}
    assert known('"""warp"""\ndef f():\n    """skew"""\n', NAMES) == set()


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_outside_the_effects_names_none(path: Path) -> None:
    is_of_diagnosis = "diagnos" in str(path.relative_to(PACKAGE))
    # where causes are compared and shown no such name can be anything else
    names = NAMES | FAMILIES if is_of_diagnosis else NAMES - PLATE_WORDS
    assert known(path.read_text(encoding="utf-8"), names) == set()


@pytest.mark.parametrize("path", TRUTHS, ids=lambda p: str(p.relative_to(VALIDATION)))
def test_truths_are_made_without_the_catalogue(path: Path) -> None:
    assert path.exists()
    imported = [
        name
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        for name in _imported(node)
        if name.startswith(("cpam_bayes.effects", "cpam_bayes.mechanics"))
    ]
    assert imported == []


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.ImportFrom):
        return [node.module or ""]
    return [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
