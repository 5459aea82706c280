"""Shared tools of all figures: sizes and style of a journal, captions, and writing of both.

A script makes its figures in ``pictures(results)`` and wraps that function in a ``Drawing``, which reads the
results of one study, writes each figure with its caption file, and answers the command line.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

FIGURES = Path(__file__).parent
RESULTS = FIGURES.parent / "studies" / "results"

# Widths of one and of two columns of a journal, and the smallest letters legible in print.
SINGLE_MM, DOUBLE_MM = 90.0, 190.0
LEAST_POINTS = 7.0
TALLEST_MM = 232.0
KINDS = ("png", "pdf", "svg")
DPI = 180

# Okabe and Ito's colours, which the colour-blind can tell apart; greys for the background.
BLUE, ORANGE, GREEN, SKY = "#0072B2", "#D55E00", "#009E73", "#56B4E9"
AMBER, PURPLE, YELLOW, BLACK = "#E69F00", "#CC79A7", "#F0E442", "#000000"
DARK, GREY, LIGHT, BAND = "#333333", "#777777", "#BBBBBB", "#E4E4E4"

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.titlesize": 8.0,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.title_fontsize": 7.0,
    "figure.titlesize": 8.5,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "grid.color": "#E0E0E0",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.0,
    "pdf.fonttype": 42,
    "figure.constrained_layout.use": True,
}
SYMBOLS = {
    "E1": "$E_1$",
    "E2": "$E_2$",
    "nu12": r"$\nu_{12}$",
    "G12": "$G_{12}$",
    "G23": "$G_{23}$",
    "relative_std": "noise",
}


@dataclass(frozen=True)
class Picture:
    """A figure and the two parts of its caption.

    Parameters
    ----------
    name : str
        File name without its ending.
    figure : Figure
        One or two columns wide.
    title : str
        Title in one sentence.
    text : str
        Description of the drawing and of what to see in it; its numbers are taken from the results.
    """

    name: str
    figure: Figure
    title: str
    text: str


@dataclass(frozen=True)
class Drawing:
    """The figures of one script.

    Parameters
    ----------
    script : str
        The script's ``__file__``.
    study : str
        Name of the study whose results are drawn.
    seeds : str
        The seeds of the study in words.
    pictures : callable
        From the study's results to the figures.
    """

    script: str
    study: str
    seeds: str
    pictures: Callable[[dict[str, Any]], list[Picture]]

    def __call__(self, results: Path = RESULTS, folder: Path = FIGURES, kind: str = "png") -> list[Path]:
        """Draw each figure from the results in one folder and write it with its caption into another.

        The same results give the same bytes. Returns the figures' paths; raises ``FileNotFoundError`` if
        there are no results.
        """
        return self.write(self.drawn(results), results, folder, kind)

    def drawn(self, results: Path = RESULTS) -> list[Picture]:
        """The figures, drawn but not written."""
        with _style():
            return self.pictures(json.loads(self._content(results)))

    def write(self, drawn: Sequence[Picture], results: Path, folder: Path, kind: str = "png") -> list[Path]:
        """Write figures drawn from the results in one folder, and their captions, into another."""
        content, written = self._content(results), []
        with _style():
            for picture in drawn:
                path = folder / f"{picture.name}.{kind}"
                _save(picture.figure, path, kind, hashlib.sha256(content).hexdigest())
                path.with_suffix(".md").write_text(self._caption(picture, content), encoding="utf-8")
                written.append(path)
        return written

    def _content(self, results: Path) -> bytes:
        return (results / f"{self.study}.json").read_bytes()

    def main(self, arguments: Sequence[str] | None = None) -> None:
        """Run the command line of the script."""
        run([self], arguments, f"Draw the figures of studies/results/{self.study}.json, with captions.")

    def _caption(self, picture: Picture, content: bytes) -> str:
        stated = re.search(rb'"version": "([^"]+)"', content)
        computed = f" of cpam_bayes {stated[1].decode()}" if stated else ""
        source = (
            f"Data: `studies/results/{self.study}.json`{computed}, SHA-256 "
            f"{hashlib.sha256(content).hexdigest()[:16]}, written by `python studies/{self.study}.py`; "
            f"{self.seeds}. Figure: `python figures/draw.py "
            f"{Path(self.script).stem}`."
        )
        parts = (f"**{picture.title}**", picture.text, source)
        return "\n\n".join(map(_wrapped, parts)) + "\n"


def run(drawings: Sequence[Drawing], arguments: Sequence[str] | None, description: str) -> None:
    """Draw, with the folders and the format given on the command line."""
    parser = argparse.ArgumentParser(description=description)
    add_options(parser)
    draw_all(drawings, parser.parse_args(arguments))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that all figure commands share."""
    parser.add_argument("--out", type=Path, default=FIGURES, metavar="DIR", help="write here (figures/)")
    parser.add_argument("--results", type=Path, default=RESULTS, metavar="DIR", help="read JSON from here")
    parser.add_argument("--format", choices=KINDS, default="png", help="file format (png)")


