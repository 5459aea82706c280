"""The paper's tables beside computed values: differences by table, frequencies of Table 5, misfits.

python figures/19_paper.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BLUE, DOUBLE_MM, GREEN, GREY, LIGHT, ORANGE, SKY, Drawing, Picture, figure
from matplotlib.figure import Figure

MARKS = {
    "agrees": (BLUE, "o"),
    "within the posterior": (GREY, "D"),
    "cannot be told apart": (GREEN, "s"),
    "not determined": (SKY, "v"),
    "not reproducible": (ORANGE, "^"),
}
# Beyond this a printed frequency must have lost a digit.
MISPRINTED_PERCENT = 50.0


def pictures(data: dict[str, Any]) -> list[Picture]:
    document = data["paper"]
    rows = [row for row in document["rows"] if row["difference_percent"] is not None]
    table_5 = [row for row in rows if row["table"] == 5]
    misfits = [m for m in document["audit"]["misfits"] if m["source"].startswith("CPAM")]
    found = {kind: sum(_verdict(r) == kind for r in rows) for kind in MARKS}
    verdicts = ", ".join(f"{kind} {number}" for kind, number in found.items() if number)
    layups = sum(isinstance(row["ours"], list) for row in document["rows"])
    drawn = [
        Picture(
            "19_paper",
            _differences(rows),
            "Printed values of the paper over those computed here, by table.",
            f"Verdicts on {len(rows)} printed numbers: {verdicts}; {layups} stacking sequences have a "
            "verdict too, but no difference in per cent. The axis is linear within 1 % and logarithmic "
            "beyond.",
        )
    ]
    if table_5:
        worst = max((r for r in table_5 if _readable(r)), key=lambda r: abs(r["difference_percent"]))
        drawn.append(
            Picture(
                "19_paper_table_5",
                _frequencies(table_5),
                "ABAQUS frequencies of Table 5 over converged ones, mode by mode.",
                "Modes of each plate from the left. The largest difference is "
                f"{worst['difference_percent']:+.1f} % on {worst['specimen']}. "
                f"Left out for lack of a digit in print: {sum(not _readable(r) for r in table_5)}.",
            )
        )
    if misfits:
        larger = sum(m["rms_percent"] > 1.5 * m["our_rms_percent"] for m in misfits)
        drawn.append(
            Picture(
                "19_paper_misfits",
                _misfits(misfits),
                "Misfit of the paper's printed constants to its own measured frequencies.",
                "Root mean square misfit of the printed constants beside that of the constants with the "
                "smallest F found here (F is in Hz: its rms in % can be larger); of the aluminium plates "
                "with two and with four unknown constants. "
                f"In {larger} of {len(misfits)} cases the printed constants fit more than 1.5 times worse.",
            )
        )
    return drawn


def _verdict(row: dict[str, Any]) -> str:
    return str(row["verdict"]).partition(":")[0]


def _readable(row: dict[str, Any]) -> bool:
    return abs(row["difference_percent"]) < MISPRINTED_PERCENT


def _differences(rows: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 80)
    axes = new.subplots()
    tables = sorted({row["table"] for row in rows})
    for kind, (colour, marker) in MARKS.items():
        of_kind = [row for row in rows if _verdict(row) == kind]
        # spread about the table's position, so that points do not hide each other
        places = [tables.index(row["table"]) + 0.35 * np.sin(7.0 * i) for i, row in enumerate(of_kind)]
        values = [row["difference_percent"] for row in of_kind]
        label = kind if of_kind else None
        axes.plot(places, values, marker, ms=3, mew=0, alpha=0.75, color=colour, label=label)
    axes.set_yscale("symlog", linthresh=1.0)
    ticks = (-100, -10, -1, 0, 1, 10, 100)
    axes.set_yticks(ticks, [f"{t:+d}" if t else "0" for t in ticks])
    axes.minorticks_off()
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.grid(axis="y")
    axes.set_xticks(range(len(tables)), [str(table) for table in tables])
    for place in range(1, len(tables)):
        axes.axvline(place - 0.5, color=LIGHT, linewidth=0.4)
    axes.tick_params(axis="x", length=0)
    axes.set(xlabel="table of the paper", ylabel="printed / computed - 1, %", xlim=(-0.5, len(tables) - 0.5))
    new.legend(loc="outside upper center", ncols=len(MARKS))
    return new


def _frequencies(rows: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 65)
    axes = new.subplots()
    plates = list(dict.fromkeys(row["specimen"] for row in rows))
    for i, plate in enumerate(plates):
        of_plate = [row for row in rows if row["specimen"] == plate]
        for k, row in enumerate(of_plate):
            if _readable(row):
                place = i + 0.8 * (k + 0.5) / len(of_plate) - 0.4
                axes.bar(place, row["difference_percent"], 0.7 / len(of_plate), color=BLUE)
    axes.axhline(0.0, color="0.4", linewidth=0.7)
    axes.grid(axis="y")
    axes.set_xticks(range(len(plates)), plates)
    axes.tick_params(axis="x", length=0)
    axes.set(xlabel="plate, its modes from the left", ylabel="ABAQUS / converged - 1, %")
    return new


def _misfits(misfits: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 70)
    axes = new.subplots()
    places = np.arange(len(misfits))
    printed, ours = ([m[key] for m in misfits] for key in ("rms_percent", "our_rms_percent"))
    axes.vlines(places, printed, ours, color="0.6", linewidth=1.0)
    axes.plot(places, printed, "o", color=ORANGE, label="printed constants")
    axes.plot(places, ours, "o", color=BLUE, label="smallest F found here")
    names = [
        m["specimen"] if m["table"] == 9 else f"{m['specimen']}\n{m['case'].split()[0]}" for m in misfits
    ]
    axes.set_yscale("log")
    ticks = [
        t
        for t in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
        if min(printed + ours) / 2 < t < 2 * max(printed + ours)
    ]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.minorticks_off()
    axes.grid(axis="y")
    axes.set_xticks(places, names)
    axes.tick_params(axis="x", length=0)
    axes.set_xlabel("specimen; number of unknown constants of the aluminium plates")
    axes.set_ylabel("rms misfit of the frequencies, %")
    new.legend(loc="outside upper center", ncols=2)
    return new


draw = Drawing(__file__, "19_paper", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
