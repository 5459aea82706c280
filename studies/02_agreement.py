"""Agreement of Ritz, finite elements and CalculiX bricks, and the mode shapes of C1 and D3.

python studies/02_agreement.py [--quick]
"""

from __future__ import annotations

import shutil
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import cpam_bayes as cb
from cpam_bayes.forward_model.model import NO_PARAMETERS, PlateModel, converged_model, plate_problem
from cpam_bayes.mechanics.fem import default_counts, discretise_sparse, fem_space
from cpam_bayes.mechanics.modes import shapes_on_grid
from cpam_bayes.plate import Specimen
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.questions.forward import ForwardResult
from cpam_bayes.render.report import Heading, Table, facts
from cpam_bayes.render.terminal import screen_text
from cpam_bayes.running import single_blas_thread
from validation.reporting import study_main

RESULTS = Path(__file__).parent / "results" / f"{Path(__file__).stem}.json"

KEYS = {
    "quick": "whether this is the small version",
    "limit_percent": "largest deviation of finite elements from Ritz that passes",
    "specimens": "Ritz, elements and bricks on each built-in plate, those that are the same plate once",
    "unsymmetric": "the same on free plates whose layup couples bending and stretching",
    "edges": "Ritz and elements, one row a combination of edges, for each of four plates",
    "shapes": "modes of C1 and D3 on a grid: w, or u and v, the largest displacement being SHAPE_UNITS",
    "seconds": "what the study took",
}

LIMIT_PERCENT = 0.05
# Elements along a side, relative to the package's default.
FINER = 1.5
# Bricks of C2 and C3 take as long as those of C1 and show the same.
BRICKS = ("D&G", "A1", "A2", "B1", "B2", "C1", "C4", "D1", "D2", "D3", "D4")
# Free plates with nonzero B: the plate that gives sizes and material, and the layup.
UNSYMMETRIC = (("C2", "[0/90]"), ("C2", "[45/-45]"), ("D2", "[0/90]"), ("D2", "[45/-45]"))
# Plates for all combinations of edges: the plate that gives sizes and material, layup (None: its own),
# whether it is its own mirror image. A symmetric angle-ply has only the rotation by 180 degrees; the mirror
# image of [45/-45] is the same plate upside down.
EDGE_PLATES = (("C2", None, True), ("C2", "[0/90]", True), ("C2", "[45/-45]", True), ("D4", None, False))
SHAPES, GRID = ("C1", "D3"), 33
SHAPE_UNITS = 100_000
REFERENCE = np.empty(0)  # the reference constants: no parameter varies


@single_blas_thread
def run(quick: bool) -> dict[str, Any]:
    """Results for all plates; quick: one of each kind, coarse, no bricks."""
    start = time.perf_counter()
    names = SHAPES[:1] if quick else _distinct_plates()
    unsymmetric = UNSYMMETRIC[:1] if quick else UNSYMMETRIC
    finer = 0.7 if quick else FINER
    with _bricks([] if quick else _brick_plates()) as bricks:
        specimens = [_specimen_row(cb.read_plate(name), finer, bricks) for name in names]
        coupled = [_specimen_row(_changed(name, layup), finer, bricks) for name, layup in unsymmetric]
        edges = [_edges(*plate, finer, quick) for plate in (EDGE_PLATES[:1] if quick else EDGE_PLATES)]
        shapes = {
            name: _shapes(cb.read_plate(name), 9 if quick else GRID) for name in names if name in SHAPES
        }
        for row in (*specimens, *coupled):
            row["bricks"] = row["bricks"] and row["bricks"]()
    return {
        "quick": quick,
        "limit_percent": LIMIT_PERCENT,
        "specimens": specimens,
        "unsymmetric": coupled,
        "edges": edges,
        "shapes": shapes,
        "seconds": time.perf_counter() - start,
    }


def _distinct_plates() -> tuple[str, ...]:
    """Built-in plates, without the duplicates whose layup is unknown."""
    return tuple(plate.name for plate in cb.builtin_plates() if plate.specimen == plate.name)


def _changed(name: str, layup: str | None = None, edges: str | None = None) -> Specimen:
    specimen = cb.read_plate(name)
    plate = specimen.plate
    own = plate.layup if layup is None else parse_layup(layup)
    return replace(specimen, plate=replace(plate, layup=own, edges=edges or plate.edges))


# Ritz and finite elements


def _elements(specimen: Specimen, n_modes: int, finer: float) -> PlateModel:
    """Finite elements on a mesh with ``finer`` times the default number of elements along a side."""
    problem = plate_problem(specimen)
    counts = [max(2, round(finer * n)) for n in default_counts(problem.nominal)]
    operator = discretise_sparse(problem, fem_space(problem.edges, problem.nominal, *counts), {})
    return PlateModel(operator, n_modes, np.full(n_modes, np.nan))


def _frequencies(model: PlateModel) -> np.ndarray:
    return model.predict(REFERENCE).frequencies[0]


