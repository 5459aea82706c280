"""Answers of a user's own method to the lists of a set: read, checked, and scored beside the diagnosis.

One JSON object per line: the document of ``cpam-bayes diagnose --json`` with the "id" of its list, or only
these of its keys: "claim" and "causes", and if the method has them "probability", "constants",
"baseline" (its "constants" are those of the plain model) and "detectable". All other keys are ignored.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from cpam_bayes.effects import CATALOGUE
from validation.claims import scoring
from validation.reporting import markdown_table

Record = dict[str, Any]

_CLAIMS = (*scoring.CLAIMS, "other", "undecided", "none")
_OF_INTERVAL = ("mean", "sd", "q025", "q975")
_CAUSES = frozenset(effect.name for effect in CATALOGUE)


class AnswerError(ValueError):
    """A line that is not a valid answer to a list; the message says which and why."""


def read(path: Path, lists: Collection[str]) -> dict[str, Record]:
    """Answers in a file by list; raises AnswerError for invalid ones or none, OSError if there is no file.

    lists : names of the existing lists
    """
    found: dict[str, Record] = {}
    for number, line in enumerate(path.read_text("utf-8").splitlines(), 1):
        if not line.strip():
            continue
        try:
            document = json.loads(line)
            _require(isinstance(document, dict), "not an object with keys")
            name = document.get("id")
            _require(isinstance(name, str) and name in lists, f'"id" {name!r}: no list of this set')
            _require(name not in found, f"a second answer to {name}")
            found[name] = answer_of(document)
        except ValueError as error:
            why = "not JSON" if isinstance(error, json.JSONDecodeError) else error
            raise AnswerError(f"{path.name}, line {number}: {why}") from None
    if not found:
        raise AnswerError(f"{path.name}: no answers")
    return found


def answer_of(document: Mapping[str, Any]) -> Record:
    """The parts of one answer that the scores need; raises AnswerError if one is missing."""
    claim, causes, probability = (document.get(key) for key in ("claim", "causes", "probability"))
    _require(claim in _CLAIMS, f'"claim" {claim!r}: one of {", ".join(_CLAIMS)}')
    _require(isinstance(causes, list), f'"causes" {causes!r}: a list of names')
    # a second mass is named sensor_mass#2
    unknown = [c for c in causes or () if str(c).partition("#")[0] not in _CAUSES]
    _require(not unknown, f'"causes" {unknown}: one of {", ".join(sorted(_CAUSES))}')
    _require(bool(causes) or claim not in scoring.CLAIMS, f'"causes": a claim "{claim}" has causes')
    _require(
        probability is None or (_is_number(probability) and 0.0 <= probability <= 1.0),
        f'"probability" {probability!r}: 0 to 1',
    )
    baseline = document.get("baseline") or {}
    _require(isinstance(baseline, dict), f'"baseline" {baseline!r}: an object with "constants"')
    limits = document.get("detectable") or []
    _require(isinstance(limits, list), '"detectable": a list')
    return {
        "claim": claim,
        "causes": causes,
        "probability": probability,
        "constants": _intervals("constants", document.get("constants")),
        "baseline": _intervals("baseline", baseline.get("constants")),
        "detectable": dict(map(_limit, limits)),
    }


def table(name: str, own: Sequence[scoring.Scored], ours: Sequence[scoring.Scored]) -> str:
    """Markdown table with the method beside the diagnosis on the same lists."""
    both = [(scoring.figures(records), records) for records in (ours, own)]
    rows = [("lists", *(str(len(records)) for _, records in both))]
    rows += [
        (category, *(str(sum(r["category"] == category for r in records)) for _, records in both))
        for category in scoring.CATEGORIES
    ]
    shown = zip(*(figures for figures, _ in both), strict=True)
    rows += [(first["what"], *map(_figure, (first, second))) for first, second in shown]
    return markdown_table(("", "diagnosis", name), rows)


def _figure(row: Record) -> str:
    if not row["number"]:
        return "-"
    low, high = row["interval"]
    return f"{row['value']:.3f} ({low:.3f} to {high:.3f}) of {row['number']} {row['unit']}"


def _intervals(key: str, constants: Any) -> Record:
    """The 95 % interval of each constant, from its ends or from mean and standard deviation."""
    _require(_holds_objects(constants or {}), f'"{key}": an object of objects, one for each constant')
    found = {}
    for name, said in (constants or {}).items():
        given = (
            {k: said[k] for k in ("mean", "sd", "q025", "q975") if _is_number(said.get(k))} if said else {}
        )
        _require(
            {"q025", "q975"} <= given.keys() or {"mean", "sd"} <= given.keys(),
            f'"{key}" of {name}: "q025" and "q975", or "mean" and "sd"',
        )
        found[name] = given
    return found


def _limit(said: Any) -> tuple[str, list[Any]]:
    """A cause with the smallest size that would be claimed (None if none would) and its unit."""
    _require(
        isinstance(said, dict) and {"cause", "smallest", "unit"} <= said.keys(),
        '"detectable": each with "cause", "smallest" and "unit"',
    )
    smallest, unit = said["smallest"], said["unit"]
    _require(
        smallest is None or (_is_number(smallest) and unit in scoring.OF_LIMIT),
        f'"detectable" of {said["cause"]}: {smallest!r} {unit!r}',
    )
    return str(said["cause"]), [smallest, unit]


def _holds_objects(value: Any) -> bool:
    return isinstance(value, dict) and all(isinstance(held, dict) for held in value.values())


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _require(holds: bool, why: str) -> None:
    if not holds:
        raise AnswerError(why)
