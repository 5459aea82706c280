"""Pages agree with the saved results: every generated section is rewritten and compared."""

import json
from functools import cache
from pathlib import Path

import pytest

from cpam_bayes.fingerprint import fingerprint, sources_of
from cpam_bayes.plate.records import USUAL_SCALE_SD, USUAL_SD
from tests.test_studies import PROJECT, SAVED, STUDIES, script
from validation import fingerprints, reporting
from validation.fingerprints import UNKNOWN, fingerprint_of_study
from validation.reporting import AGE, FIGURE, marks, outdated, save_results, with_age, with_sections

PAGES = {str(path.relative_to(PROJECT)): path for path in reporting.pages(PROJECT)}
WITH_SECTIONS = [name for name, path in PAGES.items() if marks(path.read_text(encoding="utf-8"))]
PAGE = "Typed.\n\n<!-- 01_study: part -->\nold\n<!-- /01_study -->\n\nTyped, too.\n"
STUDY = "16_theory_error"
OTHER = "0123456789ab"
HEAD = "# Title\n\n<!-- age: studies -->\n<!-- /age -->\n\n"
SECTION = f"{HEAD}<!-- {STUDY}: largest -->\nold\n<!-- /{STUDY} -->\n"


@cache
def sections(study: str) -> dict[str, str]:
    module = script("studies", study)
    results = json.loads((SAVED / f"{study}.json").read_text(encoding="utf-8"))
    return dict(module.sections(results)) if hasattr(module, "sections") else {}


@pytest.mark.parametrize("name", WITH_SECTIONS)
def test_a_page_says_what_the_saved_results_say(name):
    """To rewrite it: python studies/write_pages.py."""
    assert script("studies", "write_pages").written(PAGES[name], STUDIES) == PAGES[name].read_text("utf-8")


def test_the_documentation_is_short_and_says_in_six_lines_how_wrong_an_answer_can_be():
    words = {name: len(path.read_text("utf-8").split()) for name, path in PAGES.items()}
    assert sum(words.values()) <= 30_000, sorted(words.items(), key=lambda page: -page[1])
    section = (PROJECT / "README.md").read_text("utf-8").split("## How wrong it can be")[1].split("\n## ")[0]
    text = with_sections(section, AGE, {"studies": ""})
    assert len([line for line in text.splitlines() if line.strip() and not line.startswith("<!--")]) <= 6


def test_the_page_of_priors_has_the_tolerances_that_hold_where_a_file_states_none():
    page, said = PAGES["docs/priors.md"].read_text("utf-8"), {}
    for row in page.partition("| of | default | stands for |\n")[2].partition("\n\n")[0].splitlines()[1:]:
        names, text = row.split("|")[1:3]
        said |= {name.strip(): float(text.split()[0]) / 100 for name in names.partition("(")[0].split(",")}
    assert said == pytest.approx({**USUAL_SD, "frequency scale": USUAL_SCALE_SD})


def test_sources_of_sections_are_studies_figures_or_benchmarks_and_none_lacks_its_place():
    asked = {mark for path in PAGES.values() for mark in marks(path.read_text(encoding="utf-8"))}
    # benchmarks/waits.py writes the tables of docs/speed.md
    assert {source for source, _ in asked} <= {FIGURE, AGE, "waits", *STUDIES}
    for study in STUDIES:
        written = {name for name in sections(study) if (study, name) in asked}
        assert bool(written) == bool(sections(study)), study


def test_figures_stand_in_pages_with_their_captions_alone_and_each_is_of_a_study():
    for path in PAGES.values():
        none = dict.fromkeys(reporting.sections_of_figures(PROJECT, path), "")
        text = with_sections(path.read_text(encoding="utf-8"), FIGURE, none)
        by_hand = [line for line in text.splitlines() if line.startswith("![") and "figures/" in line]
        assert by_hand == [] or path.name == "README.md"
    for path in reporting.captions(PROJECT):
        assert len(reporting.of_figure(path) & set(STUDIES)) == 1, path.name
    for asked, study in (("picture mode_shapes_C1", "02_agreement"), ("all of 15_claims", "15_claims")):
        assert reporting.studies_of(f"<!-- figure: {asked} -->\n<!-- /figure -->\n") == {study}


def test_a_section_is_written_between_its_marks_alone_in_all_pages(tmp_path):
    written = with_sections(PAGE, "01_study", {"part": "new"})
    assert (written, with_sections(PAGE, "02_another", {})) == (PAGE.replace("\nold\n", "\n\nnew\n\n"), PAGE)
    with pytest.raises(ValueError, match="no section of 01_study is named 'part'; there are whole"):
        with_sections(PAGE, "01_study", {"whole": ""})
    for lone in ("01_study: part", "/01_study", "figure: x"):
        with pytest.raises(ValueError, match="without their pair"):
            marks(f"Typed.\n\n<!-- {lone} -->\n")
    (tmp_path / "docs").mkdir()
    for name, page in (("README.md", PAGE), ("docs/one.md", PAGE), ("docs/two.md", "Typed.\n")):
        (tmp_path / name).write_text(page, encoding="utf-8")
    changed, again = (reporting.write_sections(tmp_path, "01_study", {"part": "new"}) for _ in range(2))
    assert (changed, again) == ([tmp_path / "README.md", tmp_path / "docs" / "one.md"], [])


@pytest.fixture
def ledger(tmp_path, monkeypatch):
    monkeypatch.setattr(fingerprints, "LEDGER", tmp_path / "fingerprints.json")
    return tmp_path / "fingerprints.json"