def _deviation(specimen: Specimen, ritz: ForwardResult, finer: float) -> dict[str, Any]:
    """Deviation of finite elements from Ritz, and the estimated errors of both at the worst mode.

    The error of the elements is taken as the change from the default mesh to the finer one, an upper bound
    if they converge.
    """
    n_modes = len(ritz.modes)
    found = _frequencies(_elements(specimen, n_modes, finer))
    coarser = _frequencies(_elements(specimen, n_modes, finer / FINER))
    deviation = 100.0 * (found / ritz.frequencies - 1.0)
    change = 100.0 * np.abs(coarser / found - 1.0)
    worst = int(np.argmax(np.abs(deviation)))
    error = 100.0 * ritz.error[worst] + change[worst]
    return {
        "modes": n_modes,
        "worst_percent": float(deviation[worst]),
        "worst_mode": worst + 1,
        "ritz_error_percent": 100.0 * float(ritz.error[worst]),
        "elements_error_percent": float(change[worst]),
        "passes": bool(abs(deviation[worst]) <= LIMIT_PERCENT),
        "within_estimates": bool(abs(deviation[worst]) <= error),
    }


def _kinds(ritz: ForwardResult) -> dict[str, int]:
    """Number of modes of each kind."""
    return dict(sorted(Counter(mode.kind for mode in ritz.modes).items()))


def _specimen_row(specimen: Specimen, finer: float, bricks: Mapping[str, Any]) -> dict[str, Any]:
    ritz = cb.forward(specimen)
    modes = ritz.modes
    elements = _elements(specimen, len(modes), 0.5).modes(REFERENCE)
    key = _title(specimen)
    return {
        "plate": specimen.name,
        "layup": specimen.plate.layup.text,
        "edges": specimen.plate.edges,
        "frequencies_hz": [mode.frequency for mode in modes],
        "kinds": _kinds(ritz),
        "same_kinds": [m.kind for m in modes] == [m.kind for m in elements],
        **_deviation(specimen, ritz, finer),
        "bricks": (lambda: _against(ritz, bricks[key].result())) if key in bricks else None,
    }


# All combinations of edges


def _edges(name: str, layup: str | None, mirrored: bool, finer: float, quick: bool) -> dict[str, Any]:
    combinations = ["SSSS"] if quick else distinct_edges(mirrored)
    rows = []
    for edges in combinations:
        specimen = _changed(name, layup, edges)
        ritz = cb.forward(specimen)
        rows.append({"edges": edges, "kinds": _kinds(ritz), **_deviation(specimen, ritz, finer)})
    text = _changed(name, layup).plate.layup.text
    return {"plate": name, "layup": text, "mirrored": mirrored, "rows": rows}


def distinct_edges(mirrored: bool) -> list[str]:
    """Combinations of F, S, C on four edges that give different plates, one representative of each.

    mirrored : the plate is its own mirror image in x and in y (36 of 81); otherwise it is unchanged by a
    rotation of 180 degrees only (45).
    """
    return sorted({edges_form("".join(e), mirrored) for e in product("FSC", repeat=4)}, key=_from_free)


def edges_form(edges: str, mirrored: bool) -> str:
    """Representative of all combinations of edges equivalent to this one."""
    x0, y0, x1, y1 = edges
    same = [edges, x1 + y1 + x0 + y0]
    if mirrored:
        same += [x1 + y0 + x0 + y1, x0 + y1 + x1 + y0]
    return max(same, key=_from_free)


def _from_free(edges: str) -> tuple[int, ...]:
    return tuple("FSC".index(e) for e in edges)


# Bricks


def _brick_plates() -> list[Specimen]:
    if shutil.which("ccx") is None:
        print("ccx is not installed: no bricks")
        return []
    return [cb.read_plate(name) for name in BRICKS] + [_changed(name, layup) for name, layup in UNSYMMETRIC]


@contextmanager
def _bricks(specimens: Sequence[Specimen]) -> Iterator[dict[str, Future[Any]]]:
    """Solve the bricks with CalculiX in a second thread, one plate after the other."""
    with ThreadPoolExecutor(1) as pool:
        futures = {_title(s): pool.submit(_solve_bricks, s) for s in specimens}
        try:
            yield futures
        finally:
            pool.shutdown(cancel_futures=True)


def _title(specimen: Specimen) -> str:
    return f"{specimen.name} {specimen.plate.layup.text}"


def _solve_bricks(specimen: Specimen) -> ForwardResult:
    return cb.forward(specimen, solver="ccx")


def _against(ritz: ForwardResult, bricks: ForwardResult) -> dict[str, Any]:
    deviation = (100.0 * (bricks.frequencies / ritz.frequencies - 1.0)).tolist()
    worst = int(np.argmax(np.abs(deviation)))
    return {
        "worst_percent": deviation[worst],
        "worst_mode": worst + 1,
        "deviations_percent": deviation,
        "same_kinds": [m.kind for m in ritz.modes] == [m.kind for m in bricks.modes],
        "seconds": bricks.seconds,
    }


# Mode shapes


