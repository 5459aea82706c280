"""The table of a batch as CSV and as NetCDF."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.batches.batch import BatchResult
from cpam_bayes.batches.plate_row import PlateRow
from cpam_bayes.plate import to_user, unit_of, user_name

__all__ = ["csv_text", "dataset", "population_dataset"]

_COLUMNS = ("value", "sd", "low", "high")


def csv_text(result: BatchResult) -> str:
    """One row a plate; what is not known is empty."""
    heads = ["file", "name", "status", "message"]
    for name in result.constants:
        user = user_name(name)
        heads += [user, f"{user}_sd", f"{user}_q025", f"{user}_q975", f"{user}_verdict"]
    heads += ["rms_percent", "noise_percent", "claim", "causes", "probability", "probability_beside"]
    heads += [f"P({limit.text})" for limit in result.limits]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(heads)
    table.writerows(_cells(result, row) for row in result.rows)
    return text.getvalue()


def _cells(result: BatchResult, row: PlateRow) -> list[str]:
    cells = [row.file, row.name, row.status, row.message]
    for name in result.constants:
        c = row.constant(name)
        if c is None:
            cells += [""] * 5
            continue
        cells += [_number(to_user(name, float(getattr(c, column)))) for column in _COLUMNS]
        cells.append(c.verdict)
    cells += [_number(100.0 * row.rms), _number(100.0 * row.noise)]
    found = row.diagnosis
    if found is None:
        cells += [""] * 4
    else:
        beside = _number(found.probability_beside)
        cells += [found.claim, " ".join(found.causes), _number(found.probability), beside]
    for limit in result.limits:
        p = result.probability(row, limit)
        cells.append("" if p is None else _number(p))
    return cells


def _number(value: float) -> str:
    return f"{value:.7g}" if math.isfinite(value) else ""


def dataset(result: BatchResult) -> Any:
    """The table over plate, constant and limit as ``xarray.Dataset``, in the units of plate files."""
    import xarray

    names = result.constants
    values = {column: np.full((len(result.rows), len(names)), np.nan) for column in _COLUMNS}
    verdicts = np.full((len(result.rows), len(names)), "", dtype=object)
    for i, row in enumerate(result.rows):
        for j, name in enumerate(names):
            c = row.constant(name)
            if c is not None:
                verdicts[i, j] = c.verdict
                for column in _COLUMNS:
                    values[column][i, j] = to_user(name, float(getattr(c, column)))
    probability = np.array(
        [[_or_nan(result.probability(row, limit)) for limit in result.limits] for row in result.rows]
    ).reshape(len(result.rows), len(result.limits))

    def texts(of: list[str]) -> tuple[str, Any]:
        return "plate", np.array(of, dtype=object)

    of_constants = ("plate", "constant")
    return xarray.Dataset(
        {
            "value": (of_constants, values["value"]),
            "sd": (of_constants, values["sd"]),
            "q025": (of_constants, values["low"]),
            "q975": (of_constants, values["high"]),
            "verdict": (of_constants, verdicts),
            "probability_of_limit": (("plate", "limit"), probability),
            "rms": ("plate", [row.rms for row in result.rows], {"of": "relative residuals"}),
            "noise": ("plate", [row.noise for row in result.rows], {"of": "relative standard deviation"}),
            "file": texts([row.file for row in result.rows]),
            "status": texts([row.status for row in result.rows]),
            "message": texts([row.message for row in result.rows]),
            "claim": texts([row.diagnosis.claim if row.diagnosis else "" for row in result.rows]),
            "causes": texts([" ".join(row.diagnosis.causes) if row.diagnosis else "" for row in result.rows]),
        },
        coords={
            "plate": np.array([row.name for row in result.rows], dtype=object),
            "constant": np.array([user_name(name) for name in names], dtype=object),
            "unit": ("constant", np.array([unit_of(name) for name in names], dtype=object)),
            "limit": np.array([limit.text for limit in result.limits], dtype=object),
        },
        attrs={"cpam_bayes_version": __version__, "command": result.command, "seed": result.seed},
    )


def population_dataset(result: BatchResult) -> Any:
    """The draws of means and scatters as ``xarray.Dataset``, in the units of plate files."""
    import xarray

    found = result.population
    assert found is not None
    n = len(found.constants)
    drawn = {}
    for k, c in enumerate(found.constants):
        user = user_name(c.name)
        drawn[user] = ("draw", to_user(c.name, 1.0) * found.draws[:, k], {"unit": unit_of(c.name)})
        drawn[f"{user}_scatter"] = ("draw", found.draws[:, n + k], {"of": "relative standard deviation"})
    attrs = {"cpam_bayes_version": __version__, "plates": found.plates, "seed": result.seed}
    return xarray.Dataset(drawn, attrs=attrs)


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value
