"""Worked cases from bricks: verdicts, and truths that are those of the files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.test_studies import saved, script

PROJECT = Path(__file__).parent.parent
CASES = "17_worked_cases"


@pytest.mark.parametrize(
    ("cause", "claim", "causes", "expected"),
    [
        ("none", "none", [], "right"),
        ("none", "other", [], "wrong"),
        ("none", "named", ["warp"], "wrong"),
        ("warp", "none", [], "calm"),
        ("warp", "named", ["warp"], "right"),
        ("warp", "named", ["skew"], "wrong"),
        ("warp", "class", ["warp", "skew"], "right as a class"),
        ("warp", "class", ["taper_x", "skew"], "wrong"),
        ("warp", "pair", ["warp", "skew"], "wrong"),
        ("warp", "other", [], "other"),
        ("warp", "undecided", ["warp", "skew", "damage"], "undecided"),
        ("soft_clamp", "pair", ["clamp_translation", "clamp_rotation"], "right"),
        ("no cause of the catalogue", "other", [], "right"),
    ],
)
def test_an_answer_has_its_verdict(cause: str, claim: str, causes: list[str], expected: str) -> None:
    assert script("studies", CASES).verdict(cause, claim, causes) == expected


def test_saved_answers_are_held_against_the_truths_of_the_files() -> None:
    truths = json.loads((PROJECT / "studies/data/bricks/truths.json").read_text(encoding="utf-8"))
    for row in saved(CASES)["cases"]:
        truth = truths[row["case"]]
        assert row["truth"]["cause"] == truth["cause"]
        assert {c["name"]: c["truth"] for c in row["constants"]} == truth["constants"]
