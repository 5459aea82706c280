"""The pairing of measured shapes with modes of the model: as a section, in a document, drawn."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.labels import ShapePairing
from cpam_bayes.plate import Measurement
from cpam_bayes.render.figures import PREDICTED, new_figure
from cpam_bayes.render.report import Caption, Column, Drawing, Rows, Section, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FIGURE", "assurance_drawings", "assurance_sections", "shape_keys"]

FIGURE = "modal_assurance"


def assurance_sections(pairing: ShapePairing | None, measurement: Measurement | None) -> tuple[Section, ...]:
    """The mode of each measured shape, no section without shapes."""
    if pairing is None or measurement is None:
        return ()
    return (Section("Measured shapes", (_table(pairing, measurement),), (FIGURE,)),)


def _table(pairing: ShapePairing, measurement: Measurement) -> Table:
    rows = tuple(
        (float(f), pairing.candidates[j] if j >= 0 else None, int(j), mac, p)
        for f, j, mac, p in zip(
            measurement.frequencies, pairing.modes, pairing.assurance, pairing.probability, strict=True
        )
    )
    return Rows("shapes", _ROWS, rows).table("Modal assurance at the reference constants")


_ROWS = (
    Column("measured Hz", value=lambda r: r[0], text=lambda f: f"{f:.10g}", number=True),
    Column("mode", value=lambda r: "none" if r[1] is None else r[1].label),
    Column(
        "model Hz", value=lambda r: r[1] and r[1].frequency, text=lambda f: significant(f, 5), number=True
    ),
    Column("MAC", value=lambda r: r[1] and r[3][r[2]], text=lambda v: f"{v:.3f}", number=True),
    Column(
        "next MAC",
        value=lambda r: (np.delete(r[3], r[2]) if r[1] else r[3]).max(initial=0.0),
        text=lambda v: f"{v:.3f}",
        number=True,
    ),
    Column(
        "probability",
        value=lambda r: r[1] and float(r[4][r[2]]),
        text=lambda v: significant(v, 3),
        number=True,
    ),
)


def shape_keys(pairing: ShapePairing | None, measurement: Measurement | None) -> dict[str, Any]:
    """The pairing in a JSON document, nothing without shapes."""
    if pairing is None or measurement is None:
        return {}
    rows = zip(measurement.frequencies, pairing.modes, pairing.probability, strict=True)
    return {
        "modal_assurance": pairing.assurance.tolist(),
        "shapes": [
            {
                "measured_hz": float(f),
                "mode": None if j < 0 else int(j) + 1,
                "label": None if j < 0 else pairing.candidates[j].label,
                "probability": None if j < 0 else float(p[j]),
            }
            for f, j, p in rows
        ],
    }


# Numbers are written in the squares of matrices up to this size; candidates are marked from this probability.
_MOST_WRITTEN, _MARKED = 20, 0.01


def assurance_drawings(
    title: str, pairing: ShapePairing | None, measurement: Measurement | None
) -> tuple[Drawing, ...]:
    """Measured shapes against modes, none without shapes."""
    if pairing is None or measurement is None:
        return ()
    n, k = pairing.assurance.shape
    paired = int(np.sum(pairing.modes >= 0))
    caption = Caption(
        "Each row is a measured shape, each column a mode of the model at the reference constants; dark is "
        "like, 1 is the same shape. A red ring marks the mode that a frequency is taken for, a grey one a "
        "mode that it may be as well. Two dark squares in a row: the nodes do not tell these modes apart, or "
        "the constants differ so much from the reference that the modes have mixed.",
        f"Modal assurance of {n} measured shapes with {k} modes; {paired} are paired.",
    )
    return (Drawing(FIGURE, partial(_matrix, title, pairing, measurement), caption),)


def _matrix(title: str, pairing: ShapePairing, measurement: Measurement) -> Figure:
    n, k = pairing.assurance.shape
    figure = new_figure(1.9 + 0.42 * k, 1.5 + 0.36 * n)
    axes = figure.add_subplot()
    image = axes.imshow(pairing.assurance, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    figure.colorbar(image, ax=axes, label="modal assurance")
    axes.set_xticks(
        range(k), [f"{m.label} {m.frequency:.4g}" for m in pairing.candidates], rotation=90, fontsize=8
    )
    axes.set_yticks(range(n), [f"{f:.5g}" for f in measurement.frequencies], fontsize=8)
    axes.set(xlabel="mode of the model, Hz", ylabel="measured, Hz")
    axes.set_title(f"{title}: measured shapes and the model's", fontsize=10, loc="left")
    if max(n, k) <= _MOST_WRITTEN:
        for (i, j), value in np.ndenumerate(pairing.assurance):
            if value >= 0.05:
                color = "white" if value > 0.6 else "0.2"
                axes.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=8, color=color)
    for i, j in np.argwhere(pairing.probability >= _MARKED):
        colour = PREDICTED if pairing.modes[i] == j else "0.45"
        axes.plot(j, i, "o", markersize=19, markerfacecolor="none", markeredgecolor=colour)
    return figure
