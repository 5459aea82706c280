"""Saved results of studies, and the sections of documentation pages that are written from them.

A page holds a section between two marks, each on a line of its own:

    <!-- 08_sequences: cost -->
    ...
    <!-- /08_sequences -->

The first name is the source, a study, a benchmark, ``figure`` or ``age``; the second is the section.
Everything else in a page is written by hand.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import textwrap
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from operator import itemgetter
from os.path import relpath
from pathlib import Path
from typing import Any

from . import fingerprints

Results = dict[str, Any]


def study_parser(doc: str | None) -> argparse.ArgumentParser:
    """Parser of a study's command line: described by the docstring's first line, with the option --quick."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the small version; nothing is saved")
    return parser


def study_main(
    doc: str | None, run: Callable[[bool], Results], show: Callable[[Results], None], path: Path
) -> None:
    """Run a study without further options, print its tables and save the results."""
    quick = study_parser(doc).parse_args().quick
    results = run(quick)
    show(results)
    if not quick:
        save_results(path, results)


def save_results(path: Path, results: Results) -> None:
    """Write the results; those of a study with the fingerprint of the code that computed its oldest case.

    Raises ``ValueError`` for NaN or infinity, which JSON lacks.
    """
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(results, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if fingerprints.is_of_study(path):
        fingerprints.record(path, results)


def saved_results(path: Path) -> Results:
    """The saved results, a study's rows with their fingerprints; empty if there are none."""
    results: Results = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return fingerprints.with_recorded(results, path)


def with_saved(
    results: Results,
    path: Path,
    order: Sequence[Hashable],
    case_of: Callable[[Results], Hashable] = itemgetter("case"),
) -> Results:
    """New results merged with the saved cases that were not computed again.

    Every list in the results holds rows, each of one case; it is merged case by case and put into the given
    order, which drops rows of cases that are not in it. Everything else is taken from the new results.
    """
    saved, place = saved_results(path), {case: i for i, case in enumerate(order)}
    both = dict(results)
    for key, rows in results.items():
        if isinstance(rows, list):
            new = {case_of(row) for row in rows}
            stay = [row for row in saved.get(key, []) if case_of(row) not in new]
            now = [fingerprints.stamped(row, path) for row in rows]
            known = [row for row in (*stay, *now) if case_of(row) in place]
            both[key] = sorted(known, key=lambda row: place[case_of(row)])
    return both


def case_by_case(
    numbers: Iterable[int],
    run_case: Callable[[int], Results],
    as_results: Callable[[list[Results]], Results],
    *,
    minutes: float = math.inf,
    path: Path | None = None,
    say: Callable[[Results], None] = lambda case: print(case, flush=True),
) -> Results:
    """Results of the cases saved at a path and of the missing ones, saved one by one.

    as_results : results from the rows of cases, ordered by number
    minutes : no further case is begun after these
    say : called with each computed case
    """
    known = {c["case"]: c for c in saved_results(path).get("cases", [])} if path else {}
    end = time.monotonic() + 60.0 * minutes

    def found() -> Results:
        return as_results([known[number] for number in sorted(known)])

    for number in numbers:
        if number in known:
            continue
        if time.monotonic() > end:
            break
        known[number] = run_case(number)
        if path:
            known[number] = fingerprints.stamped(known[number], path)
            save_results(path, found())
        say(known[number])
    return found()


def cases_main(
    doc: str | None,
    run: Callable[[bool, float], Results],
    show: Callable[[Results], None],
    path: Path,
    others: Callable[..., Results],
) -> None:
    """Command line of a study of drawn cases, which are saved one by one.

    others : results of other cases for ``--development``, printed and not saved; takes minutes
    """
    parser = study_parser(doc)
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no further case after these")
    parser.add_argument("--development", action="store_true", help="other cases; nothing is saved")
    args = parser.parse_args()
    if args.development:
        show(others(minutes=args.minutes))
        return
    results = run(args.quick, args.minutes)
    show(results)
    if not args.quick:
        save_results(path, results)


FIGURE = "figure"
# Source of the sentence on results from an earlier state of the code.
AGE = "age"
_PROJECT = fingerprints.STUDIES.parent
_SECTION = re.compile(
    r"^<!-- (?P<source>\w+): (?P<name>[^\n]+?) -->\n(?P<text>.*?)^<!-- /(?P=source) -->$",
    re.MULTILINE | re.DOTALL,
)


def pages(project: Path) -> list[Path]:
    """All pages that may contain sections: the README and docs/."""
    return [project / "README.md", *sorted((project / "docs").glob("*.md"))]


def marks(page: str) -> list[tuple[str, str]]:
    """Source and name of each section, in order; raises ``ValueError`` for a mark without its pair."""
    sections = [(section["source"], section["name"]) for section in _SECTION.finditer(page)]
    sources = {source for source, _ in sections}
    lone = [
        line
        for line in re.findall(r"^<!-- /?(\w+)(?:: .*)? -->$", page, re.MULTILINE)
        if line not in sources and (line in (FIGURE, AGE) or line[:1].isdigit())
    ]
    if lone:
        raise ValueError(
            f"marks of {', '.join(lone)} without their pair: write <!-- x: name --> and <!-- /x -->"
        )
    return sections


def with_sections(page: str, source: str, sections: Mapping[str, str]) -> str:
    """A page with the sections of one source rewritten.

    Raises ``ValueError`` for a section that the page contains and the source lacks.
    """

    def text(section: re.Match[str]) -> str:
        if section["source"] != source:
            return section[0]
        name = section["name"]
        if name not in sections:
            known = ", ".join(sections) or "none"
            raise ValueError(f"no section of {source} is named {name!r}; there are {known}")
        content = sections[name].strip("\n")
        between = f"\n\n{content}\n\n" if content else "\n"
        return f"<!-- {source}: {name} -->{between}<!-- /{source} -->"

    return _SECTION.sub(text, page)


def write_sections(project: Path, source: str, sections: Mapping[str, str]) -> list[Path]:
    """Write the sections of one source, and ages of results, into all pages that contain them.

    Returns the pages that changed.
    """
    changed = []
    for path in pages(project):
        before = path.read_text(encoding="utf-8")
        after = with_age(with_sections(before, source, sections))
        if after != before:
            path.write_text(after, encoding="utf-8")
            changed.append(path)
    return changed


def studies_of(page: str) -> set[str]:
    """Studies whose results a page shows, in sections or in figures."""
    asked = marks(page)
    written = {source for source, _ in asked if (fingerprints.STUDIES / f"{source}.py").exists()}
    figures = {name.removeprefix("picture ") for source, name in asked if source == FIGURE}
    return written.union(*(of_figure(path) for path in captions(_PROJECT) if _names(path) & figures))


def outdated(page: str) -> list[str]:
    """Studies whose results in a page come from other sources than today's, or from unknown ones."""
    return sorted(filter(fingerprints.is_outdated, studies_of(page)))


def with_age(page: str) -> str:
    """A page whose mark for it says which of its results an earlier state of the code computed."""
    old = outdated(page)
    new = sorted(studies_of(page).difference(old))
    which = f"results of {_named(old)}"
    if len(old) > len(new) + 1:
        which = f"all results here{f' but those of {_named(new)}' if new else ''}"
    said = paragraph(f"Older than the code: {which}.") if old else ""
    return with_sections(page, AGE, {"studies": said})


def _named(studies: Sequence[str]) -> str:
    return listed([f"`{name}`" for name in studies])


def captions(project: Path) -> list[Path]:
    """Caption files of all drawn figures."""
    return [p for p in sorted((project / "figures").glob("*.md")) if p.with_suffix(".png").exists()]


def of_figure(caption: Path) -> set[str]:
    """The study whose results a figure draws."""
    return set(re.findall(r"`studies/results/(\w+)\.json`", caption.read_text(encoding="utf-8")))


def _names(caption: Path) -> set[str]:
    """Names of a figure's sections in pages: its own, and that of all figures of its script."""
    scripts = re.findall(r"`python figures/draw\.py (\w+)`", caption.read_text(encoding="utf-8"))
    return {caption.stem, *(f"all of {script}" for script in scripts)}


def figure_section(caption: Path, page: Path, *, titled: bool = False) -> str:
    """A figure with its caption as a page shows it, from the caption file beside the figure.

    The alternative text of the picture does not repeat the caption.

    titled : with only the title of the caption
    """
    title, text, *_ = caption.read_text(encoding="utf-8").split("\n\n")
    link = Path(relpath(caption.with_suffix(".png"), page.parent)).as_posix()
    return f"![Figure]({link})\n\n{paragraph(title if titled else f'{title} {text}')}"


def sections_of_figures(project: Path, page: Path) -> dict[str, str]:
    """All figures by name: "picture NAME" with the title alone, and "all of NAME" for those of a script."""
    written: dict[str, str] = {}
    for path in captions(project):
        written[f"picture {path.stem}"] = figure_section(path, page, titled=True)
        for name in _names(path):
            written[name] = f"{written.get(name, '')}\n\n{figure_section(path, page)}".strip()
    return written


def paragraph(text: str, start: str = "") -> str:
    """Text wrapped to lines of a page, the first beginning with ``start`` ("- " for a list item)."""
    return textwrap.fill(
        " ".join(text.split()),
        110,
        initial_indent=start,
        subsequent_indent=" " * len(start),
        break_on_hyphens=False,
        break_long_words=False,
    )


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = ("| " + " | ".join(cells) + " |" for cells in (head, *rows))
    first, *others = lines
    return "\n".join((first, "|" + "---|" * len(head), *others))


def counted(number: float) -> str:
    """A count in few digits: 1296, 46 656, 1.7 million, 844 million, 2.2 billion."""
    for word, unit in (("billion", 1e9), ("million", 1e6)):
        if number >= unit:
            return f"{number / unit:.{0 if number >= 10 * unit else 1}f} {word}"
    return f"{number:.0f}" if number < 1e4 else f"{number:,.0f}".replace(",", " ")


def with_error(value: float, error: float, decimals: int = 3) -> str:
    """A value with its standard error in units of the last digit: 0.970(12)."""
    digits = round(error * 10**decimals)
    return f"{value:.{decimals}f}" + (f"({digits})" if digits else "")


def in_digits(value: float, digits: int = 2) -> str:
    """A value with this many digits and a short exponent: 2.3e-5, 1.1e4."""
    return re.sub(r"e([+-])0*", lambda sign: "e" + sign[1].strip("+"), f"{value:.{digits}g}")


def angles(angles_deg: Iterable[float]) -> str:
    """Short form of a stacking sequence: 0/90/45."""
    return "/".join(f"{angle:g}" for angle in angles_deg)


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: a, b and c."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))
