"""Findings of `identify` in plate files with a slip, without one, and with a real cause.

python figures/26_slips.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, LIGHT, ORANGE, SINGLE_MM, Drawing, Picture, figure, stacked
from matplotlib.figure import Figure

# Outcomes of a file and their colours. If there is no slip, naming none is right.
COLOURS = {
    "right": BLUE,
    "a wrong slip": ORANGE,
    "the slip is not named": LIGHT,
    "cannot be seen": "white",
    "refused with a message": "0.5",
}
# The study's name of a slip -> its label.
SLIPS = {
    "sides": "length for width",
    "layup": "layup turned by 90 deg",
    "edges": "neighbouring edge held",
    "supports": "clamped for supported",
    "missed": "a mode missed",
    "false": "a false peak",
    "misread": "two digits exchanged",
    "decimal": "decimal point moved",
    "clamped": "clamped, stated free",
    "free": "free, stated clamped",
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
            "How often a slip in a plate file is named.",
            f"{len(slips)} files with one of {len({c['kind'] for c in slips})} slips: it is "
            f"named in {right}, {unseen} fit within the noise (white). "
            f"{others} files without a slip or with a real cause: a slip is named in {wrong}.",
        )
    ]


def _shares(rows: list[dict[str, Any]]) -> Figure:
    named = {_name(row): _outcomes(row) for row in rows}
    shown = {what: c for what, c in COLOURS.items() if any(counts[what] for counts in named.values())}
    new = figure(SINGLE_MM, 34 + 4.5 * len(rows))
    axes = new.subplots()
    stacked(axes, named, shown, "files", edgecolor="0.3", linewidth=0.4)
    new.legend(loc="outside lower center", ncols=2)
    return new


def _name(row: dict[str, Any]) -> str:
    return SLIPS.get(row["kind"], f"no slip: {row['kind'].replace('_', ' ')}")


def _outcomes(row: dict[str, Any]) -> dict[str, int]:
    """Number of files by outcome."""
    none, is_slip = row["none"], row["kind"] in SLIPS
    return {
        "right": row["right"] + (0 if is_slip else none),
        "a wrong slip": row["another slip"],
        "the slip is not named": none if is_slip else 0,
        "cannot be seen": row["cannot be seen"],
        "refused with a message": row["refused with a message"],
    }


draw = Drawing(__file__, "26_slips", "seed 27", pictures)

if __name__ == "__main__":
    draw.main()
