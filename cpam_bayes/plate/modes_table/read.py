"""The table that a plate file names under [measurement], found and read."""

from __future__ import annotations

from pathlib import Path

from cpam_bayes.plate.modes_table.delimited import decode
from cpam_bayes.plate.modes_table.hits import TableModes, modes_of
from cpam_bayes.plate.modes_table.rows import TableProblem, read_modes_table
from cpam_bayes.plate.problems import Problem
from cpam_bayes.plate.raw import Data, number, table
from cpam_bayes.plate.regular_file import read_named_file

__all__ = ["table_of"]

_KEY = ("measurement", "table")


def table_of(data: Data, directory: Path | None) -> tuple[TableModes | None, list[Problem]]:
    """The modes of the table that a plate file names, and what is wrong with it, by line and column.

    directory : where relative paths begin
    """
    measurement = table(data, "measurement")
    name = measurement.get("table")
    if not isinstance(name, str) or not name:
        return None, []
    content, unread = read_named_file(_KEY, name, directory, "a table of modes")
    if content is None:
        return None, unread
    rows, problems = read_modes_table(decode(content))
    modes: TableModes | None = None
    if rows is not None:
        least = max(number(measurement, "relative_std") or 0.0, 0.0)
        modes, problems = modes_of(rows, complete=measurement.get("complete") is not False, least=least)
    return modes, [_located(name, problem) for problem in problems]


def _located(name: str, problem: TableProblem) -> Problem:
    return Problem(_KEY, f"{Path(name).name} {problem}")
