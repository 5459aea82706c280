"""Facts stated in several places agree: version, dependencies, workflows, links."""

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml

import cpam_bayes

PROJECT = Path(__file__).parent.parent
PYPROJECT = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))
WORKFLOWS = sorted((PROJECT / ".github" / "workflows").glob("*.yml"))
PAGES = sorted([*PROJECT.glob("*.md"), *PROJECT.glob(".github/*.md")])
# names in conda, and what needs an extra only here
CONDA_NAMES = {"matplotlib": "matplotlib-base"}
CONDA_EXTRAS = {"xarray-einstats"}


def text_of(name: str) -> str:
    return (PROJECT / name).read_text("utf-8")


def yaml_of(name: str) -> Any:
    return yaml.safe_load(text_of(name))


def names_and_bounds(requirements: Iterable[str]) -> dict[str, str]:
    parts = (re.match(r"([\w-]+)(?:\[[\w,]+\])?\s*([^;]*)", line) for line in requirements)
    return {part[1].casefold(): part[2].strip() for part in parts if part}


def test_version_licence_and_authors_are_the_same_everywhere():
    project, citation = PYPROJECT["project"], yaml_of("CITATION.cff")
    version = project["version"]
    recipe = yaml_of("conda/recipe.yaml")["context"]["version"]
    assert cpam_bayes.__version__ == str(citation["version"]) == recipe == version
    assert f"\nVersion {version}. " in text_of("README.md")
    assert re.findall(r"^## \[([\d.]+)\]", text_of("CHANGELOG.md"), re.MULTILINE)[0] == version
    assert citation["license"] == project["license"] == "BSD-3-Clause"
    assert [author["name"] for author in citation["authors"]] == [a["name"] for a in project["authors"]]
    licence = text_of(project["license-files"][0])
    assert licence.startswith("BSD 3-Clause License\n")
    assert re.search("names of its|Neither the name", licence)  # the third clause, missing in two-clause BSD
    assert project["authors"][0]["name"].removeprefix("The ") in licence


def test_the_recipe_of_conda_has_the_dependencies_of_the_package():
    ours = names_and_bounds(line for line in PYPROJECT["project"]["dependencies"] if ";" not in line)
    run, host = (names_and_bounds(yaml_of("conda/recipe.yaml")["requirements"][of]) for of in ("run", "host"))
    assert run.pop("python") == PYPROJECT["project"]["requires-python"]
    assert {name: run.pop(name) for name in CONDA_EXTRAS} == dict.fromkeys(CONDA_EXTRAS, "")
    assert run == {CONDA_NAMES.get(name, name): bounds for name, bounds in ours.items()}
    assert host["hatchling"] == names_and_bounds(PYPROJECT["build-system"]["requires"])["hatchling"]


def libraries(name: str, of: Any) -> set[str]:
    """Libraries of an extra or a dependency group, including those of others in it."""
    found: set[str] = set()
    for line in of[name]:
        own = re.fullmatch(r"cpam-bayes\[([\w,]+)\]", str(line))
        others = own[1].split(",") if own else [] if isinstance(line, str) else [line["include-group"]]
        found |= set().union(*(libraries(other, of) for other in others)) if others else {line}
    return found


def test_a_dependency_group_is_its_extra_and_the_hook_of_ruff_is_of_its_series():
    groups, extras = PYPROJECT["dependency-groups"], PYPROJECT["project"]["optional-dependencies"]
    for group, extra in (("lint", "dev"), ("docs", "docs"), ("test", "test")):
        assert libraries(group, groups) == libraries(extra, extras)
    hook = next(r for r in yaml_of(".pre-commit-config.yaml")["repos"] if "ruff" in r["repo"])
    (series,) = re.findall(r"^ruff>=([\d.]+),", "\n".join(extras["dev"]), re.MULTILINE)
    assert hook["rev"].startswith(f"v{series}.")


def test_each_classified_python_is_tested():
    stated = {c.rpartition(" ")[2] for c in PYPROJECT["project"]["classifiers"] if "Python :: 3." in c}
    jobs = yaml_of(".github/workflows/tests.yml")["jobs"]
    for tested in (jobs[job]["strategy"]["matrix"] for job in ("fast", "weekly")):
        assert (stated - set(tested["python"]), len(tested["system"])) == (set(), 3)
    assert set(re.findall(r'"(3\.\d+)"', text_of("noxfile.py").partition("PYTHONS")[2])) >= stated


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_reads_no_more_than_it_must_and_pins_its_actions(path):
    workflow = yaml.safe_load(path.read_text("utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert job.keys() >= {"name", "timeout-minutes"}
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step)
            if "uses" in step:
                assert re.fullmatch(r"[\w-]+/[\w-]+@(v\d+|release/v\d+)", step["uses"])
    sessions = set(re.findall(r"^def (\w+)\(session", text_of("noxfile.py"), re.MULTILINE))
    asked = re.findall(r"nox --sessions ([\w ]+)", path.read_text("utf-8"))
    assert {name for names in asked for name in names.split()} <= sessions


def test_links_of_pages_and_what_the_source_distribution_takes_lead_to_files():
    for page in PAGES:
        prose = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
        targets = re.findall(r"\]\(([^)#\s]+)(?:#[\w-]+)?\)", prose)
        assert [t for t in targets if "://" not in t and not (page.parent / t).exists()] == [], page.name
    included = PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert [name for name in included if not (PROJECT / name.lstrip("/")).exists()] == []
