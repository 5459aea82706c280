"""Table 9: constants and stacking sequences that the paper identified together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

from cpam_bayes.paper.tables import printed_table

PAPER: Final = "CPAM"
"""Source of the rows of the paper's own method."""


@dataclass(frozen=True, slots=True)
class IdentifiedLayup:
    """One specimen of Table 9.

    constants : by name with unit, as in plate files, in the digits of the print; empty where part (a) has
    no row of its own (F1, F2, G1, G2).
    angles_deg : the unknown plies of part (b), outermost first.
    """

    specimen: str
    constants: Mapping[str, str]
    angles_deg: tuple[int, ...]


@cache
def identified_layups() -> Mapping[str, IdentifiedLayup]:
    """Table 9 by specimen, in the order of part (b)."""
    table = printed_table(9)
    constants = {
        row.specimen: {name: cell.text for name, cell in row.values.items()}
        for row in table.rows
        if row.part == "a" and row.source == PAPER
    }
    return {
        row.specimen: IdentifiedLayup(
            specimen=row.specimen,
            constants=constants.get(row.specimen, {}),
            angles_deg=row.values["angles_deg"].angles_deg,
        )
        for row in table.rows
        if row.part == "b"
    }
