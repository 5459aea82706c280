"""Tables of three modes as laboratories write them: a row per hit, a column per hit, sheets of a workbook."""

import io
from typing import Any

import openpyxl

TABLE = "mode,hz,damping\n1,101.5,0.004\n2,305.25,0.002\n3,333,\n"
MODES = [101.5, 305.25, 333.0]
TAPPED = [[101.4, 305.2, 333.1], [101.6, 305.3, 332.9]]  # hits of three modes with MODES as their means


def wide(separator: str, heads: list[str], *, first: str = "", mark: str = ".", more: str = "") -> str:
    lines = [separator.join(([first] if first else []) + heads)]
    for i, hit in enumerate(TAPPED, 1):
        lines.append(separator.join(([str(i)] if first else []) + [f"{f}".replace(".", mark) for f in hit]))
    return "\n".join(lines) + f"\n{more}"


def across(separator: str, heads: list[str]) -> str:
    rows = [[str(i), *(f"{hit[i - 1]}" for hit in TAPPED)] for i in (1, 2, 3)]
    return "\n".join(separator.join(row) for row in [heads, *rows]) + "\n"


def sheet(rows: list[list[Any]], *, before: list[list[Any]] | None = None) -> bytes:
    book = openpyxl.Workbook()
    for row in before or []:
        book.active.append(row)
    page = book.active if before is None else book.create_sheet("data")
    for row in rows:
        page.append(row)
    held = io.BytesIO()
    book.save(held)
    return held.getvalue()


LONG = [["Mode", "Frequenz [Hz]"], *([i, f] for i, f in enumerate(MODES, 1))]
WIDE = [["Schlag", "Mode 1", "Mode 2", "Mode 3"], *([i, *hit] for i, hit in enumerate(TAPPED, 1))]
THREE = ["1", "2", "3"]
