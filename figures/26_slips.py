"""What `identify` names of plate files with a slip, without one, and with a real cause.

python figures/26_slips.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, LIGHT, ORANGE, SINGLE_MM, Drawing, Picture, figure, stacked
from matplotlib.figure import Figure

# Outcomes as the study counts them, and how each is drawn.
COLOURS = {
    "right": BLUE,
    "another slip": ORANGE,
    "none": LIGHT,
    "cannot be seen": "white",
    "refused with a message": "0.5",
}


def pictures(data: dict[str, Any]) -> list[Picture]:
    slips = [c for c in data["cases"] if c["truth"][0]]
    others = len(data["cases"]) - len(slips)
    rows = data["counts"]
    right, unseen = (sum(row[what] for row in rows) for what in ("right", "cannot be seen"))
    wrong = sum(row["another slip"] for row in rows if not any(c["kind"] == row["kind"] for c in slips))
    return [
        Picture(
            "26_slips",
            _shares(rows),
            "What is named of plate files with a slip.",
            f"{len(slips)} files with one of {len({c['kind'] for c in slips})} slips: it is "
            f"named in {right}, {unseen} fit within the noise as they are. "
            f"{others} files without a slip or with a real cause: a slip is named in {wrong}.",
        )
    ]


def _shares(rows: list[dict[str, Any]]) -> Figure:
    new = figure(SINGLE_MM, 34 + 4.5 * len(rows))
    axes = new.subplots()
    named = {row["kind"].replace("_", " "): row for row in rows}
    stacked(axes, named, COLOURS, "files", edgecolor="0.3", linewidth=0.4)
    new.legend(loc="outside lower center", ncols=2)
    return new


draw = Drawing(__file__, "26_slips", "seed 27", pictures)

if __name__ == "__main__":
    draw.main()
