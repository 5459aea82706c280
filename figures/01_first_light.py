"""The thin plates identified and the error of the plate model; and identify_C1.png for the README.

python figures/01_first_light.py
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

HERE = Path(__file__).parent
RESULTS = HERE.parent / "studies" / "results"

DPI = 150
MEASURED, PREDICTED = "#333333", "#c1440e"
VERDICTS = {
    "determined by the data": "#2c7a51",
    "determined by data and prior": "#c98a1b",
    "determined by the prior": "#8a8a8a",
}
OPEN = VERDICTS["determined by the prior"]
SYMBOLS = {"E1_GPa": "$E_1$", "E2_GPa": "$E_2$", "nu12": r"$\nu_{12}$", "G12_GPa": "$G_{12}$"}
# Residuals beyond are drawn at the edge with their number.
WIDEST = 6.0


def draw(results: Path = RESULTS, folder: Path = HERE) -> list[Path]:
    """Draw both pictures from the study's results in one folder into another."""
    found = json.loads((results / "01_first_light.json").read_text(encoding="utf-8"))
    written = [_save(_overview(found), folder / "01_first_light.png")]
    written += [
        _save(_identification(plate), folder / "identify_C1.png")
        for plate in found["identifications"]
        if plate["plate"] == "C1"
    ]
    return written


def _save(figure: Figure, path: Path) -> Path:
    FigureCanvasAgg(figure)
    figure.savefig(path, dpi=DPI)
    return path


# One plate, for the README


def _identification(found: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(11.0, 4.5), layout="constrained")
    figure.suptitle(
        f"Specimen {found['plate']}, layup {_subscripts(found['layup'])}, edges {found['edges']}: "
        f"{len(found['constants'])} constants from {len(found['frequencies'])} frequencies",
        fontsize=13,
    )
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.15, 0.75, 1.0))
    _frequencies(left, found)
    _residuals(middle, found)
    _constants(right, found["constants"])
    return figure


def _subscripts(layup: str) -> str:
    return re.sub(r"_(\w+)", r"$_{\1}$", layup)


def _frequencies(axes: Axes, found: Mapping[str, Any]) -> None:
    modes = found["frequencies"]
    rows = range(len(modes))
    measured, predicted = ([m[key] for m in modes] for key in ("measured_hz", "predicted_hz"))
    axes.hlines(rows, 0, measured, color="0.9", linewidth=1)
    axes.plot(measured, rows, "o", ms=11, mfc="none", mec=MEASURED, mew=1.6, label="measured")
    axes.plot(predicted, rows, "o", ms=5.5, color=PREDICTED, label="predicted")
    for row, f in zip(rows, measured, strict=True):
        # towards the side where there is room
        place, side = ((12, 0), "left") if f < 0.8 * max(measured) else ((-12, 0), "right")
        axes.annotate(
            f"{f:g} Hz",
            (f, row),
            place,
            textcoords="offset points",
            ha=side,
            va="center",
            color=MEASURED,
            bbox={"color": "white", "pad": 1},
        )
    axes.set_yticks(rows, [f"{i}  {m['label']}" for i, m in enumerate(modes, 1)])
    axes.set(xlim=(0, 1.1 * max(measured)), ylim=(len(modes) - 0.5, -0.5), xlabel="frequency, Hz")
    axes.set_title("Frequencies of the modes")
    axes.legend(loc="lower left", fontsize=10)
    _clean(axes)


