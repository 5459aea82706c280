"""Imports go one way, and heavy libraries load when they are used."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import cpam_bayes

# A module imports only from its own layer and from those above it in this list.
LAYERS = (
    "errors",
    "threads",
    "parallel",
    "priors",
    "parameters",
    "elasticity",
    "layup",
    "laminate",
    "weights",
    "problem",
    "effects",
    "spaces",
    "affine",
    "sparse",
    "modes",
    "shapes",
    "convergence",
    "measurement",
    "calculix",
    "model",
    "air_shift",
    "elements",
    "reduced",
    "cache",
    "labels",
    "noise",
    "pairing",
    "posterior",
    "inference",
    "diagnosis",
    "paper",
    "report",
    "commands",
    "cli",
    "__main__",
)
HEAVY = ("arviz", "dynesty", "distributed", "emcee", "matplotlib", "skfem")
# The package itself may be asked for these by any layer; it imports nothing.
ROOT_NAMES = {"__version__"}

PACKAGE = Path(cpam_bayes.__file__).parent
PROJECT = Path(__file__).parent.parent
MODULES = sorted(PACKAGE.rglob("*.py"))


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(source: str, module: str, is_package: bool) -> Iterator[str]:
    """The full names a module imports, lazy and type-checking imports included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = module.split(".")[: None if is_package else -1]
                above = above[: len(above) - node.level + 1]
                base = ".".join([*above, base] if base else above)
            yield from (f"{base}.{alias.name}" for alias in node.names)


def layer(name: str) -> str | None:
    """The layer of a full name of this package; None for the package itself and for others."""
    parts = name.split(".")
    return parts[1] if parts[0] == "cpam_bayes" and len(parts) > 1 else None


def violations(source: str, module: str, is_package: bool) -> list[str]:
    own = layer(module)
    if own is not None and own not in LAYERS:
        return [f"{module} is in no layer: add it to LAYERS at its place"]
    # The package itself stands before the first layer.
    height = -1 if own is None else LAYERS.index(own)
    found = []
    for name in imports(source, module, is_package):
        used = layer(name)
        if name == "cpam_bayes" or used is None or used in ROOT_NAMES:
            continue
        if used not in LAYERS:
            found.append(f"{module} imports {name}, which is in no layer")
        elif LAYERS.index(used) > height:
            found.append(f"{module} imports {name}, which stands after it")
    return found


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_a_module_imports_only_from_layers_before_it(path: Path) -> None:
    found = violations(path.read_text("utf-8"), module_name(path), path.name == "__init__.py")
    assert found == []


@pytest.mark.parametrize(
    ("module", "is_package", "source"),
    [
        ("cpam_bayes.laminate", False, "from cpam_bayes.problem import Problem"),
        ("cpam_bayes.laminate", False, "from cpam_bayes import problem"),
        ("cpam_bayes.laminate", False, "import cpam_bayes.cli"),
        ("cpam_bayes.laminate", False, "def late():\n    from .problem import Problem"),
        ("cpam_bayes.spaces.ritz", False, "from ..affine import discretise"),
        ("cpam_bayes.spaces", True, "from ..affine import discretise"),
        ("cpam_bayes", True, "from cpam_bayes.errors import LayupError"),
        ("cpam_bayes.newcomer", False, ""),
        ("cpam_bayes.cli", False, "from cpam_bayes.newcomer import thing"),
    ],
)
def test_a_wrong_import_is_found(module: str, is_package: bool, source: str) -> None:
    assert len(violations(source, module, is_package)) == 1


@pytest.mark.parametrize(
    ("module", "is_package", "source"),
    [
        ("cpam_bayes.spaces.ritz", False, "from .protocol import Space"),
        ("cpam_bayes.spaces", True, "from .protocol import Space\nfrom . import ritz"),
        ("cpam_bayes.problem", False, "import numpy\nfrom .laminate import Laminate"),
        ("cpam_bayes.errors", False, "from cpam_bayes import __version__"),
    ],
)
def test_a_right_import_is_accepted(module: str, is_package: bool, source: str) -> None:
    assert violations(source, module, is_package) == []


def test_matplotlib_is_imported_in_report_and_figures_alone() -> None:
    elsewhere = [*MODULES, *PROJECT.glob("studies/*.py"), *PROJECT.glob("benchmarks/*.py")]
    users = {
        str(path)
        for path in elsewhere
        if path.is_relative_to(PROJECT / "studies")
        or path.is_relative_to(PROJECT / "benchmarks")
        or layer(module_name(path)) != "report"
        for name in imports(path.read_text("utf-8"), "", path.name == "__init__.py")
        if name.split(".")[0] == "matplotlib"
    }
    assert users == set()


def test_the_command_line_loads_no_heavy_library() -> None:
    code = f"""
import json, sys
import cpam_bayes.cli
print(json.dumps([name for name in {HEAVY!r} if name in sys.modules]))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60
    )
    assert json.loads(done.stdout) == []
