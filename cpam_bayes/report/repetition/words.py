"""Why the two halves of a noise study differ, and the paper beside it, in sentences."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import fixed, significant
from cpam_bayes.paper import PerturbationTable, contradictions
from cpam_bayes.plate import user_name
from cpam_bayes.repetition.agreement import Cause
from cpam_bayes.repetition.study import Cell, Sensitivity
from cpam_bayes.repetition.warnings import level_percent

__all__ = [
    "beside_paper",
    "difference_sentences",
    "in_standard_errors",
    "printed_percent",
]

# Inversions that the paper's means are over.
_PAPER_GROUPS = 10


def printed_percent(name: str, cell: Cell, table: PerturbationTable | None) -> float | None:
    """The paper's percentage for a constant at this level, where it has one."""
    return None if table is None else table.percent_error(user_name(name), level_percent(cell.level))


def in_standard_errors(result: Sensitivity, cell: Cell, i: int, printed: float | None) -> float | None:
    """A printed percentage over the standard error that a mean of the paper's ten inversions has here."""
    error = 100.0 * float(cell.repetition.sd[i]) / np.sqrt(_PAPER_GROUPS) / abs(float(result.reference[i]))
    return None if printed is None or error == 0.0 else float(printed / error)


def difference_sentences(result: Sensitivity) -> tuple[str, ...]:
    """One sentence for each constant, level and reading that differs, with the numbers that say why."""
    sentences = []
    for cell in result.cells:
        for i, c in enumerate(result.without_noise.constants):
            comparison = cell.comparisons[i]
            if not comparison.causes:
                continue
            what = []
            if not comparison.means_agree:
                what.append(f"means {significant(abs(comparison.shift), 2)} standard errors apart")
            if not comparison.sds_agree:
                what.append(f"sd {significant(comparison.sd_ratio, 2)} times the posterior's")
            why = "; ".join(_reason(result, cell, i, cause) for cause in comparison.causes)
            level = f"{level_percent(cell.level):g} % {cell.reading}"
            sentences.append(f"{level}, {c.name}: {' and '.join(what)}: {why}.")
    return tuple(sentences) or (
        "Nowhere: all means and standard deviations agree within chance (1 % tests).",
    )


def _reason(result: Sensitivity, cell: Cell, i: int, cause: Cause) -> str:
    rep, post = cell.repetition, cell.posterior
    apart = abs(float((result.reference[i] - post.best[i]) / post.sd[i]))
    values: dict[Cause, str] = {
        "missed": f"the swarms of {rep.missed} of {result.groups} lists missed the minimum of eq. (7)",
        "bounds": (
            f"{int(rep.on_bound[:, i].sum())} of {result.groups} inversions end on a bound, where "
            f"{100 * float(post.next_to_bound[i]):.0f} % of the posterior lies"
        ),
        "open": (
            f"the noise leaves it open: the posterior's sd is {100 * float(post.contraction[i]):.0f} % of "
            "its prior's, while inversions know of a prior its bounds alone"
        ),
        "optima": "the inversions or the posterior fall into separate groups",
        "skewed": f"the posterior is skewed ({fixed(float(post.skewness[i]), 1)})",
        "reordered": f"in {100 * rep.reordered:.0f} % of the noisy lists modes have changed places",
        "weights": (
            f"eq. (7) does not weigh the frequencies by this noise, which widens the scatter "
            f"{significant(float(post.swarm_sd[i] / post.linearised_sd[i]), 2)} times to first order"
        ),
        "misfit": (
            "the model does not repeat the list, and eq. (7) and the likelihood settle at different "
            f"constants, {significant(apart, 2)} sd apart"
        ),
        "stopped": (
            f"the swarm stops {significant(apart, 2)} sd short of the optimum, though it repeats the list: "
            "its own tolerance shows"
        ),
        "unexplained": "no measured cause explains it",
    }
    return values[cause]


def beside_paper(result: Sensitivity, table: PerturbationTable | None) -> tuple[str, ...]:
    """What the printed percentages mean beside the scatter of a mean of ten, and what is odd about them."""
    if table is None:
        return ()
    names = [c.name for c in result.without_noise.constants]
    sentences = [
        f"Table {table.number}: noise on the measured list, errors against the paper's own noise-free answer."
    ]
    if table.angles_deg:
        sentences.append("The paper sought the ply angles too; here the layup is known.")
    for reading in dict.fromkeys(cell.reading for cell in result.cells):
        cells = [cell for cell in result.cells if cell.reading == reading]
        ratios = [
            ratio
            for cell in cells
            for i, name in enumerate(names)
            if (ratio := in_standard_errors(result, cell, i, printed_percent(name, cell, table))) is not None
        ]
        if ratios:
            rms = significant(float(np.sqrt(np.mean(np.square(ratios)))), 2)
            below = int(np.sum(np.abs(ratios) < 1.0))
            sentences.append(
                f"{reading}: {below} of {len(ratios)} printed percentages are smaller than the standard "
                f"error that a mean of ten inversions has here; in these units their rms is {rms}, where "
                "chance alone gives about 1."
            )
    sentences += [
        f"{c.key} at {c.level_percent:g} %: the printed {c.printed} % does not follow from its row, whose "
        f"amounts allow {c.lowest:.1f} to {c.highest:.1f} %."
        for c in contradictions(table)
    ]
    return tuple(sentences)
