"""Which figures a comparison with the paper has, and the words beside them."""

from __future__ import annotations

from cpam_bayes.comparison.records import PaperResult
from cpam_bayes.paper.layups import PAPER
from cpam_bayes.report.sections import Caption

_CAPTIONS = {
    "differences": Caption(
        "Each point is a printed value: at zero the paper and the computation agree. Orange points cannot be "
        "reproduced from the paper's own inputs.",
        "Differences between printed and computed values in percent, by table of the paper.",
    ),
    "frequencies": Caption(
        "Each bar is a mode: how far a frequency of Table 5 lies from the converged one.",
        "Differences of the frequencies of Table 5 from converged ones, by plate and mode.",
    ),
    "misfits": Caption(
        "Where the orange bar is higher, other constants fit the plate's frequencies better than the printed "
        "ones.",
        "Misfit of the printed constants beside the least misfit found, by plate.",
    ),
}


def figures_of(result: PaperResult) -> tuple[str, ...]:
    """Names of the figures that the computed tables give."""
    compared = [row for row in result.rows if row.difference_percent is not None]
    drawn = {
        "differences": bool(compared),
        "frequencies": any(row.table == 5 for row in compared),
        "misfits": any(m.source.startswith(PAPER) for m in result.misfits),
    }
    return tuple(name for name, is_drawn in drawn.items() if is_drawn)


def captions(result: PaperResult) -> dict[str, Caption]:
    """A caption for each figure."""
    return {name: _CAPTIONS[name] for name in figures_of(result)}
