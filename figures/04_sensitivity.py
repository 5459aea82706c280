"""Noise on a list of frequencies: repeated inversions, posteriors and the paper's Tables 10 to 14.

python figures/04_sensitivity.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import DOUBLE_MM, Drawing, Picture, figure, listed
from matplotlib.figure import Figure

from cpam_bayes.render.noise_study import draw_constant, legend_entries

STUDY = "04_sensitivity"
NAMES = {"model": STUDY, "measured": f"{STUDY}_measured"}
TITLES = {
    "model": "Noise on the frequencies that the plate model gives at the reference constants",
    "measured": "Noise on the measured frequencies, as in the paper",
}


def pictures(data: dict[str, Any]) -> list[Picture]:
    return [_picture(data[source], source) for source in TITLES]


def _picture(documents: list[dict[str, Any]], source: str) -> Picture:
    compared = [
        constant
        for d in documents
        for level in d["levels"]
        for interpretation in level["readings"].values()
        for constant in interpretation["constants"].values()
    ]
    readings = len(documents[0]["levels"][0]["readings"])
    beside = " The two interpretations of eq. (12) stand side by side." if readings > 1 else ""
    inversions = max(len(c["repetitions"]) for c in compared)
    agreeing = sum(c["means_agree"] and c["sds_agree"] for c in compared)
    return Picture(
        NAMES[source],
        _grid(documents, TITLES[source]),
        f"{TITLES[source]}: repeated inversions, posteriors and the printed means of ten.",
        f"Every constant of {listed([d['plate'] for d in documents])} at each level of noise, as difference "
        f"from the inversion without noise. Circles: mean of {inversions} inversions of perturbed "
        "frequencies, with their standard deviation and, thick, the standard error of the mean. Squares: "
        "mean and standard deviation of the posterior at that noise. Crosses: Tables 10 to 14 as "
        f"printed.{beside} Means and standard deviations of repetition and posterior both "
        f"agree in {agreeing} of {len(compared)} comparisons.",
    )


def _grid(documents: list[dict[str, Any]], title: str) -> Figure:
    columns = max(len(d["without_noise"]["constants"]) for d in documents)
    new = figure(DOUBLE_MM, 25 + 41 * len(documents))
    axes = new.subplots(len(documents), columns, squeeze=False)
    for row, document in zip(axes, documents, strict=True):
        names = list(document["without_noise"]["constants"])
        for ax, name in zip(row, names, strict=False):
            draw_constant(ax, document, name)
            ax.grid(True, axis="y")
            ax.set_xlabel("noise, %", labelpad=1)
        for ax in row[len(names) :]:
            ax.set_axis_off()
        row[0].set_ylabel("difference, %")
    new.suptitle(title)
    handles = legend_entries(list(documents[0]["levels"][0]["readings"]))
    new.legend(handles=handles, loc="outside lower center", ncols=2)
    return new


draw = Drawing(__file__, STUDY, "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
