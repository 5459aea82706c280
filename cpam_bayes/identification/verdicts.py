"""Whether the data determine a constant: the one place that decides it."""

from __future__ import annotations

from typing import Final, Literal

__all__ = ["BY_DATA", "BY_PRIOR", "MISFIT", "Verdict", "verdict_of"]

Verdict = Literal[
    "determined by the data",
    "determined by data and prior",
    "determined by the prior",
    "not determined, the model misfits",
]

MISFIT: Final = "not determined, the model misfits"

BY_DATA: Final = 0.9
"""Posterior contraction from which the data determine a constant: its sd is a third of the prior's."""
BY_PRIOR: Final = 0.5
"""Posterior contraction below which the prior does: its sd is more than 0.7 of the prior's."""


def verdict_of(sd: float, prior_sd: float, *, explained: bool, at_bound: bool = False) -> Verdict:
    """Who determines a constant, by its posterior contraction 1 - (sd / prior sd)^2.

    explained : whether the noise as stated explains the misfit, see `slips.birge_ratio`. A model that it does
    not is none of this plate, and what its frequencies determine is no constant of the plate either.

    A constant in contact with a bound is never determined by the data alone; one whose sd is not known
    counts as determined by the prior.
    """
    contraction = 1.0 - (sd / prior_sd) ** 2
    if not contraction >= BY_PRIOR:
        return "determined by the prior"
    if not explained:
        return MISFIT
    return (
        "determined by the data"
        if contraction >= BY_DATA and not at_bound
        else "determined by data and prior"
    )
