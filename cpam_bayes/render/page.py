"""An answer as one self-contained HTML page: the first screen, the plate and the fit, the rest folded.

The page embeds its style and figures, has no script, and forbids itself to fetch anything.
"""

from __future__ import annotations

import base64
import hashlib
import math
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from cpam_bayes import __version__
from cpam_bayes.plate import Specimen
from cpam_bayes.render.report import (
    COMPUTATION,
    Caption,
    Report,
    Section,
    Summary,
    facts,
    json_text,
    merged,
)

PAGE: Final = "report.html"
"""File name of the page of every command."""

# A larger SVG is embedded as PNG.
_MAX_SVG_BYTES: Final = 150_000
# Smallest scale of a figure on a page.
_LEAST_SCALE: Final = 0.86
_COMMAND: Final = re.compile(r'<meta name="generator" content="cpam-bayes (\w+)">')
_JOINED: Final = re.compile(
    r"(?<=\d) (?=%|(?:GPa|MPa|mm|um|Hz|kg|g)\b)|(?<=\d) (?=\+-)|(?<=\+-) (?=\d)|(?<=[<>]=) "
)
"""Spaces at which lines are not broken: before units, within a tolerance, after an inequality sign."""
_LIBRARIES: Final = ("numpy", "scipy", "emcee")


TERMS: Final = {
    "contraction": "1 - (sd / prior sd)\N{SUPERSCRIPT TWO}: 1 where the data decide, 0 where the prior does",
    "effective samples": "independent draws that would be as good as the correlated ones of the chains",
    "evidence": "the probability of the list under a model, its constants integrated over; also marginal "
    "likelihood",
    "extended model": "the plate model with the claimed cause in it",
    "false peak": "a listed frequency that is no mode of the plate",
    "interval": "unless said otherwise, from the 2.5 % to the 97.5 % quantile of the posterior",
    "k-hat": "tail index of importance weights: above 0.7 their average is not to be trusted",
    "label": "a mode named by its nodal lines across x and across y: (1,1) is the first twist of a free "
    "plate",
    "missed mode": "a mode within the list's range but not in the list",
    "nat": "unit of a log probability: 1 nat is a factor of 2.72",
    "noise": "scatter of a measured frequency about that of its mode",
    "p-value": "the probability of residuals at least as large if the model is right, with the noise "
    "named beside it",
    "plain model": "the plate as its file says, with nothing wrong",
    "posterior": "the probability of the constants after the measurement",
    "prior": "the probability of the constants, or of the size of a cause, before the measurement",
    "R-hat": "spread between chains over that within them: 1.01 or more means not converged",
    "repeatability": "the scatter of a frequency from test to test of one plate",
    "residual": "predicted / measured - 1",
    "rms": "root mean square, here of the relative residuals",
    "signature": "how a cause shifts the frequencies, less what the constants can imitate",
    "walker": "one of the points that an ensemble sampler moves",
}
"""Word -> its meaning on a page, as in docs/glossary.md."""


def terms_section(text: str) -> Section:
    """Section with the terms used in a text and their meanings."""
    used = tuple(
        (word, meaning)
        for word, meaning in TERMS.items()
        if re.search(rf"\b{re.escape(word)}s?\b", text, re.IGNORECASE)
    )
    return Section("Terms on this page", (facts("Terms on this page", used),))


@dataclass(frozen=True, slots=True)
class Image:
    """A figure embedded in a page.

    source : data URI
    width : natural width of the figure, CSS pixels
    """

    source: str
    width: int
    caption: Caption

    @property
    def least_width(self) -> int:
        """Width below which the smallest letters, of 8 points, would be less than 9 pixels high."""
        return math.ceil(_LEAST_SCALE * self.width)


