"""The result of `batch`: a table of plates, whose columns are declared once for screen, JSON and files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Final, Literal, TypeAlias

import numpy as np

from cpam_bayes import __version__
from cpam_bayes.batches.limits import ControlChart, Limit, control_chart
from cpam_bayes.batches.plate_row import PlateDiagnosis, PlateRow, RowConstant
from cpam_bayes.batches.population import Population
from cpam_bayes.formatting import fixed
from cpam_bayes.plate import to_user, unit_of, user_name
from cpam_bayes.render.page import page_text
from cpam_bayes.render.report import Column, Rows, csv_text
from cpam_bayes.result import Result

BatchVerdict: TypeAlias = Literal["pass", "fail", "too close to call", "cannot be judged"]
SURE: Final = 0.95
"""Probability of meeting all limits from which a plate passes; it fails from 1 - SURE down."""
CERTIFICATE: Final = "Certificate"
"""Title of the section that is printed as a certificate."""

_OF_CONSTANT: Final = (
    Column(None, "value", lambda c: to_user(c.name, 1.0) * c.value),
    Column(None, "sd", lambda c: to_user(c.name, 1.0) * c.sd),
    Column(None, "q025", lambda c: to_user(c.name, 1.0) * c.low),
    Column(None, "q975", lambda c: to_user(c.name, 1.0) * c.high),
    Column(None, "verdict", lambda c: c.verdict.value),
)
"""Columns of a `RowConstant`, in plate-file units."""
_OF_CLAIM: Final = (
    Column(None, "claim", lambda d: d.claim),
    Column(None, "causes", lambda d: list(d.causes)),
    Column(None, "probability", lambda d: d.probability),
    Column(None, "probability_none", lambda d: d.probability_none),
)
"""Columns of a `PlateDiagnosis`."""
_OF_PLATE: Final = (
    Column(None, "file", lambda row: row.file),
    Column("plate", "name", lambda row: row.name),
    Column(None, "status", lambda row: row.status),
    Column(None, "message", lambda row: row.message),
)
_OF_FIT: Final = (
    Column(None, "rms_percent", lambda row: 100.0 * row.rms),
    Column(None, "noise_percent", lambda row: 100.0 * row.noise),
    Column(None, "search", lambda row: row.search or None),
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class BatchResult(Result):
    """One row for each plate.

    Attributes
    ----------
    rows : in the order of the plates
    limits : that the constants have to meet
    diagnosis : whether each plate was diagnosed
    models : number of geometries, whose plates share one model
    from_store : number of plates read from the store
    population : mean constants of the material and their scatter, if asked for
    seconds : wall clock
    """

    command: ClassVar[str] = "batch"

    rows: tuple[PlateRow, ...]
    limits: tuple[Limit, ...]
    diagnosis: bool
    models: int
    from_store: int
    seconds: float
    population: Population | None = None

    @property
    def status(self) -> str:
        """One of "done", "failed" where a plate has no answer, "not converged" where the scatter has not."""
        if self.failed or self.reached_goal:
            return "failed" if self.failed else "done"
        return "not converged"

    @property
    def title(self) -> str:
        """Number of plates, as text."""
        return f"of {len(self.rows)} plate{'' if len(self.rows) == 1 else 's'}"

    @property
    def done(self) -> tuple[PlateRow, ...]:
        """Plates with an answer."""
        return tuple(row for row in self.rows if row.status == "done")

    @property
    def judged(self) -> tuple[PlateRow, ...]:
        """Plates whose list the model describes: only these enter medians, scatter and charts."""
        return tuple(row for row in self.rows if row.is_judged)

    @property
    def failed(self) -> tuple[PlateRow, ...]:
        """Plates without an answer."""
        return tuple(row for row in self.rows if row.status == "failed")

    @property
    def constants(self) -> tuple[str, ...]:
        """All constants of the plates, in the order of their first occurrence."""
        return tuple(dict.fromkeys(c.name for row in self.done for c in row.constants))

    def chart(self, name: str) -> ControlChart | None:
        """The control chart of one constant over the judged plates that have it."""
        found = [row.constant(name) for row in self.judged]
        return control_chart([c.value for c in found if c is not None])

    def outside(self, name: str) -> tuple[PlateRow, ...]:
        """Plates beyond the control limits of one constant."""
        chart, having = self.chart(name), [row for row in self.judged if row.constant(name) is not None]
        return () if chart is None else tuple(having[i] for i in chart.outside)

    def probability(self, row: PlateRow, limit: Limit) -> float | None:
        """Probability that a plate meets a limit; None where it has no such constant."""
        constant = row.constant(limit.name)
        return None if constant is None else constant.posterior.meets(limit)

    def texts(self) -> Mapping[str, str]:
        """The table as CSV, and where there are limits a certificate of one page."""
        table = {"results.csv": csv_text(plates(self))}
        report = self.report()
        sections = [replace(s, folded=False) for s in report.sections if s.title == CERTIFICATE and s.tables]
        if not sections:
            return table
        title, rows = f"{CERTIFICATE}: {report.summary.title}", plates(self).table("Plates")
        shown = replace(report.summary, title=title, tables=(rows,), next_step="")
        page = page_text(title, shown, sections, {})
        return {**table, "certificate.html": page}

    def datasets(self) -> Mapping[str, Any]:
        """The table as an xarray dataset, and the draws of means and scatters."""
        table = {"results.nc": dataset(self)}
        return table if self.population is None else {**table, "population.nc": population_dataset(self)}


def _record(columns: Sequence[Column], of: Any) -> dict[str, Any]:
    return {c.key: c.value(of) for c in columns if c.key is not None}


def plates(result: BatchResult, most: int | None = None) -> Rows:
    """One row per plate: the table of the screen, results.csv and the data frame; most : rows at most."""
    constants = [column for name in result.constants for column in _columns_of(name)]
    claim = [replace(c, value=partial(_of_claim, c)) for c in _OF_CLAIM]
    limits = [
        Column(
            f"P({limit.shown})",
            f"P({limit.text})",
            partial(_probability, result, limit),
            probability_text,
            number=True,
        )
        for limit in result.limits
    ]
    judged = [Column("verdict", "verdict", partial(verdict, result))]
    wrong = [Column("model error", None, lambda row: row.diagnosis and _claim_text(row.diagnosis))]
    return Rows(
        "plates",
        (*_OF_PLATE, *constants, *_OF_FIT, *claim, *limits, *judged, *wrong),
        result.rows[:most],
        lambda row: verdict(result, row) in ("cannot be judged", "too close to call"),
    )


def _columns_of(name: str) -> list[Column]:
    """Columns of a constant for the reader, then for files: E1_GPa, E1_GPa_sd, ..."""
    unit, user = unit_of(name), user_name(name)
    shown = Column(f"{name}, {unit}" if unit else name, None, lambda row: _constant_text(row, name))
    value, *others = (replace(c, value=partial(_of_constant, c, name)) for c in _OF_CONSTANT)
    return [shown, replace(value, key=user), *(replace(c, key=f"{user}_{c.key}") for c in others)]


def _of_constant(column: Column, name: str, row: PlateRow) -> Any:
    constant = row.constant(name)
    return None if constant is None else column.value(constant)


def _of_claim(column: Column, row: PlateRow) -> Any:
    """Table cell of a diagnosis; several causes are joined by spaces."""
    value = None if row.diagnosis is None else column.value(row.diagnosis)
    return " ".join(value) if isinstance(value, list) else value


def _probability(result: BatchResult, limit: Limit, row: PlateRow) -> float | None:
    return result.probability(row, limit)


def verdict(result: BatchResult, row: PlateRow) -> BatchVerdict | None:
    """The verdict of a plate on all limits; None where there are none."""
    if not result.limits:
        return None
    limited = [row.constant(limit.name) for limit in result.limits]
    if not row.is_judged or not all(c is not None and not c.is_open for c in limited):
        return "cannot be judged"
    probabilities = [result.probability(row, limit) or 0.0 for limit in result.limits]
    if min(probabilities) <= 1.0 - SURE:
        return "fail"
    return "pass" if min(probabilities) >= SURE else "too close to call"


def _constant_text(row: PlateRow, name: str) -> str:
    constant = row.constant(name)
    if constant is None:
        return "failed" if row.status == "failed" else ""
    return constant.text


def probability_text(p: float) -> str:
    """A probability with three decimals, or the bound beyond which it lies."""
    return fixed(p, 3) if 0.001 <= p <= 0.999 else ("< 0.001" if p < 0.5 else "> 0.999")


def _claim_text(found: PlateDiagnosis) -> str:
    if found.claim == "none":
        return f"none (P {found.probability:.2f})"
    causes = f": {', '.join(found.causes)}" if found.causes else ""
    return f"{found.claim}{causes} (P {found.probability:.2f})"


def document(result: BatchResult) -> dict[str, Any]:
    """The JSON document."""
    return {
        "command": result.command,
        "version": __version__,
        "seed": result.seed,
        "plates": len(result.rows),
        "failed": len(result.failed),
        "models": result.models,
        "from_store": result.from_store,
        "limits": [limit.text for limit in result.limits],
        "rows": [_row_keys(result, row) for row in result.rows],
        "control_chart": {user_name(name): _chart_keys(result, name) for name in result.constants},
        "population": _population_keys(result.population),
        "seconds": result.seconds,
        "warnings": list(result.warnings),
    }


def _row_keys(result: BatchResult, row: PlateRow) -> dict[str, Any]:
    probabilities = {limit.text: result.probability(row, limit) for limit in result.limits}
    return {
        **_record(_OF_PLATE, row),
        **dict(row.certificate),
        "constants": {user_name(c.name): _constant_keys(c) for c in row.constants},
        "limits": probabilities if row.status == "done" else {},
        "verdict": verdict(result, row),
        **_record(_OF_FIT, row),
        "slip": None if row.slip is None else row.slip[0],
        "diagnosis": None if row.diagnosis is None else _record(_OF_CLAIM, row.diagnosis),
    }


def _constant_keys(c: RowConstant) -> dict[str, Any]:
    unit = to_user(c.name, 1.0)
    posterior = {"centre": unit * c.posterior.centre, "sd": unit * c.posterior.sd}
    return {**_record(_OF_CONSTANT, c), "laplace": posterior}


def _chart_keys(result: BatchResult, name: str) -> dict[str, Any] | None:
    chart = result.chart(name)
    if chart is None:
        return None
    values = {
        "median": chart.median,
        "sigma": chart.sigma,
        "lower": chart.limits[0],
        "upper": chart.limits[1],
    }
    outside = [row.name for row in result.outside(name)]
    return {**{key: to_user(name, value) for key, value in values.items()}, "outside": outside}


def _population_keys(found: Population | None) -> dict[str, Any] | None:
    if found is None:
        return None
    d = found.diagnostics
    return {
        "plates": found.plates,
        "status": found.status,
        "constants": {
            user_name(c.name): {
                "mean": _quantiles(c.mean, to_user(c.name, 1.0)),
                "scatter_percent": _quantiles(c.scatter, 100.0),
                "next_plate": _quantiles(c.next_plate, to_user(c.name, 1.0)),
            }
            for c in found.constants
        },
        "diagnostics": {
            "r_hat": d.r_hat,
            "ess_bulk": d.ess_bulk,
            "autocorrelation_time": d.autocorrelation_time,
            "converged": d.converged,
            "steps": d.steps,
        },
    }


def _quantiles(values: tuple[float, float, float, float], factor: float) -> dict[str, float]:
    return dict(zip(("mean", "sd", "q025", "q975"), (factor * v for v in values), strict=True))


def dataset(result: BatchResult) -> Any:
    """The table over plate, constant and limit as ``xarray.Dataset``, in plate-file units."""
    import xarray

    names, rows = result.constants, result.rows

    def over_constants(column: Column) -> Any:
        cells = [[_of_constant(column, name, row) for name in names] for row in rows]
        numbers = column.key != "verdict"
        empty = np.nan if numbers else ""
        filled = [[empty if cell is None else cell for cell in line] for line in cells]
        kind: Any = float if numbers else object
        return ("plate", "constant"), np.array(filled, dtype=kind).reshape(len(rows), len(names))

    def texts(of: Callable[[PlateRow], Any]) -> tuple[str, Any]:
        return "plate", np.array([of(row) or "" for row in rows], dtype=object)

    met = [[result.probability(row, limit) for limit in result.limits] for row in rows]
    probability = np.array(met, dtype=float).reshape(len(rows), len(result.limits))
    claims = [c for c in _OF_CLAIM if c.key in ("claim", "causes")]
    return xarray.Dataset(
        {
            **{str(column.key): over_constants(column) for column in _OF_CONSTANT},
            "probability_of_limit": (("plate", "limit"), probability),
            "rms": ("plate", [row.rms for row in rows], {"of": "relative residuals"}),
            "noise": ("plate", [row.noise for row in rows], {"of": "relative standard deviation"}),
            **{str(c.key): texts(c.value) for c in _OF_PLATE if c.key != "name"},
            **{str(c.key): texts(partial(_of_claim, c)) for c in claims},
        },
        coords={
            "plate": np.array([row.name for row in rows], dtype=object),
            "constant": np.array([user_name(name) for name in names], dtype=object),
            "unit": ("constant", np.array([unit_of(name) for name in names], dtype=object)),
            "limit": np.array([limit.text for limit in result.limits], dtype=object),
        },
        attrs={"cpam_bayes_version": __version__, "command": result.command, "seed": result.seed},
    )


def population_dataset(result: BatchResult) -> Any:
    """Draws of means and scatters as ``xarray.Dataset``, in plate-file units."""
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
