"""Imports go one way, and heavy libraries load when they are used."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import cpam_bayes

PACKAGE = Path(cpam_bayes.__file__).parent
PROJECT = Path(__file__).parent.parent
MODULES = sorted(PACKAGE.rglob("*.py"))
# A module imports only from its own layer and those above it in the documentation's table.
ROOM = re.compile(r"^\| `([\w/]+?)/?(?:\.py)?` \|", re.MULTILINE)
LAYERS = (*ROOM.findall((PROJECT / "docs" / "architecture.md").read_text("utf-8")), "__main__")
HEAVY = ("arviz_base", "arviz_stats", "dynesty", "distributed", "emcee", "matplotlib", "skfem")
# Every layer may import these from the package itself.
ROOT_NAMES = {"__version__"}
TYPE_CHECKING = ("TYPE_CHECKING", "typing.TYPE_CHECKING")
ANNOTATIONS = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:"
# the command line and public names load modules on demand, by name
BY_NAME = {"cpam_bayes", "cpam_bayes.cli"}
# Names of the functions that compute frequencies or densities.
SOLVES = {"predict", "spectrum", "modes", "log_prob", "log_likelihood", "solve", "air_shifts", "best_fit"}


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


class RunTime(ast.NodeTransformer):
    """Removes the code under ``if TYPE_CHECKING:``, which never runs."""

    def visit_If(self, node: ast.If) -> ast.AST | list[ast.stmt]:
        self.generic_visit(node)
        return node.orelse if ast.unparse(node.test) in TYPE_CHECKING else node


def imports(source: str, module: str, is_package: bool, *, run_time: bool = False) -> Iterator[str]:
    """Full names of a module's imports, lazy ones included; run_time : without those for annotations."""
    tree = ast.parse(source)
    for node in ast.walk(RunTime().visit(tree) if run_time else tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".") if is_package else module.split(".")[:-1]
            above = above[: len(above) - node.level + 1] if node.level else []
            base = ".".join([*above, node.module] if node.module else above)
            yield from (f"{base}.{alias.name}" for alias in node.names)


def layer(name: str) -> str | None:
    """Layer of a full name of this package; None for the package itself and for others."""
    parts = name.split(".")
    return parts[1] if parts[0] == "cpam_bayes" and len(parts) > 1 else None


def violations(source: str, module: str, is_package: bool) -> list[str]:
    own = layer(module)
    if own is not None and own not in LAYERS:
        return [f"{module} is in no layer: add it to docs/architecture.md at its place"]
    # the package itself is before the first layer and imports nothing at run time; type checkers do
    height = -1 if own is None else LAYERS.index(own)
    found = []
    for name in imports(source, module, is_package, run_time=module == "cpam_bayes"):
        used = layer(name)
        if name == "cpam_bayes" or used is None or used in ROOT_NAMES:
            continue
        if used not in LAYERS:
            found.append(f"{module} imports {name}, which is in no layer")
        elif LAYERS.index(used) > height:
            found.append(f"{module} imports {name}, which stands after it")
    return found


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_a_module_imports_only_from_layers_before_it(path):
    assert violations(path.read_text("utf-8"), module_name(path), path.name == "__init__.py") == []


def test_a_wrong_import_is_found_and_a_right_one_accepted():
    for wrong, module, is_package, source in (
        (1, "cpam_bayes.plate.laminate", False, "from cpam_bayes import mechanics"),
        (1, "cpam_bayes.plate.laminate", False, "def late():\n    from ..mechanics.problem import Problem"),
        (1, "cpam_bayes.forward_model.calculix", True, "from ...inference import swarm"),
        (1, "cpam_bayes", True, "def late():\n    from cpam_bayes.errors import LayupError"),
        (1, "cpam_bayes.newcomer", False, ""),
        (1, "cpam_bayes.cli", False, "from cpam_bayes.newcomer import thing"),
        (0, "cpam_bayes.forward_model.calculix", True, "from .deck import Deck\nfrom . import run"),
        (0, "cpam_bayes", True, f"{ANNOTATIONS}\n    from cpam_bayes.cli import main as main"),
    ):
        assert len(violations(source, module, is_package)) == wrong, source


def test_no_module_imports_itself_through_others():
    names, edges = {module_name(path): path for path in MODULES}, {}
    for module, path in names.items():
        used = imports(path.read_text("utf-8"), module, path.name == "__init__.py")
        owners = {name if name in names else name.rpartition(".")[0] for name in used}
        # the package itself names its modules, which is its purpose
        edges[module] = (owners & names.keys()) - {module, "cpam_bayes"}
    TopologicalSorter(edges).prepare()
    with pytest.raises(CycleError):
        TopologicalSorter({"a": {"b"}, "b": {"c"}, "c": {"b"}}).prepare()


