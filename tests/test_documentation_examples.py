"""The documentation's examples and notebooks run and give the output shown; its site is complete."""

import json
import os
import re
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import matplotlib
import nbformat
import pytest
import yaml

import cpam_bayes as cb
from cpam_bayes.cli import COMMANDS, _asked
from cpam_bayes.documents import DOCUMENTS, json_schema
from docs.build.examples import ExampleError, _alike, check, run_block
from tests.browser import open_browser
from tests.test_studies import script

PROJECT = Path(__file__).parent.parent
DOCS = PROJECT / "docs"
PAGES = sorted([*PROJECT.glob("docs/*.md"), PROJECT / "README.md"])
# Pages whose examples take more than five seconds, more than thirty, and one that runs CalculiX.
SLOW = "README effects many_plates mode_shapes priors repeats coin_test from_a_hit hybrids several_plates"
LONG = "cluster laboratory library other_plates sensitivity sensors tutorial"
MARKS = {name: [pytest.mark.slow] for name in SLOW.split()}
MARKS |= {name: [pytest.mark.slow, pytest.mark.weekly] for name in LONG.split()}
MARKS |= {"calculix_abaqus": [pytest.mark.needs_ccx, pytest.mark.slow, pytest.mark.weekly]}
WITH_EXAMPLES = [
    pytest.param(page, marks=MARKS.get(page.stem, []), id=page.stem)
    for page in PAGES
    if re.search(r"^```(python|console)", page.read_text("utf-8"), re.MULTILINE)
]
# only the last digit may differ, by rounding
SAME = dict.fromkeys(("second 2.00", "second 2.01"), True)
OTHER = dict.fromkeys(("second 2.02", "second 2.000", "third 2.00", "second 2.00\nthird 3.00"), False)
NOTEBOOKS = sorted((PROJECT / "notebooks").glob("*.ipynb"))
WEEKLY_BUT_ONE = [
    pytest.param(p, marks=() if "posterior" in p.stem else pytest.mark.weekly, id=p.stem) for p in NOTEBOOKS
]
HIDDEN = "[...document.querySelectorAll('article img')].filter(i => !i.naturalWidth).map(i => i.src)"


@pytest.mark.parametrize("page", WITH_EXAMPLES)
def test_the_examples_of_a_page_run_and_print_what_it_says(page, tmp_path, monkeypatch):
    """To rewrite the outputs: ``python docs/build/examples.py PAGE``."""
    monkeypatch.setattr(matplotlib, "rcParams", matplotlib.rcParams.copy())
    assert check(page, tmp_path) > 0


def test_a_sampled_mean_may_differ_by_a_twentieth_of_its_standard_deviation():
    texts = ("5.44 +- 0.54 g", "5.45 +- 0.54 g", "5.44 g +- 0.54 g")
    assert [_alike(f"5.42{text[4:]}", text) for text in texts] == [True, False, False]


@pytest.mark.parametrize(("documented", "is_the_same"), [*SAME.items(), *OTHER.items()])
def test_an_output_that_is_not_the_documented_one_fails(tmp_path, documented, is_the_same):
    page, command = tmp_path / "page.md", r"printf 'first in 9.9 s\nsecond 2.00\n'"
    page.write_text(f"```console\n$ {command}\nfirst in 3.2 s\n{documented}\n```\n")
    with nullcontext() if is_the_same else pytest.raises(ExampleError, match=r"page\.md"):
        assert check(page, tmp_path) == 1


def test_a_value_that_is_not_the_documented_one_and_a_command_that_fails_fail(tmp_path):
    run_block("1 + 1  # -> 2\n", {})
    with pytest.raises(ExampleError, match=r"1 \+ 1"):
        run_block("1 + 1  # -> 3\n", {})
    page = tmp_path / "page.md"
    page.write_text("```console\n$ exit 1\n```\n", encoding="utf-8")
    with pytest.raises(ExampleError, match="exit status 1"):
        check(page, tmp_path)


def test_the_plate_and_the_picture_of_the_first_pages_are_those_of_the_tutorial():
    names = ("docs/tutorial.md", "README.md", "examples/panel.toml", "docs/pictures/from_foam_to_report.svg")
    tutorial, readme, panel, picture = ((PROJECT / name).read_text("utf-8") for name in names)
    assert f'```toml title="panel.toml"\n{panel}```' in tutorial
    assert f'```toml title="examples/panel.toml"\n{panel}```' in readme
    _, _, posterior = tutorial.partition("--out posterior\n")
    rows = re.findall(r"^  (?:E1|E2|nu12|G12) .*?[\d.]+ to [\d.]+", posterior, re.MULTILINE)[:4]
    assert intervals(picture) == intervals("\n".join(rows))
    (mass,) = re.findall(r"([\d.]+ g) of added mass", picture)
    assert f"an added mass of {mass}" in " ".join(tutorial.split())


