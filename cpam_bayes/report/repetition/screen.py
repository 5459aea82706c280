"""Screen of `sensitivity`: repeated inversions beside a posterior, and beside the paper."""

from __future__ import annotations

import math
from typing import Final

from cpam_bayes.formatting import fixed, signed, significant, with_spread
from cpam_bayes.paper import PerturbationTable
from cpam_bayes.plate import to_user, unit_of
from cpam_bayes.repetition.perturbation import Interpretation
from cpam_bayes.repetition.sensitivity import SensitivityResult
from cpam_bayes.repetition.study import Cell, Sensitivity
from cpam_bayes.repetition.warnings import level_percent, where
from cpam_bayes.report.plates.head import plate_section
from cpam_bayes.report.repetition.words import (
    beside_paper,
    difference_sentences,
    printed_percent,
)
from cpam_bayes.report.sections import Section
from cpam_bayes.report.tables import Column, Table, facts, remarks

READING_WORDS: Final[dict[Interpretation, str]] = {
    "relative": "each mode has its own standard deviation, the level times its frequency",
    "rms": "all modes have one standard deviation, the level times the root mean square frequency",
}


def sections(result: SensitivityResult) -> tuple[Section, ...]:
    """Plate, what was done, one table for each level and reading, why both differ, the paper."""
    study, table = result.study, result.table
    return (
        plate_section(result.specimen, result.air_shifts),
        Section("What was done", (_study(study, result.seed),)),
        Section(
            "Repeated inversions beside the posterior",
            (
                *(_cell_table(study, cell, table) for cell in study.cells),
                remarks("Where repetition and posterior differ", difference_sentences(study)),
                remarks("Beside the paper", beside_paper(study, table)),
            ),
            ("sensitivity",),
            folded=False,
        ),
    )


def _study(result: Sensitivity, seed: int) -> Table:
    n = result.groups
    listed = {
        "model": "what the plate model gives at the reference constants of [material]",
        "measured": "as measured",
    }[result.source]
    rows = [("list", listed)]
    rows += [(r, READING_WORDS[r]) for r in dict.fromkeys(cell.reading for cell in result.cells)]
    rows += [
        ("repetition", f"{n} noisy lists, each inverted by the swarm, eq. (7): mean and sd over the {n}"),
        (
            "error",
            "mean over the noise-free inversion - 1; se: standard error of the mean, sd / sqrt(groups)",
        ),
        (
            "search",
            f"without noise {result.found_again} of {result.starts} swarms found the best constants; "
            f"{sum(cell.repetition.restarted for cell in result.cells)} swarms on noisy lists missed the "
            "minimum and were started anew",
        ),
        ("posterior", "one, of the list without added noise, its noise known to be that of the level"),
        (
            "work",
            f"{sum(cell.repetition.solves for cell in result.cells)} forward solves of the swarms, "
            f"{result.seconds:.0f} s in all, seed {seed}",
        ),
    ]
    return facts("Study", tuple(rows))


def _cell_table(result: Sensitivity, cell: Cell, table: PerturbationTable | None) -> Table:
    headings = ("no noise", "repetition", "sd", "error %", "se %")
    after = ("posterior", "sd", "sd ratio")
    printed = table is not None and level_percent(cell.level) in table.levels_percent
    columns = (
        Column("name"),
        Column("unit"),
        *(Column(h, number=True) for h in headings),
        *((Column("paper %", number=True),) if printed else ()),
        *(Column(h, number=True) for h in after),
        Column("verdict"),
    )
    rows = []
    for i, c in enumerate(result.without_noise.constants):
        unit, comparison = to_user(c.name, 1.0), cell.comparisons[i]
        mean, sd = with_spread(unit * float(cell.repetition.mean[i]), unit * float(cell.repetition.sd[i]))
        centre, spread = with_spread(unit * float(cell.posterior.mean[i]), unit * float(cell.posterior.sd[i]))
        value = printed_percent(c.name, cell, table)
        rows.append(
            (
                c.name,
                unit_of(c.name),
                significant(unit * c.value),
                mean,
                sd,
                signed(100.0 * (float(cell.repetition.mean[i]) / c.value - 1.0), 2),
                significant(100.0 * comparison.standard_error / abs(c.value), 2),
                *((("" if value is None else signed(value, 2)),) if printed else ()),
                centre,
                spread,
                fixed(comparison.sd_ratio, 2) if math.isfinite(comparison.sd_ratio) else "-",
                "differ: " + ", ".join(comparison.causes) if comparison.causes else "agree",
            )
        )
    flagged = frozenset(i for i, comparison in enumerate(cell.comparisons) if comparison.causes)
    return Table(f"Noise {where(cell)}", columns, tuple(rows), flagged)
