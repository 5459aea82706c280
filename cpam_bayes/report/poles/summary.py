"""`poles` in plain words."""

from __future__ import annotations

from cpam_bayes.formatting import significant, with_spread
from cpam_bayes.modal_analysis.poles import TABLE, PolesResult
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed


def summary(result: PolesResult) -> Summary:
    """The modes, what they rest on, and what to do with the table."""
    modes = result.modes
    many = "no mode" if not modes else "1 mode" if len(modes) == 1 else f"{len(modes)} modes"
    span = f" from {modes[0].frequency:.5g} to {modes[-1].frequency:.5g} Hz" if len(modes) > 1 else ""
    return Summary(
        title=f"poles {result.title}",
        slips=result.slips,
        headline=f"The responses show {many}{span}.",
        tables=(_table(result),),
        basis=(
            f"Read: {result.responses.origin}; looked at {result.low:.5g} to {result.high:.5g} Hz, lines "
            f"{result.responses.step:.4g} Hz apart.",
            "Standard deviations are those of the fit to these responses: how the plate hangs, warms or is "
            "hit elsewhere is not in them.",
        ),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=(
            f"Look at the stability diagram of --out DIR and edit DIR/{TABLE}: weight 0 leaves a mode out.",
            f'Identify from it: [measurement] table = "{TABLE}" in the plate file.',
        )
        if modes
        else (),
    )


def _table(result: PolesResult) -> Table:
    rows = []
    for i, mode in enumerate(result.modes, 1):
        hz, sd = with_spread(mode.frequency, mode.sd)
        damping, damping_sd = with_spread(100.0 * mode.damping, 100.0 * mode.damping_sd)
        rows.append((str(i), hz, sd, damping, damping_sd, significant(2.0 * mode.damping, 3)))
    columns = headed("#mode", "#Hz", "#sd", "#damping %", "#sd", "#loss factor")
    return Table("Modes", columns, tuple(rows))
