"""The site of the documentation: every page in its place, every public name, nothing from a network."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

import cpam_bayes as cb
from cpam_bayes.documents import DOCUMENTS, json_schema
from tests.browser import open_browser

PROJECT = Path(__file__).parent.parent
DOCS = PROJECT / "docs"
HIDDEN = "[...document.querySelectorAll('article img')].filter(i => !i.naturalWidth).map(i => i.src)"


def listed_pages(nav: list[Any]) -> list[str]:
    """The pages of a navigation, in its order."""
    pages: list[str] = []
    for entry in nav:
        for target in entry.values() if isinstance(entry, dict) else [entry]:
            pages += [target] if isinstance(target, str) else listed_pages(target)
    return pages


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(directory)],
        cwd=PROJECT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return directory


def test_the_navigation_names_every_page_once() -> None:
    nav = yaml.safe_load((PROJECT / "mkdocs.yml").read_text("utf-8"))["nav"]
    assert sorted(listed_pages(nav)) == sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))


def test_the_site_builds_strictly_with_figures_equations_schemas_and_the_api(site: Path) -> None:
    api = (site / "api.html").read_text("utf-8")
    described = re.findall(r"^::: cpam_bayes\.(\w+)$", (DOCS / "api.md").read_text("utf-8"), re.MULTILINE)
    assert set(cb.__all__) <= set(described)
    assert all(f'id="cpam_bayes.{name}"' in api for name in cb.__all__)
    # fields of docstrings are a list, of docs/build/docstrings.py, with the types of the signature
    text = re.sub(r"<[^>]+>", "", api)
    assert re.search(r"density: kg/m3, from the mass when that was given", text)
    assert re.search(r"plate\s*\(\s*PlateLike\s*\)\W+the name of a built-in specimen", text)
    theory = (site / "theory.html").read_text("utf-8")
    assert theory.count("<math") > 20
    assert not re.search(r"\\(frac|int|sum|nu)\b", theory)
    for command in DOCUMENTS:
        assert json.loads((site / "schema" / f"{command}.json").read_text("utf-8")) == json_schema(command)
    # nothing comes from a network
    fetching = re.compile(r'(?:<(?:script|img|iframe)[^>]*\ssrc=|@import\s|url\()["\']?(?:https?:)?//')
    for file in [*site.rglob("*.html"), *site.rglob("*.css")]:
        shown = file.read_text("utf-8")
        assert not fetching.search(shown), file.name
        if file.suffix == ".html":
            for source in re.findall(r'<img[^>]*\ssrc="([^"]+)"', shown):
                assert (file.parent / source).is_file(), f"{file.name}: {source}"


@pytest.mark.needs_browser
def test_every_page_fits_a_screen_and_a_phone_and_shows_its_figures(site: Path) -> None:
    with open_browser() as browser:
        for page in sorted(site.glob("*.html")):
            for width in (1280, 390):
                browser.show(page, width)
                wide = browser.value("document.documentElement.scrollWidth")
                assert wide <= width, f"{page.name}: {wide} px in a window of {width}"
                hidden = browser.value(HIDDEN)
                assert hidden == [], page.name
        assert [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))] == []
