"""What is to be said about a noise study: warnings, why its two halves differ, and the paper beside it."""

from __future__ import annotations

import numpy as np

from cpam_bayes.formatting import fixed, significant
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.paper import PerturbationTable, contradictions
from cpam_bayes.plate import user_name
from cpam_bayes.priors import TruncatedNormal
from cpam_bayes.repetition.agreement import Cause
from cpam_bayes.repetition.study import Cell, Sensitivity

__all__ = [
    "beside_paper",
    "difference_sentences",
    "in_standard_errors",
    "level_percent",
    "printed_percent",
    "printed_table",
    "sensitivity_warnings",
    "where",
]

# A constant is found again where it is this close, as a fraction of its search interval.
_FOUND_AGAIN = 1e-2
# Inversions that the paper's means are over.
_PAPER_GROUPS = 10


def printed_table(result: Sensitivity, table: PerturbationTable | None) -> PerturbationTable | None:
    """The paper's table if it is of this built-in specimen: a file of the same name is another plate."""
    if table is None or result.specimen.source != f"built-in {table.specimen}":
        return None
    return table


def sensitivity_warnings(result: Sensitivity) -> tuple[str, ...]:
    """Everything that is a reason not to trust the numbers as they stand."""
    found = []
    rms = result.without_noise.rms
    least = min(cell.level for cell in result.cells)
    if rms > least:
        found.append(
            f"without any added noise the plate model misses this list by {significant(100 * rms, 2)} % "
            f"(rms), more than the noise of {level_percent(least):g} %: the constants make up for that, and "
            "the posterior takes it for noise; --list model studies the noise alone"
        )
    if result.source == "model":
        known = reference_constants(result.specimen)
        lost = [
            c.name
            for c in result.without_noise.constants
            if abs(c.value - known[c.name]) > _FOUND_AGAIN * (c.upper - c.lower)
        ]
        if lost:
            found.append(
                f"without noise the swarm did not quite find {', '.join(lost)} again from which the list was "
                "made: other constants give nearly the same frequencies, and it stopped there"
            )
    if 2 * result.found_again < result.starts:
        found.append(
            f"without noise only {result.found_again} of {result.starts} swarms found the best constants, "
            "the others ended in worse optima: a single swarm, as in identify, often misses them"
        )
    for cell in result.cells:
        if cell.repetition.missed:
            found.append(
                f"{where(cell)}: on {cell.repetition.missed} of {result.groups} lists no swarm came down to "
                "the value that the constants found without noise have: those are no minima"
            )
        if not cell.posterior.converged:
            found.append(
                f"{where(cell)}: the posterior's chains used their budget before they converged, with "
                f"{cell.posterior.effective:.0f} effective samples"
            )
        if cell.repetition.converged < result.groups:
            found.append(
                f"{where(cell)}: {result.groups - cell.repetition.converged} of {result.groups} swarms used "
                "their budget before they converged"
            )
        if cell.repetition.redrawn:
            found.append(
                f"{where(cell)}: {cell.repetition.redrawn} noisy frequencies were not positive and were "
                "drawn again, so that the noise is not quite Gaussian"
            )
    return (*found, *_left_aside(result))


def _left_aside(result: Sensitivity) -> list[str]:
    """What the plate file gives and a noise study has no use for."""
    own, found = result.specimen, []
    if own.plate.sd:
        names = ", ".join(user_name(name) for name in own.plate.sd)
        found.append(f"[plate.sd] is not used here: {names} are taken as exact")
    if own.measurement is not None and any(own.measurement.labels):
        found.append("labels are not used here: frequencies are paired with modes in their order")
    normal = [n for n in own.unknowns.names if isinstance(own.unknowns[n].prior, TruncatedNormal)]
    if normal:
        found.append(
            f"mean and sd of {', '.join(normal)} in [unknowns] enter the posterior alone, the inversions "
            "know the bounds only"
        )
    return found


def where(cell: Cell) -> str:
    """Level and reading in words."""
    sizes = {
        "relative": "of each frequency (relative)",
        "rms": f"of the rms frequency (rms), {significant(float(cell.noise_sd[0]), 3)} Hz for all modes",
    }
    return f"{level_percent(cell.level):g} % {sizes[cell.reading]}"


def level_percent(level: float) -> float:
    """A level as it was written, without the rounding of a division by 100."""
    return round(100.0 * level, 10)


def printed_percent(name: str, cell: Cell, table: PerturbationTable | None) -> float | None:
    """The paper's percentage for a constant at this level, where it has one."""
    return None if table is None else table.percent_error(user_name(name), level_percent(cell.level))


def in_standard_errors(result: Sensitivity, cell: Cell, i: int, printed: float | None) -> float | None:
    """A printed percentage over the standard error that a mean of the paper's ten inversions has here."""
    error = 100.0 * float(cell.repetition.sd[i]) / np.sqrt(_PAPER_GROUPS) / abs(float(result.reference[i]))
    return None if printed is None or error == 0.0 else float(printed / error)


def difference_sentences(result: Sensitivity) -> tuple[str, ...]:
    """One sentence for each constant, level and reading that differs, with the numbers that say why."""
    found = []
    for cell in result.cells:
        for i, c in enumerate(result.without_noise.constants):
            own = cell.comparisons[i]
            if not own.causes:
                continue
            what = []
            if not own.means_agree:
                what.append(f"means {significant(abs(own.shift), 2)} standard errors apart")
            if not own.sds_agree:
                what.append(f"sd {significant(own.sd_ratio, 2)} times the posterior's")
            why = "; ".join(_reason(result, cell, i, cause) for cause in own.causes)
            level = f"{level_percent(cell.level):g} % {cell.reading}"
            found.append(f"{level}, {c.name}: {' and '.join(what)}: {why}.")
    return tuple(found) or ("Nowhere: all means and standard deviations agree within chance (1 % tests).",)


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
    found = [
        f"Table {table.number}: noise on the measured list, errors against the paper's own noise-free answer."
    ]
    if table.angles_deg:
        found.append("The paper sought the ply angles too; here the layup is known.")
    for reading in dict.fromkeys(cell.reading for cell in result.cells):
        own = [cell for cell in result.cells if cell.reading == reading]
        ratios = [
            ratio
            for cell in own
            for i, name in enumerate(names)
            if (ratio := in_standard_errors(result, cell, i, printed_percent(name, cell, table))) is not None
        ]
        if ratios:
            rms = significant(float(np.sqrt(np.mean(np.square(ratios)))), 2)
            below = int(np.sum(np.abs(ratios) < 1.0))
            found.append(
                f"{reading}: {below} of {len(ratios)} printed percentages are smaller than the standard "
                f"error that a mean of ten inversions has here; in these units their rms is {rms}, where "
                "chance alone gives about 1."
            )
    found += [
        f"{c.key} at {c.level_percent:g} %: the printed {c.printed} % does not follow from its row, whose "
        f"amounts allow {c.lowest:.1f} to {c.highest:.1f} %."
        for c in contradictions(table)
    ]
    return tuple(found)