def _shapes(specimen: Specimen, n: int) -> dict[str, Any]:
    """Mode shapes (n, n), x by rows, in whole numbers: exact enough for nodal lines, and small."""
    assert specimen.measurement is not None
    model = converged_model(specimen, NO_PARAMETERS, specimen.measurement.size)
    values = shapes_on_grid(model.operator, model.spectrum(REFERENCE, vectors=True), n=n)
    found = []
    for mode, (u, v, w) in zip(model.modes(REFERENCE), values, strict=True):
        drawn = {"u": u, "v": v} if mode.in_plane_fraction > 0.5 else {"w": w}
        largest = np.sqrt(np.max(np.sum(np.square(list(drawn.values())), axis=0)))
        fields = {name: np.rint(SHAPE_UNITS * a / largest).astype(int).tolist() for name, a in drawn.items()}
        found.append({"frequency_hz": mode.frequency, "kind": mode.kind, "label": mode.label, **fields})
    plate = specimen.plate
    return {
        "layup": plate.layup.text,
        "edges": plate.edges,
        "length_mm": 1e3 * plate.length,
        "width_mm": 1e3 * plate.width,
        "modes": found,
    }


# Output


def show(results: dict[str, Any]) -> None:
    """Print the results as tables."""
    limit = f"percent of the Ritz frequency, elements pass up to {results['limit_percent']:g}"
    columns = _columns(_HEADINGS)
    tables = [
        Table(f"Built-in plates: {limit}", columns, tuple(map(_row, results["specimens"]))),
        Table(f"Free plates with B not zero: {limit}", columns, tuple(map(_row, results["unsymmetric"]))),
        *(_edges_table(plate) for plate in results["edges"]),
        facts("In all", _summary(results)),
    ]
    print(screen_text(tuple(tables), sys.stdout))


_HEADINGS = ("plate", "layup", "edges", "kinds", "modes", "elements", "mode", "Ritz est.", "elements est.")
_HEADINGS += ("", "bricks", "mode", "s")
_TEXT = {"plate", "layup", "edges", "kinds", ""}
_ACROSS = 5


def _columns(headings: Sequence[str]) -> tuple[Heading, ...]:
    return tuple(Heading(heading, heading not in _TEXT) for heading in headings)


def _row(r: Mapping[str, Any]) -> tuple[str, ...]:
    kinds = ", ".join(f"{n} {kind}" for kind, n in r["kinds"].items())
    estimates = (f"{r['ritz_error_percent']:.4f}", f"{r['elements_error_percent']:.4f}")
    elements = (f"{r['worst_percent']:+.4f}", str(r["worst_mode"]), *estimates, _verdict(r))
    bricks = ("", "", "")
    if b := r["bricks"]:
        bricks = (f"{b['worst_percent']:+.3f}", str(b["worst_mode"]), f"{b['seconds']:.0f}")
    return (r["plate"], r["layup"], r["edges"], kinds, str(r["modes"]), *elements, *bricks)


def _verdict(row: Mapping[str, Any]) -> str:
    return "pass" if row["passes"] else "FAIL"


def _edges_table(plate: Mapping[str, Any]) -> Table:
    """Table of edges, deviation, mode and verdict, several combinations per line."""
    cells: list[str] = []
    for r in plate["rows"]:
        cells += (r["edges"], f"{r['worst_percent']:+.4f}", str(r["worst_mode"]), _verdict(r))
    across = 4 * _ACROSS
    cells += [""] * (-len(cells) % across)
    rows = tuple(tuple(cells[i : i + across]) for i in range(0, len(cells), across))
    passed = f"{sum(r['passes'] for r in plate['rows'])} of {len(plate['rows'])} pass"
    modes = plate["rows"][0]["modes"]
    in_plane = sum("in-plane" in r["kinds"] for r in plate["rows"])
    title = f"Edges, plate {plate['plate']} with {plate['layup']}, {modes} modes: {passed}"
    if in_plane:
        title += f", {in_plane} with in-plane modes"
    return Table(title, _columns(("edges", "%", "mode", "") * _ACROSS), rows)


def _summary(results: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    rows = [(plate, r) for plate in results["edges"] for r in plate["rows"]]
    rows += [(r, r) for r in (*results["specimens"], *results["unsymmetric"])]
    named = [(f"{plate['plate']} {plate['layup']} {r['edges']}", r) for plate, r in rows]
    name, worst = max(named, key=lambda item: abs(item[1]["worst_percent"]))
    beyond = [name for name, r in named if not r["within_estimates"]]
    return (
        ("plates", f"{len(rows)}, of which {sum(not r['passes'] for _, r in named)} FAIL"),
        ("worst", f"{worst['worst_percent']:+.4f} %, mode {worst['worst_mode']} of {name}"),
        ("further apart than both errors estimated", "; ".join(beyond) or "none"),
        ("took", f"{results['seconds']:.0f} s"),
    )


def main() -> None:
    study_main(__doc__, run, show, RESULTS)


if __name__ == "__main__":
    main()
