"""A method of one's own is scored with one command, which writes nothing of ours."""

import json
from pathlib import Path
from typing import Any

import pytest

from cpam_bayes.questions.diagnose import diagnosis_result
from cpam_bayes.render.report import json_text
from tests.diagnosed import misread
from tests.test_studies import PROJECT, script
from validation import own_method
from validation.claims import answering, scoring

DATA = PROJECT / "studies" / "data" / "claims"
STUDY = script("studies", "15_claims")
LISTS = {r["id"]: r for r in answering.asked(DATA / "sealed.jsonl")}
OURS = answering.answered(DATA / "answers" / "sealed_diagnosis.jsonl")
# Kept by the project: what a score may not change.
KEPT = (
    *(PROJECT / "studies" / "results").iterdir(),
    *(PROJECT / "docs").glob("*.md"),
    *(DATA / "answers").iterdir(),
    PROJECT / "README.md",
)
ANSWERED = [name for name in OURS if LISTS[name]["truth"]["causes"]][:3]


def told(name: str) -> dict[str, Any]:
    """A right answer to a list, in the least that a line has."""
    causes = ["damage" if cause == "other" else cause for cause in LISTS[name]["truth"]["causes"]]
    return {"id": name, "claim": "class", "causes": causes}


def written(folder: Path, *lines: Any) -> Path:
    path = folder / "mine.jsonl"
    path.write_text("".join(f"{line if isinstance(line, str) else json.dumps(line)}\n" for line in lines))
    return path


def test_the_document_of_the_command_is_scored_as_our_own_answers_are() -> None:
    document = json.loads(json_text(diagnosis_result(misread(), 3).to_dict()))
    ours = answering.reduced(document)
    mine = own_method.answer_of(document | {"id": "any"})
    for key in ("claim", "causes", "probability", "detectable"):
        assert mine[key] == ours[key], key
    for key in ("constants", "baseline"):
        assert {n: dict(c) for n, c in mine[key].items()} == ours[key], key
    assert mine["detectable"]["outlier"][1] == "%"


def test_one_command_prints_the_scores_beside_ours_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.read_bytes() for path in KEPT if path.is_file()}
    document = json.loads(json_text(diagnosis_result(misread(), 3).to_dict()))
    lines = [told(ANSWERED[0]), {"id": ANSWERED[1], "claim": "none", "causes": []}]
    lines.append(document | {"id": ANSWERED[2]})
    STUDY.main(["--score", str(written(tmp_path, *lines))])
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "|  | diagnosis | mine |"
    rows = {cells[0]: cells[1:] for cells in ([c.strip() for c in row.split("|")[1:-1]] for row in said[2:])}
    assert rows["lists"] == ["3", "3"]
    ours = [scoring.score(LISTS[name]["truth"], OURS[name])["category"] for name in ANSWERED]
    for category in scoring.CATEGORIES:
        assert rows[category][0] == str(ours.count(category)), category
    assert int(rows[scoring.RIGHT][1]) >= 1
    assert int(rows[scoring.MISSED][1]) == 1
    assert {path: path.read_bytes() for path in before} == before
    assert set(KEPT) >= set((DATA / "answers").iterdir())


def test_without_probabilities_and_constants_only_claims_are_scored(tmp_path: Path) -> None:
    records = own_method.read(written(tmp_path, *map(told, ANSWERED[:2])), set(LISTS))
    assert list(records) == ANSWERED[:2]
    scores = scoring.scored(LISTS.values(), records)
    figures = {row["what"]: row["number"] for row in scoring.figures(scores)}
    assert figures[scoring.TOO_SURE] == figures[scoring.COVERED] == 0
    assert figures[scoring.WRONG_CLAIMS] == 2
    # the diagnosis has not answered these
    said = own_method.table("mine", scores, [])
    assert "| lists | 0 | 2 |" in said
    assert "| claimed and right | 0 | 2 |" in said


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("{", "not JSON"),
        ([1], "not an object"),
        ({"id": ANSWERED[0]}, f"a second answer to {ANSWERED[0]}"),
        ({"id": "clean-99999"}, "'clean-99999': no list of this set"),
        ({"id": None}, "None: no list of this set"),
        ({"claim": "sure"}, "\"claim\" 'sure': one of named, class, pair, other, undecided, none"),
        ({"causes": "warp"}, "\"causes\" 'warp': a list of names"),
        ({"causes": ["wrap"]}, "\"causes\" ['wrap']: one of air, "),
        ({"claim": "named", "causes": []}, 'a claim "named" has causes'),
        ({"probability": 1.2}, '"probability" 1.2: 0 to 1'),
        ({"probability": "high"}, "\"probability\" 'high': 0 to 1"),
        ({"constants": {"E1_GPa": {"q025": 1.0}}}, '"constants" of E1_GPa: "q025" and "q975", or'),
        ({"constants": {"E1_GPa": 140.0}}, '"constants": an object of objects'),
        ({"constants": {"E1_GPa": {"mean": float("nan"), "sd": 1.0}}}, '"constants" of E1_GPa'),
        ({"baseline": 3}, '"baseline" 3: an object'),
        ({"detectable": {"warp": 1.0}}, '"detectable": a list'),
        ({"detectable": [1.0]}, '"detectable": each with'),
        ({"detectable": [{"cause": "warp"}]}, '"detectable": each with "cause", "smallest" and "unit"'),
        ({"detectable": [{"cause": "warp", "smallest": 1.0, "unit": "inch"}]}, "of warp: 1.0 'inch'"),
    ],
)
def test_what_cannot_be_scored_is_refused_with_its_line(
    line: Any, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    second = told(ANSWERED[1]) | line if isinstance(line, dict) else line
    path = written(tmp_path, told(ANSWERED[0]), second)
    for file, words in ((path, ("mine.jsonl, line 2: ", why)), (tmp_path / "none.jsonl", ("none.jsonl",))):
        with pytest.raises(SystemExit) as stop:
            STUDY.main(["--score", str(file)])
        assert stop.value.code == 2
        said = capsys.readouterr().err
        assert all(word in said for word in words)