def _residuals(axes: Axes, found: Mapping[str, Any]) -> None:
    residuals = [m["residual_percent"] for m in found["frequencies"]]
    rows = range(len(residuals))
    axes.axvspan(-found["noise_percent"], found["noise_percent"], color="0.93")
    axes.barh(rows, residuals, 0.5, color=PREDICTED)
    for row, r in zip(rows, residuals, strict=True):
        place, side = ((4, 0), "left") if r > 0 else ((-4, 0), "right")
        text = f"{r:+.1f} %"
        axes.annotate(text, (r, row), place, textcoords="offset points", ha=side, va="center")
    widest = 1.7 * max(map(abs, residuals))
    axes.axvline(0, color=MEASURED, linewidth=1)
    axes.set(xlim=(-widest, widest), ylim=(len(residuals) - 0.5, -0.5))
    noise = f"grey: sd of the noise, {found['noise_percent']:.1f} %"
    axes.set_xlabel(f"predicted / measured - 1, %\n{noise}")
    axes.set_title(f"Residuals, rms {found['rms_percent']:.1f} %")
    axes.set_yticks(rows, [""] * len(residuals))
    _clean(axes)


def _constants(axes: Axes, constants: Mapping[str, Mapping[str, Any]]) -> None:
    widest = 110.0
    for row, (name, c) in enumerate(constants.items()):
        color, sure = _colour(c), c["agrees"] is not None
        own = 100.0 * c["reference_sd"] / c["reference"]
        axes.barh(row, 2 * own, 0.42, left=-own, color="0.9")
        if c["bound"] is None and c["sd"] is not None:
            sd = 100.0 * c["sd"] / c["reference"]
            axes.errorbar(c["percent"], row, xerr=sd, color=color, capsize=5, linewidth=2)
        axes.plot(c["percent"], row, "o", ms=9, color=color, mfc=color if sure else "white", mew=2)
        axes.text(
            1.04, row, _estimate(name, c), transform=axes.get_yaxis_transform(), va="center", color=color
        )
    axes.axvline(0, color=MEASURED, linewidth=1)
    axes.set_yticks(range(len(constants)), [SYMBOLS[name] for name in constants], fontsize=13)
    axes.set(xlim=(-widest, widest), ylim=(len(constants) - 0.5, -0.5))
    axes.set_xlabel("identified / reference - 1, %\ngrey: sd of the reference")
    axes.set_title("Constants, with sd")
    _clean(axes)


def _colour(constant: Mapping[str, Any]) -> str:
    if constant["bound"] is not None:
        return OPEN
    return VERDICTS[constant["verdict"]]


def _estimate(name: str, constant: Mapping[str, Any]) -> str:
    value, sd, unit = constant["value"], constant["sd"], " GPa" if name.endswith("GPa") else ""
    if constant["bound"] is not None:
        return f"{value:.2g}{unit}\nat its {constant['bound']} bound"
    if sd is None:
        return f"{value:.3g}{unit}\nsd not known"
    decimals = 0 if sd >= 10 else 1 if sd >= 1 else 2
    return f"{value:.{decimals}f} ± {sd:.{decimals}f}{unit}\n{constant['verdict']}"


# All plates


def _overview(found: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(11.0, 9.0), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.7, 1.0), hspace=0.03)
    constants, residuals = above.subplots(1, 2, width_ratios=(1.2, 1.0))
    _all_constants(constants, found["identifications"])
    _all_residuals(residuals, found["identifications"])
    _forward(below.subplots(), found["forward_errors"])
    return figure


def _all_constants(axes: Axes, plates: list[dict[str, Any]]) -> None:
    rows = [(f["plate"], name, c) for f in plates for name, c in f["constants"].items()]
    for row, (_, _, c) in enumerate(rows):
        color, sure = _colour(c), c["agrees"] is not None
        ratio = c["value"] / c["reference"]
        if c["bound"] is None and c["sd"] is not None:
            low, high = ((c["value"] + s * c["sd"]) / c["reference"] for s in (-1, 1))
            axes.plot([max(low, 0.05), high], [row, row], color=color, linewidth=1.5)
        axes.plot(ratio, row, "o", ms=5, color=color, mfc=color if sure else "white")
    axes.axvline(1.0, color=MEASURED, linewidth=0.8)
    _part(axes, [plate for plate, _, _ in rows])
    axes.set_yticks(range(len(rows)), [f"{plate}  {SYMBOLS[name]}" for plate, name, _ in rows], fontsize=8)
    axes.set_xscale("log")
    axes.set(xlim=(0.2, 10), ylim=(len(rows) - 0.5, -0.5), xlabel="identified / reference")
    axes.set_xticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
    axes.set_xticks([], minor=True)
    axes.set_title("Constants, with sd")
    axes.legend(
        handles=[
            Line2D(
                [],
                [],
                marker="o",
                ls="",
                color=colour,
                mfc="white" if colour == OPEN else colour,
                label=verdict + (" or at a bound" if colour == OPEN else ""),
            )
            for verdict, colour in VERDICTS.items()
        ],
        loc="lower left",
        fontsize=8,
        framealpha=1.0,
    )
    _clean(axes)


