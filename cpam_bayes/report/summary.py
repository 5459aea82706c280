"""The answer to a question in plain words: what a reader sees first, on a screen and on a page.

Each question has a module `cpam_bayes.report.QUESTION.summary` that makes the record; how it is shown is
the same for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from cpam_bayes.formatting import listed, significant, with_spread
from cpam_bayes.report.tables import Column, Table, headed, remarks

__all__ = [
    "BASIS",
    "CONSTANTS",
    "MORE",
    "NEXT_STEPS",
    "WARNINGS",
    "ConstantLine",
    "Determined",
    "Summary",
    "determined_by",
    "more_modes_step",
    "names_of",
    "sentence",
    "summary_tables",
]

Determined = Literal["yes", "partly", "no"]

CONSTANTS: Final = "Constants"
BASIS: Final = "What the answer rests on"
WARNINGS: Final = "Warnings"
NEXT_STEPS: Final = "What to do next"

MORE: Final = remarks(
    "Statistics and tables behind this answer",
    ("--verbose prints them; --json and --out DIR hold all of them; in Python: summary(verbose=True)",),
)


@dataclass(frozen=True, slots=True)
class ConstantLine:
    """One constant as a reader needs it.

    symbol : as the field writes it, E1
    title : its name in words
    key : its name in plate files and JSON documents, E1_GPa
    value : in the unit
    interval : of 95 %, in the unit, None where none can be given
    unit : "" where there is none
    reference : of the plate file, nan where it has none
    determined : whether the frequencies determine the constant
    by : what decides its value, alone or with the frequencies, as it ends "its value is decided by ..."
    rests_on : the priors of other constants that the interval rests on, "the prior of E2"; "" for none
    """

    symbol: str
    title: str
    key: str
    value: float
    interval: tuple[float, float] | None
    unit: str
    reference: float
    determined: Determined
    by: str
    rests_on: str = ""

    @property
    def value_text(self) -> str:
        """The value with as many digits as its interval is worth."""
        return with_spread(self.value, self._sd)[0]

    @property
    def interval_text(self) -> str:
        """The interval of 95 %, without its unit."""
        if self.interval is None:
            return "not known"
        low, high = (with_spread(end, self._sd)[0] for end in self.interval)
        return f"{low} to {high}"

    @property
    def reference_text(self) -> str:
        """The reference, "" where there is none."""
        return f"{self.reference:.5g}" if math.isfinite(self.reference) else ""

    @property
    def determined_text(self) -> str:
        """Whether the frequencies determine the constant, and what decides where they do not."""
        if self.determined == "no":
            return f"no, by {self.by}"
        if self.determined == "partly":
            return f"partly, with {self.by}" + (f" and {self.rests_on}" if self.rests_on else "")
        half = 2.0 * self._sd / abs(self.value)
        said = f"yes, to +-{significant(100.0 * half, 2)} %" if math.isfinite(half) else "yes"
        return said + (f", with {self.rests_on}" if self.rests_on else "")

    @property
    def _sd(self) -> float:
        return math.nan if self.interval is None else (self.interval[1] - self.interval[0]) / 4.0


@dataclass(frozen=True, slots=True)
class Summary:
    """The answer to one question in plain words; every sentence can be understood alone.

    title : what was asked
    slips : what most likely ruins the answer, and the likely cure; read before all else
    headline : the answer in one or two sentences, a line for each of several questions
    constants : the constants that were asked for, () where none were
    tables : what else was asked for: modes, stacking sequences
    basis : what the answer rests on: frequencies, plate, noise, and what no frequency shows
    warnings : every reason not to trust the answer as it stands
    next_steps : what to do now, the most useful first
    """

    title: str
    headline: str
    slips: tuple[str, ...] = ()
    constants: tuple[ConstantLine, ...] = ()
    tables: tuple[Table, ...] = ()
    basis: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    next_steps: tuple[str, ...] = ()


def summary_tables(summary: Summary) -> tuple[Table, ...]:
    """The summary for a screen: slips, headline, constants, basis, warnings, next steps."""
    return (
        _head(summary),
        _constants(summary.constants),
        *summary.tables,
        remarks(BASIS, summary.basis),
        remarks(WARNINGS, tuple(map(sentence, summary.warnings)), flagged=True),
        remarks(NEXT_STEPS, summary.next_steps),
    )


def _head(summary: Summary) -> Table:
    slips = tuple(map(sentence, summary.slips))
    rows = tuple((text,) for text in (*slips, *summary.headline.splitlines()))
    return Table(summary.title, (Column(),), rows, frozenset(range(len(slips))))


def _constants(constants: tuple[ConstantLine, ...]) -> Table:
    columns = headed(
        *("", "", "#value", "95 % interval", "unit", "#reference", "determined by these frequencies")
    )
    rows = tuple(
        (
            c.symbol,
            c.title,
            c.value_text,
            c.interval_text,
            c.unit,
            c.reference_text,
            c.determined_text,
        )
        for c in constants
    )
    flagged = frozenset(i for i, c in enumerate(constants) if c.determined != "yes")
    return Table(CONSTANTS, columns, rows, flagged)


def sentence(text: str) -> str:
    """A warning as a sentence of its own: a capital letter first, a full stop last.

    A first word that is written as in a plate file or a formula keeps its small letter.
    """
    first = text.split(" ", 1)[0].rstrip(",;:")
    plain = first.isalpha() and first.islower()
    begun = text[:1].upper() + text[1:] if plain else text
    return begun if begun.endswith((".", "!", "?")) else f"{begun}."


def names_of(constants: Sequence[ConstantLine], *determined: Determined) -> str:
    """Symbols of the constants so determined, with commas and "and"."""
    return listed([c.symbol for c in constants if c.determined in determined], "and")


def more_modes_step(constants: tuple[ConstantLine, ...]) -> tuple[str, ...]:
    """What further modes may do for constants that the frequencies leave open; nothing where none is."""
    left = names_of(constants, "no", "partly")
    return (f"Measure more modes: {left} may then be determined.",) if left else ()


def determined_by(constants: tuple[ConstantLine, ...], n_frequencies: int) -> str:
    """Which constants the frequencies determine and which not, as a headline."""
    yes, no = names_of(constants, "yes"), names_of(constants, "no")
    many = "1 frequency" if n_frequencies == 1 else f"{n_frequencies} frequencies"
    verb = "determines" if n_frequencies == 1 else "determine"
    if not yes:
        begun = f"The {many} {verb} none of the constants alone"
    elif len(constants) == sum(c.determined == "yes" for c in constants):
        which = {1: "the constant", 2: "both constants"}.get(
            len(constants), f"all {len(constants)} constants"
        )
        begun = f"The {many} {verb} {which}: {yes}"
    else:
        count = sum(c.determined == "yes" for c in constants)
        begun = f"The {many} {verb} {count} of {len(constants)} constants: {yes}"
    if not no:
        return f"{begun}."
    many_no = sum(c.determined == "no" for c in constants) > 1
    value = "the values come" if many_no else "the value comes"
    return f"{begun}. Do not use {no}: {value} from bounds or priors, not from the plate."
