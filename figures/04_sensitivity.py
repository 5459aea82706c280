"""Noise on a list of frequencies: repeated inversions, posteriors and the paper's Tables 10 to 14."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from cpam_bayes.report.repetition.figures import draw_constant, legend_entries

HERE = Path(__file__).parent
STUDY = Path(__file__).stem
TITLES = {
    "model": "Noise on the list that the plate model gives at the reference constants",
    "measured": "Noise on the measured list, as in the paper, against the inversion without noise",
}
NAMES = {"model": STUDY, "measured": f"{STUDY}_measured"}
STYLE = {"font.size": 8.0, "axes.titlesize": 8.5, "legend.fontsize": 8.0, "axes.axisbelow": True}


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw the study's results, read from one folder, into another."""
    data = json.loads((results / f"{STUDY}.json").read_text(encoding="utf-8"))
    return [_draw(data[source], TITLES[source], folder / f"{NAMES[source]}.png") for source in TITLES]


def _draw(documents: list[dict[str, Any]], title: str, path: Path) -> Path:
    columns = max(len(d["without_noise"]["constants"]) for d in documents)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            len(documents),
            columns,
            figsize=(2.5 * columns + 0.5, 2.1 * len(documents) + 1.1),
            layout="constrained",
            squeeze=False,
        )
        for row, document in zip(axes, documents, strict=True):
            names = list(document["without_noise"]["constants"])
            for ax, name in zip(row, names, strict=False):
                draw_constant(ax, document, name)
                ax.grid(True, axis="y", color="#e4e4e4", linewidth=0.6)
            for ax in row[len(names) :]:
                ax.set_axis_off()
            row[0].set_ylabel("difference, %")
        for ax in axes.ravel():
            if ax.axison:
                ax.set_xlabel("noise, %", labelpad=1)
        figure.suptitle(title, fontsize=10)
        handles = legend_entries(list(documents[0]["levels"][0]["readings"]))
        figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
        figure.savefig(path, dpi=110, metadata={"Software": None})
        plt.close(figure)
    return path


if __name__ == "__main__":
    for path in draw(HERE.parent / "studies" / "results", HERE):
        print(path.relative_to(HERE.parent))
