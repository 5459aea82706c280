"""What the answer to every question has in common, and how long work shows its progress.

A question (`forward`, `identify`, `diagnose`, ...) is answered by a function that returns a subclass of
`Result`: all numbers, the warnings and the status, computed and complete. How an answer looks is the
concern of `cpam_bayes.report.QUESTION`, which is loaded when it is asked for and computes nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import wraps
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Final, ParamSpec, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.arguments import checked
from cpam_bayes.deadline import current_limit
from cpam_bayes.plate.records import Specimen

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["SILENT", "PlateResult", "Progress", "Result", "Watch", "within_time"]

P = ParamSpec("P")
R = TypeVar("R", bound="Result")


@dataclass(frozen=True, slots=True)
class Progress:
    """How a computation reports while it runs.

    tick : called with (iterations done, value to show). notify : called with what begins that takes long.
    """

    tick: Callable[[int, float], None]
    notify: Callable[[str], None]


class Watch(Protocol):
    """Somebody who is shown the progress of long work: a terminal, a notebook, nobody."""

    def announce(self, text: str) -> None:
        """Show one line about what begins."""

    def stage(
        self, title: str, total: int, described: Callable[[float], str]
    ) -> AbstractContextManager[Progress]:
        """Show one stage of the work until it ends.

        total : the budget of iterations, which need not be used up. described : the ticked value in words.
        """


class _Silent:
    def announce(self, text: str) -> None:
        del text

    @contextmanager
    def stage(self, title: str, total: int, described: Callable[[float], str]) -> Iterator[Progress]:
        del title, total, described
        yield Progress(lambda done, value: None, lambda text: None)


SILENT: Final[Watch] = _Silent()
"""Shows nothing: the default of the library."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Result:
    """The answer to one question.

    seed : repeats the answer bit for bit. warnings : every reason not to trust the numbers as they
    stand. slips : those of them that most likely ruin the answer, which stand above everything else.
    reached_goal : False where a sampler has not converged; the warnings then say so.
    """

    question: ClassVar[str]
    """Folder of `cpam_bayes.report` that renders the answer."""
    command: ClassVar[str]
    """The command that prints it, and the name of its JSON file."""
    draws: ClassVar[str] = ""
    """Module whose `inference_data(result)` gives the draws of a posterior, where there is one."""
    has_figures: ClassVar[bool] = True
    """Whether there is something to draw."""

    seed: int
    warnings: tuple[str, ...] = ()
    slips: tuple[str, ...] = ()
    reached_goal: bool = True

    @property
    def status(self) -> str:
        """How the computation ended; "done" where nothing has to converge."""
        return "done"

    @property
    def has_draws(self) -> bool:
        """Whether `to_arviz` gives the draws of a posterior."""
        return bool(self.draws)

    @property
    def title(self) -> str:
        """What was asked about, for headings."""
        return ""

    @property
    def about(self) -> tuple[Specimen, ...]:
        """The plates that were asked about, to be drawn; none for a question about no plate."""
        return ()

    def __repr__(self) -> str:
        """One line: what was asked, and how it ended; `summary()` says the rest."""
        about = f"{self.command} {self.title}".strip()
        many = f", warnings: {len(self.warnings)}" if self.warnings else ""
        return f"<{type(self).__name__} of {about}: {self.status}{many}>"

    def summary(self, *, verbose: bool = False) -> str:
        """The screen of the command, as plain text; verbose : with the tables behind the answer."""
        from_tables = import_module("cpam_bayes.report.tables").plain_text
        return "\n".join(from_tables(table) for table in self.screen(verbose=verbose) if table.rows)

    def in_words(self) -> Any:
        """The answer in plain words, see `cpam_bayes.report.summary.Summary`."""
        return self._rendered("summary", "summary")

    def screen(self, *, verbose: bool = False) -> tuple[Any, ...]:
        """The tables of the screen, see `cpam_bayes.report.tables.Table`.

        verbose : with the statistics and tables behind the answer.
        """
        words = import_module("cpam_bayes.report.summary")
        first, behind = words.summary_tables(self.in_words()), self.tables()
        if not behind:
            return tuple(first)
        return (*first, *(behind if verbose else (words.MORE,)))

    def sections(self) -> tuple[Any, ...]:
        """What stands behind the answer, see `cpam_bayes.report.sections.Section`."""
        return tuple(self._rendered("screen", "sections"))

    def tables(self) -> tuple[Any, ...]:
        """The statistics and tables behind the answer."""
        return tuple(import_module("cpam_bayes.report.sections").tables_of(self.sections()))

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of the command: what is not a finite number is None."""
        plain = import_module("cpam_bayes.report.documents").plain
        return dict(plain(self._rendered("document", "document")))

    def figures(self) -> Mapping[str, Figure]:
        """All figures by name, drawn anew; the last one is a drawing of the plate."""
        drawn = dict(self._rendered("figures", "figures")) if self.has_figures else {}
        if self.about:
            drawn["plate"] = import_module("cpam_bayes.report.plates.figures").plate_figure(self.about)
        return drawn

    def captions(self) -> Mapping[str, Any]:
        """What to see in each figure, by name, see `cpam_bayes.report.sections.Caption`."""
        said = dict(self._rendered("captions", "captions")) if self.has_figures else {}
        if self.about:
            said["plate"] = import_module("cpam_bayes.report.plates.captions").plate_caption(self.about)
        return said

    def plot(self, name: str | None = None) -> Figure:
        """One figure, the first one unless named.

        Raises
        ------
        ValueError
            If there is no figure of that name.
        """
        drawn = self.figures()
        if name is None and drawn:
            return next(iter(drawn.values()))
        if name is None or name not in drawn:
            raise ValueError(f"plot: received {name!r}, accepted: {' '.join(drawn) or 'nothing to be drawn'}")
        return drawn[name]

    def texts(self) -> Mapping[str, str]:
        """Further files of `--out`, by name."""
        return {}

    def datasets(self) -> Mapping[str, Any]:
        """Further NetCDF files of `--out` as xarray datasets, by name."""
        return {}

    @checked
    def save(self, directory: str | os.PathLike[str]) -> None:
        """Write the JSON document, the figures and the other files of `--out` into a directory.

        Raises
        ------
        ValueError
            If the directory cannot be made or written to; `ArgumentError` if it is no path.
        """
        files = import_module("cpam_bayes.report.files")
        with files.staging(os.fspath(directory)) as stage:
            files.save(self, stage)

    def to_arviz(self) -> Any:
        """The draws with their log densities as arviz ``InferenceData``, as in ``posterior.nc``.

        Raises
        ------
        ValueError
            If no posterior was sampled.
        """
        if not self.has_draws:
            raise ValueError(f"to_arviz: {self.command} samples no posterior; `sample` and `sequence` do")
        return import_module(self.draws).inference_data(self)

    def _repr_html_(self) -> str:
        return str(import_module("cpam_bayes.report.page").fragment(self.screen(verbose=True)))

    def _rendered(self, part: str, function: str) -> Any:
        return getattr(import_module(f"cpam_bayes.report.{self.question}.{part}"), function)(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PlateResult(Result):
    """The answer to a question about one plate.

    What reading its measurement left doubtful is a warning of every such answer.

    air_shifts : (n,) relative changes of the lowest frequencies that the air of a room would cause, None
    where air is in the model or its effect is not computed.
    """

    specimen: Specimen
    air_shifts: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        measurement = self.specimen.measurement
        if measurement is not None and measurement.remarks:
            warnings = dict.fromkeys((*self.warnings, *measurement.remarks))
            object.__setattr__(self, "warnings", tuple(warnings))

    @property
    def title(self) -> str:
        """The name of the plate."""
        return self.specimen.name

    @property
    def about(self) -> tuple[Specimen, ...]:
        """The plate."""
        return (self.specimen,)


def within_time(verb: Callable[P, R]) -> Callable[P, R]:
    """A function whose answer says first what it lacks because time was up (`cpam_bayes.deadline`)."""

    @wraps(verb)
    def telling(*args: P.args, **kwargs: P.kwargs) -> R:
        answer, limit = verb(*args, **kwargs), current_limit()
        if limit is None or not limit.missing:
            return answer
        # a part of the answer may have said already what was missing by then
        slips, warnings = (
            (limit.sentence, *(text for text in texts if not text.startswith(limit.beginning)))
            for texts in (answer.slips, answer.warnings)
        )
        return replace(answer, slips=slips, warnings=warnings, reached_goal=False)

    return telling
