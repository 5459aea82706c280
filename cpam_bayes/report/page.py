"""An answer as one self-contained HTML page: the summary first, then section by section what it rests on.

The page holds its style and its figures, has no script, and forbids itself to fetch anything.
"""

from __future__ import annotations

import base64
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from cpam_bayes.report.sections import Caption, Section
from cpam_bayes.report.summary import Summary, sentence
from cpam_bayes.report.tables import Table, facts
from cpam_bayes.result import Result

__all__ = ["Image", "fragment", "page_text", "write_page"]

# A drawing of more bytes than this is embedded as pixels.
_MAX_SVG_BYTES: Final = 150_000
_LIBRARIES: Final = ("numpy", "scipy", "emcee")


@dataclass(frozen=True, slots=True)
class Image:
    """A figure as a page holds it: its source, which is data, and its caption."""

    source: str
    caption: Caption


def write_page(result: Result, directory: Path) -> None:
    """Write ``report.html`` with the figures that lie in the directory's ``figures``."""
    captions = result.captions()
    images = {name: Image(_source(directory / "figures" / name), captions[name]) for name in captions}
    text = page_text(
        f"{result.command} {result.title}".strip(),
        result.in_words(),
        (*result.sections(), _computation(result)),
        images,
    )
    (directory / "report.html").write_text(text, encoding="utf-8")


def page_text(title: str, summary: Summary, sections: Sequence[Section], images: Mapping[str, Image]) -> str:
    """The page; images : by the names that the sections give."""
    template = _environment().get_template("page.html")
    shown = [s for s in sections if s.figures or any(table.rows for table in s.tables)]
    return template.render(title=title, summary=summary, sections=shown, images=images)


def fragment(tables: Sequence[Table]) -> str:
    """The tables, for a notebook."""
    shown: Any = _environment().get_template("tables.html").module
    return "\n".join(str(shown.table(table)) for table in tables if table.rows)


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("cpam_bayes.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["sentence"] = sentence
    style = environment.get_template("style.css").render()
    environment.globals["style"] = Markup(style)
    return environment


def _source(figure: Path) -> str:
    """A figure as a data URI: lines where they are few, pixels where they are many."""
    svg, png = figure.with_suffix(".svg"), figure.with_suffix(".png")
    drawn = svg.read_bytes()
    if len(drawn) <= _MAX_SVG_BYTES:
        return f"data:image/svg+xml;base64,{base64.b64encode(drawn).decode('ascii')}"
    return f"data:image/png;base64,{base64.b64encode(png.read_bytes()).decode('ascii')}"


def _computation(result: Result) -> Section:
    """Versions, seed, work and time: what repeats the answer."""
    document = result.to_dict()
    rows = [
        ("program", f"cpam_bayes {document['version']}" if "version" in document else "cpam_bayes"),
        ("libraries", ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("seed", f"{result.seed}; the same seed gives the same answer"),
    ]
    if document.get("forward_solves"):
        rows.append(("forward solves", str(document["forward_solves"])))
    if document.get("seconds") is not None:
        rows.append(("time", f"{document['seconds']:.1f} s"))
    return Section("How this was computed", (facts("What repeats the answer", tuple(rows)),))
