"""Finished computations on disk, so that a stopped comparison goes on; and those stored in the package."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from cpam_bayes import __version__
from cpam_bayes.comparison.cases import case_specimen
from cpam_bayes.comparison.tasks import Effort, Results, Task, printed_rows
from cpam_bayes.storage import read_sealed, set_aside, write_sealed

__all__ = ["packaged", "read", "stamp", "write"]

# To be raised when the same inputs give other numbers.
_FORMAT: Final = 2


def task_key(effort: Effort, task: Task) -> str:
    """Hash of all that a result depends on: version, effort, seed, plate and printed rows."""
    specimen = case_specimen(task.specimen, task.case)
    measured = specimen.measurement
    content = {
        "format": _FORMAT,
        "version": __version__,
        "effort": asdict(effort),
        "task": asdict(task),
        "plate": repr(specimen.plate),
        "material": [repr(specimen.material), specimen.unknowns.names],
        "bounds": [specimen.unknowns.lower.tolist(), specimen.unknowns.upper.tolist()],
        "measured": None if measured is None else measured.frequencies.tolist(),
        "printed": [repr(row) for row in printed_rows(task.table, task.specimen, task.case)],
    }
    text = json.dumps(content, sort_keys=True, default=repr)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def stamp(results: Results) -> Results:
    """The results with version and date of the computation."""
    return {"version": __version__, "date": datetime.now(UTC).date().isoformat(), **results}


def read(directory: Path, effort: Effort, task: Task) -> Results | None:
    """What was stored of a task, None where it was not, with other inputs, or is damaged: it is set aside."""
    path = _path(directory, effort, task)
    try:
        content = read_sealed(path)
    except OSError:
        return None
    if content is None:
        return None
    try:
        computed: Results = json.loads(content)
    except ValueError:
        set_aside(path)
        return None
    return computed


def write(directory: Path, effort: Effort, task: Task, results: Results) -> None:
    """Store a finished task; a directory that cannot be written to ends the storing, not the work."""
    with suppress(OSError):
        directory.mkdir(parents=True, exist_ok=True)
        write_sealed(_path(directory, effort, task), json.dumps(results, indent=1).encode())


@cache
def packaged(name: str) -> Mapping[str, Any]:
    """What takes too long for every run, with version and date: "calculix", "diagnoses" or "sequences"."""
    resource = files("cpam_bayes") / "data" / "paper" / "computed" / f"{name}.json"
    computed: Mapping[str, Any] = json.loads(resource.read_text(encoding="utf-8"))
    return computed


def _path(directory: Path, effort: Effort, task: Task) -> Path:
    return directory / f"{task_key(effort, task)}.results"
