"""Screen and document of `sensitivity`: repeated inversions beside a posterior, and beside the paper."""

from __future__ import annotations

import math
from typing import Any, Final

from cpam_bayes.formatting import fixed, signed, significant, with_spread
from cpam_bayes.paper import PerturbationTable, contradictions
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.repetition.perturbation import Interpretation
from cpam_bayes.repetition.study import Cell, Sensitivity
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.plates import plate_head, unit_of
from cpam_bayes.report.repetition.words import (
    beside_paper,
    difference_sentences,
    in_standard_errors,
    level_percent,
    printed_percent,
    where,
)
from cpam_bayes.report.tables import Column, Table, facts, remarks

__all__ = ["sensitivity_document", "sensitivity_screen"]

READING_WORDS: Final[dict[Interpretation, str]] = {
    "relative": "each mode has its own standard deviation, the level times its frequency",
    "rms": "all modes have one standard deviation, the level times the root mean square frequency",
}


def sensitivity_document(
    result: Sensitivity, seed: int, table: PerturbationTable | None, warnings: tuple[str, ...]
) -> dict[str, Any]:
    """The JSON document of `sensitivity`; `constants` of a level are those of its first reading."""
    measurement = result.without_noise.specimen.measurement
    assert measurement is not None
    levels = []
    for level in dict.fromkeys(cell.level for cell in result.cells):
        own = [cell for cell in result.cells if cell.level == level]
        readings = {cell.reading: _cell_keys(result, cell, table) for cell in own}
        first = own[0].reading
        levels.append(
            {
                "level_percent": level_percent(level),
                "reading": first,
                "constants": readings[first]["constants"],
                "readings": readings,
            }
        )
    return {
        **plate_keys("sensitivity", result.specimen, seed),
        "list": result.source,
        "frequencies_hz": [float(f) for f in measurement.frequencies],
        "groups": result.groups,
        "without_noise": {
            "constants": {
                user_name(c.name): {"value": to_user(c.name, c.value), "bound": c.bound}
                for c in result.without_noise.constants
            },
            "rms_percent": 100.0 * result.without_noise.rms,
            "status": result.without_noise.swarm.status,
            "swarms": result.starts,
            "swarms_that_found_it": result.found_again,
        },
        "levels": levels,
        "paper": None if table is None else _paper_keys(table),
        "forward_solves": sum(cell.repetition.solves for cell in result.cells),
        "seconds": result.seconds,
        "warnings": list(warnings),
        "notes": list(result.specimen.notes),
    }


def _cell_keys(result: Sensitivity, cell: Cell, table: PerturbationTable | None) -> dict[str, Any]:
    rep, post = cell.repetition, cell.posterior
    constants = {}
    for i, c in enumerate(result.without_noise.constants):
        unit, own = to_user(c.name, 1.0), cell.comparisons[i]
        percent = 100.0 / c.value
        printed = printed_percent(c.name, cell, table)
        error = percent * own.standard_error
        constants[user_name(c.name)] = {
            "repetition_mean": unit * float(rep.mean[i]),
            "repetition_sd": unit * float(rep.sd[i]),
            "posterior_mean": unit * float(post.mean[i]),
            "posterior_sd": unit * float(post.sd[i]),
            "paper_percent_error": printed,
            "percent_error": percent * (float(rep.mean[i]) - c.value),
            "percent_standard_error": error,
            "paper_in_standard_errors": in_standard_errors(result, cell, i, printed),
            "means_agree": own.means_agree,
            "sds_agree": own.sds_agree,
            "shift_in_standard_errors": own.shift,
            "sd_ratio": own.sd_ratio,
            "causes": list(own.causes),
            "share_on_bound": float(rep.on_bound[:, i].mean()),
            "posterior_share_next_to_bound": float(post.next_to_bound[i]),
            "posterior_skewness": float(post.skewness[i]),
            "posterior_sd_over_prior_sd": float(post.contraction[i]),
            "linearised_posterior_sd": unit * float(post.linearised_sd[i]),
            "linearised_repetition_sd": unit * float(post.swarm_sd[i]),
            "repetitions": [unit * float(value) for value in rep.constants[:, i]],
        }
    return {
        "noise_sd_hz": [float(sd) for sd in cell.noise_sd],
        "reordered_share": rep.reordered,
        "redrawn": rep.redrawn,
        "swarms_converged": rep.converged,
        "swarms_restarted": rep.restarted,
        "lists_missed": rep.missed,
        "posterior_converged": post.converged,
        "posterior_effective": post.effective,
        "constants": constants,
    }


def _paper_keys(table: PerturbationTable) -> dict[str, Any]:
    return {
        "table": table.number,
        "angles_deg": [list(angles) for angles in table.angles_deg],
        "contradictions": [
            {
                "constant": c.key,
                "level_percent": c.level_percent,
                "printed_percent": float(c.printed),
                "possible_percent": [c.lowest, c.highest],
            }
            for c in contradictions(table)
        ],
    }


def sensitivity_screen(
    result: Sensitivity, seed: int, table: PerturbationTable | None, warnings: tuple[str, ...]
) -> tuple[Table, ...]:
    """Plate, what was done, one table for each level and reading, why both differ, the paper."""
    return (
        plate_head(f"sensitivity {result.specimen.name}", result.specimen),
        _study(result, seed),
        *(_cell_table(result, cell, table) for cell in result.cells),
        remarks("Where repetition and posterior differ", difference_sentences(result)),
        remarks("Beside the paper", beside_paper(result, table)),
        remarks("Warnings", warnings, flagged=True),
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
        unit, own = to_user(c.name, 1.0), cell.comparisons[i]
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
                significant(100.0 * own.standard_error / abs(c.value), 2),
                *((("" if value is None else signed(value, 2)),) if printed else ()),
                centre,
                spread,
                fixed(own.sd_ratio, 2) if math.isfinite(own.sd_ratio) else "-",
                "differ: " + ", ".join(own.causes) if own.causes else "agree",
            )
        )
    flagged = frozenset(i for i, own in enumerate(cell.comparisons) if own.causes)
    return Table(f"Noise {where(cell)}", columns, tuple(rows), flagged)
