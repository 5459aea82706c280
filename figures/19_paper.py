"""The paper's tables beside computed values: differences by table, frequencies of Table 5, misfits.

python figures/19_paper.py
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 110
COLOURS = {"agrees": "#4878a8", "within the posterior": "#8a8a8a", "not reproducible": "#c1440e"}
# Beyond this a printed frequency lacks a digit.
MISPRINTED_PERCENT = 50.0


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw all three from the study's results."""
    document = json.loads((results / "19_paper.json").read_text(encoding="utf-8"))["paper"]
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    top, bottom = figure.subfigures(2, 1)
    rows = [row for row in document["rows"] if row["difference_percent"] is not None]
    _differences(top.subplots(), rows)
    left, right = bottom.subplots(1, 2)
    _frequencies(left, [row for row in rows if row["table"] == 5])
    _misfits(right, [m for m in document["audit"]["misfits"] if m["source"].startswith("CPAM")])
    path = folder / "19_paper.png"
    figure.savefig(path, dpi=DPI)
    return [path]


def _differences(axes: Any, rows: list[dict[str, Any]]) -> None:
    tables = sorted({row["table"] for row in rows})
    for kind, colour in COLOURS.items():
        of_kind = [row for row in rows if row["verdict"].partition(":")[0] == kind]
        # spread about the table's place, so that rows do not hide each other
        places = [tables.index(row["table"]) + 0.35 * np.sin(7.0 * i) for i, row in enumerate(of_kind)]
        values = [row["difference_percent"] for row in of_kind]
        axes.plot(places, values, "o", ms=3, alpha=0.7, color=colour, label=kind)
    axes.set_yscale("symlog", linthresh=1.0)
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(range(len(tables)), [str(table) for table in tables])
    axes.set_xlabel("table of the paper")
    axes.set_ylabel("printed over computed, less one, %")
    axes.legend(fontsize="small", frameon=False, ncols=3)


def _frequencies(axes: Any, rows: list[dict[str, Any]]) -> None:
    plates = list(dict.fromkeys(row["specimen"] for row in rows))
    for i, plate in enumerate(plates):
        off = [row["difference_percent"] for row in rows if row["specimen"] == plate]
        for k, value in enumerate(off):
            if abs(value) < MISPRINTED_PERCENT:
                place = i + 0.8 * (k + 0.5) / len(off) - 0.4
                axes.bar(place, value, 0.7 / len(off), color="#4878a8" if i % 2 else "#c1440e")
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.set_xticks(range(len(plates)), plates)
    axes.set_xlabel("plate, its modes from the left")
    axes.set_ylabel("ABAQUS of Table 5 over converged, less one, %")


def _misfits(axes: Any, misfits: list[dict[str, Any]]) -> None:
    places = np.arange(len(misfits))
    axes.bar(
        places - 0.2, [m["rms_percent"] for m in misfits], 0.38, color="#c1440e", label="printed constants"
    )
    axes.bar(
        places + 0.2, [m["our_rms_percent"] for m in misfits], 0.38, color="#4878a8", label="least F found"
    )
    names = [
        m["specimen"] if m["table"] == 9 else f"{m['specimen']}\n{m['case'].split()[0]}" for m in misfits
    ]
    axes.set_yscale("log")
    axes.set_xticks(places, names, fontsize="x-small")
    axes.set_xlabel("specimen; constants unknown of the aluminium plates")
    axes.set_ylabel("rms misfit of the frequencies, %")
    axes.legend(fontsize="small", frameon=False)


if __name__ == "__main__":
    for drawn in draw():
        print(drawn)