def modules_in_strings(source: str) -> list[str]:
    nodes = list(ast.walk(ast.parse(source)))
    docstrings = [node.value for node in nodes if isinstance(node, ast.Expr)]
    texts = [n for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    return [n.value for n in texts if n not in docstrings and re.match(r"cpam_bayes\.\w", n.value)]


def test_no_module_is_reached_by_a_name_in_a_string():
    assert {module_name(path) for path in MODULES if modules_in_strings(path.read_text("utf-8"))} <= BY_NAME
    found = modules_in_strings('"""See `cpam_bayes.plate`."""\nload(f"cpam_bayes.questions.{name}")')
    assert found == ["cpam_bayes.questions."]


def test_the_documentation_names_no_layer_that_is_not_there():
    rooms = {p.relative_to(PACKAGE).parts[0].removesuffix(".py") for p in MODULES} - {"__init__"}
    assert sorted(LAYERS) == sorted(rooms)


def uses_matplotlib(source: str) -> bool:
    """Whether a module loads matplotlib, at once or in a function; type annotations do not count."""
    return any(name.split(".")[0] == "matplotlib" for name in imports(source, "", False, run_time=True))


def test_matplotlib_is_loaded_where_answers_are_drawn_alone():
    scripts = [*PROJECT.glob("studies/**/*.py"), *PROJECT.glob("benchmarks/*.py")]
    computing = [path for path in MODULES if layer(module_name(path)) not in ("render", "questions")]
    assert [path for path in (*scripts, *computing) if uses_matplotlib(path.read_text("utf-8"))] == []
    figure = "    from matplotlib.figure import Figure"
    assert [uses_matplotlib(f"{above}\n{figure}") for above in (ANNOTATIONS, "def late():")] == [False, True]


@pytest.mark.parametrize("layer", ["cli", pytest.param("questions.", marks=pytest.mark.slow)])
def test_no_heavy_library_is_loaded_before_it_is_asked_for(layer):
    names = [n for n in map(module_name, MODULES) if n.startswith(f"cpam_bayes.{layer}")]
    code = f"import {', '.join(names)}, sys\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True, timeout=120) == "[]\n"


@pytest.mark.parametrize("path", sorted((PACKAGE / "render").rglob("*.py")), ids=module_name)
def test_what_renders_solves_nothing(path):
    calls = (node.func for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Call))
    names = {f.attr if isinstance(f, ast.Attribute) else getattr(f, "id", "") for f in calls}
    assert names & SOLVES == set()


# Modules that read files of others, for which only the wording is available.
READERS = {"plate", "storage"}
READS = {"startswith", "endswith", "removeprefix", "removesuffix", "partition", "rpartition", "split", "find"}
ASKED_FOR = {  # Literals that are compared but never shown, or removed from text of another layer.
    "at least",  # the side of a limit, one of two literals
    "mirror image",  # the name of a symmetry
    "cannot be judged",  # the verdict on a plate of a batch, one of four literals
    "too close to call",  # another one
    "built-in ",  # the source of a specimen, as written by the reader of plates
    "executor: ",  # the name of the argument in an error, which argparse adds itself
}


def read_texts(source: str) -> Iterator[str]:
    """Texts with a space that a module compares with or searches for."""
    for node in ast.walk(ast.parse(source)):
        looked_for: list[ast.expr] = []
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in READS:
            looked_for = node.args
        elif isinstance(node, ast.Compare):
            asked = (ast.Eq, ast.NotEq, ast.In, ast.NotIn)
            looked_for = [node.left, *node.comparators] if any(isinstance(o, asked) for o in node.ops) else []
        for literal in (n for expression in looked_for for n in ast.walk(expression)):
            text = literal.value if isinstance(literal, ast.Constant) else None
            if isinstance(text, str) and " " in text and re.search(r"[A-Za-z]{2}", text):
                yield text


def test_nothing_is_decided_by_a_text_that_is_shown():
    texts = {path: set(read_texts(path.read_text("utf-8"))) for path in MODULES}
    assert set().union(*texts.values()) >= ASKED_FOR
    others = {path: found for path, found in texts.items() if layer(module_name(path)) not in READERS}
    assert {path: found - ASKED_FOR for path, found in others.items() if found - ASKED_FOR} == {}
    source = 'any(w.startswith("The noise") for w in said), verdict == "determined by data" or "E1" in name'
    assert sorted(read_texts(source)) == ["The noise", "determined by data"]
