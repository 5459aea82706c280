"""Every reason not to trust a noise study as it stands, in sentences."""

from __future__ import annotations

from cpam_bayes.formatting import significant
from cpam_bayes.forward_model.model import reference_constants
from cpam_bayes.inference.diagnostics.constraints import constraint_warnings
from cpam_bayes.paper import PerturbationTable
from cpam_bayes.plate import user_name
from cpam_bayes.priors import TruncatedNormal
from cpam_bayes.repetition.study import Cell, Sensitivity

# A constant is found again where it is this close, as a fraction of its search interval.
_FOUND_AGAIN = 1e-2


def printed_table(result: Sensitivity, table: PerturbationTable | None) -> PerturbationTable | None:
    """The paper's table if it is of this built-in specimen: a file of the same name is another plate."""
    if table is None or result.specimen.source != f"built-in {table.specimen}":
        return None
    return table


def sensitivity_warnings(result: Sensitivity) -> tuple[str, ...]:
    """Everything that is a reason not to trust the numbers as they stand."""
    problems = []
    rms = result.without_noise.rms
    least = min(cell.level for cell in result.cells)
    if rms > least:
        problems.append(
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
            problems.append(
                f"without noise the swarm did not quite find {', '.join(lost)} again from which the list was "
                "made: other constants give nearly the same frequencies, and it stopped there"
            )
    if 2 * result.found_again < result.starts:
        problems.append(
            f"without noise only {result.found_again} of {result.starts} swarms found the best constants, "
            "the others ended in worse optima: a single swarm, as in identify, often misses them"
        )
    for cell in result.cells:
        if cell.repetition.missed:
            problems.append(
                f"{where(cell)}: on {cell.repetition.missed} of {result.groups} lists no swarm came down to "
                "the value that the constants found without noise have: those are no minima"
            )
        if not cell.posterior.converged:
            problems.append(
                f"{where(cell)}: the posterior's chains used their budget before they converged, with "
                f"{cell.posterior.effective:.0f} effective samples"
            )
        problems += constraint_warnings(
            f"{where(cell)}: the posterior is cut by the constraint", cell.posterior.constraints
        )
        if cell.repetition.converged < result.groups:
            problems.append(
                f"{where(cell)}: {result.groups - cell.repetition.converged} of {result.groups} swarms used "
                "their budget before they converged"
            )
        if cell.repetition.redrawn:
            problems.append(
                f"{where(cell)}: {cell.repetition.redrawn} noisy frequencies were not positive and were "
                "drawn again, so that the noise is not quite Gaussian"
            )
    return (*problems, *_left_aside(result))


def _left_aside(result: Sensitivity) -> list[str]:
    """What the plate file gives and a noise study has no use for."""
    specimen, problems = result.specimen, []
    if specimen.plate.sd:
        names = ", ".join(user_name(name) for name in specimen.plate.sd)
        problems.append(f"[plate.sd] is not used here: {names} are taken as exact")
    if specimen.measurement is not None and specimen.measurement.names_modes:
        problems.append(
            "labels and shapes are not used here: frequencies are paired with modes in their order"
        )
    normal = [n for n in specimen.unknowns.names if isinstance(specimen.unknowns[n].prior, TruncatedNormal)]
    if normal:
        problems.append(
            f"mean and sd of {', '.join(normal)} in [unknowns] enter the posterior alone, the inversions "
            "know the bounds only"
        )
    return problems


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
