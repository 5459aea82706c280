"""The control chart of a batch."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cpam_bayes.batches.batch import BatchResult
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.report.figures import MEASURED

_OUTSIDE = "#c1440e"
# Names of plates stand below the axis up to this number of them.
_MOST_NAMES = 40


def figures(result: BatchResult) -> dict[str, Figure]:
    """Each constant over the plates in their order, with the limits of individual values."""
    if not result.done:
        return {}
    names, rows = result.constants, result.done
    figure = Figure(figsize=(min(max(5.5, 0.2 * len(rows) + 2.0), 12.0), 1.7 * len(names) + 1.0),
                    layout="constrained")  # fmt: skip
    grid = figure.subplots(len(names), 1, squeeze=False, sharex=True).ravel()
    for axes, name in zip(grid, names, strict=True):
        having = [(i, c) for i, row in enumerate(rows) if (c := row.constant(name)) is not None]
        place = np.array([i for i, _ in having])
        value, low, high = (
            np.array([to_user(name, float(getattr(c, key))) for _, c in having])
            for key in ("value", "low", "high")
        )
        chart = result.chart(name)
        red = np.zeros(len(having), dtype=bool)
        if chart is not None:
            red[list(chart.outside)] = True
            lower, upper = (to_user(name, v) for v in chart.limits)
            axes.axhspan(lower, upper, color="0.93")
            axes.axhline(to_user(name, chart.median), color="0.5", linewidth=1)
        axes.vlines(place, low, high, color="0.6", linewidth=1)
        axes.plot(place[~red], value[~red], "o", color=MEASURED, markersize=3.5)
        axes.plot(place[red], value[red], "o", color=_OUTSIDE, markersize=4.5)
        for limit in result.limits:
            if limit.name == name:
                axes.axhline(to_user(name, limit.value), color=_OUTSIDE, linestyle="--", linewidth=1)
        axes.set_ylabel(f"{name}, {unit_of(name)}" if unit_of(name) else name)
    if len(rows) <= _MOST_NAMES:
        grid[-1].set_xticks(range(len(rows)), [row.name for row in rows], rotation=90, fontsize="small")
    else:
        grid[-1].set_xlabel("plate, in the order of the batch")
    figure.suptitle(f"Constants of {len(rows)} plates")
    return {"control_chart": figure}