def test_a_page_that_shows_results_of_studies_says_where_they_are_of_other_code():
    for name, path in PAGES.items():
        text = path.read_text("utf-8")
        asked = [section for source, section in marks(text) if source == AGE]
        assert asked == (["studies"] if reporting.studies_of(text) else []), name
        assert ("Older than the code: " in text) == bool(outdated(text)), name


def test_results_and_figures_of_other_sources_are_named_until_their_study_is_run_again(ledger):
    assert outdated(SECTION) == [STUDY]
    save_results(ledger.with_name(f"{STUDY}.json"), {"cases": []})
    today = {STUDY: fingerprint_of_study(STUDY)}
    assert (json.loads(ledger.read_text()), outdated(SECTION), with_age(SECTION)) == (today, [], SECTION)
    ledger.write_text(json.dumps({STUDY: OTHER}))
    assert outdated(SECTION) == [STUDY]
    assert f"Older than the code: results of `{STUDY}`." in with_age(SECTION)
    figure = "\n<!-- figure: picture {} -->\n<!-- /figure -->\n"
    both = SECTION + figure.format("20_swarms")
    assert "code: all results here." in with_age(both)
    ledger.write_text(json.dumps(today))
    assert (with_age(with_age(SECTION)), outdated(both)) == (SECTION, ["20_swarms"])
    more = SECTION + "".join(map(figure.format, ("27_coins", "20_swarms", "05_calibration")))
    assert f"code: all results here but those of `{STUDY}`." in " ".join(with_age(more).split())


def saved_before(ledger: Path, recorded: str | None) -> Path:
    """Results with two cases without fingerprints, and their entry in the ledger."""
    path = ledger.with_name(f"{STUDY}.json")
    path.write_text(json.dumps({"cases": [{"case": 0, "x": 1}, {"case": 1, "x": 1}]}))
    ledger.write_text(json.dumps({} if recorded is None else {STUDY: recorded}))
    return path


@pytest.mark.parametrize("recorded", [None, OTHER])
def test_a_study_is_of_todays_code_when_all_its_cases_are(ledger, recorded):
    path, before, today = saved_before(ledger, recorded), recorded or UNKNOWN, fingerprint_of_study(STUDY)
    save_results(path, reporting.saved_results(path))  # only the summary was redone: nothing was computed
    assert fingerprints.recorded()[STUDY] == before
    for case, of in ((0, before), (1, today)):
        save_results(path, reporting.with_saved({"cases": [{"case": case, "x": 2}]}, path, (0, 1)))
        assert fingerprints.recorded()[STUDY] == of
    cases = [{"case": k, "x": 2, "fingerprint": today} for k in (0, 1)]
    assert reporting.saved_results(path)["cases"] == cases


def test_cases_keep_the_fingerprint_that_they_were_computed_with_or_are_of_unknown_code(ledger):
    path = saved_before(ledger, OTHER)
    case_by_case = reporting.case_by_case
    found = case_by_case(range(3), lambda n: {"case": n, "x": 2}, lambda cases: {"cases": cases}, path=path)
    assert [c["fingerprint"] for c in found["cases"]] == [OTHER, OTHER, fingerprint_of_study(STUDY)]
    assert fingerprints.recorded() == {STUDY: OTHER}
    rows = [{"case": 0, "fingerprint": fingerprint_of_study(STUDY)}, {"case": 1}]
    save_results(path, {"cases": rows, "counts": [{"n": 2}]})
    assert fingerprints.recorded() == {STUDY: UNKNOWN}
    of_no_study = path.parent / "waits" / "waits.json"
    save_results(of_no_study, reporting.with_saved({"rows": [{"case": "a"}]}, of_no_study, ("a",)))
    assert reporting.saved_results(of_no_study) == {"rows": [{"case": "a"}]}
    assert fingerprints.recorded() == {STUDY: UNKNOWN}


def test_a_study_that_names_what_computes_its_cases_is_of_the_state_of_that():
    named = "cpam_bayes.questions.paper.work"
    assert fingerprint_of_study("19_paper") == fingerprint(named, fingerprints.as_computed)
    # judging and display are no part of it
    of_the_paper = {f.stem for f in sources_of([named], []) if f.parent.name == "paper"}
    assert of_the_paper == {"work", "layups", "rows"}


def test_a_change_that_is_listed_as_equivalent_is_taken_back_as_long_as_it_is_there(tmp_path, monkeypatch):
    change = '[[change]]\nfile = "fingerprint.py"\nlines = [["x = 1\\n", "_DIGITS: Final = {}\\n"]]\n'
    changes, source = tmp_path / "changes.toml", PROJECT / "cpam_bayes" / "fingerprint.py"
    monkeypatch.setattr(fingerprints, "CHANGES", changes)
    changes.write_text(change.format(12))
    assert "\nx = 1\n" in fingerprints.as_computed.__wrapped__(source)
    changes.write_text(change.format(13))
    with pytest.raises(ValueError, match="no longer holds"):
        fingerprints.as_computed.__wrapped__(source)


def test_a_study_depends_on_what_it_takes_from_validation(tmp_path, monkeypatch):
    (tmp_path / "validation" / "deep").mkdir(parents=True)
    names = ("90_new.py", "validation/way.py", "validation/deep/end.py")
    study, way, end = (tmp_path / name for name in names)
    study.write_text("from validation import way\nfrom validation.reporting import save_results\n")
    way.write_text("from validation.deep.end import x\n")
    monkeypatch.setattr(fingerprints, "STUDIES", tmp_path)
    found, fixed = [], "from cpam_bayes.formatting import fixed\n"
    for imported in ("", fixed, "import cpam_bayes as cb\ncb.forward()\n"):
        end.write_text(f"x = 1\n{imported}")
        found.append(fingerprint_of_study.__wrapped__("90_new"))
    assert (found[0], len(set(found))) == ("", 3)
