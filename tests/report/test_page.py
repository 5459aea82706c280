"""One page for every answer: whole in itself, its words and figures those of the result, for every reader."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape, unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from cpam_bayes.diagnosis.plates import diagnosis_result
from cpam_bayes.forward_model.builtin import plates
from cpam_bayes.report.page import Image, page_text
from cpam_bayes.report.sections import Caption, Section
from cpam_bayes.report.summary import ConstantLine, Summary
from cpam_bayes.report.tables import Column, Table
from cpam_bayes.report.terms import TERMS, terms_section
from cpam_bayes.result import Result
from tests.browser import Browser, faults, open_browser
from tests.diagnosed import aluminium_case, diagnosed, listed

PROJECT = Path(__file__).parents[2]
MAX_BYTES = 5_000_000
WIDE, PHONE = 1280, 390
# Width of A4 between margins of 15 mm, CSS pixels.
PAPER = 680


@pytest.fixture(scope="module")
def results(point, forward_result) -> dict[str, Result]:
    """A result of each kind that is quick to have."""
    found = diagnosed(
        [listed(aluminium_case(), np.array([1.0, 1.0, 1.05, 1.0, 1.0, 1.0]))], ["outlier", "viscoelastic"]
    )
    return {
        "identify": point,
        "forward": forward_result,
        "diagnose": diagnosis_result(found, 0),
        "plates": plates(),
    }


@pytest.fixture(scope="module")
def pages(results, tmp_path_factory) -> dict[str, Path]:
    """The page of each, as `--out` writes it."""
    root = tmp_path_factory.mktemp("pages")
    for name, result in results.items():
        result.save(root / name)
    return {name: root / name / "report.html" for name in results}


NAMES = ("identify", "forward", "diagnose", "plates")


class Outline(HTMLParser):
    """Levels of headings, alternative texts and attributes of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.headings: list[int] = []
        self.alt: list[str] = []
        self.loaded: list[str] = []
        self.tags: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag == "img":
            self.alt.append(given.get("alt") or "")
        if tag in ("img", "link", "script", "iframe"):
            self.loaded.append(given.get("src") or given.get("href") or "")


@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_whole_in_itself_and_small(pages, name):
    text = pages[name].read_text(encoding="utf-8")
    page = Outline(text)
    assert len(text.encode()) <= MAX_BYTES
    assert all(source.startswith("data:") for source in page.loaded)
    assert "script" not in page.tags
    assert "default-src 'none'" in text
    assert "url(" not in text


@pytest.mark.parametrize("name", NAMES)
def test_a_page_can_be_read_aloud(pages, name):
    text = pages[name].read_text(encoding="utf-8")
    page = Outline(text)
    assert '<html lang="en">' in text
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in text
    assert page.headings[0] == 1
    assert page.headings.count(1) == 1
    assert all(later <= earlier + 1 for earlier, later in zip(page.headings, page.headings[1:], strict=False))
    assert all(len(alt) > 20 for alt in page.alt)


@pytest.mark.parametrize("name", NAMES)
def test_every_figure_has_its_caption_and_its_place(results, name):
    result = results[name]
    figures, captions = set(result.figures()), result.captions()
    placed = [figure for section in result.sections() for figure in section.figures]
    assert set(captions) == figures
    assert sorted(placed) == sorted(figures)
    assert all(caption.text.endswith(".") and caption.alt.endswith(".") for caption in captions.values())


@pytest.mark.parametrize("name", NAMES)
def test_a_page_holds_the_tables_of_the_result(results, pages, name):
    text = pages[name].read_text(encoding="utf-8")
    for table in results[name].tables():
        if table.rows:
            assert escape(table.title) in text


def summary_of(**changes) -> Summary:
    line = ConstantLine(
        "E1", "Young's modulus", "E1_GPa", 120.0, (110.0, 130.0), "GPa", 121.2, "no", "its bounds"
    )
    given = {"title": "identify D&G", "headline": "Nothing < something.", "constants": (line,)}
    return Summary(**(given | changes))


