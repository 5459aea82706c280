"""Residual of real causes that the catalogue's forms leave, cause by cause.

python figures/25_form_errors.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BLUE, LIGHT, ORANGE, SINGLE_MM, Drawing, Picture, figure
from matplotlib.figure import Figure


def pictures(data: dict[str, Any]) -> list[Picture]:
    effects = sorted(data["effects"], key=lambda row: row["rms"])
    least, most = effects[0], effects[-1]
    plates = len({case["plate"] for case in data["cases"]})
    return [
        Picture(
            "25_form_errors",
            _rows(effects, data["cases"]),
            "How much of a real cause's shift the catalogue's form misses.",
            "Rms over ten modes of what is left of the shift by a real form after the catalogue's effect was "
            f"fitted to it, over the rms of the shift: {len(data['cases'])} forms, sizes and places on "
            f"{plates} plates. Grey: each of them; blue: their rms, in the catalogue but for tapers and "
            f"warp; orange: their rms where the constants are free to imitate. From {least['rms']:.2f} "
            f"({least['cause']}) to {most['rms']:.2f} ({most['cause']}).",
        )
    ]


def _rows(effects: list[dict[str, Any]], cases: list[dict[str, Any]]) -> Figure:
    new = figure(SINGLE_MM, 28 + 5 * len(effects))
    axes = new.subplots()
    for k, row in enumerate(effects):
        own = [case["kappa"] for case in cases if case["cause"] == row["cause"]]
        axes.plot(own, np.full(len(own), k), "|", color=LIGHT, ms=7)
    places = np.arange(len(effects))
    for key, colour, marker, label in (
        ("rms", BLUE, "o", "constants held"),
        ("rms_free", ORANGE, "D", "constants free"),
    ):
        axes.plot([row[key] for row in effects], places, marker, color=colour, ls="", label=label)
    axes.set_yticks(places, [row["cause"] for row in effects])
    axes.set(xlim=(0.0, 1.02), ylim=(-0.6, len(effects) - 0.4), xlabel="missed fraction of the shift")
    new.legend(loc="outside lower center", ncols=2)
    return new


draw = Drawing(__file__, "25_form_errors", "no random numbers", pictures)

if __name__ == "__main__":
    draw.main()