def intervals(text: str) -> list[list[float]]:
    return [[round(float(end), 2) for end in ends] for ends in re.findall(r"([\d.]+) to ([\d.]+)", text)]


def test_every_command_and_option_of_the_documentation_exists():
    options, found = {}, 0
    for name in COMMANDS:
        (commands,) = (action for action in _asked([name])[1]._actions if action.dest == "command")
        options[name] = {o for action in commands.choices[name]._actions for o in action.option_strings}
    for page in PAGES:
        for name, rest in re.findall(r"cpam-bayes ([a-z]+)((?: [^`\n|]*)?)", page.read_text("utf-8")):
            assert name in options, f"{page.name}: cpam-bayes {name}"
            unknown = set(re.findall(r"(?<=\s)--[a-z-]+", rest)) - options[name]
            assert not unknown, f"{page.name}: cpam-bayes {name}{rest}"
            found += 1
    assert found > len(COMMANDS)
    listed = (DOCS / "commands.md").read_text("utf-8")
    assert set(COMMANDS) <= set(re.findall(r"^\| `cpam-bayes ([a-z]+)", listed, re.MULTILINE))


def outputs(notebook: nbformat.NotebookNode) -> list[tuple[str, list[nbformat.NotebookNode]]]:
    return [(cell.source, cell.outputs) for cell in notebook.cells if cell.cell_type == "code"]


def test_three_notebooks_are_saved_with_results_figures_and_no_errors():
    assert len(NOTEBOOKS) == 3
    for path in NOTEBOOKS:
        shown = [out for _, some in outputs(nbformat.read(path, as_version=4)) for out in some]
        assert {"image/png", "text/html"} <= {kind for out in shown for kind in out.get("data", {})}
        assert all(out.output_type != "error" for out in shown)


@pytest.mark.slow
@pytest.mark.parametrize("path", WEEKLY_BUT_ONE)
def test_a_notebook_runs_and_shows_what_it_is_saved_with(path):
    saved, executed = (
        [(source, [out.output_type for out in shown]) for source, shown in outputs(notebook)]
        for notebook in (nbformat.read(path, as_version=4), script("notebooks", "execute").executed(path))
    )
    assert executed == saved


def listed_pages(nav: list[Any]) -> list[str]:
    pages: list[str] = []
    for entry in nav:
        for target in entry.values() if isinstance(entry, dict) else [entry]:
            pages += [target] if isinstance(target, str) else listed_pages(target)
    return pages


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    directory = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(directory)]
    env = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=PROJECT, env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return directory


def test_the_navigation_names_every_page_once():
    nav = yaml.safe_load((PROJECT / "mkdocs.yml").read_text("utf-8"))["nav"]
    assert sorted(listed_pages(nav)) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))


def test_the_site_builds_strictly_with_figures_equations_schemas_and_the_api(site):
    api = (site / "api.html").read_text("utf-8")
    described = re.findall(r"^::: cpam_bayes\.(\w+)$", (DOCS / "api.md").read_text("utf-8"), re.MULTILINE)
    assert set(cb.__all__) <= set(described)
    assert all(f'id="cpam_bayes.{name}"' in api for name in cb.__all__)
    text = re.sub(r"<[^>]+>", "", api)  # lists of fields (docs/build/docstrings.py), typed by signatures
    assert re.search(r"density: kg/m3, from the mass when that was given", text)
    assert re.search(r"plate\s*\(\s*PlateLike\s*\)\W+the name of a built-in specimen", text)
    theory = (site / "theory.html").read_text("utf-8")
    assert re.search(r"\\(frac|int|sum|nu)\b", theory) is None
    assert theory.count("<math") > 20
    for command in DOCUMENTS:
        assert json.loads((site / "schema" / f"{command}.json").read_text("utf-8")) == json_schema(command)
    # nothing is loaded from a network
    fetching = re.compile(r'(?:<(?:script|img|iframe)[^>]*\ssrc=|@import\s|url\()["\']?(?:https?:)?//')
    for file in [*site.rglob("*.html"), *site.rglob("*.css")]:
        shown = file.read_text("utf-8")
        assert not fetching.search(shown), file.name
        for source in re.findall(r'<img[^>]*\ssrc="([^"]+)"', shown):
            assert (file.parent / source).is_file(), f"{file.name}: {source}"


@pytest.mark.needs_browser
def test_every_page_fits_a_screen_and_a_phone_and_shows_its_figures(site):
    with open_browser() as browser:
        for page in sorted(site.glob("*.html")):
            for width in (1280, 390):
                browser.show(page, width)
                wide = browser.value("document.documentElement.scrollWidth")
                assert wide <= width, f"{page.name}: {wide} px in a window of {width}"
                assert browser.value(HIDDEN) == [], page.name
        assert [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))] == []
