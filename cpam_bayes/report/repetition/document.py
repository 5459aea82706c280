"""The JSON document of `sensitivity`."""

from __future__ import annotations

from typing import Any

from cpam_bayes.paper import PerturbationTable, contradictions
from cpam_bayes.plate import to_user, user_name
from cpam_bayes.repetition.sensitivity import SensitivityResult
from cpam_bayes.repetition.study import Cell, Sensitivity
from cpam_bayes.repetition.warnings import level_percent
from cpam_bayes.report.documents import plate_keys
from cpam_bayes.report.repetition.words import in_standard_errors, printed_percent


def document(answer: SensitivityResult) -> dict[str, Any]:
    """The JSON document of `sensitivity`; `constants` of a level are those of its first reading."""
    result, table = answer.study, answer.table
    measurement = result.without_noise.specimen.measurement
    assert measurement is not None
    levels = []
    for level in dict.fromkeys(cell.level for cell in result.cells):
        cells = [cell for cell in result.cells if cell.level == level]
        readings = {cell.reading: _cell_keys(result, cell, table) for cell in cells}
        first = cells[0].reading
        levels.append(
            {
                "level_percent": level_percent(level),
                "reading": first,
                "constants": readings[first]["constants"],
                "readings": readings,
            }
        )
    return {
        **plate_keys(answer),
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
        "warnings": list(answer.warnings),
        "notes": list(result.specimen.notes),
    }


def _cell_keys(result: Sensitivity, cell: Cell, table: PerturbationTable | None) -> dict[str, Any]:
    rep, post = cell.repetition, cell.posterior
    constants = {}
    for i, c in enumerate(result.without_noise.constants):
        unit, comparison = to_user(c.name, 1.0), cell.comparisons[i]
        percent = 100.0 / c.value
        printed = printed_percent(c.name, cell, table)
        error = percent * comparison.standard_error
        constants[user_name(c.name)] = {
            "repetition_mean": unit * float(rep.mean[i]),
            "repetition_sd": unit * float(rep.sd[i]),
            "posterior_mean": unit * float(post.mean[i]),
            "posterior_sd": unit * float(post.sd[i]),
            "paper_percent_error": printed,
            "percent_error": percent * (float(rep.mean[i]) - c.value),
            "percent_standard_error": error,
            "paper_in_standard_errors": in_standard_errors(result, cell, i, printed),
            "means_agree": comparison.means_agree,
            "sds_agree": comparison.sds_agree,
            "shift_in_standard_errors": comparison.shift,
            "sd_ratio": comparison.sd_ratio,
            "causes": list(comparison.causes),
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
