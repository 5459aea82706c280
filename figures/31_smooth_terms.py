"""Coverage of intervals of the diagnosis with each smooth term of the model of error switched off.

python figures/31_smooth_terms.py [--help]
"""

from __future__ import annotations

from typing import Any

from journal import BAND, BLUE, SINGLE_MM, Drawing, Picture, bare, figure
from matplotlib.figure import Figure

# Coverage that was predicted.
PREDICTED = (0.93, 0.97)


def pictures(data: dict[str, Any]) -> list[Picture]:
    rows = data["terms"]
    return [
        Picture(
            "31_smooth_terms",
            _coverage(rows),
            "Constants in their 95 % intervals with a term of the model of error switched off.",
            f"{rows[0]['constants']} constants of {rows[0]['lists']} lists drawn from priors, with two "
            f"standard errors by list; the band is {PREDICTED[0]:g} to {PREDICTED[1]:g}.",
        )
    ]


def _coverage(rows: list[dict[str, Any]]) -> Figure:
    new = figure(SINGLE_MM, 18 + 7.0 * len(rows))
    axes = new.subplots()
    places = range(len(rows))
    axes.axvspan(*PREDICTED, color=BAND, lw=0)
    axes.errorbar(
        [r["share"] for r in rows],
        places,
        xerr=[2.0 * r["standard_error"] for r in rows],
        fmt="o",
        color=BLUE,
        lw=0.8,
    )
    axes.set_yticks(places, [f"without {r['without']}" if k else "all terms" for k, r in enumerate(rows)])
    axes.set(xlim=(0.8, 1.0), ylim=(len(rows) - 0.5, -0.5), xlabel="fraction in their intervals")
    bare(axes)
    return new


draw = Drawing(__file__, "31_smooth_terms", "seed 564914213", pictures)

if __name__ == "__main__":
    draw.main()
