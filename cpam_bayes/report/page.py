"""An answer as one self-contained HTML page: the summary first, then section by section what it rests on.

The page holds its style and its figures, has no script, and forbids itself to fetch anything.
"""

from __future__ import annotations

import base64
import hashlib
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from cpam_bayes import __version__
from cpam_bayes.report.documents import json_text
from cpam_bayes.report.sections import COMPUTATION, Caption, Section, merged
from cpam_bayes.report.summary import Summary, sentence
from cpam_bayes.report.tables import Table, facts
from cpam_bayes.report.terms import terms_section
from cpam_bayes.result import Result

__all__ = ["PAGE", "Image", "command_of", "fragment", "page_text", "write_page"]

PAGE: Final = "report.html"
"""Name of the page of every command."""

# A drawing of more bytes than this is embedded as pixels.
_MAX_SVG_BYTES: Final = 150_000
_COMMAND: Final = re.compile(r'<meta name="generator" content="cpam-bayes (\w+)">')
_LIBRARIES: Final = ("numpy", "scipy", "emcee")


@dataclass(frozen=True, slots=True)
class Image:
    """A figure as a page holds it.

    source : a data URI
    width : of the figure at its own size, CSS pixels
    """

    source: str
    width: int
    caption: Caption


def write_page(result: Result, directory: Path) -> None:
    """Write the page with the figures that lie in the directory's ``figures``."""
    captions = result.captions()
    images = {name: _image(directory / "figures" / name, caption) for name, caption in captions.items()}
    summary, sections = result.in_words(), result.sections()
    terms = terms_section(_words(summary, sections, captions.values()))
    text = page_text(
        f"{result.command} {result.title}".strip(),
        summary,
        (*sections, terms, _computation(result)),
        images,
        f"cpam_bayes {__version__}, seed {result.seed}",
        result.command,
    )
    (directory / PAGE).write_text(text, encoding="utf-8")


def _words(summary: Summary, sections: Iterable[Section], captions: Iterable[Caption]) -> str:
    """All that a page says, but for the words inside its figures."""
    tables = (*summary.tables, *(table for section in sections for table in section.tables))
    cells = (" ".join((table.title, *(table.headings or ()), *chain(*table.rows))) for table in tables)
    said = (summary.headline, *summary.slips, *summary.basis, *summary.warnings, *summary.next_steps)
    return "\n".join((*said, *cells, *(caption.text for caption in captions)))


def command_of(page: Path) -> str | None:
    """The command that wrote a page, None for a file of something else."""
    found = _COMMAND.search(page.read_text(encoding="utf-8", errors="replace"))
    return found[1] if found else None


def page_text(
    title: str,
    summary: Summary,
    sections: Sequence[Section],
    images: Mapping[str, Image],
    made: str = "",
    command: str = "",
) -> str:
    """The page; images : by the names that the sections give. made, command : what made the page."""
    template = _environment().get_template("page.html")
    shown = [s for s in merged(sections) if s.figures or any(table.rows for table in s.tables)]
    return template.render(
        title=title, summary=summary, sections=shown, images=images, made=made, command=command
    )


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
    environment.filters["typeset"] = _typeset
    environment.filters["brief"] = _brief
    style = environment.get_template("style.css").render()
    environment.globals["style"] = Markup(style)
    return environment


def _brief(title: str) -> str:
    """The title of a table without what it explains."""
    return re.split("[:;,]", title)[0]


def _typeset(text: str) -> Markup:
    """A text of the screen as print has it: signs of its own, and words of the command line as code."""
    plain = str(escape(text.replace("+-", "\N{PLUS-MINUS SIGN}")))
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", plain))


def _image(figure: Path, caption: Caption) -> Image:
    """A figure as lines where they are few, as pixels where they are many."""
    drawn = figure.with_suffix(".svg").read_bytes()
    points = re.search(rb'<svg[^>]*\swidth="([0-9.]+)pt"', drawn)
    assert points is not None, f"{figure}: no width"
    kind = "svg+xml"
    if len(drawn) > _MAX_SVG_BYTES:
        kind, drawn = "png", figure.with_suffix(".png").read_bytes()
    data = base64.b64encode(drawn).decode("ascii")
    return Image(f"data:image/{kind};base64,{data}", round(float(points[1]) * 96 / 72), caption)


def _computation(result: Result) -> Section:
    """Versions, seed, time and hashes: what repeats the answer, and what tells whether it is this one."""
    document = result.to_dict()
    libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    rows = [
        ("program", f"cpam_bayes {__version__}, {libraries}"),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("seed", f"{result.seed}: the same seed gives the same answer"),
    ]
    if document.get("seconds") is not None:
        rows.append(("time", f"{document['seconds']:.1f} s"))
    rows += [
        (specimen.source, f"SHA-256 {hashlib.sha256(Path(specimen.source).read_bytes()).hexdigest()}")
        for specimen in result.about
        if Path(specimen.source).is_file()
    ]
    answer = hashlib.sha256(json_text(document).encode()).hexdigest()
    rows.append((f"{result.command}.json", f"SHA-256 {answer}"))
    return Section(COMPUTATION, (facts("What repeats the answer, and which answer it is", tuple(rows)),))