def _part(axes: Axes, owners: list[str]) -> None:
    """Shade every other plate, so that its rows are seen to belong together."""
    for i, owner in enumerate(dict.fromkeys(owners)):
        first, last = owners.index(owner), len(owners) - 1 - owners[::-1].index(owner)
        if i % 2:
            axes.axhspan(first - 0.5, last + 0.5, color="0.96", zorder=0)


def _all_residuals(axes: Axes, plates: list[dict[str, Any]]) -> None:
    for row, f in enumerate(plates):
        for i, mode in enumerate(f["frequencies"], 1):
            r = mode["residual_percent"]
            x = min(max(r, -WIDEST), WIDEST)
            y = row + 0.09 * (i - (len(f["frequencies"]) + 1) / 2)
            axes.plot([0, x], [y, y], color=PREDICTED, linewidth=2.5, solid_capstyle="butt")
            if x != r:
                place = (-4, 0) if r > 0 else (4, 0)
                side = "right" if r > 0 else "left"
                axes.annotate(
                    f"{r:+.0f}",
                    (x, y),
                    place,
                    textcoords="offset points",
                    ha=side,
                    va="center",
                    fontsize=7,
                    bbox={"color": "white", "pad": 0.5},
                )
        axes.text(
            1.03,
            row,
            f"rms {f['rms_percent']:.1f} %\n{f['forward_solves']} solves\n{f['seconds']:.1f} s",
            transform=axes.get_yaxis_transform(),
            va="center",
            fontsize=8,
        )
    _part(axes, [f["plate"] for f in plates])
    axes.axvline(0, color=MEASURED, linewidth=0.8)
    axes.set_yticks(range(len(plates)), [f["plate"] for f in plates])
    axes.set(xlim=(-WIDEST, WIDEST), ylim=(len(plates) - 0.5, -0.5))
    axes.set_xlabel("predicted / measured - 1, %")
    axes.set_title("Residuals, first mode on top")
    _clean(axes)


def _forward(axes: Axes, errors: list[dict[str, Any]]) -> None:
    rows = range(len(errors))
    least = 1e-4
    axes.plot(
        [max(abs(e["worst_percent"]), least) for e in errors],
        rows,
        "o",
        ms=6,
        color=PREDICTED,
        label="worst mode against the reference",
    )
    axes.plot(
        [e["estimate_percent"] for e in errors],
        rows,
        "|",
        ms=13,
        mew=2,
        color=MEASURED,
        label="estimated by the solver",
    )
    axes.plot(
        [e["allowed_percent"] for e in errors], rows, "|", ms=13, mew=1.5, color="#4878a8", label="allowed"
    )
    axes.set_yticks(rows, [f"{e['case']}: {_short(e['source'])}" for e in errors], fontsize=8)
    axes.set_xscale("log")
    axes.set(ylim=(len(errors) - 0.5, -0.5), xlabel="error of a frequency, %")
    axes.set_title("Plate model against references")
    axes.grid(axis="x", color="0.92")
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8, frameon=False, labelspacing=1.2)
    _clean(axes)


def _short(source: str) -> str:
    return "two other bases" if source.startswith("converged") else source.split(",")[0]


def _clean(axes: Axes) -> None:
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)


if __name__ == "__main__":
    for _path in draw():
        print(_path.name)
