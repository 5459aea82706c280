"""Saving figures, as PNG and SVG, and the colours that they share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

__all__ = ["MEASURED", "PREDICTED", "save_figures"]

_DPI = 150
MEASURED, PREDICTED = "#333333", "#c1440e"


def save_figures(figures: Mapping[str, Figure], directory: Path) -> None:
    """Write each figure as NAME.png and NAME.svg; the same figure gives the same bytes."""
    for name, figure in figures.items():
        FigureCanvasAgg(figure)
        figure.savefig(directory / f"{name}.png", dpi=_DPI)
        # One salt for two figures would give them the same element names on one page.
        with mpl.rc_context({"svg.hashsalt": name}):
            figure.savefig(directory / f"{name}.svg", metadata={"Date": None})
