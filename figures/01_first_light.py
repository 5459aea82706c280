"""Identification of the thin plates and error of the plate model; and identify_C1.png for the README.

python figures/01_first_light.py [--help]
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from journal import (
    AMBER,
    BAND,
    BLUE,
    DARK,
    DOUBLE_MM,
    GREEN,
    GREY,
    ORANGE,
    Drawing,
    Picture,
    bare,
    figure,
    listed,
    subscripts,
    symbol,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

MEASURED, PREDICTED = DARK, ORANGE
VERDICTS = {
    "determined by the data": GREEN,
    "determined by data and prior": AMBER,
    "determined by the prior": GREY,
}
# As the command says it.
SAID = {
    "determined by the data": "determined",
    "determined by data and prior": "partly",
    "determined by the prior": "not determined",
}
OPEN = VERDICTS["determined by the prior"]
# Residuals beyond this are drawn at the edge, with their value.
WIDEST = 6.0
# References below the range of the axis.
SMALLEST_PERCENT = 1e-4


def pictures(found: dict[str, Any]) -> list[Picture]:
    plates, errors = found["identifications"], found["forward_errors"]
    by_data = sum(_verdict(c) == "determined by the data" for f in plates for c in f["constants"].values())
    all_constants = sum(len(f["constants"]) for f in plates)
    failed = [e["case"] for e in errors if not e["passes"]]
    drawn = [
        Picture(
            "01_first_light",
            _overview(found),
            "Thin plates of the paper, identified by the particle swarm, and the error of the plate model.",
            f"Above left: identified over reference constants of {listed([f['plate'] for f in plates])}, "
            "with one standard deviation, linearised; hollow: the frequencies do not determine the "
            f"constant, or it ended on a bound. The data determine {by_data} of {all_constants}. Above "
            f"right: residual of each mode, first mode on top; beyond {WIDEST:g} % drawn at the edge with "
            "its number. Below: largest error of a frequency against closed forms, published values and "
            "other bases, beside the error that the solver states and the one allowed. "
            + (f"Beyond the allowed error: {listed(failed)}." if failed else "All are within it."),
        )
    ]
    drawn += [_identified(plate) for plate in plates if plate["plate"] == "C1"]
    return drawn


def _verdict(constant: Mapping[str, Any]) -> str:
    return "determined by the prior" if constant["bound"] is not None else str(constant["verdict"])


# One plate, for the README


def _identified(plate: Mapping[str, Any]) -> Picture:
    open_ones = [n for n, c in plate["constants"].items() if _verdict(c) != "determined by the data"]
    not_known = (
        f" The frequencies alone do not determine {listed([n.removesuffix('_GPa') for n in open_ones])}."
        if open_ones
        else ""
    )
    return Picture(
        f"identify_{plate['plate']}",
        _identification(plate),
        f"Specimen {plate['plate']}: frequencies, residuals and identified constants.",
        "Left: measured frequencies of the modes and those that the identified model predicts. Middle: "
        f"residuals, rms {plate['rms_percent']:.1f} %; grey: one standard deviation of the noise, "
        f"{plate['noise_percent']:.1f} %. Right: identified over reference constants with one standard "
        "deviation; grey: standard deviation of the reference; hollow: not determined by the "
        f"data.{not_known}",
    )


def _identification(found: Mapping[str, Any]) -> Figure:
    new = figure(DOUBLE_MM, 78)
    new.suptitle(
        f"Specimen {found['plate']}, layup {subscripts(found['layup'])}, edges {found['edges']}: "
        f"{len(found['constants'])} constants from {len(found['frequencies'])} frequencies"
    )
    left, middle, right = new.subplots(1, 3, width_ratios=(1.15, 0.75, 0.9))
    _frequencies(left, found)
    _residuals(middle, found)
    _constants(right, found["constants"])
    return new


def _frequencies(axes: Axes, found: Mapping[str, Any]) -> None:
    modes = found["frequencies"]
    rows = range(len(modes))
    measured, predicted = ([m[key] for m in modes] for key in ("measured_hz", "predicted_hz"))
    axes.hlines(rows, 0, measured, color="0.9", linewidth=1)
    axes.plot(measured, rows, "o", ms=8, mfc="none", mec=MEASURED, mew=1.2, label="measured")
    axes.plot(predicted, rows, "o", ms=4, color=PREDICTED, label="predicted")
    for row, f in zip(rows, measured, strict=True):
        # towards the side with more room
        place, side = ((8, 0), "left") if f < 0.7 * max(measured) else ((-8, 0), "right")
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
    axes.legend(loc="upper right")
    bare(axes)


def _residuals(axes: Axes, found: Mapping[str, Any]) -> None:
    residuals = [m["residual_percent"] for m in found["frequencies"]]
    rows = range(len(residuals))
    axes.axvspan(-found["noise_percent"], found["noise_percent"], color=BAND)
    axes.barh(rows, residuals, 0.5, color=PREDICTED)
    for row, r in zip(rows, residuals, strict=True):
        place, side = ((3, 0), "left") if r > 0 else ((-3, 0), "right")
        axes.annotate(f"{r:+.1f} %", (r, row), place, textcoords="offset points", ha=side, va="center")
    widest = 2.1 * max(map(abs, residuals))
    axes.axvline(0, color=MEASURED, linewidth=0.8)
    axes.set(xlim=(-widest, widest), ylim=(len(residuals) - 0.5, -0.5))
    axes.set_xlabel("predicted / measured - 1, %\ngrey: sd of the noise")
    axes.set_title(f"Residuals, rms {found['rms_percent']:.1f} %")
    axes.set_yticks(rows, [""] * len(residuals))
    bare(axes)


def _constants(axes: Axes, constants: Mapping[str, Mapping[str, Any]]) -> None:
    widest = 0.0
    for row, (name, c) in enumerate(constants.items()):
        color, sure = VERDICTS[_verdict(c)], c["agrees"] is not None
        spread = 100.0 * c["reference_sd"] / c["reference"]
        axes.barh(row, 2 * spread, 0.42, left=-spread, color=BAND)
        widest = max(widest, 1.5 * spread, 1.5 * abs(c["percent"]))
        if c["bound"] is None and c["sd"] is not None:
            sd = 100.0 * c["sd"] / c["reference"]
            axes.errorbar(c["percent"], row, xerr=sd, color=color, capsize=3, linewidth=1.4)
        axes.plot(c["percent"], row, "o", ms=6, color=color, mfc=color if sure else "white", mew=1.4)
        axes.text(1.04, row, _estimate(name, c), transform=axes.get_yaxis_transform(), va="center")
    axes.axvline(0, color=MEASURED, linewidth=0.8)
    axes.set_yticks(range(len(constants)), [symbol(name) for name in constants], fontsize=9)
    axes.set(xlim=(-widest, widest), ylim=(len(constants) - 0.5, -0.5))
    axes.set_xlabel("identified / reference - 1, %\ngrey: sd of the reference")
    axes.set_title("Constants, one standard deviation")
    bare(axes)


def _estimate(name: str, constant: Mapping[str, Any]) -> str:
    value, sd, unit = constant["value"], constant["sd"], " GPa" if name.endswith("GPa") else ""
    if constant["bound"] is not None:
        return f"{value:.2g}{unit}\nat its {constant['bound']} bound"
    if sd is None:
        return f"{value:.3g}{unit}\nsd not known"
    decimals = 0 if sd >= 10 else 1 if sd >= 1 else 2
    return f"{value:.{decimals}f} ± {sd:.{decimals}f}{unit}\n{SAID[_verdict(constant)]}"


# All plates


def _overview(found: Mapping[str, Any]) -> Figure:
    new = figure(DOUBLE_MM, 200)
    above, below = new.subfigures(2, 1, height_ratios=(2.1, 1.0), hspace=0.03)
    constants, residuals = above.subplots(1, 2, width_ratios=(1.2, 1.0))
    _all_constants(constants, found["identifications"])
    _all_residuals(residuals, found["identifications"])
    _forward(below.subplots(), found["forward_errors"])
    return new


def _all_constants(axes: Axes, plates: list[dict[str, Any]]) -> None:
    rows = [(f["plate"], name, c) for f in plates for name, c in f["constants"].items()]
    for row, (_, _, c) in enumerate(rows):
        color, sure = VERDICTS[_verdict(c)], c["agrees"] is not None
        ratio = c["value"] / c["reference"]
        if c["bound"] is None and c["sd"] is not None:
            low, high = ((c["value"] + s * c["sd"]) / c["reference"] for s in (-1, 1))
            axes.plot([low, high], [row, row], color=color)
        axes.plot(ratio, row, "o", color=color, mfc=color if sure else "white")
    axes.axvline(1.0, color=MEASURED, linewidth=0.8)
    _shade(axes, [plate for plate, _, _ in rows])
    axes.set_yticks(range(len(rows)), [f"{plate}  {symbol(name)}" for plate, name, _ in rows])
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlabel="identified / reference")
    handles = [
        Line2D(
            [],
            [],
            marker="o",
            ls="",
            color=colour,
            mfc="white" if colour == OPEN else colour,
            label=SAID[verdict] + (" or at a bound" if colour == OPEN else ""),
        )
        for verdict, colour in VERDICTS.items()
    ]
    axes.set_title("Constants, one standard deviation", pad=38)
    axes.legend(handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), labelspacing=0.3)
    bare(axes)


def _shade(axes: Axes, owners: list[str]) -> None:
    """Shade every other plate, so that its rows are seen to belong together."""
    for i, owner in enumerate(dict.fromkeys(owners)):
        first, last = owners.index(owner), len(owners) - 1 - owners[::-1].index(owner)
        if i % 2:
            axes.axhspan(first - 0.5, last + 0.5, color="0.95", zorder=0)


def _all_residuals(axes: Axes, plates: list[dict[str, Any]]) -> None:
    for row, f in enumerate(plates):
        beyond = []
        for i, mode in enumerate(f["frequencies"], 1):
            r = mode["residual_percent"]
            y = row + 0.13 * (i - (len(f["frequencies"]) + 1) / 2)
            axes.plot([0, min(max(r, -WIDEST), WIDEST)], [y, y], color=PREDICTED, lw=2, solid_capstyle="butt")
            if abs(r) > WIDEST:
                beyond.append(f"{r:+.0f}")
        said = f"rms {f['rms_percent']:.1f} %\n{f['forward_solves']} solves"
        if beyond:
            said += f"\nbeyond: {', '.join(beyond)} %"
        axes.text(1.03, row, said, transform=axes.get_yaxis_transform(), va="center", fontsize=7)
    _shade(axes, [f["plate"] for f in plates])
    axes.axvline(0, color=MEASURED, linewidth=0.8)
    axes.set_yticks(range(len(plates)), [f["plate"] for f in plates])
    axes.set(xlim=(-WIDEST, WIDEST), ylim=(len(plates) - 0.5, -0.5))
    axes.set_xlabel("predicted / measured - 1, %")
    axes.set_title("Residuals, first mode on top")
    bare(axes)


def _forward(axes: Axes, errors: list[dict[str, Any]]) -> None:
    rows = range(len(errors))
    worst = [max(abs(e["worst_percent"]), SMALLEST_PERCENT) for e in errors]
    axes.plot(worst, rows, "o", ms=5, color=PREDICTED, label="worst mode against the reference")
    stated = [e["estimate_percent"] for e in errors]
    axes.plot(stated, rows, "|", ms=9, mew=1.6, color=MEASURED, label="stated by the solver")
    allowed = [e["allowed_percent"] for e in errors]
    axes.plot(allowed, rows, "|", ms=9, mew=1.6, color=BLUE, label="allowed")
    axes.set_yticks(rows, [f"{e['case']}: {_short(e['source'])}" for e in errors])
    axes.set_xscale("log")
    axes.set(ylim=(len(errors) - 0.5, -0.5), xlabel="error of a frequency, %")
    axes.set_title("Plate model against references", pad=14)
    axes.grid(axis="x")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 0.98), ncols=3)
    bare(axes)


def _short(source: str) -> str:
    return "two other bases" if source.startswith("converged") else source.split(",")[0]


draw = Drawing(__file__, "01_first_light", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