def test_text_of_a_page_is_escaped():
    table = Table("a < b", (Column("x"), Column("n", number=True)), (("<script>", "1"),), frozenset({0}))
    image = Image("data:,", 100, Caption("<b>.", 'a "quoted" <i>.'))
    text = page_text("D&G", summary_of(), [Section("s", (table,), ("f",))], {"f": image})
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert "<title>D&amp;G</title>" in text
    assert "Nothing &lt; something." in text
    assert '<tr class="flag">' in text
    assert "<i>" not in text
    assert "<figcaption>&lt;b&gt;.</figcaption>" in text


def test_words_of_the_command_line_are_code_and_signs_are_typeset():
    text = page_text("t", summary_of(basis=("Ask `identify <b>`: 1 +- 2.",)), [], {})
    assert "<li>Ask <code>identify &lt;b&gt;</code>: 1 \N{PLUS-MINUS SIGN} 2.</li>" in text


def test_a_page_says_the_summary_first_and_its_slips_before_all():
    summary = summary_of(
        slips=("a slip of units",), warnings=("a warning",), next_steps=("Weigh the plate.",)
    )
    text = page_text("t", summary, [Section("Later", (Table("x", (Column(),), (("y",),)),))], {})
    said = ["A slip of units.", "Nothing &lt; something.", "110.0 to 130.0", "A warning.", "Weigh", "Later"]
    places = [text.index(words) for words in said]
    assert places == sorted(places)


@pytest.mark.parametrize("name", NAMES)
def test_a_page_explains_the_words_that_it_uses(pages, name):
    body = pages[name].read_text(encoding="utf-8").partition("<body>")[2]
    text = unescape(" ".join(re.sub(r"<[^>]*>", " ", body).split()))
    said, _, explained = text.partition("Words on this page")
    for word, meaning in TERMS.items():
        used = re.search(rf"\b{word}\b", said, re.IGNORECASE) is not None
        assert not used or meaning.replace("`", "") in explained, word


def test_the_words_of_pages_are_those_of_the_glossary():
    glossary = (PROJECT / "docs" / "glossary.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", glossary, re.MULTILINE))
    assert {word: rows.get(word) for word in TERMS} == TERMS
    section = terms_section("The posterior, two walkers, evidences; a noisy interim.")
    assert [word for word, _ in section.tables[0].rows] == ["evidence", "posterior", "walker"]


def test_a_section_without_content_is_left_out():
    text = page_text("t", summary_of(), [Section("Empty", (Table("x", (Column(),), ()),))], {})
    assert "Empty" not in text


# In a browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with open_browser() as opened:
        yield opened


@pytest.mark.needs_browser
@pytest.mark.parametrize("width", [WIDE, PHONE])
@pytest.mark.parametrize("name", NAMES)
def test_a_page_in_a_browser(browser, pages, name, width):
    assert faults(browser, pages[name], width) == []
    assert browser.value("document.images.length") > 0 or name == "plates"


@pytest.mark.needs_browser
def test_what_is_folded_is_printed(browser, pages):
    browser.show(pages["diagnose"], PAPER)
    browser.call("Emulation.setEmulatedMedia", media="print")
    closed = browser.value("[...document.querySelectorAll('details')].filter((d) => !d.open).length")
    content = "[...document.querySelectorAll('img, table')]"
    hidden = browser.value(f"{content}.filter((i) => !i.checkVisibility()).length")
    width = browser.value("document.documentElement.scrollWidth")
    browser.call("Emulation.setEmulatedMedia", media="")
    assert closed > 0
    assert hidden == 0
    assert width <= PAPER


@pytest.mark.needs_browser
def test_a_folded_section_opens_by_key(browser, pages):
    browser.show(pages["identify"], WIDE)
    browser.value("document.querySelector('summary').focus()")
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13,
                     text="\r" if kind == "keyDown" else "")  # fmt: skip
    assert browser.value("document.querySelector('details').open") is True


@pytest.mark.needs_browser
def test_a_page_that_asks_the_network_is_found_out(browser, tmp_path):
    page = tmp_path / "page.html"
    page.write_text('<img src="http://127.0.0.1:9/x.png"><script>console.log("said")</script>', "utf-8")
    browser.requests.clear()
    browser.console.clear()
    browser.show(page, WIDE)
    assert "http://127.0.0.1:9/x.png" in browser.requests
    assert any("said" in text for text in browser.console)
