"""Outcomes of hostile inputs: accepted, refused with a message, or anything else.

python figures/21_hard_use.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BLUE, DOUBLE_MM, ORANGE, Drawing, Picture, bare, figure
from matplotlib.figure import Figure

KINDS = {
    "accepted": ("#DDDDDD", "accepted"),
    "refused": (BLUE, "refused"),
    "failed": (ORANGE, "anything else"),
}


def pictures(data: dict[str, Any]) -> list[Picture]:
    inputs = sum(row["inputs"] for row in data["kinds"])
    failed = sum(row["failed"] for row in data["kinds"])
    return [
        Picture(
            "21_hard_use",
            _bars(data["kinds"]),
            "What became of hostile plate files, layups, tables, measurements, stored files and arguments.",
            f"Parts of {inputs} inputs that were accepted or refused with a message; {failed} ended in "
            "anything else. A damaged stored file counts as refused where nothing of it is used.",
        )
    ]


def _bars(rows: list[dict[str, Any]]) -> Figure:
    new = figure(DOUBLE_MM, 25 + 7 * len(rows))
    axes = new.subplots()
    for k, row in enumerate(rows):
        left = 0.0
        for key, (colour, word) in KINDS.items():
            part = 100 * row[key] / row["inputs"]
            axes.barh(k, part, 0.7, left=left, color=colour, label=word if not k else None)
            left += part
    axes.set_yticks(range(len(rows)), [f"{row['kind']} ({row['inputs']})" for row in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set(xlim=(0, 100), xlabel="part of the inputs, %")
    bare(axes)
    new.legend(loc="outside lower center", ncols=len(KINDS))
    return new


draw = Drawing(__file__, "21_hard_use", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
