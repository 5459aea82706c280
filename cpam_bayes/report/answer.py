"""What every command hands back to be shown and saved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from cpam_bayes.report.tables import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Figures: TypeAlias = "Mapping[str, Figure]"


def no_figures() -> Figures:
    """For the answers that have none."""
    return {}


def no_files(directory: Path) -> None:
    """For the answers that have no other files."""
    del directory


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of one command.

    document : of `--json` and of the file NAME.json. screen : the tables to show. warnings : for
    standard error; the document and the screen have them too. figures : draws them, by file name
    without its ending. files : writes further files into a directory. status : the exit status.
    """

    name: str
    document: Mapping[str, Any]
    screen: tuple[Table, ...]
    warnings: tuple[str, ...] = ()
    figures: Callable[[], Figures] = no_figures
    files: Callable[[Path], None] = no_files
    status: int = 0
