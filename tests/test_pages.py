"""Pages say what the saved results say: every generated section is written anew and compared."""

import json
from functools import cache
from pathlib import Path

import pytest

from cpam_bayes.fingerprint import fingerprint, sources_of
from cpam_bayes.plate.records import USUAL_SCALE_SD, USUAL_SD
from tests.test_studies import PROJECT, SAVED, STUDIES, script
from validation import fingerprints
from validation.fingerprints import UNKNOWN, fingerprint_of_study
from validation.reporting import (
    AGE,
    FIGURE,
    captions,
    case_by_case,
    marks,
    of_figure,
    outdated,
    pages,
    save_results,
    saved_results,
    sections_of_figures,
    studies_of,
    with_age,
    with_saved,
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


def test_the_documentation_is_short_and_says_in_six_lines_how_wrong_an_answer_can_be() -> None:
    words = {name: len(path.read_text("utf-8").split()) for name, path in PAGES.items()}
    assert sum(words.values()) <= 30_000, sorted(words.items(), key=lambda page: -page[1])
    section = (PROJECT / "README.md").read_text("utf-8").split("## How wrong it can be")[1].split("\n## ")[0]
    text = with_sections(section, AGE, {"studies": ""})
    assert len([line for line in text.splitlines() if line.strip() and not line.startswith("<!--")]) <= 6


def test_the_page_of_priors_has_the_tolerances_that_hold_where_a_file_states_none() -> None:
    page = PAGES["docs/priors.md"].read_text("utf-8")
    said = {}
    for row in page.partition("| of | default | stands for |\n")[2].partition("\n\n")[0].splitlines()[1:]:
        names, text = row.split("|")[1:3]
        for name in names.partition("(")[0].split(","):
            said[name.strip()] = float(text.split()[0]) / 100
    used = {**USUAL_SD, "frequency scale": USUAL_SCALE_SD}
    assert said == pytest.approx(used)


def test_sources_of_sections_are_studies_figures_or_benchmarks_and_none_lacks_its_place() -> None:
    asked = {mark for path in PAGES.values() for mark in marks(path.read_text(encoding="utf-8"))}
    # benchmarks/waits.py writes the tables of docs/speed.md
    assert {source for source, _ in asked} <= {FIGURE, AGE, "waits", *STUDIES}
    for study in STUDIES:
        written = {name for name in sections(study) if (study, name) in asked}
        assert bool(written) == bool(sections(study)), study


def test_figures_stand_in_pages_with_their_captions_alone_and_each_is_of_a_study() -> None:
    for path in PAGES.values():
        none = dict.fromkeys(sections_of_figures(PROJECT, path), "")
        text = with_sections(path.read_text(encoding="utf-8"), FIGURE, none)
        by_hand = [line for line in text.splitlines() if line.startswith("![") and "figures/" in line]
        assert by_hand == [] or path.name == "README.md"
    for path in captions(PROJECT):
        assert len(of_figure(path) & set(STUDIES)) == 1, path.name
    assert studies_of("<!-- figure: picture mode_shapes_C1 -->\n<!-- /figure -->\n") == {"02_agreement"}
    assert studies_of("<!-- figure: all of 15_claims -->\n<!-- /figure -->\n") == {"15_claims"}


def test_a_section_is_written_between_its_marks_alone_in_all_pages(tmp_path: Path) -> None:
    written = with_sections(PAGE, "01_study", {"part": "new"})
    assert written == PAGE.replace("\nold\n", "\n\nnew\n\n")
    assert with_sections(PAGE, "02_another", {}) == PAGE
    with pytest.raises(ValueError, match="no section of 01_study is named 'part'; there are whole"):
        with_sections(PAGE, "01_study", {"whole": ""})
    for lone in ("01_study: part", "/01_study", "figure: x"):
        with pytest.raises(ValueError, match="without their pair"):
            marks(f"Typed.\n\n<!-- {lone} -->\n")
    (tmp_path / "docs").mkdir()
    for name, page in (("README.md", PAGE), ("docs/one.md", PAGE), ("docs/two.md", "Typed.\n")):
        (tmp_path / name).write_text(page, encoding="utf-8")
    changed = write_sections(tmp_path, "01_study", {"part": "new"})
    assert changed == [tmp_path / "README.md", tmp_path / "docs" / "one.md"]
    assert write_sections(tmp_path, "01_study", {"part": "new"}) == []


STUDY = "16_theory_error"
OTHER = "0123456789ab"
SECTION = (
    f"# Title\n\n<!-- age: studies -->\n<!-- /age -->\n\n<!-- {STUDY}: largest -->\nold\n<!-- /{STUDY} -->\n"
)


@pytest.fixture
def ledger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty one; results of studies lie beside it."""
    monkeypatch.setattr(fingerprints, "LEDGER", tmp_path / "fingerprints.json")
    return tmp_path / "fingerprints.json"


def test_a_page_that_shows_results_of_studies_says_where_they_are_of_other_code() -> None:
    for name, path in PAGES.items():
        text = path.read_text("utf-8")
        asked = [section for source, section in marks(text) if source == AGE]
        assert asked == (["studies"] if studies_of(text) else []), name
        assert ("Older than the code: " in text) == bool(outdated(text)), name


def test_results_and_figures_of_other_sources_are_named_until_their_study_is_run_again(ledger: Path) -> None:
    assert outdated(SECTION) == [STUDY]
    save_results(ledger.with_name(f"{STUDY}.json"), {"cases": []})
    today = {STUDY: fingerprint_of_study(STUDY)}
    assert json.loads(ledger.read_text()) == today
    assert outdated(SECTION) == []
    assert with_age(SECTION) == SECTION
    ledger.write_text(json.dumps({STUDY: OTHER}))
    assert outdated(SECTION) == [STUDY]
    assert f"Older than the code: results of `{STUDY}`." in with_age(SECTION)
    figure = "\n<!-- figure: picture {} -->\n<!-- /figure -->\n"
    both = SECTION + figure.format("20_swarms")
    assert "code: all results here." in with_age(both)
    ledger.write_text(json.dumps(today))
    assert with_age(with_age(SECTION)) == SECTION
    assert outdated(both) == ["20_swarms"]
    more = SECTION + "".join(map(figure.format, ("27_coins", "20_swarms", "05_calibration")))
    assert f"code: all results here but those of `{STUDY}`." in " ".join(with_age(more).split())


def saved_before(ledger: Path, recorded: str | None) -> Path:
    """Results with two cases, without fingerprints, and what the ledger says of them."""
    path = ledger.with_name(f"{STUDY}.json")
    path.write_text(json.dumps({"cases": [{"case": 0, "x": 1}, {"case": 1, "x": 1}]}))
    ledger.write_text(json.dumps({} if recorded is None else {STUDY: recorded}))
    return path


@pytest.mark.parametrize("recorded", [None, OTHER])
def test_a_study_is_of_todays_code_when_all_its_cases_are(ledger: Path, recorded: str | None) -> None:
    path, before, today = saved_before(ledger, recorded), recorded or UNKNOWN, fingerprint_of_study(STUDY)
    # summed up again: nothing was computed
    save_results(path, saved_results(path))
    assert fingerprints.recorded()[STUDY] == before
    for case, of in ((0, before), (1, today)):
        save_results(path, with_saved({"cases": [{"case": case, "x": 2}]}, path, (0, 1)))
        assert fingerprints.recorded()[STUDY] == of
    assert saved_results(path)["cases"] == [{"case": k, "x": 2, "fingerprint": today} for k in (0, 1)]


def test_cases_keep_the_fingerprint_that_they_were_computed_with_or_are_of_unknown_code(
    ledger: Path,
) -> None:
    path = saved_before(ledger, OTHER)
    found = case_by_case(range(3), lambda n: {"case": n, "x": 2}, lambda cases: {"cases": cases}, path=path)
    assert [c["fingerprint"] for c in found["cases"]] == [OTHER, OTHER, fingerprint_of_study(STUDY)]
    assert fingerprints.recorded() == {STUDY: OTHER}
    rows = [{"case": 0, "fingerprint": fingerprint_of_study(STUDY)}, {"case": 1}]
    save_results(path, {"cases": rows, "counts": [{"n": 2}]})
    assert fingerprints.recorded() == {STUDY: UNKNOWN}
    of_no_study = path.parent / "waits" / "waits.json"
    save_results(of_no_study, with_saved({"rows": [{"case": "a"}]}, of_no_study, ("a",)))
    assert saved_results(of_no_study) == {"rows": [{"case": "a"}]}
    assert fingerprints.recorded() == {STUDY: UNKNOWN}


def test_a_study_that_names_what_computes_its_cases_is_of_the_state_of_that() -> None:
    named = "cpam_bayes.questions.paper.work"
    assert fingerprint_of_study("19_paper") == fingerprint(named)
    # what is only judged and shown is no part of it
    of_the_paper = {f.stem for f in sources_of([named], []) if f.parent.name == "paper"}
    assert of_the_paper == {"work", "layups", "rows"}


def test_a_study_depends_on_what_it_takes_from_validation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "validation" / "deep").mkdir(parents=True)
    study, way = tmp_path / "90_new.py", tmp_path / "validation" / "way.py"
    end = tmp_path / "validation" / "deep" / "end.py"
    study.write_text("from validation import way\nfrom validation.reporting import save_results\n")
    way.write_text("from validation.deep.end import x\n")
    monkeypatch.setattr(fingerprints, "STUDIES", tmp_path)
    found = []
    for imported in (
        "",
        "from cpam_bayes.formatting import fixed\n",
        "import cpam_bayes as cb\ncb.forward()\n",
    ):
        end.write_text(f"x = 1\n{imported}")
        found.append(fingerprint_of_study.__wrapped__("90_new"))
    assert found[0] == ""
    assert len(set(found)) == 3
