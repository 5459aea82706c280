"""JSON documents, CSV files and data frames."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.plate import Specimen
from cpam_bayes.render.report import Rows

__all__ = [
    "csv_text",
    "data_frame",
    "json_text",
    "laminate_keys",
    "laminate_unit",
    "plain",
    "plate_keys",
    "xlsx_bytes",
]

# Characters of the name of a sheet.
_LONGEST_TITLE = 31
_ENGINEERING_GPA = ("Ex", "Ey", "Gxy")


def json_text(document: Mapping[str, Any]) -> str:
    """One JSON document; what is not a finite number becomes null."""
    return json.dumps(plain(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def plate_keys(command: str, seed: int, specimen: Specimen) -> dict[str, Any]:
    """The keys that every document about one plate begins with."""
    return {
        "command": command,
        "version": __version__,
        "plate": specimen.name,
        "specimen": specimen.specimen,
        "source": specimen.source,
        "seed": seed,
        **dict(specimen.certificate),
        **_damping_keys(specimen),
    }


def _damping_keys(specimen: Specimen) -> dict[str, Any]:
    """Damping ratios and loss factors of the measured frequencies, where a table gives them."""
    measurement = specimen.measurement
    if measurement is None or measurement.damping is None or measurement.loss_factors is None:
        return {}
    columns = (measurement.frequencies, measurement.damping, measurement.loss_factors)
    return {
        "damping": [
            {"measured_hz": float(f), "damping_ratio": float(ratio), "loss_factor": float(factor)}
            for f, ratio, factor in zip(*columns, strict=True)
        ]
    }


def laminate_keys(laminate: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """D11 to D26 in N m, Ex, Ey, Gxy in GPa by name, nuxy."""
    units = {name: laminate_unit(name) for name in laminate}
    return {key: {"value": laminate[name] * factor} for name, (key, factor) in units.items()}


def laminate_unit(name: str) -> tuple[str, float]:
    """Key of a laminate constant in documents, with its unit, and the factor from SI."""
    return (f"{name}_GPa", 1e-9) if name in _ENGINEERING_GPA else (name, 1.0)


def plain(value: Any) -> Any:
    """Plain containers, numbers and texts; what is not a finite number becomes None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def csv_text(rows: Rows) -> str:
    """The rows as a CSV file: a head of keys, empty cells for what is not known."""
    sheet, columns = io.StringIO(), [c.key for c in rows.columns if c.key is not None]
    writer = csv.DictWriter(sheet, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: "" if v is None else v for k, v in plain(row).items()} for row in rows.records())
    return sheet.getvalue()


def xlsx_bytes(tables: Sequence[Rows]) -> bytes:
    """The tables as a workbook, a sheet each, with a head of keys; a text is never a formula."""
    import openpyxl  # for workbooks alone

    book = openpyxl.Workbook()
    book.remove(book.active)
    for rows in tables:
        sheet = book.create_sheet(rows.name[:_LONGEST_TITLE])
        sheet.append([c.key for c in rows.columns if c.key is not None])
        for at, record in enumerate(rows.records(), 2):
            for column, value in enumerate(plain(record).values(), 1):
                is_plain = value is None or isinstance(value, bool | int | float | str)
                cell = sheet.cell(at, column, value if is_plain else json.dumps(value, ensure_ascii=False))
                if isinstance(cell.value, str):
                    cell.data_type = "s"
        sheet.freeze_panes = "A2"
    held = io.BytesIO()
    book.save(held)
    return held.getvalue()


def data_frame(tables: Sequence[Rows], name: str | None) -> Any:
    """One of the tables of an answer as a pandas data frame, the first unless named.

    Raises
    ------
    ValueError
        If there is no table of that name.
    """
    import pandas as pd  # heavy, and a part of xarray

    by_name = {rows.name: rows for rows in tables}
    rows = by_name.get(name) if name is not None else next(iter(tables), None)
    if rows is None:
        raise ValueError(f"to_dataframe: received {name!r}, accepted: {' '.join(by_name) or 'no table'}")
    return pd.DataFrame.from_records(
        rows.records(), columns=[c.key for c in rows.columns if c.key is not None]
    )
