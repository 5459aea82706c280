"""What stands in several places says the same: version, dependencies, workflows, links."""

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
# What packages of conda are called, and what they bring that an extra brings here.
CONDA_NAMES = {"matplotlib": "matplotlib-base"}
CONDA_EXTRAS = {"xarray-einstats"}


def text_of(name: str) -> str:
    return (PROJECT / name).read_text("utf-8")


def recipe() -> Any:
    return yaml.safe_load(text_of("conda/recipe.yaml"))


def names_and_bounds(requirements: Iterable[str]) -> dict[str, str]:
    """Name -> bounds of requirements without their extras and markers."""
    parts = (re.match(r"([\w-]+)(?:\[[\w,]+\])?\s*([^;]*)", line) for line in requirements)
    return {part[1].casefold(): part[2].strip() for part in parts if part}


def test_licence_and_authors_are_those_of_the_citation_and_of_the_licence_file() -> None:
    project, citation = PYPROJECT["project"], yaml.safe_load(text_of("CITATION.cff"))
    assert citation["license"] == project["license"] == "BSD-3-Clause"
    assert [author["name"] for author in citation["authors"]] == [a["name"] for a in project["authors"]]
    first, *_ = licence = text_of(project["license-files"][0]).splitlines()
    assert first == "BSD 3-Clause License"
    # its third clause is what the one of two clauses lacks
    assert any("names of its" in line or "Neither the name" in line for line in licence)
    assert any(project["authors"][0]["name"].removeprefix("The ") in line for line in licence)


def test_the_version_is_the_same_everywhere() -> None:
    version = PYPROJECT["project"]["version"]
    assert cpam_bayes.__version__ == version
    assert str(yaml.safe_load(text_of("CITATION.cff"))["version"]) == version
    assert recipe()["context"]["version"] == version
    assert f"\nVersion {version}. " in text_of("README.md")
    assert re.findall(r"^## \[([\d.]+)\]", text_of("CHANGELOG.md"), re.MULTILINE)[0] == version


def test_the_recipe_of_conda_has_the_dependencies_of_the_package() -> None:
    ours = names_and_bounds(line for line in PYPROJECT["project"]["dependencies"] if ";" not in line)
    run = names_and_bounds(recipe()["requirements"]["run"])
    assert run.pop("python") == PYPROJECT["project"]["requires-python"]
    assert {name: run.pop(name) for name in CONDA_EXTRAS} == dict.fromkeys(CONDA_EXTRAS, "")
    assert run == {CONDA_NAMES.get(name, name): bounds for name, bounds in ours.items()}
    host = names_and_bounds(recipe()["requirements"]["host"])
    assert host["hatchling"] == names_and_bounds(PYPROJECT["build-system"]["requires"])["hatchling"]


def extra(name: str) -> set[str]:
    """The libraries of an extra, those of the extras of this package in it included."""
    found: set[str] = set()
    for line in PYPROJECT["project"]["optional-dependencies"][name]:
        own = re.fullmatch(r"cpam-bayes\[([\w,]+)\]", line)
        found |= set().union(*map(extra, own[1].split(","))) if own else {line}
    return found


def group(name: str) -> set[str]:
    """The libraries of a dependency group, those of groups in it included."""
    found: set[str] = set()
    for line in PYPROJECT["dependency-groups"][name]:
        found |= {line} if isinstance(line, str) else group(line["include-group"])
    return found


@pytest.mark.parametrize(("named", "as_extra"), [("lint", "dev"), ("docs", "docs"), ("test", "test")])
def test_a_dependency_group_is_its_extra(named: str, as_extra: str) -> None:
    assert group(named) == extra(as_extra)


def test_each_classified_python_is_tested() -> None:
    stated = {c.rpartition(" ")[2] for c in PYPROJECT["project"]["classifiers"] if "Python :: 3." in c}
    jobs = yaml.safe_load(text_of(".github/workflows/tests.yml"))["jobs"]
    for job in ("fast", "weekly"):
        tested = jobs[job]["strategy"]["matrix"]
        assert stated <= set(tested["python"])
        assert len(tested["system"]) == 3
    assert set(re.findall(r'"(3\.\d+)"', text_of("noxfile.py").partition("PYTHONS")[2])) >= stated


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_reads_no_more_than_it_must_and_pins_its_actions(path: Path) -> None:
    workflow = yaml.safe_load(path.read_text("utf-8"))
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert job["name"]
        assert job["timeout-minutes"]
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step)
            if "uses" in step:
                assert re.fullmatch(r"[\w-]+/[\w-]+@(v\d+|release/v\d+)", step["uses"])
    sessions = set(re.findall(r"^def (\w+)\(session", text_of("noxfile.py"), re.MULTILINE))
    asked = re.findall(r"nox --sessions ([\w ]+)", path.read_text("utf-8"))
    assert {name for names in asked for name in names.split()} <= sessions


@pytest.mark.parametrize(
    "name",
    [
        ".github/dependabot.yml",
        ".pre-commit-config.yaml",
        *(f".github/ISSUE_TEMPLATE/{name}.yml" for name in ("config", "question", "wish", "wrong_answer")),
    ],
)
def test_a_file_of_settings_can_be_read(name: str) -> None:
    assert yaml.safe_load(text_of(name))


def test_the_hook_of_ruff_is_of_the_series_that_ci_has() -> None:
    hook = next(r for r in yaml.safe_load(text_of(".pre-commit-config.yaml"))["repos"] if "ruff" in r["repo"])
    stated = next(line for line in extra("dev") if line.startswith("ruff"))
    assert hook["rev"].startswith("v" + stated.partition(">=")[2].partition(",")[0] + ".")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_link_of_a_page_leads_to_a_file(page: Path) -> None:
    prose = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[\w-]+)?\)", prose)
    assert [t for t in targets if "://" not in t and not (page.parent / t).exists()] == []


def test_what_the_source_distribution_takes_is_there() -> None:
    included = PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert [name for name in included if not (PROJECT / name.lstrip("/")).exists()] == []


def test_the_article_is_short_and_has_all_its_references() -> None:
    article, entries = text_of("paper/paper.md"), text_of("paper/paper.bib")
    cited = set(re.findall(r"@(\w+)", article))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", entries, re.MULTILINE))
    assert len(article.split()) <= 900


def test_the_container_runs_the_command_as_a_user_of_its_own() -> None:
    lines = text_of("Containerfile").splitlines()
    assert 'ENTRYPOINT ["cpam-bayes"]' in lines
    assert [line for line in lines if line.startswith("USER")] == ["USER tester"]
