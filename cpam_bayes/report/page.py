"""An answer as one self-contained HTML page: its tables, and its figures within."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from cpam_bayes.report.tables import Table

__all__ = ["fragment", "page_text", "write_page"]

_STYLE = """\
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 70rem; margin: 2rem auto }
h1 { font-size: 1.5rem }
h2 { font-size: 1.05rem; margin: 1.8rem 0 .4rem }
table { border-collapse: collapse }
td, th { padding: .15rem .8rem .15rem 0; text-align: left; vertical-align: top }
th { border-bottom: 1px solid #999; font-weight: 600 }
.n { text-align: right; font-variant-numeric: tabular-nums }
.flag td { background: #fff3d6 }
img { max-width: 100% }
figure { margin: 1rem 0 }
"""


def page_text(title: str, tables: Sequence[Table], figures: Sequence[tuple[str, bytes]]) -> str:
    """The page; figures : name and bytes of each PNG."""
    parts = [
        "<!DOCTYPE html>",
        f'<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>',
        f"<style>\n{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
    ]
    parts.append(fragment(tables))
    for name, png in figures:
        source = base64.b64encode(png).decode("ascii")
        shown = escape(name.replace("_", " "))
        parts.append(f'<figure><img alt="{shown}" src="data:image/png;base64,{source}"></figure>')
    return "\n".join([*parts, "</body></html>\n"])


def fragment(tables: Sequence[Table]) -> str:
    """The tables, for a page or a notebook."""
    return "\n".join(_table(table) for table in tables if table.rows)


def write_page(title: str, tables: Sequence[Table], directory: Path) -> None:
    """Write ``report.html`` with the PNG files in the directory's ``figures``."""
    pictures = [(path.stem, path.read_bytes()) for path in sorted((directory / "figures").glob("*.png"))]
    (directory / "report.html").write_text(page_text(title, tables, pictures), encoding="utf-8")


def _table(table: Table) -> str:
    lines = [f"<h2>{escape(table.title)}</h2>", "<table>"]
    if table.headings:
        cells = zip(table.headings, table.columns, strict=True)
        lines.append("<tr>" + "".join(_cell("th", text, c.number) for text, c in cells) + "</tr>")
    for i, row in enumerate(table.rows):
        flag = ' class="flag"' if i in table.flagged else ""
        cells = zip(row, table.columns, strict=True)
        lines.append(f"<tr{flag}>" + "".join(_cell("td", text, c.number) for text, c in cells) + "</tr>")
    return "\n".join([*lines, "</table>"])


def _cell(tag: str, text: str, number: bool) -> str:
    kind = ' class="n"' if number else ""
    return f"<{tag}{kind}>{escape(text)}</{tag}>"
