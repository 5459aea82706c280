"""Log evidences from the diagnosis's importance sampler minus those from nested sampling.

python figures/24_nested_evidence.py [--help]
"""

from __future__ import annotations

from typing import Any

import numpy as np
from journal import BAND, BLUE, GREY, SINGLE_MM, Drawing, Picture, figure
from matplotlib.figure import Figure

# Tolerance beyond the errors of both, nats.
AGREED = 0.1


def pictures(data: dict[str, Any]) -> list[Picture]:
    summary = data["summary"]
    return [
        Picture(
            "24_nested_evidence",
            _differences(data["cases"]),
            "Log marginal likelihoods by the importance sampler less those of nested sampling.",
            f"Hypotheses near the best of {summary['cases']} simulated lists, with two standard errors of "
            f"both together; nested sampling has {data['live_points']} live points. Grey: {AGREED:g} nats. "
            f"{summary['agreed']} of {summary['compared']} agree to {AGREED:g} nats and two standard errors.",
        )
    ]


def _differences(cases: list[dict[str, Any]]) -> Figure:
    rows = [row for case in cases for row in case["hypotheses"]]
    difference = [row["importance"] - row["nested"] for row in rows]
    error = [2.0 * np.hypot(row["importance_error"], row["nested_error"]) for row in rows]
    new = figure(SINGLE_MM, 60)
    axes = new.subplots()
    axes.axhspan(-AGREED, AGREED, color=BAND, lw=0, zorder=0)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.errorbar(np.arange(1, len(rows) + 1), difference, yerr=error, fmt="o", color=BLUE, lw=0.8, mew=0)
    axes.set(xlabel="hypothesis", ylabel="importance less nested, nats")
    return new


draw = Drawing(__file__, "24_nested_evidence", "seed 0", pictures)

if __name__ == "__main__":
    draw.main()