def write_page(
    report: Report,
    directory: Path,
    command: str,
    title: str,
    seed: int,
    about: Sequence[Specimen],
) -> None:
    """Write the page, with the figures in the directory's ``figures``.

    report : with all drawings and the JSON document that is saved beside the page
    about : the plates asked about
    """
    document, drawings = report.document, report.drawings
    images = {d.name: _image(directory / "figures" / d.name, d.caption) for d in drawings}
    terms = terms_section(_words(report, [d.caption for d in drawings]))
    text = page_text(
        f"{command} {title}".strip(),
        report.summary,
        (*report.sections, terms, _computation(document, command, seed, about)),
        images,
        f"cpam_bayes {__version__}, sources {document['fingerprint']}, seed {seed}",
        command,
    )
    (directory / PAGE).write_text(text, encoding="utf-8")


def _words(report: Report, captions: Iterable[Caption]) -> str:
    """All text of a page except that inside figures."""
    summary = report.summary
    tables = (*summary.tables, *(table for section in report.sections for table in section.tables))
    cells = (" ".join((table.title, *(table.headings or ()), *chain(*table.rows))) for table in tables)
    said = (summary.headline, *summary.slips, *summary.lines, *summary.warnings, summary.next_step)
    return "\n".join((*said, *cells, *(caption.text for caption in captions)))


def command_of(page: Path) -> str | None:
    """The command that wrote a page, None for any other file."""
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
    """HTML of the page; images : by the names in the sections. made, command : what made the page."""
    template = _environment().get_template("page.html")
    shown = [s for s in merged(sections) if s.figures or any(table.rows for table in s.tables)]
    return template.render(
        title=title,
        summary=summary,
        sections=shown,
        images=images,
        made=made,
        command=command,
    )


def fragment(summary: Summary) -> str:
    """HTML of the first screen, for a notebook."""
    shown: Any = _environment().get_template("tables.html").module
    return f"<p><b>{escape(summary.title)}</b></p>\n{shown.answer(summary, 4)}"


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["typeset"] = _typeset
    # the title of a table without its explanation
    environment.filters["brief"] = lambda title: re.split("[:;,]", title)[0]
    environment.filters["command"] = _command
    style = environment.get_template("style.css").render()
    environment.globals["style"] = Markup(style)
    return environment


def _typeset(text: str) -> Markup:
    """Text as HTML with typographic signs; words in backquotes become code."""
    kept = _JOINED.sub("\N{NO-BREAK SPACE}", text)
    plain = str(escape(kept.replace("+-", "\N{PLUS-MINUS SIGN}")))
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", plain))


def _command(text: str) -> Markup:
    """A next step, whose command follows two spaces."""
    said, _, line = text.partition("  ")
    return _typeset(f"{said} `{line}`" if line else said)


def _image(figure: Path, caption: Caption) -> Image:
    """A figure as SVG, or as PNG where the SVG is large."""
    drawn = figure.with_suffix(".svg").read_bytes()
    points = re.search(rb'<svg[^>]*\swidth="([0-9.]+)pt"', drawn)
    assert points is not None, f"{figure}: no width"
    kind = "svg+xml"
    if len(drawn) > _MAX_SVG_BYTES:
        kind, drawn = "png", figure.with_suffix(".png").read_bytes()
    data = base64.b64encode(drawn).decode("ascii")
    return Image(f"data:image/{kind};base64,{data}", round(float(points[1]) * 96 / 72), caption)


def _computation(document: Mapping[str, Any], command: str, seed: int, about: Sequence[Specimen]) -> Section:
    """Section of versions, seed, time and hashes, by which the answer is reproduced and recognised."""
    libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    rows = [
        ("program", f"cpam_bayes {__version__}, {libraries}"),
        (
            "sources",
            f"fingerprint {document['fingerprint']}, the hash of the code that the answer depends on",
        ),
        ("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        ("seed", f"{seed}: the same seed gives the same answer"),
    ]
    if document.get("seconds") is not None:
        rows.append(("time", f"{document['seconds']:.1f} s"))
    rows += [
        (specimen.source, f"SHA-256 {hashlib.sha256(Path(specimen.source).read_bytes()).hexdigest()}")
        for specimen in about
        if Path(specimen.source).is_file()
    ]
    answer = hashlib.sha256(json_text(document).encode()).hexdigest()
    rows.append((f"{command}.json", f"SHA-256 {answer}"))
    return Section(COMPUTATION, (facts("Provenance", tuple(rows)),))
