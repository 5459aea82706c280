"""Tables 10 to 14: constants that the paper identified from frequencies with added noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

from cpam_bayes.paper.percentages import last_digit, possible_percent
from cpam_bayes.paper.tables import content

TABLES: Final = {"A2": 10, "C1": 11, "C3": 12, "D1": 13, "D3": 14}


@dataclass(frozen=True, slots=True)
class PrintedConstant:
    """One row, in the digits of the print.

    key : name with its unit, as in plate files.
    free : identified from the list without noise.
    amount, percent_error : mean over ten noisy lists and its difference from ``free``, one a level.
    """

    key: str
    free: str
    amount: tuple[str, ...]
    percent_error: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PerturbationTable:
    """One of Tables 10 to 14.

    angles_deg : the unknown plies without noise, then one sequence a level; empty where none was
    sought. The paper sought angles and constants together.
    """

    number: int
    specimen: str
    levels_percent: tuple[float, ...]
    constants: tuple[PrintedConstant, ...]
    angles_deg: tuple[tuple[int, ...], ...]

    def percent_error(self, key: str, level_percent: float) -> float | None:
        """The printed percentage, or None where the table has no such constant or level."""
        for row in self.constants:
            if row.key == key and level_percent in self.levels_percent:
                return float(row.percent_error[self.levels_percent.index(level_percent)])
        return None


@dataclass(frozen=True, slots=True)
class Contradiction:
    """A printed percentage that its own row cannot give, whatever was rounded.

    lowest, highest : percentages that the printed amounts allow.
    """

    table: int
    key: str
    level_percent: float
    printed: str
    lowest: float
    highest: float


@cache
def perturbation_table(specimen: str) -> PerturbationTable | None:
    """The table of a built-in specimen, or None where the paper has none for it."""
    number = TABLES.get(specimen)
    if number is None:
        return None
    read = content(number)
    angles = read.get("angles_deg")
    return PerturbationTable(
        number=read["table"],
        specimen=read["specimen"],
        levels_percent=tuple(read["levels_percent"]),
        constants=tuple(
            PrintedConstant(key, row["free"], tuple(row["amount"]), tuple(row["percent_error"]))
            for key, row in read["constants"].items()
        ),
        angles_deg=() if angles is None else tuple(tuple(a) for a in (angles["free"], *angles["found"])),
    )


def contradictions(table: PerturbationTable) -> tuple[Contradiction, ...]:
    """Printed percentages outside of what 100 (amount / free - 1) can be before rounding.

    Amount and free value may each be half a unit of their last digit off, the percentage a whole one,
    since some were cut off and not rounded.
    """
    impossible = []
    for row in table.constants:
        for level, amount, printed in zip(table.levels_percent, row.amount, row.percent_error, strict=True):
            lowest, highest = possible_percent(amount, row.free, exact_reference=False)
            unit = last_digit(printed)
            if not lowest - unit <= float(printed) <= highest + unit:
                impossible.append(Contradiction(table.number, row.key, level, printed, lowest, highest))
    return tuple(impossible)