def draw_all(drawings: Sequence[Drawing], options: argparse.Namespace) -> None:
    """Draw several scripts' figures and print their paths."""
    options.out.mkdir(parents=True, exist_ok=True)
    for drawing in drawings:
        for path in drawing(options.results, options.out, options.format):
            print(path)


def figure(width_mm: float, height_mm: float) -> Figure:
    """An empty figure of this size."""
    new = Figure(figsize=(width_mm / 25.4, height_mm / 25.4), dpi=DPI, layout="constrained")
    FigureCanvasAgg(new)
    return new


def stacked(
    axes: Axes, rows: Mapping[str, Mapping[str, int]], colours: Mapping[str, str], of: str, **bars: Any
) -> None:
    """Draw the share of each category in percent, one stacked bar per row.

    rows : name -> category -> count. of : what is counted. bars : passed to ``Axes.barh``.
    """
    names, base = list(rows), [0.0] * len(rows)
    for category, colour in colours.items():
        percent = [100.0 * rows[n][category] / max(sum(rows[n][c] for c in colours), 1) for n in names]
        axes.barh(range(len(names)), percent, 0.75, left=base, color=colour, label=category, **bars)
        base = [b + s for b, s in zip(base, percent, strict=True)]
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set(xlim=(0.0, 100.0), xlabel=f"fraction of the {of}, %")
    bare(axes)


def bare(axes: Axes) -> None:
    """Remove the line and ticks at the left, for rows with names."""
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)


def subscripts(layup: str) -> str:
    """A layup in mathtext, with subscripts, as for [(0/90)_8]_s."""
    return re.sub(r"_(\w+)", r"$_{\1}$", layup)


def symbol(name: str) -> str:
    """Mathtext symbol of a constant, from its name with or without its unit."""
    return SYMBOLS.get(name.removesuffix("_GPa"), name)


def counted(number: float) -> str:
    """A whole number with thin spaces between thousands."""
    return f"{round(number):,}".replace(",", "\N{THIN SPACE}")


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: a, b and c."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def claimed(answer: Mapping[str, Any]) -> str:
    """The causes of a claim, or the claim where it has none."""
    return (" and " if answer["claim"] == "pair" else " or ").join(answer["causes"]) or str(answer["claim"])


def _wrapped(text: str) -> str:
    """Text wrapped to lines of at most 110 characters, with code left whole."""
    whole = re.sub(r"`[^`]*`", lambda code: code[0].replace(" ", "\0"), text)
    return textwrap.fill(whole, 110, break_on_hyphens=False, break_long_words=False).replace("\0", " ")


def _style() -> Any:
    known = {key: value for key, value in mpl.rcParamsDefault.items() if not key.startswith("backend")}
    return mpl.rc_context({**known, **STYLE})


def _save(drawn: Figure, path: Path, kind: str, source: str) -> None:
    # No date, and a fixed salt for the names of SVG elements: the same results give the same bytes.
    metadata = {
        "png": {"Software": None, "Source": source},
        "pdf": {"CreationDate": None, "Subject": source},
        "svg": {"Date": None, "Source": source},
    }[kind]
    with mpl.rc_context({"svg.hashsalt": path.stem}):
        smaller: dict[str, Any] = {"pil_kwargs": {"optimize": True}} if kind == "png" else {}
        drawn.savefig(path, dpi=DPI, metadata=metadata, **smaller)
