"""A small handmade answer, for tests of every display."""

import io
from dataclasses import dataclass
from typing import ClassVar

from matplotlib.figure import Figure

from cpam_bayes.render import report
from cpam_bayes.render.figures import new_figure
from cpam_bayes.render.report import Caption, Column, Drawing, Report, Rows, Section, facts, remarks
from cpam_bayes.result import Result


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


CONSTANTS = Rows(
    "constants",
    (
        Column("", "name", lambda row: row[0]),
        Column("value", "value", lambda row: row[1], lambda v: f"{v:.1f} GPa", number=True),
        Column("95 % interval", None, lambda row: row[2] and "{:.0f} to {:.0f}".format(*row[2])),
        Column(None, "sd", lambda row: row[3]),
        Column("reference", None, lambda row: None),
        Column("note", None, lambda row: "not determined" if row[2] is None else "determined"),
    ),
    (("E1", 136.6, (131.4, 141.9), 2.7), ("E2", 8.87, None, float("nan"))),
    lambda row: row[2] is None,
)


def draw() -> Figure:
    figure = new_figure(6.0, 2.0)
    figure.subplots().plot([0.0, 1.0], [0.0, 1.0])
    return figure


REPORT = Report(
    summary=report.Summary(
        title="identify D&G",
        headline="1 frequency < 2 constants: E1 is determined.",
        tables=(CONSTANTS.table("Constants"),),
        lines=("Fit 0.19 %, `relative_std` +- 0.2 %.",),
        next_step="is anything wrong?  cpam-bayes diagnose 'D&G'",
        slips=("The list is in kHz, not Hz. Divide by 1000.",),
        warnings=("The noise is high.",),
    ),
    sections=(
        Section("Fit of each mode", (facts("Layup", (("layup", "[(0/90)_8]_s"),)),), ("fit",), folded=False),
        Section("Empty", (remarks("nothing", ()),)),
        Section("Details", (remarks("In words", ("[red]no colour[/red] <script>",), flagged=True),)),
        Section(report.COMPUTATION, (facts("Computation", (("time", "1 s"),)),)),
    ),
    document={"constants": CONSTANTS.records(), "seconds": 1.0},
    drawings=(Drawing("fit", draw, Caption("A line <b>.", 'A "straight" line, drawn as an example.')),),
    rows=(CONSTANTS,),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Small(Result):
    command: ClassVar[str] = "identify"

    def report(self) -> Report:
        return REPORT


RESULT = Small(seed=0)
