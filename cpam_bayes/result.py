"""The base of every answer: it can be read, plotted, saved, and exported as numbers.

A verb (`forward`, `identify`, `diagnose`, ...) returns a subclass of `Result` with all numbers, the notices
and the status. Its presentation, `report()`, is made on request.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import singledispatch, wraps
from typing import TYPE_CHECKING, Any, ClassVar, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from cpam_bayes.answer import Notice, each_once
from cpam_bayes.errors import checked
from cpam_bayes.fingerprint import fingerprint
from cpam_bayes.plate import Specimen
from cpam_bayes.render.notices import sentences
from cpam_bayes.render.report import Drawing, Report, Summary, Table, plain
from cpam_bayes.render.terminal import plain_text, screen_tables
from cpam_bayes.running import current_limit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@singledispatch
def present(result: Any) -> Report:
    """The report of an answer; each question registers the function for its own result."""
    raise TypeError(f"present: received {type(result).__name__}, accepted: the result of a question")


P = ParamSpec("P")
R = TypeVar("R", bound="Result")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Result:
    """The answer to one question.

    seed : repeats the answer bit for bit. notices : every reason not to trust the numbers as they stand.
    reached_goal : False where a sampler has not converged; a notice then says so.
    """

    command: ClassVar[str]
    """The command that prints it, and the name of its JSON file."""

    seed: int
    notices: tuple[Notice, ...] = ()
    reached_goal: bool = True

    @property
    def warnings(self) -> tuple[str, ...]:
        """Every reason not to trust the numbers as they stand, in sentences."""
        return sentences(self.notices, "slip", "warning")

    @property
    def slips(self) -> tuple[str, ...]:
        """The warnings that most likely ruin the answer."""
        return sentences(self.notices, "slip")

    @property
    def cautions(self) -> tuple[str, ...]:
        """The other warnings."""
        return sentences(self.notices, "warning")

    @property
    def status(self) -> str:
        """The outcome of the computation; "done" where nothing has to converge."""
        return "done"

    @property
    def has_draws(self) -> bool:
        """Whether `to_arviz` gives the draws of a posterior."""
        return False

    @property
    def title(self) -> str:
        """Name of the subject, for headings."""
        return ""

    @property
    def about(self) -> tuple[Specimen, ...]:
        """The plates in question, for drawings; none for a question about no plate."""
        return ()

    def __repr__(self) -> str:
        """One line: what was asked, and how it ended; `summary()` says the rest."""
        about = f"{self.command} {self.title}".strip()
        many = f", warnings: {len(self.warnings)}" if self.warnings else ""
        return f"<{type(self).__name__} of {about}: {self.status}{many}>"

    def screen(
        self, headline: str, tables: tuple[Table, ...] = (), lines: tuple[str, ...] = (), next_step: str = ""
    ) -> Summary:
        """The first screen, with the title, the slips and the warnings of the answer."""
        title = f"{self.command} {self.title}"
        return Summary(title, headline, tables, lines, next_step, self.slips, self.cautions)

    def report(self) -> Report:
        """The report of the answer, made by `present`."""
        return present(self)

    def summary(self, *, verbose: bool = False) -> str:
        """The screen of the command, as plain text; verbose : with the tables behind the answer."""
        shown = screen_tables(self.report(), verbose=verbose)
        return "\n".join(plain_text(table) for table in shown if table.rows)

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of the command, in units of the plate file; None for values that are not finite.

        It holds the fingerprint of the sources that the answer depends on.
        """
        return document_of(self, self.report())

    def to_dataframe(self, name: str | None = None) -> Any:
        """A table of the answer as a pandas data frame, in the units of the plate file.

        name : the main table where left out

        Raises
        ------
        ValueError
            If there is no table of that name.
        """
        from cpam_bayes.render.report import data_frame

        return data_frame(self.report().written, name)

    def drawings(self) -> tuple[Drawing, ...]:
        """All drawings; one of the plate is appended where the report has none."""
        return self.saved_report().drawings

    def saved_report(self) -> Report:
        """The report as it is saved: the whole document and all drawings."""
        from cpam_bayes.render.plate import PLATE, plate_drawing

        report = self.report()
        has_plate = any(drawing.name == PLATE for drawing in report.drawings)
        plate = (plate_drawing(self.about),) if self.about and not has_plate else ()
        return replace(report, document=document_of(self, report), drawings=(*report.drawings, *plate))

    def figures(self) -> Mapping[str, Figure]:
        """All figures by name, drawn anew."""
        return {drawing.name: drawing.draw() for drawing in self.drawings()}

    def plot(self, name: str | None = None) -> Figure:
        """One figure, the first one unless named.

        Raises
        ------
        ValueError
            If there is no figure of that name.
        """
        drawings = {drawing.name: drawing for drawing in self.drawings()}
        if name is None and drawings:
            return next(iter(drawings.values())).draw()
        if name is None or name not in drawings:
            raise ValueError(f"plot: received {name!r}, accepted: {' '.join(drawings) or 'nothing to draw'}")
        return drawings[name].draw()

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
        from cpam_bayes.render.files import save, staging

        with staging(os.fspath(directory)) as stage:
            save(self, stage)

    def to_arviz(self) -> Any:
        """The draws with their log densities for arviz, as in ``posterior.nc``.

        Raises
        ------
        ValueError
            If no posterior was sampled.
        """
        raise ValueError(f"to_arviz: {self.command} has no draws; `identify`, `sample` and `sequence` have")

    def _repr_html_(self) -> str:
        from cpam_bayes.render.page import fragment

        return fragment(self.report().summary)


def document_of(result: Result, report: Report) -> dict[str, Any]:
    """The JSON document of an answer and its report, with the fingerprint of its sources."""
    keys = dict(plain(report.document))
    head = {key: keys.pop(key) for key in ("command", "version") if key in keys}
    return {**head, "fingerprint": fingerprint(type(result).__module__), **keys}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PlateResult(Result):
    """The answer to a question about one plate.

    Doubts from reading its measurement are warnings of every such answer.

    air_shifts : (n,) relative changes of the lowest frequencies that the air of a room would cause, None
    where air is in the model or its effect is not computed.
    """

    specimen: Specimen
    air_shifts: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        measurement = self.specimen.measurement
        if measurement is not None and measurement.notices:
            object.__setattr__(self, "notices", each_once((*self.notices, *measurement.notices)))

    @property
    def title(self) -> str:
        """The name of the plate."""
        return self.specimen.name

    @property
    def about(self) -> tuple[Specimen, ...]:
        """The plate."""
        return (self.specimen,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class PlatesResult(Result):
    """The answer to a question about one or several plates, which it holds."""

    plates: tuple[Specimen, ...]

    @property
    def title(self) -> str:
        """The names of the plates."""
        return " ".join(plate.name for plate in self.plates)

    @property
    def about(self) -> tuple[Specimen, ...]:
        """The plates."""
        return self.plates


def within_time(verb: Callable[P, R]) -> Callable[P, R]:
    """Wrap a verb so that its answer first says what is missing when time is up (`cpam_bayes.running`)."""

    @wraps(verb)
    def telling(*args: P.args, **kwargs: P.kwargs) -> R:
        answer, limit = verb(*args, **kwargs), current_limit()
        if limit is None or not limit.missing:
            return answer
        # a part of the answer may have told already what was missing by then
        others = (notice for notice in answer.notices if notice.code != "time_up")
        notice = Notice("time_up", "slip", {"seconds": limit.seconds, "missing": tuple(limit.missing)})
        return replace(answer, notices=(notice, *others), reached_goal=False)

    return telling
