"""Fingerprints that tell which state of the code computed a case, and a study by its oldest case.

A study whose cases are all computed by one module of the package names it, `COMPUTED_BY`; the code that
judges and shows them is then not part of the fingerprint.

A row of a study's results keeps the fingerprint of the code that computed it under "fingerprint". `LEDGER`
has one per study: today's if all rows have it, or if none has any and all were computed at once; else the
first of another state. Rows saved without one get what is recorded for their study, "unknown" if nothing is.

`CHANGES` lists changes of the package's sources that can change no saved number, each with the reason; they
are taken back before a fingerprint is made.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, Final

import cpam_bayes
from cpam_bayes.fingerprint import fingerprint, fingerprint_of_script, text_of, without_words

STUDIES: Final = Path(__file__).parents[1]
LEDGER = STUDIES / "results" / "fingerprints.json"
CHANGES = STUDIES / "equivalent_changes.toml"
KEY: Final = "fingerprint"
UNKNOWN: Final = "unknown"

# The code that keeps and writes results is not part of what computes them.
_KEEPING: Final = frozenset({"fingerprints", "reporting"})
_COMPUTED_BY: Final = re.compile(r'^COMPUTED_BY = "([\w.]+)"$', re.MULTILINE)
_OF_NOTHING: Final = hashlib.sha256().hexdigest()[:12]


@cache
def fingerprint_of_study(name: str) -> str:
    """Fingerprints, joined by "+", of the package's sources that a study uses, directly or via `validation`.

    They are read once: sources that change while a study runs are not those that compute it.
    """
    named = _COMPUTED_BY.search((STUDIES / f"{name}.py").read_text("utf-8"))
    if named:
        return fingerprint(named[1], as_computed)
    scripts = _scripts(STUDIES / f"{name}.py")
    found = {fingerprint_of_script(script, cpam_bayes._PUBLIC, as_computed) for script in scripts}
    return "+".join(sorted(found - {_OF_NOTHING}))


@cache
def as_computed(file: Path) -> str:
    """The code of a source file without the changes of `CHANGES`.

    Raises ``ValueError`` where a change is not in the file as it is listed: then it is no longer the one that
    was found equivalent.
    """
    text = without_words(text_of(file))
    for change in _changes(text_of(CHANGES)):
        if file == Path(cpam_bayes.__file__).parent / change["file"]:
            for was, now in change["lines"]:
                if text.count(now) != 1:
                    raise ValueError(f"{change['file']} no longer holds a change listed in {CHANGES.name}")
                text = text.replace(now, was)
    return text


@cache
def _changes(text: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = tomllib.loads(text)["change"]
    return found


def remember(script: Path) -> None:
    """Record the fingerprint of a study when it starts, before it computes anything; ignore other scripts."""
    if script.resolve().parent == STUDIES and script.stem[:1].isdigit():
        fingerprint_of_study(script.stem)


def is_of_study(path: Path) -> bool:
    """Whether a file holds the results of a study."""
    return path.parent == LEDGER.parent and path != LEDGER


def stamped(row: dict[str, Any], path: Path, fingerprint: str | None = None) -> dict[str, Any]:
    """A results row with the given fingerprint, today's by default; an existing one is kept."""
    if not is_of_study(path):
        return row
    return {**row, KEY: row.get(KEY, fingerprint or fingerprint_of_study(path.stem))}


def with_recorded(results: dict[str, Any], path: Path) -> dict[str, Any]:
    """Saved results with the known fingerprints added to their rows."""
    before = recorded().get(path.stem, UNKNOWN)
    return {
        key: [stamped(row, path, before) if isinstance(row, dict) else row for row in rows]
        if isinstance(rows, list)
        else rows
        for key, rows in results.items()
    }


def recorded() -> dict[str, str]:
    """Fingerprints of all studies' saved results."""
    found: dict[str, str] = json.loads(LEDGER.read_text("utf-8")) if LEDGER.exists() else {}
    return found


def record(path: Path, results: dict[str, Any]) -> None:
    """Enter the fingerprint of the oldest case of a study's results into the ledger."""
    today = fingerprint_of_study(path.stem)
    found = next((other for other in _fingerprints(results) if other != today), today)
    known = dict(sorted({**recorded(), path.stem: found}.items()))
    LEDGER.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")


def is_outdated(study: str) -> bool:
    """Whether a study's results come from other sources than today's, or from unknown ones."""
    return recorded().get(study) != fingerprint_of_study(study)


def _fingerprints(results: dict[str, Any]) -> Iterator[str]:
    """Fingerprints of the rows of each list that has any."""
    for rows in results.values():
        if isinstance(rows, list) and any(isinstance(row, dict) and KEY in row for row in rows):
            yield from (row.get(KEY, UNKNOWN) for row in rows)


def _scripts(script: Path) -> list[Path]:
    """A script and all files of `validation` that it imports, at any depth."""
    found: list[Path] = []
    waiting = [script]
    while waiting:
        file = waiting.pop()
        if file in found or file.stem in _KEEPING:
            continue
        found.append(file)
        for name in _imported(ast.parse(file.read_text("utf-8"))):
            other = STUDIES.joinpath(*name.split(".")).with_suffix(".py")
            if name.startswith("validation.") and other.is_file():
                waiting.append(other)
    return found


def _imported(tree: ast.Module) -> Iterator[str]:
    """Full names of the modules that a file imports, including names that may be modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


remember(Path(sys.argv[0]))
