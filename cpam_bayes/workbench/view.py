"""A visit as HTML: the form, drawn once, and its parts, redrawn when something changes."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from cpam_bayes.errors import LayupError
from cpam_bayes.plate.edges import CONDITIONS, PLACES
from cpam_bayes.plate.layup import parse_layup
from cpam_bayes.workbench.plate_text import as_typed, sensors_in, value_at
from cpam_bayes.workbench.visit import LIST_FILES, Visit, Work

_EDGES: Final = {letter: CONDITIONS[letter].name for letter in "FSC"}
_SIZES: Final = (
    ("plate.length_mm", "Length, along x", "mm"),
    ("plate.width_mm", "Width, along y", "mm"),
    ("plate.thickness_mm", "Thickness", "mm"),
    ("plate.mass_g", "Mass, weighed", "g"),
)
_CONSTANTS: Final = (("E1_GPa", "GPa"), ("E2_GPa", "GPa"), ("nu12", ""), ("G12_GPa", "GPa"))
_DOING: Final = {
    "pick": "Looking for modes in the recording",
    "batch": "Computing the plates of the folder",
    "identify": "Computing the full answer",
    "diagnose": "Looking for what is wrong",
    "report": "Writing the report",
}
# Width and height of an interval bar; margin of a drawing as a fraction of the longer side.
_BAR: Final = (160.0, 16.0)
_MARGIN: Final = 0.13
_SPECTRUM: Final = (640.0, 150.0)
_MOST_PLIES, _MOST_BARS = 40, 8


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["typeset"] = lambda text: str(text).replace("+-", "\N{PLUS-MINUS SIGN}")
    environment.filters["said"] = lambda text: str(text).partition("  ")
    return environment


def begin_page(folder: Path, names: Sequence[str], work: Work) -> str:
    """The first page: three steps, an example, the plates of the folder; work : on the table of plates."""
    parts = folder_news(names, work)["parts"]
    page = _environment().get_template("begin.html")
    return page.render(folder=folder.name or str(folder), names=names, parts=parts, work=work)


def folder_news(names: Sequence[str], work: Work) -> dict[str, Any]:
    """The current list of plates with its results, and the running computation."""
    module, table = _module(), work.answers.get("batch")
    cells = {row["file"]: row for row in table["rows"]} if table else {}
    parts = {
        "plates": str(module.plates(names, table, cells, work.problems)),
        "doing": str(module.progress(work, _DOING)),
    }
    return {"version": work.version, "structure": 0, "parts": parts}


def visit_page(visit: Visit) -> str:
    """The complete page of a visit."""
    page = _environment().get_template("visit.html")
    return page.render(visit=visit, parts=_parts(visit), form=Markup(_form(visit)))


def news_of(visit: Visit, structure: int) -> dict[str, Any]:
    """The current parts of the page; with the form, if its structure is newer than the displayed one."""
    parts = dict(_parts(visit))
    if structure != visit.structure:
        parts["form"] = _form(visit)
    return {"version": visit.version, "structure": visit.structure, "parts": parts}


def _module() -> Any:
    return _environment().get_template("parts.html").module


def _form(visit: Visit) -> str:
    data = visit.data
    shown = {key: as_typed(value_at(data, key)) for key, *_ in _SIZES}
    edges = visit.edges
    sections = {
        key: value_at(data, key) or {} for key in ("material", "unknowns", "measurement", "environment")
    }
    return str(
        _module().form(
            visit=visit,
            name=as_typed(data.get("name")),
            sizes=[(key, label, unit, shown[key]) for key, label, unit in _SIZES],
            layup=as_typed(value_at(data, "plate.layup")),
            edges=list(zip(PLACES, edges, strict=True)),
            conditions=_EDGES,
            materials=visit.desk.materials,
            material=sections["material"].get("name", ""),
            constants=[
                (key, unit, as_typed(sections["material"].get(key)), _bounds(sections["unknowns"].get(key)))
                for key, unit in _CONSTANTS
                if key in sections["material"] or key in sections["unknowns"]
            ],
            repeatability=as_typed(sections["measurement"].get("relative_std")),
            resolution=as_typed(sections["measurement"].get("resolution_hz")),
            air=as_typed(sections["environment"].get("air_density_kg_m3")),
            rows=visit.rows,
            source=next((_names(n) for k in LIST_FILES if (n := value_at(data, k))), ""),
            is_typed=not any(value_at(data, key) for key in LIST_FILES[1:]),
            sensors=sensors_in(data),
        )
    )


def _bounds(value: object) -> str:
    return ", ".join(map(as_typed, value)) if isinstance(value, list) else ("" if value is None else "normal")


def _names(given: object) -> str:
    return ", ".join(map(str, given)) if isinstance(given, list) else str(given)


def _parts(visit: Visit) -> dict[str, str]:
    """Element identifier -> HTML."""
    module, answers = _module(), visit.answers
    exact, live = answers.get("identify"), answers.get("live")
    answer = exact or live or visit.stale.get("shown")
    settled = exact is not None
    diagnosis = answers.get("diagnose")
    # one answer per page: if something is wrong, the constants of the plate as stated are folded away
    folded = settled and diagnosis is not None and diagnosis["kind"] != "none" and diagnosis["nothing"] < 0.5
    shares = [*visit.shares.items()][:_MOST_BARS] if visit.doing[0] == "diagnose" else []
    allowing = [_bar(c) for c in diagnosis["constants"]] if diagnosis and folded else []
    weighed = [{"title": title, "probability": p, "said": f"{p:.2f}"} for title, p in shares]
    parts = {
        "title": str(module.title(visit)),
        "problems": str(module.problems(visit)),
        "answer": str(
            module.answer(
                visit, answer, settled, [_bar(c) for c in answer["constants"]] if answer else [], folded
            )
            if "hold" not in answers or (answer and not answers["hold"])
            else module.guide(answers["hold"])
        ),
        "diagnosis": str(module.diagnosis(visit, diagnosis, allowing)),
        "doing": str(module.doing(visit, _DOING, weighed)),
        "drawing": str(_drawing(visit)),
        "stack": str(_stack(visit)),
        "tools": str(module.tools(visit, _commands(visit))),
    }
    listed = visit.rows
    parts["spectrum"] = str(_spectrum(visit))
    used = [i for i, row in enumerate(listed) if not row.left_out]
    rows = diagnosis["rows"] if folded and diagnosis else answer["rows"] if answer else []
    shapes = (exact or visit.stale.get("identify") or {}).get("shapes", [])
    for i in range(len(listed)):
        at = used.index(i) if i in used else -1
        row = rows[at] if at >= 0 and len(rows) == len(used) else None
        shape = shapes[at] if at >= 0 and len(shapes) == len(used) else None
        parts[f"model{i}"] = (row["model"] or "no mode") if row else ""
        parts[f"residual{i}"] = str(module.residual(row)) if row and row["residual"] else ""
        parts[f"shape{i}"] = str(_shape(shape)) if shape else ""
    for key in visit.fields:
        parts[f"error:{key}"] = str(Markup.escape(visit.fields[key]))
    return parts


def _commands(visit: Visit) -> list[tuple[str, str]]:
    """The equivalent commands of the command line."""
    name = shlex.quote(visit.file)
    report = f"cpam-bayes report {name} --quick --out {shlex.quote(f'{Path(visit.file).stem}-report')}"
    return [
        ("constants", f"cpam-bayes identify {name}"),
        ("diagnosis", f"cpam-bayes diagnose {name} --next never"),
        ("report", report),
    ]


def _bar(constant: Mapping[str, Any]) -> Markup:
    """An interval bar across the search bounds, with the reference."""
    low, high = map(float, constant["bounds"])
    width, height = _BAR

    def at(value: float) -> float:
        return 4.0 + (width - 8.0) * min(max((value - low) / (high - low), 0.0), 1.0)

    shape = [f'<line class="track" x1="4" x2="{width - 4:g}" y1="8" y2="8"/>']
    interval, reference = constant["interval"], constant["reference"]
    if interval is not None:
        a, b = (at(end) for end in interval)
        kind = "sure" if constant["is_determined"] else "open"
        shape.append(
            f'<rect class="{kind}" x="{a:.1f}" y="4" width="{max(b - a, 2.0):.1f}" height="8" rx="2"/>'
        )
    shape.append(f'<circle class="at" cx="{at(constant["value"]):.1f}" cy="8" r="3"/>')
    if math.isfinite(reference):
        x = at(reference)
        shape.append(
            f'<path class="reference" d="M{x:.1f} 1v14"><title>reference {reference:.4g}</title></path>'
        )
    return Markup(
        f'<svg class="bar" viewBox="0 0 {width:g} {height:g}" aria-hidden="true">{"".join(shape)}</svg>'
    )


def _shape(grid: Sequence[Sequence[int]]) -> Markup:
    """A thumbnail mode shape: up in one tone, down in another, stronger where it moves more."""
    n = len(grid)
    paths = []
    for level in (-3, -2, -1, 1, 2, 3):
        cells = "".join(
            f"M{i} {n - 1 - j}h1v1h-1z"
            for i, line in enumerate(grid)
            for j, value in enumerate(line)
            if value == level
        )
        if cells:
            paths.append(f'<path class="{"up" if level > 0 else "down"} level{abs(level)}" d="{cells}"/>')
    return Markup(
        f'<svg class="shape" viewBox="0 0 {n} {n}" preserveAspectRatio="none">{"".join(paths)}</svg>'
    )


def _drawing(visit: Visit) -> Markup:
    """The plate from above: edges, attached masses, findings; mm, y upwards."""
    a, b = (_positive(value_at(visit.data, f"plate.{key}_mm")) for key in ("length", "width"))
    if a is None or b is None or max(a, b) > 50.0 * min(a, b):
        return Markup('<p class="hint">The drawing needs length and width.</p>')
    m = _MARGIN * max(a, b)
    shape = [f'<rect class="plate" x="0" y="0" width="{a:g}" height="{b:g}"/>']
    edges = visit.edges
    lines = ((0, 0, 0, b), (0, b, a, b), (a, 0, a, b), (0, 0, a, 0))
    for letter, (x1, y1, x2, y2), (dx, dy) in zip(
        edges, lines, ((-1, 0), (0, 1), (1, 0), (0, -1)), strict=True
    ):
        kind = letter if letter in _EDGES else "F"
        shape.append(f'<line class="edge edge{kind}" x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}"/>')
        shape += _marks(letter, (x1, y1), (x2, y2), (dx * m / 3, dy * m / 3))
    r = 0.022 * max(a, b)
    for sensor in visit.data.get("sensor", []):
        x, y = (_number(sensor.get(k)) for k in ("x_mm", "y_mm"))
        if x is not None and y is not None:
            said = Markup.escape(as_typed(sensor.get("mass_g")))
            shape.append(
                f'<circle class="mass" cx="{x:g}" cy="{b - y:g}" r="{r:g}"><title>{said} g</title></circle>'
            )
    place = (visit.answers.get("diagnose") or {}).get("place")
    if place is not None:
        (x, y), (sx, sy) = place
        shape.append(
            f'<g class="found"><ellipse cx="{x:g}" cy="{b - y:g}" '
            f'rx="{max(2 * sx, r):g}" ry="{max(2 * sy, r):g}"/>'
            f'<path d="M{x - r:g} {b - y:g}h{2 * r:g}M{x:g} {b - y - r:g}v{2 * r:g}"/></g>'
        )
    shape += _places(visit.answers.get("hold"), b, r)
    shape.append(
        f'<path class="axes" d="M{m / 4:g} {b - m / 4:g}v{-m:g}M{m / 4:g} {b - m / 4:g}h{m:g}"/>'
        f'<text class="axes" x="{m * 1.35:g}" y="{b - m / 8:g}" font-size="{m / 2.6:g}">x</text>'
        f'<text class="axes" x="{m / 6:g}" y="{b - m * 1.4:g}" font-size="{m / 2.6:g}">y</text>'
    )
    return Markup(
        f'<svg id="plate-view" class="plate-view" viewBox="{-m:g} {-m:g} {a + 2 * m:g} {b + 2 * m:g}" '
        f'data-length="{a:g}" data-width="{b:g}" role="img" '
        f'aria-label="the plate from above, {a:g} by {b:g} mm">'
        f"{''.join(shape)}</svg>"
    )


def _places(hold: Mapping[str, Any] | None, width: float, r: float) -> Iterable[str]:
    """Soft pads as rings, hits as crosses, the sensor as a ring with a dot."""
    if not hold:
        return
    for x, y in hold["pads_mm"]:
        yield f'<circle class="pad" cx="{x:g}" cy="{width - y:g}" r="{r:g}"><title>soft pad</title></circle>'
    for x, y in hold["hits_mm"]:
        d = f"M{x - r:g} {width - y - r:g}l{2 * r:g} {2 * r:g}m0 {-2 * r:g}l{-2 * r:g} {2 * r:g}"
        yield f'<path class="hit" d="{d}"><title>hit here</title></path>'
    x, y = hold["sensor_mm"]
    at = f'cx="{x:g}" cy="{width - y:g}"'
    yield f'<circle class="listen" {at} r="{r:g}"><title>measure here</title></circle>'
    yield f'<circle class="mass" {at} r="{r / 3:g}"/>'


def _spectrum(visit: Visit) -> Markup:
    """The spectrum of the recording with the rows of the list; a click adds or leaves out a peak."""
    found = visit.stale.get("pick")
    if not found or found["recording"] != value_at(visit.data, "measurement.picked_from"):
        return Markup("")
    (low, _), (high, _) = found["spectrum"][0], found["spectrum"][-1]
    width, height = _SPECTRUM

    def across(hz: float) -> float:
        return float(width * (hz - low) / (high - low))

    floor = min(level for _, level in found["spectrum"])
    line = " ".join(f"{across(hz):.1f},{height * level / floor:.1f}" for hz, level in found["spectrum"])
    marks = []
    for row in visit.rows:
        hz = _number(float(row.hz)) if row.hz.replace(".", "", 1).isdigit() else None
        if hz is not None and low <= hz <= high:
            kind = "left" if row.left_out else "hand" if row.by_hand else "used"
            said = {"left": "left out", "hand": "added by hand", "used": "picked"}[kind]
            x = across(hz)
            marks.append(
                f'<path class="{kind}" d="M{x:.1f} 0v{height:g}"><title>{hz:g} Hz, {said}</title></path>'
            )
    ticks = "".join(
        f'<text x="{width * k / 4:g}" y="{height + 16:g}" class="tick{k}">'
        f"{low + (high - low) * k / 4:.0f}</text>"
        for k in range(5)
    )
    return Markup(
        f'<svg class="spectrum" viewBox="0 0 {width:g} {height + 18:g}" role="img" data-low="{low:g}" '
        f'data-high="{high:g}" aria-label="spectrum of {{}}, {low:.0f} to {high:.0f} Hz">'
        f'{"".join(marks)}<polyline points="{line}"/>{ticks}</svg>'
        '<p class="hint">Click a line to leave it out, a peak to '
        "add it; both are logged in the plate file.</p>"
    ).format(found["recording"])


def _marks(
    letter: str, start: tuple[float, float], end: tuple[float, float], out: tuple[float, float]
) -> Iterable[str]:
    """Hatching of a clamped edge, triangles of a simply supported one."""
    condition = CONDITIONS[letter]
    if condition.mark == "line":
        return
    n = 15 if condition.is_clamp else 7
    (x1, y1), (x2, y2), (dx, dy) = start, end, out
    step = (x2 - x1) / n, (y2 - y1) / n
    path = []
    for i in range(n):
        x, y = x1 + (i + 0.5) * step[0], y1 + (i + 0.5) * step[1]
        if condition.is_clamp:
            path.append(f"M{x:g} {y:g}l{dx + step[0] / 2:g} {dy + step[1] / 2:g}")
        else:
            half = step[0] / 4 + step[1] / 4
            tx, ty = (half, 0.0) if step[0] else (0.0, half)
            path.append(f"M{x:g} {y:g}l{dx + tx:g} {dy + ty:g}l{-2 * tx:g} {-2 * ty:g}z")
    yield f'<path class="mark" d="{"".join(path)}"/>'


def _stack(visit: Visit) -> Markup:
    """The plies, the lowest at the bottom, each with a line along its fibres."""
    try:
        known = visit.specimen
        layup = known.plate.layup if known else parse_layup(str(value_at(visit.data, "plate.layup")))
    except LayupError:
        return Markup("")
    if value_at(visit.data, "material.isotropic"):
        return Markup("")
    n = layup.n_plies
    angles, unknown = layup.angles_deg.tolist(), layup.unknown_index.tolist()
    height = max(min(13.0, 132.0 / n), 2.0)
    shape = []
    for k in range(min(n, _MOST_PLIES)):
        y = (min(n, _MOST_PLIES) - 1 - k) * height
        said = "?" if unknown[k] >= 0 else f"{angles[k]:g}"
        tone = 0.06 if unknown[k] >= 0 else 0.12 + 0.5 * abs(math.cos(math.radians(angles[k])))
        shape.append(
            f'<rect class="ply" x="0" y="{y:g}" width="64" height="{height:g}" fill-opacity="{tone:.2f}"/>'
        )
        if height >= 11.0:
            shape.append(f'<text x="72" y="{y + height - 2:g}" font-size="11">{said}</text>')
    total = min(n, _MOST_PLIES) * height
    return Markup(
        f'<svg class="stack" viewBox="-1 -1 100 {total + 2:g}" height="{total + 2:g}" role="img" '
        f'aria-label="{n} plies from bottom to top">{"".join(shape)}</svg>'
    ) + Markup('<span class="hint">{} {}</span>').format(n, "ply" if n == 1 else "plies")


def _number(value: object) -> float | None:
    fits = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if fits else None  # type: ignore[arg-type]


def _positive(value: object) -> float | None:
    found = _number(value)
    return found if found is not None and 0.0 < found < 1e5 else None
