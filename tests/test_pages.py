"""Pages say what the saved results say: every generated section is written anew and compared."""

import json
from functools import cache
from pathlib import Path

import pytest

from cpam_bayes.plate.records import USUAL_SCALE_SD, USUAL_SD
from tests.test_studies import PROJECT, SAVED, STUDIES, script
from validation import reporting
from validation.reporting import (
    FIGURE,
    counted,
    figure_section,
    fingerprint_of_study,
    in_digits,
    listed,
    markdown_table,
    marks,
    outdated,
    pages,
    save_results,
    sections_of_figures,
    with_error,
    with_sections,
    write_sections,
)

PAGES = {str(path.relative_to(PROJECT)): path for path in pages(PROJECT)}
WITH_SECTIONS = [name for name, path in PAGES.items() if marks(path.read_text(encoding="utf-8"))]
PAGE = "Typed.\n\n<!-- 01_study: part -->\nold\n<!-- /01_study -->\n\nTyped, too.\n"


@cache
def sections(study: str) -> dict[str, str]:
    module = script("studies", study)
    results = json.loads((SAVED / f"{study}.json").read_text(encoding="utf-8"))
    return dict(module.sections(results)) if hasattr(module, "sections") else {}


@pytest.mark.parametrize("name", WITH_SECTIONS)
def test_a_page_says_what_the_saved_results_say(name: str) -> None:
    """Written anew by: python studies/write_pages.py."""
    assert script("studies", "write_pages").written(PAGES[name], STUDIES) == PAGES[name].read_text("utf-8")


def test_the_documentation_has_at_most_30_000_words() -> None:
    words = {name: len(path.read_text("utf-8").split()) for name, path in PAGES.items()}
    longest_first = sorted(words.items(), key=lambda page: -page[1])
    assert sum(words.values()) <= 30_000, longest_first


def test_the_page_of_priors_has_the_tolerances_that_hold_where_a_file_states_none() -> None:
    page = PAGES["docs/priors.md"].read_text("utf-8")
    said = {}
    for row in page.partition("| of | default | stands for |\n")[2].partition("\n\n")[0].splitlines()[1:]:
        names, text = row.split("|")[1:3]
        for name in names.partition("(")[0].split(","):
            said[name.strip()] = float(text.split()[0]) / 100
    used = {**USUAL_SD, "frequency scale": USUAL_SCALE_SD}
    assert said == pytest.approx(used)


def test_every_source_of_a_section_is_a_study_a_figure_or_a_benchmark() -> None:
    sources = {source for path in PAGES.values() for source, _ in marks(path.read_text(encoding="utf-8"))}
    # benchmarks/waits.py writes the tables of docs/speed.md
    assert sources <= {FIGURE, "waits", *STUDIES}


def test_a_study_that_writes_sections_has_its_place_in_a_page() -> None:
    asked = {mark for path in PAGES.values() for mark in marks(path.read_text(encoding="utf-8"))}
    for study in STUDIES:
        written = {name for name in sections(study) if (study, name) in asked}
        assert bool(written) == bool(sections(study)), study


def test_figures_stand_in_pages_with_their_captions_alone() -> None:
    for path in PAGES.values():
        none = dict.fromkeys(sections_of_figures(PROJECT, path), "")
        text = with_sections(path.read_text(encoding="utf-8"), FIGURE, none)
        by_hand = [line for line in text.splitlines() if line.startswith("![") and "figures/" in line]
        assert by_hand == [] or path.name == "README.md"


@pytest.mark.parametrize(
    ("study", "key", "name"),
    [("13_several_plates", "setups", "setups"), ("17_worked_cases", "cases", "cases")],
)
def test_a_section_follows_whatever_the_results_hold(study: str, key: str, name: str) -> None:
    results = json.loads((SAVED / f"{study}.json").read_text(encoding="utf-8"))
    fewer = {**results, key: results[key][:-1]}
    assert script("studies", study).sections(fewer)[name] != sections(study)[name]


def test_a_section_is_written_between_its_marks_alone() -> None:
    written = with_sections(PAGE, "01_study", {"part": "new"})
    assert written == PAGE.replace("\nold\n", "\n\nnew\n\n")
    assert with_sections(written, "01_study", {"part": "new"}) == written
    assert with_sections(PAGE, "02_another", {}) == PAGE
    with pytest.raises(ValueError, match="no section of 01_study is named 'part'; there are whole"):
        with_sections(PAGE, "01_study", {"whole": ""})


@pytest.mark.parametrize(
    "lone", ["<!-- 01_study: part -->\n", "<!-- /01_study -->\n", "<!-- figure: x -->\n"]
)
def test_a_mark_without_its_pair_is_refused(lone: str) -> None:
    with pytest.raises(ValueError, match="without their pair"):
        marks("Typed.\n\n" + lone)


def test_a_study_writes_its_sections_into_all_pages(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    for name in ("README.md", "docs/one.md"):
        (tmp_path / name).write_text(PAGE, encoding="utf-8")
    (tmp_path / "docs" / "two.md").write_text("Typed.\n", encoding="utf-8")
    changed = write_sections(tmp_path, "01_study", {"part": "new"})
    assert changed == [tmp_path / "README.md", tmp_path / "docs" / "one.md"]
    assert write_sections(tmp_path, "01_study", {"part": "new"}) == []


def test_a_figure_is_linked_from_where_its_page_lies(tmp_path: Path) -> None:
    caption = tmp_path / "figures" / "x.md"
    caption.parent.mkdir()
    caption.write_text("**What it\nis.**\n\nWhat to see.\n\nData: ...\n", encoding="utf-8")
    shown = "![What it is.]({})\n\n**What it is.** What to see."
    assert figure_section(caption, tmp_path / "README.md") == shown.format("figures/x.png")
    assert figure_section(caption, tmp_path / "docs" / "one.md") == shown.format("../figures/x.png")
    titled = "![What it is.](figures/x.png)\n\n**What it is.**"
    assert figure_section(caption, tmp_path / "README.md", titled=True) == titled


def test_numbers_of_things_are_short() -> None:
    numbers = (1296, 46656, 1679616, 60466176, 2.18e9)
    assert [*map(counted, numbers)] == ["1296", "46 656", "1.7 million", "60 million", "2.2 billion"]


def test_values_are_written_as_in_print() -> None:
    assert with_error(0.9702, 0.0118) == "0.970(12)"
    assert with_error(-27.678, 1e-6) == "-27.678"
    assert [in_digits(v) for v in (2.35e-5, 0.0014, 1.08e4, 41.0)] == ["2.3e-5", "0.0014", "1.1e4", "41"]
    assert [listed(names) for names in (["a"], ["a", "b"], ["a", "b", "c"])] == ["a", "a and b", "a, b and c"]
    assert markdown_table(("x", "y"), [("1", "2")]) == "| x | y |\n|---|---|\n| 1 | 2 |"


def test_results_of_other_sources_are_named_until_the_study_is_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "16_theory_error"
    page = f"# Title\n\n<!-- {name}: largest -->\nold\n<!-- /{name} -->\n"
    monkeypatch.setattr(reporting, "_FINGERPRINTS", tmp_path / "fingerprints.json")
    assert outdated(page) == [name]
    save_results(tmp_path / f"{name}.json", {"cases": []})
    assert json.loads((tmp_path / "fingerprints.json").read_text()) == {name: fingerprint_of_study(name)}
    assert outdated(page) == []
    (tmp_path / "fingerprints.json").write_text(json.dumps({name: "0123456789ab"}))
    assert outdated(page) == [name]
