"""One page for every answer: self-contained, the answer first, accessible to every reader."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from cpam_bayes.render.page import TERMS, page_text, terms_section
from tests.answers import EVERY, answered
from tests.browser import faults, open_browser
from tests.render.small import REPORT, RESULT

PROJECT = Path(__file__).parents[2]
WIDE, PHONE = 1280, 390
PAPER = 680  # Width of A4 minus margins of 15 mm, CSS pixels.

# Text of the page with its elements, without styles and the figure's data.
BODY = """\
main section h1 identify D&G
p.slip The list is in kHz, not Hz. Divide by 1000.
p.headline 1 frequency < 2 constants: E1 is determined.
h2 Constants
div.scroll table thead tr th th.n value
th 95 % interval
th note
tbody tr th E1
td.n 136.6 GPa
td 131 to 142
td determined
tr.flag th E2
td.n 8.9 GPa
td td not determined
p Fit 0.19 %,
code relative_std
/ \N{PLUS-MINUS SIGN} 0.2 %.
p.next b Next:
/ is anything wrong?
code cpam-bayes diagnose 'D&G'
div.warnings h2 Warnings
ul li The noise is high.
div.open section h2 Fit of each mode
div.figures figure div.scroll img figcaption A line <b>.
details.numbers summary Layup
h3 Layup
div.scroll table.facts tbody tr th layup
td [(0/90)_8]_s
details summary h2 Details
h3 In words
ul li.flag [red]no colour[/red] <script>
"""


class Outline(HTMLParser):
    """Text of a page after its head, one line per piece, with the elements that begin there."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.headings: list[int] = []
        self.lines, self.begun, self.loaded, self.alt = ([] for _ in range(4))
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        kind = given.get("class")
        self.begun.append(f"{tag}.{kind}" if kind and kind not in ("answer", "words") else tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag in ("img", "link", "script", "iframe"):
            self.loaded.append(given.get("src") or given.get("href") or "")
        if tag == "img":
            self.alt.append(given.get("alt") or "")

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.lines.append(" ".join([*(self.begun or ["/"]), " ".join(data.split())]))
            self.begun = []


@pytest.fixture(scope="module")
def browser():
    with open_browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    out = tmp_path_factory.mktemp("small")
    RESULT.save(out)
    return out / "report.html"


def test_a_page_says_the_answer_first_then_the_fit_and_folds_the_rest(page):
    body = page.read_text("utf-8").partition("<body>")[2]
    lines = "\n".join(Outline(body).lines) + "\n"
    assert lines[: len(BODY)] == BODY
    assert "Empty" not in body


def test_a_page_is_whole_in_itself_and_can_be_read_aloud(page):
    text = page.read_text("utf-8")
    outline = Outline(text)
    assert all(source.startswith("data:") for source in outline.loaded)
    assert [part for part in ("<script", "url(") if part in text] == []
    size = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    for part in ("default-src 'none'", "<title>identify</title>", '<html lang="en">', size):
        assert part in text
    assert [i for i, level in enumerate(outline.headings) if level == 1] == [0]
    steps = zip(outline.headings, outline.headings[1:], strict=False)
    assert all(later <= earlier + 1 for earlier, later in steps)
    assert outline.alt == ['A "straight" line, drawn as an example.']


def test_a_notebook_shows_the_first_screen_alone():
    lines = Outline(RESULT._repr_html_()).lines
    assert lines[0] == "p b identify D&G"
    said = [any(word in line for line in lines) for word in ("136.6 GPa", "Details", "Computation")]
    assert said == [True, False, False]


def test_a_page_explains_the_words_that_it_uses_as_the_glossary_does():
    glossary = (PROJECT / "docs" / "glossary.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", glossary, re.MULTILINE))
    assert {word: rows.get(word) for word in TERMS} == TERMS
    section = terms_section("The posterior, two walkers, evidences; a noisy interim.")
    assert [word for word, _ in section.tables[0].rows] == ["evidence", "posterior", "walker"]
    assert TERMS["walker"] in page_text("t", REPORT.summary, (section,), {})


@pytest.mark.needs_browser
@pytest.mark.parametrize("name", EVERY)
def test_the_page_of_a_command_has_no_fault_on_a_screen_and_on_a_phone(browser, name, tmp_path):
    answered(name).save(tmp_path)
    page = tmp_path / "report.html"
    assert faults(browser, page, WIDE) + faults(browser, page, PHONE) == []
    assert page.stat().st_size < 5_000_000


@pytest.mark.needs_browser
def test_small_letters_and_what_asks_the_network_are_found(browser, page, tmp_path):
    assert faults(browser, page, PHONE) == []
    own = tmp_path / "page.html"
    own.write_text(re.sub(r'style="min-width: \d+px"', "", page.read_text("utf-8")), encoding="utf-8")
    assert any(fault.startswith("small letters") for fault in faults(browser, own, PHONE))
    asked = "http://127.0.0.1:9/x.png"
    own.write_text(f'<img src="{asked}"><script>console.log("said")</script>', "utf-8")
    found = faults(browser, own, WIDE)
    assert f"asked for {asked}" in found
    assert any(fault.startswith("console: ") and "said" in fault for fault in found)


@pytest.mark.needs_browser
def test_what_is_folded_is_printed_and_opens_by_key(browser, page):
    browser.show(page, PAPER)
    browser.call("Emulation.setEmulatedMedia", media="print")
    closed = browser.value("[...document.querySelectorAll('details')].filter((d) => !d.open).length")
    content = "[...document.querySelectorAll('img, table')]"
    hidden = browser.value(f"{content}.filter((i) => !i.checkVisibility()).length")
    width = browser.value("document.documentElement.scrollWidth")
    browser.call("Emulation.setEmulatedMedia", media="")
    assert hidden == 0
    assert closed > 0
    assert width <= PAPER
    browser.show(page, WIDE)
    browser.value("document.querySelector('summary').focus()")
    enter = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13}
    for kind, text in (("keyDown", "\r"), ("keyUp", "")):
        browser.call("Input.dispatchKeyEvent", type=kind, text=text, **enter)
    assert browser.value("document.querySelector('details').open") is True
