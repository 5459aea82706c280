"""The page of the comparison says what its document says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cpam_bayes.report.comparison.markdown import page

PROJECT = Path(__file__).parent.parent.parent


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    saved = json.loads((PROJECT / "studies" / "results" / "19_paper.json").read_text("utf-8"))
    found: dict[str, Any] = saved["paper"]
    return found


def test_a_changed_number_changes_the_page(document: dict[str, Any]) -> None:
    rows = [dict(row) for row in document["rows"]]
    place = next(i for i, row in enumerate(rows) if row["table"] == 9 and row["ours"] is not None)
    rows[place]["ours"] = 1.2345
    assert page({**document, "rows": rows}) != page(document)


def test_all_tables_are_there_with_three_disagreements(document: dict[str, Any]) -> None:
    assert [t["table"] for t in document["tables"]] == list(range(1, 15))
    assert len(document["disagreements"]) == 3
    assert not document["quick"]
    found = {row["verdict"].partition(":")[0] for row in document["rows"]}
    assert found == {"agrees", "within the posterior", "not reproducible", "input"}
    # every printed value of tests/paper/test_tables.py
    assert len(document["rows"]) == 474
