"""Tables of the results of benchmarks/waits.py, for the screen and for docs/speed.md."""

from __future__ import annotations

from typing import Any

from cpam_bayes.render.report import Heading, Table
from studies.validation.reporting import markdown_table, paragraph

Results = dict[str, Any]
Cells = tuple[str, ...]

_WAITS = (
    *("", "before, s", "now, s", "to reach, s", "before, processor s", "now, processor s"),
    *("before, GiB", "now, GiB", "to reach, GiB"),
)
_SOLVER = ("", "before", "now", "to reach", "", "against")


def tables(results: Results) -> tuple[Table, ...]:
    """Tables for the screen, with the answers."""
    waits = tuple((*row, _answers(r)) for row, r in zip(_wait_rows(results), results["waits"], strict=True))
    columns = _columns((*_WAITS, "answers"), left=("answers",))
    solver = Table("Forward solvers", _columns(_SOLVER, left=("against",)), tuple(_solver_rows(results)))
    return Table("Wall clock and memory, from nothing", columns, waits), *((solver,) if solver.rows else ())


def sections(results: Results) -> dict[str, str]:
    """Tables of docs/speed.md, for the later version alone."""
    places = [_WAITS.index(heading) for heading in ("", "now, s", "now, GiB")]
    rows = [tuple(row[i] for i in places) for row in _wait_rows(results)]
    waits = markdown_table(("", "s", "GiB"), rows)
    solved = [(case, now, unit, against) for case, _, now, _, unit, against in _solver_rows(results)]
    solver = markdown_table(("", "measured", "unit", "against"), solved) if solved else "Not measured yet."
    return {"waits": f"{_loads(results['waits'])}\n\n{waits}".strip(), "solver": solver}


def _wait_rows(results: Results) -> list[Cells]:
    return [
        (
            row["case"],
            _seconds(row["before"]),
            _seconds(row["after"]),
            _plain(row["reach_s"]),
            _processor(row["before"]),
            _processor(row["after"]),
            _gib(row["before"]),
            _gib(row["after"]),
            _plain(row["reach_gib"]),
        )
        for row in results["waits"]
    ]


def _solver_rows(results: Results) -> list[Cells]:
    return [
        (
            row["case"],
            _found(row["before"]),
            _found(row["after"]),
            f"{_plain(row['reach'])} or {'more' if row['at_least'] else 'less'}",
            row["unit"],
            (row["after"] or {}).get("against", ""),
        )
        for row in results["solver"]
    ]


def _loads(rows: list[Results]) -> str:
    """Sentence on the load of the machine."""
    loads = [row["load"] for row in rows if row.get("load") is not None]
    if not loads:
        return ""
    return paragraph(f"Load average after a case: {min(loads):.1f} to {max(loads):.1f}.")


def _seconds(measured: Results | None) -> str:
    if measured is None:
        return ""
    text = f"{'over ' if measured['stopped'] else ''}{_plain(measured['seconds'])}"
    # 1 is an answer too: from chains that used up their budget, for instance
    failed = not measured["stopped"] and measured["exit_status"] not in (0, 1)
    return f"{text} (exit {measured['exit_status']})" if failed else text


def _processor(measured: Results | None) -> str:
    return "" if measured is None else _plain(measured["processor_seconds"])


def _gib(measured: Results | None) -> str:
    return "" if measured is None else f"{measured['peak_gib']:.1f}"


def _answers(row: Results) -> str:
    said = [m["answer"] or "" for m in (row["before"], row["after"]) if m is not None]
    return said[0] if len(set(said)) == 1 else f"{said[0]}; now {said[1]}"


def _found(measured: Results | None) -> str:
    return "" if measured is None else _plain(measured["found"])


def _plain(value: float | None) -> str:
    if value is None:
        return ""
    return (
        f"{value:.1e}" if 0.0 < abs(value) < 1e-2 else f"{value:.2g}" if abs(value) < 10 else f"{value:.0f}"
    )


def _columns(headings: Cells, left: tuple[str, ...]) -> tuple[Heading, ...]:
    return tuple(Heading(heading, i > 0 and heading not in left) for i, heading in enumerate(headings))
