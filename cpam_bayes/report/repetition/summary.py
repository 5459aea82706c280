"""`sensitivity` in plain words: how far noise moves the constants."""

from __future__ import annotations

from cpam_bayes.formatting import significant
from cpam_bayes.plate import user_name
from cpam_bayes.repetition.sensitivity import SensitivityResult
from cpam_bayes.repetition.study import Cell
from cpam_bayes.repetition.warnings import level_percent
from cpam_bayes.report.repetition.screen import READING_WORDS
from cpam_bayes.report.sentences import constant_title, plate_argument, plate_sentence
from cpam_bayes.report.summary import Summary
from cpam_bayes.report.tables import Table, headed

_LISTS = {
    "model": "what the plate model gives at the constants of [material]",
    "measured": "the measured frequencies",
}


def summary(result: SensitivityResult) -> Summary:
    """The spread of each constant at each level, by repetition and by one posterior."""
    study = result.study
    first = study.cells[0]
    constants = study.without_noise.constants
    worst = max(range(len(constants)), key=lambda i: _percents(result, first, i)[1])
    name = constants[worst].name
    spread = significant(_percents(result, first, worst)[1], 2)
    compared = [c for cell in study.cells for c in cell.comparisons]
    agree = sum(not c.causes for c in compared)
    return Summary(
        title=f"sensitivity {result.title}",
        slips=result.slips,
        headline=(
            f"Noise of {level_percent(first.level):g} % of the frequencies moves {name} most, by {spread} % "
            f"(one standard deviation). In {agree} of {len(compared)} comparisons {study.groups} repeated "
            "inversions and one posterior agree within chance."
        ),
        tables=tuple(_spreads(result, cell) for cell in study.cells),
        basis=(
            f"The frequencies that noise is added to: {_LISTS[study.source]}.",
            f"Repetition: {study.groups} noisy lists at each level, each inverted by the swarm.",
            "Posterior: one, of the frequencies without added noise, with the noise taken as known.",
            *dict.fromkeys(
                f"Reading {cell.reading!r} of eq. (12): {READING_WORDS[cell.reading]}."
                for cell in study.cells
            ),
            plate_sentence(result.specimen),
        ),
        warnings=tuple(w for w in result.warnings if w not in result.slips),
        next_steps=(
            "Take the spread at the repeatability of your own tap test as the error to expect; where it is "
            "too large for a constant, measure more modes or another plate.",
            f"Identify the constants: cpam-bayes identify {plate_argument(result.specimen)} --backend emcee",
        ),
    )


def _percents(result: SensitivityResult, cell: Cell, i: int) -> tuple[float, float]:
    """Standard deviation by repetition and by the posterior, % of the constant without noise."""
    value = abs(result.study.without_noise.constants[i].value)
    return 100.0 * float(cell.repetition.sd[i]) / value, 100.0 * float(cell.posterior.sd[i]) / value


def _spreads(result: SensitivityResult, cell: Cell) -> Table:
    columns = headed("", "", "#repeated inversions, sd %", "#posterior, sd %", "do both agree?")
    rows, flagged = [], []
    for i, c in enumerate(result.study.without_noise.constants):
        by_repetition, by_posterior = _percents(result, cell, i)
        causes = cell.comparisons[i].causes
        if causes:
            flagged.append(i)
        rows.append(
            (
                c.name,
                constant_title(c.name, result.specimen.material) or user_name(c.name),
                significant(by_repetition, 2),
                significant(by_posterior, 2),
                "no, see --verbose" if causes else "yes",
            )
        )
    title = f"Noise of {level_percent(cell.level):g} %, reading {cell.reading!r}"
    return Table(title, columns, tuple(rows), frozenset(flagged))
